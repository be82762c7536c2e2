"""Many calibrations of one robot from the same visits: what they share is computed once.

Draws differ in what the instruments read. The poses of the nominal robot, closed from home, are the same in every draw,
and so, nearly, are the rows around the minimum. One draw is calibrated in full, from the nominal robot. With T of its
minimum u_0 (`calib.core.numerics.statistics`), the derivative of its rows by z, u = u_0 + T z, and the second
derivative, by differences of one tenth of a standard deviation along each column of T, where every other draw has its
minimum is known to second order, and one exact evaluation there, with its own closed loops and its own Jacobian, says
the rest: see
`calib.core.numerics.nearby`. The minimum is the one that `calib.fit` finds, to a small part of a standard deviation; a
fit by itself takes a dozen evaluations. Passive joints start where their derivative by z says.

All of that is done for many draws in one call, and so is what follows from their minima
(`calib.studies.draw_statistics`). Where more is to be found than a minimum (noise that is not stated or
contradicted, sizes of families, offsets that readings share, weights of a robust loss), or where the model does not
lead to it, the solver of every fit goes on from the start that the model gives; with a robust loss, from that of first
order.

When it fails. Where noise is not stated and priors hold something, both find the noise to one percent, along different
ways. Where visits differ (touches move the robot until it touches; poses are drawn again), or a loop opens at the
common start, a draw begins where the first one ended.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from calib.core.base.arrays import FloatArray, IntArray, ReadOnlyArrays
from calib.core.base.errors import CalibrationError, ComputationError
from calib.core.data.measurements import Measurements
from calib.core.fitting.fitted import Fit
from calib.core.fitting.outliers import blocks
from calib.core.fitting.problem import Evaluation, Problem
from calib.core.fitting.settings import Settings
from calib.core.fitting.solving import contradicted, convergence_at, solve_from, uncertainty_at
from calib.core.instruments.kind import View
from calib.core.numerics.losses import studentised
from calib.core.numerics.nearby import Nearby
from calib.core.robots.robot import Robot
from calib.core.rows.many_robots import ManyRobots
from calib.core.rows.observed import seen_by
from calib.core.rows.whitening import Whitening
from calib.studies.draw_statistics import Estimate, estimates_at
from calib.studies.study_data import Drawn

_STEP = 0.1  # of a difference of Jacobians, in standard deviations
_LARGEST = 4_000_000  # numbers in a second derivative that is computed, 32 MB
_TOGETHER = 100_000  # numbers in the Jacobians of draws that are computed together: more need new pages of memory


@dataclass(frozen=True, eq=False)
class Repeated(ReadOnlyArrays):
    """Calibrates again and again; `of` makes one.

    Attributes:
        first: A finished fit of one draw.
        settings: How to fit.
        problem: That of the first draw.
        seen: What each instrument saw then, at the minimum, by name.
        nearby: The rows around that minimum.
        passive: Passive joints there, (n, n_passive) [m or rad].
        by_z: Their derivative, (n * n_passive, rank).
        many: Evaluates many robots at once; None where each has to be evaluated by itself.
    """

    first: Fit
    settings: Settings
    problem: Problem
    seen: dict[str, View | FloatArray]
    nearby: Nearby
    passive: FloatArray
    by_z: FloatArray
    many: ManyRobots | None

    @staticmethod
    def of(first: Fit, settings: Settings, *, alike: bool = True) -> Repeated:
        """Prepare many calibrations like a first one.

        Args:
            first: That one.
            settings: How to fit.
            alike: Whether draws are of the same visits.
        """
        data, rows = first.identification.data, first.rows
        problem = Problem.of(first.nominal, data, settings.sigma, first.configurations.passive)
        at = problem.evaluate(first.robot)
        seen = seen_by(first.robot, at.configurations, data.readings)
        root = rows.known.root
        driven, index, whitening = at.configurations.actuated, first.unknowns.index, problem.whitening
        many = None if problem.noise_weighs else ManyRobots.of(first.robot, driven, data.readings, index, whitening)
        bend, by_z = _differences(problem, first, at, many) if alike and settings.loss == "none" else (None, None)
        nearby = Nearby(rows.jacobian @ root, bend, rows.prior.times(root), rows.prior.times(rows.deviations))
        passive = at.configurations.passive
        by_z = np.zeros((passive.size, root.shape[1])) if by_z is None else by_z
        return Repeated(first, settings, problem, seen, nearby, passive, by_z, many)

    def estimates(self, drawn: Sequence[Drawn]) -> list[Estimate | CalibrationError]:
        """Calibrate from other readings.

        Args:
            drawn: Readings of the same visits, or of others.

        Returns:
            What each gave, or why it gave no answer: a loop opens, the noise cannot be found, no degrees of freedom are
            left.
        """
        results = dict[int, Estimate | CalibrationError]()
        alike = [k for k, each in enumerate(drawn) if self._differs_in_noise(each.data)] if self._are_minima else []
        at_once = max(_TOGETHER // self.nearby.jacobian.size, 1)
        for start in range(0, len(alike), at_once):
            some = alike[start : start + at_once]
            found = self._together([drawn[k].data for k in some])
            results |= {some[number]: estimate for number, estimate in found.items()}
        for k, each in enumerate(drawn):
            if k not in results:
                try:
                    results[k] = self._alone(each)
                except CalibrationError as error:
                    results[k] = error
        return [results[k] for k in range(len(drawn))]

    @property
    def _are_minima(self) -> bool:
        """Whether nothing but minima has to be found, as far as the noise is as stated."""
        problem, known = self.problem, self.first.rows.known.rank
        plain = self.nearby.bend is not None and self.settings.starts == 1 and known.rank == known.n_columns
        stated = not (np.any(problem.unstated) or np.any(problem.confirmed) or np.any(self.first.scales.groups != 1.0))
        return plain and stated and not problem.unknowns.families and not np.any(problem.whitening.tells_offsets)

    def _differs_in_noise(self, data: Measurements) -> bool:
        """Whether these are readings of the same visits, whitened as those of the first draw."""
        first = self.first.identification.data
        return (
            np.array_equal(data.joints, first.joints)
            and _same_looks(data, first)
            and self.problem.whitening.whitens(data)
        )

    def _together(self, data: Sequence[Measurements]) -> dict[int, Estimate]:
        """Calibrate draws that differ in nothing but noise, by number; without those of which more has to be found."""
        root, ones = self.first.rows.known.root, np.ones(len(self.problem.whitening.groups))
        last = dict[int, Evaluation]()

        def evaluate(k: int, z: FloatArray) -> tuple[FloatArray, FloatArray] | None:
            """By the way of every fit."""
            problem = self._problem(data[k], z)
            evaluation = problem.evaluate_if_closed(self._robot(z))
            if evaluation is None:
                return None
            rows, last[k] = problem.rows(evaluation, ones), evaluation
            return rows.residuals, rows.jacobian @ root

        def rows_of(numbers: IntArray, z: FloatArray) -> Iterator[tuple[FloatArray, FloatArray] | None]:
            if self.many is None:
                yield from map(evaluate, numbers, z)
                return
            first = self.first
            passive = self.passive + (z @ self.by_z.T).reshape(-1, *self.passive.shape)
            by_z = first.unknowns.scales[:, None] * root
            found = self.many.rows(_values(first, z), passive, [data[k].readings for k in numbers])
            for k, at, rows in zip(numbers, z, found, strict=True):
                yield evaluate(k, at) if rows is None else (rows[0], rows[1] @ by_z)

        residuals = np.stack([self._residuals(each, self.problem.whitening) for each in data])
        minima = self.nearby.minima(residuals, rows_of)
        found = estimates_at(minima, self.nearby, self.first) if len(minima.draws) else {}
        if not self.problem.noise_weighs:
            return found
        return {
            k: one for k, one in found.items() if not np.any(contradicted(self.problem, last[k], ones)[0].noise_found)
        }

    def _alone(self, drawn: Drawn) -> Estimate:
        """Calibrate from the readings of one draw."""
        first, data = self.first, drawn.data
        if not np.array_equal(data.joints, first.identification.data.joints):
            return self._from(Problem.of(first.nominal, data, self.settings.sigma, drawn.passive), first.robot)
        start, problem = first.robot, self._problem(data)
        if _same_looks(data, first.identification.data):
            z = self.nearby.first(self._residuals(data, problem.whitening)[None])[0]
            start, problem = self._robot(z), self._problem(data, z)
        try:
            return self._from(problem, start)
        except ComputationError:
            if start is first.robot:
                raise
        return self._from(self._problem(data), first.robot)

    def _from(self, problem: Problem, start: Robot) -> Estimate:
        solved = solve_from(problem, problem.evaluate(start), self.settings)
        rows, scales, statistics = uncertainty_at(solved, self.first.statistics.beyond_linear)
        weights = np.ones(rows.layout.n_readings) if solved.weights is None else solved.weights
        typical = [group.typical for group in rows.layout.groups]
        sigma = statistics.factors.values * problem.whitening.totals(scales) * typical
        convergence = convergence_at(solved, rows, statistics.std)
        test = studentised(blocks(rows, weights), rows.weighted(weights).known.root, statistics.freedom)
        return Estimate(
            solved.at.robot.values[self.first.unknowns.index],
            statistics.covariance,
            statistics.std,
            statistics.half_width,
            statistics.coverage_factor,
            sigma,
            float(np.sum(statistics.factors.freedom * (sigma / typical) ** 2)),
            statistics.freedom,
            len(test.outliers) > 0,
            "" if convergence.converged else convergence.message,
        )

    def _robot(self, z: FloatArray) -> Robot:
        """The robot at z (rank,)."""
        rows = self.first.rows
        return self.first.unknowns.moved(self.first.robot, rows.deviations + rows.known.root @ z)

    def _problem(self, data: Measurements, z: FloatArray | None = None) -> Problem:
        """The problem of a draw of the same visits, with passive joints near z (rank,)."""
        passive = self.passive if z is None else self.passive + (self.by_z @ z).reshape(self.passive.shape)
        return self.problem.read_again(data, passive)

    def _residuals(self, data: Measurements, whitening: Whitening) -> FloatArray:
        """Whitened residuals of other readings at the first minimum, (n_rows,)."""
        first, robot, readings = self.first, self.first.robot, data.readings
        residuals = {
            name: robot.instrument(name).compare(seen, robot.values[robot.unknowns(name)], readings[name]).residuals
            for name, seen in self.seen.items()
        }
        weighing = whitening.weighing(first.scales.ratios)
        whitened: FloatArray = whitening.flatten(residuals) / whitening.row_scale(first.scales.groups)
        return whitened if weighing is None else weighing.whiten(whitened)


def _values(first: Fit, z: FloatArray) -> FloatArray:
    """All parameters at z (n, rank), (n, n_parameters) [m or rad]."""
    values = np.repeat(first.robot.values[None], len(z), axis=0)
    values[:, first.unknowns.index] = first.unknowns.values_at(first.rows.deviations + z @ first.rows.known.root.T)
    return values


def _differences(
    problem: Problem, first: Fit, at: Evaluation, many: ManyRobots | None
) -> tuple[FloatArray | None, FloatArray | None]:
    """Second derivative of the rows, (n_rows, rank, rank), and derivative of passive joints; None where not known."""
    rows, root, passive = first.rows, first.rows.known.root, at.configurations.passive
    (n_rows, rank), scales = (len(rows.residuals), root.shape[1]), first.scales
    if n_rows * rank**2 > _LARGEST:
        return None, None
    problem = problem.weighed(scales.ratios)
    bend, by_z = np.empty((n_rows, rank, rank)), np.empty((passive.size, rank))
    found: Iterable[tuple[FloatArray, FloatArray] | None] = [None] * rank
    if many is not None and np.all(scales.groups == 1.0) and not np.any(scales.ratios):
        closed = np.repeat(passive[None], rank, axis=0)
        found = many.rows(_values(first, _STEP * np.eye(rank)), closed, [problem.data.readings] * rank)
    for k, moved in enumerate(found):
        if moved is not None:
            bend[:, :, k] = (moved[1] * first.unknowns.scales - rows.jacobian) @ root / _STEP
            by_z[:, k] = (closed[k] - passive).ravel() / _STEP
            continue
        robot = first.unknowns.moved(first.robot, rows.deviations + _STEP * root[:, k])
        evaluation = problem.evaluate_if_closed(robot, at)
        if evaluation is None:
            return None, None
        there = problem.rows(evaluation, scales.groups, first.unknowns).jacobian
        bend[:, :, k] = (there - rows.jacobian) @ root / _STEP
        by_z[:, k] = (evaluation.configurations.passive - passive).ravel() / _STEP
    return (bend + bend.transpose(0, 2, 1)) / 2, by_z


def _same_looks(data: Measurements, other: Measurements) -> bool:
    """Whether the same was looked at."""
    return all(
        np.array_equal(getattr(data.readings[name], key), getattr(readings, key))
        for name, readings in other.readings.items()
        for key in ("visits", "pairs", "details")
    )
