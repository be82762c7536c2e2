"""Measurements: the visits of a robot to its poses, and what each instrument read there.

A visit is one row: joint values, and what else is known of that moment (context). Rows with one pose name repeat that
pose; nothing is averaged. An instrument may have read nothing at a visit, and several may have read at one.

Poses and measurements that are already in memory, checked as those of a file are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from calib.arrays import FloatArray, IntArray, ReadOnlyArrays
from calib.errors import DataError, nearest
from calib.joint_terms.term import Context
from calib.model.robot import Robot
from calib.observation.kind import Instrument, Readings
from calib.observation.position import Position
from calib.units import DISPLAY_UNIT, PER_SI, Dimension

CONTEXT: dict[str, Dimension] = {"time": "time", "temperature": "temperature", "load": "mass"}
"""Columns that say under which conditions a visit was made, and what they measure."""
_JOINTS_AGREE: dict[Dimension, float] = {"length": 1e-3, "angle": 2e-3}
"""Largest spread of a joint among repeats of one pose [m, rad]; more means that they are different poses."""
_MOVED = 1e-4  # change of a joint between two rows that counts as motion [m, rad]
_SOURCE = "arrays"


@dataclass(frozen=True, eq=False)
class Poses(ReadOnlyArrays):
    """Joint values of a list of visits.

    Attributes:
        joints: Actuated joints in the robot's order, (n, n_actuated) [m or rad].
        labels: What to call each in messages: file, line and pose name.
        names: The pose names of the file, or their running number; rows of one name repeat one pose.
        path: Where they came from.
        ignored: Columns of the file that nothing was read from.
        comments: What the file says about itself, line by line.
        context: Conditions of each visit, (n,) [SI] by name, of `CONTEXT`; NaN where not known.
    """

    joints: FloatArray
    labels: tuple[str, ...]
    names: tuple[str, ...]
    path: str
    ignored: tuple[str, ...]
    comments: tuple[str, ...] = field(default=(), kw_only=True)
    context: Mapping[str, FloatArray] = field(default_factory=dict, kw_only=True)

    def __len__(self) -> int:
        return len(self.joints)

    @cached_property
    def pose_numbers(self) -> IntArray:
        """A number for each visit, the same for those of one pose name, counted as they first appear, (n,)."""
        numbers: dict[str, int] = {}
        return np.array([numbers.setdefault(name, len(numbers)) for name in self.names], dtype=np.intp)

    @property
    def n_poses(self) -> int:
        """Number of different poses."""
        return int(self.pose_numbers.max(initial=-1)) + 1


@dataclass(frozen=True, eq=False)
class Measurements(Poses):
    """Visits with what was read.

    Attributes:
        readings: Of each instrument, by its name; visits are indices into the rows.
        approach: Direction in which each joint moved last before the visit, +1 or -1, 0 where not known,
            (n, n_actuated). If not given: from the order of the rows.
        order: Place of each visit in the order of measurement, counted from 0, (n,). If not given: as they stand.
    """

    readings: Mapping[str, Readings]
    approach: FloatArray | None = None
    order: IntArray | None = None

    @property
    def n_readings(self) -> int:
        """Number of readings of all instruments."""
        return sum(len(found) for found in self.readings.values())

    @property
    def approach_directions(self) -> FloatArray:
        """`approach`, from the order of the rows where it is not given, (n, n_actuated)."""
        return directions_of_motion(self.joints) if self.approach is None else self.approach

    @property
    def conditions(self) -> Context:
        """Under which conditions the robot was commanded, for its joint terms."""
        return Context.of(self.approach_directions, self.context)

    @property
    def places(self) -> IntArray:
        """`order`, the rows as they stand where it is not given, (n,)."""
        return np.arange(len(self)) if self.order is None else self.order

    def subset(self, index: IntArray) -> Measurements:
        """Return the visits with these indices (n,), in this order, with their readings."""
        index = np.asarray(index, dtype=np.intp)
        return replace(
            self,
            order=self.places[index],
            approach=self.approach_directions[index],
            joints=self.joints[index],
            labels=tuple(self.labels[i] for i in index),
            names=tuple(self.names[i] for i in index),
            context={key: values[index] for key, values in self.context.items()},
            readings={name: _of_visits(found, index) for name, found in self.readings.items()},
        )

    def points(self, robot: Robot) -> FloatArray:
        """Return where each target was seen in the measurement frame, (n, n_targets, 3) [m]; NaN where it was not.

        Only instruments that measure points say so; of several readings of a target at a visit, the mean.
        """
        total = np.zeros((len(self), len(robot.target_names), 3))
        count = np.zeros((len(self), len(robot.target_names), 1))
        for one in robot.instruments:
            found = self.readings.get(one.name)
            seen = None if found is None else one.points(found.values)
            if found is None or seen is None:
                continue
            t = robot.target_names.index(one.target)
            np.add.at(total[:, t], found.visits, seen)
            np.add.at(count[:, t], found.visits, 1.0)
        with np.errstate(invalid="ignore"):
            result: FloatArray = total / count
        return result


def with_points(robot: Robot, data: Measurements, points: FloatArray) -> Measurements:
    """Return measurements in which instruments that measure points saw these, (n, n_targets, 3) [m]."""
    readings = dict(data.readings)
    for name, found in data.readings.items():
        one = robot.instrument(name)
        seen = one.points(found.values)
        if seen is not None:
            change = np.zeros((len(found), one.n_rows))
            change[:, :3] = points[found.visits, robot.target_names.index(one.target)] - seen
            readings[name] = replace(found, values=one.moved(found.values, change))
    return replace(data, readings=readings)


def _of_visits(found: Readings, index: IntArray) -> Readings:
    """The readings of the visits with these indices, in this order; a visit may come twice."""
    order = np.argsort(found.visits, kind="stable")
    first, last = (np.searchsorted(found.visits[order], index, side=side) for side in ("left", "right"))
    counts = last - first
    kept = order[np.repeat(first - np.cumsum(counts) + counts, counts) + np.arange(int(counts.sum()))]
    return Readings(
        np.repeat(np.arange(len(index)), counts),
        found.pairs[kept],
        found.values[kept],
        None if found.covariance is None else found.covariance[kept],
        found.details[kept],
    )


def directions_of_motion(joints: FloatArray) -> FloatArray:
    """Return the direction in which each joint moved last before each pose: +1, -1, or 0 before its first motion.

    A joint that stands still keeps its direction: that is what backlash depends on.

    Args:
        joints: Joint values in the order of measurement, (n_poses, n_actuated) [m or rad].
    """
    steps = np.diff(joints, axis=0, prepend=joints[:1])
    direction = np.where(np.abs(steps) > _MOVED, np.sign(steps), 0.0)
    rows = np.where(direction != 0, np.arange(len(joints))[:, None], 0)
    last_moved = np.maximum.accumulate(rows, axis=0)
    result: FloatArray = np.take_along_axis(direction, last_moved, axis=0)
    return result


def check_repeats(poses: Poses, robot: Robot) -> None:
    """Raise `DataError` where rows of one pose name have different joint values."""
    limits = np.array([_JOINTS_AGREE[robot.mechanism.dimensions[joint]] for joint in robot.joint_names])
    order = np.argsort(poses.pose_numbers, kind="stable")
    starts = np.flatnonzero(np.diff(poses.pose_numbers[order], prepend=-1))
    spread = np.maximum.reduceat(poses.joints[order], starts) - np.minimum.reduceat(poses.joints[order], starts)
    bad = np.argwhere(spread > limits)
    if len(bad):
        pose = int(bad[0][0])
        joint = int(np.argmax(spread[pose] / limits))
        row = int(order[starts[pose]])
        dimension = robot.mechanism.dimensions[robot.joint_names[joint]]
        unit = DISPLAY_UNIT[dimension]
        raise DataError(
            f"{poses.labels[row]}: joint '{robot.joint_names[joint]}' differs by"
            f" {spread[pose, joint] * PER_SI[dimension][unit]:.3g} {unit} among the rows of pose"
            f" '{poses.names[row]}'; rows with the same pose value must repeat one pose"
        )


def as_poses(robot: Robot, poses: Poses | ArrayLike, names: Sequence[str] | None = None) -> Poses:
    """Return joint values as `Poses`, naming them by their row where they come without names.

    Args:
        robot: Whose joints they are.
        poses: Poses with names, or actuated joints alone, (n_poses, n_actuated) [m or rad].
        names: Pose names of joint values, n_poses of them.

    Raises:
        DataError: Wrong shape, values that are not finite, or a wrong number of names.
    """
    if isinstance(poses, Poses):
        return poses
    joints = robot.joint_vector(poses)
    if names is not None and len(names) != len(joints):
        raise DataError(f"names: {len(names)} for {len(joints)} poses; give one for each")
    called = tuple(str(k) for k in range(len(joints))) if names is None else tuple(str(name) for name in names)
    return Poses(joints, tuple(f"pose {name}" for name in called), called, _SOURCE, ())


def as_measurements(
    robot: Robot,
    poses: Poses | ArrayLike,
    readings: ArrayLike | Mapping[str, ArrayLike | Readings],
    names: Sequence[str] | None = None,
) -> Measurements:
    """Return what was read as `Measurements`; rows with the same pose name repeat that pose.

    Args:
        robot: Whose joints and instruments they are.
        poses: Poses with names, or actuated joints alone, (n, n_actuated) [m or rad].
        readings: What each instrument read, by its name, a row for each pose, (n, n_values) [SI], NaN where it read
            nothing; or `Readings`, where an instrument reads several things at a pose; of an instrument that reads no
            numbers: words, as in its column of a file, empty where it read nothing. Where all instruments measure
            positions: these, (n, n_targets, 3), or (n, 3) for one [m].
        names: Pose name of each row; without names, every row is a pose of its own.

    Raises:
        DataError: Wrong shape, values that are not finite, an unknown instrument, or rows of one pose whose joint
            values differ.
    """
    where = as_poses(robot, poses, names)
    if not isinstance(readings, Mapping):
        readings = _positions_by_instrument(robot, len(where), readings)
    found: dict[str, Readings] = {}
    for name, given in readings.items():
        if name not in [one.name for one in robot.instruments]:
            raise DataError(f"no instrument '{name}'{nearest(name, [one.name for one in robot.instruments])}")
        one = robot.instrument(name)
        if isinstance(given, Readings):
            found[name] = given
            continue
        if not one.columns():
            found[name] = _words(one, where, np.asarray(given))
            continue
        found[name] = _readings(one, where, np.asarray(given, dtype=float))
    data = measurements(where, found)
    check_repeats(data, robot)
    return data


def measurements(poses: Poses, readings: Mapping[str, Readings]) -> Measurements:
    """Put poses and readings together."""
    return Measurements(
        poses.joints,
        poses.labels,
        poses.names,
        poses.path,
        poses.ignored,
        readings,
        comments=poses.comments,
        context=poses.context,
    )


def plain_readings(values: FloatArray) -> Readings:
    """Return values (n, n_values) of n visits in a row as readings, without those that are NaN throughout."""
    seen = np.flatnonzero(~np.all(np.isnan(values), axis=1))
    return Readings(seen, np.zeros(len(seen), dtype=np.intp), values[seen], None, np.zeros((len(seen), 0)))


def _positions_by_instrument(robot: Robot, n: int, given: ArrayLike) -> dict[str, FloatArray]:
    if not all(isinstance(one, Position) for one in robot.instruments):
        names = ", ".join(one.name for one in robot.instruments)
        raise DataError(f"readings: the robot has several kinds of instruments; give them by name ({names})")
    values = np.asarray(given, dtype=float)
    n_instruments = len(robot.instruments)
    if n_instruments == 1 and values.shape == (n, 3):
        values = values[:, None]
    if values.shape != (n, n_instruments, 3):
        raise DataError(
            f"positions of shape {np.shape(given)}; expected ({n}, {n_instruments}, 3): a row for each pose,"
            f" the targets in the order {', '.join(one.name for one in robot.instruments)}"
        )
    return {one.name: values[:, k] for k, one in enumerate(robot.instruments)}


def _words(one: Instrument, poses: Poses, given: ArrayLike) -> Readings:
    """Readings of an instrument that says in one column of words what it looked at, and reads no numbers."""
    texts = [str(text).strip() for text in np.atleast_1d(np.asarray(given))]
    if np.shape(given) != (len(poses),) or not all(isinstance(text, str) for text in np.asarray(given, dtype=object)):
        raise DataError(f"{one.name}: expected {len(poses)} words, one for each pose; empty where it read nothing")
    (column,) = one.text_columns()
    own, pairs, details = one.looked_at({column: texts}, poses.labels)
    seen = np.flatnonzero(own)
    return Readings(seen, pairs[seen], np.repeat(one.values({}), len(seen), axis=0), None, details[seen])


def _readings(one: Instrument, poses: Poses, values: FloatArray) -> Readings:
    if one.looks()[1].shape[1]:
        raise DataError(f"{one.name}: an array does not say what each reading is about; give Readings with its details")
    width = one.values({column.name: np.zeros(0) for column in one.columns()}).shape[1]
    if values.shape != (len(poses), width):
        raise DataError(f"{one.name}: readings of shape {values.shape}; expected ({len(poses)}, {width})")
    whole = np.all(np.isnan(values), axis=1)
    bad = np.flatnonzero(~np.isfinite(values).all(axis=1) & ~whole)
    if len(bad):
        raise DataError(
            f"{poses.labels[bad[0]]}: readings of '{one.name}' are not finite; correct them, or leave them out"
        )
    return plain_readings(values)
