"""Base and tool that carry a robot's poses to printed poses, T_printed = X T_robot(q) Y, and what no pose shows.

This is the hand-eye problem X^-1 T_printed = T_robot Y (`calib.core.instruments.hand_eye`). Rows with large misses are
left out and the rest is aligned again, so that a row of another program does not spoil the result.

Some changes of base and tool are not seen, such as a shift of both along the parallel axes of a SCARA. With J the
derivative of poses over the joints' ranges by parameters in sigmas, of places (p) and of joint origins (o), and unit
rows as the priors of joint origins, the places are seen by what origins cannot imitate:

    K = B - A A^+ B        A = [J_o; 1]        B = [J_p; 0]

A singular direction of K with a standard deviation above a metre or a radian is not seen. So axes that are parallel but
for errors of the robot, or for the digits of its file, count as parallel.

When it fails. More than a third of the rows wrong.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray, IntArray, ReadOnlyArrays
from calib.core.instruments.hand_eye import LEVER, rotation_form, solve_poses
from calib.core.numerics import linalg
from calib.core.numerics.identifiability import eliminate, reduce_rows
from calib.core.robots.jacobian import linearise
from calib.core.robots.robot import Robot
from calib.matching.agreement import other_poses
from calib.shared.null_space import UnseenGroup, natural_coefficients, null_groups

_ROUNDS = 5
_FAR = 6.0  # a row is left out if it misses by more than this many times the median miss
_PARALLEL = 1e-3  # axes that lean less than this show no shift along them: robots differ more from their files [rad]
_LEAST = 1e-4  # miss that is never left out [m]
_SMALL = 1e-5  # change of a position that poses show [m]
_UNSEEN = 100.0  # least standard deviation of an unseen change, in sigmas of places: 1 m, 1 rad
_NAMED = 1e-3  # components of such a change that are smaller than this part of its largest one are not named


@dataclass(frozen=True, eq=False)
class Alignment(ReadOnlyArrays):
    """Base and tool, and the misses that remain.

    Attributes:
        base: X, (4, 4).
        tool: Y, (4, 4).
        distances: Miss of each row, from distance and rotation by `LEVER`, (n,) [m].
        kept: Mask of the aligned rows, (n,).
    """

    base: FloatArray
    tool: FloatArray
    distances: FloatArray
    kept: BoolArray

    @property
    def rms_distance(self) -> float:
        """Root mean square of the misses of the kept rows [m]."""
        return float(np.sqrt(np.mean(self.distances[self.kept] ** 2)))


def align(
    robot: FloatArray,
    printed: FloatArray,
    now: tuple[FloatArray, FloatArray] = (np.eye(4), np.eye(4)),
    known: tuple[bool, bool] = (False, False),
) -> Alignment:
    """Find base and tool.

    Args:
        robot: T_robot(q), (n, 4, 4) [m].
        printed: T_printed, (n, 4, 4) [m].
        now: Base and tool, (4, 4) each [m]; what the poses do not determine stays near them.
        known: Whether the base is known, and whether the tool is.
    """
    start = np.linalg.inv(now[0]), now[1]
    kept = np.ones(len(robot), dtype=bool)
    for _ in range(_ROUNDS):
        inverse_base, tool = solve_poses(robot[kept], printed[kept], start, known, _PARALLEL)
        base = np.linalg.inv(inverse_base)
        misses = distances(base @ robot @ tool, printed)
        near = misses <= max(_FAR * float(np.median(misses)), _LEAST)
        if np.array_equal(near, kept) or 3 * np.sum(near) < 2 * len(near):
            break
        kept = near
    return Alignment(base, tool, misses, kept)


def turns_apart(robot: FloatArray, printed: FloatArray) -> float:
    """Return the misfit of rotations N_i to R_i, (n, 3, 3) each, by the best X and Y, over their spread: 0 for exact
    agreement, about 1 for unrelated rotations.
    """
    turned = max(1.0 - float(np.sum(np.mean(T, axis=0) ** 2)) / 3.0 for T in (robot, printed))
    missed = 1.0 - float(linalg.singular_values(rotation_form(robot, printed))[0]) / len(robot)
    return missed / max(turned, 1e-12)


def distances(poses: FloatArray, others: FloatArray) -> FloatArray:
    """Return misses of poses from others (n, 4, 4), from distance and rotation by `LEVER`, (n,) [m]."""
    away = np.sum((poses[:, :3, 3] - others[:, :3, 3]) ** 2, axis=1)
    turned = np.sum((poses[:, :3, :3] - others[:, :3, :3]) ** 2, axis=(1, 2)) / 2.0  # 4 sin^2 of half the angle
    return np.asarray(np.sqrt(away + LEVER**2 * turned))


def without_unseen(model: Robot) -> Robot:
    """Return the robot with as many parameters of places held as changes of them are not seen."""
    places = _free_places(model)
    held = eliminate(_seen_changes(model, places)).dropped
    return model.fix([model.parameters[places[k]].name for k in held])


def unseen_changes(model: Robot) -> list[str]:
    """Return the changes of free places that are not seen, in words: `tool.z +1 mm, base.z -1 mm`."""
    places, tool = _free_places(model), f"{model.target_names[0]}."
    parameters = [model.parameters[k] for k in places]
    of_tool = [k for k, p in enumerate(parameters) if p.name.startswith(tool)]
    for k in of_tool:
        parameters[k] = replace(parameters[k], name=parameters[k].name.replace(tool, "tool.", 1))
    groups = map(_without_small, null_groups(_seen_changes(model, places), of_tool))
    return [
        ", ".join(f"{name} {size:+.4g} {unit}" for name, size, unit in natural_coefficients(group, parameters))
        for group in groups
    ]


def _free_places(model: Robot) -> IntArray:
    """Indices of the free parameters of base and tool."""
    return np.flatnonzero(model.is_free & np.array([p.placement for p in model.parameters]))


def _seen_changes(model: Robot, places: IntArray) -> FloatArray:
    """Changes of places that are seen, orthonormal rows in sigmas, (k, n_places)."""
    origins = np.setdiff1d(np.flatnonzero(model.is_free), places)
    rows = linearise(model, model.assemble(other_poses(model)), turns=True).jacobian[:, 0]
    rows = rows * [p.sigma_si for p in model.parameters] / np.repeat([_SMALL, _SMALL / LEVER], 3)[:, None]
    rows = reduce_rows(rows.reshape(-1, rows.shape[-1]))
    by_origins = np.vstack([rows[:, origins], np.eye(len(origins))])
    by_places = np.vstack([rows[:, places], np.zeros((len(origins), len(places)))])
    left = by_places - by_origins @ linalg.lstsq(by_origins, by_places)
    _, values, directions = linalg.svd(left, full_matrices=False)
    return np.asarray(directions[values > 1.0 / _UNSEEN])


def _without_small(group: UnseenGroup) -> UnseenGroup:
    """The group without components that are rounding, or too small to matter."""
    large = np.abs(group.coefficients) > _NAMED * np.max(np.abs(group.coefficients))
    return UnseenGroup(tuple(np.array(group.members)[large].tolist()), group.coefficients[large])
