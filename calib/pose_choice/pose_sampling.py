"""Poses to try a robot with where nobody gives any: spread at random over its joint limits.

A closed-loop robot can take only part of its joint limits, sometimes a small one. The box of the limits is therefore
drawn in towards home, by a third each time, until enough of the poses in it close, at a distance from singularities.
Where targets must stay in a range, nothing is drawn in, since home may lie outside; poses are tried until enough are.

Touches tell less than positions would: of one socket, the size of the robot stays open, because the ball is in the same
place every time. So poses of a robot that touches are brought to what it touches, one thing after the other, where that
is found from where they are.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from calib.arrays import BoolArray, FloatArray, random_numbers
from calib.data.in_memory import as_poses
from calib.data.measurements import Poses, of_visits
from calib.errors import DataError, InputError, nearest
from calib.linearisation.simulate import MET, at_contact
from calib.model.robot import Robot, require_robot
from calib.observation.kind import Readings

_DRAWN_IN = 2.0 / 3.0
_SMALLEST_BOX = 0.01  # of the joint limits
_TRIES = 4  # poses tried for each one wanted, in each box
_ROUNDS = 50  # of tries where targets must stay in a range


Within = Mapping[str, tuple[float, float]] | Poses
"""Ranges of joints, and of coordinates of targets such as `tool_x`, by name [SI]; or poses, which span ranges."""


def sample(
    robot: Robot, count: int, seed: int | np.random.Generator = 0, *, within: Within | ArrayLike | None = None
) -> Poses:
    """Return `count` poses that the robot can take, named by their number; at contact where it touches something.

    Where too few poses touch anything, as the description places it, they are all left as they are, and say nothing of
    touches (`calib.linearisation.observed.unsaid_touches`).

    Args:
        robot: The robot at its present values.
        count: How many.
        seed: Of the joint values; or where the random numbers come from.
        within: Ranges to stay in, inside the joint limits; see `Within`. Or joint values that span them, (n,
            n_actuated) [m or rad].

    Raises:
        InputError: The count or the seed is negative, or a range is not one.
        DataError: Not enough were found, even near home; or a sliding joint has no limits.
    """
    require_robot(robot)
    if count < 1:
        raise InputError(f"count {count}: at least one pose is needed")
    rng, ranges = random_numbers(seed), _ranges(robot, within)
    touches = [one for one in robot.instruments if not one.columns()]
    tried = _poses(_spread(robot, _TRIES * count if touches else count, rng, ranges))
    if not touches:
        return tried
    looks = [(one, pair, detail) for one in touches for pair, detail in zip(*one.looks(), strict=True)]
    wanted = {}
    for one in touches:
        visits = np.array([k for k in range(len(tried)) if looks[k % len(looks)][0] is one], dtype=np.intp)
        pairs, details = (np.array([looks[k % len(looks)][part] for k in visits]) for part in (1, 2))
        wanted[one.name] = Readings(visits, pairs, np.zeros((len(visits), one.n_rows)), None, details)
    commands, misses = at_contact(robot, tried, wanted)
    there = np.flatnonzero(misses < MET)
    if len(there) < count:
        return _poses(tried.joints[:count])
    found = {name: of_visits(one, there[:count]) for name, one in wanted.items()}
    said = {
        name: Readings(one.visits, one.pairs, np.zeros((len(one), 0)), None, one.details) for name, one in found.items()
    }
    return replace(_poses(commands[there[:count]]), wanted=said)


def _poses(joints: FloatArray) -> Poses:
    names = tuple(str(k + 1) for k in range(len(joints)))
    return Poses(joints, tuple(f"sampled pose {name}" for name in names), names, "sampled poses", ())


def _ranges(robot: Robot, within: Within | ArrayLike | None) -> dict[str, tuple[float, float]]:
    """Checked ranges by the names of joints and coordinates of targets."""
    if within is None:
        return {}
    if not isinstance(within, Mapping):
        joints = as_poses(robot, within).joints
        spans = zip(joints.min(axis=0), joints.max(axis=0), strict=True)
        return {name: (float(low), float(high)) for name, (low, high) in zip(robot.joint_names, spans, strict=True)}
    known = (*robot.joint_names, *(f"{target}_{axis}" for target in robot.target_names for axis in "xyz"))
    for name, span in within.items():
        if name not in known:
            raise InputError(f"within: no joint or coordinate '{name}'{nearest(name, known)}")
        if np.shape(span) != (2,):
            raise InputError(f"within: {name} needs a range, such as (-0.5, 0.5)")
        low, high = span
        if not (np.isfinite(low) and np.isfinite(high) and low <= high):
            raise InputError(f"within: {name} from {low:g} to {high:g} is no range; give the smaller number first")
    return dict(within)


def _spread(
    robot: Robot, count: int, rng: np.random.Generator, ranges: Mapping[str, tuple[float, float]]
) -> FloatArray:
    """Joint values that the robot can take, in these ranges [SI], (count, n_actuated)."""
    lower, upper = _limits(robot, ranges)
    middle = np.clip(robot.home, lower, upper)
    of_targets = set(ranges) - set(robot.joint_names)
    found = np.zeros((0, len(robot.joint_names)))
    size, rounds = 1.0, 0
    while len(found) < count and size > _SMALLEST_BOX and rounds < _ROUNDS:
        low, high = middle + size * (lower - middle), middle + size * (upper - middle)
        q = rng.uniform(low, high, (_TRIES * count, len(low)))
        closed = robot.close(q)
        good = np.flatnonzero(closed.ok)
        distance = robot.singular_values(robot.configurations(q[good], closed.at(good)))
        good = good[distance >= robot.description.singularity_limit]
        if of_targets and len(good):
            good = good[_inside(robot, q[good], ranges)]
        found = np.vstack([found, q[good]])[:count]
        size, rounds = (size, rounds + 1) if of_targets else (_DRAWN_IN * size, rounds)
    if len(found) < count:
        what = "are within these ranges; widen them" if ranges else "can be assembled; give a file of poses"
        raise DataError(f"{robot.path}: only {len(found)} of {count} random poses {what}")
    return found


def _inside(robot: Robot, q: FloatArray, ranges: Mapping[str, tuple[float, float]]) -> BoolArray:
    """Whether the targets are in their ranges at joints q (n, n_actuated), (n,)."""
    positions = robot.positions(q)
    good = np.ones(len(q), dtype=bool)
    for t, target in enumerate(robot.target_names):
        for a, axis in enumerate("xyz"):
            low, high = ranges.get(f"{target}_{axis}", (-np.inf, np.inf))
            good &= (positions[:, t, a] >= low) & (positions[:, t, a] <= high)
    return good


def _limits(robot: Robot, ranges: Mapping[str, tuple[float, float]]) -> tuple[FloatArray, FloatArray]:
    """Joint limits that contain home; a turning joint without limits gets half a turn to both sides.

    Joints that have a range get that, as far as it is inside their limits.
    """
    joints = {joint.name: joint for joint in robot.urdf.joints}
    lower, upper = robot.home.copy(), robot.home.copy()
    for k, name in enumerate(robot.joint_names):
        low, high = joints[name].lower, joints[name].upper
        if name in ranges:
            lower[k], upper[k] = max(low, ranges[name][0]), min(high, ranges[name][1])
            if lower[k] > upper[k]:
                raise InputError(f"within: {name} lies outside its joint limits {low:.6g} to {high:.6g} [m or rad]")
            continue
        if robot.mechanism.dimensions[name] == "length" and not np.isfinite(high - low):
            raise DataError(
                f"{robot.path}: sliding joint '{name}' has no limits to spread poses over; give a file of poses"
            )
        lower[k] = min(lower[k], low if np.isfinite(low) else robot.home[k] - np.pi)
        upper[k] = max(upper[k], high if np.isfinite(high) else robot.home[k] + np.pi)
    return lower, upper
