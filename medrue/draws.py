"""Many simulated calibrations of one robot: the same truth and pose sets, other measurement noise.

Each draw adds one noise field to the true positions of all candidate poses; every set of poses is calibrated from its
part of that field, so that sets are compared on the same noise. `calib.fit` identifies once from nominal, with exact
measurements. From there a draw is one or two Gauss-Newton steps away, with `calib`'s Jacobian; the minimum is the one
that `calib.fit` finds (tested).

The draws are done in chunks of fixed size with one thread for linear algebra, so that the numbers do not depend on how
many processes share them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from itertools import islice
from typing import TypeVar

import numpy as np

from calib import fit
from calib.core.base.arrays import FloatArray, IntArray
from calib.core.base.errors import NotConvergedError
from calib.core.base.threads import one_blas_thread
from calib.core.base.workers import Progress, results_in_order
from calib.core.data.in_memory import as_measurements
from calib.core.data.measurements import Measurements
from calib.core.numerics import linalg
from calib.core.robots.configurations import Configurations
from calib.core.robots.jacobian import linearise
from calib.core.robots.robot import Robot

Item = TypeVar("Item")
Result = TypeVar("Result")
CHUNK = 10
"""Draws that are done together."""
_MAX_STEPS = 12
_SMALL_STEP = 0.03
"""Part of the residual that the last step explains; the next one, its square at most, is not worth it."""


@dataclass(frozen=True)
class Work:
    """How simulations are run; numbers do not depend on it.

    Attributes:
        executor: Executor of the draws; this process if there is none.
        show: Shows the progress of a stage of the work, by its name (`calib.core.commands.common.Output.working`).
    """

    executor: Executor | None = None
    show: Callable[[str], AbstractContextManager[Progress | None]] = lambda _: nullcontext()

    def results(self, stage: str, function: Callable[[Item], Result], tasks: Sequence[Item]) -> list[Result]:
        """Return the result of each task."""
        with self.show(stage) as progress:
            return list(results_in_order(function, tasks, self.executor, progress))


@dataclass(frozen=True, eq=False)
class PoseSet:
    """Poses to identify with; all others validate.

    Attributes:
        name: Name of the choice.
        chosen: Their indices among the candidates, ascending, (n,).
    """

    name: str
    chosen: IntArray

    def validation_indices(self, n_candidates: int) -> IntArray:
        """Return the indices of the poses that validate, ascending, (n_candidates - n,)."""
        return np.setdiff1d(np.arange(n_candidates), self.chosen)


@dataclass(frozen=True, eq=False)
class DrawTask:
    """Draws of noise on one truth.

    Attributes:
        robot: The nominal robot.
        joints: Candidate poses, (n, n_actuated) [m, rad].
        truth: Exact positions of the tool there, (n, 3) [m].
        sets: The pose sets to compare.
        sigma: Noise of one coordinate [m].
        seeds: One for each draw.
    """

    robot: Robot
    joints: FloatArray
    truth: FloatArray
    sets: tuple[PoseSet, ...]
    sigma: float
    seeds: tuple[np.random.SeedSequence, ...]

    def noisy(self, seed: np.random.SeedSequence) -> FloatArray:
        """Return the measured positions of one draw, (n, 3) [m]."""
        return self.truth + np.random.default_rng(seed).normal(0.0, self.sigma, self.truth.shape)

    def chunks(self) -> list[DrawTask]:
        """Return the same draws in chunks of `CHUNK`."""
        starts = range(0, len(self.seeds), CHUNK)
        return [replace(self, seeds=self.seeds[start : start + CHUNK]) for start in starts]


@dataclass(frozen=True, eq=False)
class DrawOutcome:
    """Results of the draws, axes (draw, set, ...).

    Attributes:
        values: Identified parameters, (n_draws, n_sets, n_parameters) [m, rad].
        distances: Distance of the predicted from the true position at every candidate, (n_draws, n_sets, n) [m].
    """

    values: FloatArray
    distances: FloatArray


def measurements(robot: Robot, joints: FloatArray, positions: FloatArray, index: IntArray) -> Measurements:
    """Return positions of the tool (n, 3) [m], one at each of the poses `index`, as measurements."""
    return as_measurements(robot, joints[index], positions[index], [str(k + 1) for k in index])


def run(tasks: Sequence[DrawTask], work: Work) -> list[DrawOutcome]:
    """Return the outcome of each task."""
    chunks = [task.chunks() for task in tasks]
    parts = iter(work.results("simulated calibrations", run_chunk, [chunk for some in chunks for chunk in some]))
    outcomes = []
    for some in chunks:
        own = list(islice(parts, len(some)))
        values, distances = (np.concatenate([getattr(part, name) for part in own]) for name in ("values", "distances"))
        outcomes.append(DrawOutcome(values, distances))
    return outcomes


@one_blas_thread
def run_chunk(task: DrawTask) -> DrawOutcome:
    """Run the draws of one task, one after another."""
    exact = measurements(task.robot, task.joints, task.truth, task.sets[0].chosen)
    start = fit(task.robot, exact, sigma=task.sigma or 1e-6).robot
    nearby = start.assemble(task.joints).passive
    calibrators = [Calibrator(task, pose_set, start, nearby) for pose_set in task.sets]
    values = np.empty((len(task.seeds), len(task.sets), len(task.robot.values)))
    distances = np.empty((len(task.seeds), len(task.sets), len(task.joints)))
    for d, seed in enumerate(task.seeds):
        noisy = task.noisy(seed)
        for s, calibrator in enumerate(calibrators):
            robot = calibrator.calibrate(noisy)
            values[d, s] = robot.values
            distances[d, s] = np.linalg.norm(calibrator.predict(robot) - task.truth, axis=1)
    return DrawOutcome(values, distances)


class Calibrator:
    """Calibrates from one set of poses, again and again.

    It starts from a robot identified from exact measurements, with its passive joints nearby, (n, n_passive) [m, rad].
    """

    def __init__(self, task: DrawTask, pose_set: PoseSet, start: Robot, nearby: FloatArray) -> None:
        self._chosen, self._joints, self._free = pose_set.chosen, task.joints, task.robot.is_free
        self._scales = task.robot.parameters.sigma_si[self._free]
        self._start, self._passive = start, nearby
        self._first = linearise(start, self._assemble(start, self._chosen))

    def calibrate(self, positions: FloatArray) -> Robot:
        """Return the robot identified from positions of all candidates, (n, 3) [m], of which only the set's are used.

        Raises:
            NotConvergedError: The steps do not become small.
        """
        robot, linear = self._start, self._first
        for _ in range(_MAX_STEPS):
            jacobian = linear.jacobian[:, 0][..., self._free].reshape(-1, len(self._scales)) * self._scales
            residual = (positions[self._chosen] - linear.positions[:, 0]).ravel()
            step = linalg.lstsq(jacobian, residual, rcond=None)
            values = robot.values.copy()
            values[self._free] += self._scales * step
            robot = robot.with_parameters(values)
            if np.linalg.norm(jacobian @ step) <= _SMALL_STEP * np.linalg.norm(residual):
                return robot
            linear = linearise(robot, self._assemble(robot, self._chosen))
        raise NotConvergedError(f"a simulated identification did not converge in {_MAX_STEPS} steps")

    def predict(self, robot: Robot) -> FloatArray:
        """Return the positions of the tool at all candidates, (n, 3) [m]."""
        return robot.positions(self._joints, seed=self._passive)[:, 0]

    def _assemble(self, robot: Robot, index: IntArray) -> Configurations:
        return robot.assemble(self._joints[index], self._passive[index])
