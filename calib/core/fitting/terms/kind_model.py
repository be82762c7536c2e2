"""The mixed model of kinds of joint errors around a fit (`calib.core.numerics.mixed_model`).

Near a fit, the rows are linear in its free parameters, and in the coefficients of joint terms that the fit lacks. The
coefficients of one kind of term are a family; where joints differ (`JointTerm.differs`), each joint has its own family.
Each joint also has an independent error at each pose, which stands for errors of no kind.

Uncertainty of the sizes. Each possible set of sizes gives coefficients u with a covariance C. Their total covariance,
mean of C + mean of (u - u_fit)(u - u_fit)^T, less the C of the fit, is added to the covariance of the fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray, IntArray
from calib.core.fitting.solved_fit import SolvedFit
from calib.core.fitting.terms.candidate_terms import CandidateTerm, missing_terms
from calib.core.numerics import linalg
from calib.core.numerics.mixed_model import MixedModel
from calib.core.numerics.mixed_rows import MixedRows
from calib.core.robots.robot import Robot
from calib.core.robots.terms.term import TermSection
from calib.core.rows.observed import observe
from calib.core.rows.prediction import UndecidedTerms
from calib.core.rows.unknowns import Unknowns
from calib.core.rows.whitening import Whitening

_POSES = 500  # number of poses from which sizes are found
_LITTLE = 0.01  # directions of undecided terms that add less than this part of the largest variance are left out


@dataclass(frozen=True)
class TermFamily:
    """Coefficients with a common size: their kind of term and their joint, empty for those of all joints."""

    term: str
    joint: str = ""


def with_kinds(robot: Robot, kinds: Sequence[CandidateTerm]) -> Robot:
    """Return a robot with terms of some kinds added to its own, their coefficients zero."""
    sections = [section for kind in kinds for section in kind.sections]
    return robot.with_terms((*robot.description.terms, *sections)) if sections else robot


class KindModel:
    """Rows of kinds of joint errors around a fit, whose own families keep their sizes.

    Attributes:
        robot: The robot with terms of all kinds.
        families: The families of these kinds.
    """

    def __init__(self, fit: SolvedFit, kinds: Sequence[CandidateTerm]) -> None:
        self._fit, self._kinds = fit, kinds
        self.robot = with_kinds(fit.robot, kinds)
        unknowns, known = (
            Unknowns.from_robot(self.robot),
            dict(zip(fit.unknowns.names, fit.unknowns.scales, strict=True)),
        )
        scales = [known.get(name, scale) for name, scale in zip(unknowns.names, unknowns.scales, strict=True)]
        self._unknowns = replace(unknowns, scales=np.array(scales))
        owner = {
            p.name: TermFamily(kind.term, term.joint if term.differs else "")
            for kind in kinds
            for term in kind.terms_in(self.robot)
            for p in term.parameters
        }
        self.families = list(dict.fromkeys(owner[name] for name in unknowns.names if name in owner))
        numbers = {name: self.families.index(family) for name, family in owner.items()}
        self._family = np.array([numbers.get(name, -1) for name in unknowns.names], dtype=np.intp)

    @cached_property
    def informative_rows(self) -> IntArray:
        """Rows from which sizes are found, (n_read,)."""
        layout = self._fit.whitening.layout
        poses = np.unique(layout.pose_of_row)
        some = poses[:: -(-len(poses) // _POSES)]
        return np.flatnonzero((layout.group >= 0) & np.isin(layout.pose_of_row, some))

    def rows(
        self, read: IntArray, groups: FloatArray, stated: BoolArray, weights: FloatArray | None = None
    ) -> MixedRows:
        """Return rows of the model.

        Args:
            read: Numbers of the rows, (n_read,).
            groups: Scales of the noise that whitens them, (n_groups,).
            stated: Mask of the groups whose noise is stated, (n_groups,).
            weights: Weight of each reading, (n_readings,); that of the fit if not given.
        """
        fit, layout = self._fit, self._fit.whitening.layout
        data, whitening, places = fit.identification.data, fit.whitening, read
        visits, used = np.arange(len(data)), np.ones(layout.n_readings, dtype=bool)
        weights = fit.weights if weights is None else weights
        some = np.unique(layout.visit[layout.reading[read]])
        looks = [readings.visits for readings in data.readings.values()]
        if len(some) < len(data) and all(np.all(np.diff(v) >= 0) and np.any(np.isin(v, some)) for v in looks):
            visits, used, data = some, np.isin(layout.visit, some), data.subset(some)  # others are not observed
            whitening = Whitening(fit.robot, data, fit.sigma_given)
            places = np.searchsorted(np.flatnonzero(used[layout.reading]), read)
        near = fit.configurations.passive[visits]
        poses = self.robot.assemble(data.joints, near, data.labels, data.conditions)
        observed = observe(self.robot, poses, data.readings, joints=True)
        rows = whitening.rows(observed, groups, self._unknowns, self.robot.values).with_weights(weights[used])
        levers: FloatArray = whitening.joint_columns(observed, groups) * fit.robot.mechanism.joint_scale
        levers *= np.sqrt(weights[used])[whitening.layout.reading, None]
        return MixedRows.from_linear_problem(
            rows.take_rows(places), self._family, stated, layout.pose_of_row[read], levers[places]
        )

    def undecided(
        self, model: MixedModel, fitted: FloatArray, others: FloatArray, robot: Robot
    ) -> UndecidedTerms | None:
        """Return the uncertainty that the sizes add to the covariance of the fit; None if they add none.

        Args:
            model: Model of `rows`.
            fitted: Logarithms of the sizes of the fit, (n_sizes,).
            others: Logarithms of each possible set of sizes, (n_sets, n_sizes).
            robot: The robot of the fit.
        """
        at = model.solve(fitted)
        covariance, steps, before = np.zeros((len(at.scale),) * 2), list[FloatArray](), at.condensed_coefficients
        for solved in map(model.solve, others):
            covariance += solved.covariance
            steps.append(solved.condensed_coefficients - before)
        moves = np.array(steps)
        added = (covariance + moves.T @ moves) / len(others) - at.covariance
        moved = np.flatnonzero(np.diag(added))  # the others are in no set of sizes
        sizes = np.linalg.norm(model.x[:, moved], axis=0) + 1e-30
        values, vectors = linalg.eigh(sizes[:, None] * added[np.ix_(moved, moved)] * sizes)
        kept = values > _LITTLE * float(np.max(values, initial=0.0))
        if not np.any(kept):
            return None
        condensed = np.zeros((len(added), int(np.sum(kept))))
        condensed[moved] = vectors[:, kept] * np.sqrt(values[kept]) / sizes[:, None]
        spread = self._unknowns.scales[:, None] * model.components.coefficients(condensed)
        rows = np.flatnonzero(np.any(spread, axis=1))
        names, sections = tuple(self._unknowns.names[k] for k in rows), list[TermSection]()
        for kind in self._kinds:
            uncertain = [t.joint for t in kind.terms_in(self.robot) if any(p.name in names for p in t.parameters)]
            sections += kind.scaled_sections(self.robot, dict.fromkeys(uncertain, 1.0))
        return UndecidedTerms(missing_terms(robot, tuple(sections)), names, spread[rows])
