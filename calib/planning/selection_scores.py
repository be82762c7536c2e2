"""Scores of a choice of poses, and the best pose to add or remove next, for every index.

Scores are frozen; a move gives new scores. Larger is better for each of them: log det K for O1, minus the square of the
task index, O2 to O5 themselves. K is the information of the chosen poses, B_j the rows of pose j, and W the mean over
task poses of their B^T B (`calib.planning.selection_problem`). Adding pose j turns K into K + B_j^T B_j, removing it
into K - B_j^T B_j.

O1 and the task index. With three coordinates per pose this change has rank three, and small matrices of all candidates
give the new value:

    log det     log det(I +- G_j),  G_j = B_j K^-1 B_j^T;  after a move G_i -+ T_i T_i^T with
                T_i = B_i K^-1 B_j^T chol(I +- G_j)^-T, one product of all rows with three columns
    task        trace(W K^-1) -+ trace((I +- G_j)^-1 B_j K^-1 W K^-1 B_j^T)

O2 to O5. The new index needs the eigenvalues of each candidate's matrix. A bound rules out most candidates: in the axes
of the present eigenvectors, only two parts of the new matrix are kept: the block of the few smallest eigenvalues, and
the rest of the diagonal (pinching). The true eigenvalues majorise those of this matrix, so its O2 to O5 are upper
bounds. True eigenvalues are computed in the order of the bounds, until no bound exceeds the best value. The result is
the exact best candidate.

Reference: bhatia1997, sections II.5 and III.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray, IntArray
from calib.core.numerics import linalg
from calib.planning.selection_problem import DETERMINED, TASK, SelectionProblem

_REFRESH = 32  # moves after which the determinant's small matrices are recomputed, against rounding
_UPDATED = 1e-6  # least det(I - G) for an update; near zero, the update would lose too many digits
_PINCHED = 4  # size of the block: eigenvectors of the smallest eigenvalues
_BATCH = 16  # candidates whose eigenvalues are computed together


@dataclass(frozen=True, eq=False)
class Scores(ABC):
    """Value of a choice, and its best next moves, by the information K (r, r) of the chosen candidates."""

    problem: SelectionProblem
    gathered: FloatArray

    @property
    @abstractmethod
    def value(self) -> float:
        """Larger is better; comparable between choices of equally many poses."""

    @abstractmethod
    def best_move(self, allowed: BoolArray, *, add: bool) -> int:
        """Return the allowed candidate (n_candidates,) whose addition (or removal) is best."""

    def after_move(self, candidate: int, *, add: bool) -> Self:
        """Return the scores after adding (or removing) a candidate."""
        rows = self.problem.rows[candidate]
        return replace(self, gathered=self.gathered + (1.0 if add else -1.0) * rows.T @ rows)

    def spares(self, candidates: IntArray) -> BoolArray:
        """Return which of the chosen candidates (n,) can each go while every direction stays determined, (n,)."""
        whiten, least = self._redundancy
        seen = self.problem.rows[candidates] @ whiten
        left = np.eye(seen.shape[1]) - seen @ seen.transpose(0, 2, 1)
        return np.asarray(linalg.eigvalsh(left)[:, 0] > least)

    @cached_property
    def _redundancy(self) -> tuple[FloatArray, float]:
        """X with X^T K X = I, (r, r), and the part of its information that every direction must keep.

        With the diagonal of K scaled to ones, B K^-1 B^T is exact to about r eps times its condition number, so smaller
        parts count as zero. For a singular K no pose is spared.
        """
        diagonal = np.diag(self.gathered)
        scale = 1.0 / np.sqrt(np.where(diagonal > 0, diagonal, np.inf))
        values, vectors = linalg.eigh(scale[:, None] * self.gathered * scale)
        rounding = len(values) * float(np.finfo(float).eps) * float(values[-1])
        if not values[0] > rounding:
            return np.zeros_like(self.gathered), 1.0
        return scale[:, None] * vectors / np.sqrt(values), max(DETERMINED, rounding / float(values[0]))


@dataclass(frozen=True, eq=False)
class DeterminantScores(Scores):
    """log det K, by rank-three updates.

    Attributes:
        inverse: K^-1, (r, r).
        seen: G of every candidate, (k, k, n_candidates), with candidates last so that sums run through memory.
        moves_since_update: Moves since `seen` was recomputed.
    """

    inverse: FloatArray
    seen: FloatArray
    moves_since_update: int

    @classmethod
    def from_problem(cls, problem: SelectionProblem, gathered: FloatArray) -> Self:
        """Return the scores of a choice with this K, (r, r)."""
        inverse = np.linalg.inv(gathered)
        root = _products(problem.rows, _root(inverse))
        return cls(problem, gathered, inverse, np.einsum("icn,kcn->ikn", root, root), 0)

    @cached_property
    def value(self) -> float:
        """Log det K."""
        return float(np.linalg.slogdet(self.gathered)[1])

    def gains(self) -> FloatArray:
        """Return the rise of log det K by adding each candidate, (n_candidates,)."""
        return np.log(_determinants(self.seen, 1.0))

    def best_move(self, allowed: BoolArray, *, add: bool) -> int:
        """Return the best next move; see `Scores`."""
        factors = _determinants(self.seen, 1.0 if add else -1.0)
        return int(np.argmax(np.where(allowed, factors, -np.inf)))

    def after_move(self, candidate: int, *, add: bool) -> Self:
        """Return the scores after a move; see `Scores`."""
        sign = 1.0 if add else -1.0
        rows = self.problem.rows[candidate]
        gathered = self.gathered + sign * rows.T @ rows
        left = _determinants(self.seen[:, :, candidate : candidate + 1], sign)[0]
        small = np.eye(len(rows)) + sign * self.seen[:, :, candidate]
        if (
            self.moves_since_update >= _REFRESH or left < _UPDATED or linalg.eigvalsh(small)[0] <= 0
        ):  # the determinant alone may be positive with two negative eigenvalues
            return self.from_problem(self.problem, gathered)
        half = np.linalg.solve(np.linalg.cholesky(small), rows @ self.inverse).T
        inverse = self.inverse - sign * half @ half.T
        through = _products(self.problem.rows, half)
        seen = self.seen - sign * np.einsum("icn,kcn->ikn", through, through)
        moves = self.moves_since_update + 1
        return replace(self, gathered=gathered, inverse=inverse, seen=seen, moves_since_update=moves)


def _root(matrix: FloatArray) -> FloatArray:
    """Return C with C C^T = matrix (r, r), which rounding may have made slightly indefinite."""
    try:
        return np.asarray(np.linalg.cholesky(matrix))
    except np.linalg.LinAlgError:
        values, vectors = linalg.eigh(matrix)
        return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def _products(rows: FloatArray, matrix: FloatArray) -> FloatArray:
    """Return rows times matrix with the candidates last, (k, n_columns, n_candidates)."""
    n, k, r = rows.shape
    flat = (rows.reshape(n * k, r) @ matrix).reshape(n, k, -1)  # one product, where numpy would do n small products
    return np.ascontiguousarray(flat.transpose(1, 2, 0))


def _determinants(seen: FloatArray, sign: float) -> FloatArray:
    """det(I +- G) of every candidate; written out for three rows, much faster than factorisations."""
    if len(seen) != 3:
        return np.asarray(np.linalg.det(np.eye(len(seen)) + sign * seen.transpose(2, 0, 1)))
    a, b, c = (1.0 + sign * seen[i, i] for i in range(3))
    d, e, f = sign * seen[0, 1], sign * seen[0, 2], sign * seen[1, 2]
    return np.asarray(a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e))


@dataclass(frozen=True, eq=False)
class TaskScores(Scores):
    """Minus trace(W K^-1), the square of the task index, by changes of rank three."""

    @cached_property
    def value(self) -> float:
        """Minus trace(W K^-1)."""
        return -self.problem.task_trace(self.gathered)

    @cached_property
    def _task_products(self) -> tuple[FloatArray, FloatArray]:
        """B K^-1 B^T and B K^-1 W K^-1 B^T of every candidate."""
        rows = self.problem.rows
        inverse = np.linalg.inv(self.gathered)
        seen = np.matmul(rows @ inverse, rows.transpose(0, 2, 1))
        task_rows = rows @ (inverse @ self.problem.task)
        return seen, np.matmul(task_rows, task_rows.transpose(0, 2, 1))

    def gains(self) -> FloatArray:
        """Return the fall of trace(W K^-1) by adding each candidate, (n_candidates,)."""
        seen, task_rows = self._task_products
        return np.trace(np.linalg.solve(np.eye(seen.shape[1]) + seen, task_rows), axis1=1, axis2=2)

    def best_move(self, allowed: BoolArray, *, add: bool) -> int:
        """Return the best next move; see `Scores`."""
        if add:
            return int(np.argmax(np.where(allowed, self.gains(), -np.inf)))
        seen, task_rows = self._task_products
        candidates = np.flatnonzero(allowed)
        small = np.eye(seen.shape[1]) - seen[candidates]
        solvable = self.spares(candidates)
        if not np.any(solvable):
            return int(candidates[0])
        candidates, small = candidates[solvable], small[solvable]
        change = np.trace(np.linalg.solve(small, task_rows[candidates]), axis1=1, axis2=2)
        return int(candidates[np.argmin(change)])


@dataclass(frozen=True, eq=False)
class Spectrum(Scores):
    """O2, O3, O4 or O5: functions of the singular values."""

    index: str

    @cached_property
    def matrix(self) -> FloatArray:
        """S K S, the information matrix of the scaled parameters, (r, r) [m^2]."""
        return self.problem.strengths[:, None] * self.gathered * self.problem.strengths

    @cached_property
    def value(self) -> float:
        """The index."""
        return float(spectral_index(linalg.eigvalsh(self.matrix)[None], self.index)[0])

    def best_move(self, allowed: BoolArray, *, add: bool) -> int:
        """Return the best next move; see `Scores`."""
        sign = 1.0 if add else -1.0
        candidates = np.flatnonzero(allowed)
        eigenvalues, vectors = linalg.eigh(self.matrix)
        turned = self.problem.rows[candidates] @ (self.problem.strengths[:, None] * vectors)
        bounds = spectral_index(_pinched_eigenvalues(eigenvalues, turned, sign), self.index)
        order = np.argsort(-bounds, kind="stable")
        best, best_value = int(candidates[order[0]]), -np.inf
        for start in range(0, len(order), _BATCH):
            batch = order[start : start + _BATCH]
            if bounds[batch[0]] <= best_value:
                break
            changed = np.diag(eigenvalues) + sign * np.matmul(turned[batch].transpose(0, 2, 1), turned[batch])
            exact = spectral_index(linalg.eigvalsh(changed), self.index)
            if np.max(exact) > best_value:
                best, best_value = int(candidates[batch[np.argmax(exact)]]), float(np.max(exact))
        return best


def _pinched_eigenvalues(eigenvalues: FloatArray, turned: FloatArray, sign: float) -> FloatArray:
    """Eigenvalues of the changed matrices, (n, r), without off-diagonal entries outside the smallest block."""
    low = turned[:, :, :_PINCHED]
    block = np.diag(eigenvalues[:_PINCHED]) + sign * np.matmul(low.transpose(0, 2, 1), low)
    diagonal = eigenvalues[_PINCHED:] + sign * np.sum(turned[:, :, _PINCHED:] ** 2, axis=1)
    return np.concatenate([linalg.eigvalsh(block), diagonal], axis=1)


def spectral_index(eigenvalues: FloatArray, index: str) -> FloatArray:
    """Return O2 to O5 of information matrices from their eigenvalues in any order, (n, r) -> (n,); 0 if singular."""
    smallest, largest = np.min(eigenvalues, axis=1), np.max(eigenvalues, axis=1)
    positive = np.maximum(smallest, 0.0)
    if index == "O2":
        result = np.sqrt(positive / largest)
    elif index == "O3":
        result = np.sqrt(positive)
    elif index == "O4":
        result = positive / np.sqrt(largest)
    else:
        safe = np.where(eigenvalues > 0, eigenvalues, np.inf)
        result = np.where(smallest > 0, 1.0 / np.sum(1.0 / np.sqrt(safe), axis=1), 0.0)
    return result


def scores(problem: SelectionProblem, index: str, chosen: BoolArray, ridge: float = 0.0) -> Scores:
    """Return the scores of a choice (n_candidates,) by an index of `CHOICES`.

    A ridge on the diagonal of K lets a choice that determines too little be improved.
    """
    gathered = problem.information_of(chosen.astype(float)) + ridge * np.eye(len(problem.strengths))
    if index == "O1":
        return DeterminantScores.from_problem(problem, gathered)
    return TaskScores(problem, gathered) if index == TASK else Spectrum(problem, gathered, index)
