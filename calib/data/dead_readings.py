"""Readings that no instrument took: 0, 0, 0 to the last digit, and columns that were copied over others."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from calib.arrays import IntArray
from calib.data.measurements import Measurements
from calib.model.robot import Robot
from calib.observation.kind import Readings

_FEW = 3  # rows that may agree by chance


def zero_visits(data: Measurements, robot: Robot) -> IntArray:
    """Return the visits (n,) with a reading that begins with 0, 0, 0, as many programs write where they saw nothing.

    Args:
        data: The measurements.
        robot: Knows which of its instruments read numbers at all: a touch does not.
    """
    numbers = [found for name, found in data.readings.items() if robot.instrument(name).columns()]
    found = [one.visits[np.all(one.values[:, :3] == 0.0, axis=1)] for one in numbers if _has_three(one)]
    return np.unique(np.concatenate([np.zeros(0, dtype=np.intp), *found]))


def _has_three(one: Readings) -> bool:
    return one.values.shape[1] >= 3


def equal_columns(data: Measurements, robot: Robot) -> list[tuple[str, str]]:
    """Return pairs of measured columns that vary and yet are the same wherever both were read.

    Args:
        data: The measurements.
        robot: Knows the columns of its instruments.
    """
    columns = {}
    for name, found in data.readings.items():
        for column, numbers in robot.instrument(name).cells(found.values).items():
            whole = np.full(len(data), np.nan)
            whole[found.visits] = numbers
            columns[column] = whole
    varied = [name for name, numbers in columns.items() if len(np.unique(numbers[np.isfinite(numbers)])) > _FEW]
    return [(a, b) for a, b in combinations(varied, 2) if np.array_equal(columns[a], columns[b], equal_nan=True)]
