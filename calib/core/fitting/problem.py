"""The least-squares problem of a fit: whitened rows as functions of the scaled parameters.

The unknowns are u = (p - p_expected) / s. The scale s of a parameter is its sigma; p_expected is the mean of its prior,
which is nominal unless a fleet of robots gives another. The rows are those of `calib.core.rows.rows`, times the root of
the weight of their reading by a robust loss (`calib.core.fitting.robust`), and the priors' rows:

    u       for a parameter with a prior of its own
    P u     for parameters with correlated priors (`calib.core.numerics.prior`)

Residuals are signed components, never distances: a distance loses its sign, and has no derivative at zero. Where a
trial step opens a loop, its residuals are NaN, and the solver (`calib.core.numerics.least_squares`) shortens the step.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy

from calib.core.base.arrays import BoolArray, FloatArray, IntArray, ReadOnlyArrays, hold
from calib.core.base.errors import ComputationError
from calib.core.data.measurements import Measurements
from calib.core.instruments.kind import Readings
from calib.core.numerics.chances import UNLIKELY
from calib.core.numerics.identifiability import MANY_COLUMNS, reduce_rows
from calib.core.numerics.least_squares import TOLERANCE, LeastSquaresSolution, minimise
from calib.core.numerics.linear_model import LinearModel, RowGroups
from calib.core.numerics.mixed_rows import UNSEEN, SeenColumns
from calib.core.robots.configurations import Configurations, close, configurations_if_closed, describe_open
from calib.core.robots.joint_errors import term_columns
from calib.core.robots.robot import Robot
from calib.core.rows.observed import Observed, observe
from calib.core.rows.rows import Rows
from calib.core.rows.unknowns import Unknowns
from calib.core.rows.whitening import Whitening

_LEAST_FREEDOM = 0.1  # least degrees of freedom per row, where priors hold more parameters than there are rows
_TRIALS = 2  # points that the solver compares before it moves


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Readings compared with a robot at one set of parameter values.

    Attributes:
        readings: Readings of each instrument, by name.
        by: Numbers of the parameters that the readings are differentiated by, (k,); all if not given.
        factors: Cache of `Problem.compressed`: unknowns, and the triangular factor of each group's rows for them.
        whitened: Cache of `Problem.rows`: scales of the groups, unknowns, and the derivative of the rows by these.
    """

    robot: Robot
    configurations: Configurations
    readings: Mapping[str, Readings]
    by: IntArray | None = None
    factors: list[tuple[Unknowns, list[FloatArray]]] = field(default_factory=list)
    whitened: list[tuple[FloatArray, Unknowns, FloatArray]] = field(default_factory=list)

    @cached_property
    def observed(self) -> dict[str, Observed]:
        """Residuals and derivatives of each instrument, by name; those by joints take little more work."""
        return observe(self.robot, self.configurations, self.readings, joints=True, by=self.by)

    @cached_property
    def residuals(self) -> dict[str, FloatArray]:
        """Predicted minus read, of each instrument, (n, n_rows) [SI]; NaN where a component was not read."""
        return {name: observed.residuals for name, observed in self.observed.items()}

    @cached_property
    def joint_derivative(self) -> dict[str, FloatArray]:
        """Derivative of the readings by the actuated joints, of each instrument, (n, n_rows, n_actuated) [SI]."""
        result = {name: observed.joint_derivative.copy() for name, observed in self.observed.items()}
        hold(*result.values())
        return result

    def keep_whitened(self, groups: FloatArray, unknowns: Unknowns, columns: FloatArray) -> None:
        """Keep the derivative of the rows (n_rows, n_unknowns) in place of that of the readings, computed when used.

        Args:
            groups: Scales of the groups that whiten it, (n_groups,).
        """
        hold(columns)
        _ = self.residuals, self.joint_derivative
        self.whitened[:] = [(groups, unknowns, columns)]
        vars(self).pop("observed", None)


@dataclass(frozen=True, eq=False)
class Problem(ReadOnlyArrays):
    """Rows of a fit as functions of the parameters, from `from_data`.

    Attributes:
        sigma: Noise of positions per axis, if it replaces the stated one [m].
        columns: Columns Phi of the joint terms, at the nominal parameters.
        passive: Passive joints at similar parameters, from which loops are closed, (n, n_passive) [m or rad].
        unknowns: The free parameters, with the sizes of families found so far.
        noise_found: Mask of the groups whose noise is found from the residuals, (n_groups,); at first those without
            stated noise.
        free_alone: Whether readings are differentiated by the free parameters alone, not by held ones.
        limits: Whether a pose beyond the limits of a passive joint counts as open, also at trial steps.
    """

    robot: Robot
    data: Measurements
    sigma: float | None
    columns: tuple[FloatArray, ...]
    passive: FloatArray
    whitening: Whitening
    unknowns: Unknowns
    noise_found: BoolArray
    free_alone: bool = False
    limits: bool = False

    @staticmethod
    def from_data(
        robot: Robot,
        data: Measurements,
        sigma: float | None = None,
        near: FloatArray | None = None,
    ) -> Problem:
        """Close every visit and whiten its readings.

        Args:
            sigma: Noise of positions per axis, if it replaces the stated one [m].
            near: Passive joints of the visits under similar parameters, if they are known, (n, n_passive) [m or rad].

        Raises:
            UnreachablePoseError: A pose cannot be closed.
        """
        columns = term_columns(robot, data.joints, data.conditions)
        passive = robot.assemble(data.joints, near, data.labels, data.conditions).passive
        whitening = Whitening(robot, data, sigma)
        unknowns = Unknowns.from_robot(robot)
        return Problem(robot, data, sigma, columns, passive, whitening, unknowns, whitening.is_unstated)

    def with_readings(self, data: Measurements, passive: FloatArray) -> Problem:
        """Return the problem of other readings at the same visits, joint values and conditions.

        `passive` are passive joints near the solution of that problem, (n, n_passive) [m or rad].
        """
        whitening = Whitening(self.robot, data, self.sigma)
        return replace(self, data=data, passive=passive, whitening=whitening, noise_found=whitening.is_unstated)

    def largest_scales(self, efficiency: float = 1.0) -> FloatArray:
        """Return the largest scale that chance explains of each group, (n_groups,); infinite without stated noise.

        A larger scale, found with this efficiency relative to least squares, contradicts the stated noise (scale 1).
        """
        counts = self.whitening.layout.counts
        left = max(1.0 - len(self.unknowns) / max(int(np.sum(counts)), 1), _LEAST_FREEDOM)
        freedom = np.maximum(efficiency * left * counts, 1e-3)
        largest = np.sqrt(scipy.special.chdtri(freedom, UNLIKELY) / freedom)
        return np.where(self.whitening.is_unstated, np.inf, np.maximum(largest, 1.0))

    @property
    def confirmed_freedom(self) -> FloatArray:
        """Degrees of freedom with which a fleet confirmed the stated noise, (n_groups,); 0 where noise is found."""
        fleet = self.robot.description.fleet
        return np.where(
            self.noise_found | self.whitening.is_unstated, 0.0, 0.0 if fleet is None else fleet.noise_freedom
        )

    @property
    def noise_weighs(self) -> bool:
        """Whether the scales of the groups change the solution: against priors, or against each other."""
        return bool(np.any(self.unknowns.prior.has)) or len(self.whitening.groups) > 1

    def evaluate(self, robot: Robot, near: Evaluation | None = None) -> Evaluation:
        """Evaluate a robot on the data, near an evaluation at similar values; a loop that opens: `ComputationError`."""
        evaluation = self.evaluate_if_closed(robot, near) or self._try_evaluate(robot, None)
        if evaluation is None:
            closed = close(robot, self.data.joints, columns=self._columns_of(robot), limits=self.limits)
            raise ComputationError(describe_open(robot, self.data.joints, closed, self.data.labels))
        return evaluation

    def evaluate_if_closed(self, robot: Robot, near: Evaluation | None = None) -> Evaluation | None:
        """Evaluate a robot on the data; None where a loop opens."""
        return self._try_evaluate(robot, self.passive if near is None else near.configurations.passive)

    def _try_evaluate(self, robot: Robot, seed: FloatArray | None) -> Evaluation | None:
        columns = self._columns_of(robot)
        configurations = configurations_if_closed(robot, self.data.joints, seed, columns, limits=self.limits)
        by = self.unknowns.index if self.free_alone else None
        return None if configurations is None else Evaluation(robot, configurations, self.data.readings, by)

    def _columns_of(self, robot: Robot) -> tuple[FloatArray, ...]:
        """Phi of the joint terms, which changes with the parameters only where gravity's direction is fitted."""
        return term_columns(robot, self.data.joints, self.data.conditions) if robot.turns_gravity else self.columns

    def rows(self, evaluation: Evaluation, groups: FloatArray, unknowns: Unknowns | None = None) -> Rows:
        """Return the whitened rows.

        Args:
            groups: Scale of the noise of each group, (n_groups,).
            unknowns: Parameters of the columns; the free ones if not given.
        """
        chosen = self.unknowns if unknowns is None else unknowns
        deviations = chosen.deviations(evaluation.robot.values)
        columns, layout = self.derivative(evaluation, groups, chosen), self.whitening.layout
        rows = Rows(self.residuals(evaluation, groups), columns, chosen.prior, deviations, layout)
        if any(known.has(chosen) for known, _ in evaluation.factors):
            rows.remember(self.compressed(evaluation, groups, chosen).factor)
        return rows

    def residuals(self, evaluation: Evaluation, groups: FloatArray) -> FloatArray:
        """Return the residuals of all rows, (n_rows,); arguments as in `rows`."""
        return self.whitening.whiten(evaluation.residuals, groups)

    def derivative(
        self, evaluation: Evaluation, groups: FloatArray, unknowns: Unknowns, weights: FloatArray | None = None
    ) -> FloatArray:
        """Return the derivative of the rows by some scaled parameters, (n_rows, n_unknowns).

        Args:
            evaluation, groups, unknowns: Arguments of `rows`.
            weights: Weight of each reading, (n_readings,).
        """
        columns = next((kept for known, own, kept in evaluation.whitened if own is unknowns), None)
        if columns is None:
            columns = self.whitening.columns(evaluation.observed, groups, unknowns)
        elif np.any(evaluation.whitened[0][0] != groups):
            known = self.whitening.row_scale(evaluation.whitened[0][0])
            columns = columns * (known / self.whitening.row_scale(groups))[:, None]
        return columns if weights is None else columns * np.sqrt(weights)[self.whitening.layout.reading][:, None]

    def compressed(
        self, evaluation: Evaluation, groups: FloatArray, unknowns: Unknowns, rows: FloatArray | None = None
    ) -> LinearModel:
        """Return a linear model of few rows, (n_few, n_unknowns), with the same J^T J and J^T r as all rows.

        The few rows are the triangular factors of the rows of each group, computed once for an evaluation.

        Args:
            evaluation, groups, unknowns: Arguments of `rows`.
            rows: The derivative of the rows by these, (n_rows, n_unknowns), if it is known.
        """
        if not any(known.has(unknowns) for known, _ in evaluation.factors):
            evaluation.factors[:] = [(unknowns, self._factors(evaluation, groups, unknowns, rows))]
        known, factors = evaluation.factors[0]
        chosen = np.append(np.searchsorted(known.index, unknowns.index), -1)  # residuals are the last column
        sizes = np.append(unknowns.scales / known.scales[chosen[:-1]], 1.0)
        rows = np.vstack([factor[:, chosen] * (sizes / scale) for factor, scale in zip(factors, groups, strict=True)])
        few = RowGroups(
            np.repeat(np.arange(len(groups)), [len(factor) for factor in factors]), self.whitening.layout.counts
        )
        deviations = unknowns.deviations(evaluation.robot.values)
        model = LinearModel(rows[:, -1], rows[:, :-1], unknowns.prior, deviations, few)
        if len(groups) == 1 and rows.shape == factors[0].shape:  # the rows are that factor already
            model.remember(rows)
        return model

    def _factors(
        self, evaluation: Evaluation, groups: FloatArray, unknowns: Unknowns, rows: FloatArray | None
    ) -> list[FloatArray]:
        """Triangular factor of [J r] of each group, whitened by the stated noise, (at most n + 1, n + 1)."""
        rows = self.derivative(evaluation, groups, unknowns) if rows is None else rows
        residuals, group = self.residuals(evaluation, groups), self.whitening.layout.group
        members = [group == g for g in range(len(groups))]
        parts = [slice(None) if np.all(mine) else mine for mine in members]  # a slice copies nothing
        return [scale * reduce_rows(rows[part], residuals[part]) for part, scale in zip(parts, groups, strict=True)]

    def solve(
        self,
        start: Evaluation,
        groups: FloatArray,
        unknowns: Unknowns | None = None,
        *,
        tolerance: float = TOLERANCE,
        weights: FloatArray | None = None,
    ) -> tuple[Evaluation, LeastSquaresSolution]:
        """Minimise over some parameters; return the evaluation at the end, and the solver's result.

        Args:
            groups: Scale of the noise of each group, (n_groups,).
            unknowns: The parameters that may move; the free ones if not given. The others stay as in `start`.
            tolerance: See `calib.core.numerics.least_squares`.
            weights: Weight of each reading, (n_readings,).
        """
        way = _SolverRows(self, start, groups, self.unknowns if unknowns is None else unknowns, weights)
        solution = minimise(way.residuals, way.jacobian, way.begin, tolerance=tolerance)
        return way.current, solution


class _SolverRows:
    """Residuals and Jacobian at the points that the solver tries; each point is evaluated once.

    The solver's variables w are u; of families, they are the components that rows see at the start. The other
    components stay.

    Attributes:
        begin: w at the start, (n_variables,).
        current: Evaluation at the point of the last Jacobian.
    """

    def __init__(
        self, problem: Problem, start: Evaluation, groups: FloatArray, unknowns: Unknowns, weights: FloatArray | None
    ) -> None:
        self._problem, self._groups, self._unknowns, self._weights = problem, groups, unknowns, weights
        self.current, self._prior, self._seen = start, unknowns.prior, None
        self.begin = first = unknowns.deviations(start.robot.values)
        if unknowns.families:
            rows = problem.derivative(start, groups, unknowns, weights)
            self._seen = SeenColumns.from_rows(rows, unknowns.prior, unknowns.family, UNSEEN)
            self.begin, self._prior = self._seen.combine(first), self._seen.prior
            self._others = first - self._seen.coefficients(self.begin)
        self._looked_at: list[tuple[FloatArray, Evaluation | None, FloatArray]] = [
            (self.begin, start, self._values(self.begin, start))
        ]

    def _look_at(self, w: FloatArray) -> tuple[Evaluation | None, FloatArray]:
        """Evaluation at w (n_variables,), None where a loop opens, and all residuals, (n_rows,)."""
        for known, evaluation, values in self._looked_at:
            if np.array_equal(known, w):
                return evaluation, values
        u = w if self._seen is None else self._others + self._seen.coefficients(w)
        evaluation = self._problem.evaluate_if_closed(self._unknowns.robot_at(self.current.robot, u), self.current)
        values = self._values(w, evaluation)
        self._looked_at = [*self._looked_at, (w, evaluation, values)][-_TRIALS:]
        return evaluation, values

    def _values(self, w: FloatArray, evaluation: Evaluation | None) -> FloatArray:
        layout = self._problem.whitening.layout
        if evaluation is None:
            return np.full(layout.n_rows + np.count_nonzero(self._prior.has), np.nan)
        residuals = self._problem.residuals(evaluation, self._groups)
        if self._weights is not None:
            residuals *= np.sqrt(self._weights)[layout.reading]
        return np.concatenate([residuals, self._prior.times(w)])

    def residuals(self, w: FloatArray) -> FloatArray:
        """Return all residuals at w (n_variables,), ending with the priors' rows, (n_rows,); NaN where a loop opens."""
        return self._look_at(w)[1]

    def jacobian(self, w: FloatArray) -> LinearModel:
        """Return the linear model at w (n_variables,), and make w the current point."""
        evaluation, values = self._look_at(w)
        if evaluation is None:  # derivatives are requested only where the residuals were finite
            raise ComputationError("the solver left the region where the loops close")
        if evaluation is not self.current:
            self.current.whitened.clear()  # it takes memory, as the other points do
        self.current, self._looked_at = evaluation, [(w, evaluation, values)]
        problem, groups, unknowns = self._problem, self._groups, self._unknowns
        rows = problem.derivative(evaluation, groups, unknowns, self._weights)
        rows = rows if self._seen is None else self._seen.combine(rows)
        model = LinearModel(values[: len(rows)], rows, self._prior, w)
        if self._weights is None and self._seen is None:
            if unknowns is problem.unknowns:
                evaluation.keep_whitened(groups, unknowns, rows)
            if len(w) < MANY_COLUMNS:
                model.remember(problem.compressed(evaluation, groups, unknowns, rows).factor)
        return model
