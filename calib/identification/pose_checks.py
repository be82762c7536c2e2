"""Whether measurements can determine a robot at all, and if not, why."""

from __future__ import annotations

import numpy as np

from calib.arrays import FloatArray
from calib.data.measurements import Measurements
from calib.errors import DataError, NotIdentifiableError
from calib.identification.problem import Evaluation, Problem
from calib.linearisation.determination import Determination, determination
from calib.model.robot import Robot

_STILL = 1e-6  # range of a joint below which it never moved [m, rad]
_ALONE = 1e-3  # part of the widest spread of poses in joint space that a direction must have to count
_LINE = 1e-3  # width over length below which positions lie on one line


def check_measurements(robot: Robot, data: Measurements) -> None:
    """Check numbers and their number before anything is computed.

    Args:
        robot: The robot.
        data: Its measurements.

    Raises:
        DataError: Values that are not finite, nothing to identify, or too few poses.
    """
    bad = np.flatnonzero(~np.all(np.isfinite(data.joints), axis=1))
    if len(bad):
        raise DataError(f"{data.labels[bad[0]]}: joint values are not finite; correct them, or leave the pose out")
    for name, found in data.readings.items():
        wrong = np.flatnonzero(np.any(np.isinf(found.values), axis=1) | np.all(np.isnan(found.values), axis=1))
        if len(wrong):
            raise DataError(
                f"{data.labels[found.visits[wrong[0]]]}: readings of '{name}' are not finite; correct them, or"
                " leave the pose out"
            )
    unknown = int(sum(use and not p.prior for p, use in zip(robot.parameters, robot.free, strict=True)))
    if not np.any(robot.free):
        raise DataError(f"{robot.path}: every parameter is held; there is nothing to identify")
    rows = sum(len(found) * robot.instrument(name).n_rows for name, found in data.readings.items())
    if rows <= unknown or len(data) < 3:
        per_visit = sum(robot.instrument(name).n_rows for name in data.readings)
        needed = max(3, -(-(unknown + 1) // max(per_visit, 1)))
        raise DataError(
            f"{data.path}: {len(data)} {'pose gives' if len(data) == 1 else 'poses give'} {rows} coordinates for"
            f" {unknown} unknowns without a prior; measure at least {needed} poses (several times that for a useful"
            " result)"
        )
    held = any(
        p.placement and p.dimension == "angle" and not use for p, use in zip(robot.parameters, robot.free, strict=True)
    )
    if robot.description.base.pose == "unknown" and not held:
        _refuse_one_line(robot, data)


def _refuse_one_line(robot: Robot, data: Measurements) -> None:
    """Raise `DataError` where the positions of all targets lie on one line: they leave the measurement frame open."""
    every = data.points(robot)
    points = every.reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=1)]
    turned = any(
        robot.instrument(name).orientations(found.values[:1]) is not None for name, found in data.readings.items()
    )
    if len(points) == 0 or turned:
        return
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    same = len(unmoved_joints(robot, data.joints)) == len(robot.joint_names)
    if len(spread) > 1 and spread[1] > _LINE * spread[0] and not (same and len(robot.target_names) < 3):
        return
    raise DataError(
        f"{data.path}: {'all poses are the same' if same else 'all measured positions lie on one line'}; where the"
        " measurement frame is, which the description calls unknown, needs positions that spread in at least two"
        " directions: measure other poses, or hold what they leave open (`held`, such as base.rx for the turn about a"
        " line along x)"
    )


def unmoved_joints(robot: Robot, joints: FloatArray) -> list[str]:
    """Return the actuated joints that stay where they are in all poses (n_poses, n_actuated)."""
    return [name for name, reach in zip(robot.joint_names, np.ptp(joints, axis=0), strict=True) if reach < _STILL]


def directions_moved(joints: FloatArray) -> int:
    """Return along how many directions of joint space (each joint by its range) the poses (n_poses, n_actuated) lie."""
    reach = np.ptp(joints, axis=0)
    moved = joints[:, reach >= _STILL]
    if moved.shape[1] == 0:
        return 0
    spread = np.linalg.svd((moved - moved.mean(axis=0)) / np.ptp(moved, axis=0), compute_uv=False)
    return int(np.sum(spread > _ALONE * spread[0]))


def require_identifiable(problem: Problem, evaluation: Evaluation) -> Determination:
    """Return what the data determine; raise unless data and priors together determine every free parameter.

    Args:
        problem: The problem.
        evaluation: Where it is looked at.

    Raises:
        NotIdentifiableError: The message names the parameters, and joints that never moved.
    """
    robot = problem.robot
    columns = problem.whitening.flatten({name: one.jacobian for name, one in evaluation.observed.items()})
    columns = columns / problem.whitening.row_scale(problem.whitening.start())[:, None]
    own = [k for k, p in enumerate(robot.parameters) if not p.family]  # families have priors
    parameters, free = [robot.parameters[k] for k in own], robot.free[own]
    found = determination(columns[:, own], parameters, free)
    if found.missing == 0:
        return found
    names = [p.name for p, use in zip(parameters, free, strict=True) if use]
    null = np.linalg.svd(found.open_columns)[2][found.together.rank :]
    involved = [name for name, size in zip(names, np.max(np.abs(null), axis=0), strict=True) if size > 1e-3]
    raise NotIdentifiableError(
        f"{problem.data.path}: {found.words()}; not separable:"
        f" {', '.join(involved[:12])}{', ...' if len(involved) > 12 else ''}{_why(problem)};"
        f" hold {found.missing} of them (`held`; `calib check` tells which), or measure other poses"
    )


def _why(problem: Problem) -> str:
    still = unmoved_joints(problem.robot, problem.data.joints)
    if len(still) == len(problem.robot.joint_names):
        return " (all poses are the same)"
    if still:
        return f" ({'joint' if len(still) == 1 else 'joints'} {', '.join(still)} never moved)"
    return ""
