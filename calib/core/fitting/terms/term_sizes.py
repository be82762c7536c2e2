"""Sizes of all kinds of joint errors, in one model, instead of a choice of kinds.

The model is that of `calib.core.fitting.terms.kind_model` around the fit of the origins, with all kinds of terms that
the measurements can show (`calib.core.fitting.terms.candidate_terms`). Sizes are found by restricted likelihood,
together with the noise.

Which kinds are fitted. From the model of all, kinds are left out one by one, those with most coefficients first, until
all stay. A kind stays where both are true:

    prediction   left-out blocks of poses are predicted better: the sum of squared errors falls by more than one
                 standard error over the blocks. Blocks are boxes of joint space, for each setup. Likelihood alone would
                 trust the model, and support any kind that looks like errors of no kind. Poses left out at random have
                 neighbours that were kept, so that a curve through errors of any cause seems to predict
    evidence     the likelihood is higher with it by a factor of 20 (kass1995), times the number of kinds: among many
                 absent kinds, one looks present by chance

A kind that was left out is tried again with those that stay. A kind that stays is proven if the likelihood is
higher with it by a factor of 20, given all other kinds. Of kinds that look alike, one may stay, but none is proven.

Results:

    terms        kinds that stay are fitted like any term, with the sigma that was found
    undecided    the other kinds may exist, too, and sizes are uncertain: what drawn sizes of all kinds that the rows
                 leave open add is added to the covariance of the fit. Sizes of fitted curves are not drawn: the fit
                 finds them again, and counts their uncertainty (`calib.core.numerics.size_search`)

Weighting the fit itself by the error of joints was no better on a tracked arm, and much worse where a camera reads
several points of a pose. Time and temperature are no kinds of this model unless they are named: an error that grows
with them was worse on every part of a file that lay outside their range.

When it fails. Joint errors of many milliradians look curved. Blocks of a small part of joint space are neighbours of
each other: a kind that predicts them need not hold elsewhere. Of kinds that look alike, one stays.

Reference: breiman1984; kass1995; patterson1971; roberts2017.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray, IntArray
from calib.core.base.errors import DataError
from calib.core.base.threads import one_blas_thread
from calib.core.data.measurements import Measurements
from calib.core.data.pose_groups import boxes, repeated_poses
from calib.core.fitting.fitted import Fit
from calib.core.fitting.regions import BLOCKS
from calib.core.fitting.terms.candidate_terms import (
    TELLS,
    CandidateTerm,
    TermChoice,
    TermTrial,
    candidates,
)
from calib.core.fitting.terms.kind_model import KindModel
from calib.core.numerics.mixed_model import MixedModel, SolvedModel
from calib.core.numerics.size_search import draw_sizes, least_sizes, likeliest_sizes
from calib.core.robots.terms.term import TermSection
from calib.core.rows.prediction import UndecidedTerms

LEAST_POSES = 16
"""Fewest different poses from which sizes are found."""
_SMALL = 0.05  # below this part of the usual size, a family is fitted only if the rows show it
_SHOWS = 1.0  # rise of the log likelihood by a family that the rows show
_ROUGH = 0.05  # error of the log likelihood of kinds that are compared
_DRAWS = 24
_SHORTEST = 0.3  # a component of usual size is dropped if its length is below this part of the fit's noise
_LIMITS = (0.025, 0.975)
_TOO_FEW = "these measurements are too few to fit it; measure more poses"


def has_poses_for_terms(data: Measurements) -> bool:
    """Whether measurements have enough different poses to find the sizes of terms."""
    return len(repeated_poses(data.joints, data.pose_numbers)) >= LEAST_POSES


@one_blas_thread
def size_terms(fit: Fit, *, adds_terms: bool = True) -> TermChoice:
    """Return the terms of the joints' errors with the sizes that measurements show.

    Args:
        adds_terms: Whether terms may be fitted; if not, those that would be are undecided.

    Raises:
        DataError: Too few poses.
    """
    data, described = fit.identification.data, fit.robot.description.terms
    if not has_poses_for_terms(data):
        raise DataError(
            f"{data.path}: finding which joint terms are there needs at least {LEAST_POSES} different poses; name the"
            " terms (--terms curve,gain), or measure more"
        )
    kinds = candidates(fit.robot, data)
    if fit.computed:
        why = "nothing is left to explain: these data were computed, not measured"
        return TermChoice("auto", described, tuple(TermTrial(candidate.term, refusal=why) for candidate in kinds))
    requested = tuple(candidate for candidate in kinds if not candidate.refusal)
    model = _TermModel(fit, requested, adds_terms)
    tried = [TermTrial(kind.term, refusal=kind.refusal) if kind.refusal else model.outcome(kind) for kind in kinds]
    sections = (*described, *(section for candidate in requested for section in model.entries(candidate)))
    tried.sort(key=lambda term: not term.added)
    return TermChoice("auto", sections, tuple(tried), model.undecided(sections))


class _TermModel:
    def __init__(self, fit: Fit, kinds: Sequence[CandidateTerm], adds_terms: bool) -> None:
        self._fit, self._kinds, self._kind_model = fit, kinds, KindModel(fit, kinds)
        self._adds_terms = adds_terms
        self._families, read = self._kind_model.families, self._kind_model.informative_rows
        self._terms = np.array([family.term for family in self._families], dtype=np.str_)  # of each family
        self._requested_kinds = frozenset(map(str, self._terms))
        # divided by the noise that the fit found: stated noise contains no errors of the robot
        self._rows = self._kind_model.rows(read, fit.scales, np.zeros(len(fit.scales), dtype=bool))
        self._solved_model = likeliest_sizes(MixedModel.from_rows(self._rows), least_gain=_ROUGH)
        self._smallest_logs = least_sizes(self._solved_model.model)  # as good as zero
        self._solved = {self._requested_kinds: self._solved_model}
        self._left_out = dict[frozenset[str], FloatArray]()

    @cached_property
    def _blocks(self) -> IntArray:
        """Block of each row of the model by the module docstring, (n_rows,)."""
        data, depths = self._fit.identification.data, self._fit.robot.mechanism.depths
        setups = np.zeros(len(data), dtype=np.intp) if data.setups is None else data.setups
        layout, block = self._fit.whitening.layout, np.zeros(len(data), dtype=np.intp)
        visits = layout.visit[layout.reading[self._kind_model.informative_rows]]
        each = np.unique(setups[visits])
        for setup in each:
            there = np.flatnonzero(setups == setup)
            own = boxes(data.joints[there], data.pose_numbers[there], -(-BLOCKS // len(each)), depths)
            block[there] = np.max(block) + 1 + own
        return np.unique(block[visits], return_inverse=True)[1]

    def _solve_with_kinds(self, kinds: frozenset[str]) -> SolvedModel:
        """The model with some of the requested kinds; the search starts from the most similar solved set."""
        full = self._solved_model
        if kinds not in self._solved:
            near = self._solved[min(self._solved, key=lambda known: full.freedom(self._members(known ^ kinds)))].logs
            solved = likeliest_sizes(
                full.model, np.where(np.isneginf(near), full.logs, near), self._absent(kinds), _ROUGH
            )
            self._solved = {of: replace(at) for of, at in self._solved.items()}  # cached matrices take memory
            self._solved[kinds] = solved
        return self._solved[kinds]

    def _absent(self, kinds: frozenset[str]) -> BoolArray:
        """Mask of the families of all other requested kinds, (n_families,)."""
        return ~np.isin(self._terms, list(kinds))

    def _squares(self, kinds: frozenset[str]) -> FloatArray:
        """Squared errors of left-out blocks, divided by those of the model without terms, (n_blocks,)."""
        if kinds not in self._left_out:
            sums = self._solve_with_kinds(frozenset()).squares_and_freedom[0]
            counts = np.bincount(self._rows.group, minlength=len(sums))
            weights = counts / np.where(sums > 0.0, sums, np.inf)
            self._left_out[kinds] = self._solve_with_kinds(kinds).left_out_squares(self._blocks, weights)
        return self._left_out[kinds]

    def _earns(self, kind: str, kinds: frozenset[str]) -> bool:
        """Whether a kind stays among these kinds, by the two conditions of the module docstring."""
        more, fewer = kinds | {kind}, kinds - {kind}
        evidence = self._solve_with_kinds(fewer).cost - self._solve_with_kinds(more).cost
        if evidence <= TELLS + np.log(len(self._requested_kinds)):
            return False
        gains = self._squares(fewer) - self._squares(more)
        return float(np.sum(gains)) > np.sqrt(len(gains)) * float(np.std(gains, ddof=1))

    @cached_property
    def _chosen_model(self) -> SolvedModel:
        every = kinds = self._requested_kinds
        seen = set[frozenset[str]]()
        while kinds not in seen:
            seen.add(kinds)
            at = self._solve_with_kinds(kinds)
            for kind in sorted(kinds, key=lambda kind: -at.freedom(self._members({kind}))):
                kinds = kinds if self._earns(kind, kinds) else kinds - {kind}
            if kinds not in seen:
                continue
            more = [kind for kind in sorted(every - kinds) if self._earns(kind, kinds)]
            kinds |= {min(more, key=lambda kind: self._solve_with_kinds(kinds | {kind}).cost)} if more else kinds
        return likeliest_sizes(self._solved_model.model, self._solve_with_kinds(kinds).logs, self._absent(kinds))

    @cached_property
    def _is_fitted(self) -> BoolArray:
        return self._is_large & self._adds_terms

    @cached_property
    def _is_large(self) -> BoolArray:
        """Whether each family of the chosen model is large, or the log likelihood is higher with it, (n_families,)."""
        chosen, n = self._chosen_model, len(self._families)
        fitted, least = np.exp(chosen.logs[:n]) > _SMALL, chosen.logs[:n] <= self._smallest_logs[:n]
        for k in np.flatnonzero(~(fitted | least)):
            without = likeliest_sizes(chosen.model, chosen.logs, least | (np.arange(n) == k))
            fitted[k] = without.cost - chosen.cost > _SHOWS
        return fitted

    def _members(self, kinds: Collection[str]) -> IntArray:
        """Numbers of the families of some kinds."""
        return np.flatnonzero(np.isin(self._terms, list(kinds)))

    def entries(self, candidate: CandidateTerm) -> tuple[TermSection, ...]:
        """Return the fitted entries of a kind, with the sigma that was found."""
        factors = dict[str, float]()
        terms = candidate.terms_in(self._kind_model.robot)
        for k in (k for k in self._members({candidate.term}) if self._is_fitted[k]):
            joints = [term.joint for term in terms if self._families[k].joint in ("", term.joint)]
            factors |= dict.fromkeys(joints, float(np.exp(self._chosen_model.logs[k])))
        if candidate.is_curve_in(self._kind_model.robot):  # the fit finds its size again
            section = candidate.sections[0]
            return tuple(section.model_copy(update={"joint": joint}) for joint in factors)
        return candidate.scaled_sections(self._kind_model.robot, factors)

    def outcome(self, candidate: CandidateTerm) -> TermTrial:
        """Return the outcome for a kind."""
        members = self._members({candidate.term})
        there = [k for k in members if self._is_fitted[k]]
        most = max(members, key=lambda k: self._chosen_model.logs[k])
        low, high = np.quantile(np.exp(self._draws[:, most]), _LIMITS)  # beside all kinds: the size is beside fewer
        size = float(np.exp(max(self._chosen_model.logs[most], self._smallest_logs[most])))
        return TermTrial(
            candidate.term,
            bool(there),
            self._solve_with_kinds(self._requested_kinds - {candidate.term}).cost - self._solved_model.cost
            if there
            else float("nan"),
            size,
            (min(float(low), size), max(float(high), size)),
            tuple(self._families[k].joint for k in there if self._families[k].joint),
            "" if self._adds_terms or not np.any(self._is_large[members]) else _TOO_FEW,
        )

    @cached_property
    def _draws(self) -> FloatArray:
        """Logarithms of sizes that the rows leave open, (n_draws, n_sizes)."""
        return draw_sizes(self._solved_model, _DRAWS, np.random.default_rng(self._fit.seed))

    def undecided(self, fitted_terms: tuple[TermSection, ...]) -> UndecidedTerms | None:
        """Return the uncertainty that the sizes leave in these terms and in the others; None if they leave none."""
        fitted = np.append(self._is_fitted, np.ones(len(self._smallest_logs) - len(self._families), dtype=bool))
        logs = np.where(fitted, self._chosen_model.logs, self._smallest_logs)
        curves = [kind.term for kind in self._kinds if kind.is_curve_in(self._kind_model.robot)]
        sized = np.isin(np.arange(len(logs)), np.flatnonzero(np.isin(self._terms, curves)))
        draws = np.where(fitted & sized, logs, self._draws)  # a fit finds the sizes of curves again
        model, robot = MixedModel.from_rows(self._rows, _SHORTEST), self._fit.robot.with_terms(fitted_terms)
        return self._kind_model.undecided(model, logs, draws, robot)
