"""Candidate poses: assembled, checked, turned into rows of information, a part at a time so that many fit in memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from calib.data.measurements import Measurements, Poses
from calib.errors import DataError, UnreachablePoseError
from calib.linearisation.information import scaled_rows
from calib.linearisation.jacobian import linearise
from calib.model.mechanism import BoolArray, FloatArray, IntArray
from calib.model.open_loops import why_open
from calib.model.robot import Configurations, Robot, near_singularity
from calib.read_only import ReadOnlyArrays

_PART = 8192
_SAME = 1e-9
"""Joint values that differ by less are the same pose [m, rad]."""
_MEASURED_AGAIN = 1e-4
"""A candidate within this of a measured pose is that pose [m, rad]."""
_SHOWN = 10


@dataclass(frozen=True, eq=False)
class Candidates:
    """Poses that may be measured.

    Attributes:
        joints: (n, n_actuated) [m or rad].
        positions: Targets at the robot's present values, (n, n_targets, 3) [m]; NaN where not usable.
        rows: Scaled Jacobian of the free parameters, (n, 3 n_targets, n_free) [m]; 0 where not usable.
        usable: Which can be assembled far enough from singularities, (n,).
        skipped: What to call each pose that is not usable, and why.
    """

    joints: FloatArray
    positions: FloatArray
    rows: FloatArray
    usable: BoolArray
    skipped: tuple[str, ...]


def build_candidates(robot: Robot, poses: Poses, *, skip_unreachable: bool = False) -> Candidates:
    """Assemble candidates and take their Jacobians.

    Args:
        robot: The robot, linearised at its present values.
        poses: The candidates.
        skip_unreachable: Leave poses out that cannot be assembled or are next to a singularity of the loops.

    Raises:
        DataError: A pose is given twice.
        UnreachablePoseError: There are such poses, and they are not to be skipped.
    """
    _require_different(poses)
    n, n_free = len(poses), int(np.sum(robot.free))
    n_targets = len(robot.target_names)
    positions, rows = np.full((n, n_targets, 3), np.nan), np.zeros((n, 3 * n_targets, n_free))
    usable, reasons = np.zeros(n, dtype=bool), list[str]()
    for start in range(0, n, _PART):
        part = slice(start, min(start + _PART, n))
        q = poses.joints[part]
        closed = robot.close(q)
        good = np.flatnonzero(closed.ok)
        distance = np.zeros(len(q))
        distance[good] = robot.singular_values(Configurations(q[good], closed.passive[good], closed.slope[good]))
        good = np.flatnonzero(distance >= robot.description.singularity_limit)
        linear = linearise(robot, Configurations(q[good], closed.passive[good], closed.slope[good]))
        positions[start + good] = linear.positions
        rows[start + good] = scaled_rows(linear.jacobian, robot.parameters, robot.free)
        usable[start + good] = True
        if len(good) < len(q):
            reasons += _reasons(robot, q, closed.ok, distance, poses.labels[part], len(reasons))
    if reasons and not skip_unreachable:
        raise UnreachablePoseError(_listed(reasons) + "; remove these poses, or leave them out with --skip-unreachable")
    if isinstance(poses, Measurements):  # a mean of several readings says more than one reading
        rows *= np.sqrt(poses.counts)[:, None, None]
    return Candidates(poses.joints, positions, rows, usable, tuple(reasons))


@dataclass(frozen=True, eq=False)
class KnownPoses(ReadOnlyArrays):
    """Poses that are not for choosing: measured already, or those whose accuracy counts.

    Attributes:
        joints: (n, n_actuated) [m or rad].
        positions: Targets at the robot's present values, (n, n_targets, 3) [m].
        rows: Scaled Jacobian of the free parameters, (n, 3 n_targets, n_free) [m].
        counts: Readings averaged at each pose, (n,).
    """

    joints: FloatArray
    positions: FloatArray
    rows: FloatArray
    counts: IntArray

    def weighted(self) -> FloatArray:
        """Return all rows, weighted so that each has the noise of one reading, (3 n n_targets, n_free) [m]."""
        rows = self.rows * np.sqrt(self.counts)[:, None, None]
        result: FloatArray = rows.reshape(-1, self.rows.shape[2])
        return result


def assemble_known(robot: Robot, poses: Poses) -> KnownPoses:
    """Assemble poses and take their Jacobians.

    Raises:
        UnreachablePoseError: A pose cannot be assembled.
    """
    linear = linearise(robot, robot.assemble(poses.joints, labels=poses.labels))
    counts = poses.counts if isinstance(poses, Measurements) else np.ones(len(poses), dtype=np.intp)
    rows = scaled_rows(linear.jacobian, robot.parameters, robot.free)
    return KnownPoses(poses.joints, linear.positions, rows, counts)


def near_measured(candidates: FloatArray, measured: FloatArray) -> BoolArray:
    """Return which candidates (n, n_actuated) are poses that were measured already, (n,)."""
    gaps, _ = cKDTree(measured).query(candidates, p=np.inf)
    result: BoolArray = gaps < _MEASURED_AGAIN
    return result


def _require_different(poses: Poses) -> None:
    rounded = np.round(poses.joints / _SAME).astype(np.int64)
    _, first, inverse = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
    again = np.flatnonzero(first[inverse.ravel()] != np.arange(len(poses)))
    if len(again):
        k = int(again[0])
        more = f" (and {len(again) - 1} more)" if len(again) > 1 else ""
        raise DataError(
            f"{poses.labels[k]}{more}: the same joint values as {poses.labels[first[inverse.ravel()[k]]]};"
            " each candidate can be chosen once, so give it once"
        )


def _reasons(
    robot: Robot, q: FloatArray, ok: BoolArray, distance: FloatArray, labels: Sequence[str], already: int
) -> list[str]:
    limit = robot.description.singularity_limit
    found: list[str] = []
    for k in (int(number) for number in np.flatnonzero(distance < limit)):
        if ok[k]:
            found.append(near_singularity(labels[k], distance[k], limit))
            continue
        shown = already + len(found) < _SHOWN  # a search each: not for thousands
        why = f" ({why_open(robot.mechanism, robot.mode, q[k])})" if shown else ""
        found.append(f"{labels[k]}: cannot be assembled{why}")
    return found


def _listed(reasons: Sequence[str]) -> str:
    more = f"; and {len(reasons) - _SHOWN} more" if len(reasons) > _SHOWN else ""
    return "; ".join(reasons[:_SHOWN]) + more
