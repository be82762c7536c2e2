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

from calib.core.base.arrays import BoolArray, FloatArray, IntArray
from calib.planning.exchange import Exchange
from calib.planning.selection_bound import CERTIFIED, Relaxation, slopes
from calib.planning.selection_setting import SelectionSetting

SCREENED = 20_000
"""Above this number, candidates are screened, if the index has a bound and no least distance is set."""
_SEARCHED = 4096  # searched candidates
_FOR_EACH = 8  # searched candidates per requested candidate, if that is more


@dataclass(frozen=True, eq=False)
class CandidateSubset:
    """The candidates that exchanges search.

    Attributes:
        all_candidates: The setting with all candidates.
        index: Searched candidates, ascending, (n,).
        setting: The setting with these alone.
    """

    all_candidates: SelectionSetting
    index: IntArray
    setting: SelectionSetting

    @property
    def is_part(self) -> bool:
        """Whether some candidates are left out."""
        return self.setting is not self.all_candidates

    def numbers_of(self, candidates: IntArray) -> IntArray:
        """Return the indices in this subset of candidates (n,), all of which must be in it."""
        result: IntArray = np.searchsorted(self.index, candidates)
        return result

    def with_all_numbers(self, result: Exchange) -> Exchange:
        """Return an exchange in this subset with the indices of all candidates."""
        if not self.is_part:
            return result
        chosen = np.zeros(len(self.all_candidates.problem), dtype=bool)
        chosen[self.index[result.chosen]] = True
        history = tuple((a, b) if a < 0 else (int(self.index[a]), int(self.index[b])) for a, b in result.history)
        return replace(result, chosen=chosen, history=history)


def first_candidates(setting: SelectionSetting, starts: IntArray) -> CandidateSubset:
    """Return the first candidates to search: the best at equal weights, and the starts (n,)."""
    if not _is_screened(setting):
        return CandidateSubset(setting, np.arange(len(setting.problem)), setting)
    problem = setting.problem
    # without priors, K of all candidates is the identity
    alike = problem.before + setting.request.count / len(problem) * np.eye(len(problem.strengths))
    return _narrow(setting, slopes(problem, setting.request.index, alike), starts)


def candidates_after_relaxation(
    setting: SelectionSetting, relaxation: Relaxation, chosen: BoolArray
) -> CandidateSubset:
    """Return the candidates to search after the relaxation and a choice (n_candidates,)."""
    if not _is_screened(setting):
        return CandidateSubset(setting, np.arange(len(setting.problem)), setting)
    problem = setting.problem
    slope = slopes(problem, setting.request.index, problem.information_of(relaxation.weights))
    return _narrow(setting, slope, np.flatnonzero(chosen | (relaxation.weights > 0)))


def _is_screened(setting: SelectionSetting) -> bool:
    request = setting.request
    return request.index in CERTIFIED and request.minimum_distance == 0 and len(setting.problem) > SCREENED


def _narrow(setting: SelectionSetting, slope: FloatArray, kept: IntArray) -> CandidateSubset:
    """The candidates with the largest slope (n_candidates,), and the kept ones (n,)."""
    counts = setting.counts
    ranked = np.where(setting.space.usable, slope, -np.inf)
    best = setting.largest(ranked, np.maximum(_SEARCHED // len(counts), _FOR_EACH * counts))
    index = np.union1d(np.concatenate(best), kept).astype(np.intp)
    problem, pairs, space = setting.problem, setting.pairs, setting.space
    few = replace(
        setting,
        problem=replace(problem, rows=problem.rows[index]),
        pairs=replace(
            pairs,
            pose=pairs.pose[index],
            group=pairs.group[index],
            rows=pairs.rows[index],
            possible=pairs.possible[index],
            n_read=pairs.n_read[index],
        ),
        space=replace(
            space,
            points=space.points[index],
            usable=space.usable[index],
            pose=None if space.pose is None else space.pose[index],
            kind=None if space.kind is None else space.kind[index],
        ),
    )
    return CandidateSubset(setting, index, few)
