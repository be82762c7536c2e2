"""Monte Carlo: many calibrations of one robot on simulated measurements, and what they say about its statistics.

In each draw a true robot is measured at the same poses with new noise, and the nominal robot calibrated from that. Over
many draws the estimates scatter by what the fit claims (`std`), around the truth (no bias), 95 % intervals hold it in
95 of 100 draws, and chi-square is what the stated noise says: as far as the problem is linear, the noise is what is
assumed, and the model can be the truth. Where one of these fails is what a study finds out.

Every draw has its own seed, spawned from the study's (`numpy.random.SeedSequence`), so that the numbers depend neither
on how many workers share the draws nor on how they are dealt out. Draws are sent to the workers in chunks; what a chunk
shares is computed once (`calib.identification.repeated`). A chunk whose worker is lost is sent again
(`calib.workers`).

When it fails. A draw that ends without an answer, or not converged, is counted and left out of every average. A study
simulates what it is told: errors that nobody put into the truth or the noise are not in its figures.

Reference: jcgm101.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack, nullcontext
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from calib.arrays import FloatArray
from calib.data.in_memory import as_poses
from calib.data.measurements import Measurements, Poses
from calib.errors import CalibrationError, InputError, NotConvergedError
from calib.identification.fit import Settings, identify
from calib.identification.fitted import Fit
from calib.identification.repeated import Estimate, Repeated
from calib.identification.study_result import Draws, Study
from calib.linearisation.jacobian import linearise
from calib.linearisation.observed import predicted_readings
from calib.linearisation.prediction import carried
from calib.linearisation.simulate import noisy_readings, simulate, unstated_noise
from calib.model.acceleration import asked, compiled
from calib.model.robot import Robot, require_robot
from calib.numerics.losses import checked_loss
from calib.threads import one_blas_thread
from calib.workers import Workers, in_order

Noise = Callable[[Measurements, np.random.Generator], Measurements]
"""Makes what is read of what would be read without noise."""
_CHUNK = 50
_MANY = 20_000  # poses of all draws for which each process may load compiled code


@dataclass(frozen=True, eq=False)
class _Setting:
    """What all draws share.

    Attributes:
        truth: The robot that is measured.
        exact: What would be read of it without noise.
        drawn: Which parameters of the truth are drawn in each draw, by how much, (n_parameters,) [m or rad].
        noise: What makes measurements of `exact`, if that is not what the description states.
        settings: How to fit.
        first: The fit of the first draw; None before that.
        compiled: Whether there is so much to do that loading compiled code is worth it.
        elsewhere: Joint values of poses to predict, (n, n_actuated) [m or rad].
        near: Passive joints there, (n, n_passive) [m or rad].
        passive: Passive joints of the truth where it is measured, (n, n_passive) [m or rad].
    """

    truth: Robot
    exact: Measurements
    drawn: FloatArray
    noise: Noise | None
    settings: Settings
    elsewhere: FloatArray
    near: FloatArray
    passive: FloatArray
    first: Fit | None = None
    compiled: bool = False

    def measured(self, seed: np.random.SeedSequence) -> tuple[Robot, Measurements]:
        """Return the true robot of a draw, and what is measured of it."""
        rng, truth, exact = np.random.default_rng(seed), self.truth, self.exact
        if np.any(self.drawn):
            truth = truth.with_parameters(truth.values + self.drawn * rng.standard_normal(len(self.drawn)))
        if any(not one.columns() for one in truth.instruments):  # touches: the noise is in the joints
            return truth, simulate(truth, exact, self.settings.sigma, rng)
        if truth is not self.truth:
            there = truth.assemble(exact.joints, self.passive, exact.labels, exact.conditions)
            exact = replace(exact, readings=predicted_readings(truth, there, exact.readings))
        if self.noise is not None:
            return truth, self.noise(exact, rng)
        return truth, replace(exact, readings=noisy_readings(truth, exact.readings, self.settings.sigma, rng))


def study(
    robot: Robot,
    poses: Poses | ArrayLike,
    *,
    draws: int = 1000,
    truth: Robot | Literal["priors"] | None = None,
    sigma: float | None = None,
    noise: Noise | None = None,
    loss: str = "none",
    elsewhere: ArrayLike | None = None,
    seed: int = 0,
    executor: Executor | int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Study:
    """Calibrate a robot many times from simulated measurements.

    Args:
        robot: The nominal robot, as every fit starts from it.
        poses: Where to measure: poses with names, or joint values alone, (n, n_actuated) [m or rad]; of measurements,
            what was read at each.
        draws: How many calibrations.
        truth: The robot that is measured; `robot` itself if not given; `priors` for one whose parameters are drawn anew
            from the priors each time.
        sigma: Standard deviation of measured positions per axis [m], in place of what the description states.
        noise: What makes the readings of a draw of exact ones and a generator, if it is not normal noise as stated; a
            function of a module, so that other processes find it.
        loss: `none`, or a robust loss: `huber`, `cauchy`, `tukey`.
        elsewhere: Joint values of poses to predict, (n, n_actuated) [m or rad]; none if not given.
        seed: Seed of the whole study.
        executor: Who does the draws: any `concurrent.futures` executor, or a number of processes on this machine; this
            process if not given.
        progress: Called with the number of draws done and of all draws, in the order of work.

    Raises:
        InputError: A number of draws or processes that makes no sense, or noise that nobody states.
        NotConvergedError: The first draw did not converge, or none gave an answer.
        CalibrationError: What `calib.fit` raises, of the first draw.
    """
    require_robot(robot)
    started = time.perf_counter()
    _require_sense(robot, draws, sigma, noise, executor)
    settings = Settings(sigma=sigma, loss=checked_loss(loss), seed=seed)
    setting = _prepared(robot, poses, truth, noise, settings, elsewhere)
    seeds = np.random.SeedSequence(seed).spawn(draws)
    many = draws * len(setting.exact) >= _MANY or asked()
    setting = replace(setting, first=_first_fit(robot, setting, seeds[0]), compiled=many)
    tasks = [(setting, tuple(seeds[start : start + _CHUNK])) for start in range(0, draws, _CHUNK)]
    parts = list[tuple[Draws, tuple[str, ...]]]()
    with Workers(executor, len(tasks)) as workers:
        for part in in_order(_chunk, tasks, workers):
            parts.append(part)
            if progress is not None:
                progress(sum(len(one) for one, _ in parts), draws)
    return _joined(setting, parts, seed, time.perf_counter() - started)


def _require_sense(
    robot: Robot, draws: int, sigma: float | None, noise: Noise | None, executor: Executor | int | None
) -> None:
    """Raise `InputError` for what no study can be made of."""
    if draws < 2:
        raise InputError(f"draws {draws}: must be 2 or more")
    if isinstance(executor, int) and executor < 1:
        raise InputError(f"executor {executor}: a number of processes must be 1 or more")
    unstated = [] if noise is not None else unstated_noise(robot, sigma)
    if unstated:
        raise InputError(
            f"{robot.path}: states no noise (sigma) of {', '.join(unstated)}, so that none can be simulated; state it"
            " there, or give sigma (of positions), or noise"
        )


def _prepared(
    robot: Robot,
    poses: Poses | ArrayLike,
    truth: Robot | Literal["priors"] | None,
    noise: Noise | None,
    settings: Settings,
    elsewhere: ArrayLike | None,
) -> _Setting:
    if not (truth is None or truth == "priors" or isinstance(truth, Robot)):
        raise InputError(f"truth {truth!r:.60}: must be a robot, or 'priors'")
    true = truth if isinstance(truth, Robot) else robot
    drawn = np.zeros(len(true.parameters))
    if truth == "priors":
        drawn = np.array([p.sigma * p.prior for p in robot.parameters]) * robot.is_free
        if not np.any(drawn):
            raise InputError(f"{robot.path}: has no priors to draw the truth from; give a robot as the truth")
    exact = simulate(true, as_poses(robot, poses), 0.0)
    there = np.zeros((0, len(robot.joint_names))) if elsewhere is None else robot.joint_vector(elsewhere)
    near = robot.assemble(there).passive
    passive = true.assemble(exact.joints, labels=exact.labels, context=exact.conditions).passive
    return _Setting(true, exact, drawn, noise, settings, there, near, passive)


def _first_fit(robot: Robot, setting: _Setting, seed: np.random.SeedSequence) -> Fit:
    first = identify(robot, setting.measured(seed)[1], None, setting.settings)
    if not first.converged:
        raise NotConvergedError(f"the first of the simulated calibrations did not converge: {first.message}")
    return first


@one_blas_thread
def _chunk(task: tuple[_Setting, Sequence[np.random.SeedSequence]]) -> tuple[Draws, tuple[str, ...]]:
    """Do some draws; return what they gave, and why some gave no answer."""
    setting, seeds = task
    first = setting.first
    assert first is not None  # tasks are made after it
    repeated = Repeated(first, setting.settings)
    draws, failures = list[Draws](), list[str]()
    with compiled() if setting.compiled else nullcontext():
        for seed in seeds:
            try:
                truth, data = setting.measured(seed)
                estimate = repeated.estimate(data)
                if not estimate.convergence.converged:
                    raise NotConvergedError(estimate.convergence.message)
                draws.append(_draw(setting, first, truth, estimate))
            except CalibrationError as error:
                failures.append(str(error))
                draws.append(_unanswered(setting, first))
    return Draws.joined(draws), tuple(failures)


def _draw(setting: _Setting, first: Fit, truth: Robot, estimate: Estimate) -> Draws:
    """One draw that gave an answer."""
    true = dict(zip((one.name for one in truth.parameters), truth.values, strict=True))
    statistics = estimate.statistics
    errors = half_width = np.zeros((0, len(truth.target_names), 3))
    if len(setting.elsewhere):
        at = linearise(estimate.robot, estimate.robot.assemble(setting.elsewhere, setting.near))
        spread = carried(at.jacobian[..., first.unknowns.index], statistics.covariance)
        half_width = statistics.coverage_factor * np.sqrt(np.diagonal(spread, axis1=2, axis2=3))
        errors = at.positions - truth.positions(setting.elsewhere, seed=setting.near)
    rows = (
        np.array([true.get(name, np.nan) for name in first.free_names]),
        estimate.robot.values[first.unknowns.index],
        statistics.std,
        statistics.half_width,
        estimate.sigma,
        estimate.chi_square if first.chi_square is not None else np.nan,
        statistics.freedom,
        float(estimate.names_outliers),
        errors,
        half_width,
    )
    return Draws(*(np.asarray(row)[None] for row in rows))


def _unanswered(setting: _Setting, first: Fit) -> Draws:
    """One draw that gave no answer."""
    n_free, there = len(first.unknowns), (len(setting.elsewhere), len(first.nominal.target_names), 3)
    shapes = ((n_free,),) * 4 + ((len(first.noise),),) + ((),) * 3 + (there,) * 2
    return Draws(*(np.full((1, *shape), np.nan) for shape in shapes))


def _joined(setting: _Setting, parts: Sequence[tuple[Draws, tuple[str, ...]]], seed: int, seconds: float) -> Study:
    """Put the parts together."""
    first = setting.first
    assert first is not None
    draws = Draws.joined([part for part, _ in parts])
    failures = tuple(text for _, texts in parts for text in texts)
    free = tuple(first.nominal.parameters[k] for k in first.unknowns.index)
    groups = tuple(f"{one.group.name}: {one.group.part}" for one in first.noise)
    return Study(first.nominal.name, free, groups, draws, failures, setting.exact.n_poses, seed, seconds)
