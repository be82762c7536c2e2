"""Many calibrations of one robot: fits that start near the minimum of the first.

Draws differ in their readings. One draw is calibrated in full, from the nominal robot. Every other draw starts one
linear step away from the minimum of the first. The step follows from the linear model of that minimum (J, T and the
priors' rows, `calib.core.numerics.statistics`) and the draw's own residuals. Then the fit continues as usual, with the
same solver, noise, offsets, robust losses and rules of convergence. Curvature beyond the linear model widens the
intervals as in the first fit.

When it fails. If noise is not stated and parameters have priors, a full fit and a fit from the linear step agree on
the noise to one percent only. If visits differ (a touch moves the robot until contact; poses are drawn again), or a
loop opens after the step, a draw starts at the minimum of the first.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib.core.base.arrays import FloatArray, ReadOnlyArrays
from calib.core.base.errors import ComputationError
from calib.core.data.measurements import Measurements
from calib.core.fitting.fitted import Fit
from calib.core.fitting.problem import Problem
from calib.core.fitting.settings import Settings
from calib.core.fitting.solving import convergence_at, solve_from, uncertainty_at
from calib.core.instruments.kind import View
from calib.core.robots.robot import Robot
from calib.core.rows.observed import views_of_instruments
from calib.core.rows.whitening import Whitening
from calib.studies.study_data import DrawnData


@dataclass(frozen=True, eq=False)
class RepeatedCalibration(ReadOnlyArrays):
    """Calibration of one robot from one draw of data after another; `first` is a finished fit of one draw."""

    first: Fit
    settings: Settings

    @cached_property
    def problem(self) -> Problem:
        """Problem of the first draw."""
        first = self.first
        return Problem.from_data(
            first.nominal, first.identification.data, self.settings.sigma, first.configurations.passive
        )

    @cached_property
    def views(self) -> dict[str, View | FloatArray]:
        """View of each instrument in the first draw, at the minimum, by name; see `views_of_instruments`."""
        return views_of_instruments(
            self.first.robot, self.first.configurations, self.first.identification.data.readings
        )

    def fit(self, drawn: DrawnData) -> Fit:
        """Calibrate from readings of the same visits, or of others.

        Raises:
            CalibrationError: A loop opens, the noise cannot be estimated, or no degrees of freedom are left.
        """
        first, data = self.first, drawn.data
        if not np.array_equal(data.joints, first.identification.data.joints):
            return self._fit_from(
                Problem.from_data(first.nominal, data, self.settings.sigma, drawn.passive), first.robot
            )
        problem = self.problem.with_readings(data, first.configurations.passive)
        if _same_looks(data, first.identification.data):
            try:
                return self._fit_from(problem, self._one_step(data, problem.whitening))
            except ComputationError:
                pass
        return self._fit_from(problem, first.robot)

    def _one_step(self, data: Measurements, whitening: Whitening) -> Robot:
        """The robot one step from the first minimum, by its linear model and other readings."""
        first, robot, rows = self.first, self.first.robot, self.first.rows
        residuals = {
            name: robot.instrument(name)
            .compare(seen, robot.values[robot.unknowns[name]], data.readings[name])
            .residuals
            for name, seen in self.views.items()
        }
        step = rows.step(whitening.whiten(residuals, first.scales))
        return first.unknowns.robot_at(robot, rows.deviations + step)

    def _fit_from(self, problem: Problem, start: Robot) -> Fit:
        solved, first = solve_from(problem, problem.evaluate(start), self.settings), self.first
        final = solved.evaluation
        rows, scales, statistics = uncertainty_at(solved, first.statistics.beyond_linear)
        closed = final.configurations
        return replace(
            first,
            robot=final.robot,
            identification=replace(
                first.identification, data=problem.data, after=final.residuals, passive=closed.passive
            ),
            configurations=closed,
            statistics=statistics,
            rows=rows,
            whitening=problem.whitening,
            scales=scales,
            convergence=convergence_at(solved, rows, statistics.std),
            weights=np.ones(rows.layout.n_readings) if solved.weights is None else solved.weights,
        )


def _same_looks(data: Measurements, other: Measurements) -> bool:
    """Whether the instruments had the same targets at the same visits."""
    return data.readings.keys() == other.readings.keys() and all(
        np.array_equal(getattr(data.readings[name], key), getattr(readings, key))
        for name, readings in other.readings.items()
        for key in ("visits", "pairs", "details")
    )
