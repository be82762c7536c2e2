"""Comparison of a robot with its fleet: the fleet's prior is dropped where the readings contradict it.

A robot that was repaired, that fell, or that is of another make would be pulled towards the others, and its noise would
seem larger, which hides the difference. So it is first fitted without the fleet. The information of its readings is
compared with the fleet's prior, as results of a fleet are compared with each other (`calib.fleets.hierarchy`). One by
one, the least likely parameter loses the fleet's prior and keeps the description's, until the others are likely. If
more than a quarter of the parameters would lose it, all do.

If there are too few readings for a fit without the fleet, the fit gets the fleet's prior, made several times as wide.
The information of a prior is always removed before the comparison.

When it fails. If neither fit succeeds (too few readings for unstated noise), nothing is compared. Poses that do not
determine a parameter cannot contradict its prior.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np

from calib.core.base.errors import CalibrationError
from calib.core.data.measurements import Measurements
from calib.core.fitting.fit import fit_data
from calib.core.fitting.fitted import Fit
from calib.core.fitting.settings import Settings
from calib.core.numerics.chances import FALSE_ALARM
from calib.core.robots.fleet_prior import FleetSection
from calib.core.robots.robot import Robot
from calib.fleets.hierarchy import compare_with_fleet
from calib.fleets.shared_parameters import evidence_of_fit, expectation_of_fleet, shared_parameters, without_fleet

_WIDE = 5.0  # factor that widens a prior, so that it decides little
_MOST = 0.25  # largest part of unlike parameters; with more, the whole robot is unlike
_EXTRA = 3.0  # degrees of freedom of a parameter's spread from others of its kind; each robot adds one


def without_contradicted_fleet(robot: Robot, data: Measurements, settings: Settings, fleet: FleetSection) -> Robot:
    """Return the robot without the parts of its fleet's prior that the readings contradict.

    Args:
        robot: The nominal robot.
        data: Its measurements.
        settings: Options of the fit.
        fleet: The fleet's section of the robot's description.
    """
    alone = _fit_nearly_without_fleet(robot, fleet, data, replace(settings, starts=1))
    if alone is None:
        return robot
    shared = tuple(p for p in shared_parameters(robot) if fleet.knows(p.name))
    freedom = alone.statistics.freedom
    unlike: list[str] = []
    while shared:
        evidence = evidence_of_fit(alone.robot, alone.free, alone.statistics.covariance, freedom, shared)
        mean, expected = expectation_of_fleet(fleet, robot, shared)
        compared = compare_with_fleet(evidence, mean, expected, np.full(len(shared), fleet.robots + _EXTRA))
        if not compared.p_value() < FALSE_ALARM:
            break
        if len(unlike) + 1 > _MOST * len(fleet.parameters) or not np.any(np.isfinite(compared.distances)):
            unlike = list(fleet.parameters)
            break
        worst = shared[int(np.nanargmax(np.abs(compared.distances)))].name
        unlike.append(worst)
        shared = tuple(p for p in shared if p.name != worst)
    if not unlike:
        return robot
    changed = fleet.model_copy(update={"unlike": tuple(name for name in fleet.parameters if name in unlike)})
    return replace(robot, description=robot.description.model_copy(update={"fleet": changed}))


def _fit_nearly_without_fleet(robot: Robot, fleet: FleetSection, data: Measurements, settings: Settings) -> Fit | None:
    """The fit without the fleet, or with the fleet's prior made wide; None if neither is possible."""
    wide = robot.description.model_copy(update={"fleet": fleet.widen(_WIDE, robot.parameters)})
    for tried in (without_fleet(robot), replace(robot, description=wide)):
        with suppress(CalibrationError):
            return fit_data(tried, settings, data)
    return None
