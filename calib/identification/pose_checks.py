"""Whether measurements can determine a robot at all, and if not, why."""

from __future__ import annotations

import numpy as np

from calib.data.measurements import Measurements
from calib.errors import DataError, NotIdentifiableError
from calib.identification.problem import Problem
from calib.model.mechanism import BoolArray, FloatArray
from calib.model.robot import Robot
from calib.numerics.identifiability import numerical_rank

_STILL = 1e-6  # range of a joint below which it never moved [m, rad]


def check_measurements(robot: Robot, data: Measurements, free: BoolArray) -> None:
    """Check numbers and their number before anything is computed.

    Raises:
        DataError: Values that are not finite, nothing to identify, or too few poses.
    """
    for name, values in (("joint values", data.joints), ("positions", data.positions), ("counts", data.counts)):
        bad = np.flatnonzero(~np.all(np.isfinite(values.reshape(len(data), -1)), axis=1))
        if len(bad):
            raise DataError(f"{data.labels[bad[0]]}: {name} are not finite; correct them, or leave the pose out")
    unknown = int(sum(use and not p.prior for p, use in zip(robot.parameters, free, strict=True)))
    if not np.any(free):
        raise DataError(f"{robot.path}: every parameter is held; there is nothing to identify")
    rows = data.positions.size
    if rows <= unknown or len(data) < 3:
        needed = max(3, -(-(unknown + 1) // (3 * len(robot.target_names))))
        raise DataError(
            f"{data.path}: {len(data)} {'pose gives' if len(data) == 1 else 'poses give'} {rows} coordinates for"
            f" {unknown} unknowns without a prior; measure at least {needed} poses (several times that for a useful"
            " result)"
        )


def unmoved_joints(robot: Robot, joints: FloatArray) -> list[str]:
    """Return the actuated joints that stay where they are in all poses (n_poses, n_actuated)."""
    return [name for name, reach in zip(robot.joint_names, np.ptp(joints, axis=0), strict=True) if reach < _STILL]


def require_identifiable(problem: Problem, scaled: FloatArray) -> None:
    """Raise unless data and priors together determine every free parameter.

    Args:
        problem: The problem.
        scaled: Scaled Jacobian of the free parameters, or its triangular factor, (n, n_free).

    Raises:
        NotIdentifiableError: The message names the parameters, and joints that never moved.
    """
    stacked = np.vstack([scaled, np.eye(len(problem.has_prior))[problem.has_prior]])
    rank = numerical_rank(stacked)
    if rank.rank == rank.n_columns:
        return
    names = [parameter.name for parameter, use in zip(problem.robot.parameters, problem.free, strict=True) if use]
    null = np.linalg.svd(stacked)[2][rank.rank :]
    involved = [name for name, size in zip(names, np.max(np.abs(null), axis=0), strict=True) if size > 1e-3]
    raise NotIdentifiableError(
        f"the poses determine {rank.rank} of {rank.n_columns} free parameters; not separable:"
        f" {', '.join(involved[:12])}{', ...' if len(involved) > 12 else ''}{_why(problem)};"
        f" hold {rank.n_columns - rank.rank} of them (`held`), or measure other poses"
    )


def _why(problem: Problem) -> str:
    still = unmoved_joints(problem.robot, problem.data.joints)
    if len(still) == len(problem.robot.joint_names):
        return " (all poses are the same)"
    if still:
        return f" ({'joint' if len(still) == 1 else 'joints'} {', '.join(still)} never moved)"
    return ""
