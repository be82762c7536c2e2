"""The experiment with today's methods: every pose from both sides, and a model of what was left out.

The simulated robots are those of `medrue.experiment`, draw by draw. Their rails also have the smaller errors of
`medrue.imperfections.RailErrors`; two of these errors are in no model. The tracker reads every pose twice: after the
rail came in the positive direction, and after it came in the negative one. Such readings of n poses, with the same
noise, identify

* the paper's model,
* the extended model (`urdf/medrue_extended.yaml`), which knows the direction of approach. For comparison, it is also
  identified from one direction alone, and from a random direction for each pose.

All of them are judged at the other poses, from both sides. Poses are chosen by O1 of the extended model at its nominal
parameters, which is all that is known before measuring; one set is the 84 poses of the paper's protocol.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from calib.core.base.arrays import FloatArray, IntArray
from calib.core.base.errors import NotIdentifiableError
from calib.core.base.threads import one_blas_thread
from calib.core.data.in_memory import as_measurements
from calib.core.data.measurements import Measurements
from calib.core.fitting.fit import fit_data
from calib.core.fitting.settings import Settings
from calib.core.robots.robot import Robot
from calib.core.robots.terms.term import Context
from calib.planning.selection import select
from medrue.draws import PoseSet, Work
from medrue.imperfections import Imperfections, RailErrors, from_direction, imperfect_robot
from medrue.paper_tables import table3
from medrue.tracker import REPEATS, SIGMA, measure

COUNTS = (10, 14, 21, 28, 42, 63, 84, 126)
"""Numbers of poses to identify with."""
QUICK_COUNTS = (28, 84)
SIDES = (1.0, -1.0)
"""Directions of approach."""


@dataclass(frozen=True)
class Way:
    """One way to calibrate.

    Attributes:
        name: Its name.
        extended: Whether with the extended model; else with the paper's.
        sides: Directions from which each pose is approached: both, the positive one, or either at random.
    """

    name: str
    extended: bool
    sides: Literal["both", "one", "either"]


PAPER = Way("paper's model, both sides", False, "both")
EXTENDED = Way("extended, both sides", True, "both")
WAYS = (PAPER, EXTENDED, Way("extended, either side", True, "either"), Way("extended, one side", True, "one"))


RAIL = RailErrors()
"""Smaller errors of the rail of every robot that is measured from both sides."""


@dataclass(frozen=True, eq=False)
class ExperimentTask:
    """One simulated robot to measure.

    Attributes:
        robot: Nominal MedRUE with the paper's parameters.
        extended: The extended model, nominal; the truth is made of it.
        joints: Poses, (n, 6) [m, rad].
        sets: Pose sets to identify with.
        imperfections: Sizes of what the paper's parameters leave out.
        seed: Seed of this draw.
    """

    robot: Robot
    extended: Robot
    joints: FloatArray
    sets: tuple[PoseSet, ...]
    imperfections: Imperfections
    seed: np.random.SeedSequence


@dataclass(frozen=True, eq=False)
class BothSidesDraw:
    """Results of calibrations of one simulated robot.

    Attributes:
        measured: Positions as read, by side and pose, (2, n, 3) [m].
        after: Errors, predicted minus measured, by way, set, side and pose, (n_ways, n_sets, 2, n, 3) [m]; NaN where
            the readings were too few for the model, or the fit did not converge.
        actual: True values of the extended model's parameters, (n_parameters,) [m, rad].
        values: Values that `EXTENDED` found from the first set, (n_parameters,) [m, rad]; NaN where it found none.
        std: Their standard deviations as the fit states them, (n_parameters,) [m, rad].
    """

    measured: FloatArray
    after: FloatArray
    actual: FloatArray
    values: FloatArray
    std: FloatArray


@dataclass(frozen=True, eq=False)
class BothSides:
    """Everything that the measurement from both sides found.

    Attributes:
        extended: The extended model, nominal.
        joints: Poses, (n, 6) [m, rad].
        sets: Pose sets: the paper's 84 of O1, then one for each number of poses, chosen by O1 of the extended model.
        draws: Simulated robots, those of the experiment.
    """

    extended: Robot
    joints: FloatArray
    sets: tuple[PoseSet, ...]
    draws: tuple[BothSidesDraw, ...]

    def errors(self, way: Way, s: int) -> FloatArray:
        """Return the errors at the poses that the set `s` leaves, (n_draws, n_rows, 3) [m]."""
        w = WAYS.index(way)
        others = self.sets[s].validation_indices(len(self.joints))
        return np.array([draw.after[w, s][:, others].reshape(-1, 3) for draw in self.draws])

    def first_measurements(self) -> Measurements:
        """Return the readings of the first robot at all poses, from both sides."""
        n = len(self.joints)
        side, pose = np.repeat(np.arange(len(SIDES)), n), np.tile(np.arange(n), len(SIDES))
        return measurements_of_visits(self.extended, self.joints, self.draws[0].measured, side, pose)


def run_both_sides(
    robot: Robot,
    extended: Robot,
    joints: FloatArray,
    first: PoseSet,
    counts: tuple[int, ...],
    imperfections: Imperfections,
    seeds: Sequence[np.random.SeedSequence],
    work: Work,
) -> BothSides:
    """Measure and calibrate the robots of the experiment's seeds from both sides.

    `joints` are the poses, (n, 6) [m, rad], of which the paper's set comes first, and then sets of these counts.
    """
    choose = partial(select, extended, joints, index="O1", sigma=SIGMA)
    chosen = work.results("choosing poses for the extended model", choose, counts)
    sets = (first, *(PoseSet(f"{len(s.chosen)}", np.sort(s.chosen)) for s in chosen))
    tasks = [ExperimentTask(robot, extended, joints, sets, imperfections, seed) for seed in seeds]
    draws = work.results("measurements from both sides", both_sides_draw, tasks)
    return BothSides(extended, joints, sets, tuple(draws))


@one_blas_thread
def both_sides_draw(task: ExperimentTask) -> BothSidesDraw:
    """Build one imperfect robot, measure it from both sides, and calibrate it in every way from every set of poses."""
    actual = task.robot.with_parameters(table3().identified)
    truth = imperfect_robot(
        task.extended, actual, task.imperfections, np.random.default_rng(task.seed), RAIL
    )  # the tilts are the first numbers of that generator, as in the experiment
    generator = np.random.default_rng(np.random.SeedSequence(task.seed.entropy, spawn_key=(*task.seed.spawn_key, 0)))
    n = len(task.joints)
    points = np.concatenate([truth.positions(task.joints, np.full(n, side)) for side in SIDES])
    measured = measure(points, generator).positions.reshape(len(SIDES), n, 3)
    either = generator.integers(len(SIDES), size=n)
    passive = task.robot.assemble(task.joints).passive
    after = np.full((len(WAYS), len(task.sets), *measured.shape), np.nan)
    values: FloatArray = np.full(len(task.extended.parameters), np.nan)
    std = values
    how = Settings(sigma=SIGMA / float(np.sqrt(REPEATS)))
    for w, way in enumerate(WAYS):
        model = task.extended if way.extended else task.robot
        for s, pose_set in enumerate(task.sets):
            data = measurements_of_visits(model, task.joints, measured, *_visits(way, pose_set, either))
            try:
                fit = fit_data(model, how, data)
            except NotIdentifiableError:  # too few readings for so many parameters
                continue
            if not fit.converged:
                continue
            after[w, s] = _predict(fit.robot, task.joints, passive) - measured
            if way == EXTENDED and s == 0:
                values, std = fit.robot.values, fit.statistics.std
    return BothSidesDraw(measured, after, truth.robot.values, values, std)


def measurements_of_visits(
    robot: Robot, joints: FloatArray, measured: FloatArray, side: IntArray, pose: IntArray
) -> Measurements:
    """Return visits as measurements; both sides of a pose have different names, so that errors are not averaged.

    Args:
        robot: The model that they are for.
        joints: Poses, (n, 6) [m, rad].
        measured: Positions as read, by side and pose, (2, n, 3) [m].
        side: Index into `SIDES` of each visit, (n_visits,).
        pose: Pose of each visit, (n_visits,).
    """
    names = [f"{k + 1}{'+-'[s]}" for s, k in zip(side, pose, strict=True)]
    data = as_measurements(robot, joints[pose], measured[side, pose], names)
    return replace(data, approach=from_direction(np.array(SIDES)[side]))


def _visits(way: Way, pose_set: PoseSet, either: IntArray) -> tuple[IntArray, IntArray]:
    """Sides and poses of the visits from which a way identifies, (n,) each."""
    pose = pose_set.chosen
    if way.sides == "both":
        return np.repeat(np.arange(len(SIDES)), len(pose)), np.tile(pose, len(SIDES))
    return (either[pose] if way.sides == "either" else np.zeros(len(pose), dtype=np.intp)), pose


def _predict(robot: Robot, joints: FloatArray, passive: FloatArray) -> FloatArray:
    """Positions of the tool from each side, (2, n, 3) [m], starting from the passive joints of the nominal robot."""
    if not robot.terms:
        return np.array([robot.positions(joints, seed=passive)[:, 0]] * len(SIDES))
    directions = [Context.from_conditions(from_direction(np.full(len(joints), side)), {}) for side in SIDES]
    return np.array([robot.positions(joints, direction, passive)[:, 0] for direction in directions])
