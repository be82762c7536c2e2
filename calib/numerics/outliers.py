"""Outliers: readings that lie further from where the fit puts them than noise explains.

A reading has k whitened rows r with scaled Jacobian B. With h = B C B^T (k x k) its leverage on its own prediction, C
the covariance of the parameters for noise 1, and w its weight in the fit (1 without a robust loss, 0 outside the fit),
the residual of normal data has

    cov r = f^2 V,      V = I + (1 - 2 w) h      (I - h for a reading that was used, I + h for one that was not)

so that T^2 = r^T V^-1 r is the studentised residual: the same for a reading that pulls the fit towards itself as for
one that does not. T / median of chi(k) is compared with a scale that outliers hardly move, its median over the
readings. A reading is an outlier where k F(k, nu/2) exceeds (T / scale)^2 with a chance below 1 % over the number of
readings: good measurements of any number show one in a set out of a hundred. (nu/2, because a median finds a scale
about half as well as the squares.)

Leverage is trace(h)/k: the part of a reading's own error that its prediction follows, the mean over its rows; leverages
of all rows add up to the effective parameters. The largest eigenvalue of h is the same for the direction in which it is
worst. Near 1 a reading cannot be judged there.

When it fails. Several outliers that agree with each other pull a least-squares fit to them; fit with a robust loss to
see them. A reading of leverage near 1 is never an outlier.

Reference: cook1982, chapter 2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from calib.arrays import FloatArray, IntArray, ReadOnlyArrays
from calib.numerics.losses import median_length

FALSE_ALARM = 0.01
"""Chance that a set of good measurements shows an outlier."""
HIGH_LEVERAGE = 0.9
"""Largest leverage along any direction, above which a reading decides its own prediction and cannot be judged."""
_SMALLEST = 1e-6  # eigenvalue of V below which a direction has no residual left
_NO_NOISE = 1e-12


@dataclass(frozen=True, eq=False)
class Studentised(ReadOnlyArrays):
    """Every reading of a set judged.

    Attributes:
        ratio: T over its scale, (n_readings,).
        leverage: Mean over the rows, (n_readings,).
        largest_leverage: That of the worst direction, (n_readings,).
        p_value: Chance of such a reading among good measurements of this number, (n_readings,).
        scale: Scale of T.
    """

    ratio: FloatArray
    leverage: FloatArray
    largest_leverage: FloatArray
    p_value: FloatArray
    scale: float

    @property
    def outliers(self) -> IntArray:
        """Readings that are outliers, worst first, (n_outliers,)."""
        found = np.flatnonzero(self.p_value < FALSE_ALARM)
        result: IntArray = found[np.argsort(-self.ratio[found], kind="stable")]
        return result


@dataclass(frozen=True, eq=False)
class Blocks:
    """Readings of equally many rows.

    Attributes:
        residuals: Whitened, (n, k); zero for rows that were not read.
        columns: Whitened scaled Jacobian, (n, k, n_free).
        widths: Rows that were read, (n,).
        weights: w of the module docstring, (n,).
    """

    residuals: FloatArray
    columns: FloatArray
    widths: IntArray
    weights: FloatArray


def studentised(blocks: list[Blocks], root: FloatArray, freedom: float, scale: float | None = None) -> Studentised:
    """Judge every reading.

    Args:
        blocks: Readings, in order.
        root: T of `calib.numerics.information`, (n_free, rank).
        freedom: Degrees of freedom of the fit.
        scale: Scale of T, if it is known from other readings.
    """
    sizes, leverages, largest = [], [], []
    for block in blocks:
        pulled = block.columns @ root
        own = pulled @ pulled.transpose(0, 2, 1)
        values, vectors = np.linalg.eigh(np.eye(own.shape[-1]) + (1.0 - 2.0 * block.weights)[:, None, None] * own)
        turned = np.matmul(vectors.transpose(0, 2, 1), block.residuals[:, :, None])[:, :, 0]
        squares = np.where(values > _SMALLEST, turned**2 / np.maximum(values, _SMALLEST), 0.0)
        sizes.append(np.sqrt(np.sum(squares, axis=1)))
        leverages.append(np.trace(own, axis1=1, axis2=2) / block.widths)
        largest.append(np.linalg.eigvalsh(own)[:, -1])
    size, widths = np.concatenate(sizes), np.concatenate([block.widths for block in blocks])
    found = float(np.median(size / median_length(widths))) if scale is None else scale
    found = max(found, _NO_NOISE)
    ratio = size / found
    p_value = np.minimum(1.0, len(ratio) * scipy.special.fdtrc(widths, max(freedom / 2.0, 1.0), ratio**2 / widths))
    return Studentised(ratio, np.concatenate(leverages), np.concatenate(largest), p_value, found)
