"""Readings that stand in a file more than once.

A copy has the joint values and the readings of another visit, to the last digit. Honest repeats may have them, too,
where readings are written in coarse steps: with a step d and a scatter s of each reading, two are equal with a chance
of about d / (2 sqrt(pi) s). The step is the largest one that divides all readings; the scatter is that of repeats that
differ, and at least that of the best instruments and robots. Visits are copies where chance does not explain so many.

When it fails. Readings in steps as coarse as they scatter say nothing: copies of these are not seen.
"""

from __future__ import annotations

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray, IntArray
from calib.core.base.units import Dimension
from calib.core.data.measurements import Measurements
from calib.core.numerics.chances import UNLIKELY
from calib.core.robots.robot import Robot

_SCATTER: dict[Dimension | None, float] = {"length": 5e-6, "angle": 1e-5, "pixel": 0.02}
"""Scatter of the readings of the most repeatable robots [m, rad, px]."""
_DIGIT = 1e-3  # steps below this part of this scatter make no difference


def copied_visits(robot: Robot, data: Measurements) -> IntArray:
    """Return the visits that are copies of earlier ones, (n,); none where chance may have made them equal."""
    repeated = _same_joints(data.joints)
    first: dict[tuple[bytes, frozenset[bytes]], int] = {}
    copies, known, pairs = [], dict[bytes, int](), []
    for visit, keys in zip(repeated.tolist(), reading_keys(data, repeated), strict=True):
        joints = data.joints[visit].tobytes()
        if (joints, frozenset(keys)) in first:
            copies.append(visit)
        elif joints in known:
            pairs.append((known[joints], visit))
        first.setdefault((joints, frozenset(keys)), visit)
        known.setdefault(joints, visit)
    if not copies:
        return np.zeros(0, dtype=np.intp)
    chance = _chance_of_same(robot, data, pairs)
    sure = bool(scipy.special.bdtrc(len(copies) - 1, len(copies) + len(pairs), chance) < UNLIKELY)
    return np.array(copies if sure else [], dtype=np.intp)


def _chance_of_same(robot: Robot, data: Measurements, pairs: list[tuple[int, int]]) -> float:
    """Return the chance that a repeat has the same readings, from `pairs` of unlike repeats; 0 without numbers."""
    chances = []
    for name, readings in data.readings.items():
        instrument = robot.instrument(name)
        whole = np.full((len(data), readings.values.shape[1]), np.nan)
        whole[readings.visits] = readings.values
        for column, numbers in zip(instrument.columns(), whole.T, strict=False):
            least = _SCATTER.get(column.dimension, 0.0)
            if least == 0.0:
                continue
            apart = np.array([numbers[a] - numbers[b] for a, b in pairs])
            apart = apart[np.isfinite(apart)]
            scatter = max(least, float(np.sqrt(np.mean(apart**2) / 2)) if len(apart) else 0.0)
            step = _step(numbers, _DIGIT * least)
            chances.append(step / (2 * np.sqrt(np.pi) * scatter) if step < scatter else 1.0)
    return float(np.prod(chances)) if chances else 0.0


def _step(numbers: FloatArray, digit: float) -> float:
    """Return the largest step that divides all differences of numbers (n,), up to rounding to `digit`."""
    known = np.unique(numbers[np.isfinite(numbers)])
    return digit * float(np.gcd.reduce(np.round((known - known[:1]) / digit).astype(np.int64)))


def _same_joints(joints: FloatArray) -> IntArray:
    """Visits whose joint values (n_visits, n_actuated) may equal those of another, (n,)."""
    left = np.arange(len(joints))
    for column in joints.T:
        _, number, count = np.unique(column[left], return_inverse=True, return_counts=True)
        left = left[count[number] > 1]
        if len(left) == 0:
            break
    return left


def reading_keys(data: Measurements, visits: IntArray) -> list[set[bytes]]:
    """Return keys of the readings at some visits (n,), equal where the readings are equal to the last digit."""
    place = np.full(len(data), -1)
    place[visits] = np.arange(len(visits))
    keys: list[set[bytes]] = [set() for _ in range(len(visits))]
    for name, readings in data.readings.items():
        of_these = place[readings.visits] >= 0
        parts = (readings.visits, readings.values, readings.details)
        for visit, values, details in zip(*(part[of_these] for part in parts), strict=True):
            keys[place[visit]].add(name.encode() + values.tobytes() + details.tobytes())
    return keys
