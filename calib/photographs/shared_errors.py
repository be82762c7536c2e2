"""Sizes of the errors that the points of an image share, and weights of images by them.

Problem. Residuals of image i, to first order, are r_i = J_i x + G_i e_i + noise: x is what is sought, e_i an error of
the robot's tool there (6 components), and the noise of pixels is independent. With S = diag(s_t s_t s_t s_r s_r s_r),

    cov r_i = V_i = s^2 I + G_i S^2 G_i^T,   V_i^-1 = (I - G_i K_i G_i^T) / s^2,   K_i = S (s^2 I + S G_i^T G_i S)^-1 S

so that least squares weighed by it needs only sums over the points of each image (`calib.photographs.scene`):

    A = sum of (J^T J - J^T G K G^T J) / s^2 + P,        b = sum of (J^T r - J^T G K G^T r) / s^2 + P (x - x_prior)

(P: priors of intrinsics). Gauss-Newton steps are x -= A^-1 b. The three sizes s, s_t, s_r come from restricted maximum
likelihood: they make

    sum of log det V_i  +  log det A  +  r^T V^-1 r - b^T A^-1 b

smallest. It is solved by L-BFGS in their logarithms from several starts and polished by Newton steps, so that rounding
alone decides the last digits. A robot that is exact gets s_t = s_r = 0.

Errors that follow the pose. Those of an arm (`calib.photographs.arm_errors`) have one value at all images, e_i + N_i k
with k ~ N(0, s_a^2 I). They are further columns G_i N_i of J with the prior 1 / s_a^2 in P: the same A and b then
solve for both, and the criterion is the same but for log det of the prior's covariance, 2 log s_a for each.

Reference: patterson1971.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray, IntArray, ReadOnlyArrays
from calib.core.numerics import linalg
from calib.photographs.scene import ImageSums

_SMALLEST = 1e-8  # s_t [m] and s_r [rad] that count as none
_FAR = 1e12  # value of a criterion that cannot be computed
_STARTS = ((3e-4, 3e-4), (3e-3, 1e-4), (1e-4, 3e-3))  # s_t [m], s_r [rad]
_ARM_STARTS = (3e-5, 5e-4)  # s_a [m, rad]
_STEP = 1e-3  # step of logarithms, for differences


@dataclass(frozen=True)
class ErrorSizes:
    """Sizes of the errors: of a pixel coordinate [px], and of the robot's tool, per axis [m], [rad].

    Attributes:
        arm: Sigma of each length [m] and angle [rad] of the arm; zero where none are considered.
    """

    pixel: float = 1.0
    shift: float = 0.0
    turn: float = 0.0
    arm: float = 0.0

    @property
    def sizes(self) -> FloatArray:
        """Diagonal of S, (6,)."""
        return np.repeat([self.shift, self.turn], 3)


@dataclass(frozen=True, eq=False)
class IntrinsicsPrior(ReadOnlyArrays):
    """Expected values and sigmas of the sought intrinsics, (k,) each; infinite sigma: nothing is expected."""

    values: FloatArray
    sigma: FloatArray


def gains(linear: ImageSums, noise: ErrorSizes) -> FloatArray:
    """Return K_i of the module docstring, (n, 6, 6)."""
    s = noise.sizes
    inner = noise.pixel**2 * np.eye(6) + s[:, None] * linear.gg * s
    return s[:, None] * np.linalg.solve(inner, np.broadcast_to(np.diag(s), inner.shape))


def normal_equations(
    linear: ImageSums, noise: ErrorSizes, prior: IntrinsicsPrior | None, now: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    """Return A (k, k), b (k,) and r^T V^-1 r with the prior's part; see the module docstring.

    Args:
        linear: Sums over images.
        noise: Sizes of the errors.
        prior: Prior of the intrinsics that are sought.
        now: Present values of these, (k,).
    """
    gain, square = gains(linear, noise), noise.pixel**2
    jgk = linear.jg @ gain
    a = np.sum(linear.jj - jgk @ linear.jg.transpose(0, 2, 1), axis=0) / square
    b = np.sum(linear.jr - np.einsum("nab,nb->na", jgk, linear.gr), axis=0) / square
    c = float(np.sum(linear.rr - np.einsum("na,nab,nb->n", linear.gr, gain, linear.gr))) / square
    if prior is not None and len(now):
        weight = 1.0 / prior.sigma**2
        lens = 12 + np.arange(len(now))
        a[lens, lens] += weight
        b[lens] += weight * (now - prior.values)
        c += float(np.sum(weight * (now - prior.values) ** 2))
    if linear.n_arm:
        arm = len(a) - 1 - np.arange(linear.n_arm)
        a[arm, arm] += 1.0 / noise.arm**2
    return a, b, c


def criterion(linear: ImageSums, logs: FloatArray, prior: IntrinsicsPrior | None, now: FloatArray) -> float:
    """Return minus twice the restricted log-likelihood of the logarithms of sizes, (3,) or (4,), but for a constant."""
    noise = _noise_of(logs)
    a, b, c = normal_equations(linear, noise, prior, now)
    s = noise.sizes
    inner = np.eye(6) + s[:, None] * linear.gg * s / noise.pixel**2
    log_v = float(np.sum(np.linalg.slogdet(inner)[1]) + 2 * np.sum(linear.n_rows) * np.log(noise.pixel))
    if linear.n_arm:
        log_v += 2 * linear.n_arm * np.log(noise.arm)
    if not np.all(np.diag(a) > 0):  # rounding, where the sizes are far from what they can be
        return _FAR
    scale = 1.0 / np.sqrt(np.diag(a))
    scaled = scale[:, None] * a * scale
    log_a = float(np.linalg.slogdet(scaled)[1] - 2 * np.sum(np.log(scale)))
    return log_v + log_a + c - float((scale * b) @ np.linalg.solve(scaled, scale * b))


def logarithms(noise: ErrorSizes, linear: ImageSums) -> FloatArray:
    """Return the logarithms of sizes, (3,), or (4,) with errors of the arm."""
    sizes = [noise.pixel, noise.shift, noise.turn, noise.arm][: 4 if linear.n_arm else 3]
    return np.log(np.maximum(sizes, 0.3 * _SMALLEST))


def _noise_of(logs: FloatArray) -> ErrorSizes:
    pixel, shift, turn, *arm = map(float, np.exp(logs))
    return ErrorSizes(pixel, 0.0 if shift < _SMALLEST else shift, 0.0 if turn < _SMALLEST else turn, *arm)


def find_noise(
    linear: ImageSums, prior: IntrinsicsPrior | None, now: FloatArray, near: ErrorSizes | None = None
) -> ErrorSizes:
    """Return the sizes of the errors by restricted maximum likelihood, the intrinsics sought being `now`, (k,).

    Args:
        linear: Sums over images; with errors of the arm, their size is found too.
        prior: Prior of the intrinsics that are sought.
        now: Present values of these, (k,).
        near: Sizes of a similar problem, to begin with.
    """
    low = logarithms(ErrorSizes(1e-3), linear)
    bounds = list(zip(low, np.log([1e3, 0.1, 0.1, 0.1]), strict=False))

    def cost(logs: FloatArray) -> float:
        return criterion(linear, logs, prior, now)

    rough = np.sqrt(float(np.sum(linear.rr)) / max(float(np.sum(linear.n_rows)) - linear.jr.shape[1], 1.0))
    pixel = np.clip(rough / 2, 2e-3, 500.0)
    starts = [np.log([pixel, *start]) for start in _STARTS] if near is None else []
    if near is not None:
        starts = [np.log(np.maximum([near.pixel, near.shift, near.turn], [1e-3, 1e-6, 1e-6]))]
    if linear.n_arm:
        starts = [np.append(start, np.log(arm)) for start in starts for arm in _ARM_STARTS]
    best = min(
        (scipy.optimize.minimize(cost, start, method="L-BFGS-B", bounds=bounds) for start in starts),
        key=lambda end: end.fun,
    )
    return _noise_of(_polish(cost, np.asarray(best.x), low))


def _polish(cost: Callable[[FloatArray], float], at: FloatArray, low: FloatArray) -> FloatArray:
    """Newton steps by central differences, over sizes that are not at their smallest."""
    for _ in range(4):
        free = known_sizes(at)
        gradient, curvature = differences(cost, at, free)
        values, vectors = linalg.eigh(curvature)
        if len(values) == 0 or values.min() <= 1e-6:
            break
        step = vectors @ ((vectors.T @ gradient) / values)
        if np.max(np.abs(step)) > 0.5:
            break
        at = at.copy()
        at[free] -= step
        if np.max(np.abs(step)) < 1e-9:
            break
    return np.maximum(at, low)


def known_sizes(logs: FloatArray) -> IntArray:
    """Return the numbers of sizes that are not at their smallest, of logarithms (k,)."""
    return np.flatnonzero(np.exp(logs) > 30 * _SMALLEST)


def differences(cost: Callable[[FloatArray], float], at: FloatArray, free: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return gradient (k,) and curvature (k, k) of a cost by some of its arguments, by central differences."""
    h, k = _STEP, len(free)
    gradient, curvature = np.zeros(k), np.zeros((k, k))
    unit = np.eye(len(at))[free] * h
    centre = cost(at)
    ahead = [cost(at + step) for step in unit]
    back = [cost(at - step) for step in unit]
    for i in range(k):
        gradient[i] = (ahead[i] - back[i]) / (2 * h)
        curvature[i, i] = (ahead[i] - 2 * centre + back[i]) / h**2
        for j in range(i):
            corners = [cost(at + a * unit[i] + b * unit[j]) * a * b for a in (1, -1) for b in (1, -1)]
            curvature[i, j] = curvature[j, i] = sum(corners) / (4 * h**2)
    return gradient, curvature
