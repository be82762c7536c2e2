"""Uncertainty budget of a calibrated robot by the GUM, in the words of the GUM and of the VIM.

Measurand: one coordinate of the tool's position, as the calibrated robot gives it, root mean square over the measured
poses and the three axes. With an unknown base, a motion of all positions as one body does not count.

Readings y reach the parameters through the fit's linear model. With the whitened rows J at the solution, the whitening
W of readings, T T^T = (J^T J + P^T P)^-1 (`calib.core.numerics.statistics`) and s the scales, a common change dy of the
readings moves parameters by s T T^T J^T W dy, and positions by B times that, B their derivative. So:

    readings        B s T (core - S - V) T^T s B^T    type A; independent parts of each reading
    prior           B s T S T^T s B^T                 type B; S the share of the priors
    sizes           B s T V T^T s B^T                 type A; of joint terms whose sizes come from the same readings
                                                      (`calib.core.numerics.size_search`)
    instrument      u . |B s T T^T J^T W dy/dx|       type B; scale and offset of lengths, offset of angles, focal
                                                      length and principal point of a camera: fully correlated, no
                                                      number of poses makes them smaller
    temperature     u . expansion . lever             lever: coordinate of the tool from the base
    robot           repeatability, from repeated poses, and errors of the model: the claim's mean square
                    (`calib.core.judging.claim`) minus the part in the rows above

The combined uncertainty is the root of the sum of squares; effective degrees of freedom are by Welch and Satterthwaite
(GUM G.4), the coverage factor is Student's t at 95 %.

When it fails. Scatter of repeats and claim also contain the noise of single readings, which cannot be separated: the
result is too wide. The centring of the target differs from reading to reading, so the estimated noise contains it.

Reference: jcgm100 (GUM), sections 4, 5.2, G.4.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray
from calib.core.data.in_memory import PosesLike
from calib.core.instruments.pixel import Pixel
from calib.core.judging.repeatability import doubtful_repeats, repeatability
from calib.core.judging.row_derivatives import EffectSetting
from calib.core.judging.verdict import JudgedFit
from calib.core.numerics import linalg
from calib.core.numerics.size_search import variance_by_sizes
from calib.core.numerics.statistics import prior_shares
from calib.core.rows.prediction import without_common_motion
from calib.quality.traceability import TraceabilitySection

PROBABILITY = 0.95
_FOUND = "found from the same readings (calib fit --terms)"
NOISE, PRIOR = "noise of the readings", "expected deviations of the parameters (priors)"
SIZES = "sizes of joint terms"
SCALE, OFFSET = "scale of the instrument", "offset of the instrument along each axis"
OFFSET_ANGLE = "offset of the instrument's angles"
FOCAL_LENGTH, PRINCIPAL_POINT = "focal length of the camera", "principal point of the camera along each axis"
CENTRING = "centring of the target"
TEMPERATURE, EXPANSION = "temperature of the robot", "coefficient of expansion of the robot"
REPEATABILITY, MODEL = "repeatability of the robot", "what the model leaves out"
ELSEWHERE = "extrapolation to other poses"


@dataclass(frozen=True)
class Systematic:
    """An error of the instrument that all readings share; `attribute` is its name in `traceability.instrument`."""

    quantity: str
    attribute: str
    unit: str
    axes: int


SYSTEMATIC = (
    Systematic(SCALE, "scale", "m/m", 1),
    Systematic(OFFSET, "offset", "m", 3),
    Systematic(OFFSET_ANGLE, "offset_angle", "rad", 3),
    Systematic(FOCAL_LENGTH, "focal_length", "m/m", 1),
    Systematic(PRINCIPAL_POINT, "principal_point", "px", 2),
)
_FIRST = dict(zip((each.quantity for each in SYSTEMATIC), np.cumsum([0, *(s.axes for s in SYSTEMATIC)]), strict=False))
"""First column of each in `ErrorPropagation.systematic`."""


@dataclass(frozen=True)
class BudgetRow:
    """One row of the budget.

    Attributes:
        quantity: The input quantity.
        standard_uncertainty: Its standard uncertainty, in `unit`.
        unit: Unit of the input quantity.
        sensitivity: Sensitivity coefficient [m per unit].
        note: Its source.
        freedom: Degrees of freedom; infinite for a known uncertainty.
        type: Kind of evaluation: A (statistics of observations) or B (other information).
        counts: Whether it is part of the combined uncertainty; False if another row contains it.
    """

    quantity: str
    standard_uncertainty: float
    unit: str
    sensitivity: float
    note: str
    freedom: float = math.inf
    type: str = "B"
    counts: bool = True

    @staticmethod
    def direct(quantity: str, contribution: float, freedom: float, note: str) -> BudgetRow:
        """Return a row of type A whose quantity is a length of the measurand itself."""
        return BudgetRow(quantity, contribution, "m", 1.0, note, freedom, "A")

    @property
    def contribution(self) -> float:
        """Part of the standard uncertainty of the measurand [m]."""
        return self.sensitivity * self.standard_uncertainty


@dataclass(frozen=True)
class Budget:
    """The budget; see the module docstring."""

    rows: tuple[BudgetRow, ...]

    @property
    def combined_uncertainty(self) -> float:
        """Combined standard uncertainty [m]."""
        return math.hypot(*(row.contribution for row in self.rows if row.counts))

    @property
    def freedom(self) -> float:
        """Effective degrees of freedom."""
        parts = sum(row.contribution**4 / row.freedom for row in self.rows if row.counts)
        return self.combined_uncertainty**4 / parts if parts > 0 else math.inf

    @property
    def coverage_factor(self) -> float:
        """Coverage factor of a 95 % interval."""
        return float(scipy.special.stdtrit(min(self.freedom, 1e9), 0.5 + PROBABILITY / 2))

    @property
    def expanded_uncertainty(self) -> float:
        """Expanded uncertainty [m]."""
        return self.coverage_factor * self.combined_uncertainty

    def to_dict(self) -> dict[str, object]:
        """Return the budget as data for JSON, in SI units; null for infinite degrees of freedom."""
        rows = [asdict(row) | {"contribution": row.contribution, "freedom": _finite(row.freedom)} for row in self.rows]
        return {
            "rows": rows,
            "combined_standard_uncertainty": self.combined_uncertainty,
            "effective_degrees_of_freedom": _finite(self.freedom),
            "coverage_factor": self.coverage_factor,
            "coverage_probability": PROBABILITY,
            "expanded_uncertainty": self.expanded_uncertainty,
        }


def _finite(number: float) -> float | None:
    return number if math.isfinite(number) else None


@dataclass(frozen=True, eq=False)
class ErrorPropagation:
    """Propagation of input errors by the linear model of a fit; see the module docstring.

    Attributes:
        fit: The fit.
        positions: Positions of the targets at the measured poses, (n, n_targets, 3) [m].
        derivative: B s, by the scaled free parameters, (n n_targets 3, n_free) [m].
        noise: Covariance of T^T J^T e, e the noise of the whitened readings, (rank, rank).
        sizes: Addition to `noise` from estimated sizes of joint terms, (rank, rank); 0 if there are none.
        systematic: Change of the whitened readings by the errors in `SYSTEMATIC`, (n_rows, 10) [per 1, m, rad or px].
    """

    fit: JudgedFit
    positions: FloatArray
    derivative: FloatArray
    noise: FloatArray
    sizes: FloatArray
    systematic: FloatArray

    @staticmethod
    def from_fit(fit: JudgedFit) -> ErrorPropagation:
        """Return the propagation of a fit."""
        data, passive = fit.identification.data, fit.identification.passive
        linear = fit.uncertainty.linearise(fit.robot, data.joints, data.conditions, passive, turns=False)
        kept = np.setdiff1d(np.arange(linear.positions.shape[1]), list(fit.robot.unreported_targets.values()))
        positions, rows = linear.positions[:, kept], linear.jacobian[:, kept, :, : len(fit.unknowns)]
        if fit.reported_uncertainty.motion is not None:
            rows = without_common_motion(positions, rows)
        derivative = rows.reshape(-1, rows.shape[-1]) * fit.unknowns.scales
        pinned = linalg.pinv(fit.root)
        core, scales = fit.covariance.values, fit.unknowns.scales
        deviations = fit.weighted_rows.deviations
        sizes = variance_by_sizes(fit.root @ fit.root.T, fit.unknowns.family, deviations)
        of_readings = core / np.outer(scales, scales) - fit.interval_factor**2 * sizes
        noise = pinned @ of_readings @ pinned.T
        noise = noise - fit.interval_factor**2 * prior_shares(
            fit.weighted_rows.posterior_information, fit.unknowns.prior
        )
        sizes = fit.interval_factor**2 * (pinned @ sizes @ pinned.T)
        return ErrorPropagation(fit, positions, derivative, noise, sizes, _systematic(fit))

    @property
    def parameter_response(self) -> FloatArray:
        """Derivative of the scaled parameters by the whitened readings, (n_free, n_rows)."""
        root = self.fit.root
        return np.asarray(root @ (self.fit.weighted_rows.jacobian @ root).T)

    @property
    def lever(self) -> FloatArray:
        """Positions of the targets from the robot's base, (n_coordinates,) [m]."""
        mechanism = self.fit.robot.mechanism
        base = mechanism.placement(mechanism.origin_names[mechanism.targets[0].a - 1]).inverse().translation
        return (self.positions - base).ravel()

    def coordinate_rms(self, core: FloatArray) -> float:
        """Return the uncertainty of a coordinate (root mean square) [m] from a covariance of T^-1 u, (rank, rank)."""
        carried = self.derivative @ self.fit.root
        return float(np.sqrt(max(np.mean(np.einsum("ij,jk,ik->i", carried, core, carried)), 0.0)))


def _systematic(fit: JudgedFit) -> FloatArray:
    """Changes of readings for `ErrorPropagation.systematic`."""
    n = sum(each.axes for each in SYSTEMATIC)
    changes = {name: np.zeros((*r.shape, n)) for name, r in fit.identification.after.items()}
    for instrument, part, rows in fit.identification.parts():
        values = fit.identification.data.readings[instrument.name].values
        change, axes = changes[instrument.name], np.arange(len(part.axes))
        points = instrument.points(values) if part.is_position else None
        if points is not None:
            change[:, rows, _FIRST[SCALE]] = points
            change[:, rows, _FIRST[OFFSET] + axes] = 1.0
        elif part.dimension == "length" and values.shape[1] == instrument.n_rows:
            change[:, rows, _FIRST[SCALE]], change[:, rows, _FIRST[OFFSET]] = values[:, rows], 1.0
        elif part.dimension == "angle":
            change[:, rows, _FIRST[OFFSET_ANGLE] + axes] = 1.0
        elif isinstance(instrument, Pixel):
            change[:, rows, _FIRST[FOCAL_LENGTH]] = values - np.array(instrument.intrinsics[2:4])
            change[:, rows, _FIRST[PRINCIPAL_POINT] + axes] = 1.0
    return EffectSetting(fit).whiten(changes)


def budget(linear: ErrorPropagation, stated: TraceabilitySection, poses: PosesLike | None = None) -> Budget:
    """Return the budget of a fit; `poses` are others at which the robot will be used."""
    fit = linear.fit
    shares = prior_shares(fit.weighted_rows.posterior_information, fit.unknowns.prior)
    freedom = fit.statistics.interval_freedom
    noise, prior, reading = linear.coordinate_rms(linear.noise), linear.coordinate_rms(shares), fit.first_noise
    unit = {"length": "m", "angle": "rad"}.get(reading.group.part.dimension, "px")
    counted = "scatter of residuals" if fit.interval_factor == 1.0 else "scatter of residuals, and between regions"
    by_noise = noise / reading.sigma if reading.sigma > 0 else 0.0
    rows = [
        BudgetRow(NOISE, reading.sigma, unit, by_noise, counted, freedom, "A"),
        BudgetRow(PRIOR, fit.interval_factor, "1", prior, "sigma of the description"),
        *_from_instrument(linear, stated),
        *_thermal(linear, stated),
    ]
    if fit.unknowns.families:
        rows.insert(2, BudgetRow.direct(SIZES, linear.coordinate_rms(linear.sizes), freedom, _FOUND))
    own = sum(row.contribution**2 for row in rows if row.quantity in (NOISE, PRIOR, SIZES))
    return Budget((*rows, *_robot_rows(fit, own, poses)))


def _from_instrument(linear: ErrorPropagation, stated: TraceabilitySection) -> list[BudgetRow]:
    moved = np.mean((linear.derivative @ (linear.parameter_response @ linear.systematic)) ** 2, axis=0)
    instrument, rows = stated.instrument, []
    source = f"certificate {instrument.certificate or 'not stated'}: {instrument.stated}"
    for each in SYSTEMATIC:
        columns = slice(_FIRST[each.quantity], _FIRST[each.quantity] + each.axes)
        if np.any(linear.systematic[:, columns]):
            u, per = getattr(instrument, each.attribute) / instrument.divisor, float(np.sqrt(np.sum(moved[columns])))
            rows.append(BudgetRow(each.quantity, u, each.unit, per, source))
    axes = linear.systematic[:, _FIRST[OFFSET] : _FIRST[OFFSET] + 3]
    if np.any(axes):
        read, u = np.mean(np.sum((linear.derivative @ linear.parameter_response) ** 2, axis=1)), stated.target.centring
        per, note = float(np.sqrt(read * np.mean(axes**2) * 3.0)), "part of the noise as found: not counted again"
        rows.append(BudgetRow(CENTRING, u, "m", per, note, counts=False))
    return rows


def _thermal(linear: ErrorPropagation, stated: TraceabilitySection) -> list[BudgetRow]:
    heat, lever = stated.temperature, float(np.sqrt(np.mean(linear.lever**2)))
    by_kelvin, by_ratio = heat.expansion * lever, abs(heat.difference) * lever
    return [
        BudgetRow(TEMPERATURE, heat.uncertainty, "K", by_kelvin, "expansion times lever"),
        BudgetRow(EXPANSION, heat.expansion_uncertainty, "1/K", by_ratio, "difference times lever"),
    ]


def _robot_rows(fit: JudgedFit, included: float, poses: PosesLike | None) -> list[BudgetRow]:
    """Rows of the robot itself; `included` is the part of the claim's mean square in other rows [m^2]."""
    scatter, freedom = repeatability(fit.identification)
    rows, claim = [], fit.verdict.claim
    if freedom:
        note = "repeated poses; contains the noise of a reading"
        if doubtful_repeats(fit.identification):
            note += ", and nothing else if the robot did not move between repeats"
        rows.append(BudgetRow.direct(REPEATABILITY, scatter, float(freedom), note))
        included += scatter**2
    if claim is not None and claim.at_measured_poses.is_position:
        total = claim.at_measured_poses.rms**2 / 3.0
        n = claim.at_measured_poses.n_poses
        note = "from poses left out in turn; contains their noise"
    else:
        known_positions = fit.identification_uncertainty
        total, n = float(np.mean(known_positions.reported_distance**2)) / 3.0, fit.identification.data.n_poses
        note = "errors of joints that residuals show"
    rows.append(BudgetRow.direct(MODEL, math.sqrt(max(total - included, 0.0)), float(n), note))
    elsewhere = None if poses is None else fit.claim_at(poses)
    if elsewhere is not None and claim is not None:
        more = math.sqrt(max(elsewhere.rms**2 - claim.at_measured_poses.rms**2, 0.0) / 3.0)
        rows.append(BudgetRow.direct(ELSEWHERE, more, float(n), "covariance of the parameters at these poses"))
    return rows
