"""Scores of single singular values: O2 to O5, by exact eigenvalues of few candidates.

The new index needs the eigenvalues of each candidate's matrix. Most candidates are ruled out before: in the
eigenvectors of the present matrix, the new one is replaced by its block of the smallest few and the diagonal of the
rest (pinching). Pinched eigenvalues are majorised by the true ones, so O2 to O5 of them are upper bounds. True
eigenvalues are computed in the order of the bounds, until no bound exceeds the best value found: the best candidate is
found exactly.

Reference: Bhatia 1997, sections II.5 and III.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib.base.arrays import BoolArray, FloatArray
from calib.planning.selection_problem import SelectionProblem, Sparing

_PINCHED = 4  # smallest eigenvectors that are kept as a block
_BATCH = 16  # candidates whose eigenvalues are computed together


@dataclass(frozen=True, eq=False)
class Spectrum:
    """O2 to O5: functions of the singular values.

    Attributes:
        problem: The candidates.
        matrix: S K S, the information matrix of the scaled parameters, (r, r) [m^2].
        index: O2, O3, O4 or O5.
    """

    problem: SelectionProblem
    matrix: FloatArray
    index: str

    @cached_property
    def value(self) -> float:
        """The index."""
        return float(spectral_index(np.linalg.eigvalsh(self.matrix)[None], self.index)[0])

    def best(self, allowed: BoolArray, *, add: bool) -> int:
        """Return the best next move; see `calib.planning.selection_scores.Scores`."""
        sign = 1.0 if add else -1.0
        candidates = np.flatnonzero(allowed)
        eigenvalues, vectors = np.linalg.eigh(self.matrix)
        turned = self.problem.rows[candidates] @ (self.problem.strengths[:, None] * vectors)
        bounds = spectral_index(_pinched(eigenvalues, turned, sign), self.index)
        order = np.argsort(-bounds, kind="stable")
        best, best_value = int(candidates[order[0]]), -np.inf
        for start in range(0, len(order), _BATCH):
            batch = order[start : start + _BATCH]
            if bounds[batch[0]] <= best_value:
                break
            changed = np.diag(eigenvalues) + sign * np.matmul(turned[batch].transpose(0, 2, 1), turned[batch])
            exact = spectral_index(np.linalg.eigvalsh(changed), self.index)
            if np.max(exact) > best_value:
                best, best_value = int(candidates[batch[np.argmax(exact)]]), float(np.max(exact))
        return best

    def moved(self, candidate: int, *, add: bool) -> Spectrum:
        """Return the scores after a move; see `calib.planning.selection_scores.Scores`."""
        rows = self.problem.rows[candidate] * self.problem.strengths
        return Spectrum(self.problem, self.matrix + (1.0 if add else -1.0) * rows.T @ rows, self.index)

    def spares(self, candidate: int) -> bool:
        """Return whether a chosen candidate can go; see `calib.planning.selection_scores.Scores`."""
        return bool(self._sparing.spares(self.problem.rows[[candidate]] * self.problem.strengths)[0])

    @cached_property
    def _sparing(self) -> Sparing:
        return Sparing.of(self.matrix)


def _pinched(eigenvalues: FloatArray, turned: FloatArray, sign: float) -> FloatArray:
    """Eigenvalues of the changed matrices with all but the smallest block's off-diagonal entries left out, (n, r)."""
    low = turned[:, :, :_PINCHED]
    block = np.diag(eigenvalues[:_PINCHED]) + sign * np.matmul(low.transpose(0, 2, 1), low)
    diagonal = eigenvalues[_PINCHED:] + sign * np.sum(turned[:, :, _PINCHED:] ** 2, axis=1)
    result: FloatArray = np.concatenate([np.linalg.eigvalsh(block), diagonal], axis=1)
    return result


def spectral_index(eigenvalues: FloatArray, index: str) -> FloatArray:
    """Return O2 to O5 of information matrices from their eigenvalues in any order, (n, r) -> (n,); 0 where singular."""
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
