"""Poses and measurements as CSV files, checked at the door: every mistake is named by file, line and column.

A file of measurements has one row for each visit: joint columns, and the columns of the instruments that read there.
Cells of an instrument that are all empty mean that it read nothing. Measurements may also be spread over several files:
those with joint columns give the visits, the others say by their `pose` column to which visit each of their rows
belongs, many rows to one visit if need be (pixels, for instance).
"""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from pathlib import Path
from typing import cast

import numpy as np

from calib.core.base.arrays import FloatArray, IntArray
from calib.core.base.errors import DataError, InputError, listed_columns, nearest, require_known
from calib.core.data.instrument_cells import (
    columns_in,
    labels_of_rows,
    named_columns,
    nearest_free_column,
    readings_in,
    setups_of,
)
from calib.core.data.joined_tables import join_by_pose_column
from calib.core.data.joining import join_poses, join_readings
from calib.core.data.measurement_columns import APPROACH, header, in_table_unit
from calib.core.data.measurements import Measurements, Poses, check_repeats, measurements, states_by_order
from calib.core.data.robot_tables import read_robot_table
from calib.core.data.table_writing import format_table
from calib.core.data.tables import Source, Table, is_columns
from calib.core.data.tolerances import stated_tolerance
from calib.core.instruments.kind import Instrument, Readings
from calib.core.robots.gravity import contradiction_angles, turned_joints
from calib.core.robots.loading import RobotLike, as_robot
from calib.core.robots.robot import Robot
from calib.core.robots.terms.gravity import COLUMNS as GRAVITY_COLUMNS
from calib.core.robots.terms.gravity import GravitySection, check_read, columns_of, read_down
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
    table = read_robot_table(path, robot)
    return poses_of_table(table, robot, used=set())


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
    files = [Path(source).resolve() if isinstance(source, (str, Path)) else None for source in paths]
    for k, again in enumerate(paths):
        if files[k] is not None and files[k] in files[:k]:
            raise DataError(f"{again}: is given twice, so that every reading would count as two; give it once")
    tables = [read_robot_table(source, robot, growing=growing) for source in paths]
    tables = join_by_pose_column(tables, robot)
    with_joints = [table for table in tables if len(tables) == 1 or set(robot.commanded_names) <= set(table.names)]
    if not with_joints:
        joints = ", ".join(robot.commanded_names)
        raise DataError(f"{tables[0].path}: none of the files has a column for every joint ({joints})")
    several = len(tables) > 1
    used = {
        column
        for table in tables
        for instrument in _instruments_in(robot, table, several)
        for column in columns_in(instrument, table)
    }
    firsts = np.cumsum([0, *(len(table.rows) for table in with_joints)])
    poses = join_poses(
        [poses_of_table(table, robot, used, int(k)) for table, k in zip(with_joints, firsts[:-1], strict=True)]
    )
    parts: dict[str, list[Readings]] = {}
    start = 0
    for table in tables:
        if any(table is other for other in with_joints):
            rows = start + np.arange(len(table.rows))
            start += len(table.rows)
        else:
            rows = _visits_by_pose(table, poses)
        for instrument in _instruments_in(robot, table, several):
            own_lines = len(with_joints) < len(tables)
            parts.setdefault(instrument.name, []).append(
                readings_in(robot, instrument, table, rows, own_lines=own_lines)
            )
    data = measurements(poses, {name: join_readings(readings) for name, readings in parts.items()})
    if data.n_readings == 0 and not parts:
        raise DataError(f"{tables[0].path}: {_no_instrument(robot, tables[0])}")
    if data.n_readings == 0 and growing is None:
        where = f"{tables[0].path}{f' and {len(paths) - 1} more' if len(paths) > 1 else ''}"
        raise DataError(f"{where}: all cells of the measured columns are empty; there is nothing to read")
    check_repeats(data, robot)
    kept = np.unique(np.concatenate([readings.visits for readings in data.readings.values()]))
    return data.subset(kept) if len(kept) < len(data) else data


def sources(given: Source | Sequence[Source]) -> list[Source]:
    """Return the given tables, one or several; anything else is an `InputError`."""
    if isinstance(given, (str, Path)) or is_columns(given):
        return [given]
    several = list(cast(Sequence[Source], given))
    for source in several:
        if not isinstance(source, (str, Path)) and not is_columns(source):
            raise InputError(
                f"measurements: expected a file, a data frame, or several of them, not {type(source).__name__}; arrays"
                " become measurements with calib.as_measurements(robot, q, xyz)"
            )
    return several


def poses_of_table(table: Table, robot: Robot, used: set[str], first: int = 0) -> Poses:
    """Return the visits of a table; where it does not name its poses, they are counted on from `first`.

    Args:
        robot: Robot with these joints.
        used: Columns that something is read from, other than joints and conditions of a visit.
        first: Visits before the first row.

    Raises:
        DataError: The message names file, line and column.
    """
    setups = setups_of(robot, table) if robot.description.setups and "setup" in table.names else None
    joints, sensed = _joints_of_table(table, robot, setups, robot.joint_names)
    joints.flags.writeable = False  # so its holders need no copy
    called = tuple(table.text("pose")) if "pose" in table.names else None
    if called is not None and "" in called:
        line = table.lines[called.index("")]
        raise DataError(f"{table.path}, line {line}, column 'pose': is empty; name the pose, or leave the column out")
    names = tuple(map(str, range(first + 1, first + 1 + len(table.rows)))) if called is None else called
    context, approach = conditions_of_table(table, robot, joints)
    directions = {f"{APPROACH}{name}" for name in robot.joint_names}
    used = used | sensed | set(robot.joint_names) | {"pose", "setup", "instrument"} | set(context) | directions
    ignored = tuple(name for name in table.names if name not in used)
    poses = Poses(
        joints,
        tuple(labels_of_rows(table)),
        names,
        table.path,
        ignored,
        comments=table.comments,
        context=context,
        approach=approach,
        setups=setups,
        robot=robot,
    )
    _check_gravity(poses, robot, table)
    stated_tolerance(table.comments, table.path)
    return poses


def _check_gravity(poses: Poses, robot: Robot, table: Table) -> None:
    """Raise `DataError` where sensors read another direction of gravity than the description states."""
    angles = contradiction_angles(robot.description, robot.nominal, poses.joints, poses.conditions)
    if not np.all(np.isnan(angles)):
        k = int(np.nanargmax(angles))
        raise DataError(
            f"{table.path}, line {table.lines[k]}: the direction of gravity that was read is"
            f" {np.degrees(angles[k]):.0f} deg from the one that {robot.path} states; check gravity.down, gravity.frame"
            " and the signs (an accelerometer at rest reads upwards), or leave gravity.down out"
        )


def stands_of_table(table: Table, robot: Robot, setups: IntArray | None) -> dict[str, FloatArray]:
    """Return the joint values that inclinometers read, where the other joints are unknown, (n,) [rad] by name.

    Args:
        table: The table, with columns of these joints or of their sensors.
        robot: Robot with these joints.
        setups: The setup of each row, (n,); None: the first.

    Raises:
        DataError: Nothing states them, or only a sensor whose readings depend on unknowns does.
    """
    mechanism, turning = robot.nominal, [n for n in robot.commanded_names if robot.nominal.dimensions[n] == "angle"]
    for sensor, section in robot.description.inclinometers.items():
        support = mechanism.support[mechanism.frames[section.frame]]
        behind = [name for name in turning if support @ mechanism.select_actuated[:, mechanism.actuated.index(name)]]
        if behind and not columns_of(sensor).keys().isdisjoint(table.names):
            raise DataError(
                f"{table.path}: what '{sensor}' reads depends on joint '{behind[0]}', which is to be found; give"
                f" columns {' and '.join(section.joints)} in place of the sensor's"
            )
    joints, _ = _joints_of_table(table, robot, setups, robot.sensed_names)
    return {name: joints[:, robot.joint_names.index(name)] for name in robot.sensed_names}


def _joints_of_table(
    table: Table, robot: Robot, setups: IntArray | None, names: Sequence[str]
) -> tuple[FloatArray, set[str]]:
    """These joint values of a table, the others at home, (n, n_actuated), and the columns that inclinometers read."""
    sensors = robot.description.inclinometers
    sensed = {joint: name for name, section in sensors.items() for joint in section.joints}
    reading = [name for name in sensors if not columns_of(name).keys().isdisjoint(table.names)]
    joints = np.tile(robot.home, (len(table.rows), 1))
    for j, name in enumerate(robot.joint_names):
        if name not in names:
            continue
        sensor = sensed.get(name)
        if sensor in reading and name in table.names:
            raise DataError(f"{table.path}: has a column '{name}', and inclinometer '{sensor}' reads it; leave one out")
        if name not in table.names and sensor is None:
            raise DataError(
                f"{table.path}: no column '{name}'{nearest_free_column(name, robot, table)} (if your file has"
                " another name for it, translate that name under 'columns' in the robot description)"
            )
        if name not in table.names and sensor not in reading:
            raise DataError(
                f"{table.path}: no column '{name}', and none of inclinometer '{sensor}', which reads it: expected"
                f" {sensor}_accelerometer_x, ..., or {sensor}_gravity_x, ..., or {sensor}_gravity_tilt_x, ..."
            )
        if name in table.names:
            joints[:, j] = table.column(name, robot.mechanism.dimensions[name])
    stated = (robot.description.gravity or GravitySection()).stated_directions(tuple(robot.description.setups))
    down = stated[np.zeros(len(joints), dtype=np.intp) if setups is None else setups]
    for name in reading:
        known = {column: dimension for column, dimension in columns_of(name).items() if column in table.names}
        cells = {column.removeprefix(f"{name}_"): table.column(column, known[column], gaps=True) for column in known}
        check_read(cells, table.path, table.lines, f"{name}_")
        sensed_down = read_down(cells)
        assert sensed_down is not None  # or it is an error by now
        turned = [robot.joint_names.index(joint) for joint in sensors[name].joints]
        joints[:, turned] = turned_joints(robot.nominal, sensors[name], joints, sensed_down, down)
        _check_tilts(robot, name, joints[:, turned], table)
    return joints, {column for name in reading for column in columns_of(name)}


def _check_tilts(robot: Robot, sensor: str, tilts: FloatArray, table: Table) -> None:
    """Raise `DataError` where two joints (n, 2) cannot be what a sensor reads, or only beyond their limits."""
    section = robot.description.inclinometers[sensor]
    lost = np.flatnonzero(np.isnan(tilts).any(axis=1))
    if len(lost):
        raise DataError(
            f"{table.path}, line {table.lines[lost[0]]}: {' and '.join(section.joints)} have no values at"
            f" which '{sensor}' reads this direction of gravity; check the axes of {section.frame}, and its signs"
        )
    lower, upper = robot.urdf.limits(section.joints)
    beyond = (tilts < lower) | (tilts > upper)
    if np.any(beyond):
        k, j = np.argwhere(beyond)[0]
        raise DataError(
            f"{table.path}, line {table.lines[k]}: what '{sensor}' reads turns {section.joints[j]} by"
            f" {np.degrees(tilts[k, j]):.2f} deg, and its limits in the URDF are {np.degrees(lower[j]):.2f} and"
            f" {np.degrees(upper[j]):.2f} deg; check signs (an accelerometer at rest reads upwards), the axes of"
            f" {section.frame}, units (rad without [deg]), and these limits"
        )


def conditions_of_table(
    table: Table, robot: Robot, joints: FloatArray | None = None
) -> tuple[dict[str, FloatArray], FloatArray | None]:
    """Return the conditions of the robot in each row of a table.

    Args:
        robot: Robot whose terms name their inputs.
        joints: The commands of its rows, (n, n_actuated) [m or rad]; None where they are yet to be found: then their
            order tells nothing.

    Returns:
        Columns that terms depend on, and those of gravity where the description speaks of it, (n,) [SI] by name, NaN
        where empty; directions of approach, 0 for joints without a column, (n, n_actuated), None where no joint has
        one.

    Raises:
        DataError: Cells that are no numbers, columns that say no direction of gravity, or a direction of approach of a
            joint whose name is misspelt.
    """
    dimensions, with_gravity = condition_columns(robot.terms), robot.description.gravity is not None
    keys = [key for key in dimensions if key in table.names and (with_gravity or key not in GRAVITY_COLUMNS)]
    context = {key: table.column(key, dimensions[key], gaps=True) for key in keys}
    _check_spelling(table, robot)
    check_read(context, table.path, table.lines)
    states = {} if joints is None else states_by_order(robot, joints)
    for term in robot.terms:
        for column in term.reads():
            if column not in context and column not in states and joints is not None:
                raise DataError(f"{table.path}: no column '{column}', on which a joint term of '{term.joint}' depends")
            context.setdefault(column, states.get(column, np.zeros(len(table.rows))))
    for name in table.names:
        joint = name.removeprefix(APPROACH)
        if joint != name and joint not in robot.joint_names and difflib.get_close_matches(joint, robot.joint_names):
            raise DataError(f"{table.path}, column '{name}': no joint '{joint}'{nearest(joint, robot.joint_names)}")
    present = [(j, name) for j, joint in enumerate(robot.joint_names) if (name := f"{APPROACH}{joint}") in table.names]
    if not present:
        return context, None
    directions = np.zeros((len(table.rows), len(robot.joint_names)))
    for j, name in present:
        directions[:, j] = np.sign(np.nan_to_num(table.column(name, None, gaps=True)))
    return context, directions


def _check_spelling(table: Table, robot: Robot) -> None:
    """Raise `DataError` where a column seems to say where gravity points, but for its spelling."""
    sensed = {column for name in robot.description.inclinometers for column in columns_of(name)}
    for name in table.names if robot.description.gravity is not None else ():
        close = difflib.get_close_matches(name, GRAVITY_COLUMNS, n=1, cutoff=0.9)
        if close and close[0] not in table.names and name not in sensed:
            raise DataError(f"{table.path}: no column '{name}' says where gravity points; did you mean '{close[0]}'?")


def _visits_by_pose(table: Table, poses: Poses) -> IntArray:
    """The visit of each row of a file without joint columns."""
    if "pose" not in table.names:
        raise DataError(
            f"{table.path}: has neither a column for every joint nor a column 'pose'; add one of them, or say in the"
            " robot description what joins the files: join: rows, or join: time"
        )
    first = dict(zip(poses.names[::-1], range(len(poses) - 1, -1, -1), strict=True))
    rows = []
    for line, name in zip(table.lines, table.text("pose"), strict=True):
        require_known(
            name, first, f"{table.path}, line {line}, column 'pose': no file with joint values has a pose", DataError
        )
        rows.append(first[name])
    return np.array(rows, dtype=np.intp)


def _instruments_in(robot: Robot, table: Table, several: bool) -> list[Instrument]:
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
    return f"has no column of any instrument; expected: {expected}; the file has {listed_columns(table.names)}"


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
    """Return positions of targets as CSV text in mm and degrees.

    Args:
        robot: Names joints and targets.
        poses: Joint values, and the conditions that they state.
        positions: (n_poses, n_targets, 3) [m].
        comments: Lines to put first.
        std: Standard deviation of each coordinate, (n_poses, n_targets, 3) [m], in columns `<target>_std_x` ...
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
