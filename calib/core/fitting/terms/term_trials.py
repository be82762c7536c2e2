"""Trials: what the linear model around a fit says of some terms of the joints' errors.

The columns of all candidates stand beside those that the fit has anyway; a trial uses those of some terms. How large
their coefficients are is one number for each kind (one for each joint, for a curve), found together with the noise by
marginal likelihood. Blocks of neighbouring poses are then left out in turn, with sizes and noise of all poses: a
handful of numbers, and they stay the same in all blocks.

When it fails. All of it is linear: joint errors of many milliradians look curved.

Products of the rows are made once for each block, and a trial takes those of its columns: its work grows with columns
alone, however many poses there are. Blocks are left out of a trial when that is first asked for: about half of all
trials are told by their evidence alone. Joint values are combined in other ways only for a guess.

Reference: mackay1992; roberts2017.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray, IntArray, ReadOnlyArrays
from calib.core.data.pose_groups import boxes
from calib.core.fitting.fitted import Fit
from calib.core.fitting.terms.candidate_terms import Candidate
from calib.core.fitting.validation import stretches
from calib.core.numerics import linalg
from calib.core.numerics.chances import EXACT
from calib.core.numerics.identifiability import reduced
from calib.core.numerics.mixed_model import MixedModel
from calib.core.numerics.mixed_rows import MixedRows, NoiseOfRows
from calib.core.numerics.prior import Prior
from calib.core.numerics.prior_sizes import FamilyModel, Products, SizedModel, found_with_families, log_evidence
from calib.core.numerics.size_search import likeliest_sizes
from calib.core.numerics.undecided import averaged
from calib.core.rows.jacobian import linearise
from calib.core.rows.observed import observe
from calib.core.rows.prediction import beside_common_motion, other_combinations
from calib.core.rows.rows import Rows, Scales
from calib.core.rows.unknowns import Unknowns

BLOCKS = 8
"""Number of blocks that are left out in turn."""
_COMBINATIONS = 200
_LARGER = 8  # how much larger than the rows their products may be: they save dozens of trials the work
_RIDGE = 1e-12  # of its diagonal, added to a matrix whose null space the blocks left may widen
_NOTHING = 1e-6  # singular value over the largest, below which a principal component says nothing
_TELLING = 1500  # poses from which errors that were seen say what is to be expected
_LITTLE = 0.01  # chance that a kind is there below which it is left out of what is uncertain
_LOST = 1e-9  # part of a place's information below which only the poses that are left out see it


@dataclass(frozen=True, eq=False)
class Trial:
    """The linear model with some terms.

    Attributes:
        terms: Their names.
        evidence: Log marginal likelihood; minus infinity where so many columns explain all rows, and no noise is left.
        n_sizes: How many sizes were found.
        sizes: Largest size found of each term, over what is expected.
        n_partitions: How many partitions into blocks there are.
        predict: Computes what `left_out` returns.
        combine: Computes `unsure`.
    """

    terms: tuple[str, ...]
    evidence: float
    n_sizes: int
    sizes: dict[str, float]
    n_partitions: int
    predict: Callable[[int], tuple[FloatArray, float]]
    combine: Callable[[], float]

    @cached_property
    def _told(self) -> dict[int, tuple[FloatArray, float]]:
        return {}

    def left_out(self, partition: int) -> tuple[FloatArray, float]:
        """Return what it says of the blocks of a partition, each left out in turn.

        Returns:
            Whitened squares of what each block is off, (n_blocks,), and the root mean square of the main part [SI].
        """
        if partition not in self._told:
            self._told[partition] = self.predict(partition)
        return self._told[partition]

    @property
    def rms(self) -> float:
        """Root mean square of the main part, blocks of the first partition left out in turn [SI]."""
        return self.left_out(0)[1]

    @cached_property
    def unsure(self) -> float:
        """Variance of positions at other combinations of joint values, mean over these [m^2].

        0 where the main part of the readings is no length, which nothing can be weighed against.
        """
        return self.combine()


@dataclass(frozen=True, eq=False)
class _Design(ReadOnlyArrays):
    """Columns of all candidates and of what the fit has anyway.

    The many columns of a curve span little more than the poses do: those of one family are replaced by their principal
    components, U S of U S V^T. A prior that is the same for all of them stays what it is, and nothing is lost.

    Attributes:
        rows: Whitened by what is stated, (n_rows, n_columns).
        residuals: (n_rows,).
        parts: Parameters that stand together (k,), and what columns are of them, (k, n_columns of theirs).
        prior, deviations: As of `calib.core.rows.rows.Rows`, of the columns.
        owner: The candidate of each column; empty for what the fit has anyway.
        label: The size of each column's coefficients: its name; empty where it is not to be found.
    """

    rows: FloatArray
    residuals: FloatArray
    parts: tuple[tuple[IntArray, FloatArray], ...]
    prior: Prior
    deviations: FloatArray
    owner: tuple[str, ...]
    label: tuple[str, ...]

    def columns(self, derivative: FloatArray) -> FloatArray:
        """Return the derivative by the columns, (..., n_columns), from that by scaled parameters, (..., n_free)."""
        return _columns(self.parts, derivative)


def _columns(parts: Iterable[tuple[IntArray, FloatArray]], derivative: FloatArray) -> FloatArray:
    return np.concatenate([derivative[..., members] @ part for members, part in parts], axis=-1)


def _design(rows: Rows, unknowns: Unknowns, owner: list[str]) -> _Design:
    families = [unknowns.families[number] if number >= 0 else "" for number in unknowns.family]
    labels = [family or term for family, term in zip(families, owner, strict=True)]
    parts: list[tuple[IntArray, FloatArray]] = []
    standing: list[IntArray] = []  # a parameter whose prior each column has
    for label in dict.fromkeys(labels):
        members = np.array([k for k, other in enumerate(labels) if other == label])
        part: FloatArray = np.eye(len(members))
        first = members
        if label and owner[members[0]] and len(members) > 1:
            _, values, directions = linalg.svd(reduced(rows.jacobian[:, members]), full_matrices=False)
            kept = max(int(np.sum(values > _NOTHING * values[0])), 1)
            part, first = directions[:kept].T, np.full(kept, members[0])
        parts.append((members, part))
        standing.append(first)
    first = np.concatenate(standing)
    return _Design(
        _columns(parts, rows.jacobian),
        rows.residuals,
        tuple(parts),
        rows.prior.only(first),
        _columns(parts, rows.deviations),
        tuple(owner[k] for k in first),
        tuple(labels[k] for k in first),
    )


class _Part:
    """Rows of a design that are left out together, or all of them.

    Their products are kept where they are not much larger than the rows; else each trial makes those of its columns.

    Args:
        design: The design.
        group: Group of each of its rows, (n_rows,).
        n_groups: Number of groups.
        which: Which rows, (n_part,).
    """

    def __init__(self, design: _Design, group: IntArray, n_groups: int, which: IntArray) -> None:
        self._design, self._group, self._n_groups, self.which = design, group[which], n_groups, which
        n_columns = design.rows.shape[1]
        self._kept = self._made(np.arange(n_columns)) if _LARGER * len(which) > n_groups * n_columns else None

    def _made(self, use: IntArray) -> Products:
        rows, right = self._design.rows[np.ix_(self.which, use)], self._design.residuals[self.which]
        return Products.of(rows, right, self._group, self._n_groups)

    def products(self, use: IntArray) -> Products:
        """Return the products of some columns, by group."""
        return self._made(use) if self._kept is None else self._kept.only(use)

    def weighed(self, use: IntArray, scales: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return J^T J and J^T y of some columns, rows over the scales of their groups (n_groups,)."""
        if self._kept is not None:
            return self._kept.only(use).weighed(scales)
        divisor = np.where(self._group >= 0, scales[self._group], 1.0)
        rows = self._design.rows[np.ix_(self.which, use)] / divisor[:, None]
        return rows.T @ rows, rows.T @ (self._design.residuals[self.which] / divisor)


class Trials:
    """The linear model of a fit, which has the columns of all candidates.

    Args:
        fit: The fit without them.
        tried: The candidates.
    """

    def __init__(self, fit: Fit, tried: tuple[Candidate, ...]) -> None:
        data, layout = fit.identification.data, fit.whitening.layout
        self.fit = fit
        added = (section for candidate in tried for section in candidate.sections)
        self.robot = fit.robot.with_terms((*fit.robot.description.terms, *added))
        near = fit.configurations.passive
        configurations = self.robot.assemble(data.joints, near, data.labels, data.conditions)
        observed = observe(self.robot, configurations, data.readings)
        unknowns = Unknowns.of(self.robot)
        owner = {
            p.name: candidate.term for candidate in tried for term in candidate.of(self.robot) for p in term.parameters
        }
        rows = fit.whitening.rows(
            observed, np.ones(len(layout.groups)), unknowns, unknowns.deviations(self.robot.values)
        ).weighted(fit.weights)
        rows = rows.whitened(fit.whitening.weighing(fit.scales.ratios))
        self._design = _design(rows, unknowns, [owner.get(name, "") for name in unknowns.names])
        self._unknowns = unknowns
        self._residuals = {name: block.residuals for name, block in observed.items()}
        self._by_column = {
            name: self._design.columns(block.by(unknowns.index) * unknowns.scales) for name, block in observed.items()
        }
        partitions = [boxes(data.joints, data.pose_numbers, BLOCKS, self.robot.mechanism.depths)]
        if np.ptp(data.conditions.time) > 0:
            partitions.append(stretches(data, BLOCKS))
        if data.setups is not None and np.ptp(data.setups) > 0:
            partitions.append([np.flatnonzero(data.setups == setup) for setup in np.unique(data.setups)])
        visit = layout.visit[layout.reading]
        self._all = self._part(np.arange(layout.n_rows))
        self._partitions = [
            [self._part(np.flatnonzero(np.isin(visit, held))) for held in blocks] for blocks in partitions
        ]
        self._known: dict[tuple[str, ...], Trial] = {}
        self._sizes: dict[tuple[str, ...], tuple[FloatArray, FloatArray]] = {}
        self._divisor = fit.whitening.row_scale(fit.scales.groups * fit.statistics.factors.values)

    def _part(self, which: IntArray) -> _Part:
        layout = self.fit.whitening.layout
        return _Part(self._design, layout.group, len(layout.groups), which)

    @cached_property
    def _elsewhere(self) -> FloatArray:
        """Derivatives of positions where joint values are combined in other ways, (n_coordinates, n_columns)."""
        data, robot = self.fit.identification.data, self.robot
        q = other_combinations(data.joints, _COMBINATIONS)
        closed = robot.close(q)
        closes = closed.ok
        if self.fit.identification.main_part.dimension != "length" or not np.any(closes):
            return np.zeros((0, len(self._design.owner)))
        places = np.linspace(0, len(data) - 1, len(q)).astype(np.intp)
        conditions = data.conditions.at(places[closes])
        linear = linearise(robot, robot.assemble(q[closes], closed.passive[closes], context=conditions))
        positions, rows = linear.positions[:, robot.located], linear.jacobian[:, robot.located]
        by_parameters = beside_common_motion(positions, rows).reshape(-1, rows.shape[-1])
        return self._design.columns(by_parameters[:, self._unknowns.index] * self._unknowns.scales)

    def of(self, terms: tuple[str, ...]) -> Trial:
        """Return the linear model with some terms; each is computed once."""
        key = tuple(sorted(terms))
        if key not in self._known:
            self._known[key] = self._computed(key)
        return self._known[key]

    def undecided(self, terms: tuple[str, ...], others: Sequence[str]) -> dict[str, dict[str, FloatArray]]:
        """Return what other terms, each beside some, leave uncertain (`calib.core.numerics.undecided`).

        Terms of which each joint has a size of its own have too many coefficients, and are not among them.

        Args:
            terms: Those that were chosen.
            others: Those that were not.

        Returns:
            Of each of the others that may well be there, changes of parameters by name: one standard deviation in each
            of some independent directions, (n,) [SI]. Nothing where no noise is left.
        """
        design, (use, model) = self._design, self._model(terms)
        scales, sizes = self._found(terms, model)
        if np.any(scales <= EXACT):
            return {}
        solved, n = model.solved(scales, sizes), len(use)
        known = {}
        for term in others:
            own = np.array([k for k, owner in enumerate(design.owner) if owner == term], dtype=np.intp)
            if design.label[own[0]] != term:
                continue
            columns = np.concatenate([use, own])
            gram, pull = self._all.products(columns).weighed(scales)
            shared = gram[:n, n:]
            follows = -solved.root @ (solved.root.T @ shared)
            kind = averaged(gram[n:, n:] + shared.T @ follows, pull[n:] + shared.T @ solved.step)
            if kind.chance > _LITTLE:
                known[term] = self._parameters(columns, np.vstack([follows @ kind.spread, kind.spread]))
        return known

    def _parameters(self, use: IntArray, steps: FloatArray) -> dict[str, FloatArray]:
        """Return changes of parameters, (k,) each [SI], by name, from those of some columns, (n_used, k)."""
        of_columns = np.zeros((len(self._design.owner), steps.shape[1]))
        of_columns[use] = steps
        changes, start = np.zeros((len(self._unknowns), steps.shape[1])), 0
        for members, part in self._design.parts:
            changes[members] += part @ of_columns[start : start + part.shape[1]]
            start += part.shape[1]
        changes *= self._unknowns.scales[:, None]
        return {name: change for name, change in zip(self._unknowns.names, changes, strict=True) if np.any(change)}

    def expected_rms(self, terms: Sequence[str]) -> float:
        """Return how far off readings are expected to be at poses that are left out, if all of some terms may be there.

        Errors that were seen at such poses are few large ones and many small ones, by a model that was chosen for
        them. Those that are expected come from the mixed model of all terms, with the sizes that it finds, with what no
        column describes, and with what noise leaves uncertain of all of it (`calib.core.numerics.mixed_model`).

        Args:
            terms: Which may be there.

        Returns:
            Root mean square of the main part [SI]; NaN where each pose stands alone, and where poses are so
            many that errors seen hardly depend on which terms were chosen.
        """
        fit, layout, (use, family, _) = self.fit, self.fit.whitening.layout, self._families(terms)
        if np.sum(layout.poses_of_groups) > _TELLING:
            return float("nan")
        design, n_joints = self._design, len(fit.robot.joint_names)
        by_joint = fit.whitening.flatten(fit.by_joint)[:, :n_joints] * fit.robot.mechanism.joint_scale
        levers: FloatArray = np.sqrt(fit.weights)[layout.reading, None] * by_joint
        weighing = fit.whitening.weighing(fit.scales.ratios)
        levers = levers if weighing is None else weighing.whiten(levers)
        variances = 1.0 if weighing is None else weighing.variances()
        read = np.flatnonzero((layout.group >= 0) & np.any(design.rows != 0.0, axis=1))
        found = np.zeros(len(layout.groups), dtype=bool)  # stated noise knows nothing of what the robot does
        noise = NoiseOfRows(layout.group[read], found, layout.pose_of_row[read])
        columns = design.rows[np.ix_(read, use)]
        prior, deviations = design.prior.only(use), design.deviations[use]
        rows = MixedRows.of(columns, design.residuals[read], prior, deviations, family, noise, levers[read])
        std = np.full(layout.n_rows, np.nan)
        for places, _, covariance in likeliest_sizes(MixedModel.of(rows)).left_out():
            std[read[places]] = np.sqrt(np.diag(covariance))
        std *= np.sqrt(variances / fit.weights[layout.reading])
        by_reading = fit.whitening.read(std, Scales(np.ones(len(found)), np.zeros(len(fit.scales.ratios))))
        expected = replace(fit.identification, after=by_reading)
        lengths = np.nansum(expected.errors("after", expected.main_part.name) ** 2, axis=1)
        return float(np.sqrt(np.mean(lengths[lengths > 0.0]))) if np.any(lengths > 0.0) else float("nan")

    def _families(self, terms: Sequence[str]) -> tuple[IntArray, IntArray, int]:
        """The columns with some terms (n_used,), the family of each, -1 for none (n_used,), and how many there are."""
        design = self._design
        use = np.array([k for k, term in enumerate(design.owner) if term == "" or term in terms])
        names = list(dict.fromkeys(design.label[k] for k in use if design.label[k]))
        family = np.array([names.index(design.label[k]) if design.label[k] else -1 for k in use], dtype=np.intp)
        return use, family, len(names)

    def _model(self, terms: tuple[str, ...]) -> tuple[IntArray, FamilyModel]:
        """The columns with some terms, (n_used,), and their model."""
        design, (use, family, n_families) = self._design, self._families(terms)
        model = FamilyModel(
            self._all.products(use),
            design.prior.only(use),
            design.deviations[use],
            np.ones(len(self.fit.whitening.groups), dtype=bool),  # stated noise knows nothing of what the robot does
            family,
            n_families,
        )
        return use, model

    def _found(self, terms: tuple[str, ...], model: FamilyModel) -> tuple[FloatArray, FloatArray]:
        """Scales of groups and sizes of families with some terms, and their model; each is found once."""
        key = tuple(sorted(terms))
        if key not in self._sizes:
            self._sizes[key] = found_with_families(model, self.fit.scales.groups * self.fit.statistics.factors.values)
        return self._sizes[key]

    def _computed(self, terms: tuple[str, ...]) -> Trial:
        use, model = self._model(terms)
        scales, sizes = self._found(terms, model)
        solved = model.solved(scales, sizes)
        if np.any(scales <= EXACT) or model.freedom(solved) < 1.0:
            nothing = self._nothing_foretold, lambda: np.inf
            infinite = dict.fromkeys(terms, np.inf)
            return Trial(terms, -np.inf, model.n_families, infinite, len(self._partitions), *nothing)
        of_term = {
            term: max(float(solved.factor[k]) for k, column in enumerate(use) if self._design.owner[column] == term)
            for term in terms
        }
        evidence = log_evidence(model, solved, scales)
        predict, combine = partial(self._foretold, terms, scales, sizes), partial(self._unsure, terms, scales, sizes)
        return Trial(terms, evidence, model.n_families, of_term, len(self._partitions), predict, combine)

    def _nothing_foretold(self, partition: int) -> tuple[FloatArray, float]:
        """Of a trial that leaves no noise to any group that has some."""
        return np.full(len(self._partitions[partition]), np.inf), np.inf

    def _foretold(
        self, terms: tuple[str, ...], scales: FloatArray, sizes: FloatArray, partition: int
    ) -> tuple[FloatArray, float]:
        use, model = self._model(terms)
        solved = model.solved(scales, sizes)  # again: the matrices of all trials together would be too large to keep
        return self._left_out(solved, model.prior, scales, use, self._partitions[partition])

    def _unsure(self, terms: tuple[str, ...], scales: FloatArray, sizes: FloatArray) -> float:
        use, model = self._model(terms)
        solved = model.solved(scales, sizes)
        variances = np.sum((self._elsewhere[:, use] @ solved.root) ** 2, axis=1)
        return 3.0 * float(np.mean(variances)) if len(variances) else 0.0

    def _left_out(
        self, solved: SizedModel, prior: Prior, scales: FloatArray, use: IntArray, parts: list[_Part]
    ) -> tuple[FloatArray, float]:
        """Whitened squares of each block when it is left out, and the root mean square of the main part [SI]."""
        layout, data = self.fit.whitening.layout, self.fit.identification.data
        steps = np.zeros((len(self._design.owner), len(parts)))
        block = np.full(len(data), -1)
        for k, part in enumerate(parts):
            steps[use, k] = self._step_without(part, solved, prior, scales, use)
            block[layout.visit[layout.reading[part.which]]] = k
        after = {}
        for name, columns in self._by_column.items():
            moves = columns @ steps  # of all blocks: one product in place of many copies
            block_of_reading = block[data.readings[name].visits]
            moved = np.take_along_axis(moves, np.maximum(block_of_reading, 0)[:, None, None], axis=2)[:, :, 0]
            after[name] = self._residuals[name] + np.where(block_of_reading[:, None] >= 0, moved, 0.0)
        flat = self.fit.whitening.flatten(after) / self._divisor
        flat *= np.sqrt(self.fit.weights)[layout.reading]
        squares = np.array([float(np.sum(flat[part.which] ** 2)) for part in parts])
        errors = replace(self.fit.identification, after=after)
        lengths = np.nansum(errors.errors("after", errors.main_part.name) ** 2, axis=1)
        return squares, float(np.sqrt(np.mean(lengths)))

    def _step_without(
        self, part: _Part, solved: SizedModel, prior: Prior, scales: FloatArray, use: IntArray
    ) -> FloatArray:
        """Step to the minimum without some rows, (n_use,)."""
        kept, pull = part.weighed(use, scales)
        np.subtract(solved.matrix, kept, out=kept)  # in place: such matrices are large, and there are many
        known, size = solved.right - pull, np.diag(solved.matrix)
        lost = ~prior.has & (np.diag(kept) <= _LOST * size)
        kept[np.diag_indices_from(kept)] += _RIDGE * size
        step = np.zeros(len(use))
        step[~lost] = -_solution(kept[np.ix_(~lost, ~lost)] if np.any(lost) else kept, known[~lost])
        if np.any(lost):  # places that only these rows see are placed by them
            group = self.fit.whitening.layout.group[part.which]
            divisor = np.where(group >= 0, scales[group], 1.0)
            rows = self._design.rows[np.ix_(part.which, use)] / divisor[:, None]
            right = self._design.residuals[part.which] / divisor
            step[lost] = -linalg.lstsq(rows[:, lost], right + rows @ step, rcond=None)
        return step


def _solution(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solve a symmetric system, (n, n) and (n,), that rounding may have made indefinite."""
    upper, failed = scipy.linalg.lapack.dpotrf(matrix.T, clean=0)  # as LAPACK has it: not copied twice
    return np.linalg.solve(matrix, right) if failed else np.asarray(scipy.linalg.lapack.dpotrs(upper, right)[0])
