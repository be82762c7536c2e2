"""The problem of choosing poses, in coordinates in which it is well conditioned.

Each candidate k adds A_k^T A_k to the information matrix of the scaled parameters, A_k its rows (`calib.information`).
What is known before (priors, poses already measured) adds M_0. With all candidates together,

    M_all = M_0 + sum_k A_k^T A_k = V S^2 V^T,         B_k = A_k V S^-1,      K = S^-1 V^T M V S^-1

so that K of all candidates is the identity, and K of a choice says which part of what could be known each direction
keeps. Directions that no candidate determines are outside V and take no part. All indices are functions of K:

    log det of the information   log det K + constant
    singular values of the rows  square roots of the eigenvalues of S K S
    task index                   sigma sqrt(trace(W K^-1)),   W = mean over task poses of their B^T B

A choice may use each candidate once: w_k in {0, 1}.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.information import OUTSIDE, Information, information
from calib.mechanism import BoolArray, FloatArray

TASK = "task"
"""Name of the task index where an index is chosen."""
DETERMINED = 1e-10
"""A direction of which a choice has less than this part of the information of all candidates is not determined."""


@dataclass(frozen=True, eq=False)
class Problem:
    """Candidates in whitened coordinates; see the module docstring.

    Attributes:
        rows: B, (n_candidates, 3 n_targets, r).
        before: K of what is known before, (r, r).
        strengths: S, (r,) [m].
        task: Factor L with W = L L^T, (r, at most r); without columns where no task is given.
        n_before: Poses already measured.
        known: What all candidates and the knowledge before determine.
    """

    rows: FloatArray
    before: FloatArray
    strengths: FloatArray
    task: FloatArray
    n_before: int
    known: Information

    def __len__(self) -> int:
        return len(self.rows)

    def gathered(self, weights: FloatArray) -> FloatArray:
        """Return K of a weighted choice, (r, r).

        Args:
            weights: One for each candidate, (n_candidates,).
        """
        used = np.flatnonzero(weights)
        flat = (self.rows[used] * np.sqrt(weights[used])[:, None, None]).reshape(-1, self.rows.shape[2])
        return self.before + flat.T @ flat

    def task_trace(self, gathered: FloatArray) -> float:
        """Return trace(W K^-1) for K (r, r)."""
        return float(np.sum(np.linalg.solve(gathered, self.task) * self.task))

    def determined_by(self, chosen: BoolArray) -> bool:
        """Return whether a choice (n_candidates,) determines every direction that all candidates together do."""
        return bool(np.linalg.eigvalsh(self.gathered(chosen.astype(float)))[0] > DETERMINED)


def build_problem(
    rows: FloatArray, known: FloatArray | None = None, n_before: int = 0, task_rows: FloatArray | None = None
) -> Problem:
    """Whiten candidates.

    Args:
        rows: Scaled Jacobian of each candidate, (n_candidates, 3 n_targets, n_parameters) [m].
        known: Rows of priors and of poses already measured, (n_known, n_parameters) [m].
        n_before: Poses already measured.
        task_rows: Scaled Jacobian at the poses whose accuracy counts, (n_task, 3 n_targets, n_parameters) [m].
    """
    found = information(rows, known)
    whiten = found.directions / found.strengths
    before = np.zeros((found.rank.rank, found.rank.rank))
    if known is not None and len(known):
        before = (known @ whiten).T @ (known @ whiten)
    task = np.zeros((found.rank.rank, 0))
    if task_rows is not None:
        flat = (task_rows @ whiten).reshape(-1, found.rank.rank)
        n_positions = flat.shape[0] // 3
        task = np.asarray(np.linalg.qr(flat, mode="r")).T / np.sqrt(n_positions)
    return Problem(np.ascontiguousarray(rows @ whiten), before, found.strengths, task, n_before, found)


def task_is_determined(problem: Problem, task_rows: FloatArray) -> bool:
    """Return whether the candidates determine every position of the task, so that its index is finite."""
    size = np.sum(task_rows**2, axis=2)
    outside = size - np.sum((task_rows @ problem.known.directions) ** 2, axis=2)
    return bool(np.all(outside <= OUTSIDE**2 * np.max(size)))
