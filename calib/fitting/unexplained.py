"""Errors of joints that residuals show beside noise, and that no parameter describes.

Residuals larger than the noise say that something is left out: gears, play, a bending link. Where the robot will be off
by it at another pose is not known; how much, is. It is told as an error of each joint that is another one at each pose,
so that a position feels it by its lever, in the directions in which joints move it:

    covariance of x(q) = B C B^T + delta^2 sum over joints of (s_j dx/dq_j)(s_j dx/dq_j)^T

with delta in rad, s_j the characteristic length of the robot for a joint that slides and 1 for one that turns. With
rows r and their derivatives h_j by the joints, whitened by the noise of an instrument that is known (variance v of a
row, 1 where it is stated), n rows and f degrees of freedom,

    delta^2 = sum of (n r^2 / f - v) / sum over rows and joints of (s_j h_j)^2

Noise is known where it is stated, or where poses were read again: then it is the scatter within a pose, which the model
has no part in. Where neither is so, nothing separates what is left out from noise.

Delta is no part of the covariance of parameters: these are found with residuals as large as they are.

When it fails. A stated noise that is too small counts as an error of the joints. What the parameters took up shows in
no residual: at poses unlike those measured the robot may be further off. Gross errors that a robust loss lets through
count, too.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import scipy

from calib.base.arrays import BoolArray, FloatArray
from calib.numerics.statistics import Statistics
from calib.rows.rows import Layout

_AGAIN = 10
"""Readings beyond the first of their pose from which their scatter tells the noise."""
_HARDLY = 0.05
"""Chance of residuals so large by noise alone below which something is left out, as in `calib.fitting.regions`."""


def unexplained_joint_error(
    layout: Layout, residuals: FloatArray, by_joint: FloatArray, statistics: Statistics
) -> float:
    """Return delta of the module docstring [rad]; 0 where noise explains the residuals, or is not known.

    Args:
        layout: Of the rows.
        residuals: Whitened by the stated noise alone, with the weights of a robust loss, (n_rows,).
        by_joint: Their derivative by the joints, scaled by s_j, whitened likewise, (n_rows, n_joints).
        statistics: Of the fit.
    """
    squares, lever, n_rows, repeats = 0.0, 0.0, 0, np.inf
    for rows, variance, freedom in _known_noise(layout, residuals):
        squares += float(np.sum(residuals[rows] ** 2)) / variance
        lever += float(np.sum(by_joint[rows] ** 2)) / variance
        n_rows += int(np.sum(rows))
        repeats = min(repeats, freedom)
    if lever == 0.0:
        return 0.0
    kept = n_rows * statistics.freedom / layout.n_read
    ratio = squares / kept
    exact = np.isinf(repeats)
    chance = scipy.special.chdtrc(kept, squares) if exact else scipy.special.fdtrc(kept, repeats, ratio)
    return float(np.sqrt(n_rows * (ratio - 1.0) / lever)) if chance < _HARDLY and ratio > 1.0 else 0.0


def _known_noise(layout: Layout, residuals: FloatArray) -> Iterator[tuple[BoolArray, float, float]]:
    """Yield rows whose noise is known, its variance beside the stated one, and how many squares it is known from."""
    for g, group in enumerate(layout.groups):
        rows = layout.group == g
        if group.stated:
            yield rows, 1.0, np.inf
            continue
        component = np.arange(layout.n_rows) - np.searchsorted(layout.reading, layout.reading)
        reader = np.searchsorted(layout.start, layout.reading, side="right")
        places = np.stack([layout.pose_of_row, reader, component])[:, rows]
        same = np.unique(places, axis=1, return_inverse=True)[1].reshape(-1)
        count = np.bincount(same)
        own = residuals[rows] - (np.bincount(same, residuals[rows]) / count)[same]
        freedom = float(np.sum(count - 1))
        variance = float(np.sum(own**2)) / max(freedom, 1.0)
        if freedom >= _AGAIN and variance > 0.0:
            yield rows, variance, freedom
