"""Whether a calibration makes poses that were not used better or worse, against chance.

For the same measured points k, whitened by the noise that was found, the errors before b_k and after a_k:

    change  T = sum |a_k|^2 - |b_k|^2

A robot that needs no correction has b_k = e_k (noise) and a_k = e_k + B_k d, with d ~ N(0, C) what the fit is off by
its own noise: the change is then positive, though nothing is wrong. With G = sum B_k^T B_k,

    E T = tr(GC) = m        var of |B d|^2 = 2 tr(GCGC)        var of 2 e^T B d = 4 m

The calibration is `worse`, or `better`, where the change lies above, or below, what this gives with a chance of 0.1 %
each: the quadratic part as a scaled chi-square of the same mean and variance, the mixed part as normal. In the place of
e, which nobody knows, stand the errors of the better state, where they are larger than the noise: that is what the
model leaves out.

When it fails. What the model leaves out is no noise, and follows the poses: where the poses not used are few and alike,
the chance is larger.

Reference: satterthwaite1946.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2, norm

from calib.identification.fitted import ErrorSet, Fit
from calib.linearisation.jacobian import linearise
from calib.model.mechanism import FloatArray

CHANCE = 1e-3
"""Chance that a calibration that changes nothing is called better, or worse."""


@dataclass(frozen=True)
class Comparison:
    """Errors on one set of poses that were not used.

    Attributes:
        name: What to call these poses.
        before, after: Root mean square distance [m].
        better, worse: Whether the calibration made them so, beyond chance.
    """

    name: str
    before: float
    after: float
    better: bool
    worse: bool

    @property
    def words(self) -> str:
        """Both root mean squares in words."""
        return f"RMS {1e3 * self.after:.4f} mm after, {1e3 * self.before:.4f} mm before"


def comparisons(fit: Fit) -> Iterator[Comparison]:
    """Compare before and after on the validation poses and on poses left out in turns, as far as there are any."""
    if fit.computed:
        return
    if fit.validation is not None:
        q = fit.validation.data.joints
        jacobian = linearise(fit.robot, fit.robot.assemble(q)).jacobian[..., fit.free]
        yield _compare(fit, "the validation poses", fit.validation, jacobian, 1.0)
    if fit.folds is not None:
        fewer = fit.folds.count / (fit.folds.count - 1)  # each fold is predicted by a fit of the others
        yield _compare(fit, "poses left out in turns", fit.folds.errors, fit.jacobian, fewer)


def _compare(fit: Fit, name: str, errors: ErrorSet, jacobian: FloatArray, covariance: float) -> Comparison:
    weight = errors.data.counts[:, None, None] / fit.statistics.sigma**2
    before, after = (weight * values**2 for values in (errors.before, errors.after))
    product = np.einsum("ptai,ptaj->ij", weight[..., None] * jacobian, jacobian)
    product = product @ (covariance * fit.statistics.covariance)
    per_row = max(1.0, min(float(np.mean(before)), float(np.mean(after))))
    change, expected, spread = float(np.sum(after - before)), float(np.trace(product)), _spread(product, per_row)
    return Comparison(
        name,
        _rms(errors.before),
        _rms(errors.after),
        better=change < min(0.0, expected - spread),
        worse=change > expected + spread,
    )


def _spread(product: FloatArray, per_row: float) -> float:
    """Return how far above its mean T goes with `CHANCE`.

    Args:
        product: GC, (n_free, n_free).
        per_row: Mean square of a component of e.
    """
    mean, squares = float(np.trace(product)), float(np.sum(product * product.T))
    if mean <= 0:
        return 0.0
    quadratic = squares / mean * float(chi2.isf(CHANCE, mean**2 / squares)) - mean
    mixed = float(norm.isf(CHANCE)) * 2.0 * float(np.sqrt(per_row * mean))
    return float(np.hypot(quadratic, mixed))


def _rms(errors: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=2))))
