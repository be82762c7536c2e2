"""What may be wrong with data that nothing fits: each usual mistake is undone in turn, and the nominal robot compared.

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

from calib.arrays import IntArray
from calib.data.dead_readings import equal_columns, zero_visits
from calib.data.measurements import Measurements, with_points
from calib.errors import CalibrationError
from calib.identification.joint_conventions import joint_changes
from calib.linearisation.registration import register
from calib.model.robot import Robot
from calib.threads import one_blas_thread
from calib.words import counted, listed

_CLOSER = 0.2  # miss of the nominal robot with the mistake undone, over that with the data as they are
_NEAR = 0.2  # the same over the spread of the measured positions
_AS_GOOD = 1.5  # miss over that of the best, up to which another mistake explains the data as well
_POSES = 20  # of many poses, so many are enough to see a gross mistake
_FIRST = 2


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
    empty = f"{counted(len(zeros), 'reading')} of exactly 0, 0, 0 ({listed([data.labels[k] for k in zeros])}) were none"
    tried = [(_miss(robot, some), 0, empty)] if len(zeros) else []
    prefix = f"{empty}, and " if len(zeros) else ""
    if not tried or tried[0][0] > _CLOSER * now:
        tried += [(_miss(robot, changed), joints, prefix + words) for joints, words, changed in _undone(robot, sound)]
    best = max(min(miss for miss, _, _ in tried), 1e-6)
    if not best < min(_CLOSER * now, _NEAR):
        return ""
    good = sorted(found for found in tried if found[0] <= _AS_GOOD * best)
    fewest = min((joints for _, joints, _ in good if joints), default=0)
    likely = [words for _, joints, words in good if joints in (0, fewest)]
    closer = f"with that undone, the nominal robot comes {now / best:.0f} times closer"
    return f"it looks as if {', or '.join(likely[:3])}: {closer}"


def _some(data: Measurements) -> Measurements:
    return data.subset(np.unique(np.linspace(0, len(data) - 1, _POSES).astype(np.intp)))


def _miss(robot: Robot, data: Measurements) -> float:
    """Root mean square error of the nominal robot, placed where that is needed, over the spread of the positions."""
    if not np.all(robot.close(data.joints[:_FIRST]).ok):  # then the others need not be tried
        return float("inf")
    try:
        placed = register(robot, data) if any(p.placement for p in robot.parameters) else robot
        points = data.points(robot)
        errors = placed.positions(data.joints) - points
    except CalibrationError:  # a loop stays open, or nothing can be placed
        return float("inf")
    spread = np.sum((points - points.mean(axis=0)) ** 2)
    return float(np.sqrt(np.sum(errors**2) / spread)) if spread > 0 else float("inf")


def _undone(robot: Robot, measured: Measurements) -> Iterator[tuple[int, str, Measurements]]:
    """Yield each mistake: of how many joints' signs and zeros, in words, and some of the measurements without it."""
    data = _some(measured)
    names, q, points = robot.joint_names, data.joints, data.points(robot)
    dimensions = [robot.mechanism.dimensions[name] for name in names]
    yield from joint_changes(robot, data)
    first, second = np.arange(len(measured) - 1), np.arange(1, len(measured))
    for joints, seen, where in ((first, second, "above"), (second, first, "below")):
        shifted = replace(measured.subset(seen), joints=measured.joints[joints])
        yield 0, f"all joint values stood one row {where} their measurements", _some(shifted)
    for a, b in combinations(range(len(names)), 2):
        if dimensions[a] == dimensions[b]:
            words = f"the columns of joints {names[a]} and {names[b]} were swapped"
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
