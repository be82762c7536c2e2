"""Predicted readings of a robot, compared with the readings, and their derivatives by parameters.

For a reading of kind g at a visit, with x the motion [dp; dw] of the observed frame, seen from the observing frame
(`calib.core.robots.jacobian`):

    d(residual)/d(parameters) = d(residual)/dx  .  dx/d(parameters)

The first factor is the kind's own; the second is the same for all kinds, loops included. Unknown numbers of the
instrument, and joints that it reads, enter directly.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from calib.core.base.arrays import FloatArray, IntArray, as_slice
from calib.core.data.measurements import Measurements, Poses, readings_of_visits, setup_pairs
from calib.core.instruments.kind import Comparison, Instrument, JointComparison, JointInstrument, Readings, View
from calib.core.robots import kinematics
from calib.core.robots.configurations import Configurations
from calib.core.robots.jacobian import (
    derivative_by_parameters,
    motion_twists,
    passive_motion,
    relative_motion,
    sweeps,
)
from calib.core.robots.robot import Robot


@dataclass(frozen=True, eq=False)
class Observed:
    """Readings of one instrument compared with predicted ones.

    Attributes:
        residuals: Predicted minus read, (n, n_rows) [SI]; NaN where a component was not read.
        by: Numbers of the parameters of `derivative`, which are no coefficients of joint terms, in rising order, (k,).
        derivative: Derivative of the residuals by these, then by the driven joints if requested, (n, n_rows,
            k + n_driven); (n, n_rows, 0) without derivatives.
        term_columns: phi of each joint term at each reading (`columns_of_terms`), (n, n_moved, n_coefficients) each.
    """

    robot: Robot
    residuals: FloatArray
    by: IntArray
    derivative: FloatArray
    term_columns: tuple[FloatArray, ...]

    def derivative_by(self, index: IntArray, out: FloatArray | None = None) -> FloatArray:
        """Return the derivatives by some parameters, in rising order (k,), (n, n_rows, k); not to be changed.

        They are coefficients of joint terms, or in `by`. New numbers are in `out`, if it is given.
        """
        return derivative_by_parameters(self.robot, self.derivative, self.by, self.term_columns, index, out)

    @property
    def jacobian(self) -> FloatArray:
        """Derivative by all parameters, (n, n_rows, n_parameters)."""
        return self.derivative_by(np.arange(len(self.robot.parameters)))

    @property
    def joint_derivative(self) -> FloatArray:
        """Derivative by the actuated joints, (n, n_rows, n_actuated); empty where not requested."""
        k = len(self.by)
        return self.derivative[:, :, k : k + len(self.robot.joint_names)]


def observe(
    robot: Robot,
    configurations: Configurations,
    readings: Mapping[str, Readings],
    *,
    joints: bool = False,
    derivatives: bool = True,
    by: IntArray | None = None,
) -> dict[str, Observed]:
    """Compare readings with those that the robot predicts.

    Args:
        readings: Readings of each instrument, by name; visits are indices into the configurations.
        joints: Whether to include derivatives by the actuated joints.
        by: Numbers of the parameters to take derivatives by, in rising order, (k,); all if not given.
    """
    mechanism, twists, first = robot.mechanism, motion_twists(robot, joints=joints), robot.coefficients.start
    by = np.arange(first) if by is None else by[by < first]
    if len(by) < first:
        twists = np.hstack([twists[:, by], twists[:, first:]])
    width = twists.shape[1] if derivatives else 0
    own = [instrument for instrument in robot.instruments if instrument.name in readings]
    works = [_Work(robot, instrument, readings[instrument.name], by, width) for instrument in own]
    pairs = tuple(dict.fromkeys(pair for work in works for pair in work.pairs))
    for part, swept in sweeps(mechanism, configurations, pairs):
        for work in works:
            work.fill(part, swept, configurations, twists)
    return {work.instrument.name: work.result(configurations) for work in works}


class _Work:
    """Fills the arrays of one instrument, chunk by chunk of visits."""

    def __init__(self, robot: Robot, instrument: Instrument, readings: Readings, by: IntArray, width: int) -> None:
        self.robot, self.instrument, self.readings, self._by = robot, instrument, readings, by
        self.all_pairs, self._unknowns = robot.pairs[instrument.name], robot.unknowns[instrument.name]
        self._numbers: list[int] = np.unique(readings.pairs).tolist()
        self.pairs = tuple(self.all_pairs[k] for k in self._numbers) if self.all_pairs else ()
        shape = len(readings.visits), instrument.n_rows
        first, last = by.searchsorted((self._unknowns.start, self._unknowns.stop)).tolist()
        self._own_columns, self._observed = slice(first, last), by[first:last] - self._unknowns.start
        self._residuals, self._columns = np.empty(shape), np.empty((*shape, width))  # each is filled once
        self._order = np.argsort(readings.visits, kind="stable")
        self._sorted = readings.visits[self._order]

    def fill(self, part: slice, swept: kinematics.Sweep, configurations: Configurations, twists: FloatArray) -> None:
        """Compare the readings of a chunk of visits."""
        first, last = np.searchsorted(self._sorted, [part.start, part.stop])
        index, visits = self._order[first:last], self.readings.visits - part.start
        if len(index) == 0:
            return
        if not isinstance(self.instrument, JointInstrument):
            self._fill_pairs(self._readings_of_pairs(index), visits, swept, twists)
            return
        mechanism, own = self.robot.mechanism, as_slice(index)
        joint = mechanism.origin_names.index(self.instrument.joint)
        joints = mechanism.all_joints(configurations.actuated[part], configurations.passive[part])
        comparison = self._compare(own, joints[visits[own], joint])
        assert isinstance(comparison, JointComparison)  # the kind reads a joint
        if self._columns.shape[2]:
            motion = passive_motion(mechanism, swept, mechanism.select_passive[joint], twists)
            if motion.shape[2] > len(self._by):
                motion[:, :, len(self._by) :] += mechanism.select_actuated[joint]
            self._fill_columns(own, comparison.by_joint[:, :, None] * motion[visits[own]], comparison.by_unknown)

    def _readings_of_pairs(self, index: IntArray) -> dict[int, IntArray | slice]:
        if len(self._numbers) == 1:
            return {self._numbers[0]: as_slice(index)}
        number = self.readings.pairs[index]
        return {k: as_slice(chosen) for k in self._numbers if len(chosen := index[number == k])}

    def _fill_pairs(
        self, chosen: dict[int, IntArray | slice], visits: IntArray, swept: kinematics.Sweep, twists: FloatArray
    ) -> None:
        pairs = tuple(self.all_pairs[k] for k in chosen)
        comparisons: list[Comparison] = []
        for pair, own in zip(pairs, chosen.values(), strict=True):
            rotation, position = kinematics.seen_frame(swept, pair.a, pair.b)
            comparison = self._compare(own, View(rotation[visits[own]], position[visits[own]]))
            assert isinstance(comparison, Comparison)  # the kind looks at frames
            comparisons.append(comparison)
        if not self._columns.shape[2]:
            return
        angular = any(np.any(comparison.by_twist[:, :, 3:]) for comparison in comparisons)
        motions = relative_motion(self.robot.mechanism, swept, pairs, twists, angular=angular)
        for k, (own, comparison) in enumerate(zip(chosen.values(), comparisons, strict=True)):
            motion, by_twist, at = motions[:, k], comparison.by_twist[:, :, : motions.shape[2]], visits[own]
            if len(at) != len(motion) or np.any(at != np.arange(len(at))):
                motion = motion[at]
            derivative = motion if _is_identity(by_twist) else np.matmul(by_twist, motion)
            self._fill_columns(own, derivative, comparison.by_unknown)

    def _fill_columns(self, chosen: IntArray | slice, derivative: FloatArray, by_unknown: FloatArray) -> None:
        self._columns[chosen] = derivative
        self._columns[chosen, :, self._own_columns] += by_unknown[:, :, self._observed]

    def _compare(self, chosen: IntArray | slice, seen: View | FloatArray) -> Comparison | JointComparison:
        every = isinstance(chosen, slice) and chosen == slice(0, len(self._sorted))
        readings = self.readings if every else self.readings.subset(chosen)
        comparison = self.instrument.compare(seen, self.robot.values[self._unknowns], readings)
        self._residuals[chosen] = comparison.residuals
        return comparison

    def result(self, configurations: Configurations) -> Observed:
        """Return the filled arrays."""
        phi = configurations.term_columns
        if phi:
            visits = as_slice(self.readings.visits)
            phi = tuple(columns[visits] for columns in phi)
        return Observed(self.robot, self._residuals, self._by, self._columns, phi)


def _is_identity(matrices: FloatArray) -> bool:
    return matrices.shape[1] == matrices.shape[2] and bool(np.all(matrices == np.eye(matrices.shape[1])))


def predict_readings(
    robot: Robot, configurations: Configurations, looks: Mapping[str, Readings] | None = None
) -> dict[str, Readings]:
    """Return the readings of instruments without noise.

    Args:
        looks: Visits, pairs and details of each instrument's readings; all that it can read at every visit, if not
            given.
    """
    if looks is None:
        n = len(configurations.actuated)
        looks = {instrument.name: _all_looks(instrument, n) for instrument in robot.instruments}
    result = {}
    for name, seen in views_of_instruments(robot, configurations, looks).items():
        readings = looks[name]
        values = robot.instrument(name).predict(seen, robot.values[robot.unknowns[name]], readings.details)
        result[name] = Readings(readings.visits, readings.pairs, values, None, readings.details)
    return result


def views_of_instruments(
    robot: Robot, configurations: Configurations, looks: Mapping[str, Readings]
) -> dict[str, View | FloatArray]:
    """Return the input of each instrument at each of its readings, by name: frames, or values of a joint (n,).

    Args:
        looks: Visits and pairs of each instrument's readings.
    """
    mechanism = robot.mechanism
    joints = mechanism.all_joints(configurations.actuated, configurations.passive)
    pairs = tuple(pair for name in looks for pair in robot.pairs[name])
    swept = kinematics.sweep(mechanism, joints, pairs, poses_only=True)
    result: dict[str, View | FloatArray] = {}
    for name, readings in looks.items():
        instrument = robot.instrument(name)
        if isinstance(instrument, JointInstrument):
            result[name] = joints[readings.visits, mechanism.origin_names.index(instrument.joint)]
            continue
        poses = np.tile(np.eye(4), (len(readings), 1, 1))
        for number, pair in enumerate(robot.pairs[instrument.name]):
            chosen = np.flatnonzero(readings.pairs == number)
            poses[chosen] = kinematics.relative_pose(swept, pair.a, pair.b)[readings.visits[chosen]]
        result[name] = View(poses[:, :3, :3], poses[:, :3, 3])
    return result


def planned_readings(robot: Robot, poses: Poses) -> dict[str, Readings]:
    """Return the planned readings of each instrument at poses, without values: all that it can unless the poses say.

    Measurements plan the touches that were made, because no pose shows by itself what it touches.
    """
    return {instrument.name: _looks_of(robot, instrument, poses) for instrument in robot.instruments}


def touches_without_target(robot: Robot, poses: Poses) -> list[Instrument]:
    """Return the touching instruments whose poses do not say what they touch."""
    planned = poses.planned.keys() | (poses.readings.keys() if isinstance(poses, Measurements) else set())
    return [instrument for instrument in robot.instruments if instrument.touches and instrument.name not in planned]


def _looks_of(robot: Robot, instrument: Instrument, poses: Poses) -> Readings:
    if instrument.name in poses.planned:
        return poses.planned[instrument.name]
    if isinstance(poses, Measurements) and instrument.touches:
        read = poses.readings.get(instrument.name)
        touches = _all_looks(instrument, 0) if read is None else readings_of_visits(read, np.arange(len(poses)))
        return Readings(touches.visits, touches.pairs, np.zeros((len(touches), 0)), None, touches.details)
    looks = _all_looks(instrument, len(poses))
    if poses.setups is None:
        return looks
    return replace(looks, pairs=looks.pairs + setup_pairs(robot, instrument, poses.setups)[looks.visits])


def _all_looks(instrument: Instrument, n: int) -> Readings:
    """All that an instrument can read, at each of n visits; no values."""
    pairs, details = instrument.looks()
    visits = np.repeat(np.arange(n), len(pairs))
    return Readings(visits, np.tile(pairs, n), np.zeros((len(visits), 0)), None, np.tile(details, (n, 1)))
