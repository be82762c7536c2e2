"""Scores of a choice of poses, and the best pose to add or remove next, for every index.

Scores are frozen; a move gives new scores. Larger is better for each of them: log det K for O1, minus the square of the
task index, O2 to O5 themselves. For O1 and the task index, changes of rank three give the best next move
(`calib.planning.rank_three_scores`); for O2 to O5, exact eigenvalues of few candidates give it here.

For O2 to O5, the new index needs the eigenvalues of each candidate's matrix. A bound rules out most candidates: in the
axes of the present eigenvectors, only two parts of the new matrix are kept: the block of the few smallest eigenvalues,
and the rest of the diagonal (pinching). The true eigenvalues majorise those of this matrix, so its O2 to O5 are upper
bounds. True eigenvalues are computed in the order of the bounds, until no bound exceeds the best value. The result is
the exact best candidate.

Reference: bhatia1997, sections II.5 and III.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray
from calib.core.base.parameter import Parameter
from calib.core.base.units import PER_SI
from calib.core.numerics import linalg
from calib.core.numerics.identifiability import numerical_rank
from calib.core.numerics.observability import observability
from calib.planning.rank_three_scores import DeterminantScores, Scores, TaskScores
from calib.planning.selection_problem import DETERMINED, TASK, SelectionProblem

CHOICES = ("O1", "O2", "O3", "O4", "O5", TASK)
_PINCHED = 4  # size of the block: eigenvectors of the smallest eigenvalues
_BATCH = 16  # candidates whose eigenvalues are computed together


def scores(problem: SelectionProblem, index: str, chosen: BoolArray, ridge: float = 0.0) -> Scores:
    """Return the scores of a choice (n_candidates,) by an index of `CHOICES`.

    A ridge on the diagonal of K lets a choice that determines too little be improved.
    """
    gathered = problem.information_of(chosen.astype(float)) + ridge * np.eye(len(problem.strengths))
    if index == "O1":
        return DeterminantScores.from_problem(problem, gathered)
    return TaskScores(problem, gathered) if index == TASK else Spectrum(problem, gathered, index)


def index_values(problem: SelectionProblem, chosen: BoolArray, unit: float) -> dict[str, float]:
    """Return O1 to O5 of a choice (n_candidates,) and, if there is a task, the task index [m].

    `unit` is the size of a whitened row of 1, such as the noise of a position [m].
    """
    rows = problem.rows[chosen]
    flat = rows.reshape(-1, rows.shape[2])
    gathered = flat.T @ flat + problem.before
    eigenvalues, vectors = linalg.eigh(gathered)
    determined = bool(eigenvalues[0] > DETERMINED)
    # singular values of a factor of K, not eigenvalues of S K S: these would lose half of the digits
    factor = np.sqrt(np.maximum(eigenvalues, 0.0))[:, None] * vectors.T
    singular = linalg.singular_values(factor * problem.strengths)
    if not determined:
        singular[-1] = 0.0
    values = observability(unit * singular, len(rows) + problem.n_before)
    if problem.task.shape[1]:
        trace = problem.task_trace(gathered) if determined else float("inf")
        values[TASK] = float(np.sqrt(trace + problem.task_floor))
    return values


def observability_of(
    rows: FloatArray, parameters: Sequence[Parameter], n_poses: int, *, lengths: bool = True
) -> tuple[dict[str, float], dict[str, float]]:
    """Return O1 to O5 of poses, on scaled columns [m] and on raw ones (mm per unit of table).

    Rows are the scaled Jacobian, (..., n_parameters) [m], or, if they are not `lengths`, are divided by their noise and
    give indices without unit. Where the poses are short of rank, only non-zero singular values count.
    """
    flat = rows.reshape(-1, rows.shape[-1])
    per_unit = np.array([parameter.sigma for parameter in parameters])
    scaled = numerical_rank(flat)
    raw = numerical_rank((PER_SI["length"]["mm"] if lengths else 1.0) * flat / per_unit)
    kept = slice(max(scaled.rank, 1))
    return observability(scaled.singular_values[kept], n_poses), observability(raw.singular_values[kept], n_poses)


def index_of_score(problem: SelectionProblem, index: str, score: float, count: int, unit: float) -> float:
    """Return the index of `count` chosen poses with a score; the task index in m. `unit` is as in `index_values`."""
    if index == "O1":
        mean_log = 0.5 * score / len(problem.strengths) + float(np.mean(np.log(problem.strengths)))
        return unit * float(np.exp(mean_log) / np.sqrt(count + problem.n_before))
    if index == TASK:
        return float(np.sqrt(problem.task_floor - score))
    return score if index == "O2" else unit * score


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
