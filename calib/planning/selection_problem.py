"""The problem of choosing poses, in coordinates in which it is well conditioned.

Each candidate k adds A_k^T A_k to the information matrix of the scaled parameters, A_k its rows
(`calib.core.numerics.observability`). Poses measured already add theirs, and priors add P. All poses together determine
the directions V,

    sum_k A_k^T A_k + measured = V S^2 V^T

and say nothing about the rest, N, where only P has information, whatever is chosen. N is eliminated (Schur
complement):

    M = V^T (information of the choice + measured + P) V - P_VN P_NN^+ P_NV          P_VN = V^T P N, and so on

is the information about V from a choice, with N unknown but held by its priors. Whitened, B_k = A_k V S^-1 and

    K = S^-1 M S^-1 = K_before + sum_k B_k^T B_k

so that K of all poses without priors is the identity, and K of a choice is the part of the available information in
each direction. All indices are functions of K:

    log det of the information      log det K + constant
    singular values of the rows     square roots of the eigenvalues of S K S
    task index                      sqrt(trace(W K^-1) + c) [m],       W = mean over task poses of their B^T B

with B = J (V - N P_NN^+ P_NV) S^-1 for a task pose with rows J, and c = mean of |J N P_NN^(+1/2)|^2, the part that
only priors hold. Without priors the index values are the published ones. A choice may use each candidate once.

Without pose j of a choice, direction v keeps the part v^T (K - B_j^T B_j) v / v^T K v of its information. The least
part over all directions is the smallest eigenvalue of I - B_j K^-1 B_j^T (`calib.planning.selection_scores.Scores`).
The eigenvalues of K - B_j^T B_j do not show a lost direction: the difference of two rounded matrices is wrong by eps
|K| in every direction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray
from calib.core.base.memory import zeros_with_room
from calib.core.base.parameter import Parameter
from calib.core.base.units import PER_SI
from calib.core.numerics import linalg
from calib.core.numerics.identifiability import Rank, numerical_rank, reduce_rows
from calib.core.numerics.observability import OUTSIDE, Information, information, observability

TASK = "task"
"""Name of the task index."""
CHOICES = ("O1", "O2", "O3", "O4", "O5", TASK)
_PART = 8192  # candidates at once
DETERMINED = 1e-10
"""A choice determines a direction if it has at least this part of the information of all candidates there."""


@dataclass(frozen=True, eq=False)
class SelectionProblem:
    """Candidates in whitened coordinates; see the module docstring.

    Attributes:
        rows: B, (n_candidates, 3 n_targets, r).
        before: K_before: measured poses and priors, (r, r).
        strengths: S, (r,) [m].
        task: Factor L with W = L L^T, (r, at most r); without columns if there is no task.
        task_floor: c; infinite if the task depends on undetermined directions.
        n_before: Number of measured poses.
        pose_information: V and S of all poses.
        rank: Rank of all poses and priors together.
    """

    rows: FloatArray
    before: FloatArray
    strengths: FloatArray
    task: FloatArray
    task_floor: float
    n_before: int
    pose_information: Information
    rank: Rank

    def __len__(self) -> int:
        return len(self.rows)

    def information_of(self, weights: FloatArray) -> FloatArray:
        """Return K (r, r) of a choice with weights (n_candidates,)."""
        used, total = np.flatnonzero(weights), self.before
        for start in range(0, len(used), _PART):
            some = used[start : start + _PART]
            flat = (self.rows[some] * np.sqrt(weights[some])[:, None, None]).reshape(-1, self.rows.shape[2])
            total = total + flat.T @ flat
        return total

    def task_trace(self, gathered: FloatArray) -> float:
        """Return trace(W K^-1) for K (r, r)."""
        return float(np.sum(np.linalg.solve(gathered, self.task) * self.task))

    def is_determined_by(self, chosen: BoolArray) -> bool:
        """Return whether a choice (n_candidates,) determines every direction that all candidates determine."""
        return bool(linalg.eigvalsh(self.information_of(chosen.astype(float)))[0] > DETERMINED)


def build_problem(
    rows: FloatArray,
    measured: FloatArray | None = None,
    priors: FloatArray | None = None,
    n_before: int = 0,
    task_rows: FloatArray | None = None,
    n_task: int | None = None,
) -> SelectionProblem:
    """Whiten candidates.

    Args:
        rows: Scaled Jacobian of each candidate, (n_candidates, 3 n_targets, n_parameters) [m].
        measured: Rows of the measured poses, (n_rows, n_parameters) [m].
        priors: Rows of the priors, (n_priors, n_parameters) [m].
        n_before: Number of measured poses.
        task_rows: Scaled Jacobian at the positions whose accuracy counts, (..., n_parameters) [m], or its R.
        n_task: Number of these positions; default: a third of the rows.
    """
    width = rows.shape[2]
    measured = np.zeros((0, width)) if measured is None else measured
    priors = np.zeros((0, width)) if priors is None else priors
    known = information(rows, measured)
    directions, strengths = known.directions, known.strengths
    others = linalg.svd(directions)[0][:, known.rank.rank :] if known.rank.rank else np.eye(width)
    held = linalg.pinv(priors @ others, rcond=OUTSIDE)  # P_NN^+ = held held^T
    clear = directions - others @ (held @ (priors @ directions))  # V - N P_NN^+ P_NV
    whiten = directions / strengths
    before = measured @ whiten
    prior_part = priors @ clear / strengths
    everything = information(np.vstack([reduce_rows(rows.reshape(-1, width)), measured]), priors).rank
    task, floor = _task(task_rows, n_task, clear / strengths, others, held)
    return SelectionProblem(
        rows=_whiten(rows, whiten),
        before=before.T @ before + prior_part.T @ prior_part,
        strengths=strengths,
        task=task,
        task_floor=floor,
        n_before=n_before,
        pose_information=known,
        rank=everything,
    )


def _whiten(rows: FloatArray, whiten: FloatArray) -> FloatArray:
    """B of each candidate, (n_candidates, 3 n_targets, r), computed part by part to save memory."""
    n, k, width = rows.shape
    result = zeros_with_room((n, k, whiten.shape[1]), f"whitened rows of {n} candidates")
    for start in range(0, n, _PART):
        part = rows[start : start + _PART]
        result[start : start + _PART] = (part.reshape(-1, width) @ whiten).reshape(len(part), k, -1)
    return result


def _task(
    task_rows: FloatArray | None, n_task: int | None, clear: FloatArray, others: FloatArray, held: FloatArray
) -> tuple[FloatArray, float]:
    """L and c of the task."""
    if task_rows is None:
        return np.zeros((clear.shape[1], 0)), 0.0
    flat = task_rows.reshape(-1, task_rows.shape[-1])
    n_positions = len(flat) // 3 if n_task is None else n_task
    factor = reduce_rows(flat @ clear).T / np.sqrt(n_positions)
    outside = flat @ others
    held_part = outside @ held
    unheld = outside - held_part @ linalg.pinv(held) if held.size else outside
    if np.linalg.norm(unheld) > OUTSIDE * np.linalg.norm(flat):
        return factor, float("inf")
    return factor, float(np.sum(held_part**2)) / n_positions


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


def index_of_score(problem: SelectionProblem, index: str, score: float, count: int, unit: float) -> float:
    """Return the index of `count` chosen poses with a score; the task index in m. `unit` is as in `index_values`."""
    if index == "O1":
        mean_log = 0.5 * score / len(problem.strengths) + float(np.mean(np.log(problem.strengths)))
        return unit * float(np.exp(mean_log) / np.sqrt(count + problem.n_before))
    if index == TASK:
        return float(np.sqrt(problem.task_floor - score))
    return score if index == "O2" else unit * score


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
