"""The least-squares problem of a fit: whitened rows as functions of the scaled parameters.

Unknowns u = (p - p_expected) / s with scales s, the parameters' sigma, around where priors expect them (nominal, unless
a fleet of robots says otherwise). The rows are those of `calib.rows.rows`,
times the root of the weight that a robust loss gives their reading (`calib.fitting.robust`), and

    u       for every parameter that has a prior of its own, P u (`calib.numerics.prior`) for those known together

Signed components, never distances: a distance loses its sign, and has no derivative at zero. A trial step that opens a
loop is answered with NaN, on which the solver (`calib.numerics.least_squares`) shortens its step.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy

from calib.base.arrays import BoolArray, FloatArray
from calib.base.errors import ComputationError
from calib.data.measurements import Measurements
from calib.numerics.chances import UNLIKELY
from calib.numerics.clusters import foretold
from calib.numerics.least_squares import TOLERANCE, Solution, minimise
from calib.numerics.prior_sizes import FamilyModel, found_with_families
from calib.numerics.variance_components import LinearModel, found_components, found_scales
from calib.robots.robot import Configurations, Robot, describe_open
from calib.rows.observed import Observed, observe
from calib.rows.rows import Rows
from calib.rows.unknowns import Unknowns
from calib.rows.whitening import Whitening

_ROUNDING = 1e-14  # a parameter that moves by less stays nominal, to the last digit [m or rad]
_LEAST_FREEDOM = 0.1  # degrees of freedom of each row, where priors hold more parameters than there are rows
_REMEMBERED = 3  # evaluations: the start, where the solver is, and its trial step


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Readings compared with a robot at one set of parameter values.

    Attributes:
        robot: With these values.
        configurations: Its assembled visits.
        observed: Residuals and derivatives of each instrument, by name.
    """

    robot: Robot
    configurations: Configurations
    observed: Mapping[str, Observed]

    @property
    def residuals(self) -> dict[str, FloatArray]:
        """Predicted minus read, of each instrument, (n, n_rows) [SI]; NaN where a component was not read."""
        return {name: observed.residuals for name, observed in self.observed.items()}


class Problem:
    """Rows of a fit as functions of the parameters; remembers the last solution of the loops to start the next from.

    Attributes:
        found: Of which groups the noise is found from the residuals, (n_groups,): at first where it is not stated.

    Args:
        robot: Nominal robot.
        data: Measurements.
        sigma: Noise of positions per axis, if it replaces what the description states [m].
        near: Passive joints of the visits under similar parameters, if they are known, (n, n_passive) [m or rad].
    """

    def __init__(
        self, robot: Robot, data: Measurements, sigma: float | None = None, near: FloatArray | None = None
    ) -> None:
        self.robot, self.data = robot, data
        self.unknowns = Unknowns.of(robot)
        self.whitening = Whitening(robot, data, sigma)
        self._sigma = sigma
        self._columns = robot.term_columns(data.joints, data.conditions)
        self._seed = robot.assemble(data.joints, near, data.labels, data.conditions).passive
        self._recent: dict[bytes, Evaluation | None] = {}
        self.weigh(np.zeros(self.whitening.n_offsets))
        self.found = self.unstated

    @property
    def unstated(self) -> BoolArray:
        """Of which groups nobody states the noise, (n_groups,)."""
        return np.array([not group.stated for group in self.whitening.groups])

    def contradicted(self, scales: FloatArray, efficiency: float = 1.0) -> BoolArray:
        """Return of which groups noise is stated that scales as found contradict, (n_groups,).

        Args:
            scales: As found, where what is stated is 1, (n_groups,).
            efficiency: Of how they were found, over that of least squares.
        """
        group = self.whitening.layout.group
        counts = np.bincount(group[group >= 0], minlength=len(scales))
        left = max(1.0 - len(self.unknowns) / max(int(np.sum(counts)), 1), _LEAST_FREEDOM)
        freedom = np.maximum(efficiency * left * counts, 1e-3)
        chance = scipy.special.chdtrc(freedom, freedom * scales**2)
        return np.asarray(~self.unstated & (scales > 1.0) & (chance < UNLIKELY))

    @property
    def confirmed(self) -> FloatArray:
        """Degrees of freedom with which a fleet confirmed the stated noise of groups, (n_groups,); 0 if found."""
        fleet = self.robot.description.fleet
        return np.where(self.found | self.unstated, 0.0, 0.0 if fleet is None else fleet.noise_freedom)

    @property
    def noise_weighs(self) -> bool:
        """Whether the scales of the groups change the solution: against priors, or against each other."""
        return bool(np.any(self.unknowns.prior.has)) or len(self.whitening.groups) > 1

    def weigh(self, ratios: FloatArray) -> None:
        """Weigh all that comes by these ratios of offsets to the scales of their groups, (n_offsets,)."""
        self.ratios, self.weighing = ratios, self.whitening.weighing(ratios)

    def read_again(self, data: Measurements, near: Evaluation) -> Problem:
        """Return the same problem with other readings of the same visits; no pose is closed again from home.

        Args:
            data: The readings; joint values and conditions as before.
            near: Where its solution is expected.
        """
        again = self.apart()
        again.data = data
        again.unknowns = Unknowns.of(self.robot)
        again.whitening = Whitening(self.robot, data, self._sigma)
        again._seed = near.configurations.passive
        again.weigh(np.zeros(again.whitening.n_offsets))
        again.found = again.unstated
        return again

    def apart(self) -> Problem:
        """Return the same problem with a memory of its own: what is solved there leaves no trace here."""
        apart = copy.copy(self)
        apart._recent = {}
        return apart

    def evaluate(self, robot: Robot) -> Evaluation:
        """Evaluate a robot on the data.

        Raises:
            ComputationError: A loop opens.
        """
        evaluation = self.evaluate_if_closed(robot)
        if evaluation is None:
            closed = robot.close(self.data.joints, columns=self._columns_of(robot))
            raise ComputationError(describe_open(robot, self.data.joints, closed, self.data.labels))
        return evaluation

    def evaluate_if_closed(self, robot: Robot) -> Evaluation | None:
        """Evaluate a robot on the data; None where a loop opens. The last few answers are remembered."""
        key = robot.values.tobytes()
        if key not in self._recent:
            while len(self._recent) >= _REMEMBERED:
                del self._recent[next(iter(self._recent))]
            self._recent[key] = self._compute(robot)
        return self._recent[key]

    def _compute(self, robot: Robot) -> Evaluation | None:
        columns = self._columns_of(robot)
        closed = robot.close(self.data.joints, self._seed, columns)
        if not np.all(closed.ok):
            return None
        self._seed = closed.passive
        configurations = robot.configurations(self.data.joints, closed, columns)
        return Evaluation(robot, configurations, observe(robot, configurations, self.data.readings))

    def _columns_of(self, robot: Robot) -> tuple[FloatArray, ...]:
        """Phi of the joint terms, which changes with the parameters only where gravity's direction is found."""
        return robot.term_columns(self.data.joints, self.data.conditions) if robot.turns_gravity else self._columns

    def rows(self, evaluation: Evaluation, groups: FloatArray, unknowns: Unknowns | None = None) -> Rows:
        """Return the whitened rows.

        Args:
            evaluation: An evaluation.
            groups: Scale of the noise of each group, (n_groups,).
            unknowns: Parameters that count; the free ones if not given.
        """
        chosen = self.unknowns if unknowns is None else unknowns
        rows = self.whitening.rows(evaluation.observed, groups, chosen, chosen.deviations(evaluation.robot.values))
        return rows.whitened(self.weighing)

    def _model(self, rows: Rows) -> LinearModel:
        """What rows whitened by what is stated say of the noise."""
        layout = self.whitening.layout
        unknowns = self.unknowns
        return LinearModel(
            rows.residuals,
            rows.jacobian,
            rows.prior,
            rows.deviations,
            layout.group,
            self.found,
            unknowns.family,
            len(unknowns.families),
        )

    def found_scales(self, evaluation: Evaluation, groups: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Find the scales of the groups `found`, and factors on the sigmas of families, from the residuals.

        Args:
            evaluation: An evaluation near the minimum.
            groups: Scales to start from, (n_groups,).

        Returns:
            Scales of the groups (n_groups,), factors of the families (n_families,).
        """
        model = self._model(self.rows(evaluation, np.ones(len(groups))))
        if self.unknowns.families:
            return found_with_families(FamilyModel.of(model), groups)
        return found_scales(model, groups).scales, np.ones(0)

    def found_ratios(self, evaluation: Evaluation, groups: FloatArray) -> FloatArray:
        """Find offsets that the readings of an instrument at a pose share, over the scale of their group, (n_offsets,).

        Args:
            evaluation: An evaluation near the minimum.
            groups: Scales to start from, (n_groups,).
        """
        whitening, own = self.whitening, self.unknowns
        tried = self.ratios > 0 if np.any(self.ratios) else whitening.tells_offsets
        if not np.any(tried):
            return self.ratios
        known = self.ratios * whitening.offset_scale(groups)
        # whitened by what is stated alone
        rows = whitening.rows(evaluation.observed, np.ones(len(groups)), own, own.deviations(evaluation.robot.values))
        components = found_components(
            self._model(rows), groups, whitening.offset_columns * tried, whitening.layout.pose_of_row, known
        )
        ratios: FloatArray = components.shared / whitening.offset_scale(components.scales)
        return ratios

    def left_out(self, evaluation: Evaluation, groups: FloatArray) -> FloatArray:
        """Return how far off readings are of poses that are left out in turn: their root mean square, (n_groups,).

        By the linear model around the evaluation, in units of what is stated. Every pose counts the same, however many
        readings it has.

        Args:
            evaluation: An evaluation at the minimum.
            groups: Scale of the noise of each group, (n_groups,).
        """
        layout, rows = self.whitening.layout, self.rows(evaluation, groups)
        pose = layout.pose_of_row
        errors = foretold(rows.jacobian, rows.known.root, rows.residuals, pose)
        errors = errors if self.weighing is None else self.weighing.unwhiten(errors)
        squares = (errors * self.whitening.row_scale(groups)) ** 2
        means = []
        for g in range(len(groups)):
            of_group = layout.group == g
            count = np.bincount(pose[of_group])
            means.append(np.mean((np.bincount(pose[of_group], squares[of_group]) / np.maximum(count, 1))[count > 0]))
        return np.sqrt(means)

    def moved(self, start: Robot, unknowns: Unknowns, u: FloatArray) -> Robot:
        """Return `start` with these parameters at expected + scale u, u (n_unknowns,)."""
        return start.with_parameters(_values(start, unknowns, u))

    def solve(
        self,
        start: Robot,
        groups: FloatArray,
        unknowns: Unknowns | None = None,
        *,
        tolerance: float = TOLERANCE,
        weights: FloatArray | None = None,
    ) -> tuple[Robot, Solution]:
        """Minimise over some parameters, the others staying as in `start`.

        Args:
            start: Where to begin.
            groups: Scale of the noise of each group, (n_groups,).
            unknowns: The parameters that may move; the free ones if not given.
            tolerance: See `calib.numerics.least_squares`.
            weights: Of each reading, (n_readings,).

        Raises:
            ComputationError: A loop is open at the start.
        """
        chosen = self.unknowns if unknowns is None else unknowns
        self.evaluate(start)  # says which loop is open, if one is
        prior_rows = chosen.prior.rows
        n_rows = self.whitening.layout.n_rows + len(prior_rows)
        last: dict[bytes, Rows] = {}

        def rows(u: FloatArray) -> Rows | None:
            key = u.tobytes()
            if key not in last:
                values = _values(start, chosen, u)
                remembered = self._recent.get(values.tobytes())
                evaluation = remembered or self.evaluate_if_closed(start.with_parameters(values))
                if evaluation is None:
                    return None
                made = self.rows(evaluation, groups, chosen)
                last.clear()
                last[key] = made if weights is None else made.weighted(weights)
            return last[key]

        def residuals(u: FloatArray) -> FloatArray:
            whitened = rows(u)
            if whitened is None:
                return np.full(n_rows, np.nan)
            return np.concatenate([whitened.residuals, chosen.prior.times(u)])

        def jacobian(u: FloatArray) -> FloatArray:
            whitened = rows(u)
            if whitened is None:  # derivatives are asked for only where the residuals were finite
                raise ComputationError("the solver left the region where the loops close")
            return np.vstack([whitened.jacobian, prior_rows])

        outcome = minimise(residuals, jacobian, chosen.deviations(start.values), tolerance=tolerance)
        return self.moved(start, chosen, outcome.x), outcome


def _values(start: Robot, unknowns: Unknowns, u: FloatArray) -> FloatArray:
    values = start.values.copy()
    change = unknowns.scales * u
    values[unknowns.index] = unknowns.expected + np.where(np.abs(change) < _ROUNDING, 0.0, change)
    return values
