"""The evidence of a result on the parameters that robots of one model share, and a fleet's expectation of them.

Shared are joint origins and coefficients of joint terms. The places of base, targets and instruments are no property of
a robot: they are integrated out, by taking the block of the covariance of the shared parameters. Coefficients whose
common size is estimated from the data (curves) are not shared either: these keep their own prior.

Everything is scaled, u = (p - p_nominal) / s with the description's sigmas s.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray
from calib.core.base.parameter import Parameter
from calib.core.numerics import linalg
from calib.core.robots.fleet_prior import FleetParameter, FleetSection
from calib.core.robots.robot import Robot
from calib.core.rows.unknowns import Unknowns
from calib.fleets.hierarchy import FleetEvidence, Hierarchy, evidence_of_data

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

    Args:
        robot: Calibrated, with the prior of its fit.
        free: Mask of its free parameters, (n_parameters,).
        covariance: Covariance of the free parameters, (n_free, n_free) [SI].
        freedom: Degrees of freedom of the noise.
        shared: The shared parameters.
    """
    unknowns = Unknowns.from_robot(robot, free)
    index = np.array([unknowns.names.index(p.name) for p in shared], dtype=np.intp)
    scales, nominal = _scales(shared)
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
    scales, nominal = _scales(shared)
    parameters = fleet.expected(shared, robot.path)
    covariance = fleet.covariance([p.name for p in shared])
    spread = np.array([p.sigma_si for p in parameters]) / np.sqrt(np.diag(covariance)) / scales
    mean = (np.array([p.expected_si for p in parameters]) - nominal) / scales
    return mean, spread[:, None] * covariance * spread


def section_of(
    learned: Hierarchy, robots: int, shared: Sequence[Parameter], noise_freedom: float = 0.0
) -> FleetSection:
    """Return mean and spread as a section of a robot description."""
    scales, _ = _scales(shared)
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


def _scales(shared: Sequence[Parameter]) -> tuple[FloatArray, FloatArray]:
    return np.array([p.sigma_si for p in shared]), np.array([p.nominal_si for p in shared])
