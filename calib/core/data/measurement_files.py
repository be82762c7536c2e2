"""Poses and measurements as CSV files, checked at the door: every mistake is named by file, line and column.

A file of measurements has one row for each visit: joint columns, and the columns of the instruments that read there.
Cells of an instrument that are all empty mean that it read nothing. Measurements may also be spread over several files:
those with joint columns give the visits, the others say by their `pose` column to which visit each of their rows
belongs, many rows to one visit if need be (pixels, for instance). Without such a column, rows belong to each other by
their order, or by time, if the robot description asks for it (`join`); what was joined is logged as a warning (logger
`calib`).
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from calib.core.base.arrays import FloatArray, IntArray
from calib.core.base.errors import DataError, InputError, listed_columns, require_known
from calib.core.base.words import warn_once
from calib.core.data.instrument_cells import columns_in, named_columns, readings_in
from calib.core.data.measurement_columns import header, in_table_unit
from calib.core.data.measurements import Measurements, Poses, check_repeats, measurements
from calib.core.data.robot_tables import read_robot_table
from calib.core.data.table_poses import poses_of_table
from calib.core.data.table_writing import format_table
from calib.core.data.tables import Source, Table, is_source
from calib.core.instruments.kind import Instrument, Readings
from calib.core.robots.loading import RobotLike, as_robot
from calib.core.robots.robot import Robot
from calib.core.robots.terms.gravity import COLUMNS as GRAVITY_COLUMNS
from calib.core.robots.terms.terms import condition_columns


def robot_of_data(path: object, robot: RobotLike) -> Robot:
    """Return the robot for data that are to be read; `InputError` if a robot is given in the place of the data."""
    if isinstance(path, Robot):
        raise InputError('the data come first here, then the robot: calib.read_measurements("data.csv", robot)')
    return as_robot(robot)


def read_poses(path: Source, robot: RobotLike) -> Poses:
    """Read joint values; one column for each actuated joint, other columns are ignored.

    Raises:
        DataError: The message names file, line and column.
    """
    robot = robot_of_data(path, robot)
    return poses_of_table(read_robot_table(path, robot), robot, used=set())


def read_measurements(
    path: Source | Sequence[Source], robot: RobotLike, *, growing: Sequence[str] | None = None
) -> Measurements:
    """Read joint values and readings; rows with the same `pose` repeat one pose.

    Args:
        path: The file, or several that belong together; see the module docstring. Or data frames of pandas or polars,
            or dictionaries of columns, with the headers that files have.
        robot: Robot with these joints and instruments: loaded, or its description or URDF.
        growing: For one file that is still being written: its lines so far, which may have no reading yet.

    Raises:
        DataError: The message names file, line and column.
    """
    robot = robot_of_data(path, robot)
    paths = sources(path)
    files = [os.path.realpath(source) if isinstance(source, (str, Path)) else None for source in paths]
    for k, again in enumerate(paths):
        if files[k] is not None and files[k] in files[:k]:
            raise DataError(f"{again}: is given twice, so that every reading would count as two; give it once")
    tables = [read_robot_table(source, robot, growing=growing) for source in paths]
    tables = join_by_pose_column(tables, robot)
    with_joints = [table for table in tables if len(tables) == 1 or set(robot.commanded_names) <= set(table.names)]
    if not with_joints:
        joints = ", ".join(robot.commanded_names)
        raise DataError(f"{tables[0].path}: none of the files has a column for every joint ({joints})")
    reading = [_instruments_in(robot, table, several=len(tables) > 1) for table in tables]
    used = {
        column
        for table, instruments in zip(tables, reading, strict=True)
        for instrument in instruments
        for column in columns_in(instrument, table)
    }
    firsts = np.cumsum([0, *(len(table.rows) for table in with_joints)]).tolist()
    poses = join_poses(
        [poses_of_table(table, robot, used, first) for table, first in zip(with_joints, firsts, strict=False)]
    )
    first_of = {id(table): first for table, first in zip(with_joints, firsts, strict=False)}
    own_lines, parts = len(with_joints) < len(tables), dict[str, list[Readings]]()
    for table, instruments in zip(tables, reading, strict=True):
        first = first_of.get(id(table))
        rows = _visits_by_pose(table, poses) if first is None else first + np.arange(len(table.rows))
        for instrument in instruments:
            own = readings_in(robot, instrument, table, rows, own_lines=own_lines)
            parts.setdefault(instrument.name, []).append(own)
    data = measurements(poses, {name: join_readings(readings) for name, readings in parts.items()})
    if data.n_readings == 0 and not parts:
        raise DataError(f"{tables[0].path}: {_no_instrument(robot, tables[0])}")
    if data.n_readings == 0 and growing is None:
        where = f"{tables[0].path}{f' and {len(paths) - 1} more' if len(paths) > 1 else ''}"
        raise DataError(f"{where}: all cells of the measured columns are empty; there is nothing to read")
    check_repeats(data, robot)
    return data.read_visits() if data.n_readings else data.subset(np.arange(0))


def sources(given: object) -> list[Source]:
    """Return the given tables, one or several; anything else is an `InputError`."""
    several: list[Any] = list(given) if isinstance(given, (list, tuple)) and given else [given]
    for source in several:
        if not is_source(source):
            raise InputError(
                "measurements: expected a file, a data frame, Measurements, or several of them, not"
                f" {type(source).__name__}; arrays become measurements with calib.as_measurements(robot, q, xyz)"
            )
    return several


def _visits_by_pose(table: Table, poses: Poses) -> IntArray:
    """The visit of each row of a file without joint columns."""
    if "pose" not in table.names:
        raise DataError(
            f"{table.path}: has neither a column for every joint nor a column 'pose'; add one of them, or say in the"
            " robot description what joins the files: join: rows, or join: time"
        )
    first = dict(zip(poses.names[::-1], range(len(poses) - 1, -1, -1), strict=True))
    rows = []
    for k, name in enumerate(table.text("pose")):
        require_known(name, first, f"{table.where(k, 'pose')}: no file with joint values has a pose", DataError)
        rows.append(first[name])
    return np.array(rows, dtype=np.intp)


def _instruments_in(robot: Robot, table: Table, *, several: bool) -> list[Instrument]:
    """Instruments that a table has columns for; all, where nothing says that they may be missing."""
    if not robot.description.instruments and not several:
        return list(robot.instruments)
    instruments = [
        instrument for instrument in robot.instruments if any(name in table.names for name in named_columns(instrument))
    ]
    if not instruments and set(robot.commanded_names) <= set(table.names):
        return []
    if not instruments:
        raise DataError(f"{table.path}: {_no_instrument(robot, table)}")
    return instruments


def _no_instrument(robot: Robot, table: Table) -> str:
    expected = "; ".join(dict.fromkeys(", ".join(named_columns(instrument)) for instrument in robot.instruments))
    there = listed_columns(list(map(table.header, table.names)))
    return f"has no column of any instrument; expected: {expected}; the file has {there}"


def format_measurements(robot: Robot, data: Measurements, comments: tuple[str, ...] = ()) -> str:
    """Return measurements as CSV text in mm and degrees; see `calib.core.data.measurement_columns`."""
    return format_table(list(data.to_dict(robot).items()), comments)


def format_positions(
    robot: Robot,
    poses: Poses,
    positions: FloatArray,
    comments: tuple[str, ...] = (),
    std: FloatArray | None = None,
) -> str:
    """Return positions of targets (n_poses, n_targets, 3) [m] as CSV text in mm and degrees, after comments.

    Columns `<target>_std_x` ... have the standard deviations, `std`, of the same shape.
    """
    columns = poses.to_dict(robot)
    for suffix, numbers in (("", positions), ("std_", std)):
        for t, target in enumerate(robot.target_names):
            for a, axis in enumerate("xyz"):
                if numbers is not None:
                    columns[header(f"{target}_{suffix}{axis}", "length")] = list(
                        in_table_unit(numbers[:, t, a], "length")
                    )
    return format_table(list(columns.items()), comments)


_TIME = "time"


def join_by_pose_column(tables: Sequence[Table], robot: Robot) -> list[Table]:
    """Return tables that a column `pose` joins; it is added if the description asks to join by rows or by time.

    `DataError` if not one table has joint values, numbers of rows differ, or there is no `time` near enough.
    """
    how, joints = robot.description.join, set(robot.commanded_names)
    if how == "pose" or len(tables) == 1:
        return list(tables)
    leaders = [table for table in tables if joints <= set(table.names)]
    if len(leaders) != 1:
        raise DataError(f"{tables[0].path}: 'join: {how}' needs joint values in one file, not in {len(leaders)}")
    every, leader = np.arange(len(leaders[0].rows)), leaders[0]
    return [
        _with_poses(table, every, every) if table is leader else _follower(table, leader, robot) for table in tables
    ]


def _follower(table: Table, leader: Table, robot: Robot) -> Table:
    """The rows of a table that belong to rows of the leader; the number of the leader's row is the pose."""
    if robot.description.join == "rows":
        if len(table.rows) != len(leader.rows):
            raise DataError(
                f"{table.path}: has {len(table.rows)} rows, and {leader.path} has {len(leader.rows)}; 'join: rows'"
                " needs the same number in both"
            )
        warn_once(f"{table.path}: joined row by row with {leader.path}, as the description asks")
        every = np.arange(len(table.rows))
        return _with_poses(table, every, every)
    own, given = _times(table), _times(leader)
    order = np.argsort(own)
    place = np.searchsorted(own[order], given)
    pair = order[np.clip([place - 1, place], 0, len(own) - 1)]
    nearest = pair[np.argmin(np.abs(own[pair] - given), axis=0), np.arange(len(given))]
    apart, lag = np.abs(own[nearest] - given), robot.description.lag
    near = np.flatnonzero(apart <= lag)
    if len(near) == 0:
        raise DataError(
            f"{table.path}: its times differ by {np.min(apart):.3g} s or more from those in {leader.path}, but 'lag'"
            f" allows {lag:g} s; make their clocks agree, or give a larger 'lag' in the robot description"
        )
    warn_once(f"{table.path}: joined to {len(near)} of {len(given)} rows of {leader.path} by time, within {lag:g} s")
    return _with_poses(table, nearest[near], near)


def _times(table: Table) -> FloatArray:
    if _TIME not in table.names:
        raise DataError(
            f"{table.path}: no column 'time' to join by; rename the column of times, or map it under 'columns' in the"
            " description"
        )
    return table.column(_TIME, condition_columns()[_TIME])


def _with_poses(table: Table, rows: np.ndarray, poses: np.ndarray) -> Table:
    """Some rows of a table, with a column `pose` of these numbers in place of its own, if it has one."""
    others = [k for k, name in enumerate(table.names) if name != "pose"]
    cells = [(*(table.rows[int(row)][k] for k in others), str(int(p) + 1)) for row, p in zip(rows, poses, strict=True)]
    return replace(
        table,
        names=(*(table.names[k] for k in others), "pose"),
        units=(*(table.units[k] for k in others), None),
        rows=tuple(cells),
        lines=tuple(table.lines[int(row)] for row in rows),
    )


def join_measurements(parts: Sequence[Measurements], robot: Robot) -> Measurements:
    """Put measurements one after another, as those of several files.

    If several number their poses from 1, later numbers continue the earlier ones, unless joint values repeat poses.
    `DataError` if a part is given twice, or is of a robot with other joints; or as `read_measurements`.
    """
    for k, again in enumerate(parts):
        if any(again is other for other in parts[:k]):
            raise DataError(f"{again.path}: is given twice, so that every reading would count as two; give it once")
        if again.robot is not None and again.robot.joint_names != robot.joint_names:
            raise DataError(f"{again.path}: is of '{again.robot.name}', whose joints are not those of '{robot.name}'")
    stated = [part.states_approach for part in parts]
    if any(part.approach is not None for part in parts):
        parts = [
            replace(part, approach=None if any(stated) and not known else part.approach_directions)
            for part, known in zip(parts, stated, strict=True)
        ]
    firsts = np.cumsum([0, *map(len, parts)]).tolist()
    shifted = [
        {name: replace(own, visits=own.visits + first) for name, own in part.readings.items()}
        for part, first in zip(parts, firsts, strict=False)
    ]
    names = dict.fromkeys(name for part in parts for name in part.readings)
    readings = {name: join_readings([own[name] for own in shifted if name in own]) for name in names}
    data = replace(measurements(join_poses(parts), readings), approach_assumed=not any(stated))
    try:
        check_repeats(data, robot)
    except DataError:
        numbered = [list(part.names) == [str(k + 1) for k in range(len(part))] for part in parts]
        if sum(numbered) < 2:
            raise
        counted_on = (
            map(str, range(first + 1, first + 1 + len(part))) for part, first in zip(parts, firsts, strict=False)
        )
        named = [own if known else part.names for part, own, known in zip(parts, counted_on, numbered, strict=True)]
        data = replace(data, names=tuple(chain.from_iterable(named)))
        check_repeats(data, robot)
    return data


def join_poses(parts: Sequence[Poses]) -> Poses:
    """Put the visits of several files one after another.

    `DataError` if one file states directions of approach, or of gravity, and another does not.
    """
    if len(parts) == 1:
        return parts[0]
    keys = dict.fromkeys(key for part in parts for key in part.context)
    for key in keys:
        lacking = next((part.path for part in parts if key in GRAVITY_COLUMNS and key not in part.context), None)
        if lacking is not None:
            raise DataError(
                f"{lacking}: has no column '{key}', but another file has it; give it in all files, or in none"
            )
    setups = [np.zeros(len(part), dtype=np.intp) if part.setups is None else part.setups for part in parts]
    approach = [part.approach for part in parts if part.approach is not None]
    if 0 < len(approach) < len(parts):
        silent = next(part.path for part in parts if part.approach is None)
        raise DataError(
            f"{silent}: states no directions of approach, but another file does; give them in all files, or in none"
        )
    return Poses(
        np.concatenate([part.joints for part in parts]),
        tuple(chain.from_iterable(part.labels for part in parts)),
        tuple(chain.from_iterable(part.names for part in parts)),
        ", ".join(part.path for part in parts),
        tuple(dict.fromkeys(chain.from_iterable(part.ignored for part in parts))),
        comments=tuple(dict.fromkeys(chain.from_iterable(part.comments for part in parts))),
        setups=np.concatenate(setups) if any(part.setups is not None for part in parts) else None,
        approach=np.concatenate(approach) if approach else None,
        robot=parts[0].robot,
        context={
            key: np.concatenate([part.context.get(key, np.full(len(part), np.nan)) for part in parts]) for key in keys
        },
    )


def join_readings(parts: Sequence[Readings]) -> Readings:
    """Return the readings of one instrument in several files as one.

    `DataError` if some files state standard deviations, and some do not.
    """
    if len(parts) == 1:
        return parts[0]
    with_covariance = [part.covariance for part in parts if part.covariance is not None]
    if with_covariance and len(with_covariance) < len(parts):
        raise DataError("standard deviations are given in one file and not in another; give them in all, or in none")
    labels = [part.labels for part in parts if part.labels is not None]
    return Readings(
        np.concatenate([part.visits for part in parts]),
        np.concatenate([part.pairs for part in parts]),
        np.concatenate([part.values for part in parts]),
        np.concatenate(with_covariance) if with_covariance else None,
        np.concatenate([part.details for part in parts]),
        tuple(chain.from_iterable(labels)) if len(labels) == len(parts) else None,
    )
