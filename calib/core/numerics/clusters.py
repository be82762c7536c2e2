"""The scatter of a solution where rows of one block share errors of any shape.

Least squares with span U = J T (`calib.core.numerics.observability`: H = U U^T is the hat matrix, priors included)
moves its solution, in the coordinates of T, by U^T e for errors e. Errors that are independent from row to row, with
variance f^2, scatter it by f^2 U^T U. Where the rows of a block (the readings of a pose, the poses of a region) share
errors, it scatters by the sum over blocks of U_b^T V_b U_b, with V_b the covariance of the errors of a block. V_b need
not be known: the residuals of each block are one draw of its errors. The solution follows them a little, so that for
independent errors cov r_b = f^2 (1 - H_b), H_b = U_b U_b^T. With

    g_b = U_b^T (1 - H_b)^(-1/2) r_b          core = sum over blocks of g_b g_b^T

the core has the mean f^2 U^T U where errors are independent. Where they are not, its mean is right up to the leverage
of single blocks (Bell and McCaffrey's CR2). Directions that a block decides nearly alone leave no residual; there the
noise of the rows counts.

Test. With eigenvalues w of all H_b and y = r / f

    D = sum over blocks of |g_b|^2 / f^2        mean of D = sum of w
    variance of D = 2 (sum of w^2 + sum over b != c of tr(W_b W_c)),       W_b = U_b^T H_b (1 - H_b)^-1 U_b

for independent errors; D over its mean is compared with F of the same mean and variance. Standard deviations that
suppose independent rows are too small by the root of D over its mean. D also measures how far parameters move when
blocks are left out in turn: with u the parameters of the fit, u_b without block b, and A_b the information without it,
D f^2 = sum over blocks of (u - u_b)^T A_b (u - u_b). No further fit is needed.

When it fails. A core of few blocks is uncertain: `freedom` counts the squares behind one of its directions. An error
that all blocks share alike moves nothing. Places unlike all blocks can be worse.

Reference: bell2002; cook1982, chapter 3; roberts2017.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray, IntArray, ReadOnlyArrays
from calib.core.numerics import linalg
from calib.core.numerics.tall import Span

_OWN = 0.99  # if a block decides this part of a direction, the other blocks cannot predict it
_ROWS_AT_ONCE = 30_000
_NONE = 1e-150  # noise of data that were computed, not measured


@dataclass(frozen=True, eq=False)
class Scatter(ReadOnlyArrays):
    """Scatter of the rows of blocks.

    Attributes:
        ratio: Root of D of the module docstring over its mean; NaN without noise, or where no block shares a direction
            with another one.
        chance: Chance of a D at least this large from independent rows.
        freedom: Number of squares behind a direction of the core.
        total_freedom: Number of squares behind D.
        core: Covariance of U^T e, (k, k).
    """

    ratio: float
    chance: float
    freedom: float
    total_freedom: float
    core: FloatArray

    def ratio_to(self, finer: Scatter) -> tuple[float, float]:
        """Return the ratio of this scatter to that of smaller blocks inside these, and its chance if both are alike."""
        ratio = self.ratio / finer.ratio
        return ratio, float(scipy.special.fdtrc(self.total_freedom, finer.total_freedom, ratio**2))


def scatter(
    span: FloatArray | Span, residuals: FloatArray, noise: FloatArray, block: IntArray, freedom: float
) -> Scatter:
    """Return the scatter of the rows of blocks.

    Args:
        span: U = J T of whitened rows, (n_rows, k).
        residuals: r, whitened, (n_rows,).
        noise: f of each row, (n_rows,).
        block: Block of each row, (n_rows,); -1 for rows that belong to none.
        freedom: Degrees of freedom of the estimate of f.
    """
    k, noisy = span.shape[1], False
    core, all_moved = np.zeros((2, k, k))  # `all_moved` is the sum of all W_b
    square = mean = squares = decided = fourth = 0.0
    for rows in blocks_of_equal_length(block):
        values, errors, turned = directions(span[rows], residuals[rows])
        size = np.sqrt(np.mean(noise[rows] ** 2, axis=1, keepdims=True))
        decided += float(np.sum(values))
        fourth += float(2.0 * np.sum(values**2) + np.sum(np.sum(values, axis=1) ** 2))
        alone = values >= _OWN
        w = np.where(alone, 0.0, values)
        gain = w / (1.0 - w)
        square += float(np.sum(gain * (errors / np.maximum(size, _NONE)) ** 2))
        mean += float(np.sum(w))
        squares += float(np.sum(w**2) - np.sum((gain * w) ** 2))
        flat = turned.reshape(-1, k)
        all_moved += flat.T @ (gain.reshape(-1, 1) * flat)
        pulls = np.matmul(np.where(alone, 0.0, errors / np.sqrt(1.0 - w))[:, None], turned)[:, 0]
        by_noise = (size[..., None] * turned)[alone]
        core += pulls.T @ pulls + by_noise.T @ by_noise
        noisy = noisy or bool(np.any(size > _NONE))
    half_variance = squares + float(np.sum(all_moved**2))
    behind = decided**2 * (k + 2) / (k * fourth) if fourth > 0.0 else 0.0
    if not (noisy and mean > 0.0 and half_variance > 0.0):
        return Scatter(float("nan"), 1.0, behind, 0.0, core)
    total_freedom = mean**2 / half_variance
    chance = float(scipy.special.fdtrc(total_freedom, freedom, square / mean))
    return Scatter(float(np.sqrt(square / mean)), chance, behind, total_freedom, core)


def blocks_of_equal_length(block: IntArray) -> Iterator[IntArray]:
    """Yield rows of blocks of equal length, some blocks at once, (n_blocks, n_rows_of_each), without block -1."""
    order: IntArray | None = None
    if np.any(block[1:] < block[:-1]) or np.any(block[:1] < 0):
        order = np.argsort(block, kind="stable")
        order = order[np.count_nonzero(block < 0) :]
        block = block[order]
    first = np.flatnonzero(np.append(np.ones(min(len(block), 1), dtype=bool), block[1:] != block[:-1]))
    counts = np.diff(first, append=len(block))
    for count in np.flatnonzero(np.bincount(counts)).tolist():
        starts = first[counts == count]
        at_once = max(_ROWS_AT_ONCE // count, 1)
        for k in range(0, len(starts), at_once):
            places = starts[k : k + at_once, None] + np.arange(count)
            yield places if order is None else order[places]


def directions(span: FloatArray, residuals: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return eigenvalues w of H_b, residuals along its eigenvectors l, and l^T U_b: (..., d), (..., d), (..., d, k).

    U of the rows of each block is (..., m, k), and residuals are (..., m).
    """
    n_rows, k = span.shape[-2:]
    across, errors = np.swapaxes(span, -1, -2), residuals[..., None]
    if n_rows <= k:
        values, vectors = linalg.eigh(np.matmul(span, across))
        turned = np.swapaxes(vectors, -1, -2)
        return np.clip(values, 0.0, 1.0), np.matmul(turned, errors)[..., 0], np.matmul(turned, span)
    values, vectors = linalg.eigh(np.matmul(across, span))
    values, turned = np.clip(values, 0.0, 1.0), np.swapaxes(vectors, -1, -2)
    size = np.sqrt(values)
    components = np.matmul(turned, np.matmul(across, errors))[..., 0]
    errors = np.where(size > 0, components / np.where(size > 0, size, 1.0), 0.0)
    return values, errors, size[..., None] * turned


def shifts_without_block(
    span: FloatArray | Span,
    block: IntArray,
    residuals: FloatArray,
    *,
    seen: FloatArray | Span | None = None,
    alone: float = _OWN,
) -> tuple[FloatArray, FloatArray]:
    """Return how far rows move where their own block is left out, (n_rows,), and its largest w, (n_blocks,).

    Leaving out block b moves the solution by U_b^T (1 - H_b)^-1 r_b in the coordinates of T. Residuals of block b by
    the fit of all others are (1 - H_b)^-1 r_b.

    Args:
        span: U = J T of whitened rows of the fit, (n_rows, k).
        block: Block of each row, (n_rows,); -1 for rows that belong to none, which do not move.
        residuals: r, whitened, (n_rows,).
        seen: U without the weights of a robust loss, (n_rows, k), of the rows that move; U if not given.
        alone: Nothing moves along a direction of which a block decides at least this part.
    """
    moved, largest = np.zeros(len(residuals)), np.zeros(int(block.max(initial=-1)) + 1)
    for rows in blocks_of_equal_length(block):
        own = span[rows]
        values, errors, turned = directions(own, residuals[rows])
        gain = np.where(values < alone, 1.0 / np.maximum(1.0 - values, 1.0 - alone), 0.0)
        step = np.matmul(turned.transpose(0, 2, 1), (gain * errors)[:, :, None])
        moved[rows] = np.matmul(own if seen is None else seen[rows], step)[:, :, 0]
        largest[block[rows[:, 0]]] = values[:, -1]
    return moved, largest
