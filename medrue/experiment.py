"""The paper's experiment (its section 5) on a simulated robot: Tables III to V, Figures 3, 7 and 8.

The paper's measurements are not public, so everything here is simulated. The truth is a robot with the parameters that
the paper identified (Table III) plus what its model leaves out (`medrue.imperfections`). A simulated laser tracker
(`medrue.tracker`) finds the world from three nests and reads every pose five times. Then the paper's protocol: 84
poses chosen by each index identify 28 parameters, the 336 others validate. An error is the distance of the prediction
from the measured position, as in an experiment.

Beyond the paper: the same over many draws of the imperfections and the noise, and with each cause alone, which shows
where the remaining error comes from; and the same robots measured and modelled better (`medrue.both_sides`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.threads import one_blas_thread
from calib.core.fitting.fit import fit_data
from calib.core.fitting.settings import Settings
from calib.core.robots.robot import Robot
from medrue.both_sides import COUNTS, BothSides, ExperimentTask, run_both_sides
from medrue.draws import PoseSet, Work, measurements
from medrue.imperfections import Imperfections, approach_in_order, imperfect_robot
from medrue.paper_tables import table3
from medrue.poses import target_poses
from medrue.study import choose_sets
from medrue.tracker import REPEATS, SIGMA, measure

DRAWS = 20
"""Simulated experiments: robots with other imperfections and other noise."""
QUICK_DRAWS = 2


@dataclass(frozen=True, eq=False)
class ExperimentDraw:
    """Results of one simulated experiment; errors are predicted minus measured, in the world.

    Attributes:
        before: Errors of the nominal robot, (n, 3) [m].
        after: Errors of the robot calibrated from each set, (n_sets, n, 3) [m].
        values: Identified parameters, (n_sets, 36) [m, rad].
        std: Their standard deviations as the fit states them, 0 for held ones, (n_sets, 36) [m, rad].
        repeatability: Repeatability of the tracker's readings, per axis [m].
        frame_sigma: Largest standard deviation that the world frame's uncertainty gives to a coordinate [m].
        nest_outliers: Names of nests that do not fit.
    """

    before: FloatArray
    after: FloatArray
    values: FloatArray
    std: FloatArray
    repeatability: float
    frame_sigma: float
    nest_outliers: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Experiment:
    """Everything that the simulated experiment found.

    Attributes:
        robot: Nominal MedRUE.
        joints: Poses, (420, 6) [m, rad].
        sets: Pose sets, in the order of the axes `n_sets` of the draws.
        imperfections: Sizes of what the parameters leave out.
        draws: Simulated experiments; the first is the one that the tables show.
        causes: The same draws with one cause alone, from the set of O1, by name.
        both_sides: The same robots, measured from both sides and calibrated with the extended model too.
        seed: Seed of everything random.
    """

    robot: Robot
    joints: FloatArray
    sets: tuple[PoseSet, ...]
    imperfections: Imperfections
    draws: tuple[ExperimentDraw, ...]
    causes: Mapping[str, tuple[ExperimentDraw, ...]]
    both_sides: BothSides
    seed: int

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the pose sets."""
        return tuple(pose_set.name for pose_set in self.sets)

    def validation(self, draw: ExperimentDraw, name: str) -> tuple[FloatArray, FloatArray]:
        """Return the errors before and after at the poses that the set `name` leaves for validation, (336, 3) [m]."""
        s = self.names.index(name)
        others = self.sets[s].validation_indices(len(self.joints))
        return draw.before[others], draw.after[s, others]


def run_experiment(
    robot: Robot,
    extended: Robot,
    draws: int,
    seed: int,
    work: Work,
    imperfections: Imperfections,
    counts: tuple[int, ...] = COUNTS,
) -> Experiment:
    """Run the simulated experiment of MedRUE and the extended model, both with nominal parameters.

    So many draws are done with all causes and with each alone, and then from both sides, with these counts of poses.
    The same seed gives the same numbers.
    """
    joints = target_poses(robot).joints
    _, sets = choose_sets(robot, joints, work)
    seeds = np.random.SeedSequence(seed).spawn(draws)
    tasks = [ExperimentTask(robot, extended, joints, sets, imperfections, child) for child in seeds]
    for alone in imperfections.causes.values():
        tasks += [ExperimentTask(robot, extended, joints, sets[:1], alone, child) for child in seeds]
    drawn = work.results("simulated experiments", experiment_draw, tasks)
    causes = {name: tuple(drawn[k * draws : (k + 1) * draws]) for k, name in enumerate(imperfections.causes, start=1)}
    both_sides = run_both_sides(robot, extended, joints, sets[0], counts, imperfections, seeds, work)
    return Experiment(robot, joints, sets, imperfections, tuple(drawn[:draws]), causes, both_sides, seed)


@one_blas_thread
def experiment_draw(task: ExperimentTask) -> ExperimentDraw:
    """Build one imperfect robot, measure it, and calibrate from every set of poses."""
    generator = np.random.default_rng(task.seed)
    actual = task.robot.with_parameters(table3().identified)
    truth = imperfect_robot(task.extended, actual, task.imperfections, generator)
    order = generator.permutation(len(task.joints))
    approach = approach_in_order(task.joints[:, 0], order, float(task.robot.home[0]))
    readings = measure(truth.positions(task.joints, approach), generator)
    after, values, std = [], [], []
    for pose_set in task.sets:
        data = measurements(task.robot, task.joints, readings.positions, pose_set.chosen)
        how = Settings(sigma=SIGMA / float(np.sqrt(REPEATS)))
        result = fit_data(task.robot, how, data)
        after.append(result.robot.positions(task.joints)[:, 0] - readings.positions)
        values.append(result.robot.values)
        spread = np.zeros(len(result.robot.values))
        spread[task.robot.is_free] = result.statistics.std
        std.append(spread)
    before = task.robot.positions(task.joints)[:, 0] - readings.positions
    return ExperimentDraw(
        before,
        np.array(after),
        np.array(values),
        np.array(std),
        readings.repeatability,
        readings.frame_sigma,
        readings.nest_outliers,
    )
