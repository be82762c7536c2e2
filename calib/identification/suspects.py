"""What may be wrong with data that nothing fits: each usual mistake is undone in turn, and the nominal robot compared.

Tried are: each joint counted the other way; the columns of two joints swapped; angles that are degrees read as radians
or radians read as degrees; positions that are a thousand times too large or too small; an axis of the measurement frame
mirrored; two of its axes swapped. Base and targets are placed by a rigid fit where they are not known. What brings the
nominal robot much closer to the data than they stand, and to within a part of what was measured, is named.

When it fails. Two mistakes at once are not found. A robot whose base pose is given wrong, and not called unknown, is
far off whatever is tried; the verdict looks for that first.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np

from calib.data.measurements import Measurements
from calib.errors import CalibrationError
from calib.linearisation.registration import register
from calib.model.mechanism import IntArray
from calib.model.robot import Robot
from calib.threads import one_blas_thread

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
    some = data.subset(np.unique(np.linspace(0, len(data) - 1, _POSES).astype(np.intp)))
    now = min(_miss(robot, some), 1.0)
    tried = [(_miss(robot, changed), words) for words, changed in _undone(robot, some)]
    best = max(min(miss for miss, _ in tried), 1e-6)
    if not best < min(_CLOSER * now, _NEAR):
        return ""
    likely = [words for miss, words in sorted(tried) if miss <= _AS_GOOD * best]
    closer = f"with that undone, the nominal robot comes {now / best:.0f} times closer"
    return f"it looks as if {', or '.join(likely[:3])}: {closer}"


def _miss(robot: Robot, data: Measurements) -> float:
    """Root mean square error of the nominal robot, placed where that is needed, over the spread of the positions."""
    if not np.all(robot.close(data.joints[:_FIRST]).ok):  # then the others need not be tried
        return float("inf")
    try:
        placed = register(robot, data) if any(p.placement for p in robot.parameters) else robot
        errors = placed.positions(data.joints) - data.positions
    except CalibrationError:  # a loop stays open, or nothing can be placed
        return float("inf")
    spread = np.sum((data.positions - data.positions.mean(axis=0)) ** 2)
    return float(np.sqrt(np.sum(errors**2) / spread)) if spread > 0 else float("inf")


def _undone(robot: Robot, data: Measurements) -> Iterator[tuple[str, Measurements]]:
    """Yield each mistake in words, and the measurements without it."""
    names, q, positions = robot.joint_names, data.joints, data.positions
    dimensions = [robot.mechanism.dimensions[name] for name in names]
    for j, name in enumerate(names):
        turned = np.where(np.arange(len(names)) == j, -1.0, 1.0)
        yield f"joint {name} counted the other way", replace(data, joints=q * turned)
    for a, b in combinations(range(len(names)), 2):
        if dimensions[a] == dimensions[b]:
            words = f"the columns of joints {names[a]} and {names[b]} were swapped"
            yield words, replace(data, joints=q[:, _swapped(len(names), a, b)])
    angles = np.array([dimension == "angle" for dimension in dimensions])
    if np.any(angles):
        yield "degrees were read as radians", replace(data, joints=np.where(angles, np.radians(q), q))
        yield "radians were read as degrees", replace(data, joints=np.where(angles, np.degrees(q), q))
    yield "positions in mm were read as m", replace(data, positions=1e-3 * positions)
    yield "positions in m were read as mm", replace(data, positions=1e3 * positions)
    mirror = np.array([1.0, 1.0, -1.0])
    if robot.description.base.pose == "unknown":  # all reflections of an unknown frame are one
        words = "the measurement frame were left-handed (an axis with the wrong sign, or two axes swapped)"
        yield words, replace(data, positions=positions * mirror)
        return
    for axis, name in enumerate("xyz"):
        flipped = positions * np.roll(mirror, axis + 1)
        yield f"{name} of the measured positions had the wrong sign", replace(data, positions=flipped)
    for a, b in combinations(range(3), 2):
        words = f"{'xyz'[a]} and {'xyz'[b]} of the measured positions were swapped"
        yield words, replace(data, positions=positions[..., _swapped(3, a, b)])


def _swapped(n: int, a: int, b: int) -> IntArray:
    order = np.arange(n)
    order[[a, b]] = b, a
    return order
