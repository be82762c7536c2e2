"""What else the numbers of an instrument may mean, where no robot explains them: quaternions in another order, say.

Each meaning that a kind of measurement knows (`Instrument.other_meanings`) is tried on the nominal robot, with base and
targets placed by it. One that brings the readings much nearer than they stand is named.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.base.errors import CalibrationError
from calib.data.measurements import Measurements
from calib.robots.robot import Robot
from calib.rows.observed import observe
from calib.rows.registration import register

_CLOSER = 0.2  # error with another meaning over that with the present one
_POSES = 20  # of many poses, so many are enough
_FEWEST = 4


def other_meaning(robot: Robot, data: Measurements, name: str) -> str:
    """Return what the numbers of an instrument look like in place of what they were read as; empty if nothing else.

    Args:
        robot: The nominal robot.
        data: The measurements.
        name: The instrument.
    """
    some = data.subset(np.unique(np.linspace(0, len(data) - 1, _POSES).astype(np.intp)))
    readings = some.readings.get(name)
    if readings is None or len(readings) < _FEWEST or not np.isfinite(readings.values).all():
        return ""
    tried = []
    for words, values in robot.instrument(name).other_meanings(readings.values):
        changed = replace(some, readings={**some.readings, name: replace(readings, values=values)})
        tried.append((_error(robot, changed, name), words))
    best, words = min(tried, default=(np.inf, ""))
    now = _error(robot, some, name)
    if not best < _CLOSER * now:
        return ""
    return f"it looks as if {words}: with that undone, the nominal robot comes {now / max(best, 1e-9):.0f} times closer"


def _error(robot: Robot, data: Measurements, name: str) -> float:
    """Root mean square error of the rows whose numbers may mean something else, by the nominal robot [SI]."""
    one = robot.instrument(name)
    rows = [k for k, part in enumerate(one.part_of_row) if np.isfinite(one.parts[part].largest)]
    try:
        placed = register(robot, data)
        observed = observe(placed, placed.assemble(data.joints, context=data.conditions), data.readings)
    except CalibrationError:
        return float("inf")
    return float(np.sqrt(np.mean(observed[name].residuals[:, rows] ** 2)))
