"""Blocks of poses left out in turn: whether parameters move by more than noise explains.

What a model leaves out pulls the parameters to where they fit the poses at hand; other poses pull them elsewhere. Their
covariance knows of noise alone. With the scaled parameters u of a fit, those u_b of the fit without a block b, and the
information A_b that the fit has without it (priors included),

    D = sum over blocks of (u - u_b)^T A_b (u - u_b)

Leaving out needs no fit. With U the span of the fit (`Residuals.pulled`: H = U U^T is its hat matrix, priors included),
residuals r for noise 1, and w, v the eigenvalues and eigenvectors of U_b^T U_b, the part of each direction that the
block decides,

    D = sum over blocks and directions of (v^T U_b^T r_b)^2 / (1 - w)

By noise and priors alone cov r = 1 - H, and with W_b = sum over directions of v v^T w^2 / (1 - w)

    mean of D = sum of w        variance of D = 2 (sum of w^2 + sum over b != c of tr(W_b W_c))

The sum of w is the number of effective parameters: the root of D over its mean says how many times too small standard
deviations are. D is compared with F of the same mean and variance. Directions that a block decides alone (the place of
its own setup) can be foretold by no other block, and are left aside.

When it fails. What is off in the same way in every block moves nothing. Places unlike all blocks can be worse.

Reference: cook1982, chapter 3 (influence of several cases); roberts2017.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from calib.arrays import IntArray
from calib.identification.systematic import Residuals
from calib.threads import one_blas_thread

_OWN = 0.99
"""Part of a direction that a block decides, from which the others cannot foretell it."""


@dataclass(frozen=True)
class LeftOut:
    """What leaving out blocks showed.

    Attributes:
        ratio: How many times as much as by noise the parameters move, root mean square; NaN where no block shares any.
        chance: Chance of as much from noise.
    """

    ratio: float
    chance: float


@one_blas_thread
def left_out(fit: Residuals, blocks: Sequence[IntArray]) -> LeftOut:
    """Return by how much more than noise explains parameters move.

    Args:
        fit: The fit.
        blocks: Visits of each block, (n_in_block,).
    """
    layout, span = fit.rows.layout, fit.pulled
    residuals, visit = fit.rows.residuals / fit.factor, layout.visit[layout.reading]
    size = span.shape[1]
    moved = mean = own = 0.0
    shared = np.zeros((size, size))
    for block in blocks:
        rows = np.isin(visit, block)
        part = span[rows]
        factor = part if len(part) <= size else np.linalg.qr(part, mode="r")
        _, values, directions = np.linalg.svd(factor, full_matrices=False)
        w, v = values[values**2 < _OWN] ** 2, directions[values**2 < _OWN]
        leverage = w**2 / (1.0 - w)
        moved += float(np.sum((v @ (part.T @ residuals[rows])) ** 2 / (1.0 - w)))
        mean += float(np.sum(w))
        own += float(np.sum(w**2) - np.sum(leverage**2))
        shared += (v.T * leverage) @ v
    half_variance = own + float(np.sum(shared**2))
    if mean <= 0.0 or half_variance <= 0.0:
        return LeftOut(float("nan"), 1.0)
    freedom = mean**2 / half_variance
    return LeftOut(float(np.sqrt(moved / mean)), float(scipy.special.fdtrc(freedom, fit.freedom, moved / mean)))
