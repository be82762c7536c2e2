"""Monte Carlo: many calibrations of one robot on simulated measurements, and the check of its statistics.

In each draw a true robot is measured at the same poses with new noise, and the nominal robot is calibrated from that.
Ideally, estimates scatter over the draws by the claimed `std`, around the truth (no bias), 95 % intervals contain it in
95 of 100 draws, and chi-square agrees with the stated noise. This needs a nearly linear problem, the assumed noise, and
a model that contains the truth. A study shows where one of these fails.

Alternatively, nothing is simulated, and the poses of real measurements are resampled (`calib.studies.study_data`).

Every draw has its own seed, spawned from the study's (`numpy.random.SeedSequence`), so that the numbers do not depend
on the number of workers or the distribution of draws. Workers get draws in chunks. A chunk whose worker is lost is sent
again (`calib.core.base.workers`).

Draws differ in their readings. One draw is calibrated in full, from the nominal robot. Every other draw starts one
linear step away from the minimum of the first. The step follows from the linear model of that minimum (J, T and the
priors' rows, `calib.core.numerics.statistics`) and the draw's own residuals. Then the fit continues as usual, with the
same solver, noise, offsets, robust losses and rules of convergence. Curvature beyond the linear model widens the
intervals as in the first fit.

When it fails. A draw without an answer, or not converged, is counted and left out. A study simulates its inputs: errors
that are neither in the truth nor in the noise are not in its figures. If noise is not stated and parameters have
priors, a full fit and a fit from the linear step agree on the noise to one percent only. If visits differ (a touch
moves the robot until contact; poses are drawn again), or a loop opens after the step, a draw starts at the minimum of
the first.

Reference: jcgm101.
"""

from __future__ import annotations

import time
from concurrent.futures import Executor
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from calib.core.base.arrays import FloatArray, ReadOnlyArrays
from calib.core.base.errors import CalibrationError, ComputationError, InputError, NotConvergedError
from calib.core.base.memory import require_memory
from calib.core.base.threads import one_blas_thread
from calib.core.base.units import sigma_in_si
from calib.core.base.words import count_noun
from calib.core.base.workers import Progress, Workers, results_in_order
from calib.core.calibrating.calibrate import calibrate
from calib.core.data.in_memory import PosesLike
from calib.core.data.measurements import Measurements
from calib.core.fitting.fitted import Fit
from calib.core.fitting.problem import Problem
from calib.core.fitting.settings import Settings
from calib.core.fitting.solving import convergence_at, solve_from, uncertainty_at
from calib.core.instruments.kind import View
from calib.core.judging.findings import outliers
from calib.core.numerics.losses import find_loss
from calib.core.robots.acceleration import compilation_requested, compile_kinematics, pays
from calib.core.robots.configurations import joint_vector
from calib.core.robots.loading import RobotLike, as_robot
from calib.core.robots.robot import Robot
from calib.core.robots.terms.term import Context
from calib.core.rows.observed import views_of_instruments
from calib.core.rows.whitening import Whitening
from calib.studies.study_data import Noise, ResampledDraws, SimulatedDraws, simulated_draws
from calib.studies.study_result import Draws, Study

_CHUNK = 50


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

    def fit(self, data: Measurements, passive: FloatArray | None = None) -> Fit:
        """Calibrate from readings of the same visits, or of others; see `SimulatedDraws.draw`.

        Raises:
            CalibrationError: A loop opens, the noise cannot be estimated, or no degrees of freedom are left.
        """
        first = self.first
        if not np.array_equal(data.joints, first.identification.data.joints):
            return self._fit_from(Problem.from_data(first.nominal, data, self.settings.sigma, passive), first.robot)
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


@dataclass(frozen=True, eq=False)
class _Setting:
    """Data that all draws share.

    Attributes:
        source: Source of the data of a draw.
        repeated: Calibration of further draws.
        prediction_joints: Joint values of poses to predict, (n, n_actuated) [m or rad].
        prediction_passive: Passive joints there, (n, n_passive) [m or rad].
        compiled: Whether the work is large enough to load compiled code.
        seed: Seed of the whole study, from which those of draws are spawned.
    """

    source: SimulatedDraws | ResampledDraws
    repeated: RepeatedCalibration
    prediction_joints: FloatArray
    prediction_passive: FloatArray
    compiled: bool
    seed: np.random.SeedSequence


def study(
    robot: RobotLike,
    poses: PosesLike,
    *,
    draws: int = 1000,
    truth: Robot | Literal["priors"] | None = None,
    resample: bool = False,
    sigma: float | str | None = None,
    noise: Noise | None = None,
    loss: str = "none",
    elsewhere: ArrayLike | None = None,
    seed: int = 0,
    executor: Executor | int | None = None,
    progress: Progress | None = None,
) -> Study:
    """Calibrate a robot many times from simulated measurements, or from real ones drawn with replacement.

    Args:
        robot: The nominal robot, from which every fit starts.
        poses: Poses to measure: poses with names, or joint values alone, (n, n_actuated) [m or rad]; for measurements,
            with the same readings at each.
        truth: The measured robot; default: `robot`; `priors`: a robot with parameters drawn from the priors each time.
        resample: Simulate nothing: each draw has as many poses of the measurements `poses` as there are, with
            replacement (for its meaning see `calib.studies.study_data`). The truth is the fit of all.
        sigma: Standard deviation of measured positions per axis [m]; default: the description's.
        noise: Function from exact measurements and a generator to the readings of a draw; default: normal noise as
            stated. It must be in a module, so that other processes find it.
        loss: `none`, or a robust loss: `huber`, `cauchy`, `tukey`.
        elsewhere: Joint values of poses to predict, (n, n_actuated) [m or rad]; default: none.
        seed: Seed of the whole study.
        executor: Executor of the draws; as in `calib.fit`.
        progress: Called with the number of finished draws and of all draws.

    Raises:
        InputError: An unusable number of draws or processes, unstated noise, nothing to resample.
        NotConvergedError: The first draw did not converge, or no draw gave an answer.
        CalibrationError: As `calib.fit`, for the first draw.
    """
    robot, sigma = as_robot(robot), sigma_in_si(sigma)
    started = time.perf_counter()
    if draws < 2:
        raise InputError(f"draws {draws}: must be 2 or more")
    settings = Settings(sigma=sigma, loss=find_loss(loss), seed=seed)
    shared = np.random.SeedSequence(seed)
    done, failures = list[Draws](), list[str]()
    with Workers(executor, -(-draws // _CHUNK)) as workers:
        source: SimulatedDraws | Measurements
        if not resample:
            source = simulated_draws(robot, poses, truth, sigma, noise)
        elif truth is not None or noise is not None:
            raise InputError("resample: simulates nothing, so truth and noise have no effect; leave them out")
        elif isinstance(poses, Measurements):
            source = poses
        else:
            need = "needs measurements, as calib.read_measurements reads them; these are poses alone"
            raise InputError(f"resample: {need}")
        setting = _prepare(robot, source, settings, elsewhere, shared, draws)
        chunks = [range(start, min(start + _CHUNK, draws)) for start in range(0, draws, _CHUNK)]
        if setting.compiled and workers is not None:
            _chunk(setting, range(1))  # compiles once, so that workers only load the result
        for chunk, (some, why) in zip(chunks, results_in_order(partial(_chunk, setting), chunks, workers), strict=True):
            done += some
            failures += why
            if progress is not None:
                progress(chunk.stop, draws)
    if len(failures) == draws:
        raise NotConvergedError(f"none of the {draws} draws gave an answer: {failures[0]}")
    first = setting.repeated.first
    return Study(
        robot.name,
        tuple(first.nominal.parameters[k] for k in first.unknowns.index),
        tuple(f"{estimate.group.name}: {estimate.group.part.name}" for estimate in first.noise),
        Draws.join(done),
        tuple(failures),
        setting.source.data.n_poses,
        seed,
        time.perf_counter() - started,
        resample,
    )


@one_blas_thread
def _prepare(
    robot: Robot,
    source: SimulatedDraws | Measurements,
    settings: Settings,
    elsewhere: ArrayLike | None,
    seed: np.random.SeedSequence,
    draws: int,
) -> _Setting:
    q = np.zeros((0, len(robot.joint_names))) if elsewhere is None else joint_vector(robot, elsewhere)
    near = robot.assemble(q).passive
    data = source if isinstance(source, Measurements) else source.draw(_seed_of_draw(seed, 0))[1]
    first = calibrate(robot, data, None, settings)
    if not first.converged:
        which = "calibration from all poses" if data is source else "first of the simulated calibrations"
        raise NotConvergedError(f"the {which} did not converge: {first.message}")
    each = 4 * len(first.unknowns) + len(first.noise) + 3 + 6 * len(q) * len(robot.target_names)
    require_memory(2 * draws * each, count_noun(draws, "draw"), "ask for fewer")
    if isinstance(source, Measurements):
        drawing: SimulatedDraws | ResampledDraws = ResampledDraws(first.robot, source, first.configurations.passive)
    else:
        drawing = source
    use_compiled = pays(draws * len(data)) or compilation_requested()
    return _Setting(drawing, RepeatedCalibration(first, settings), q, near, use_compiled, seed)


def _seed_of_draw(seed: np.random.SeedSequence, number: int) -> np.random.SeedSequence:
    """The seed that `seed.spawn` would give to a draw, found without those of earlier draws."""
    return np.random.SeedSequence(seed.entropy, spawn_key=(number,))


@one_blas_thread
def _chunk(setting: _Setting, numbers: range) -> tuple[list[Draws], list[str]]:
    """The draws of these numbers that have an answer, in one, and the reasons of the others."""
    draws, failures = list[Draws](), list[str]()
    with compile_kinematics() if setting.compiled else nullcontext():
        for number in numbers:
            try:
                truth, data, passive = setting.source.draw(_seed_of_draw(setting.seed, number))
                fit = setting.repeated.fit(data, passive)
            except CalibrationError as error:
                failures.append(str(error))
                continue
            if fit.converged:
                draws.append(_draw(setting, truth, fit))
            else:
                failures.append(fit.message)
    return [Draws.join(draws)] if draws else [], failures


def _draw(setting: _Setting, truth: Robot, fit: Fit) -> Draws:
    known, true = fit.interval_statistics, truth.values_by_name
    half_width: FloatArray = np.zeros((0, len(truth.target_names), 3))
    errors = half_width
    if len(setting.prediction_joints):
        q, near = setting.prediction_joints, setting.prediction_passive
        context = replace(Context.neutral(*q.shape), approach=np.ones_like(q))  # the side of any play is known
        predicted = fit.uncertainty.predict(fit.robot, q, context, near, turns=False)
        half_width = predicted.coverage_factor * predicted.std
        errors = predicted.positions - truth.positions(q, context, seed=near)
    # repeats of resampled poses scatter less than noise does
    square = fit.chi_square if isinstance(setting.source, SimulatedDraws) else None
    rows = (
        np.array([true.get(name, np.nan) for name in fit.free_names]),
        fit.robot.values[fit.unknowns.index],
        known.std,
        known.half_width,
        [estimate.sigma for estimate in fit.noise],
        np.nan if square is None else square.value,
        known.freedom,
        float(len(outliers(fit)) > 0),
        errors,
        half_width,
    )
    return Draws(*(np.asarray(row)[None] for row in rows))
