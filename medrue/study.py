"""The paper's simulation study (its section 4): Tables I and II, Figures 4 and 5, and how certain their conclusion is.

Protocol, as the paper's: 420 candidate poses; for each index, 84 of them to identify with and the 336 others to
validate; measurements simulated with the actual parameters of Table I and normal noise, sigma 40 um on each axis; 28
parameters identified, the 8 redundant ones nominal. An error is the distance of the calibrated robot's prediction from
the true position, without noise.

The paper has one draw. Here the same is done over many draws of the noise (paired: every set of poses sees the same
noise), and over many draws of the actual parameters (uniform within +-2 mm and +-1.5 deg, as the paper's). It is also
compared with the theoretical limit: with J_v the Jacobian at a validation pose and C = sigma^2 (J^T J)^-1, no unbiased
estimate has a smaller mean squared error than trace(J_v C J_v^T) (Cramer-Rao). Least squares reaches it as far as the
problem is linear.

Everything here is simulated. The truth comes from the closed form, predictions from the calibrated model.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from calib import Fit, fit
from calib.core.base.arrays import FloatArray
from calib.core.robots.jacobian import linearise
from calib.core.robots.robot import Robot
from calib.planning.selection import Selection, select
from medrue.closed_form import forward
from medrue.draws import DrawOutcome, DrawTask, PoseSet, Work, measurements, run
from medrue.paper_tables import PARAMETERS, table1
from medrue.poses import target_poses

INDICES = ("O1", "O2", "O3", "O4", "O5", "task")
COUNT = 84
"""Poses to identify with."""
SIGMA = 4e-5
"""Measurement noise on each axis: the paper's +-120 um are three standard deviations [m]."""
STATISTICS = ("mean", "max", "std")
"""Statistics of errors in Tables II, IV and V, in the order of `summary`."""


@dataclass(frozen=True)
class StudySize:
    """How much to simulate.

    Attributes:
        noise_draws: Draws of the noise on the actual parameters of Table I.
        actual_draws: Draws of the actual parameters.
        noise_per_actual: Draws of the noise on each of these.
    """

    noise_draws: int = 200
    actual_draws: int = 20
    noise_per_actual: int = 10


QUICK = StudySize(noise_draws=10, actual_draws=2, noise_per_actual=2)


@dataclass(frozen=True, eq=False)
class PaperStudy:
    """Everything that the study found.

    Attributes:
        robot: Nominal MedRUE.
        joints: The 420 candidate poses, (420, 6) [m, rad].
        truth: True positions of the tool there, (420, 3) [m].
        selections: Choice of poses by index.
        sets: The pose sets, in the order of every axis below: INDICES, then `uniform`.
        exact: Fit of the set of O1 to measurements without noise.
        single: Fit of the set of O1 to the first draw of the noise.
        outcome: All draws of the noise on Table I's actual parameters.
        by_actual: The same on drawn actual parameters, one outcome for each.
        floors: Root-mean-square error over the validation poses that theory allows, (n_sets,) [m].
        seed: Seed of everything random.
        size: How much was simulated.
    """

    robot: Robot
    joints: FloatArray
    truth: FloatArray
    selections: dict[str, Selection]
    sets: tuple[PoseSet, ...]
    exact: Fit
    single: Fit
    outcome: DrawOutcome
    by_actual: tuple[DrawOutcome, ...]
    floors: FloatArray
    seed: int
    size: StudySize

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the pose sets."""
        return tuple(pose_set.name for pose_set in self.sets)

    def validation_errors(self, outcome: DrawOutcome) -> FloatArray:
        """Return mean, max, std and RMS of the distances over each set's validation poses, (n_draws, n_sets, 4) [m]."""
        summaries = []
        for s, pose_set in enumerate(self.sets):
            summaries.append(summary(outcome.distances[:, s, pose_set.validation_indices(len(self.joints))]))
        return np.stack(summaries, axis=1)

    def nominal_errors(self) -> FloatArray:
        """Return mean, max, std and RMS of the nominal robot's errors at O1's validation poses, (4,) [m]."""
        errors = np.linalg.norm(self.robot.positions(self.joints)[:, 0] - self.truth, axis=1)
        return summary(errors[None, self.sets[0].validation_indices(len(self.joints))])[0]


def run_study(robot: Robot, size: StudySize, seed: int, work: Work) -> PaperStudy:
    """Run the study of MedRUE with nominal parameters; the same seed gives the same numbers."""
    joints = target_poses(robot).joints
    truth = true_positions(joints, table1().actual)
    selections, sets = choose_sets(robot, joints, work)
    noise_seeds, actual_seeds = np.random.SeedSequence(seed).spawn(2)
    main = DrawTask(robot, joints, truth, sets, SIGMA, tuple(noise_seeds.spawn(size.noise_draws)))
    tasks = [main, *_tasks_of_other_robots(robot, joints, sets, actual_seeds, size)]
    outcomes = run(tasks, work)
    chosen = sets[0].chosen
    others = measurements(robot, joints, truth, sets[0].validation_indices(len(joints)))
    exact = fit(robot, measurements(robot, joints, truth, chosen), validation=others, sigma=SIGMA)
    single = fit(robot, measurements(robot, joints, main.noisy(main.seeds[0]), chosen), validation=others, sigma=SIGMA)
    floors = error_floors(exact.robot, joints, sets, SIGMA)
    return PaperStudy(
        robot, joints, truth, selections, sets, exact, single, outcomes[0], tuple(outcomes[1:]), floors, seed, size
    )


def true_positions(joints: FloatArray, parameters: FloatArray) -> FloatArray:
    """Positions of the tool by the closed form, (n, 3) [m], from joints (n, 6) and parameters (36,) [m, rad].

    Raises:
        ValueError: A pose does not close with these parameters.
    """
    closed = forward(joints, parameters)
    if not closed.closes.all():
        raise ValueError("with these parameters, the loops do not close at every pose of the target workspace")
    return np.array(closed.p_world_tool)


def choose_sets(robot: Robot, joints: FloatArray, work: Work) -> tuple[dict[str, Selection], tuple[PoseSet, ...]]:
    """Choose 84 poses by every index, and 84 uniformly, out of candidates (n, 6) [m, rad].

    The nominal robot is all that is known before measuring.
    """
    choose = partial(select, robot, joints, COUNT, sigma=SIGMA)
    selections = dict(zip(INDICES, work.results("choosing poses", choose, INDICES), strict=True))
    sets = [PoseSet(index, np.sort(selection.chosen)) for index, selection in selections.items()]
    spacing = len(joints) // COUNT
    return selections, (*sets, PoseSet("uniform", np.arange(COUNT) * spacing + spacing // 2))


def summary(distances: FloatArray) -> FloatArray:
    """Mean, max, standard deviation and root mean square along the last axis, (..., n) -> (..., 4)."""
    squares = np.sqrt(np.mean(distances**2, axis=-1))
    parts = (distances.mean(axis=-1), distances.max(axis=-1), distances.std(axis=-1, ddof=1), squares)
    return np.stack(parts, axis=-1)


def error_floors(robot: Robot, joints: FloatArray, sets: tuple[PoseSet, ...], sigma: float) -> FloatArray:
    """Root-mean-square position error over each set's validation poses that theory allows, (n_sets,) [m]."""
    jacobian = linearise(robot, robot.assemble(joints)).jacobian[:, 0][..., robot.is_free]
    jacobian = jacobian * robot.parameters.sigma_si[robot.is_free]
    floors = []
    for pose_set in sets:
        used = jacobian[pose_set.chosen].reshape(-1, jacobian.shape[2])
        seen = jacobian[pose_set.validation_indices(len(joints))]
        half = np.linalg.solve(np.linalg.cholesky(used.T @ used), seen.reshape(-1, jacobian.shape[2]).T)
        floors.append(sigma * np.sqrt(np.sum(half**2) / len(seen)))
    return np.array(floors)


def draw_parameters(robot: Robot, seed: np.random.SeedSequence) -> FloatArray:
    """Actual parameters drawn as the paper's, within +-2 mm and +-1.5 deg, the held ones nominal, (36,) [m, rad]."""
    draws = np.random.default_rng(seed).uniform(-1.0, 1.0, len(PARAMETERS))
    return np.asarray(table1().nominal + table1().reach * robot.is_free * draws)


def _tasks_of_other_robots(
    robot: Robot, joints: FloatArray, sets: tuple[PoseSet, ...], seeds: np.random.SeedSequence, size: StudySize
) -> list[DrawTask]:
    """Draws of the noise on other robots."""
    tasks = []
    for child in seeds.spawn(size.actual_draws):
        robot_seed, noise = child.spawn(2)
        draws = tuple(noise.spawn(size.noise_per_actual))
        tasks.append(
            DrawTask(robot, joints, true_positions(joints, draw_parameters(robot, robot_seed)), sets, SIGMA, draws)
        )
    return tasks
