"""A proven bound on the index of any choice of poses, from the concave relaxation, and weights near the bound.

Problem. Choose m of n candidates, each at most once: K(w) = K_0 + sum w_k B_k^T B_k with w_k in {0, 1}, sum w = m. The
relaxation allows any weights in [0, 1] with the same sum. It contains every choice, so no choice is better than its
optimum.

Bound. With r rows of K, two functions are concave in K:

    phi(K) = det(K)^(1/r)             (Minkowski)                 O1 is proportional to its square root
    phi(K) = 1 / trace(W K^-1)        the least trace(Y^T K Y) with trace(Y^T L) = 1: a minimum of linear functions
                                                                  the task index is proportional to phi^(-1/2)

A concave function lies below its tangents. At any weights w, with g_k = d(log phi)/d(w_k), every w' has

    phi(w') / phi(w)  <=  1 + sum_k g_k (w'_k - w_k)  <=  1 + (sum of the m largest g_k) - sum_k g_k w_k  =  1 + gap(w)

So every w proves a bound, even the weights of a choice, or weights that have not converged. The least bound is used.
phi(c K) = c phi(K), so that phi(K') <= trace(phi'(K) K') for every K: weights need not determine all directions, if a
tiny part of the identity is added to K (`gathered_by`). The best weights for a task leave out what it does not need,
such as the zero of an encoder.
(The squares of O3, the smallest eigenvalue, and of O5 are concave, too; no bound is computed for them.)

Kinds. If m_g candidates of each kind g are to be chosen, each kind has its own sum, and its own m_g largest slopes.

Weights. A primal-dual interior-point method changes only the unclear weights: the fractional ones, and those whose g is
nearest to the m-th largest. The others stay at 0 or 1. Then g of all candidates decides again which weights are
unclear. With the matrices G_kl = B_k K^-1 B_l^T, the curvature of log det is -|G_kl|^2. So a step costs one product and
one solve with the size of the unclear candidates, however many candidates there are.

Reference: kiefer1960; boyd2004, sections 3.1.5, 7.5 and 11.7; pukelsheim1993.
"""

from __future__ import annotations

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray, IntArray
from calib.planning.exchange import Spacing
from calib.planning.selection_problem import TASK, SelectionProblem

CERTIFIED = ("O1", TASK)
"""Indices with a bound."""
_LEAST = 1e-12  # information added in each direction, of what all candidates have there
_CLOSE_ENOUGH = 2e-5  # gap of the relaxation at which to stop: 0.001 % of the index
_UNCLEAR = 110  # candidates in one run of the interior-point method
_ROUNDS = 12
_AT_ONCE = 2048  # candidates
_STEPS = 25
_TO_BOUNDARY = 0.95
_CENTRING = 0.15


def relax(problem: SelectionProblem, index: str, chosen: BoolArray, spacing: Spacing) -> tuple[float, FloatArray]:
    """Bound the index of any choice with as many poses of each kind as a choice (n_candidates,) to start from.

    Returns:
        Upper bound of log phi over all choices; weights of the relaxation, (n_candidates,), 0 for candidates that are
        not usable. The candidates with the largest weights are a good choice.
    """
    weights, kinds, usable = chosen.astype(float), spacing.kind, spacing.usable
    counts = np.bincount(kinds[chosen], minlength=int(np.max(kinds)) + 1)
    lowest = np.inf
    for _ in range(_ROUNDS):
        gathered = gathered_by(problem, weights)
        slope = np.where(usable, slopes(problem, index, gathered), -np.inf)
        used = np.flatnonzero(weights)
        gap = float(sum(np.sum(slope[best]) for best in largest(slope, kinds, counts)) - slope[used] @ weights[used])
        lowest = min(lowest, log_phi(problem, index, gathered) + float(np.log1p(max(gap, 0.0))))
        if gap < _CLOSE_ENOUGH or int(np.sum(usable)) == int(np.sum(counts)):
            break
        unclear = _unclear(slope, weights, kinds, counts)
        fixed = weights.copy()
        fixed[unclear] = 0.0
        left = (counts - np.bincount(kinds, fixed, minlength=len(counts))).astype(float)
        weights = fixed.copy()
        weights[unclear] = _interior_point(problem, index, unclear, gathered_by(problem, fixed), kinds[unclear], left)
    return lowest, weights


def gathered_by(problem: SelectionProblem, weights: FloatArray) -> FloatArray:
    """Return K of weights (n_candidates,), and a little information in every direction, (r, r)."""
    return problem.information_of(weights) + _LEAST * np.eye(len(problem.strengths))


def largest(slope: FloatArray | IntArray, kinds: IntArray, counts: IntArray) -> list[IntArray]:
    """Return for each kind its `counts` candidates with the largest slopes (n_candidates,), as a list."""
    result = []
    for number, count in enumerate(counts):
        members = np.flatnonzero(kinds == number)
        if 0 < count < len(members):  # sort only those that may be among the largest
            slopes = slope[members]
            members = members[slopes >= np.partition(slopes, len(members) - count)[len(members) - count]]
        result.append(members[np.argsort(-slope[members], kind="stable")[:count]])
    return result


def log_phi(problem: SelectionProblem, index: str, gathered: FloatArray) -> float:
    """Return log phi of the module docstring for K (r, r) and the index `O1` or `task`."""
    if index == TASK:
        return -float(np.log(problem.task_trace(gathered)))
    return float(np.linalg.slogdet(gathered)[1]) / len(gathered)


def slopes(problem: SelectionProblem, index: str, gathered: FloatArray) -> FloatArray:
    """Return g_k of all candidates, (n_candidates,), for K (r, r) and the index `O1` or `task`."""
    if index == TASK:
        half = np.linalg.solve(gathered, problem.task)
        scale = float(np.sum(half * problem.task))
    else:
        half = np.linalg.inv(np.linalg.cholesky(gathered)).T
        scale = float(len(gathered))
    n, k, r = problem.rows.shape
    result = np.empty(n)
    for start in range(0, n, _AT_ONCE):  # few enough to stay in the processor's cache
        part = problem.rows[start : start + _AT_ONCE]
        seen = part.reshape(len(part) * k, r) @ half
        result[start : start + _AT_ONCE] = np.einsum("ni,ni->n", seen, seen).reshape(len(part), k).sum(axis=1)
    return result / scale


def _unclear(slope: FloatArray, weights: FloatArray, kinds: IntArray, counts: IntArray) -> IntArray:
    """Candidates whose weights the interior-point method changes, ascending."""
    level = np.array([np.min(slope[best], initial=np.inf) for best in largest(slope, kinds, counts)])
    # distance of a slope from the level at which the weight would change; fractional weights always count as unclear
    margin = level[kinds]
    margin -= slope
    used = np.flatnonzero(weights)
    margin[used] = np.where(weights[used] == 1, -margin[used], -np.inf)
    size = min(_UNCLEAR + int(np.sum((weights > 0) & (weights < 1))), int(np.sum(slope > -np.inf)))
    return np.sort(np.argpartition(margin, size - 1)[:size])


def _interior_point(
    problem: SelectionProblem, index: str, unclear: IntArray, fixed: FloatArray, kinds: IntArray, totals: FloatArray
) -> FloatArray:
    """Maximise log phi over the weights of the unclear candidates by `_inner_weights`.

    If all or no candidates of a kind are to be chosen, their weights are set first.
    """
    size = np.bincount(kinds, minlength=len(totals))
    has_choice = (totals > 0.5) & (totals < size - 0.5)
    result = (totals > 0.5)[kinds].astype(float)
    inner = np.flatnonzero(has_choice[kinds])
    if len(inner):
        settled = problem.rows[unclear[result * ~has_choice[kinds] > 0]].reshape(-1, problem.rows.shape[2])
        kind = np.cumsum(has_choice)[kinds[inner]] - 1
        rows = problem.rows[unclear[inner]]
        result[inner] = _inner_weights(problem, index, rows, fixed + settled.T @ settled, kind, totals[has_choice])
    return result


def _inner_weights(
    problem: SelectionProblem, index: str, rows: FloatArray, fixed: FloatArray, kind: IntArray, totals: FloatArray
) -> FloatArray:
    """Maximise log phi over weights in [0, 1] of candidates with rows (n, k, r), with a given sum for each kind.

    Primal-dual, with multipliers `lower` of w >= 0, `upper` of w <= 1, and `level` of each kind's sum:
    slope - level + lower - upper = 0, w * lower = (1 - w) * upper = mu, and mu goes to 0.
    """
    member = (kind[:, None] == np.arange(len(totals))).astype(float)  # (n, n_kinds)
    n = len(rows)
    w = (totals / np.sum(member, axis=0))[kind]
    slope, curvature = _derivatives(problem, index, rows, fixed, w)
    best = largest(slope, kind, np.maximum(np.round(totals).astype(np.intp), 1))
    level = np.array([np.min(slope[indices]) for indices in best])
    floor = 0.1 * float(np.mean(np.abs(slope)))
    lower, upper = np.maximum(level[kind] - slope, 0) + floor, np.maximum(slope - level[kind], 0) + floor
    for _ in range(_STEPS):
        complementarity = float(w @ lower + (1 - w) @ upper)
        if complementarity < _CLOSE_ENOUGH / 4:
            break
        mu = _CENTRING * complementarity / (2 * n)
        matrix = curvature + np.diag(lower / w + upper / (1 - w))
        right = slope - level[kind] + mu / w - mu / (1 - w)
        solved = np.linalg.solve(matrix, np.column_stack([right, member]))
        level_step = np.linalg.solve(member.T @ solved[:, 1:], member.T @ (solved[:, 0] + w) - totals)
        step = solved[:, 0] - solved[:, 1:] @ level_step
        lower_step = mu / w - lower - lower / w * step
        upper_step = mu / (1 - w) - upper + upper / (1 - w) * step
        length = min(_reach(w, step), _reach(1 - w, -step))
        dual = min(_reach(lower, lower_step), _reach(upper, upper_step))
        w = w + length * step
        lower, upper, level = lower + dual * lower_step, upper + dual * upper_step, level + dual * level_step
        slope, curvature = _derivatives(problem, index, rows, fixed, w)
    for number, total in enumerate(totals):
        w[kind == number] = _round_weights(w[kind == number], float(total))
    return w


def _derivatives(
    problem: SelectionProblem, index: str, rows: FloatArray, fixed: FloatArray, w: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Slope (n,) of log phi by the weights, and minus its second derivative, (n, n)."""
    n, k, r = rows.shape
    flat = (rows * np.sqrt(w)[:, None, None]).reshape(-1, r)
    gathered = fixed + flat.T @ flat
    half = rows.reshape(-1, r) @ np.linalg.inv(np.linalg.cholesky(gathered)).T
    between = half @ half.T
    if index == TASK:
        task_rows = rows.reshape(-1, r) @ np.linalg.solve(gathered, problem.task)
        trace = problem.task_trace(gathered)
        slope = np.sum(task_rows.reshape(n, -1) ** 2, axis=1) / trace
        return slope, 2.0 * _blocks(between * (task_rows @ task_rows.T), k) / trace - np.outer(slope, slope)
    slope = np.diag(between).reshape(n, k).sum(axis=1) / r
    return slope, _blocks(between**2, k) / r


def _blocks(matrix: FloatArray, k: int) -> FloatArray:
    """Sums of the k x k blocks of a matrix, (k n, k n) -> (n, n)."""
    rows = matrix[0::k].copy()
    for i in range(1, k):  # slices, because numpy sums short axes slowly
        rows += matrix[i::k]
    result = rows[:, 0::k].copy()
    for i in range(1, k):
        result += rows[:, i::k]
    return result


def _reach(values: FloatArray, step: FloatArray) -> float:
    """Longest part of a step, at most 1, that keeps positive values positive."""
    falling = step < 0
    return min(1.0, _TO_BOUNDARY * float(np.min(values[falling] / -step[falling]))) if np.any(falling) else 1.0


def _round_weights(w: FloatArray, total: float) -> FloatArray:
    """Round weights near 0 or 1, and change the others so that the sum stays."""
    result = np.where(w < 1e-4, 0.0, np.where(w > 1 - 1e-4, 1.0, w))
    between = (result > 0) & (result < 1)
    rest = total - float(np.sum(result))
    if np.any(between):
        room = np.where(between, 1.0 - result if rest > 0 else result, 0.0)
        if float(np.sum(room)) > abs(rest):
            return result + rest * room / np.sum(room)
    return w
