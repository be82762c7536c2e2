"""Which terms of the joints' errors earn their place: by marginal likelihood, confirmed on blocks of poses left out.

A candidate is a kind of term for all joints that can show it; all are tried on one linear model
(`calib.identification.term_trials`). A candidate earns its place by

    evidence     twice its log marginal likelihood rises by more than chance makes it rise in one data set of a hundred:
                 a chi-square of as many degrees of freedom as it has sizes, the chance shared among the candidates
    prediction   poses of blocks that were left out are predicted better: boxes of joint space; where the data tell
                 time, stretches of it as well; where they have several setups, whole setups as well

Both are asked because each misses what the other sees. The likelihood takes what is left for independent noise: where
the model lacks something else, a term that resembles it gains. Poses left out at random have neighbours that were kept,
so that a curve through errors of any cause seems to predict; blocks have not.

Of the candidates that earn their place, the one is added whose evidence rises furthest beyond chance, among those whose
prediction no other one beats by two standard errors (breiman1984). The others are then tried beside it, until none
earns its place. What would make an added term superfluous is not added: every term earns its place beside all others.

Kinds that look alike at the poses measured say different things elsewhere. Each of the others is tried in the place of
each that is added. Where one comes within odds of 20 to 1 (kass1995), the kind is a guess, and so is what the term says
of poses unlike those measured. It must then bring more than it costs, both mean squares of positions:

    brought      what poses of blocks left out are predicted better
    lost         what positions become less sure with it where the joint values measured are combined in other ways,
                 base and tool placed anew

A kind is called proven only if its evidence leads that of every other one by these odds, also beyond what chance gives
for its sizes, and none that would earn the place predicts blocks left out as well; else the others are named.
What is added is then fitted as any robot is, without linearising.

When it fails. Errors that no candidate describes stay. Blocks of a small part of joint space are neighbours of each
other: what predicts them need not hold elsewhere (`calib.identification.rules_reach`).

Reference: mackay1992; breiman1984; kass1995; roberts2017.
"""

from __future__ import annotations

import numpy as np
import scipy

from calib.errors import DataError
from calib.identification.candidate_terms import Candidate, TermChoice, TriedTerm, candidates
from calib.identification.fitted import Fit
from calib.identification.term_trials import BLOCKS, Trial, Trials
from calib.identification.validation import stretches
from calib.joint_terms.term import TermSection
from calib.threads import one_blas_thread
from calib.units import millimetres
from calib.words import listed

CHANCE = 0.01
"""Chance that some term rises in evidence by as much as is asked where there is none."""
TELLS = 3.0
"""Difference in log marginal likelihood from which data tell terms apart: odds of 20 to 1 (kass1995)."""
SURE = 2.0
"""Standard errors by which one prediction of blocks left out must be better than another to be called better."""
LEAST_POSES = 2 * BLOCKS
"""Different poses below which nothing is tried."""


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
        return TermChoice("auto", fit.robot.description.terms, tuple(TriedTerm(one.term, why=why) for one in kinds))
    tried = tuple(one for one in kinds if not one.refused)
    search = _Search(Trials(fit, tried), tried)
    chosen, brought = search.chosen()
    added = [section for one in search.tried if one.term in brought for section in search.entries(one, chosen)]
    sections = (*fit.robot.description.terms, *added)
    told = sorted((search.told(one, chosen, brought) for one in kinds), key=lambda one: not one.added)
    return TermChoice("auto", sections, tuple(told))


class _Search:
    """The search for those that earn their place.

    Args:
        trials: What the linear model says of some of them.
        tried: The candidates.
    """

    def __init__(self, trials: Trials, tried: tuple[Candidate, ...]) -> None:
        self.trials, self.tried = trials, tried

    def chosen(self) -> tuple[Trial, dict[str, tuple[Trial, Trial]]]:
        """Return the trial with all terms that earn their place, and for each the trials without and with it."""
        current = self.trials.of(())
        brought: dict[str, tuple[Trial, Trial]] = {}
        while True:
            free = [one.term for one in self.tried if not one.doubt and one.term not in current.terms]
            trials = [self.trials.of((*current.terms, term)) for term in free]
            earning = [trial for trial in trials if self.refused(trial) == ""]
            if not earning:
                return current, brought
            best = min(earning, key=lambda trial: float(np.sum(trial.squares[0])))
            near = [trial for trial in earning if not _surely_better(best, trial)]
            rises = [self.beyond_chance(current, trial) for trial in near]
            step = near[int(np.argmax(rises))]
            brought[step.terms[-1]] = current, step
            current = step

    def beyond_chance(self, without: Trial, trial: Trial) -> float:
        """Return by how much more twice the log evidence rises than chance makes it rise."""
        share, n_sizes = CHANCE / len(self.tried), trial.n_sizes - without.n_sizes
        return float(2.0 * (trial.evidence - without.evidence) - scipy.special.chdtri(n_sizes, share))

    def failed(self, without: Trial, trial: Trial) -> str:
        """Return why a trial has not earned the term that it has more; empty if it has."""
        if self.beyond_chance(without, trial) <= 0.0:
            return "no more evidence than chance gives"
        if not _predicts_better(trial, without):
            return "poses of blocks left out are not predicted better"
        return ""

    def refused(self, trial: Trial) -> str:
        """Return why not every term of a trial earns its place beside the others; empty if all do."""
        for term in trial.terms:
            without = self.trials.of(tuple(other for other in trial.terms if other != term))
            why = self.failed(without, trial) or self.guessed(term, without, trial)
            if why:
                return why if term == trial.terms[-1] else f"beside it {term} would not earn its place: {why}"
        return ""

    def guessed(self, term: str, without: Trial, trial: Trial) -> str:
        """Return why a term of a trial is a guess that costs more than it brings; empty if it is not."""
        if trial.unsure - without.unsure <= without.rms[0] ** 2 - trial.rms[0] ** 2:
            return ""
        alike = [name for name, other in self.instead(term, trial).items() if trial.evidence - other.evidence < TELLS]
        if not alike:
            return ""
        known, before = (millimetres(float(np.sqrt(one.unsure))) for one in (trial, without))
        return (
            f"the data cannot tell it from {listed(alike)}, and it costs more than it brings: positions at other"
            f" combinations of the joint values measured are known to {known:.3g} mm, to {before:.3g} mm without it"
        )

    def instead(self, term: str, trial: Trial) -> dict[str, Trial]:
        """Return the trials with each of the other kinds in the place of one."""
        others = tuple(other for other in trial.terms if other != term)
        free = [one.term for one in self.tried if one.term not in trial.terms]
        return {name: self.trials.of((*others, name)) for name in free}

    def entries(self, one: Candidate, trial: Trial) -> tuple[TermSection, ...]:
        """Return the entries of a candidate, with a larger sigma than is usual where the data ask for it."""
        if trial.sizes[one.term] <= 1.0 or one.term == "curve":  # the size of a curve is found again by the fit
            return one.sections
        return one.resized(self.trials.robot, trial.sizes[one.term])

    def told(self, one: Candidate, chosen: Trial, brought: dict[str, tuple[Trial, Trial]]) -> TriedTerm:
        """Return what a candidate brought, or why it was left out."""
        if one.refused:
            return TriedTerm(one.term, why=one.refused)
        added = one.term in brought
        without, with_it = brought[one.term] if added else (chosen, self.trials.of((*chosen.terms, one.term)))
        why = "" if added else self.failed(without, with_it) or one.doubt or self.refused(with_it)
        alike = self.alike(one.term, chosen) if added else {}
        gain = with_it.evidence - without.evidence
        return TriedTerm(one.term, added, gain, without.rms[0], with_it.rms[0], why, alike)

    def alike(self, term: str, chosen: Trial) -> dict[str, float]:
        """Return the terms that may be there in the place of one that was added, and how much less likely they are."""
        without = self.trials.of(tuple(other for other in chosen.terms if other != term))
        rise = self.beyond_chance(without, chosen)
        return {
            name: chosen.evidence - other.evidence
            for name, other in self.instead(term, chosen).items()
            if rise - self.beyond_chance(without, other) < 2.0 * TELLS
            or not (self.failed(without, other) or _predicts_better(chosen, other))
        }


def _predicts_better(one: Trial, other: Trial) -> bool:
    """Whether one predicts blocks left out better than another in every partition."""
    return all(np.sum(less) < np.sum(more) for less, more in zip(one.squares, other.squares, strict=True))


def _surely_better(best: Trial, trial: Trial) -> bool:
    """Whether one predicts blocks left out better than another in every partition, by two standard errors."""
    for less, more in zip(best.squares, trial.squares, strict=True):
        gain = more - less
        if np.sum(gain) <= SURE * np.std(gain, ddof=1) * np.sqrt(len(gain)):
            return False
    return True
