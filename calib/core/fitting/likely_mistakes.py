"""What may be wrong with measurements that nothing fits.

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

from calib.core.base.arrays import BoolArray, FloatArray, IntArray
from calib.core.base.errors import CalibrationError
from calib.core.base.threads import one_blas_thread
from calib.core.base.words import counted, joints_named, listed
from calib.core.data.measurements import Measurements, with_points
from calib.core.fitting.joint_conventions import joint_changes
from calib.core.robots.robot import Robot
from calib.core.rows.registration import register

_CLOSER = 0.2  # miss of the nominal robot with the mistake undone, over that with the data as they are
_NEAR = 0.2  # the same over the spread of the measured positions
_AS_GOOD = 1.5  # miss over that of the best, up to which another mistake explains the data as well
_POSES = 20  # of many poses, so many are enough to see a gross mistake
_FIRST = 2
_FEW = 3  # rows that may agree by chance


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
