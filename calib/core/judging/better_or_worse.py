"""Whether a calibration makes errors at unused poses smaller or larger, beyond chance.

For the same readings k, whitened by the noise that was found, the errors before b_k and after a_k:

    change  T = sum |a_k|^2 - |b_k|^2

A robot that needs no correction has b_k = e_k (noise) and a_k = e_k + B_k d, with d ~ N(0, C) the error of the fit from
its own noise: the change is then positive, though nothing is wrong. With G = sum B_k^T B_k,

    E T = tr(GC) = m        var of |B d|^2 = 2 tr(GCGC)        var of 2 e^T B d = 4 m

The calibration is `worse`, or `better`, if noise alone gives a larger, or smaller, change in only 0.1 % of cases: the
quadratic part as a scaled chi-square of the same mean and variance, the mixed part as normal. All is in units of a
noise that was itself found, with f degrees of freedom: so F replaces the chi-square, and Student's t the normal
distribution. The unknown e is replaced by the errors of the better state, where they are larger than the noise, because
they contain errors of the model. Where poses scatter more than independent readings
(`calib.core.numerics.clusters`), the mixed part has the variance 4 times the sum over poses of e_b^T B_b C B_b^T e_b.

The uncertainty of a fit explains much where it is uncertain, and harms the robot nevertheless. So a calibration is
`worse`, too, if errors are more than `HARM` times as large as before, and the differences |a_k|^2 - |b_k|^2, summed
pose by pose, have a mean above zero with a chance of 0.1 % by Student's t; and `better` in the same way.

When it fails. Both parts of the change grow with the same d: up to 0.25 % of robots that need no correction are called
worse instead of 0.1 %. Errors of the model are no noise, and follow the poses: where unused poses are few and alike,
the chance is larger.

Reference: satterthwaite1946.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray, IntArray
from calib.core.base.memoize import memoize
from calib.core.fitting.error_sets import ErrorSet
from calib.core.fitting.fitted import Fit
from calib.core.fitting.unseen_errors import accuracy_of_errors, unused_errors
from calib.core.numerics.chances import FEWEST, UNLIKELY
from calib.core.robots.accuracy_of_files import Accuracy, PoseUse

HARM = 1.25
"""A fit harms if errors after it are more than this many times as large as before. With twice as many rows as
parameters, the fewest allowed, its noise alone makes errors sqrt(1 + 1/2) = 1.22 times as large."""


@dataclass(frozen=True, eq=False)
class UnusedErrors:
    """Errors on one set of unused poses.

    Attributes:
        better, worse: Whether the calibration made errors smaller, or larger, beyond chance.
    """

    name: str
    errors: ErrorSet
    accuracy: Accuracy
    better: bool
    worse: bool

    @property
    def words(self) -> str:
        """Both root mean squares in words."""
        known = self.accuracy
        return f"RMS {known.in_unit(known.rms)} after, {known.in_unit(known.before)} before"


@memoize
def comparisons(fit: Fit) -> tuple[UnusedErrors, ...]:
    """Compare before and after on the validation poses and in cross-validation, as far as these exist."""
    compared = []
    for errors, poses in () if fit.computed else unused_errors(fit):
        name, fewer = f"the validation poses{'' if errors is fit.validation else ', their frame placed anew'}", 1.0
        if poses is PoseUse.FOLDS and fit.folds is not None:
            name = f"{'setups' if fit.folds.setups else 'poses'} left out in turn"
            fewer = fit.folds.count / (fit.folds.count - 1)  # each fold is predicted by a fit of the others
        compared.append(UnusedErrors(name, errors, accuracy_of_errors(errors, poses), *_compare(fit, errors, fewer)))
    return tuple(compared)


def _compare(fit: Fit, errors: ErrorSet, fewer: float) -> tuple[bool, bool]:
    """Whether errors became smaller, and larger, beyond chance, with `fewer` times the covariance of the fit."""
    before, rows = fit.whitened_residuals_and_rows(errors)
    covariance = fewer * fit.statistics.covariance / np.outer(fit.unknowns.scales, fit.unknowns.scales)
    product = rows.jacobian.T @ rows.jacobian @ covariance
    squares = float(before @ before), float(rows.residuals @ rows.residuals)
    change, expected = squares[1] - squares[0], float(np.trace(product))
    pose = np.unique(rows.layout.pose_of_row, return_inverse=True)[1]
    if fit.statistics.shared_scatter is not None:
        left = rows.residuals if squares[1] < squares[0] else before
        sums = np.stack([np.bincount(pose, column * left) for column in rows.jacobian.T], axis=1)
        mixed = float(np.sum((sums @ covariance) * sums))
    else:
        mixed = max(1.0, min(squares) / rows.layout.n_read) * expected
    spread = _margin_above_mean(product, mixed, fit.statistics.freedom)
    better = change < min(0.0, expected - spread) or _has_grown(pose, rows.residuals, before)
    return better, change > expected + spread or _has_grown(pose, before, rows.residuals)


def _has_grown(pose: IntArray, before: FloatArray, after: FloatArray) -> bool:
    squares: list[FloatArray] = [np.bincount(pose, errors**2).astype(float) for errors in (before, after)]
    return bool(np.sum(squares[1]) > HARM**2 * np.sum(squares[0])) and surely_positive(squares[1] - squares[0])


def surely_positive(changes: FloatArray) -> bool:
    """Whether the mean of changes (n,) is above zero beyond chance, by Student's t; never for too few."""
    n, spread = len(changes), float(np.std(changes, ddof=1)) if len(changes) >= FEWEST else 0.0
    return spread > 0 and bool(scipy.special.stdtr(n - 1, -np.mean(changes) / spread * np.sqrt(n)) < UNLIKELY)


def _margin_above_mean(product: FloatArray, mixed: float, freedom: float) -> float:
    """Return the distance of T above its mean that chance exceeds with `UNLIKELY`.

    GC is `product`, (n_free, n_free), and `mixed` the variance of e^T B d, with the noise found with `freedom` degrees.
    """
    mean, squares = float(np.trace(product)), float(np.sum(product * product.T))
    if mean <= 0:
        return 0.0
    quadratic = mean * float(scipy.special.fdtri(mean**2 / squares, freedom, 1.0 - UNLIKELY)) - mean
    return float(np.hypot(quadratic, -2.0 * float(scipy.special.stdtrit(freedom, UNLIKELY)) * np.sqrt(mixed)))
