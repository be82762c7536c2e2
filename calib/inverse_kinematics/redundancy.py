"""Where joints have more freedom than a goal takes: stay near given joint values.

From a configuration that reaches its goal, step within the null space of the Jacobian towards the wanted joints, return
to the goal (`calib.inverse_kinematics.reaching.descend`), and keep the result where it is nearer; until the rest of the
way is orthogonal to the null space, or limits hold it. That is a local minimum of the distance, lengths divided by the
robot's characteristic length. It converges linearly, faster the nearer the wanted joints are.
"""

from __future__ import annotations

import numpy as np

from calib.arrays import FloatArray, IntArray
from calib.inverse_kinematics.reaching import LARGEST_STEP, NEARLY, Configured, Linear, Reach, descend

_STEPS = 60
_TOLERANCE = 1e-7  # of the way left within the null space [rad, or characteristic lengths]


def unwound(reach: Reach, at: Configured, near: FloatArray) -> Configured:
    """Take whole turns out of joints where that brings them nearer to `near`, (n, n_actuated), and leaves no limit."""
    mechanism, actuated = reach.mechanism, at.actuated.copy()
    for j, name in enumerate(mechanism.actuated):
        column = mechanism.select_actuated[:, j]
        if mechanism.dimensions[name] == "length" or np.count_nonzero(column) != 1:
            continue  # a whole turn of a joint that others mimic is another pose
        turns = 2 * np.pi * np.round((actuated[:, j] - near[:, j]) / (2 * np.pi))
        inside = (actuated[:, j] - turns >= reach.lower[j]) & (actuated[:, j] - turns <= reach.upper[j])
        actuated[inside, j] -= turns[inside]
    return Configured(actuated, at.passive, at.distance)


def nearer(reach: Reach, index: IntArray, start: Configured, near: FloatArray) -> Configured:
    """Move solved configurations within their null space towards the actuated joints `near`, (n, n_actuated)."""
    at = Configured(start.actuated.copy(), start.passive.copy(), start.distance.copy())
    part = np.ones(len(index))
    active = np.arange(len(index))
    for _ in range(_STEPS):
        if len(active) == 0:
            break
        linear = reach.linearise(index[active], at.actuated[active], at.passive[active])
        way = _null_way(reach, at.subset(active), linear, near[active])
        left = np.max(np.abs(way), axis=1)
        moving = left > _TOLERANCE
        active, way = active[moving], way[moving] * np.minimum(1.0, LARGEST_STEP / left[moving])[:, None]
        if len(active) == 0:
            break
        trial = np.clip(at.actuated[active] + part[active, None] * reach.scale * way, reach.lower, reach.upper)
        passive, followed = reach.follow(at.subset(active), linear.subset(np.flatnonzero(moving)), trial)
        passive[~followed] = at.passive[active[~followed]]
        trial[~followed] = at.actuated[active[~followed]]
        back = descend(reach, index[active], Configured(trial, passive, np.full(len(active), np.inf)), 8)
        before = _joint_distance(reach, at.actuated[active], near[active])
        better = (back.distance < NEARLY) & (_joint_distance(reach, back.actuated, near[active]) < before)
        good, bad = active[better], active[~better]
        at.actuated[good], at.passive[good] = back.actuated[better], back.passive[better]
        at.distance[good] = back.distance[better]
        part[good], part[bad] = np.minimum(1.0, 1.5 * part[good]), part[bad] / 3
        active = active[part[active] > 1e-3]
    return descend(reach, index, at, 8)  # to rounding, which the steps back need not reach


def _null_way(reach: Reach, at: Configured, linear: Linear, near: FloatArray) -> FloatArray:
    """Part of the way to `near` that leaves the target where it is, in scaled joints; nothing past a limit."""
    way = (near - at.actuated) / reach.scale
    held = np.zeros(way.shape, dtype=bool)
    for _ in range(way.shape[1]):
        projected = np.where(held, 0.0, way)
        free = np.where(held[:, None, :], 0.0, linear.slope)
        _, values, right = np.linalg.svd(free, full_matrices=False)
        used = np.where((values > 1e-9 * values[:, :1])[:, :, None], right, 0.0)
        projected = projected - np.einsum("nij,nik,nk->nj", used, used, projected)
        projected = np.where(held, 0.0, projected)
        outward = ((at.actuated <= reach.lower) & (projected < 0)) | ((at.actuated >= reach.upper) & (projected > 0))
        outward &= np.abs(projected) > 1e-12
        if not np.any(outward):
            break
        held |= outward
    return projected


def _joint_distance(reach: Reach, actuated: FloatArray, near: FloatArray) -> FloatArray:
    distance: FloatArray = np.linalg.norm((actuated - near) / reach.scale, axis=1)
    return distance
