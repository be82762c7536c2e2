"""Poses and measurements that are already in memory, checked as those of a file are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from calib.base.arrays import FloatArray
from calib.base.errors import DataError, nearest
from calib.data.measurements import Measurements, Poses, check_repeats
from calib.data.on_demand import Numbered
from calib.instruments.kind import Instrument, Readings
from calib.instruments.position import Position
from calib.robots.robot import Robot

_SOURCE = "arrays"


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
    if names is None:
        numbers = range(len(joints))
        return Poses(joints, Numbered("pose ", numbers), Numbered("", numbers), _SOURCE, ())
    called = tuple(str(name) for name in names)
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
    poses = as_poses(robot, poses, names)
    if not isinstance(readings, Mapping):
        readings = _positions_by_instrument(robot, len(poses), readings)
    readings_by_name: dict[str, Readings] = {}
    for name, given in readings.items():
        if name not in [one.name for one in robot.instruments]:
            raise DataError(f"no instrument '{name}'{nearest(name, [one.name for one in robot.instruments])}")
        one = robot.instrument(name)
        if isinstance(given, Readings):
            readings_by_name[name] = given
            continue
        if not one.columns():
            readings_by_name[name] = _words(one, poses, np.asarray(given))
            continue
        readings_by_name[name] = _readings(one, poses, np.asarray(given, dtype=float))
    data = measurements(poses, readings_by_name)
    check_repeats(data, robot)
    return data


def measurements(poses: Poses, readings: Mapping[str, Readings]) -> Measurements:
    """Put poses and readings together."""
    return Measurements(
        poses.joints,
        tuple(poses.labels),
        tuple(poses.names),
        poses.path,
        poses.ignored,
        readings,
        approach_assumed=isinstance(poses, Measurements) and poses.approach_assumed,
        comments=poses.comments,
        context=poses.context,
        approach=poses.approach,
        setups=poses.setups,
        wanted=poses.wanted,
    )


def plain_readings(values: FloatArray) -> Readings:
    """Return values (n, n_values) of n visits in a row as readings, without those that are NaN throughout."""
    visits = np.flatnonzero(~np.all(np.isnan(values), axis=1))
    return Readings(visits, np.zeros(len(visits), dtype=np.intp), values[visits], None, np.zeros((len(visits), 0)))


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
    visits = np.flatnonzero(own)
    return Readings(visits, pairs[visits], np.repeat(one.values({}), len(visits), axis=0), None, details[visits])


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
