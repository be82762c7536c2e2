"""The budget checked by Monte Carlo (GUM Supplement 1): inputs are drawn, and the fit is repeated.

Each draw has errors of the instrument, a temperature and an expansion (a Latin hypercube of normal numbers), noise e of
the readings (only its sum T^T J^T e matters for the fit), independent means of the priors, and other logarithms of the
estimated sizes of joint terms. The solver of the fit (`calib.core.numerics.least_squares`) starts at the minimum of the
fit and finds that of the drawn readings. The error of the measurand is the exact positions there, with loops closed,
minus those of the fit. With an unknown base, they are first aligned with those of the fit as one body. Contributions
without a fit (repeatability, model errors, extrapolation) are added as normal numbers.

Reference: jcgm101 (GUM Supplement 1), section 7.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import UnreachablePoseError
from calib.core.base.threads import one_blas_thread
from calib.core.base.workers import Progress
from calib.core.numerics import linalg
from calib.core.numerics.least_squares import minimise
from calib.core.numerics.rigid import best_transform
from calib.core.numerics.size_search import spread_of_sizes
from calib.core.rows.observed import observe
from calib.core.rows.rows import Rows
from calib.core.rows.unknowns import Unknowns
from calib.quality.traceability import TraceabilitySection
from calib.quality.uncertainty_budget import ELSEWHERE, MODEL, REPEATABILITY, SYSTEMATIC, Budget, ErrorPropagation

_TOLERANCE = 1e-7  # relative change of the cost
_SEEN = 1e-4  # only priors determine a direction if the data's part of it is less
_ADDED = (REPEATABILITY, MODEL, ELSEWHERE)


@dataclass(frozen=True)
class MonteCarlo:
    """Result of a Monte Carlo propagation.

    Attributes:
        draws: Number of successful draws.
        fitted: Standard uncertainty of a coordinate from contributions through the fit, and temperatures [m].
        combined: Standard uncertainty from all contributions [m].
        propagated_fitted, propagated: The same by linear propagation in the budget [m].
    """

    draws: int
    fitted: float
    combined: float
    propagated_fitted: float
    propagated: float

    @property
    def difference(self) -> float:
        """The larger relative difference of `fitted` and `combined` from the propagated values."""
        pairs = ((self.fitted, self.propagated_fitted), (self.combined, self.propagated))
        return max((abs(drawn / known - 1.0) for drawn, known in pairs if known > 0), default=0.0)

    def to_dict(self) -> dict[str, float]:
        """Return the result as data for JSON, in SI units."""
        return {**vars(self), "relative_difference": self.difference}


@one_blas_thread
def monte_carlo(
    linear: ErrorPropagation,
    stated: TraceabilitySection,
    known: Budget,
    draws: int,
    seed: int = 0,
    progress: Progress | None = None,
) -> MonteCarlo:
    """Check a known budget of these statements by repeated fits of drawn inputs."""
    rng = np.random.default_rng(seed)
    instrument, heat = stated.instrument, stated.temperature
    errors = [getattr(instrument, each.attribute) / instrument.divisor for each in SYSTEMATIC for _ in range(each.axes)]
    unknowns = linear.fit.unknowns
    logs = spread_of_sizes(linear.fit.root @ linear.fit.root.T, unknowns.family)
    inputs = [*errors, heat.uncertainty, heat.expansion_uncertainty]
    uniform = scipy.stats.qmc.LatinHypercube(len(inputs) + len(logs), seed=rng).random(draws)
    normal = scipy.special.ndtri(uniform)
    scalars, sizes = normal[:, : len(inputs)] * inputs, np.exp(normal[:, len(inputs) :] @ np.linalg.cholesky(logs).T)
    values, vectors = linalg.eigh(linear.noise)
    span = linear.fit.weighted_rows.jacobian @ linear.fit.root
    spread = linalg.pinv(span, rcond=_SEEN).T @ (vectors * np.sqrt(np.maximum(values, 0.0)) @ vectors.T)
    prior, squares = unknowns.prior, []
    for k, (drawn, size) in enumerate(zip(scalars, sizes, strict=True)):
        readings = linear.systematic @ drawn[:-2] + spread @ rng.standard_normal(len(values))
        mean = linear.fit.interval_factor * prior.root @ rng.standard_normal(len(prior.has))
        try:
            moved = _deviation(linear, unknowns.rescale_families(size), readings, mean)
        except UnreachablePoseError:
            continue
        warmer, more = drawn[-2:]
        grown = heat.expansion * warmer + heat.difference * more + warmer * more
        squares.append(float(np.mean((moved + grown * linear.lever) ** 2)))
        if progress is not None:
            progress(k + 1, draws)
    added = [row.contribution for row in known.rows if row.counts and row.quantity in _ADDED]
    drawn_too = rng.standard_normal((len(squares), linear.positions.size, len(added))) @ np.array(added)
    fitted = float(np.mean(squares))
    combined = fitted + float(np.mean(drawn_too**2))
    through = known.combined_uncertainty**2 - float(np.sum(np.square(added)))
    return MonteCarlo(len(squares), fitted**0.5, combined**0.5, max(through, 0.0) ** 0.5, known.combined_uncertainty)


def _deviation(linear: ErrorPropagation, unknowns: Unknowns, readings: FloatArray, mean: FloatArray) -> FloatArray:
    """Change of positions, (n_coordinates,) [m], for unknowns with drawn sizes.

    Drawn are changes of the whitened readings, (n_rows,), and the mean of the priors, (n_free,), too.
    """
    fit = linear.fit
    data, prior = fit.identification.data, unknowns.prior
    passive, weights = fit.identification.passive, np.sqrt(fit.weights)[fit.rows.layout.reading]

    @lru_cache(maxsize=4)
    def rows_at(place: bytes) -> Rows | None:
        u = np.frombuffer(place)
        robot = unknowns.robot_at(fit.robot, u)
        try:
            configurations = robot.assemble(data.joints, passive, data.labels, data.conditions)
        except UnreachablePoseError:
            return None
        observed = observe(robot, configurations, data.readings)
        return fit.whitening.rows(observed, fit.scales, unknowns, robot.values)

    def residuals(u: FloatArray) -> FloatArray:
        rows = rows_at(u.tobytes())
        own = np.full(len(readings), np.nan) if rows is None else weights * rows.residuals - readings
        return np.concatenate([own, prior.times(u - mean)])

    def jacobian(u: FloatArray) -> FloatArray:
        rows = rows_at(u.tobytes())
        assert rows is not None  # requested only where the residuals are finite
        return np.vstack([weights[:, None] * rows.jacobian, prior.rows])

    u = minimise(residuals, jacobian, unknowns.deviations(fit.robot.values), tolerance=_TOLERANCE).x
    robot = unknowns.robot_at(fit.robot, u)
    kept = np.setdiff1d(np.arange(len(robot.mechanism.targets)), list(robot.unreported_targets.values()))
    there = robot.positions(data.joints, data.conditions, passive)[:, kept].reshape(-1, 3)
    points = linear.positions.reshape(-1, 3)
    if fit.reported_uncertainty.motion is not None:
        rotation, shift = best_transform(there, points)
        there = there @ rotation.T + shift
    return (there - points).ravel()
