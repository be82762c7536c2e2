"""Base and tool that carry a robot's poses to printed poses: T_printed = X T_robot(q) Y.

This is the hand-eye problem X^-1 T_printed = T_robot Y (`calib.core.instruments.hand_eye`).

Rows with large misses are left out and the rest is aligned again, so that a row of another program does not spoil the
result.

When it fails. More than a third of the rows wrong.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray, ReadOnlyArrays
from calib.core.instruments.hand_eye import LEVER, rotation_form, solve_poses
from calib.core.numerics import linalg

_ROUNDS = 5
_FAR = 6.0  # a row is left out if it misses by more than this many times the median miss
_PARALLEL = 1e-3  # axes that lean less than this show no shift along them: robots differ more from their files [rad]
_LEAST = 1e-4  # miss that is never left out [m]


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
        inverse_base, tool = solve_poses(robot[kept], printed[kept], start, known)
        turned = printed[kept, :3, 3] @ inverse_base[:3, :3].T
        shifts = _shifts(robot[kept], turned, np.append(start[0][:3, 3], start[1][:3, 3]), known)
        inverse_base[:3, 3], tool[:3, 3] = shifts[:3], shifts[3:]
        base = np.linalg.inv(inverse_base)
        misses = distances(base @ robot @ tool, printed)
        near = misses <= max(_FAR * float(np.median(misses)), _LEAST)
        if np.array_equal(near, kept) or 3 * np.sum(near) < 2 * len(near):
            break
        kept = near
    return Alignment(base, tool, misses, kept)


def _shifts(robot: FloatArray, turned: FloatArray, now: FloatArray, known: tuple[bool, bool]) -> FloatArray:
    """Shifts of X^-1 and Y, (6,) [m], near `now` where axes are parallel but for errors of the robot.

    Args:
        robot: T_robot(q), (n, 4, 4) [m].
        turned: Printed positions, turned by X^-1, (n, 3) [m].
        now: Present shifts, (6,) [m].
        known: Whether those of X^-1 are known, and those of Y.
    """
    by = np.concatenate([np.tile(np.eye(3), (len(robot), 1, 1)), -robot[:, :3, :3]], axis=2).reshape(-1, 6)
    free, moved = np.repeat(np.logical_not(known), 3), now.copy()
    moved[free] += linalg.lstsq(by[:, free], (robot[:, :3, 3] - turned).reshape(-1) - by @ now, _PARALLEL)
    return moved


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
