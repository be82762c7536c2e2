"""Monte Carlo: many calibrations of one robot on simulated measurements, and the check of its statistics.

In each draw a true robot is measured at the same poses with new noise, and the nominal robot is calibrated from that.
Ideally, estimates scatter over the draws by the claimed `std`, around the truth (no bias), 95 % intervals contain it in
95 of 100 draws, and chi-square agrees with the stated noise. This needs a nearly linear problem, the assumed noise, and
a model that contains the truth. A study shows where one of these fails.

Alternatively, nothing is simulated, and the poses of real measurements are resampled (`calib.studies.study_data`).

Every draw has its own seed, spawned from the study's (`numpy.random.SeedSequence`), so that the numbers do not depend
on the number of workers or the distribution of draws. Workers get draws in chunks, each a fit that starts from the
first (`calib.studies.many_calibrations`). A chunk whose worker is lost is sent again (`calib.core.base.workers`).

When it fails. A draw without an answer, or not converged, is counted and left out. A study simulates
its inputs: errors that are neither in the truth nor in the noise are not in its figures.

Reference: jcgm101.
"""

from __future__ import annotations

import time
from concurrent.futures import Executor
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import CalibrationError, InputError, NotConvergedError
from calib.core.base.memory import require_memory
from calib.core.base.threads import one_blas_thread
from calib.core.base.units import in_si
from calib.core.base.words import count_noun
from calib.core.base.workers import Progress, Workers, results_in_order
from calib.core.calibrating.calibrate import calibrate
from calib.core.data.in_memory import PosesLike
from calib.core.data.measurements import Measurements
from calib.core.fitting.fitted import Fit
from calib.core.fitting.settings import Settings
from calib.core.judging.findings import outliers
from calib.core.numerics.losses import find_loss
from calib.core.robots.acceleration import compilation_requested, compile_kinematics, pays
from calib.core.robots.configurations import joint_vector
from calib.core.robots.loading import RobotLike, as_robot
from calib.core.robots.robot import Robot
from calib.studies.many_calibrations import RepeatedCalibration
from calib.studies.study_data import Noise, ResampledDraws, SimulatedDraws, simulated_draws
from calib.studies.study_result import Draws, Study

_CHUNK = 50


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

    @property
    def first(self) -> Fit:
        """The fit from which all others start."""
        return self.repeated.first


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
    robot, sigma = as_robot(robot), None if sigma is None else in_si(sigma, "length", "sigma")
    started = time.perf_counter()
    if draws < 2:
        raise InputError(f"draws {draws}: must be 2 or more")
    settings = Settings(sigma=sigma, loss=find_loss(loss), seed=seed)
    shared = np.random.SeedSequence(seed)
    chunks = [range(start, min(start + _CHUNK, draws)) for start in range(0, draws, _CHUNK)]
    done, failures = list[Draws](), list[str]()
    with Workers(executor, len(chunks)) as workers:
        source: SimulatedDraws | Measurements
        if not resample:
            source = simulated_draws(robot, poses, truth, sigma, noise)
        elif truth is not None or noise is not None:
            raise InputError("resample: simulates nothing, so truth and noise have no effect; leave them out")
        elif not isinstance(poses, Measurements):
            need = "needs measurements, as calib.read_measurements reads them; these are poses alone"
            raise InputError(f"resample: {need}")
        else:
            source = poses
        setting = _prepare(robot, source, settings, elsewhere, shared, draws)
        if setting.compiled and workers is not None:
            _chunk(setting, range(1))  # compiles once, so that workers only load the result
        for chunk, (some, why) in zip(chunks, results_in_order(partial(_chunk, setting), chunks, workers), strict=True):
            done += some
            failures += why
            if progress is not None:
                progress(chunk.stop, draws)
    if len(failures) == draws:
        raise NotConvergedError(f"none of the {draws} draws gave an answer: {failures[0]}")
    first = setting.first
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
    """The setting, with the calibration from which all others start."""
    q = np.zeros((0, len(robot.joint_names))) if elsewhere is None else joint_vector(robot, elsewhere)
    near = robot.assemble(q).passive
    data = source if isinstance(source, Measurements) else source.draw(_seed_of_draw(seed, 0)).data
    first = calibrate(robot, data, None, settings)
    if not first.converged:
        which = "calibration from all poses" if data is source else "first of the simulated calibrations"
        raise NotConvergedError(f"the {which} did not converge: {first.message}")
    drawing: SimulatedDraws | ResampledDraws
    if isinstance(source, Measurements):
        drawing = ResampledDraws(first.robot, source, first.configurations.passive)
    else:
        drawing = source
    use_compiled = pays(draws * len(data)) or compilation_requested()
    setting = _Setting(drawing, RepeatedCalibration(first, settings), q, near, use_compiled, seed)
    each = 4 * len(first.unknowns) + len(first.noise) + 3 + 6 * len(q) * len(robot.target_names)
    require_memory(2 * draws * each, count_noun(draws, "draw"), "ask for fewer")
    return setting


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
                drawn = setting.source.draw(_seed_of_draw(setting.seed, number))
                fit = setting.repeated.fit(drawn)
            except CalibrationError as error:
                failures.append(str(error))
                continue
            if fit.converged:
                draws.append(_draw(setting, drawn.truth, fit))
            else:
                failures.append(fit.message)
    return [Draws.join(draws)] if draws else [], failures


def _draw(setting: _Setting, truth: Robot, fit: Fit) -> Draws:
    """The row of a draw."""
    known, sigma = fit.interval_statistics, np.array([estimate.sigma for estimate in fit.noise])
    true = dict(zip((parameter.name for parameter in truth.parameters), truth.values, strict=True))
    none: FloatArray = np.zeros((0, len(truth.target_names), 3))
    errors = half_width = none
    if len(setting.prediction_joints):
        q, near = setting.prediction_joints, setting.prediction_passive
        predicted = fit.uncertainty.predict(fit.robot, q, near=near, turns=False)
        half_width = predicted.coverage_factor * predicted.std
        errors = predicted.positions - truth.positions(q, seed=near)
    # repeats of resampled poses scatter less than noise does
    square = fit.chi_square if isinstance(setting.source, SimulatedDraws) else None
    rows = (
        np.array([true.get(name, np.nan) for name in fit.free_names]),
        fit.robot.values[fit.unknowns.index],
        known.std,
        known.half_width,
        sigma,
        np.nan if square is None else square.value,
        known.freedom,
        float(len(outliers(fit)) > 0),
        errors,
        half_width,
    )
    return Draws(*(np.asarray(row)[None] for row in rows))
