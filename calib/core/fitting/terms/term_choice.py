"""Which terms of the joints' errors earn their place: by marginal likelihood, confirmed on blocks of poses left out.

A candidate is a kind of term for all joints that can show it; all are tried on one linear model
(`calib.core.fitting.terms.term_trials`). A candidate earns its place by

    evidence     twice its log marginal likelihood rises by more than chance makes it rise in one data set of fifty:
                 a chi-square of as many degrees of freedom as it has sizes, the chance shared among the candidates
    prediction   poses of blocks that were left out are predicted better: boxes of joint space; where the data tell
                 time, stretches of it as well; where they have several setups, whole setups as well

Both are asked because each misses what the other sees. The likelihood takes what is left for independent noise: where
the model lacks something else, a term that resembles it gains. Poses left out at random have neighbours that were kept,
so that a curve through errors of any cause seems to predict; blocks have not.

Of the candidates that earn their place, the one is added whose evidence rises furthest beyond chance, among those whose
prediction no other one beats by two standard errors (breiman1984). The others are then tried beside it, until none
earns its place. What would make an added term superfluous is not added: every term earns its place beside all others.

Kinds that look alike at the poses measured say different things elsewhere. Another kind that would earn the place is
told apart from the one added only if its log evidence, beyond what chance gives for its sizes, is lower by odds of 20
to 1 (kass1995), and it predicts blocks left out worse. Kinds that are not told apart are added together: predictions
then lie between what each would say, intervals hold either, and no single kind is claimed. Such a group is a guess,
and so is a kind alone to which the evidence of any other one comes within these odds. A guess must bring more than it
costs, both mean squares of positions:

    brought      what poses of blocks left out are predicted better
    lost         what positions become less sure with it where the joint values measured are combined in other ways,
                 base and tool placed anew

Where a group costs more, its likeliest kind is tried alone. Terms that are added later may tell the kinds of a group
apart; then the others leave it. A kind is called proven only if it was added alone and every other one is told from it,
whether that one would earn the place or not; else the others are named.
What is added is then fitted as any robot is, without linearising. What is left out may be there all the same, too small
to be proven: intervals count it by its evidence (`calib.core.numerics.undecided`).

When it fails. Errors that no candidate describes stay. Blocks of a small part of joint space are neighbours of each
other: what predicts them need not hold elsewhere (`calib.core.judging.rules_reach`).

Reference: mackay1992; breiman1984; kass1995; roberts2017.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import DataError
from calib.core.base.threads import one_blas_thread
from calib.core.base.units import millimetres
from calib.core.base.words import listed
from calib.core.fitting.fitted import Fit
from calib.core.fitting.terms.candidate_terms import Candidate, TermChoice, TriedTerm, candidates
from calib.core.fitting.terms.term_trials import BLOCKS, Trial, Trials
from calib.core.fitting.validation import stretches
from calib.core.robots.terms.term import TermSection
from calib.core.rows.prediction import UndecidedTerms

ADDED_BY_CHANCE = 0.02
"""Chance that some term rises in evidence by as much as is asked where there is none."""
TELLS = 3.0
"""Difference in log marginal likelihood from which data tell terms apart: odds of 20 to 1 (kass1995)."""
SURE = 2.0
"""Standard errors by which one prediction of blocks left out must be better than another to be called better."""
LEAST_POSES = 2 * BLOCKS
"""Different poses below which nothing is tried."""

Group = tuple[str, ...]
"""Terms that the data cannot tell from each other, the likeliest first; or a term alone."""
Groups = tuple[Group, ...]


@one_blas_thread
def choose_terms(fit: Fit) -> TermChoice:
    """Choose the terms to add to a robot.

    Args:
        fit: The fit with the terms that it has anyway.

    Raises:
        DataError: Too few poses for blocks of them.
    """
    data = fit.identification.data
    if len(stretches(data, LEAST_POSES)) < LEAST_POSES:
        raise DataError(
            f"{data.path}: choosing terms leaves out blocks of poses, and needs at least {LEAST_POSES} different poses;"
            " name the terms (--terms curve,gain), or measure more"
        )
    kinds = candidates(fit.robot, data)
    if fit.computed:
        why = "nothing is left to explain: these data were computed, not measured"
        return TermChoice(
            "auto", fit.robot.description.terms, tuple(TriedTerm(candidate.term, why=why) for candidate in kinds)
        )
    tried = tuple(candidate for candidate in kinds if not candidate.refused)
    search = _Search(Trials(fit, tried), tried)
    groups = search.chosen()
    chosen = search.of(groups)
    added = [
        section
        for candidate in search.tried
        if candidate.term in chosen.terms
        for section in search.entries(candidate, chosen)
    ]
    sections = (*fit.robot.description.terms, *added)
    tried_terms = sorted((search.outcome(candidate, groups) for candidate in kinds), key=lambda term: not term.added)
    return TermChoice("auto", sections, tuple(tried_terms), search.undecided(chosen), search.expected_rms())


class _Search:
    """The search for those that earn their place.

    Args:
        trials: What the linear model says of some of them.
        tried: The candidates.
    """

    def __init__(self, trials: Trials, tried: tuple[Candidate, ...]) -> None:
        self.trials, self.tried = trials, tried

    def of(self, groups: Groups) -> Trial:
        """Return the trial with all terms of some groups."""
        return self.trials.of(tuple(term for group in groups for term in group))

    def chosen(self) -> Groups:
        """Return the groups that earn their place."""
        groups: Groups = ()
        while True:
            without = self.of(groups)
            alone = {term: self.of((*groups, (term,))) for term in self.free(groups)}
            steps = {term: self.step(groups, term) for term, trial in alone.items() if not self.failed(without, trial)}
            earning = [term for term, step in steps.items() if step]
            if not earning:
                return groups
            best = min((alone[term] for term in earning), key=lambda trial: float(np.sum(trial.left_out(0)[0])))
            near = [term for term in earning if not _surely_better(best, alone[term])]
            groups = steps[max(near, key=lambda term: self.beyond_chance(without, alone[term]))]

    def free(self, groups: Groups) -> list[str]:
        """Return the terms that may be added to some groups."""
        return [
            candidate.term
            for candidate in self.tried
            if not candidate.doubt and not any(candidate.term in group for group in groups)
        ]

    def step(self, groups: Groups, term: str) -> Groups:
        """Return the groups with a term and what cannot be told from it, or with it alone; none if neither earns it."""
        without, with_term = self.of(groups), self.of((*groups, (term,)))
        others = [
            other for other in self.free(groups) if other != term and self.alike(without, with_term, groups, other)
        ]
        for group in dict.fromkeys([(term, *others), (term,)]):
            stepped = self.told_apart((*groups, group))
            if not self.refused(stepped):
                return stepped
        return ()

    def alike(self, without: Trial, with_term: Trial, groups: Groups, other: str) -> bool:
        """Whether another term would earn the place of one, and is not told from it."""
        instead = self.of((*groups, (other,)))
        return not self.failed(without, instead) and (
            self.beyond_chance(without, with_term) - self.beyond_chance(without, instead) < 2.0 * TELLS
            or not _predicts_better(with_term, instead)
        )

    def told_apart(self, groups: Groups) -> Groups:
        """Return groups without the terms that can be told from the likeliest one of theirs beside the other groups."""
        kept = list(groups)
        for k, group in enumerate(groups):
            rest = (*kept[:k], *kept[k + 1 :])
            without, alone = self.of(rest), {term: self.of((*rest, (term,))) for term in group}
            best = max(group, key=lambda term: self.beyond_chance(without, alone[term]))
            others = (term for term in group if term != best and self.alike(without, alone[best], rest, term))
            kept[k] = best, *others
        return tuple(kept)

    def beyond_chance(self, without: Trial, trial: Trial) -> float:
        """Return by how much more twice the log evidence rises than chance makes it rise."""
        share, n_sizes = ADDED_BY_CHANCE / len(self.tried), trial.n_sizes - without.n_sizes
        return float(2.0 * (trial.evidence - without.evidence) - scipy.special.chdtri(n_sizes, share))

    def failed(self, without: Trial, trial: Trial) -> str:
        """Return why a trial has not earned the term that it has more; empty if it has."""
        if np.isneginf(trial.evidence):
            return "its coefficients are so many that they explain every reading: measure more poses"
        if self.beyond_chance(without, trial) <= 0.0:
            return "no more evidence than chance gives"
        if not _predicts_better(trial, without):
            return "poses of blocks left out are not predicted better"
        return ""

    def refused(self, groups: Groups) -> str:
        """Return why not every group, by its likeliest term, earns its place beside the others; empty if all do."""
        trial = self.of(groups)
        for group in groups:
            rest = tuple(other for other in groups if other != group)
            without = self.of(rest)
            why = self.failed(without, self.of((*rest, group[:1]))) or self.guessed(group, without, trial)
            if why:
                name = " or ".join(group)
                return why if group == groups[-1] else f"{name} is not worth adding beside it: {why}"
        return ""

    def guessed(self, group: Group, without: Trial, trial: Trial) -> str:
        """Return why a group of a trial is a guess that costs more than it brings; empty if it is not."""
        if trial.unsure - without.unsure <= without.rms**2 - trial.rms**2:
            return ""
        alike = list(group[1:]) or [
            name for name, other in self.instead(group[0], trial).items() if trial.evidence - other.evidence < TELLS
        ]
        if not alike:
            return ""
        known, otherwise = (millimetres(float(np.sqrt(which.unsure))) for which in (trial, without))
        return (
            f"the data cannot tell it from {listed(alike)}, and its cost is larger than its gain: at other combinations"
            f" of measured joint values, positions are known to {known:.3g} mm with, to {otherwise:.3g} mm without it"
        )

    def undecided(self, chosen: Trial) -> UndecidedTerms | None:
        """Return what terms that were not added leave uncertain beside those of a trial; None if nothing."""
        others = [candidate for candidate in self.tried if not candidate.doubt and candidate.term not in chosen.terms]
        by_term = self.trials.undecided(chosen.terms, [candidate.term for candidate in others])
        if not by_term:
            return None
        sections = tuple(section for candidate in others if candidate.term in by_term for section in candidate.sections)
        return UndecidedTerms.of(sections, list(by_term.values()))

    def expected_rms(self) -> float:
        """Return how far off poses that are left out are expected to be, whichever terms are there [SI]."""
        return self.trials.expected_rms([candidate.term for candidate in self.tried if not candidate.doubt])

    def instead(self, term: str, trial: Trial) -> dict[str, Trial]:
        """Return the trials with each of the other kinds in the place of one."""
        others = tuple(other for other in trial.terms if other != term)
        free = [candidate.term for candidate in self.tried if candidate.term not in trial.terms]
        return {name: self.trials.of((*others, name)) for name in free}

    def entries(self, candidate: Candidate, trial: Trial) -> tuple[TermSection, ...]:
        """Return the entries of a candidate, with a larger sigma than is usual where the data ask for it."""
        found_again = all(p.family for term in candidate.of(self.trials.robot) for p in term.parameters)  # by the fit
        if trial.sizes[candidate.term] <= 1.0 or found_again:
            return candidate.sections
        return candidate.resized(self.trials.robot, trial.sizes[candidate.term])

    def outcome(self, candidate: Candidate, groups: Groups) -> TriedTerm:
        """Return what a candidate, with what it is not told from, brings beside the others, or why it was left out."""
        if candidate.refused:
            return TriedTerm(candidate.term, why=candidate.refused)
        group = next((group for group in groups if candidate.term in group), ())
        tried = (*groups, (candidate.term,))
        without = self.of(tuple(other for other in groups if other != group))
        with_it = self.of(groups if group else tried)
        why = "" if group else self.failed(without, with_it) or candidate.doubt or self.refused(self.told_apart(tried))
        if np.isneginf(with_it.evidence):
            return TriedTerm(candidate.term, why=why)
        together = tuple(term for term in group if term != candidate.term)
        alike = self.rivals(candidate.term, groups) if group else {}
        gain = with_it.evidence - without.evidence
        size = self.of(groups).sizes[candidate.term] if group else float("nan")
        return TriedTerm(candidate.term, bool(group), gain, without.rms, with_it.rms, why, size, together, alike)

    def rivals(self, term: str, groups: Groups) -> dict[str, float]:
        """Return the terms that may be there in the place of one that was added, and how much less likely they are."""
        rest = tuple(group for group in groups if term not in group)
        together = {other for group in groups if term in group for other in group}
        without, with_term = self.of(rest), self.of((*rest, (term,)))
        rise = self.beyond_chance(without, with_term)
        return {
            name: with_term.evidence - other.evidence
            for name, other in self.instead(term, with_term).items()
            if name in together
            or rise - self.beyond_chance(without, other) < 2.0 * TELLS
            or not (self.failed(without, other) or _predicts_better(with_term, other))
        }


def _predicts_better(trial: Trial, other: Trial) -> bool:
    """Whether a trial predicts blocks left out better than another one in every partition."""
    return all(np.sum(less) < np.sum(more) for less, more in _squares(trial, other))


def _surely_better(best: Trial, trial: Trial) -> bool:
    """Whether a trial predicts blocks left out better than another one in every partition, by two standard errors."""
    for less, more in _squares(best, trial):
        gain = more - less
        if np.sum(gain) <= SURE * np.std(gain, ddof=1) * np.sqrt(len(gain)):
            return False
    return True


def _squares(trial: Trial, other: Trial) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield what two trials are off with blocks left out, partition by partition: most are told by the first."""
    return ((trial.left_out(k)[0], other.left_out(k)[0]) for k in range(trial.n_partitions))
