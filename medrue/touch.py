"""MedRUE calibrated without a tracker: by touch, and by encoders on its passive joints, compared with the tracker.

The paper's authors later calibrated MedRUE in simulation by touch alone, with a force-torque sensor. Here it is done in
kind: their way of touching, their noise and their poses are others. All methods (`medrue.touch_methods`) measure 84
poses, chosen by the smallest error that they predict over the 420 poses of the target workspace. All are judged as in
the study's Table II, but at all 420 poses: the distance of the calibrated robot's prediction from the true position.

Two questions are kept apart. `world`: how far the prediction is off in the world. `shape`: how far it is off after the
best rigid motion of all predictions onto the true positions; a method that does not see where the base stands can know
only this.

Parameters that a method cannot see stay near nominal, because priors expect them within their sigmas (2 mm and 1.5
deg). Tracker and touched sockets of the world need no such help: the paper's eight redundant parameters are held.

Everything is simulated: the paper's robot (Table I) with many draws of the noise, and other robots, drawn as the
paper's.

Reference: joubair2016.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import NotIdentifiableError
from calib.core.base.threads import one_blas_thread
from calib.core.fitting.fit import fit_data
from calib.core.fitting.settings import Settings
from calib.core.robots.robot import Robot
from calib.planning.assessment import Assessment, check
from calib.planning.selection import Selection, select
from medrue.draws import Work
from medrue.error_before import base_placed
from medrue.paper_tables import PARAMETERS, TOOL_POINT, table1
from medrue.poses import target_poses
from medrue.study import COUNT, SIGMA, StudySize, draw_parameters, true_positions
from medrue.touch_methods import (
    ARTEFACT,
    Artefact,
    EncoderMethod,
    Method,
    Touches,
    TouchMethod,
    TrackerMethod,
    encoder_robot,
    possible_touches,
    touching_robot,
)

SIZE = StudySize(noise_draws=50, actual_draws=20, noise_per_actual=2)
QUICK = StudySize(noise_draws=4, actual_draws=2, noise_per_actual=1)
BEFORE = "before"
TOOL_KNOWN = "encoders, tool known"
"""Encoders, and the true place of the tool on the probe: encoders do not see it, a bench can measure it."""
WAYS = ("world", "shape")
"""Ways to compare predictions with the truth; see the module docstring."""
ARTEFACTS = (
    ARTEFACT,
    Artefact((-np.radians(70.0), np.radians(70.0)), (1 / 8, 7 / 8)),
    Artefact((-np.radians(45.0), 0.0, np.radians(45.0)), (1 / 4, 1 / 2, 3 / 4)),
    Artefact((-np.radians(30.0), 0.0, np.radians(30.0)), (3 / 8, 1 / 2, 5 / 8)),
    Artefact((0.0,), (1 / 2,)),
)
"""Artefacts to compare by theory: all but the first are smaller or have fewer sockets."""


@dataclass(frozen=True, eq=False)
class TouchTask:
    """One robot that every method measures once.

    Attributes:
        methods: Ways to measure; the encoders last.
        joints: Poses to judge at, (n, 6) [m, rad].
        actual: The robot's parameters, (36,) [m, rad].
        seed: Seed of noise and unknown places.
    """

    methods: tuple[Method, ...]
    joints: FloatArray
    actual: FloatArray
    seed: np.random.SeedSequence


@dataclass(frozen=True, eq=False)
class TouchStudy:
    """Everything that was found.

    Attributes:
        methods: Ways to measure.
        selections: How the poses of each were chosen, by name.
        artefacts: Root-mean-square error predicted over the 420 poses for the best touches of each of `ARTEFACTS` [m];
            infinite where they do not determine the positions.
        seen: Assessment of the first measurements of each, by name.
        noise: Distances on Table I's robot, (n_draws, n_names, 2, 420) [m]: of `names`, in `WAYS`.
        by_actual: The same on other robots, (n_robots, n_draws, n_names, 2, 420) [m].
        seed: Seed of everything random.
    """

    methods: tuple[Method, ...]
    selections: Mapping[str, Selection]
    artefacts: Mapping[Artefact, float]
    seen: Mapping[str, Assessment]
    noise: FloatArray
    by_actual: FloatArray
    seed: int

    @property
    def names(self) -> tuple[str, ...]:
        """`BEFORE`, the methods and `TOOL_KNOWN`, in the order of the distances."""
        return (BEFORE, *(method.name for method in self.methods), TOOL_KNOWN)


def run_touch(robot: Robot, size: StudySize, seed: int, work: Work) -> TouchStudy:
    """Calibrate simulated robots in every way, from nominal parameters; the same seed gives the same numbers."""
    joints = target_poses(robot).joints
    methods, selections = choose_methods(robot, joints)
    errors = work.results("choosing poses", partial(predicted_error, robot, joints), ARTEFACTS[1:])
    artefacts = dict(zip(ARTEFACTS, [selections["touch"].after["task"], *errors], strict=True))
    noise_seeds, actual_seeds = np.random.SeedSequence(seed).spawn(2)
    tasks = [
        TouchTask(methods, joints, table1().actual, noise_seed) for noise_seed in noise_seeds.spawn(size.noise_draws)
    ]
    for child in actual_seeds.spawn(size.actual_draws):
        robot_seed, noise = child.spawn(2)
        actual = draw_parameters(robot, robot_seed)
        tasks += [TouchTask(methods, joints, actual, noise_seed) for noise_seed in noise.spawn(size.noise_per_actual)]
    drawn = work.results("simulated calibrations", touch_draw, tasks)
    first, others = np.array(drawn[: size.noise_draws]), np.array(drawn[size.noise_draws :])
    by_actual = others.reshape(size.actual_draws, size.noise_per_actual, *others.shape[1:])
    seen = {method.name: _assess_method(method) for method in methods}
    return TouchStudy(methods, selections, artefacts, seen, first, by_actual, seed)


def choose_methods(robot: Robot, joints: FloatArray) -> tuple[tuple[Method, ...], dict[str, Selection]]:
    """Return all methods, each with the poses of the smallest predicted errors at `joints`, (n, 6) [m, rad]."""
    possible, encoders = possible_touches(ARTEFACT), encoder_robot()
    positions = select(robot, joints, COUNT, "task", sigma=SIGMA)
    touched = best_touches(robot, joints, possible)
    read = select(encoders, joints, COUNT, "task")
    touches = possible.some(touched.chosen)
    methods: tuple[Method, ...] = (
        TrackerMethod("tracker", robot, joints[positions.chosen]),
        TouchMethod("touch", touching_robot(anywhere=False), touches, anywhere=False),
        TouchMethod("touch, artefact anywhere", touching_robot(anywhere=True), touches, anywhere=True),
        EncoderMethod("encoders", encoders, joints[read.chosen]),
    )
    chosen = (positions, touched, touched, read)
    return methods, {method.name: selection for method, selection in zip(methods, chosen, strict=True)}


def best_touches(robot: Robot, joints: FloatArray, possible: Touches) -> Selection:
    """Choose the touches with the smallest predicted errors at `joints`, (n, 6) [m, rad].

    The error of a touch of a socket in a known place changes with the parameters as the position there does, so that
    touches are chosen as positions are.

    Raises:
        NotIdentifiableError: No touches determine the positions.
    """
    return select(robot, possible.joints, COUNT, "task", task=joints, sigma=SIGMA)


def predicted_error(robot: Robot, joints: FloatArray, artefact: Artefact) -> float:
    """Root-mean-square error at `joints` (n, 6) [m, rad] predicted for the best touches, or infinite [m]."""
    try:
        return best_touches(robot, joints, possible_touches(artefact)).after["task"]
    except NotIdentifiableError:
        return float("inf")


@one_blas_thread
def touch_draw(task: TouchTask) -> FloatArray:
    """Return the distances of one robot before, after each method, and after the last with the tool known.

    Returns:
        (2 + n_methods, 2, n) [m].
    """
    generator = np.random.default_rng(task.seed)
    truth = true_positions(task.joints, task.actual)
    calibrated = task.methods[0].robot
    distances = [_errors_of_fit(calibrated, task.joints, truth)]
    for method in task.methods:
        data = method.measured(task.actual, generator)
        how = Settings(sigma=SIGMA if isinstance(method, TrackerMethod) else None)
        calibrated = fit_data(method.robot, how, data).robot
        distances.append(_errors_of_fit(calibrated, task.joints, truth))
    tool = {name: float(task.actual[PARAMETERS.index(name)]) for name in TOOL_POINT}
    return np.array([*distances, _errors_of_fit(calibrated.with_parameters(tool), task.joints, truth)])


def _errors_of_fit(robot: Robot, joints: FloatArray, truth: FloatArray) -> FloatArray:
    """Distances from the true positions (n, 3) [m] in the world, and after the best rigid motion, (2, n) [m]."""
    predicted = robot.positions(joints)[:, 0]
    return np.linalg.norm([predicted - truth, base_placed(predicted, truth)], axis=2)


def _assess_method(method: Method) -> Assessment:
    """Parameters that the readings of a method determine, at nominal values."""
    data = method.measured(table1().nominal, np.random.default_rng(0))
    return check(method.robot, data)
