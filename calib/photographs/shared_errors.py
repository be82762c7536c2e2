"""Sizes of the errors that the points of an image share, and weights of images by these sizes.

Problem. Residuals of image i, to first order, are r_i = J_i x + G_i e_i + noise: x are the unknowns, e_i is an error of
the robot's tool there (6 components), and the noise of pixels is independent. With S = diag(s_t s_t s_t s_r s_r s_r),

    cov r_i = V_i = s^2 I + G_i S^2 G_i^T,   V_i^-1 = (I - G_i K_i G_i^T) / s^2,   K_i = S (s^2 I + S G_i^T G_i S)^-1 S

so that weighted least squares needs only sums over the points of each image (`calib.photographs.scene`):

    A = sum of (J^T J - J^T G K G^T J) / s^2 + P,        b = sum of (J^T r - J^T G K G^T r) / s^2 + P (x - x_prior)

(P: priors of intrinsics). Gauss-Newton steps are x -= A^-1 b. The three sizes s, s_t, s_r come from restricted maximum
likelihood: they minimise

    sum of log det V_i  +  log det A  +  r^T V^-1 r - b^T A^-1 b

by L-BFGS in their logarithms from several starts, polished by Newton steps so that only rounding is left in the last
digits. An exact robot gets s_t = s_r = 0.

Errors that follow the pose. The errors k of an arm (`calib.photographs.intervals`) are the same at all images,
e_i + N_i k with k ~ N(0, s_a^2 I). They are further columns G_i N_i of J with the prior 1 / s_a^2 in P. The same A and
b then solve for both, and the criterion gains log det of the prior's covariance, 2 log s_a for each error.

Reference: patterson1971.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray, IntArray
from calib.core.numerics import linalg
from calib.photographs.scene import ImageSums

_SMALLEST = 1e-8  # s_t [m] and s_r [rad] that count as zero
_FAR = 1e12  # value of a criterion that cannot be computed
_STARTS = ((3e-4, 3e-4), (3e-3, 1e-4), (1e-4, 3e-3))  # s_t [m], s_r [rad]
_ARM_STARTS = (3e-5, 5e-4)  # s_a [m, rad]
_STEP = 1e-4  # step of logarithms for differences
_POLISHED = 3  # Newton steps
_FAR_STEP = 0.5  # step of a logarithm that is not near the minimum


@dataclass(frozen=True)
class ErrorSizes:
    """Sizes (sigmas) of the errors.

    Attributes:
        pixel: Error of a pixel coordinate [px].
        shift, turn: Error of the robot's tool per axis [m], [rad].
        arm: Error of each length [m] and angle [rad] of the arm; zero if not considered.
    """

    pixel: float = 1.0
    shift: float = 0.0
    turn: float = 0.0
    arm: float = 0.0

    @property
    def sizes(self) -> FloatArray:
        """Diagonal of S, (6,)."""
        return np.repeat([self.shift, self.turn], 3)


def gains(linear: ImageSums, noise: ErrorSizes) -> FloatArray:
    """Return K_i of the module docstring, (n, 6, 6)."""
    s = noise.sizes
    inner = noise.pixel**2 * np.eye(6) + s[:, None] * linear.gg * s
    return s[:, None] * np.linalg.solve(inner, np.broadcast_to(np.diag(s), inner.shape))


def _weight(linear: ImageSums, noise: ErrorSizes) -> FloatArray:
    """The diagonal of P, (k,)."""
    weight = linear.weight.copy()
    if linear.n_arm:
        weight[-linear.n_arm :] = 1.0 / noise.arm**2
    return weight


def normal_equations(linear: ImageSums, noise: ErrorSizes) -> tuple[FloatArray, FloatArray, float]:
    """Return A (k, k), b (k,) and r^T V^-1 r with the prior's part; see the module docstring."""
    gain, square = gains(linear, noise), noise.pixel**2
    weight, off = _weight(linear, noise), linear.off
    jgk = linear.jg @ gain
    a = np.sum(linear.jj - jgk @ linear.jg.transpose(0, 2, 1), axis=0) / square + np.diag(weight)
    b = np.sum(linear.jr - np.einsum("nab,nb->na", jgk, linear.gr), axis=0) / square + weight * off
    c = float(np.sum(linear.rr - np.einsum("na,nab,nb->n", linear.gr, gain, linear.gr))) / square
    return a, b, c + float(np.sum(weight * off**2))


def deviance(linear: ImageSums, noise: ErrorSizes) -> float:
    """Return minus twice the log-likelihood at the best step of a linear problem, up to a constant."""
    a, b, c = normal_equations(linear, noise)
    return _log_v(linear, noise) + c - float(b @ linalg.lstsq(a, b, rcond=1e-12))


def _log_v(linear: ImageSums, noise: ErrorSizes) -> float:
    """Sum of log det V_i, plus log det of the prior covariance of the arm's errors."""
    s = noise.sizes
    inner = np.eye(6) + s[:, None] * linear.gg * s / noise.pixel**2
    own = float(np.sum(np.linalg.slogdet(inner)[1]) + 2 * np.sum(linear.n_rows) * np.log(noise.pixel))
    return own + (2 * linear.n_arm * float(np.log(noise.arm)) if linear.n_arm else 0.0)


def criterion(linear: ImageSums, logs: FloatArray) -> tuple[float, FloatArray]:
    """Return minus twice the restricted log-likelihood of the logarithms of sizes (3,) or (4,), and its gradient.

    With Q = V^-1 - V^-1 J A^-1 J^T V^-1 the gradient by the logarithm of a size whose errors move residuals by H is
    2 s_h^2 (tr(H^T Q H) - |H^T Q r|^2).
    """
    noise = _noise_of(logs)
    a, b, c = normal_equations(linear, noise)
    if not np.all(np.diag(a) > 0):  # rounding, for sizes far from possible ones
        return _FAR, np.zeros(len(logs))
    scale = 1.0 / np.sqrt(np.diag(a))
    inverse = scale[:, None] * np.linalg.inv(scale[:, None] * a * scale) * scale
    log_a = float(np.linalg.slogdet(scale[:, None] * a * scale)[1] - 2 * np.sum(np.log(scale)))
    step, weight, off = -inverse @ b, _weight(linear, noise), linear.off
    left = (np.eye(6) - linear.gg @ gains(linear, noise)) / noise.pixel**2  # G^T V^-1 = left G^T
    by_unknowns = left @ linear.jg.transpose(0, 2, 1)
    traces = np.diagonal(left @ linear.gg - by_unknowns @ inverse @ by_unknowns.transpose(0, 2, 1), axis1=1, axis2=2)
    pulls = np.einsum("nab,nb->na", left, linear.gr) + by_unknowns @ step
    robot = 2 * noise.sizes**2 * np.sum(traces - pulls**2, axis=0)
    reached = weight @ (np.diag(inverse) - (off + step) ** 2)  # the priors' part of degrees of freedom and squares
    pixel = 2 * (float(np.sum(linear.n_rows)) - len(a) + reached - c - b @ step) + 4 * weight @ (off + step) ** 2
    pixel -= np.sum(robot)
    gradient = [pixel, np.sum(robot[:3]), np.sum(robot[3:])]
    if linear.n_arm:
        arm = slice(-linear.n_arm, None)
        gradient.append(2 * linear.n_arm - 2 * np.sum(weight[arm] * (np.diag(inverse)[arm] + step[arm] ** 2)))
    return _log_v(linear, noise) + log_a + c + float(b @ step), np.array(gradient)


def curvature(linear: ImageSums, logs: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the sizes above the smallest, (k,), and second derivatives of the criterion by these, (k, k)."""
    free = np.flatnonzero(np.exp(logs) > 30 * _SMALLEST)
    unit = np.eye(len(logs))[free] * _STEP
    ends = [[criterion(linear, logs + sign * step)[1][free] for sign in (1, -1)] for step in unit]
    slopes = np.array([ahead - back for ahead, back in ends]).reshape(len(free), len(free)) / (2 * _STEP)
    return free, (slopes + slopes.T) / 2


def logarithms(noise: ErrorSizes, linear: ImageSums) -> FloatArray:
    """Return the logarithms of sizes, (3,), or (4,) with errors of the arm."""
    sizes = [noise.pixel, noise.shift, noise.turn, noise.arm][: 4 if linear.n_arm else 3]
    return np.log(np.maximum(sizes, 0.3 * _SMALLEST))


def _noise_of(logs: FloatArray) -> ErrorSizes:
    pixel, shift, turn, *arm = map(float, np.exp(logs))
    return ErrorSizes(pixel, 0.0 if shift < _SMALLEST else shift, 0.0 if turn < _SMALLEST else turn, *arm)


def find_noise(linear: ImageSums, near: ErrorSizes | None = None) -> ErrorSizes:
    """Return the sizes of the errors by restricted maximum likelihood; `near` are first values.

    The size of the arm's errors is estimated if `linear` has such columns.
    """
    low = logarithms(ErrorSizes(1e-3), linear)
    bounds = list(zip(low, np.log([1e3, 0.1, 0.1, 0.1]), strict=False))
    rough = np.sqrt(float(np.sum(linear.rr)) / max(float(np.sum(linear.n_rows)) - linear.jr.shape[1], 1.0))
    pixel = np.clip(rough / 2, 2e-3, 500.0)
    starts = [np.log([pixel, *start]) for start in _STARTS] if near is None else []
    if near is not None:
        starts = [np.log(np.maximum([near.pixel, near.shift, near.turn], [1e-3, 1e-6, 1e-6]))]
    if linear.n_arm:
        starts = [np.append(start, np.log(arm)) for start in starts for arm in _ARM_STARTS]

    cost = partial(criterion, linear)
    ends = [scipy.optimize.minimize(cost, start, jac=True, method="L-BFGS-B", bounds=bounds) for start in starts]
    at = np.asarray(min(ends, key=lambda end: end.fun).x)
    for _ in range(_POLISHED):
        free, slopes = curvature(linear, at)
        if len(free) == 0 or linalg.eigvalsh(slopes)[0] <= 1e-6:
            break
        step = np.linalg.solve(slopes, cost(at)[1][free])
        if np.max(np.abs(step)) > _FAR_STEP:
            break
        at[free] -= step
    return _noise_of(np.maximum(at, low))
