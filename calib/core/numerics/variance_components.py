"""Size of the noise from the residuals: scales of groups of rows, and errors shared by the rows of a pose.

Model. The rows y of a linear problem with priors are whitened by the stated noise. They have the

    covariance      V = S (I + sum of tau_j^2 h_j h_j^T) S        S = diag(s_g), h_j in units of the scaled rows

with one h_j for each component of the offsets that instruments have at a pose (`calib.core.rows.rows`). s_g is 1
for groups whose noise is stated; the other s_g and the tau_j are found by restricted maximum likelihood: with
A = J^T V^-1 J + P and Q = V^-1 - V^-1 J A^-1 J^T V^-1, every component V_i of V has at the stationary point

    y^T Q V_i Q y = trace(Q V_i)

Each component is repeatedly multiplied by the ratio of the left side to the right side (Förstner's iteration). With one
group this is sigma^2 = |r|^2 / (rows - effective parameters). Components stay positive; an absent component shrinks
towards zero.

Shared errors must be significant: they are used only if they raise twice the restricted log-likelihood by more than
chance does in one of a thousand data sets (a chi-square with as many degrees of freedom as there are h_j). Let C have
the columns tau_j h_j, with the singular value decomposition C = U S V^T pose by pose. Then a function f of the
covariance I + C C^T is I + U (f(1 + S^2) - 1) U^T.

When it fails. The noise of a group is undetermined if the group has fewer rows than parameters that it alone
determines.

Reference: foerstner1979; patterson1971.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy

from calib.core.base.arrays import BoolArray, FloatArray, IntArray
from calib.core.base.errors import NotIdentifiableError
from calib.core.numerics import linalg
from calib.core.numerics.chances import EXACT, UNLIKELY
from calib.core.numerics.identifiability import reduce_rows
from calib.core.numerics.linear_model import LinearModel
from calib.core.numerics.observability import Information

_ROUNDS = 60
_SETTLED = 1e-4
_GONE = 0.03  # a shrinking shared error is dropped below this size, relative to the scales
_CONVERGED = 0.01  # the iteration of a shared error ends once it changes by less than this part


def require_freedom(freedom: float, n_rows: int) -> None:
    """Raise `NotIdentifiableError` unless n_rows measured values leave at least one degree of freedom."""
    if freedom < 1 - 1e-9:
        raise NotIdentifiableError(
            f"{n_rows} measured values for {n_rows - max(freedom, 0.0):.0f} parameters: too few to find the"
            " uncertainty of the result. Measure more poses"
        )


class SharedError:
    """Errors shared by the rows of each block (a visit, or the visits that repeat a pose).

    Args:
        columns: C, (n_rows, n_joints).
        block: Block of each row, (n_rows,).
    """

    def __init__(self, columns: FloatArray, block: IntArray) -> None:
        self._order = np.argsort(block, kind="stable")
        _, self._block, counts = np.unique(block[self._order], return_inverse=True, return_counts=True)
        self._place = np.arange(len(block)) - np.repeat(np.cumsum(counts) - counts, counts)
        self._shape = len(counts), int(counts.max())
        self._columns = self._pack(columns)
        self._left, self._values, self._right = linalg.svd(self._columns, full_matrices=False)

    def _pack(self, rows: FloatArray) -> FloatArray:
        """Rows block by block, filled up with zeros, (n_blocks, most rows, k)."""
        packed = np.zeros((*self._shape, rows.shape[1]))
        packed[self._block, self._place] = rows[self._order]
        return packed

    def _unpack(self, packed: FloatArray) -> FloatArray:
        result = np.empty((len(self._order), packed.shape[2]))
        result[self._order] = packed[self._block, self._place]
        return result

    def whiten(self, rows: FloatArray) -> FloatArray:
        """Return (I + C C^T)^(-1/2) rows, (n_rows,) or (n_rows, k)."""
        return self._stretch(rows, 1.0 / np.sqrt(1.0 + self._values**2))

    def unwhiten(self, rows: FloatArray) -> FloatArray:
        """Return (I + C C^T)^(1/2) rows, (n_rows,) or (n_rows, k), the inverse of `whiten`."""
        return self._stretch(rows, np.sqrt(1.0 + self._values**2))

    def _stretch(self, rows: FloatArray, factors: FloatArray) -> FloatArray:
        """Return rows times a factor along each direction of C in a block, (n_blocks, k)."""
        packed = self._pack(rows[:, None] if rows.ndim == 1 else rows)
        along = np.matmul(self._left.transpose(0, 2, 1), packed)
        packed += np.matmul(self._left, (factors - 1.0)[:, :, None] * along)
        result = self._unpack(packed)
        return result[:, 0] if rows.ndim == 1 else result

    def diagonal(self) -> FloatArray:
        """Return the diagonal of (I + C C^T)^-1, (n_rows,)."""
        loss = self._values**2 / (1.0 + self._values**2)
        kept = 1.0 - np.sum(self._left**2 * loss[:, None, :], axis=2)
        return self._unpack(kept[:, :, None])[:, 0]

    def joint_errors(self, rows: FloatArray) -> FloatArray:
        """Return C^T rows, block by block, (n_blocks, n_joints, k), from (n_rows, k)."""
        return np.matmul(self._columns.transpose(0, 2, 1), self._pack(rows))

    def traces(self) -> FloatArray:
        """Return the diagonal of the sum over blocks of C^T (I + C C^T)^-1 C, (n_joints,)."""
        kept = self._values**2 / (1.0 + self._values**2)
        return np.sum(self._right**2 * kept[:, :, None], axis=(0, 1))

    def squares(self) -> FloatArray:
        """Return the square of each column of C in each block, (n_blocks, n_joints)."""
        return np.sum(self._columns**2, axis=1)

    def variances(self) -> FloatArray:
        """Return the diagonal of I + C C^T, (n_rows,)."""
        return 1.0 + self._unpack(np.sum(self._columns**2, axis=2, keepdims=True))[:, 0]

    def log_determinant(self) -> float:
        """Return log det (I + C C^T)."""
        return float(np.sum(np.log1p(self._values**2)))


@dataclass(frozen=True, eq=False)
class Components:
    """Variance components that were estimated.

    Attributes:
        scales: s_g, (n_groups,).
        shared: tau_j, (n_joints,); 0 without a shared error.
        log_likelihood: Function that returns the restricted log-likelihood, up to a constant.
    """

    scales: FloatArray
    shared: FloatArray
    log_likelihood: Callable[[], float]


def find_scales(model: LinearModel, start: FloatArray, sought: BoolArray) -> Components:
    """Find the scales without a shared error, from the triangular factor of each group's rows.

    Args:
        model: The rows, whitened by the stated noise.
        start: Scales to start from, (n_groups,).
        sought: Mask of the scales to be found, (n_groups,).

    Raises:
        NotIdentifiableError: No degrees of freedom are left.
    """
    members, counts = [model.layout.group == g for g in range(len(start))], model.layout.counts
    factors = [
        model.factor if np.all(rows) else reduce_rows(model.jacobian[rows], model.residuals[rows]) for rows in members
    ]
    scales = start.copy()

    def scaled() -> LinearModel:
        stacked = np.vstack([factor / scale for factor, scale in zip(factors, scales, strict=True)])
        return replace(model, residuals=stacked[:, -1], jacobian=stacked[:, :-1])

    for _ in range(_ROUNDS):
        now = scaled()
        known, step = now.posterior_information, now.step()
        change = np.ones(len(start))
        for g in map(int, np.flatnonzero(sought & (counts > 0))):
            factor = factors[g] / scales[g]
            left = factor[:, :-1] @ step + factor[:, -1]
            freedom = counts[g] - float(np.sum((factor[:, :-1] @ known.root) ** 2))
            change[g] = np.sqrt(float(left @ left) / max(freedom, 0.5))
        scales = np.maximum(scales * change, EXACT / 10)
        if np.all(np.abs(change - 1.0) <= _SETTLED) or np.all((scales < EXACT) | ~sought):
            break
    freedom_left = int(np.sum(counts)) - known.root.shape[1] + float(np.sum(model.prior.times(known.root) ** 2))
    require_freedom(freedom_left, int(np.sum(counts)))

    def log_likelihood() -> float:
        now = scaled()
        step = now.step()
        cost = float(np.sum((now.jacobian @ step + now.residuals) ** 2)) + _prior_cost(model, step)
        determinant = 2.0 * float(np.sum(counts * np.log(scales)))
        return -0.5 * (determinant + now.posterior_information.log_determinant + cost)

    return Components(scales, np.zeros(0), log_likelihood)


def find_components(
    model: LinearModel,
    start: FloatArray,
    sought: BoolArray,
    columns: FloatArray,
    block: IntArray,
    known: FloatArray | None = None,
) -> Components:
    """Find the scales and, if they are significant, errors shared by the rows of each block.

    Args:
        model, start, sought: As in `find_scales`.
        columns: Derivative H0 of the rows by the errors, whitened by the stated noise, (n_rows, n_columns).
        block: Block of each row, (n_rows,).
        known: Approximate sizes of errors that are known to be significant, 0 for the others, (n_columns,).

    Raises:
        NotIdentifiableError: No degrees of freedom are left.
    """
    known = np.zeros(columns.shape[1]) if known is None else known
    if np.any(known > 0):
        without = _with_shared(model, start, sought, known, columns, block)
    else:
        without = replace(find_scales(model, start, sought), shared=known)
    if np.all(without.scales[sought] < EXACT) and np.any(sought):
        return without
    read = model.layout.group >= 0
    sizes = np.sqrt(np.mean(columns[read] ** 2, axis=0))
    level = float(np.sqrt(np.mean(model.residuals[read] ** 2)))
    new = (sizes > 0) & (known == 0)
    needed = float(scipy.special.chdtri(max(int(np.sum(new)), 1), UNLIKELY))
    if not np.any(new) or level == 0 or _rise(model, without, columns, new, block) < 0.5 * needed:
        return without
    guess = 0.5 * level / np.maximum(sizes, 1e-300) / np.sqrt(np.sum(new))
    tried = _with_shared(model, without.scales, sought, np.where(new, guess, without.shared), columns, block)
    earned = 2.0 * (tried.log_likelihood() - without.log_likelihood()) > needed
    exact = np.any(tried.scales[sought] < EXACT)  # copies of one reading share all of their error
    return tried if earned and not exact else without


def _rise(model: LinearModel, components: Components, columns: FloatArray, new: BoolArray, block: IntArray) -> float:
    """Estimated rise of twice the log-likelihood by new errors: the sum of squares of their positive scores.

    The score of tau_j^2 at zero is half of (h_j^T Q y)^2 - trace(Q h_j h_j^T); correlations of scores are not negative.
    """
    read = model.layout.group >= 0
    divisor = np.where(read, components.scales[np.where(read, model.layout.group, 0)], 1.0)
    shared = SharedError(columns * components.shared / divisor[:, None], block)
    n_free = model.jacobian.shape[1]
    white = shared.whiten(np.hstack([model.jacobian, model.residuals[:, None], columns[:, new]]) / divisor[:, None])
    known, step = _solve_by_cholesky(model, white[:, : n_free + 1])
    tried = SharedError(white[:, n_free + 1 :], block)
    squares = np.sum(tried.joint_errors((white[:, :n_free] @ step + white[:, n_free])[:, None]) ** 2, axis=(0, 2))
    sizes = tried.squares()
    traced = np.sum(sizes, axis=0) - np.sum(tried.joint_errors(white[:, :n_free] @ known.root) ** 2, axis=(0, 2))
    scores = (squares - traced) / np.sqrt(2.0 * np.sum(sizes**2, axis=0))
    return float(np.sum(np.maximum(scores, 0.0) ** 2))


def _with_shared(
    model: LinearModel, start: FloatArray, sought: BoolArray, tau: FloatArray, columns: FloatArray, block: IntArray
) -> Components:
    read = model.layout.group >= 0
    number = np.where(read, model.layout.group, 0)
    n_groups = len(start)
    scales, likelihood = start.copy(), -np.inf
    for _ in range(_ROUNDS):
        divisor = np.where(read, scales[number], 1.0)
        shared = SharedError(columns * tau / divisor[:, None], block)
        rows, residuals = model.jacobian / divisor[:, None], model.residuals / divisor
        white = shared.whiten(np.hstack([rows, residuals[:, None]]))
        known, step = _solve_by_cholesky(model, white)
        cost = float(np.sum((white[:, :-1] @ step + white[:, -1]) ** 2)) + _prior_cost(model, step)
        determinant = 2.0 * float(np.sum(np.log(divisor[read]))) + shared.log_determinant()
        likelihood = -0.5 * (determinant + known.log_determinant + cost)
        left = shared.whiten(white[:, :-1] @ step + white[:, -1])
        pulled = shared.whiten(white[:, :-1]) @ known.root
        squares = np.bincount(number[read], left[read] ** 2, n_groups)
        freedom = np.bincount(number[read], (shared.diagonal() - np.sum(pulled**2, axis=1))[read], n_groups)
        change = np.where(sought & (freedom > 0.5), np.sqrt(squares / np.maximum(freedom, 0.5)), 1.0)
        traced = shared.traces() - np.sum(shared.joint_errors(pulled) ** 2, axis=(0, 2))
        shared_squares = np.sum(shared.joint_errors(left[:, None]) ** 2, axis=(0, 2))
        growth = np.where((tau > 0) & (traced > 0), np.sqrt(shared_squares / np.maximum(traced, 1e-300)), 1.0)
        gone = (growth < 1.0) & (np.sum(shared.squares(), axis=0) < _GONE**2 * len(block))
        growth = np.where(gone, 1.0, growth)
        scales, tau = np.maximum(scales * change, EXACT / 10), np.where(gone, 0.0, tau * growth)
        if np.all(np.abs(change - 1.0) <= 10 * _SETTLED) and np.all(np.abs(growth - 1.0) <= _CONVERGED):
            break
    return Components(scales, tau, lambda: likelihood)


def _solve_by_cholesky(model: LinearModel, rows: FloatArray) -> tuple[Information, FloatArray]:
    """Information of rows [J y] and priors, and the step; Cholesky's factors are accurate enough."""
    known = Information(np.linalg.cholesky(model.prior.add_to(rows[:, :-1].T @ rows[:, :-1])).T)
    pull = rows[:, :-1].T @ rows[:, -1] + model.prior.gradient(model.deviations)
    return known, -known.root @ (known.root.T @ pull)


def _prior_cost(model: LinearModel, step: FloatArray) -> float:
    return model.prior.cost(model.deviations + step)
