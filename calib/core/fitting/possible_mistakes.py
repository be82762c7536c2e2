"""Possible mistakes in measurements, each undone in some of them: those in joint values that any instrument shows.

They are joint values up to five rows above or below their measurements, mapped to a range such as -100 to 100, or in
another unit. `calib.core.fitting.likely_mistakes` and `calib.core.fitting.mistaken_readings` add others, and compare.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from calib.core.data.measurements import Measurements
from calib.core.fitting.column_maps import USUAL_FACTORS, ColumnMap
from calib.core.robots.robot import Robot

_POSES = 20  # poses that suffice to show a gross mistake
_SHIFTS = 5
_FEW = 3  # a shift must leave more rows
_RANGES = ((-100, 100), (0, 100), (-1, 1), (0, 1), (0, 1023), (0, 4095), (0, 65535))


@dataclass(frozen=True, eq=False)
class Trial:
    """A mistake that is undone.

    Attributes:
        words: The mistake.
        data: Some of the measurements without it.
        changes: Number of changes of joints; 0 for a single mistake.
        column_map: The map of columns that undoes it.
    """

    words: str
    data: Measurements
    changes: int = 0
    column_map: ColumnMap | None = None


def some_visits(data: Measurements) -> Measurements:
    """Return visits that suffice to show a gross mistake, evenly spread."""
    return data.subset(np.unique(np.linspace(0, len(data) - 1, _POSES).astype(np.intp)))


def joint_value_trials(robot: Robot, measured: Measurements) -> Iterator[Trial]:
    """Yield each mistake in all joint values, undone in some of the measurements."""
    yield from _shifted_trials(measured)
    yield from _rescaled_trials(robot, measured)
    data = some_visits(measured)
    for dimension, factors in USUAL_FACTORS.items():
        own = np.array([robot.mechanism.dimensions[name] == dimension for name in robot.joint_names])
        for factor, words in factors.items() if np.any(own) else ():
            yield Trial(f"joint values were {words}", replace(data, joints=np.where(own, factor, 1.0) * data.joints))


def _shifted_trials(measured: Measurements) -> Iterator[Trial]:
    """Joint values shifted to other rows, counted in the measured order; rows of the file may be missing here."""
    places = measured.places
    for rows, sign in product(range(1, _SHIFTS + 1), (1, -1)):
        _, of_joints, of_points = np.intersect1d(places + sign * rows, places, return_indices=True)
        if len(of_joints) > _FEW:
            joints = measured.joints[of_joints]
            side = f"{'one row' if rows == 1 else f'{rows} rows'} {'above' if sign > 0 else 'below'}"
            shifted = replace(measured.subset(of_points), joints=joints)
            yield Trial(f"all joint values are {side} their measurements", some_visits(shifted))


def _rescaled_trials(robot: Robot, measured: Measurements) -> Iterator[Trial]:
    """Joint values mapped back from ranges such as 0 to 1 to the joints' limits; the file may have meant any unit."""
    lower, upper = robot.urdf.limits(robot.joint_names)
    if not np.all(np.isfinite(upper - lower)):
        return
    angles = np.array([robot.mechanism.dimensions[name] == "angle" for name in robot.joint_names])
    si = measured.joints
    for numbers, (low, high) in product((np.where(angles, np.degrees(si), 1e3 * si), si), _RANGES):
        reach = high - low
        if np.all((numbers > low - 0.1 * reach) & (numbers < high + 0.1 * reach)):
            whole = replace(measured, joints=lower + (numbers - low) / reach * (upper - lower))
            words = f"all joint values were mapped from the joints' limits to the range {low} to {high}"
            yield Trial(words, some_visits(whole))
