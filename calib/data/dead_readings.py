"""Readings that no instrument took: 0, 0, 0 to the last digit, and columns that were copied over others."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from calib.data.measurements import Measurements
from calib.model.mechanism import IntArray

_FEW = 3  # rows that may agree by chance


def zero_poses(data: Measurements) -> IntArray:
    """Return the poses with a target at exactly 0, 0, 0, as many programs write where they saw nothing, (n,)."""
    readings = data.readings or tuple(data.positions[:, None])
    return np.flatnonzero([bool(np.any(np.all(reading == 0.0, axis=-1))) for reading in readings])


def equal_columns(data: Measurements, target_names: tuple[str, ...]) -> list[tuple[str, str]]:
    """Return pairs of measured columns that vary and yet are the same in every row.

    Args:
        data: The measurements.
        target_names: Names of their targets.
    """
    columns = data.positions.reshape(len(data), -1)
    names = [f"{target}_{axis}" for target in target_names for axis in "xyz"]
    varied = [k for k in range(len(names)) if len(np.unique(columns[:, k])) > _FEW]
    return [(names[a], names[b]) for a, b in combinations(varied, 2) if np.array_equal(columns[:, a], columns[:, b])]
