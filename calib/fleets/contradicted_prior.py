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

Evidence. Shared are joint origins and coefficients of joint terms. The places of base, targets and instruments are no
property of a robot: they are integrated out, by taking the block of the covariance of the shared parameters.
Coefficients whose common size is estimated from the data (curves) are not shared either: these keep their own prior.

Everything is scaled, u = (p - p_nominal) / s with the description's sigmas s.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray
from calib.core.base.errors import CalibrationError
from calib.core.base.parameter import Parameter
from calib.core.data.measurements import Measurements
from calib.core.fitting.fit import fit_data
from calib.core.fitting.fitted import Fit
from calib.core.fitting.settings import Settings
from calib.core.numerics import linalg
from calib.core.numerics.chances import FALSE_ALARM
from calib.core.robots.fleet_prior import FleetParameter, FleetSection
from calib.core.robots.robot import Robot
from calib.core.rows.unknowns import Unknowns
from calib.fleets.hierarchy import FleetEvidence, Hierarchy, compare_with_fleet, evidence_of_data

_SMALL = 1e-3  # a combination gets no column if its mean has less than this part of the variance of the spread


def without_fleet(robot: Robot) -> Robot:
    """Return a robot without a fleet's prior."""
    if robot.description.fleet is None:
        return robot
    return replace(robot, description=robot.description.model_copy(update={"fleet": None}))


def shared_parameters(robot: Robot) -> tuple[Parameter, ...]:
    """Return the free parameters that robots of one model share, with the sigmas of the description."""
    bare, of_terms = without_fleet(robot).parameters, range(*robot.coefficients.indices(len(robot.parameters)))
    free = robot.is_free
    return tuple(
        p
        for k, p in enumerate(bare)
        if free[k] and not p.placement and not p.family and (k < robot.n_origin_parameters or k in of_terms)
    )


def evidence_of_fit(
    robot: Robot, free: BoolArray, covariance: FloatArray, freedom: float, shared: Sequence[Parameter]
) -> FleetEvidence:
    """Return the evidence of a fit's data, scaled by the sigmas of `shared`.

    The robot is calibrated, with the prior of its fit; its free parameters (n_parameters,) have a covariance (n_free,
    n_free) [SI], and its noise degrees of freedom.
    """
    unknowns = Unknowns.from_robot(robot, free)
    index = np.array([unknowns.names.index(p.name) for p in shared], dtype=np.intp)
    scales, nominal = scales_of(shared)
    prior, mean = unknowns.prior.select(index), (unknowns.expected[index] - nominal) / scales
    factor = scales / unknowns.scales[index]
    precision = factor[:, None] * prior.add_to(np.zeros((len(index), len(index)))) * factor
    values = robot.values[robot.parameters.places(p.name for p in shared)]
    block = covariance[np.ix_(index, index)] / scales[:, None] / scales
    return evidence_of_data(block, (values - nominal) / scales, precision, mean, freedom)


def expectation_of_fleet(
    fleet: FleetSection, robot: Robot, shared: Sequence[Parameter]
) -> tuple[FloatArray, FloatArray]:
    """Return a fleet's expectation of its parameters: mean (n,) and covariance (n, n), scaled."""
    scales, nominal = scales_of(shared)
    parameters = fleet.expected(shared, robot.path)
    covariance = fleet.covariance([p.name for p in shared])
    spread = np.array([p.sigma_si for p in parameters]) / np.sqrt(np.diag(covariance)) / scales
    mean = (np.array([p.expected_si for p in parameters]) - nominal) / scales
    return mean, spread[:, None] * covariance * spread


def section_of(
    learned: Hierarchy, robots: int, shared: Sequence[Parameter], noise_freedom: float = 0.0
) -> FleetSection:
    """Return mean and spread as a section of a robot description."""
    scales, _ = scales_of(shared)
    spread = np.sqrt(learned.variance)
    sizes, axes = linalg.eigh(learned.covariance / spread[:, None] / spread)
    kept = np.flatnonzero(sizes > _SMALL)[::-1]
    unsure = axes[:, kept] * np.sqrt(sizes[kept])
    return FleetSection(
        robots=robots,
        noise_freedom=noise_freedom,
        parameters={
            p.name: FleetParameter(
                offset=_round(learned.mean[k] * scales[k], 12),
                spread=float(f"{spread[k] * scales[k]:.6g}"),
                unsure=tuple(_round(number, 6) for number in unsure[k]),
            )
            for k, p in enumerate(shared)
        },
    )


def _round(number: float, digits: int) -> float:
    return round(float(number), digits) + 0.0  # no -0.0


def scales_of(shared: Sequence[Parameter]) -> tuple[FloatArray, FloatArray]:
    """Return the sigmas and the nominal values of parameters, (n,) each [SI]."""
    return np.array([p.sigma_si for p in shared]), np.array([p.nominal_si for p in shared])


_WIDE = 5.0  # factor that widens a prior, so that it decides little
_MOST = 0.25  # largest part of unlike parameters; with more, the whole robot is unlike
_EXTRA = 3.0  # degrees of freedom of a parameter's spread from others of its kind; each robot adds one


def without_contradicted_fleet(robot: Robot, data: Measurements, settings: Settings, fleet: FleetSection) -> Robot:
    """Return the nominal robot without the parts of its fleet's prior that its measurements contradict."""
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
