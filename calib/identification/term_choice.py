"""Which terms of the joints' errors earn their place: by marginal likelihood, confirmed on blocks of poses left out.

Around the fit without them, all candidates are columns of one linear model (`calib.numerics.variance_components`). A
candidate is a kind of term for all joints that can show it; how large its coefficients are is one number for the kind
(one for each joint, for a curve), found together with the noise by marginal likelihood. A candidate earns its place by

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
Each of the others is tried in the place of each that was added: those that do as well, within odds of 20 to 1
(kass1995), are told, for the data do not say which of them is there.
Sizes and noise are those of all poses, also where blocks are left out: a handful of numbers, and they stay the same in
all blocks. What is added is then fitted as any robot is, without linearising.

When it fails. Errors that no candidate describes stay. Blocks of a small part of joint space are neighbours of each
other: what predicts them need not hold elsewhere (`calib.identification.rules_reach.beyond_curves`).

Reference: mackay1992; breiman1984; kass1995; roberts2017.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy

from calib.arrays import BoolArray, FloatArray, IntArray, ReadOnlyArrays
from calib.errors import DataError
from calib.identification.candidate_terms import Candidate, TermChoice, TriedTerm, candidates
from calib.identification.fitted import Fit
from calib.identification.validation import boxes, stretches
from calib.joint_terms.term import TermSection
from calib.linearisation.observed import observe
from calib.linearisation.rows import Rows
from calib.linearisation.unknowns import Unknowns
from calib.numerics.variance_components import LinearModel, found_with_families, log_evidence
from calib.threads import one_blas_thread

CHANCE = 0.01
"""Chance that some term rises in evidence by as much as is asked where there is none."""
BLOCKS = 8
"""Number of blocks that are left out in turns."""
TELLS = 3.0
"""Difference in log marginal likelihood from which data tell terms apart: odds of 20 to 1 (kass1995)."""
SURE = 2.0
"""Standard errors by which one prediction of blocks left out must be better than another to be called better."""
LEAST_POSES = 2 * BLOCKS
"""Different poses below which nothing is tried."""
_RIDGE = 1e-12  # of its diagonal, added to a matrix whose null space the blocks left may widen
_NOTHING = 1e-6  # singular value over the largest, below which a principal component says nothing
_LOST = 1e-9  # part of a place's information below which only the poses that are left out see it


@dataclass(frozen=True, eq=False)
class _Trial(ReadOnlyArrays):
    """The linear model with some terms.

    Attributes:
        terms: Their names.
        evidence: Log marginal likelihood.
        n_sizes: How many sizes were found.
        sizes: Largest size found of each term, over what is expected.
        squares: Of each partition, whitened squares of what each block is off when left out, (n_blocks,) each.
        rms: Of each partition, root mean square of the main part, left out in turns [SI].
    """

    terms: tuple[str, ...]
    evidence: float
    n_sizes: int
    sizes: dict[str, float]
    squares: tuple[FloatArray, ...]
    rms: tuple[float, ...]


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
    search = _Search(fit, tuple(one for one in kinds if not one.refused))
    chosen, brought = search.chosen()
    added = [section for one in search.tried if one.term in brought for section in search.entries(one, chosen)]
    sections = (*fit.robot.description.terms, *added)
    told = sorted((search.told(one, chosen, brought) for one in kinds), key=lambda one: not one.added)
    return TermChoice("auto", sections, tuple(told))


@dataclass(frozen=True, eq=False)
class _Design(ReadOnlyArrays):
    """Columns of all candidates and of what the fit has anyway.

    The many columns of a curve span little more than the poses do: those of one family are replaced by their principal
    components, U S of U S V^T. A prior that is the same for all of them stays what it is, and nothing is lost.

    Attributes:
        rows: Whitened by what is stated, (n_rows, n_columns).
        residuals: (n_rows,).
        parameters: Scaled parameters of each column, (n_parameters, n_columns).
        has_prior, deviations: As of `calib.linearisation.rows.Rows`, (n_columns,).
        owner: The candidate of each column; empty for what the fit has anyway.
        label: The size of each column's coefficients: its name; empty where it is not to be found.
    """

    rows: FloatArray
    residuals: FloatArray
    parameters: FloatArray
    has_prior: BoolArray
    deviations: FloatArray
    owner: tuple[str, ...]
    label: tuple[str, ...]


def _design(rows: Rows, unknowns: Unknowns, owner: list[str]) -> _Design:
    families = [unknowns.families[number] if number >= 0 else "" for number in unknowns.family]
    labels = [family or own for family, own in zip(families, owner, strict=True)]
    columns: list[FloatArray] = []
    parts: list[IntArray] = []
    for label in dict.fromkeys(labels):
        members = np.array([k for k, other in enumerate(labels) if other == label])
        maps = np.eye(len(labels))[:, members]
        if label and owner[members[0]] and len(members) > 1:
            _, values, directions = np.linalg.svd(rows.jacobian[:, members], full_matrices=False)
            kept = max(int(np.sum(values > _NOTHING * values[0])), 1)
            maps, members = maps @ directions[:kept].T, np.full(kept, members[0])
        columns.append(maps)
        parts.append(members)
    maps, first = np.hstack(columns), np.concatenate(parts)
    return _Design(
        rows.jacobian @ maps,
        rows.residuals,
        maps,
        rows.has_prior[first],
        maps.T @ rows.deviations,
        tuple(owner[k] for k in first),
        tuple(labels[k] for k in first),
    )


class _Search:
    """Trials on the fit's linear model, which has the columns of all candidates.

    Args:
        fit: The fit without them.
        tried: The candidates.
    """

    def __init__(self, fit: Fit, tried: tuple[Candidate, ...]) -> None:
        data, layout = fit.identification.data, fit.whitening.layout
        self.fit, self.tried = fit, tried
        added = (section for one in tried for section in one.sections)
        self._robot = fit.robot.with_terms((*fit.robot.description.terms, *added))
        configurations = self._robot.assemble(data.joints, labels=data.labels, context=data.conditions)
        observed = observe(self._robot, configurations, data.readings)
        unknowns = Unknowns.of(self._robot)
        owner = {p.name: one.term for one in tried for term in one.of(self._robot) for p in term.parameters}
        rows = fit.whitening.rows(
            observed, np.ones(len(layout.groups)), unknowns, unknowns.deviations(self._robot.values)
        ).weighted(fit.weights)
        rows = rows.whitened(fit.whitening.weighing(fit.scales.ratios))
        self._design = _design(rows, unknowns, [owner.get(name, "") for name in unknowns.names])
        change = unknowns.scales[:, None] * self._design.parameters
        self._residuals = {name: one.residuals for name, one in observed.items()}
        self._by_column = {name: one.jacobian[:, :, unknowns.index] @ change for name, one in observed.items()}
        self._partitions = [boxes(data, BLOCKS)]
        if np.ptp(data.conditions.time) > 0:
            self._partitions.append(stretches(data, BLOCKS))
        if data.setups is not None and np.ptp(data.setups) > 0:
            self._partitions.append([np.flatnonzero(data.setups == one) for one in np.unique(data.setups)])
        self._known: dict[tuple[str, ...], _Trial] = {}
        self._divisor = fit.whitening.row_scale(fit.scales.groups * fit.statistics.factors.found)

    def chosen(self) -> tuple[_Trial, dict[str, tuple[_Trial, _Trial]]]:
        """Return the trial with all terms that earn their place, and for each the trials without and with it."""
        current = self.trial(())
        brought: dict[str, tuple[_Trial, _Trial]] = {}
        while True:
            free = [one.term for one in self.tried if not one.doubt and one.term not in current.terms]
            trials = [self.trial((*current.terms, term)) for term in free]
            earning = [trial for trial in trials if self.refused(trial) == ""]
            if not earning:
                return current, brought
            best = min(earning, key=lambda trial: float(np.sum(trial.squares[0])))
            near = [trial for trial in earning if not _surely_better(best, trial)]
            rises = [self.beyond_chance(current, trial) for trial in near]
            step = near[int(np.argmax(rises))]
            brought[step.terms[-1]] = current, step
            current = step

    def beyond_chance(self, without: _Trial, trial: _Trial) -> float:
        """Return by how much more twice the log evidence rises than chance makes it rise."""
        share, n_sizes = CHANCE / len(self.tried), trial.n_sizes - without.n_sizes
        return float(2.0 * (trial.evidence - without.evidence) - scipy.special.chdtri(n_sizes, share))

    def failed(self, without: _Trial, trial: _Trial) -> str:
        """Return why a trial has not earned the term that it has more; empty if it has."""
        if self.beyond_chance(without, trial) <= 0.0:
            return "no more evidence than chance gives"
        if any(np.sum(after) >= np.sum(before) for before, after in zip(without.squares, trial.squares, strict=True)):
            return "poses of blocks left out are not predicted better"
        return ""

    def refused(self, trial: _Trial) -> str:
        """Return why not every term of a trial earns its place beside the others; empty if all do."""
        for term in trial.terms:
            why = self.failed(self.trial(tuple(other for other in trial.terms if other != term)), trial)
            if why:
                return f"beside it {term} would not earn its place: {why}"
        return ""

    def entries(self, one: Candidate, trial: _Trial) -> tuple[TermSection, ...]:
        """Return the entries of a candidate, with a larger sigma than is usual where the data ask for it."""
        if trial.sizes[one.term] <= 1.0 or one.term == "curve":  # the size of a curve is found again by the fit
            return one.sections
        return one.resized(self._robot, trial.sizes[one.term])

    def told(self, one: Candidate, chosen: _Trial, brought: dict[str, tuple[_Trial, _Trial]]) -> TriedTerm:
        """Return what a candidate brought, or why it was left out."""
        if one.refused:
            return TriedTerm(one.term, why=one.refused)
        added = one.term in brought
        without, with_it = brought[one.term] if added else (chosen, self.trial((*chosen.terms, one.term)))
        why = "" if added else self.failed(without, with_it) or one.doubt or self.refused(with_it)
        alike = self.alike(one.term, chosen) if added else ()
        gain = with_it.evidence - without.evidence
        return TriedTerm(one.term, added, gain, without.rms[0], with_it.rms[0], why, alike)

    def alike(self, term: str, chosen: _Trial) -> tuple[str, ...]:
        """Return the terms that would do as well in the place of one that was added."""
        others = tuple(other for other in chosen.terms if other != term)
        free = [one.term for one in self.tried if one.term not in chosen.terms]
        instead = {name: self.trial((*others, name)) for name in free}
        return tuple(
            name
            for name, trial in instead.items()
            if abs(chosen.evidence - trial.evidence) < TELLS
            and not self.refused(trial)
            and not _surely_better(chosen, trial)
        )

    def trial(self, terms: tuple[str, ...]) -> _Trial:
        """Return the linear model with some terms; each is computed once."""
        key = tuple(sorted(terms))
        if key not in self._known:
            self._known[key] = self._computed(key)
        return replace(self._known[key], terms=terms)

    def _computed(self, terms: tuple[str, ...]) -> _Trial:
        design, layout = self._design, self.fit.whitening.layout
        use = np.array([k for k, own in enumerate(design.owner) if own == "" or own in terms])
        names = list(dict.fromkeys(design.label[k] for k in use if design.label[k]))
        family = np.array([names.index(design.label[k]) if design.label[k] else -1 for k in use], dtype=np.intp)
        model = LinearModel(
            design.residuals,
            design.rows[:, use],
            design.has_prior[use],
            design.deviations[use],
            layout.group,
            np.ones(len(layout.groups), dtype=bool),  # stated noise knows nothing of what the robot itself does
            family,
            len(names),
        )
        scales, sizes = found_with_families(model, self.fit.scales.groups * self.fit.statistics.factors.found)
        left_out = [self._left_out(model, scales, sizes, use, blocks) for blocks in self._partitions]
        of_term = {
            term: max(float(sizes[number]) for k, number in zip(use, family, strict=True) if design.owner[k] == term)
            for term in terms
        }
        return _Trial(
            terms,
            log_evidence(model, scales, sizes),
            len(names),
            of_term,
            tuple(squares for squares, _ in left_out),
            tuple(rms for _, rms in left_out),
        )

    def _left_out(
        self, model: LinearModel, scales: FloatArray, sizes: FloatArray, use: IntArray, blocks: list[IntArray]
    ) -> tuple[FloatArray, float]:
        """Whitened squares of each block when it is left out, and the root mean square of the main part [SI]."""
        layout, data = self.fit.whitening.layout, self.fit.identification.data
        divisor, factor = self.fit.whitening.row_scale(scales), np.append(sizes, 1.0)[model.family]
        rows, right = model.jacobian * factor / divisor[:, None], model.residuals / divisor
        matrix, pull = rows.T @ rows, rows.T @ right + np.where(model.has_prior, model.deviations / factor, 0.0)
        matrix[np.diag_indices(len(matrix))] += model.has_prior
        visit = layout.visit[layout.reading]
        after = {name: residuals.copy() for name, residuals in self._residuals.items()}
        for held in blocks:
            own = np.isin(visit, held)
            kept, known = matrix - rows[own].T @ rows[own], pull - rows[own].T @ right[own]
            lost = ~model.has_prior & (np.diag(kept) <= _LOST * np.diag(matrix))
            step = np.zeros(len(known))
            ridge = np.diag(_RIDGE * np.diag(matrix)[~lost])
            step[~lost] = -np.linalg.solve(kept[np.ix_(~lost, ~lost)] + ridge, known[~lost])
            if np.any(lost):  # places that only this block sees are placed by it
                step[lost] = -np.linalg.lstsq(rows[own][:, lost], right[own] + rows[own] @ step, rcond=None)[0]
            for name, columns in self._by_column.items():
                read = np.isin(data.readings[name].visits, held)
                after[name][read] += columns[read][:, :, use] @ (factor * step)
        flat = self.fit.whitening.flatten(after) / self._divisor
        flat *= np.sqrt(self.fit.weights)[layout.reading]
        squares = np.array([float(np.sum(flat[np.isin(visit, held)] ** 2)) for held in blocks])
        errors = replace(self.fit.identification, after=after)
        lengths = np.nansum(errors.errors("after", errors.main_part.name) ** 2, axis=1)
        return squares, float(np.sqrt(np.mean(lengths)))


def _surely_better(best: _Trial, trial: _Trial) -> bool:
    """Whether one predicts blocks left out better than another in every partition, by two standard errors."""
    for less, more in zip(best.squares, trial.squares, strict=True):
        gain = more - less
        if np.sum(gain) <= SURE * np.std(gain, ddof=1) * np.sqrt(len(gain)):
            return False
    return True
