"""Choosing among very many candidates: exchanges search a promising subset, and a bound over all limits the loss.

Each move of an exchange updates the small matrices of every candidate, so its time grows with their number, while good
choices use few of them. Let g_k be the slope of the concave relaxation (`calib.planning.selection_bound`). A candidate
whose g at the best weights is below that of every weighted candidate is in no best weighted choice; a candidate far
below is hardly ever in a good choice. So:

1. g at equal weights ranks all candidates. The best of each kind, and the starts, are searched.
2. The relaxation over all candidates, from that result, gives weights, a bound on every choice and a better g.
3. The best by that g are searched again, from the result and from the weights.

The bound is over all candidates, so the efficiency limits the loss. Up to `SCREENED` candidates, none is left out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.core.base.arrays import FloatArray, IntArray
from calib.planning.exchange import Exchange, Spacing
from calib.planning.selection_bound import CERTIFIED, slopes
from calib.planning.selection_problem import SelectionProblem
from calib.planning.selection_setting import SelectionSetting

SCREENED = 20_000
"""Above this number, candidates are screened, if the index has a bound and no least distance is set."""
_SEARCHED = 4096  # searched candidates
_FOR_EACH = 8  # searched candidates per requested candidate, if that is more


@dataclass(frozen=True, eq=False)
class CandidateSubset:
    """The candidates that exchanges search: their indices, ascending, (n,), and the problem and rules of these alone.

    `n_all` is the number of all candidates.
    """

    index: IntArray
    problem: SelectionProblem
    space: Spacing
    n_all: int

    def numbers_of(self, candidates: IntArray) -> IntArray:
        """Return the indices in this subset of candidates (n,), all of which must be in it."""
        return np.asarray(np.searchsorted(self.index, candidates))

    def with_all_numbers(self, result: Exchange) -> Exchange:
        """Return an exchange in this subset with the indices of all candidates."""
        chosen = np.zeros(self.n_all, dtype=bool)
        chosen[self.index[result.chosen]] = True
        history = tuple((a, b) if a < 0 else (int(self.index[a]), int(self.index[b])) for a, b in result.history)
        return replace(result, chosen=chosen, history=history)


def first_candidates(setting: SelectionSetting, starts: IntArray) -> CandidateSubset:
    """Return the first candidates to search: the best at equal weights, and the starts (n,)."""
    # without priors, K of all candidates is the identity
    alike = setting.count / len(setting.problem) * np.eye(len(setting.problem.strengths))
    return best_candidates(setting, setting.problem.before + alike, starts)


def best_candidates(setting: SelectionSetting, gathered: FloatArray, kept: IntArray) -> CandidateSubset:
    """Return the candidates with the largest slopes at K (r, r), and the kept ones (n,); all if not screened."""
    problem, space, counts = setting.problem, setting.space, setting.counts
    n_all = len(problem)
    if setting.index not in CERTIFIED or space.distance > 0 or n_all <= SCREENED:
        return CandidateSubset(np.arange(n_all), problem, space, n_all)
    ranked = np.where(space.usable, slopes(problem, setting.index, gathered), -np.inf)
    best = setting.largest(ranked, np.maximum(_SEARCHED // len(counts), _FOR_EACH * counts))
    index = np.union1d(np.concatenate(best), kept).astype(np.intp)
    return CandidateSubset(index, replace(problem, rows=problem.rows[index]), space.select(index), n_all)
