"""Checks before a fit that measurements can determine a robot at all, in terms of the measurements.

They cover the numbers themselves, their count against the unknowns, positions on one line with an unknown base, the
rank of data and priors together (`calib.core.rows.determination`), and whether the values of joints that turn without
end count whole turns.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray
from calib.core.base.errors import DataError, NotIdentifiableError
from calib.core.base.words import joints_named, listing
from calib.core.data.measurements import Measurements
from calib.core.fitting.problem import Evaluation, Problem
from calib.core.numerics import linalg
from calib.core.numerics.graphs import connected_parts
from calib.core.robots.robot import Robot
from calib.core.robots.terms.term import Condition
from calib.core.rows.determination import Determination, determination
from calib.core.rows.unknowns import Unknowns

_STILL = 1e-6  # a joint never moved if its range is less [m, rad]
_TIED = 0.02  # joints are tied if their entry of the projector onto directions that no pose shows is larger
_ALONE = 1e-3  # least spread of poses along a direction of joint space, as part of the largest spread
_LINE = 1e-3  # positions lie on one line if width over length is less
_FILLED = 0.75  # values over more than this part of a turn are near both of its ends, and may be wrapped there
_ROUND = 1e-3  # beyond the ends of a turn, values that were rounded [rad]


def check_measurements(robot: Robot, data: Measurements) -> None:
    """Check the numbers of measurements, and how many there are, before anything is computed.

    Raises:
        DataError: Values that are not finite, nothing to identify, or too few poses.
    """
    bad = np.flatnonzero(~np.all(np.isfinite(data.joints), axis=1))
    if len(bad):
        raise DataError(f"{data.labels[bad[0]]}: joint values are not finite; correct them, or leave the pose out")
    for name, readings in data.readings.items():
        wrong = np.flatnonzero(np.any(np.isinf(readings.values), axis=1) | np.all(np.isnan(readings.values), axis=1))
        if len(wrong):
            raise DataError(
                f"{data.labels[readings.visits[wrong[0]]]}: readings of '{name}' are not finite; correct them, or"
                " leave the pose out"
            )
    for term in robot.terms:
        for condition in term.depends_on:
            k = first_unstated_visit(condition, data)
            if k is not None:
                raise DataError(
                    f"{data.labels[k]}: says no {condition.column}, which '{term.parameters[0].name}' depends on;"
                    " fill it in, or leave the row out"
                )
        missing = next((column for column in term.reads() if column not in data.context), None)
        if missing is not None:
            raise DataError(f"{data.path}: no column '{missing}', which '{term.parameters[0].name}' depends on")
    free = robot.is_free
    unknown = int(sum(use and not p.prior for p, use in zip(robot.parameters, free, strict=True)))
    if not np.any(free):
        raise DataError(f"{robot.path}: every parameter is held; there is nothing to identify")
    rows = sum(len(readings) * robot.instrument(name).n_rows for name, readings in data.readings.items())
    if rows <= unknown or len(data) < 3:
        per_visit = sum(robot.instrument(name).n_rows for name in data.readings)
        needed = max(3, -(-(unknown + 1) // max(per_visit, 1)))
        raise DataError(
            f"{data.path}: {len(data)} {'pose gives' if len(data) == 1 else 'poses give'} {rows} measured values for"
            f" {unknown} unknowns without a prior; measure at least {needed} poses (several times that for a useful"
            " result)"
        )
    places = zip(robot.parameters, free, strict=True)
    held = any(p.placement and p.dimension == "angle" and not use for p, use in places)
    if robot.description.base.pose == "unknown" and not held:
        _refuse_one_line(robot, data)


def first_unstated_visit(condition: Condition, data: Measurements) -> int | None:
    """Return the first visit without a condition that other visits state."""
    empty = np.flatnonzero(np.isnan(data.context.get(condition.column, np.zeros(0))))
    return int(empty[0]) if len(empty) else None


def _refuse_one_line(robot: Robot, data: Measurements) -> None:
    """Raise `DataError` where the positions of all targets lie on one line, which leaves the measurement frame open."""
    by_target = data.points(robot)
    points = by_target.reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=1)]
    turned = any(
        robot.instrument(name).orientations(readings.values[:1]) is not None for name, readings in data.readings.items()
    )
    if len(points) == 0 or turned:
        return
    spread = linalg.singular_values(points - points.mean(axis=0))
    same = len(unmoved_joints(robot, data.joints)) == len(robot.joint_names)
    if len(spread) > 1 and spread[1] > _LINE * spread[0] and not (same and len(robot.target_names) < 3):
        return
    raise DataError(
        f"{data.path}: {'all poses are the same' if same else 'all measured positions lie on one line'}. They do not"
        " determine the base, and the description calls its pose unknown. Measure positions that spread in at least two"
        " directions, or hold what stays open (`held`, such as base.rx for the turn about a line along x)"
    )


def unmoved_joints(robot: Robot, joints: FloatArray) -> list[str]:
    """Return the actuated joints with the same value at all poses (n_poses, n_actuated)."""
    return [name for name, reach in zip(robot.joint_names, np.ptp(joints, axis=0), strict=True) if reach < _STILL]


def tied_joints(robot: Robot, joints: FloatArray) -> list[tuple[tuple[str, ...], int]]:
    """Return groups of actuated joints that moved only together, and the number of directions of each group.

    The joints (each by its range) span fewer directions than there are joints. A joint is tied if it takes part in a
    direction that no pose shows; joints that share such directions are a group.

    Args:
        joints: Joints of all poses, (n_poses, n_actuated) [m, rad].
    """
    reach = np.ptp(joints, axis=0)
    moved = np.flatnonzero(reach >= _STILL)
    if len(moved) == 0:
        return []
    scaled = (joints[:, moved] - joints[:, moved].mean(axis=0)) / reach[moved]
    _, spread, directions = linalg.svd(scaled, full_matrices=len(scaled) < len(moved))
    unseen = directions[int(np.sum(spread > _ALONE * spread[0])) :]
    projector = np.abs(unseen.T @ unseen) > _TIED
    groups = [part for part in connected_parts(projector) if projector[part[0], part[0]]] if len(unseen) else []
    unseen_of = [round(float(np.sum(unseen[:, part] ** 2))) for part in groups]  # the trace of its projector
    return [
        (tuple(robot.joint_names[moved[k]] for k in part), len(part) - fewer)
        for part, fewer in zip(groups, unseen_of, strict=True)
    ]


def require_identifiable(problem: Problem, evaluation: Evaluation, *, alone: bool = False) -> Determination:
    """Return the determination, or raise an error if data and priors together leave a free parameter open.

    Args:
        alone: Whether to examine only the free parameters, without the held ones.

    Raises:
        NotIdentifiableError: The message names the parameters, and joints that never moved.
    """
    robot = problem.robot
    counts = robot.is_free if alone else np.ones(len(robot.parameters), dtype=bool)
    own = counts & np.array([not p.family for p in robot.parameters])  # families have priors
    parameters, free = [p for p, use in zip(robot.parameters, own, strict=True) if use], robot.is_free[own]
    determined = determination(_columns(problem, evaluation, own), parameters, free)
    if not np.any(determined.columns[:, free]):
        raise NotIdentifiableError(
            f"{problem.data.path}: no reading depends on any free parameter; measure something that moves with them"
        )
    if determined.missing == 0:
        return determined
    names = [p.name for p, use in zip(parameters, free, strict=True) if use]
    null = linalg.svd(determined.free_columns)[2][determined.together.rank :]
    involved = [name for name, size in zip(names, np.max(np.abs(null), axis=0), strict=True) if size > 1e-3]
    doubt = f"; {determined.together.doubt}" if determined.together.unclear else ""
    raise NotIdentifiableError(
        f"{problem.data.path}: {determined.words()}; not separable:"
        f" {', '.join(involved[:12])}{', ...' if len(involved) > 12 else ''}{_why(problem)};"
        f" hold {determined.missing} of them (`held`; `calib check` tells which), or measure other poses{doubt}"
    )


def _columns(problem: Problem, evaluation: Evaluation, chosen: BoolArray) -> FloatArray:
    """Return few rows J with the J^T J of the whitened derivative by chosen parameters (n_parameters,), not scaled."""
    unknowns = Unknowns.from_robot(problem.robot, chosen)
    return problem.compressed(evaluation, problem.whitening.start(), unknowns).jacobian / unknowns.scales


def _why(problem: Problem) -> str:
    still = unmoved_joints(problem.robot, problem.data.joints)
    if len(still) == len(problem.robot.joint_names):
        return " (all poses are the same)"
    if still:
        return f" ({joints_named(*still, shown=len(still))} never moved)"
    return ""


def uncounted_turns(robot: Robot, joints: FloatArray) -> list[str]:
    """Return the endless joints whose values (n_poses, n_actuated) fill one turn and stay within it.

    Such values may be wrapped: the number of whole turns is then unknown.
    """
    endless = {joint.name for joint in robot.urdf.joints if joint.type == "continuous"}
    turn, within = 2.0 * np.pi, np.zeros(joints.shape[1], dtype=bool)
    for least in (-np.pi, 0.0):
        within |= (joints.min(axis=0) > least - _ROUND) & (joints.max(axis=0) < least + turn + _ROUND)
    filled = within & (np.ptp(joints, axis=0) > _FILLED * turn)
    return [name for name, wrapped in zip(robot.joint_names, filled, strict=True) if wrapped and name in endless]


def may_be_wrapped(joints: Sequence[str], wrong: Sequence[str]) -> str:
    """Return the problem and its remedy, where values of `joints` may be wrapped and `wrong` terms count turns."""
    return (
        f"all values of {joints_named(*joints)} lie within one turn, and the URDF"
        f" states no limits. If these values were wrapped, {listing(wrong)} cannot be right. Give values that count"
        " turns; or give limits, if the joint turns no further; or use harmonics or a curve, which repeat with the"
        " turn"
    )


def wrapped_terms(robot: Robot, joints: FloatArray) -> tuple[str, ...]:
    """Return the problem with joint terms that count turns, where joint values (n_poses, n_actuated) may be wrapped."""
    uncounted = uncounted_turns(robot, joints)
    followed = [
        (term.driving_joint(robot.joint_names), term.parameters[0].name) for term in robot.terms if term.counts_turns
    ]
    wrong = {name: joint for joint, name in followed if joint in uncounted}
    return (may_be_wrapped(list(dict.fromkeys(wrong.values())), list(wrong)),) if wrong else ()
