"""How large each kind of joint error is: all kinds at once in one model, in place of a choice of them.

Around the fit of the origins, the rows are linear in the coefficients of all kinds of terms that the measurements can
show (`calib.core.fitting.terms.candidate_terms`). Each kind is a family of the mixed model
(`calib.core.numerics.mixed_model`), or one for each joint where joints differ (`JointTerm.differs`): its coefficients
are normal with a size that is found by restricted likelihood, together with the noise and with an error of each joint
that is another one at each pose, which stands for what no kind describes.

What follows from it:

    terms        a family whose likeliest size is not next to zero is fitted, as any robot is, with this sigma
    undecided    sizes are uncertain, those of the other families too. With coefficients u and covariance C of sizes
                 that are drawn from what the rows leave open, cov u = mean of C + covariance of u: what that is more
                 than C of the likeliest sizes stands beside the covariance of the fit
    expected     how far off poses are that are left out, each predicted by all others: from the same model, with every
                 kind in it. Errors seen at these poses are few large ones and many small ones, by terms that were sized
                 by them

A kind is surely there if its log likelihood is higher by odds of 20 to 1 (kass1995), beside all others; all of them
together must be, for any to be fitted. A kind of little evidence is fitted, too: shrunk to its size it costs little,
and left out it would be missed where joints were not measured.

A guess. Few poses of a small part of joint space may say that something is there, and not what. Terms are left out
where they cost more than 3.5 times what they bring, both mean squares of positions, and the log likelihood of a pose is
not higher with them by 1. They bring what poses left out are nearer, and cost what positions become less sure where
the joint values measured are combined in other ways, base and tool placed anew.

What was measured on real robots (`docs/theory/joint_terms.md`). Weighing the fit itself by the error of joints was no
better on one tracked arm and much worse where a camera reads several points of a pose, whose noise has another shape.
Time and temperature are no kinds of this model unless they are named: an error that grows with them was worse on every
part of a file that lay outside their range.

When it fails. Joint errors of many milliradians look curved. Kinds that look alike share what is there.

Reference: kass1995; patterson1971.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray, IntArray
from calib.core.base.errors import DataError
from calib.core.base.threads import one_blas_thread
from calib.core.fitting.fitted import Fit
from calib.core.fitting.terms.candidate_terms import TELLS, Candidate, TermChoice, TriedTerm, candidates, missing_terms
from calib.core.fitting.validation import stretches
from calib.core.numerics import linalg
from calib.core.numerics.mixed_model import MixedModel, SolvedModel
from calib.core.numerics.mixed_rows import MixedRows, NoiseOfRows
from calib.core.numerics.size_search import drawn_sizes, least_sizes, likeliest_sizes
from calib.core.robots.terms.term import TermSection
from calib.core.rows.jacobian import linearise
from calib.core.rows.observed import observe
from calib.core.rows.prediction import UndecidedTerms, beside_common_motion, other_combinations
from calib.core.rows.rows import Scales
from calib.core.rows.unknowns import Unknowns

LEAST_POSES = 16
"""Different poses below which no sizes are found."""
_SMALL = 0.05  # of what is usual: a family so small is fitted only if the rows show it
_SHOWS = 1.0  # rise of the log likelihood by a family that they show
_COSTS = 3.5  # how many times as much as it brings a guess may cost
_COMBINATIONS = 200
_POSES = 500  # that tell the sizes
_DRAWS = 24
_LITTLE = 0.01  # of the largest variance that readings feel of undecided terms, below which directions are left out
_LIMITS = (0.025, 0.975)


@one_blas_thread
def size_terms(fit: Fit) -> TermChoice:
    """Return the terms of the joints' errors with the sizes that measurements show.

    Args:
        fit: The fit with the terms that its robot has anyway.

    Raises:
        DataError: Too few poses.
    """
    data, described = fit.identification.data, fit.robot.description.terms
    if len(stretches(data, LEAST_POSES)) < LEAST_POSES:
        raise DataError(
            f"{data.path}: finding which joint terms are there needs at least {LEAST_POSES} different poses; name the"
            " terms (--terms curve,gain), or measure more"
        )
    kinds = candidates(fit.robot, data)
    if fit.computed:
        why = "nothing is left to explain: these data were computed, not measured"
        return TermChoice("auto", described, tuple(TriedTerm(candidate.term, why=why) for candidate in kinds))
    asked = tuple(candidate for candidate in kinds if not (candidate.refused or candidate.doubt))
    model = _TermModel(fit, asked)
    tried = [model.outcome(c) if c in asked else TriedTerm(c.term, why=c.refused or c.doubt) for c in kinds]
    sections = (*described, *(section for candidate in asked for section in model.entries(candidate)))
    tried.sort(key=lambda term: not term.added)
    return TermChoice("auto", sections, tuple(tried), model.undecided(sections), model.expected_rms())


@dataclass(frozen=True)
class _Family:
    """Coefficients of one size.

    Attributes:
        term: Their kind.
        joint: Their joint; empty for those of all joints.
    """

    term: str
    joint: str = ""


class _TermModel:
    """The mixed model of all kinds around a fit.

    Args:
        fit: The fit.
        kinds: The kinds.
    """

    def __init__(self, fit: Fit, kinds: Sequence[Candidate]) -> None:
        self._fit = fit
        self._sections = tuple(section for candidate in kinds for section in candidate.sections)
        self.robot = fit.robot.with_terms((*fit.robot.description.terms, *self._sections))
        self._unknowns = Unknowns.of(self.robot)
        owner = {
            p.name: _Family(candidate.term, term.joint if term.differs else "")
            for candidate in kinds
            for term in candidate.of(self.robot)
            for p in term.parameters
        }
        own = [self._unknowns.families[k] if k >= 0 else "" for k in self._unknowns.family]
        labels = [owner.get(name, _Family(label)) for name, label in zip(self._unknowns.names, own, strict=True)]
        self._families = [family for family in dict.fromkeys(labels) if family.term]
        numbers = {family: k for k, family in enumerate(self._families)}
        self._family = np.array([numbers.get(label, -1) for label in labels], dtype=np.intp)

    @cached_property
    def _read(self) -> IntArray:
        """Rows that tell the sizes."""
        layout = self._fit.whitening.layout
        poses = np.unique(layout.pose_of_row)
        some = poses[:: -(-len(poses) // _POSES)]
        return np.flatnonzero((layout.group >= 0) & np.isin(layout.pose_of_row, some))

    @cached_property
    def _at(self) -> SolvedModel:
        """The model with its likeliest sizes."""
        fit, layout = self._fit, self._fit.whitening.layout
        data, near = fit.identification.data, fit.configurations.passive
        observed = observe(
            self.robot, self.robot.assemble(data.joints, near, data.labels, data.conditions), data.readings
        )
        ones, deviations = np.ones(len(layout.groups)), self._unknowns.deviations(self.robot.values)
        weighing = fit.whitening.weighing(fit.scales.ratios)
        rows = fit.whitening.rows(observed, ones, self._unknowns, deviations).weighted(fit.weights).whitened(weighing)
        by_joint = fit.whitening.joint_columns(observed)[:, : len(fit.robot.joint_names)]
        levers: FloatArray = np.sqrt(fit.weights)[layout.reading, None] * by_joint * fit.robot.mechanism.joint_scale
        levers = levers if weighing is None else weighing.whiten(levers)
        read = self._read
        found = np.zeros(len(layout.groups), dtype=bool)  # stated noise knows nothing of what the robot does
        noise = NoiseOfRows(layout.group[read], found, layout.pose_of_row[read])
        columns, residuals = rows.jacobian[read], rows.residuals[read]
        mixed = MixedRows.of(columns, residuals, rows.prior, rows.deviations, self._family, noise, levers[read])
        return likeliest_sizes(MixedModel.of(mixed))

    @cached_property
    def _least(self) -> FloatArray:
        """Logarithms of sizes that are as good as zero, (n_sizes,)."""
        return least_sizes(self._at.model)

    def _evidence(self, members: IntArray) -> float:
        """By how much the log likelihood is higher with some families (n,) than without."""
        without = np.isin(np.arange(len(self._at.logs)), members)
        if np.all(self._at.logs[without] <= self._least[without]):
            return 0.0
        return likeliest_sizes(self._at.model, self._at.logs, without).cost - self._at.cost

    @cached_property
    def _there(self) -> BoolArray:
        """Which families are fitted, (n_families,)."""
        none = np.zeros(len(self._families), dtype=bool)
        if self._without.cost - self._at.cost <= TELLS or self._is_guess:
            return none
        large = np.exp(self._at.logs[: len(none)]) > _SMALL
        return np.array([some or self._evidence(np.array([k])) > _SHOWS for k, some in enumerate(large)], dtype=bool)

    @cached_property
    def _without(self) -> SolvedModel:
        """The model without any of them."""
        without = np.arange(len(self._at.logs)) < len(self._families)
        return likeliest_sizes(self._at.model, self._at.logs, without)

    @property
    def _is_guess(self) -> bool:
        """Whether the terms are a guess by the module docstring."""
        elsewhere, poses = self._elsewhere, len(np.unique(self._at.model.rows.pose))
        if self._without.cost - self._at.cost > poses or not len(elsewhere):
            return False
        known, otherwise = (
            3.0 * float(np.mean(np.einsum("ij,jk,ik->i", elsewhere, at.covariance, elsewhere)))
            for at in (self._at, self._without)
        )
        brought = self._left_out_rms(self._without) ** 2 - self._left_out_rms(self._at) ** 2
        return known - otherwise > _COSTS * max(brought, 0.0)

    @cached_property
    def _elsewhere(self) -> FloatArray:
        """Derivatives of positions where joint values are combined in other ways, (n_coordinates, n_columns)."""
        data, robot = self._fit.identification.data, self.robot
        q = other_combinations(data.joints, _COMBINATIONS)
        closed = robot.close(q)
        if self._fit.identification.main_part.dimension != "length" or not np.any(closed.ok):
            return np.zeros((0, 0))
        places = np.linspace(0, len(data) - 1, len(q)).astype(np.intp)[closed.ok]
        at = robot.assemble(q[closed.ok], closed.passive[closed.ok], context=data.conditions.at(places))
        linear = linearise(robot, at)
        positions, rows = linear.positions[:, robot.located], linear.jacobian[:, robot.located]
        columns = beside_common_motion(positions, rows).reshape(-1, rows.shape[-1])[:, self._unknowns.index]
        return self._at.model.components(columns * self._unknowns.scales)

    def _members(self, term: str) -> IntArray:
        return np.array([k for k, family in enumerate(self._families) if family.term == term], dtype=np.intp)

    def entries(self, candidate: Candidate) -> tuple[TermSection, ...]:
        """Return the entries of a kind that are fitted, with the sigma that was found."""
        factors = dict[str, float]()
        terms = candidate.of(self.robot)
        for k in (k for k in self._members(candidate.term) if self._there[k]):
            joints = [term.joint for term in terms if self._families[k].joint in ("", term.joint)]
            factors |= dict.fromkeys(joints, float(np.exp(self._at.logs[k])))
        if any(p.family for term in terms for p in term.parameters):  # the fit finds its size again
            section = candidate.sections[0]
            return tuple(section.model_copy(update={"joint": joint}) for joint in factors)
        return candidate.resized(self.robot, factors)

    def outcome(self, candidate: Candidate) -> TriedTerm:
        """Return what was found about a kind."""
        members = self._members(candidate.term)
        there = [k for k in members if self._there[k]]
        most = max(members, key=lambda k: self._at.logs[k])
        low, high = np.quantile(np.exp(self._draws[:, most]), _LIMITS)
        return TriedTerm(
            candidate.term,
            bool(there),
            self._evidence(members),
            float(np.exp(self._at.logs[most])),
            (float(low), float(high)),
            tuple(self._families[k].joint for k in there if self._families[k].joint),
        )

    @cached_property
    def _draws(self) -> FloatArray:
        """Logarithms of sizes that the rows leave open, (n_draws, n_sizes)."""
        return drawn_sizes(self._at, _DRAWS, np.random.default_rng(self._fit.seed))

    def undecided(self, fitted_terms: tuple[TermSection, ...]) -> UndecidedTerms | None:
        """Return what the sizes leave uncertain of these terms and of the others; None if that is nothing."""
        at, model = self._at, self._at.model
        logs = at.logs.copy()
        logs[: len(self._families)][~self._there] = self._least[: len(self._families)][~self._there]
        fitted = model.solved(logs)
        more, steps = -fitted.covariance, []
        for draw in self._draws:
            solved = model.solved(draw)
            more += solved.covariance / _DRAWS
            steps.append(solved.scale * solved.v - fitted.scale * fitted.v)
        more += np.array(steps).T @ np.array(steps) / _DRAWS
        felt = np.linalg.norm(model.x, axis=0) + 1e-30
        values, vectors = linalg.eigh(felt[:, None] * more * felt)
        kept = values > _LITTLE * max(float(values[-1]), 0.0)
        if not np.any(kept):
            return None
        condensed = vectors[:, kept] * np.sqrt(values[kept]) / felt[:, None]
        spread = np.stack([model.coefficients(column) for column in condensed.T], axis=1)
        spread *= self._unknowns.scales[:, None]
        names = [k for k, row in enumerate(spread) if np.any(row)]
        others = missing_terms(self._fit.robot.with_terms(fitted_terms), self._sections)
        return UndecidedTerms(others, tuple(self._unknowns.names[k] for k in names), spread[names])

    def expected_rms(self) -> float:
        """Return how far off poses that are left out are expected to be: root mean square of the main part [SI].

        NaN where each pose stands alone, where no terms are fitted, and where poses have several readings: the shape of
        what these share is not known, and that of joints may be far from it.
        """
        layout = self._fit.whitening.layout
        alone = layout.n_readings == len(np.unique(layout.pose))
        return self._left_out_rms(self._at) if alone and np.any(self._there) else float("nan")

    def _left_out_rms(self, at: SolvedModel) -> float:
        """The same by the model with some sizes."""
        fit, layout = self._fit, self._fit.whitening.layout
        weighing = fit.whitening.weighing(fit.scales.ratios)
        std = np.full(layout.n_rows, np.nan)
        for places, _, covariance in at.left_out():
            std[self._read[places]] = np.sqrt(np.diag(covariance))
        std *= np.sqrt((1.0 if weighing is None else weighing.variances()) / fit.weights[layout.reading])
        scales = Scales(np.ones(len(layout.groups)), np.zeros(len(fit.scales.ratios)))
        expected = replace(fit.identification, after=fit.whitening.read(std, scales))
        lengths = np.nansum(expected.errors("after", expected.main_part.name) ** 2, axis=1)
        return float(np.sqrt(np.mean(lengths[lengths > 0.0]))) if np.any(lengths > 0.0) else float("nan")
