"""How good a choice of poses is, and which pose to add or remove next, for every index.

Scores are frozen; a move gives new ones. Larger is better for each of them: log det K for O1, minus the square of the
task index, O2 to O5 themselves. Each kind knows how to find its best next move among many candidates without trying
them one by one (`calib.planning.rank_three_scores`, `calib.planning.spectral_scores`).
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from calib.base.arrays import BoolArray, FloatArray
from calib.base.errors import InputError, nearest
from calib.numerics.observability import observability
from calib.planning.rank_three_scores import Determinant, Task
from calib.planning.selection_problem import DETERMINED, TASK, SelectionProblem
from calib.planning.spectral_scores import Spectrum

CHOICES = ("O1", "O2", "O3", "O4", "O5", TASK)


class Scores(Protocol):
    """Value of one choice, and its best next moves."""

    @property
    def value(self) -> float:
        """Larger is better; comparable between choices of equally many poses."""

    def best(self, allowed: BoolArray, *, add: bool) -> int:
        """Return the candidate, of those that are allowed (n_candidates,), whose addition (or removal) is best."""

    def moved(self, candidate: int, *, add: bool) -> Scores:
        """Return the scores after adding (or removing) a candidate."""

    def spares(self, candidate: int) -> bool:
        """Return whether every direction stays determined when this chosen candidate is removed."""


def scores(problem: SelectionProblem, index: str, chosen: BoolArray, ridge: float = 0.0) -> Scores:
    """Return the scores of a choice.

    Args:
        problem: The candidates.
        index: One of `CHOICES`.
        chosen: Which candidates are in the choice, (n_candidates,).
        ridge: Added to the diagonal of K, so that a choice that determines too little can be improved at all.

    Raises:
        InputError: Unknown index.
    """
    return scores_of(problem, index, problem.gathered(chosen.astype(float)) + ridge * np.eye(len(problem.strengths)))


def scores_of(problem: SelectionProblem, index: str, gathered: FloatArray) -> Scores:
    """Return the scores of a choice whose K is known.

    Args:
        problem: The candidates.
        index: One of `CHOICES`.
        gathered: K, (r, r).

    Raises:
        InputError: Unknown index.
    """
    if index == "O1":
        return Determinant.of(problem, gathered)
    if index == TASK:
        return Task(problem, gathered)
    if index not in CHOICES:
        raise InputError(f"index '{index}'{nearest(index, CHOICES)}")
    return Spectrum(problem, problem.strengths[:, None] * gathered * problem.strengths, index)


def index_values(problem: SelectionProblem, chosen: BoolArray, unit: float) -> dict[str, float]:
    """Return O1 to O5 and, where a task is given, the task index [m] of a choice.

    Args:
        problem: The candidates.
        chosen: Which candidates are in the choice, (n_candidates,).
        unit: What a row with noise 1 stands for, such as the noise of a position [m].
    """
    return values_of_rows(problem, problem.rows[chosen], unit)


def values_of_rows(problem: SelectionProblem, rows: FloatArray, unit: float) -> dict[str, float]:
    """Return the indices of whitened rows, (n_poses, n_rows_per_pose, r), with what is known before."""
    flat = rows.reshape(-1, rows.shape[2])
    gathered = flat.T @ flat + problem.before
    eigenvalues, vectors = np.linalg.eigh(gathered)
    determined = bool(eigenvalues[0] > DETERMINED)
    # of a factor, not of S K S: products carry half the digits, and strengths may differ by more than that
    factor = np.sqrt(np.maximum(eigenvalues, 0.0))[:, None] * vectors.T
    singular = np.linalg.svd(factor * problem.strengths, compute_uv=False)
    if not determined:
        singular[-1] = 0.0
    values = observability(unit * singular, len(rows) + problem.n_before)
    if problem.task.shape[1]:
        trace = problem.task_trace(gathered) if determined else float("inf")
        values[TASK] = float(np.sqrt(trace + problem.task_floor))
    return values


def index_of_score(problem: SelectionProblem, index: str, score: float, count: int, unit: float) -> float:
    """Return the index that a score of `count` chosen poses stands for; the task index in m.

    Args:
        problem: The candidates.
        index: One of `CHOICES`.
        score: `Scores.value`.
        count: Number of chosen poses.
        unit: What a row with noise 1 stands for, such as the noise of a position [m].
    """
    if index == "O1":
        mean_log = 0.5 * score / len(problem.strengths) + float(np.mean(np.log(problem.strengths)))
        return unit * float(np.exp(mean_log) / np.sqrt(count + problem.n_before))
    if index == TASK:
        return float(np.sqrt(problem.task_floor - score))
    return score if index == "O2" else unit * score
