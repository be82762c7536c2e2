"""Many calibrations of one robot from the same visits: what they share is computed once.

Draws differ in what the instruments read. The poses of the nominal robot, closed from home, are the same in every draw,
and so, nearly, is the linear model around the minimum. One draw is calibrated in full, from the nominal robot; with its
whitened Jacobian J, residuals r(y) of readings y at its minimum, and T T^T = (J^T J + P)^-1
(`calib.numerics.statistics`), every other draw starts at

    u = u_0 - T T^T (J^T r(y) + P u_0)

a few products of small matrices away. From there the same solver as in every fit takes exact steps, with its own
Jacobian and its own closed loops, until its own stopping rule is met: the minimum is the one that `calib.fit` finds, to
a small part of a standard deviation, after two evaluations in place of a dozen.

When it fails. Where noise is not stated and priors hold something, both find the noise to one percent, along different
ways. Where visits differ (touches move the robot until it touches; poses are drawn again), or a loop opens at the
common start, a draw begins where the first one ended.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.base.arrays import FloatArray
from calib.base.errors import ComputationError
from calib.data.measurements import Measurements
from calib.fitting.fitted import Convergence, Fit
from calib.fitting.outliers import blocks
from calib.fitting.problem import Problem
from calib.fitting.settings import Settings
from calib.fitting.solving import convergence_at, solve_from, uncertainty_at
from calib.instruments.kind import Readings
from calib.numerics.losses import studentised
from calib.numerics.statistics import Statistics
from calib.robots.robot import Robot
from calib.rows.observed import seen_by
from calib.rows.rows import Rows


@dataclass(frozen=True, eq=False)
class Estimate:
    """What one draw gave.

    Attributes:
        robot: The calibrated robot.
        rows: Whitened residuals and Jacobian at the minimum.
        statistics: Uncertainty of the free parameters.
        convergence: How the iteration ended.
        weights: Of each reading, (n_readings,); 1 without a robust loss.
        sigma: Noise found of each group of rows, (n_groups,) [SI].
    """

    robot: Robot
    rows: Rows
    statistics: Statistics
    convergence: Convergence
    weights: FloatArray
    sigma: FloatArray

    @property
    def chi_square(self) -> float:
        """Sum of squares of the residuals in units of the stated noise, where all of it is stated."""
        stated = [group.typical for group in self.rows.layout.groups]
        return float(np.sum(self.statistics.factors.freedom * (self.sigma / stated) ** 2))

    @property
    def names_outliers(self) -> bool:
        """Whether some reading lies further off than noise explains."""
        rows = self.rows.weighted(self.weights)
        test = studentised(blocks(self.rows, self.weights), rows.known.root, self.statistics.freedom)
        return len(test.outliers) > 0


class Repeated:
    """Calibrates again and again.

    Args:
        first: A finished fit of one draw.
        settings: How to fit.
    """

    def __init__(self, first: Fit, settings: Settings) -> None:
        self._first, self._settings = first, settings
        data, near = first.identification.data, first.configurations.passive
        self._problem = Problem.of(first.nominal, data, settings.sigma, near)
        self._near = self._problem.evaluate(first.robot)
        self._seen = seen_by(first.robot, self._near.configurations, data.readings)

    def estimate(self, data: Measurements, passive: FloatArray | None = None) -> Estimate:
        """Calibrate from other readings.

        Args:
            data: Of the same visits, or of others.
            passive: Passive joints near these, (n, n_passive) [m or rad], if they are known.

        Raises:
            ComputationError: A loop opens, or the noise cannot be found.
            NotIdentifiableError: No degrees of freedom are left.
        """
        first = self._first
        if not np.array_equal(data.joints, first.identification.data.joints):
            return self._from(Problem.of(first.nominal, data, self._settings.sigma, passive), first.robot)
        problem = self._problem.read_again(data, self._near)
        start = self._stepped(problem)
        try:
            return self._from(problem, start)
        except ComputationError:
            if start is first.robot:
                raise
        return self._from(problem, first.robot)

    def _from(self, problem: Problem, start: Robot) -> Estimate:
        solved = solve_from(problem, problem.evaluate(start), self._settings)
        rows, scales, statistics = uncertainty_at(solved, self._first.statistics.beyond_linear)
        weights = np.ones(rows.layout.n_readings) if solved.weights is None else solved.weights
        typical = [group.typical for group in rows.layout.groups]
        sigma = statistics.factors.values * problem.whitening.totals(scales) * typical
        return Estimate(solved.at.robot, rows, statistics, convergence_at(solved, rows, statistics.std), weights, sigma)

    def _stepped(self, problem: Problem) -> Robot:
        """The common start, a step of the common linear model on; without it where other readings are there."""
        first, robot = self._first, self._first.robot
        readings, known = problem.data.readings, first.identification.data.readings
        if any(not _same_looks(readings[name], known[name]) for name in known):
            return robot
        residuals = {
            name: robot.instrument(name).compare(seen, robot.values[robot.unknowns(name)], readings[name]).residuals
            for name, seen in self._seen.items()
        }
        rows, root, groups = first.rows, first.rows.known.root, first.scales.groups
        whitening = problem.whitening
        weighing = whitening.weighing(first.scales.ratios)
        whitened: FloatArray = whitening.flatten(residuals) / whitening.row_scale(groups)
        whitened = whitened if weighing is None else weighing.whiten(whitened)
        pull = rows.jacobian.T @ whitened + rows.prior.pull(rows.deviations)
        return first.unknowns.moved(robot, rows.deviations - root @ (root.T @ pull))


def _same_looks(readings: Readings, other: Readings) -> bool:
    return all(np.array_equal(getattr(readings, key), getattr(other, key)) for key in ("visits", "pairs", "details"))
