"""Poses and measurements as callers give them: in memory already, in data frames, or in files; checked alike."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from calib.core.base.arrays import FloatArray, numbers_in
from calib.core.base.errors import DataError, InputError, require_known
from calib.core.base.letters import unseen
from calib.core.data.measurement_files import join_measurements, read_measurements, sources
from calib.core.data.measurements import Measurements, Poses, check_repeats, measurements, states_by_order
from calib.core.data.plan_files import read_pose_files
from calib.core.data.tables import Source, is_source
from calib.core.instruments.kind import Instrument, Readings
from calib.core.robots.configurations import joint_vector
from calib.core.robots.loading import RobotLike, as_robot
from calib.core.robots.robot import Robot

PosesLike = Poses | Source | ArrayLike
"""Poses with names, a file or data frame of poses, or joint values alone [m or rad]."""
MeasurementsLike = Measurements | Source | Sequence[Source | Measurements]
"""Measurements, a file or data frame of measurements, or a list of these."""
_SOURCE = "arrays"


def as_poses(robot: RobotLike, poses: PosesLike, names: Sequence[str] | None = None) -> Poses:
    """Return joint values as `Poses`, named by their row if they have no names.

    Args:
        robot: Robot with these joints; loaded, or its description or URDF.
        poses: Poses with names; a file or a data frame, with headers as in files; or actuated joints alone,
            (n_poses, n_actuated) [m or rad].
        names: Pose names of joint values, n_poses of them.

    Raises:
        DataError: Wrong shape, values that are not finite, or a wrong number of names.
    """
    if isinstance(poses, Poses):
        return poses
    robot = as_robot(robot)
    if is_source(poses):
        return read_pose_files([poses], robot)
    joints = joint_vector(robot, cast(ArrayLike, poses))
    if names is not None and len(names) != len(joints):
        raise DataError(f"names: {len(names)} for {len(joints)} poses; give one for each")
    states, given = states_by_order(robot, joints), range(len(joints)) if names is None else names
    called = tuple(str(name) for name in given)
    if problem := next(filter(None, map(unseen, called)), ""):
        raise DataError(f"names: {problem}")
    labels = tuple(f"pose {name}" for name in called)
    return Poses(joints, labels, called, _SOURCE, (), context=states, robot=robot)


def as_measurements(
    robot: RobotLike,
    poses: PosesLike | Sequence[Source | Measurements],
    readings: ArrayLike | Mapping[str, ArrayLike | Readings] | None = None,
    names: Sequence[str] | None = None,
) -> Measurements:
    """Return readings as `Measurements`; rows with the same pose name repeat that pose.

    Args:
        robot: Robot with these joints and instruments.
        poses: Poses with names, or actuated joints alone, (n, n_actuated) [m or rad]. Without `readings`: measurements,
            which are returned as they are; or a file or a data frame of them (`read_measurements`); or several.
        readings: Readings by the instrument's name, a row for each pose, (n, n_values) [SI], NaN where there is none.
            `Readings`, if an instrument reads several things at a pose. Words, as in a file, for an instrument that
            reads no numbers, empty where there is none. If all instruments measure positions: the positions,
            (n, n_targets, 3), or (n, 3) for one target [m].
        names: Pose name of each row; without names, every row is a pose of its own.

    Raises:
        DataError: Wrong shape, values that are not finite, an unknown instrument, or rows of one pose whose joint
            values differ.
    """
    robot = as_robot(robot)
    if readings is None:
        return _as_measurements(robot, poses)
    poses = as_poses(robot, cast(ArrayLike, poses), names)
    if not isinstance(readings, Mapping):
        readings = _positions_by_instrument(robot, len(poses), readings)
    readings_by_name: dict[str, Readings] = {}
    for name, given in readings.items():
        require_known(name, [instrument.name for instrument in robot.instruments], "no instrument", DataError)
        instrument = robot.instrument(name)
        if isinstance(given, Readings):
            readings_by_name[name] = given
        elif instrument.touches:
            readings_by_name[name] = _words(instrument, poses, np.asarray(given))
        else:
            readings_by_name[name] = _readings(instrument, poses, numbers_in(given, f"readings of '{name}'"))
    data = measurements(poses, readings_by_name)
    check_repeats(data, robot)
    return data


def _as_measurements(robot: Robot, given: object) -> Measurements:
    """Measurements as they are, or read."""
    if isinstance(given, Measurements):
        return given
    if isinstance(given, (list, tuple)) and any(isinstance(part, Measurements) for part in given):
        return join_measurements([_as_measurements(robot, part) for part in given], robot)
    return read_measurements(sources(given), robot)


def with_sigma(robot: Robot, data: Measurements, sigma: ArrayLike) -> Measurements:
    """Return measurements whose rows all state the noise of their positions.

    Args:
        robot: Its instruments say what else is read, and how well that is known.
        sigma: Standard deviation per axis of what was read in each row, (n,) or (n, 3) [m].

    Raises:
        DataError: There is not one deviation for each row, or one is not positive.
        InputError: Nothing measures positions, or other readings state no noise.
    """
    values = numbers_in(sigma, "sigma")
    if values.shape not in ((len(data),), (len(data), 3)):
        raise DataError(f"sigma of shape {values.shape}: expected ({len(data)},) or ({len(data)}, 3), one for each row")
    if not np.all(np.isfinite(values) & (values > 0)):
        raise DataError("sigma: must be positive numbers [m]; leave out rows that the fit should not use")
    stds = np.broadcast_to(values[:, None] if values.ndim == 1 else values, (len(data), 3))
    changed = dict(data.readings)
    for name, readings in data.readings.items():
        instrument = robot.instrument(name)
        if not any(part.is_position for part in instrument.parts):
            continue
        stated = zip(instrument.parts, instrument.noise.parts, strict=True)
        if readings.covariance is not None:
            covariance = readings.covariance.copy()
        elif all(part.is_position or noise.stated for part, noise in stated):
            covariance = instrument.covariance(readings.values, instrument.noise).copy()
        else:
            raise InputError(
                f"sigma: '{name}' reads more than positions, and the noise of the rest is not stated; state it in the"
                " robot description"
            )
        rows = np.flatnonzero([instrument.parts[k].is_position for k in instrument.part_of_row])
        covariance[:, rows, :] = covariance[:, :, rows] = 0.0
        covariance[:, rows, rows] = stds[readings.visits] ** 2
        changed[name] = replace(readings, covariance=covariance)
    if all(changed[name] is data.readings[name] for name in changed):
        raise InputError("sigma: no instrument measures positions; state the noise of others in the robot description")
    return replace(data, readings=changed)


def plain_readings(values: FloatArray) -> Readings:
    """Return values (n, n_values) of n visits in a row as readings, without those that are NaN throughout."""
    visits = np.flatnonzero(~np.all(np.isnan(values), axis=1))
    return Readings(visits, np.zeros(len(visits), dtype=np.intp), values[visits], None, np.zeros((len(visits), 0)))


def _positions_by_instrument(robot: Robot, n: int, given: ArrayLike) -> dict[str, FloatArray]:
    if not all(instrument.reads_positions for instrument in robot.instruments):
        names = ", ".join(instrument.name for instrument in robot.instruments)
        raise DataError(f"readings: the robot has several kinds of instruments; give them by name ({names})")
    values, shape = numbers_in(given, "positions"), (n, len(robot.instruments), 3)
    if values.shape == (n, 3) and shape[1] == 1:
        values = values[:, None]
    if values.shape != shape:
        raise DataError(
            f"positions of shape {np.shape(given)}; expected {shape}: a row for each pose,"
            f" the targets in the order {', '.join(instrument.name for instrument in robot.instruments)}"
        )
    return {instrument.name: values[:, k] for k, instrument in enumerate(robot.instruments)}


def _words(instrument: Instrument, poses: Poses, given: ArrayLike) -> Readings:
    """Readings of an instrument that says in one column of words what it looked at, and reads no numbers."""
    texts = [str(text).strip() for text in np.atleast_1d(np.asarray(given))]
    if np.shape(given) != (len(poses),) or not all(isinstance(text, str) for text in np.asarray(given, dtype=object)):
        raise DataError(
            f"{instrument.name}: expected {len(poses)} words, one for each pose; empty where it read nothing"
        )
    (column,) = instrument.text_columns()
    belongs, pairs, details = instrument.parse_texts({column: texts}, poses.labels)
    visits = np.flatnonzero(belongs)
    return Readings(visits, pairs[visits], np.repeat(instrument.values({}), len(visits), axis=0), None, details[visits])


def _readings(instrument: Instrument, poses: Poses, values: FloatArray) -> Readings:
    if instrument.looks()[1].shape[1]:
        raise DataError(
            f"{instrument.name}: an array does not name the point or thing of each reading; give"
            " calib.Readings with details"
        )
    width = instrument.values({column.name: np.zeros(0) for column in instrument.columns()}).shape[1]
    if values.shape != (len(poses), width):
        raise DataError(f"{instrument.name}: readings of shape {values.shape}; expected ({len(poses)}, {width})")
    whole = np.all(np.isnan(values), axis=1)
    bad = np.flatnonzero(~np.isfinite(values).all(axis=1) & ~whole)
    if len(bad):
        raise DataError(
            f"{poses.labels[bad[0]]}: readings of '{instrument.name}' are not finite; correct them, or leave them out"
        )
    return plain_readings(values)
