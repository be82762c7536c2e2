"""Whether measurements can determine a robot at all, and what may be wrong with those that nothing fits.

Each usual mistake is undone in turn, and the nominal robot compared.

Tried are: joints counted the other way, or from a zero that is a quarter or half of a turn off, several at once; the
columns of two joints swapped; joint values one row above or below their measurements; angles that are degrees read as
radians or radians read as degrees; positions that are a thousand times too large or too small; an axis of the
measurement frame mirrored; two of its axes swapped. Readings of exactly 0, 0, 0 are left out before, and named with the
rest. Base and targets are placed by a rigid fit where they are not known. What brings the nominal robot much closer to
the data than they stand, and to within a part of what was measured, is named. Columns that are copies of each other are
named without a trial.

When it fails. Mistakes of two kinds at once are not found. A robot whose base pose is given wrong, and not called
unknown, is far off whatever is tried; the verdict looks for that first. Only instruments that measure points are
looked at.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np

from calib.base.arrays import BoolArray, FloatArray, IntArray
from calib.base.errors import CalibrationError, DataError, NotIdentifiableError
from calib.base.threads import one_blas_thread
from calib.base.words import counted, joints_named, listed
from calib.data.measurements import Measurements, with_points
from calib.fitting.joint_conventions import joint_changes
from calib.fitting.problem import Evaluation, Problem
from calib.joint_terms.term import COLUMNS, Condition
from calib.robots.configurations import close
from calib.robots.robot import Robot
from calib.rows.determination import Determination, determination
from calib.rows.registration import register
from calib.rows.unknowns import Unknowns

_STILL = 1e-6  # range of a joint below which it never moved [m, rad]
_ALONE = 1e-3  # part of the widest spread of poses in joint space that a direction must have to count
_LINE = 1e-3  # width over length below which positions lie on one line
_CLOSER = 0.2  # miss of the nominal robot with the mistake undone, over that with the data as they are
_NEAR = 0.2  # the same over the spread of the measured positions
_AS_GOOD = 1.5  # miss over that of the best, up to which another mistake explains the data as well
_POSES = 20  # of many poses, so many are enough to see a gross mistake
_FIRST = 2
_FEW = 3  # rows that may agree by chance


def keeps_limits(data: Measurements, final: Evaluation) -> bool:
    """Return whether passive joints keep their limits at the end of a fit, which may pass them on its way.

    Args:
        data: The measurements.
        final: The end.
    """
    configurations = final.configurations
    closed = close(final.robot, data.joints, configurations.passive, configurations.term_columns)
    return bool(np.all(closed.ok))


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
    for name, readings in data.readings.items():
        wrong = np.flatnonzero(np.any(np.isinf(readings.values), axis=1) | np.all(np.isnan(readings.values), axis=1))
        if len(wrong):
            raise DataError(
                f"{data.labels[readings.visits[wrong[0]]]}: readings of '{name}' are not finite; correct them, or"
                " leave the pose out"
            )
    for term in robot.terms:
        for condition in term.depends_on:
            k = unstated(condition, data)
            if k is not None:
                raise DataError(
                    f"{data.labels[k]}: says no {COLUMNS[condition]}, which '{term.parameters[0].name}' depends on;"
                    " fill it in, or leave the row out"
                )
    unknown = int(sum(use and not p.prior for p, use in zip(robot.parameters, robot.is_free, strict=True)))
    if not np.any(robot.is_free):
        raise DataError(f"{robot.path}: every parameter is held; there is nothing to identify")
    rows = sum(len(readings) * robot.instrument(name).n_rows for name, readings in data.readings.items())
    if rows <= unknown or len(data) < 3:
        per_visit = sum(robot.instrument(name).n_rows for name in data.readings)
        needed = max(3, -(-(unknown + 1) // max(per_visit, 1)))
        raise DataError(
            f"{data.path}: {len(data)} {'pose gives' if len(data) == 1 else 'poses give'} {rows} coordinates for"
            f" {unknown} unknowns without a prior; measure at least {needed} poses (several times that for a useful"
            " result)"
        )
    held = any(
        p.placement and p.dimension == "angle" and not use
        for p, use in zip(robot.parameters, robot.is_free, strict=True)
    )
    if robot.description.base.pose == "unknown" and not held:
        _refuse_one_line(robot, data)


def unstated(condition: Condition, data: Measurements) -> int | None:
    """Return the first visit of which a condition is not known, where others state it."""
    empty = np.flatnonzero(np.isnan(data.context.get(COLUMNS.get(condition, ""), np.zeros(0))))
    return int(empty[0]) if len(empty) else None


def _refuse_one_line(robot: Robot, data: Measurements) -> None:
    """Raise `DataError` where the positions of all targets lie on one line: they leave the measurement frame open."""
    by_target = data.points(robot)
    points = by_target.reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=1)]
    turned = any(
        robot.instrument(name).orientations(readings.values[:1]) is not None for name, readings in data.readings.items()
    )
    if len(points) == 0 or turned:
        return
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    same = len(unmoved_joints(robot, data.joints)) == len(robot.joint_names)
    if len(spread) > 1 and spread[1] > _LINE * spread[0] and not (same and len(robot.target_names) < 3):
        return
    raise DataError(
        f"{data.path}: {'all poses are the same' if same else 'all measured positions lie on one line'}, which does not"
        " determine the base, whose pose the description calls unknown: measure positions that spread in at least two"
        " directions, or hold what these leave open (`held`, such as base.rx for the turn about a line along x)"
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
    own = [k for k, p in enumerate(robot.parameters) if not p.family]  # families have priors
    parameters, free = [robot.parameters[k] for k in own], robot.is_free[own]
    determined = determination(_columns(problem, evaluation, np.array(own, dtype=np.intp)), parameters, free)
    if determined.free.rank == 0:
        raise NotIdentifiableError(
            f"{problem.data.path}: no reading depends on any free parameter; measure something that moves with them"
        )
    if determined.missing == 0:
        return determined
    names = [p.name for p, use in zip(parameters, free, strict=True) if use]
    null = np.linalg.svd(determined.open_columns)[2][determined.together.rank :]
    involved = [name for name, size in zip(names, np.max(np.abs(null), axis=0), strict=True) if size > 1e-3]
    doubt = f"; {determined.together.doubt}" if determined.together.unclear else ""
    raise NotIdentifiableError(
        f"{problem.data.path}: {determined.words()}; not separable:"
        f" {', '.join(involved[:12])}{', ...' if len(involved) > 12 else ''}{_why(problem)};"
        f" hold {determined.missing} of them (`held`; `calib check` tells which), or measure other poses{doubt}"
    )


def _columns(problem: Problem, evaluation: Evaluation, index: IntArray) -> FloatArray:
    """Return the whitened derivative by parameters (n,), not scaled; of very many rows a few that are worth as much."""
    whitening, groups = problem.whitening, problem.whitening.start()
    if len(evaluation.batches) > 1:
        unknowns = Unknowns.of(problem.robot, np.isin(np.arange(len(problem.robot.parameters)), index))
        return problem.condensed(evaluation, groups, unknowns)[0][:, :-1] / unknowns.scales
    (_, observed), *_ = evaluation.observed(index)
    columns = whitening.flatten({name: block.by(index) for name, block in observed.items()}, in_place=True)
    return columns / whitening.row_scale(groups)[:, None]


def _why(problem: Problem) -> str:
    still = unmoved_joints(problem.robot, problem.data.joints)
    if len(still) == len(problem.robot.joint_names):
        return " (all poses are the same)"
    if still:
        return f" ({joints_named(*still, shown=len(still))} never moved)"
    return ""


@one_blas_thread
def likely_mistake(robot: Robot, data: Measurements) -> str:
    """Return the mistake that explains the measurements in words; empty where none does.

    Args:
        robot: The nominal robot.
        data: Measurements that do not fit it.
    """
    copied = equal_columns(data, robot)
    if copied:
        return f"it looks as if column {copied[0][1]} were a copy of {copied[0][0]}: they are equal in every row"
    data = data.subset(np.flatnonzero(np.isfinite(data.points(robot)).all(axis=(1, 2))))
    zeros = zero_visits(data, robot)
    sound = data.subset(np.setdiff1d(np.arange(len(data)), zeros))
    if len(sound) < _FIRST:
        return ""
    some = _some(sound)
    now = min(_miss(robot, _some(data) if len(zeros) == 0 else data), 1.0)
    where = listed([data.labels[k] for k in zeros])
    empty = f"{counted(len(zeros), 'reading')} of exactly 0, 0, 0 ({where}) were empty"
    tried = [(_miss(robot, some), 0, empty)] if len(zeros) else []
    prefix = f"{empty}, and " if len(zeros) else ""
    if not tried or tried[0][0] > _CLOSER * now:
        undone = list(_undone(robot, sound))
        misses = _misses(robot, [changed for _, _, changed in undone], _AS_GOOD * min(_CLOSER * now, _NEAR))
        tried += [(miss, joints, prefix + words) for miss, (joints, words, _) in zip(misses, undone, strict=True)]
    best = max(min(miss for miss, _, _ in tried), 1e-6)
    if not best < min(_CLOSER * now, _NEAR):
        return ""
    good = sorted(trial for trial in tried if trial[0] <= _AS_GOOD * best)
    fewest = min((joints for _, joints, _ in good if joints), default=0)
    likely = [words for _, joints, words in good if joints in (0, fewest)]
    closer = f"if this is corrected, errors of the nominal robot are {now / best:.0f} times smaller"
    return f"it looks as if {', or '.join(likely[:3])}: {closer}"


def _some(data: Measurements) -> Measurements:
    return data.subset(np.unique(np.linspace(0, len(data) - 1, _POSES).astype(np.intp)))


def _miss(robot: Robot, data: Measurements) -> float:
    return _misses(robot, [data])[0]


def _misses(robot: Robot, changed: list[Measurements], most: float = np.inf) -> list[float]:
    """Root mean square errors of the nominal robot over the spread of the positions; all loops are closed at once.

    Where they are larger than `most`, they may be a little too small, but not smaller than that.
    """
    closed = robot.close(np.vstack([data.joints for data in changed]), thorough=False)
    starts = np.cumsum([len(data) for data in changed])[:-1]
    each = zip(changed, np.split(closed.ok, starts), np.split(closed.passive, starts), strict=True)
    return [_miss_of(robot, data, ok, passive, most) for data, ok, passive in each]


def _miss_of(robot: Robot, data: Measurements, ok: BoolArray, passive: FloatArray, most: float) -> float:
    """Error of the robot, placed where that is needed, by which of its poses close, and how."""
    if 2 * np.sum(ok) < len(data):  # no need to look for ways to the others
        return float("inf")
    points = data.points(robot)
    spread = np.sum((points - points.mean(axis=0)) ** 2)
    # setups are placed one after the other: the error of one of them says nothing about all
    rough_beyond = np.inf if robot.description.setups else most * np.sqrt(3 * spread / points.size)
    try:
        placed = robot
        if any(p.placement for p in robot.parameters):
            placed = register(robot, data, rough_beyond=rough_beyond)
        errors = placed.positions(data.joints, seed=passive) - points
    except CalibrationError:  # a loop stays open, or nothing can be placed
        return float("inf")
    return float(np.sqrt(np.sum(errors**2) / spread)) if spread > 0 else float("inf")


def _undone(robot: Robot, measured: Measurements) -> Iterator[tuple[int, str, Measurements]]:
    """Yield each mistake: of how many joints' signs and zeros, in words, and some of the measurements without it."""
    data = _some(measured)
    names, q, points = robot.joint_names, data.joints, data.points(robot)
    dimensions = [robot.mechanism.dimensions[name] for name in names]
    yield from joint_changes(robot, data)
    first, second = np.arange(len(measured) - 1), np.arange(1, len(measured))
    for joints, measured_rows, side in ((first, second, "above"), (second, first, "below")):
        shifted = replace(measured.subset(measured_rows), joints=measured.joints[joints])
        yield 0, f"all joint values stood one row {side} their measurements", _some(shifted)
    for a, b in combinations(range(len(names)), 2):
        if dimensions[a] == dimensions[b]:
            words = f"the columns of {joints_named(names[a], names[b], separator=' and ')} were swapped"
            yield 0, words, replace(data, joints=q[:, _swapped(len(names), a, b)])
    angles = np.array([dimension == "angle" for dimension in dimensions])
    if np.any(angles):
        yield 0, "degrees were read as radians", replace(data, joints=np.where(angles, np.radians(q), q))
        yield 0, "radians were read as degrees", replace(data, joints=np.where(angles, np.degrees(q), q))
    yield 0, "positions in mm were read as m", with_points(robot, data, 1e-3 * points)
    yield 0, "positions in m were read as mm", with_points(robot, data, 1e3 * points)
    mirror = np.array([1.0, 1.0, -1.0])
    if robot.description.base.pose == "unknown":  # all reflections of an unknown frame are one
        words = "the measurement frame were left-handed (an axis with the wrong sign, or two axes swapped)"
        yield 0, words, with_points(robot, data, points * mirror)
        return
    for axis, name in enumerate("xyz"):
        flipped = points * np.roll(mirror, axis + 1)
        yield 0, f"{name} of the measured positions had the wrong sign", with_points(robot, data, flipped)
    for a, b in combinations(range(3), 2):
        words = f"{'xyz'[a]} and {'xyz'[b]} of the measured positions were swapped"
        yield 0, words, with_points(robot, data, points[..., _swapped(3, a, b)])


def _swapped(n: int, a: int, b: int) -> IntArray:
    order = np.arange(n)
    order[[a, b]] = b, a
    return order


def zero_visits(data: Measurements, robot: Robot) -> IntArray:
    """Return the visits (n,) with a reading that begins with 0, 0, 0, as many programs write where they saw nothing.

    Args:
        data: The measurements.
        robot: Knows which of its instruments read numbers at all: a touch does not.
    """
    numbers = [readings for name, readings in data.readings.items() if robot.instrument(name).columns()]
    three = [readings for readings in numbers if readings.values.shape[1] >= 3]
    visits = [readings.visits[np.all(readings.values[:, :3] == 0.0, axis=1)] for readings in three]
    return np.unique(np.concatenate([np.zeros(0, dtype=np.intp), *visits]))


def zeros_in_words(data: Measurements, robot: Robot) -> str:
    """Return what to do about readings of 0, 0, 0 (`zero_visits`); empty if there are none."""
    zeros = zero_visits(data, robot)
    if len(zeros) == 0:
        return ""
    return (
        f"{counted(len(zeros), 'pose was', 'poses were')} read at exactly 0, 0, 0, which some programs write when they"
        f" see nothing: {listed([data.labels[k] for k in zeros])}; leave {'it' if len(zeros) == 1 else 'them'} out"
    )


def equal_columns(data: Measurements, robot: Robot) -> list[tuple[str, str]]:
    """Return pairs of measured columns that vary and yet are the same wherever both were read.

    Args:
        data: The measurements.
        robot: Knows the columns of its instruments.
    """
    columns = {}
    for name, readings in data.readings.items():
        for column, numbers in robot.instrument(name).cells(readings.values).items():
            whole = np.full(len(data), np.nan)
            whole[readings.visits] = numbers
            columns[column] = whole
    varied = [name for name, numbers in columns.items() if len(np.unique(numbers[np.isfinite(numbers)])) > _FEW]
    return [(a, b) for a, b in combinations(varied, 2) if np.array_equal(columns[a], columns[b], equal_nan=True)]
