"""Robust losses: the weight of a reading by its distance from the fit.

A reading is k whitened rows of one instrument at one visit. With d = |r| / scale the length of its residual over a
scale found from the data, its squares count with the weight

    none     1
    huber    min(1, c / d)
    cauchy   1 / (1 + (d/c)^2)
    tukey    (1 - (d/c)^2)^2 for d < c, else 0

Whole readings are weighed, not coordinates, so that the result does not depend on how the measurement frame is turned.
The constants c lose 5 % of the information of normal data, for each k: with w' = dw/dd and E over the chi distribution
of d with k degrees of freedom, the efficiency is

    m^2 / b       m = E[w + w' d / k],   b = E[w^2 d^2] / k

(for k = 1 this gives the usual 1.345, 2.385 and 4.685). The noise of whitened readings, found
with these weights:

    scale       median of |r| / median of chi(k), times sqrt(rows / (rows - n_eff))
    f^2         sum w |r|^2 / sum k w, over its expectation for normal data with noise 1; rows that a weight of zero
                takes out do not count as rows
    effective   K b / m from the actual residuals: normal noise that would scatter the parameters as much (Huber's K)

When it fails. Outliers in more than about a third of the points, or in points that alone decide a parameter, draw the
fit to themselves. A robust loss does not remove systematic errors.

Reference: huber1981, sections 7.6 and 8.8; maronna2019, chapter 6.

Outliers: readings that lie further from where the fit puts them than noise explains.

A reading has k whitened rows r with scaled Jacobian B. With h = B C B^T (k x k) its leverage on its own prediction, C
the covariance of the parameters for noise 1, and w its weight in the fit (1 without a robust loss, 0 outside the fit),
the residual of normal data has

    cov r = f^2 V,      V = I + (1 - 2 w) h      (I - h for a reading that was used, I + h for one that was not)

so that T^2 = r^T V^-1 r is the studentised residual: the same for a reading that pulls the fit towards itself as for
one that does not. T / median of chi(k) is compared with a scale that outliers hardly move, its median over the
readings. A reading is an outlier if k F(k, nu/2) exceeds (T / scale)^2 with a chance below 1 % divided by the number of
readings: one in a hundred good sets has an outlier, whatever its size. (nu/2, because a median finds a scale about half
as well as the squares.)

Leverage is trace(h)/k: the part of a reading's own error that its prediction follows, the mean over its rows; leverages
of all rows add up to the effective parameters. The largest eigenvalue of h is the leverage along the worst direction.
Near 1 no test of the reading is possible along it.

When it fails. Several outliers that agree with each other pull a least-squares fit to them; fit with a robust loss to
see them. A reading of leverage near 1 is never an outlier.

Reference: cook1982, chapter 2.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, get_args

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray, IntArray, ReadOnlyArrays
from calib.core.base.errors import InputError, nearest
from calib.core.numerics import linalg
from calib.core.numerics.chances import FALSE_ALARM
from calib.core.numerics.clusters import blocks_of_equal_length
from calib.core.numerics.statistics import Factors, require_freedom
from calib.core.numerics.tall import Span

Loss = Literal["none", "huber", "cauchy", "tukey"]
LOSSES: tuple[Loss, ...] = get_args(Loss)
EFFICIENCY = 0.95
"""Part of the information of normal data that a robust loss keeps."""
_BRACKET = (0.05, 60.0)
HIGH_LEVERAGE = 0.9
"""A reading with a larger leverage along some direction decides its own prediction, and cannot be tested."""
_SMALLEST = 1e-6  # a direction with a smaller eigenvalue of V has no residual left
_NO_NOISE = 1e-12


def find_loss(name: str) -> Loss:
    """Return the loss of this name, or raise `InputError`."""
    for loss in LOSSES:
        if loss == name:
            return loss
    raise InputError(f"unknown loss '{name}'{nearest(name, LOSSES)}")


@lru_cache
def constant(loss: Loss, k: int) -> float:
    """Return c of the module docstring for readings of k rows."""
    if loss == "none":
        return np.inf
    return float(scipy.optimize.brentq(lambda c: efficiency(loss, c, k) - EFFICIENCY, *_BRACKET, xtol=1e-10))


def median_length(widths: IntArray) -> FloatArray:
    """Return the median length of normal residuals of readings with these numbers of rows, (n_readings,)."""
    return _values_by_width(lambda k: float(np.sqrt(2.0 * scipy.special.gammaincinv(0.5 * k, 0.5))), widths)


def _values_by_width(function: Callable[[int], float], widths: IntArray) -> FloatArray:
    """A number for each reading that depends on its rows alone."""
    different, index = np.unique(widths, return_inverse=True)
    return np.array([function(int(k)) for k in different])[index.ravel()]


def weights(loss: Loss, distance: FloatArray, c: FloatArray | float) -> FloatArray:
    """Return the weights of readings at distances d >= 0 over the scale, (n_readings,), for one constant c or each."""
    return _weights_and_changes(loss, distance, c)[0]


def _weights_and_changes(loss: Loss, distance: FloatArray, c: FloatArray | float) -> tuple[FloatArray, FloatArray]:
    """Weights w of `weights`, and w' d."""
    d = np.asarray(distance, dtype=float)
    if loss == "huber":
        w = np.minimum(1.0, c / np.maximum(d, 1e-300))
        return w, np.where(d > c, -w, 0.0)
    square = (d / c) ** 2  # 0 without a robust loss
    if loss == "tukey":
        inside = np.maximum(1.0 - square, 0.0)
        return inside**2, -4.0 * square * inside
    w = np.asarray(1.0 / (1.0 + square))
    return w, -2.0 * square * w**2


def weights_of(loss: Loss, distance: FloatArray, widths: IntArray) -> FloatArray:
    """Return the weights of readings with these numbers of rows, (n_readings,)."""
    return weights(loss, distance, _values_by_width(lambda k: constant(loss, k), widths))


def slopes(loss: Loss, distance: FloatArray, c: FloatArray | float, k: IntArray | int) -> FloatArray:
    """Return w + w' d / k, the mean over k rows of d(w r)/dr, of distances d (n_readings,)."""
    w, change = _weights_and_changes(loss, distance, c)
    return np.asarray(w + change / k)


def efficiency(loss: Loss, c: float, k: int) -> float:
    """Return the part of the information of normal data that a loss keeps."""
    slope = _mean(lambda d: slopes(loss, d, c, k), c, k)
    return slope**2 / (_mean(lambda d: weights(loss, d, c) ** 2 * d**2, c, k) / k)


def scale_of(distances: FloatArray, widths: IntArray, n_effective: float) -> float:
    """Return the scale of whitened residual lengths (n_readings,): a median, so that outliers hardly move it."""
    n_rows = int(np.sum(widths))
    require_freedom(n_rows - n_effective, n_rows)
    return float(np.median(distances / median_length(widths))) * float(np.sqrt(n_rows / (n_rows - n_effective)))


def robust_factors(loss: Loss, distances: FloatArray, widths: IntArray, scale: float, n_effective: float) -> Factors:
    """Return the factor on the assumed noise that the residuals show, the same for all rows.

    Args:
        distances: Lengths of whitened residuals, (n_readings,).
        widths: Number of rows of each reading, (n_readings,).
        scale: Divisor of the lengths in the weights.

    Raises:
        NotIdentifiableError: The loss leaves no degrees of freedom.
    """
    n_rows = float(np.sum(widths))
    c = _values_by_width(lambda k: constant(loss, k), widths)
    w, slope = weights(loss, distances / scale, c), slopes(loss, distances / scale, c, widths)
    expected_weight = _values_by_width(lambda k: _normal_moments(loss, k)[0], widths)
    expected_square = _values_by_width(lambda k: _normal_moments(loss, k)[1], widths)
    counted = min(n_rows, float(np.sum(widths * w / expected_weight)))
    freedom = counted - n_effective
    require_freedom(freedom, int(n_rows))
    expected = float(np.sum(widths * expected_square) / np.sum(widths * expected_weight))
    ratio = float(np.sum(w * distances**2) / np.sum(widths * w)) / expected
    factor = float(np.sqrt(ratio * counted / freedom))
    score = float(np.sqrt(np.sum(w**2 * distances**2) / (n_rows - n_effective)))
    m = float(np.average(slope, weights=widths))
    if m <= 0:
        require_freedom(0.0, int(n_rows))
    variance = float(np.average((slope - m) ** 2, weights=widths))
    correction = 1.0 + n_effective / n_rows * variance / m**2
    return Factors(np.array([factor]), np.array([freedom]), np.array([correction * score / m]), m)


@lru_cache
def _normal_moments(loss: Loss, k: int) -> tuple[float, float]:
    """E[w] and E[w d^2] / k for normal readings of k rows with noise 1."""
    c = constant(loss, k)
    return _mean(lambda d: weights(loss, d, c), c, k), _mean(lambda d: weights(loss, d, c) * d**2, c, k) / k


def _mean(function: Callable[[FloatArray], FloatArray], kink: float, k: int) -> float:
    """Mean over the chi distribution with k degrees of freedom; the integrand may have a kink."""
    size = (0.5 * k - 1.0) * np.log(2.0) + scipy.special.gammaln(0.5 * k)

    def integrand(d: float) -> float:
        return float(function(np.array(d)) * d ** (k - 1) * np.exp(-0.5 * d**2 - size))

    middle = min(kink, 15.0)
    limits = ((0.0, middle), (middle, max(30.0, 2.0 * middle)))
    return float(sum(scipy.integrate.quad(integrand, *ends)[0] for ends in limits))


@dataclass(frozen=True, eq=False)
class StudentisedErrors(ReadOnlyArrays):
    """Studentised residuals of every reading of a set.

    Attributes:
        ratio: T over its scale, (n_readings,).
        leverage: Mean over the rows, (n_readings,).
        largest_leverage: Leverage along the worst direction, (n_readings,).
        chance: Chance of a residual at least this large if only this reading were tested, (n_readings,).
        limit: Largest ratio of a reading that is no outlier, (n_readings,).
    """

    ratio: FloatArray
    leverage: FloatArray
    largest_leverage: FloatArray
    chance: FloatArray
    limit: FloatArray
    scale: float

    @property
    def p_value(self) -> FloatArray:
        """Chance of at least one such reading among good measurements of this number, (n_readings,)."""
        return np.minimum(1.0, len(self.chance) * self.chance)

    @property
    def outliers(self) -> IntArray:
        """Outliers, worst first, (n_outliers,)."""
        outliers = np.flatnonzero(self.p_value < FALSE_ALARM)
        return outliers[np.argsort(-self.ratio[outliers], kind="stable")]

    @property
    def bounded_weights(self) -> FloatArray:
        """Weights by which an outlier counts no more than the largest error that is none, (n_readings,)."""
        beyond = self.ratio > self.limit
        return np.where(beyond, (self.limit / np.where(beyond, self.ratio, 1.0)) ** 2, 1.0)


def studentised(
    residuals: FloatArray,
    span: FloatArray | Span,
    reading: IntArray,
    widths: IntArray,
    weights: FloatArray,
    freedom: float,
    scale: float | None = None,
) -> StudentisedErrors:
    """Return the studentised residual of every reading.

    Args:
        residuals: Whitened, (n_rows,); zero for rows that were not read.
        span: J T of the rows, with T of `calib.core.numerics.observability`, (n_rows, rank).
        reading: Reading of each row, (n_rows,).
        widths: Number of rows that were read, (n_readings,).
        weights: w of the module docstring, (n_readings,).
        freedom: Degrees of freedom of the fit.
    """
    size, leverages, largest = np.empty((3, len(widths)))
    for rows in blocks_of_equal_length(reading):
        own, number = span[rows], reading[rows[:, 0]]
        leverage = np.matmul(own, own.transpose(0, 2, 1))
        decided, vectors = linalg.eigh(leverage)
        values = 1.0 + (1.0 - 2.0 * weights[number])[:, None] * decided
        turned = np.matmul(vectors.transpose(0, 2, 1), residuals[rows][:, :, None])[:, :, 0]
        squares = np.where(values > _SMALLEST, turned**2 / np.maximum(values, _SMALLEST), 0.0)
        size[number] = np.sqrt(np.sum(squares, axis=1))
        leverages[number] = np.sum(decided, axis=1) / widths[number]
        largest[number] = decided[:, -1]
    scale = float(np.median(size / median_length(widths))) if scale is None else scale
    scale = max(scale, _NO_NOISE)
    ratio = size / scale
    left, rare = max(freedom / 2.0, 1.0), FALSE_ALARM / max(len(widths), 1)
    chance = np.asarray(scipy.special.fdtrc(widths, left, ratio**2 / widths))
    limit = _values_by_width(lambda k: float(np.sqrt(k * scipy.special.fdtri(k, left, 1.0 - rare))), widths)
    return StudentisedErrors(ratio, leverages, largest, chance, limit, scale)
