"""Robust losses: how much a measured point counts, given how far it is from where the fit puts it.

A point is one target at one pose: three coordinates with the same noise. With d = |r| / scale the length of its
residual over a scale found from the data, its squares count with the weight

    none     1
    huber    min(1, c / d)
    cauchy   1 / (1 + (d/c)^2)
    tukey    (1 - (d/c)^2)^2 for d < c, else 0

Whole points are weighed, not coordinates, so that the result does not depend on how the measurement frame is turned.
The constants c lose 5 % of the information of normal data, for three coordinates: with w' = dw/dd and E over the chi
distribution of d with k degrees of freedom, the efficiency is

    m^2 / b       m = E[w + w' d / k],   b = E[w^2 d^2] / k

(for k = 1 this gives the usual 1.345, 2.385 and 4.685). The noise that goes with the weights:

    scale       median(|r|) / median of chi(3), times sqrt(rows / (rows - n_eff))
    sigma^2     sum w |r|^2 / (3 sum w), over its expectation for normal data with sigma 1; rows that a weight of zero
                takes out do not count as rows
    effective   K b / m from the actual residuals: what normal noise would scatter the parameters as much (Huber's K)

When it fails. Outliers in more than about a third of the points, or in points that alone decide a parameter: then the
fit follows them. A robust loss does not make systematic errors go away.

Reference: huber1981, sections 7.6 and 8.8; maronna2019, chapter 6.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Literal, get_args

import numpy as np
from scipy.integrate import quad
from scipy.stats import chi

from calib.errors import InputError, nearest
from calib.model.mechanism import FloatArray
from calib.numerics.statistics import Noise, require_freedom

Loss = Literal["none", "huber", "cauchy", "tukey"]
LOSSES: tuple[Loss, ...] = get_args(Loss)
COORDINATES = 3
CONSTANTS: dict[Loss, float] = {"none": np.inf, "huber": 1.6279879, "cauchy": 2.6655684, "tukey": 5.4902492}
"""c of the module docstring for points of three coordinates."""
_MEDIAN = float(chi(COORDINATES).median())


def checked_loss(name: str) -> Loss:
    """Return the loss of this name; an unknown one is an `InputError`."""
    for loss in LOSSES:
        if loss == name:
            return loss
    raise InputError(f"loss '{name}'{nearest(name, LOSSES)}")


def weights(loss: Loss, distance: FloatArray, constant: float | None = None) -> FloatArray:
    """Return the weight of points at these distances, in units of the scale.

    Args:
        loss: Which one.
        distance: d >= 0, (n_points,); the weights have its shape.
        constant: c; that of three coordinates if not given.
    """
    d, c = np.asarray(distance, dtype=float), CONSTANTS[loss] if constant is None else constant
    if loss == "huber":
        return np.minimum(1.0, c / np.maximum(d, 1e-300))
    if loss == "cauchy":
        return np.asarray(1.0 / (1.0 + (d / c) ** 2))
    if loss == "tukey":
        return np.asarray(np.where(d < c, (1.0 - (d / c) ** 2) ** 2, 0.0))
    return np.ones_like(d)


def slopes(loss: Loss, distance: FloatArray, constant: float | None = None, k: int = COORDINATES) -> FloatArray:
    """Return w + w' d / k, the mean over k coordinates of d(w r)/dr, of distances d (n_points,)."""
    d, c = np.asarray(distance, dtype=float), CONSTANTS[loss] if constant is None else constant
    w = weights(loss, d, c)
    if loss == "huber":
        return np.asarray(np.where(d > c, w * (1.0 - 1.0 / k), w))
    if loss == "cauchy":
        return np.asarray(w - 2.0 * (d / c) ** 2 * w**2 / k)
    if loss == "tukey":
        inside = np.maximum(1.0 - (d / c) ** 2, 0.0)
        return np.asarray(w - 4.0 * (d / c) ** 2 * inside / k)
    return w


def efficiency(loss: Loss, constant: float, k: int = COORDINATES) -> float:
    """Return the part of the information of normal data that a loss keeps."""
    slope = _mean(lambda d: float(slopes(loss, np.array(d), constant, k)), constant, k)
    score = _mean(lambda d: float(weights(loss, np.array(d), constant)) ** 2 * d**2, constant, k) / k
    return slope**2 / score


def scale_of(distances: FloatArray, n_effective: float) -> float:
    """Return the scale [m] of residual lengths, (n_points,) [m]: a median, so that outliers hardly move it."""
    n_rows = COORDINATES * len(distances)
    require_freedom(n_rows - n_effective, n_rows)
    return float(np.median(distances)) / _MEDIAN * float(np.sqrt(n_rows / (n_rows - n_effective)))


def noise(loss: Loss, distances: FloatArray, scale: float, n_effective: float) -> Noise:
    """Return what the residuals say about the noise.

    Args:
        loss: The loss that weighed them.
        distances: Residual lengths with the noise of one reading, (n_points,) [m].
        scale: What they were divided by for the weights [m].
        n_effective: Effective parameters.

    Raises:
        NotIdentifiableError: The loss leaves no degrees of freedom.
    """
    n_rows = COORDINATES * len(distances)
    w, slope = weights(loss, distances / scale), slopes(loss, distances / scale)
    mean_weight, mean_square = _normal_moments(loss)
    counted = min(float(n_rows), COORDINATES * float(np.sum(w)) / mean_weight)
    freedom = counted - n_effective
    require_freedom(freedom, n_rows)
    ratio = float(np.sum(w * distances**2) / (COORDINATES * np.sum(w))) / (mean_square / mean_weight)
    sigma = float(np.sqrt(ratio * counted / freedom))
    score = float(np.sqrt(np.sum(w**2 * distances**2) / (n_rows - n_effective)))
    m = float(np.mean(slope))
    if m <= 0:
        require_freedom(0.0, n_rows)
    correction = 1.0 + n_effective / n_rows * float(np.var(slope)) / m**2
    return Noise(sigma, freedom, correction * score / m, m)


@lru_cache
def _normal_moments(loss: Loss) -> tuple[float, float]:
    """E[w] and E[w d^2] / 3 for normal points of sigma 1."""
    c = CONSTANTS[loss]
    return (
        _mean(lambda d: float(weights(loss, np.array(d))), c, COORDINATES),
        _mean(lambda d: float(weights(loss, np.array(d))) * d**2, c, COORDINATES) / COORDINATES,
    )


def _mean(function: Callable[[float], float], constant: float, k: int) -> float:
    """Mean over the chi distribution with k degrees of freedom; `constant` is where the integrand may have a kink."""
    density = chi(k).pdf
    middle = min(constant, 15.0)
    inner, _ = quad(lambda d: function(d) * density(d), 0.0, middle)
    outer, _ = quad(lambda d: function(d) * density(d), middle, 30.0)
    return float(inner + outer)
