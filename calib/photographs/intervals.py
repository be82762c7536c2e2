"""How far camera, board and lens may be off: with errors of single images, and with those that follow the robot's
pose.

Estimates are least squares with weights W, x = A^-1 J^T W r with A = J^T W J + P. Residuals have the covariance
V = s^2 I + G S^2 G^T + s_a^2 H H^T (`calib.photographs.shared_errors`), H = G N the columns of the arm's errors. So

    cov x = A^-1 (s^2 J^T W W J + J^T W G S^2 G^T W J + s_a^2 J^T W H H^T W J + P) A^-1

The estimate is that of W; only the intervals know of the arm. J^T W H is what its errors do to camera and board,
whether or not residuals show them. The size s_a is found from what they show: the part of the residuals that follows
the pose. The rest is s_t and s_r, found anew beside it.

That the four sizes are found from the data widens intervals by Student's t with Satterthwaite's degrees of freedom: 2
v^2 / (g^T C g) for a variance v with gradient g by the logarithms of the sizes, and C the inverse of half the
curvature of the criterion.

What it is of. C and M are places in the real flange and the real base of the robot; residuals alone would tell only
which C and M go best with its nominal poses.

When it fails. An arm of another kind, poses not in its base, errors that grow with the load or in one joint's gear
alone.

Reference: satterthwaite1946.
"""

from __future__ import annotations

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.numerics import linalg
from calib.photographs.scene import ImageSums
from calib.photographs.shared_errors import (
    ErrorSizes,
    IntrinsicsPrior,
    criterion,
    differences,
    find_noise,
    gains,
    known_sizes,
    logarithms,
    normal_equations,
)

_STEP = 1e-3  # of logarithms, for differences
_MANY = 1e6  # degrees of freedom: as good as known


def intervals(
    linear: ImageSums,
    twists: FloatArray,
    weights: ErrorSizes,
    near: ErrorSizes,
    prior: IntrinsicsPrior | None,
    now: FloatArray,
) -> tuple[float, FloatArray, FloatArray]:
    """Return the size of the arm's errors, the covariance of what is sought (k, k), and degrees of freedom (k,).

    Args:
        linear: Sums over images at the solution.
        twists: How each error of the arm moves the tool, (n, 6, 24).
        weights: What images are weighed by.
        near: Sizes of the errors without those of the arm.
        prior: Of the intrinsics that are sought.
        now: These, as they are, (f,).
    """
    wide = linear.with_arm(twists)
    noise = find_noise(wide, prior, now, near)
    logs = logarithms(noise, wide)
    inverse = np.linalg.inv(normal_equations(linear, weights, prior, now)[0])
    weighed = linear.jg @ gains(linear, weights)
    by_pixel = linear.jj - 2 * weighed @ linear.jg.transpose(0, 2, 1) + weighed @ linear.gg @ weighed.transpose(0, 2, 1)
    pixels = np.sum(by_pixel, axis=0) / weights.pixel**4
    by_image = (linear.jg - weighed @ linear.gg) / weights.pixel**2
    by_arm = np.sum(by_image @ twists, axis=0)
    held = np.zeros(len(inverse))
    if prior is not None:
        held[12 : 12 + len(now)] = 1.0 / prior.sigma**2

    def covariance_of(at: FloatArray) -> FloatArray:
        pixel, shift, turn, arm = np.exp(2 * at)
        images = np.sum((by_image * np.repeat([shift, turn], 3)) @ by_image.transpose(0, 2, 1), axis=0)
        return inverse @ (pixel * pixels + images + arm * by_arm @ by_arm.T + np.diag(held)) @ inverse

    covariance, sizes = covariance_of(logs), known_sizes(logs)
    _, curvature = differences(lambda at: criterion(wide, at, prior, now), logs, sizes)
    unit = np.eye(len(logs))[sizes] * _STEP
    slopes = [(np.diag(covariance_of(logs + step)) - np.diag(covariance_of(logs - step))) / 2e-3 for step in unit]
    slope = np.array(slopes).reshape(len(sizes), -1)
    variance = np.einsum("ik,ij,jk->k", slope, linalg.pinv(curvature / 2, hermitian=True), slope)
    with np.errstate(over="ignore"):  # sizes that are known exactly
        freedom = np.where(variance > 0, 2 * np.diag(covariance) ** 2 / np.maximum(variance, 1e-300), _MANY)
    return noise.arm, covariance, np.clip(freedom, 1.0, _MANY)
