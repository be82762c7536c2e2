"""The budget checked by Monte Carlo (GUM Supplement 1): inputs are drawn, the fit is made again, positions deviate.

Each draw has a scale and offsets of the instrument, a temperature and an expansion (a Latin hypercube of normal
numbers), noise of the readings by the sum T^T J^T e that decides the fit, and means of the priors drawn by themselves.
From the minimum, Gauss-Newton steps with the derivative of each new place lead to the minimum of the drawn readings;
positions there, exact and with loops closed, less those of the fit are what the measurand is off. Where the base is
unknown, they are laid on those of the fit as one body. What needs no fit (repeatability, what the model leaves out,
extrapolation) is added as normal numbers of its size.

Reference: jcgm101 (GUM Supplement 1), section 7.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import UnreachablePoseError
from calib.core.base.threads import one_blas_thread
from calib.core.base.workers import Progress
from calib.core.numerics.rigid import best_transform
from calib.core.robots.traceability import TraceabilitySection
from calib.core.rows.observed import observe
from calib.quality.uncertainty_budget import ELSEWHERE, MODEL, REPEATABILITY, Budget, LinearFit

_STEPS = 2  # of Gauss-Newton: the second changes a step of the noise's size by its square
_ADDED = (REPEATABILITY, MODEL, ELSEWHERE)


@dataclass(frozen=True)
class MonteCarlo:
    """What the draws say.

    Attributes:
        draws: How many could be made.
        fitted: Standard uncertainty of a coordinate by all that goes through the fit, and temperatures [m].
        combined: The same with all that counts [m].
        propagated_fitted, propagated: Both as the budget has them [m].
    """

    draws: int
    fitted: float
    combined: float
    propagated_fitted: float
    propagated: float

    @property
    def difference(self) -> float:
        """Larger relative difference of both from what was propagated."""
        pairs = ((self.fitted, self.propagated_fitted), (self.combined, self.propagated))
        return max((abs(drawn / known - 1.0) for drawn, known in pairs if known > 0), default=0.0)

    def to_dict(self) -> dict[str, float]:
        """Return it as JSON has it, in SI units."""
        return {**vars(self), "relative_difference": self.difference}


@one_blas_thread
def monte_carlo(
    linear: LinearFit,
    stated: TraceabilitySection,
    known: Budget,
    draws: int = 400,
    seed: int = 0,
    progress: Progress | None = None,
) -> MonteCarlo:
    """Check a budget.

    Args:
        linear: The linear model of the fit.
        stated: What was stated for the budget.
        known: The budget.
        draws: How many.
        seed: Of all that is drawn.
        progress: Told of each draw.
    """
    rng = np.random.default_rng(seed)
    instrument, heat = stated.instrument, stated.temperature
    sizes = np.array([instrument.scale, *[instrument.offset] * 3]) / instrument.divisor
    uniform = scipy.stats.qmc.LatinHypercube(6, seed=rng).random(draws)
    scalars = scipy.special.ndtri(uniform) * np.array([*sizes, heat.uncertainty, heat.expansion_uncertainty])
    values, vectors = np.linalg.eigh(linear.noise)
    spread = vectors * np.sqrt(np.maximum(values, 0.0))
    prior, squares = linear.fit.unknowns.prior, []
    for k, drawn in enumerate(scalars):
        score, mean = spread @ rng.standard_normal(len(values)), prior.root @ rng.standard_normal(len(prior.has))
        try:
            moved = _deviation(linear, linear.systematic @ drawn[:4], score, mean)
        except UnreachablePoseError:
            continue
        grown = heat.expansion * drawn[4] + heat.difference * drawn[5] + drawn[4] * drawn[5]
        squares.append(float(np.mean((moved + grown * linear.lever) ** 2)))
        if progress is not None:
            progress(k + 1, draws)
    added = [row.contribution for row in known.rows if row.counts and row.quantity in _ADDED]
    drawn_too = rng.standard_normal((len(squares), linear.positions.size, len(added))) @ np.array(added)
    fitted = float(np.mean(squares))
    combined = fitted + float(np.mean(drawn_too**2))
    through = known.combined**2 - float(np.sum(np.square(added)))
    return MonteCarlo(len(squares), fitted**0.5, combined**0.5, max(through, 0.0) ** 0.5, known.combined)


def _deviation(linear: LinearFit, readings: FloatArray, score: FloatArray, mean: FloatArray) -> FloatArray:
    """Return how far positions move, (n n_targets 3,) [m], where readings, noise and prior means are drawn.

    Args:
        linear: The linear model.
        readings: Change of the whitened readings, (n_rows,).
        score: T^T J^T e of the noise, (rank,).
        mean: Of the priors, (n_free,).
    """
    fit = linear.fit
    unknowns, data, root = fit.unknowns, fit.identification.data, fit.root
    start = unknowns.deviations(fit.robot.values)
    u, passive, prior = start, fit.identification.passive, unknowns.prior
    weights = np.sqrt(fit.weights)[fit.rows.layout.reading]
    weighing = fit.whitening.weighing(fit.scales.ratios)
    pull = np.linalg.pinv(root).T @ score
    for _ in range(_STEPS):
        robot = unknowns.moved(fit.robot, u)
        configurations = robot.assemble(data.joints, passive, data.labels, data.conditions)
        observed = observe(robot, configurations, data.readings)
        rows = fit.whitening.rows(observed, fit.scales.groups, unknowns, u).whitened(weighing)
        jacobian, residuals = weights[:, None] * rows.jacobian, weights * rows.residuals - readings
        normal = jacobian.T @ jacobian + prior.rows.T @ prior.rows
        gradient = jacobian.T @ residuals + prior.rows.T @ prior.times(u - mean) - pull
        u = u - root @ np.linalg.solve(root.T @ normal @ root, root.T @ gradient)
    robot = unknowns.moved(fit.robot, u)
    kept = np.setdiff1d(np.arange(len(robot.mechanism.targets)), list(robot.left_out.values()))
    there = robot.positions(data.joints, data.conditions, passive)[:, kept].reshape(-1, 3)
    points = linear.positions.reshape(-1, 3)
    if fit.told_positions.motion is not None:
        rotation, shift = best_transform(there, points)
        there = there @ rotation.T + shift
    return (there - points).ravel()
