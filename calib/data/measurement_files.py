"""Poses and measurements as CSV files, checked at the door: every mistake is named by file, line and column.

A file of measurements has one row for each visit: joint columns, and the columns of the instruments that read there.
Cells of an instrument that are all empty mean that it read nothing. Measurements may also be spread over several files:
those with joint columns give the visits, the others say by their `pose` column to which visit each of their rows
belongs, many rows to one visit if need be (pixels, for instance).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path

import numpy as np

from calib.arrays import BoolArray, FloatArray, IntArray
from calib.data.in_memory import measurements
from calib.data.measurements import CONTEXT, Measurements, Poses, check_repeats, in_setups, rank_in_visit
from calib.data.tables import Table, format_table, read_table
from calib.errors import DataError, nearest
from calib.model.robot import Robot
from calib.observation.kind import Instrument, Readings
from calib.units import DISPLAY_UNIT, PER_SI, Dimension

_APPROACH = "approach_"


def read_poses(path: Path | str, robot: Robot) -> Poses:
    """Read joint values; one column for each actuated joint, other columns are ignored.

    Raises:
        DataError: The message names file, line and column.
    """
    table = read_table(path, robot.description.columns)
    return poses_of_table(table, robot, used=set())


def read_measurements(path: Path | str | Sequence[Path | str], robot: Robot, *, growing: bool = False) -> Measurements:
    """Read joint values and what the instruments read; rows with the same `pose` repeat one pose.

    Args:
        path: The file, or several that belong together; see the module docstring.
        robot: Whose joints and instruments they are.
        growing: Whether somebody still writes: a last line without its end is left out, and nothing may be read yet.

    Raises:
        DataError: The message names file, line and column.
    """
    paths = [path] if isinstance(path, (str, Path)) else list(path)
    tables = [read_table(one, robot.description.columns, growing=growing) for one in paths]
    with_joints = [table for table in tables if len(tables) == 1 or set(robot.joint_names) <= set(table.names)]
    if not with_joints:
        raise DataError(f"{paths[0]}: none of the files has a column for every joint ({', '.join(robot.joint_names)})")
    used = {column for table in tables for one in _seen_in(robot, table) for column in columns_in(one, table)}
    firsts = np.cumsum([0, *(len(table.rows) for table in with_joints)])
    poses = _joined(
        [poses_of_table(table, robot, used, int(k)) for table, k in zip(with_joints, firsts[:-1], strict=True)]
    )
    approach = _joined_approach(robot, with_joints)
    parts: dict[str, list[Readings]] = {}
    start = 0
    for table in tables:
        if any(table is one for one in with_joints):
            rows = start + np.arange(len(table.rows))
            start += len(table.rows)
        else:
            rows = _visits_by_pose(table, poses)
        for one in _seen_in(robot, table):
            parts.setdefault(one.name, []).append(_readings(robot, one, table, rows))
    data = measurements(poses, {name: _concatenated(readings) for name, readings in parts.items()})
    if data.n_readings == 0 and not parts:
        raise DataError(f"{paths[0]}: has no column of any instrument; expected: {_expected(robot)}")
    if data.n_readings == 0 and not growing:
        where = f"{paths[0]}{f' and {len(paths) - 1} more' if len(paths) > 1 else ''}"
        raise DataError(f"{where}: all cells of the measured columns are empty; there is nothing to read")
    check_repeats(data, robot)
    kept = np.unique(np.concatenate([readings.visits for readings in data.readings.values()]))
    return replace(data, approach=approach).subset(kept) if len(kept) < len(data) else replace(data, approach=approach)


def format_measurements(robot: Robot, data: Measurements, comments: tuple[str, ...] = ()) -> str:
    """Return measurements as CSV text in mm and degrees.

    A visit at which an instrument read several things (points of a camera) has a line for each of them, which repeat
    its joint values.

    Raises:
        DataError: Simulated readings of an instrument that reads no numbers.
    """
    visits, line_of = _lines(robot, data)
    columns: dict[str, list[object]] = {
        header: [cells[k] for k in visits]
        for header, cells in [*_pose_columns(robot, data), *_conditions(robot, data), *_approach_columns(robot, data)]
    }
    for one in robot.instruments:
        readings = data.readings.get(one.name)
        if readings is None:
            continue
        dimensions = {column.name: column.dimension for column in one.columns()}
        cells: dict[str, Sequence[object]] = {
            _header(name, dimensions[name]): list(_shown(numbers, dimensions[name]))
            for name, numbers in one.cells(readings.values).items()
        }
        if one.label_column is not None:
            cells[one.label_column] = [one.name] * len(readings)
        for header, shown in (cells | one.texts(readings.pairs, readings.details)).items():
            column = columns.setdefault(header, [""] * len(visits))
            for line, cell in zip(line_of[one.name], shown, strict=True):
                column[line] = cell
        if not dimensions and np.any(readings.values):
            raise DataError(
                f"instrument '{one.name}' reads no numbers, so that no file can say by how much it missed: what it"
                " touches must be touched; give joint values at which it is"
            )
    return format_table(list(columns.items()), comments)


def _lines(robot: Robot, data: Measurements) -> tuple[IntArray, dict[str, IntArray]]:
    """The visit of each line of a file, and the line of each reading; what shares columns needs lines of its own."""
    sharing: dict[str, list[str]] = {}
    for one in robot.instruments:
        if one.name in data.readings:
            sharing.setdefault(f"column {one.label_column}" if one.label_column else one.name, []).append(one.name)
    place: dict[str, IntArray] = {}
    for names in sharing.values():
        places = rank_in_visit(np.concatenate([data.readings[name].visits for name in names]))
        ends = np.cumsum([len(data.readings[name]) for name in names])[:-1]
        place |= dict(zip(names, np.split(places, ends), strict=True))
    count = np.ones(len(data), dtype=np.intp)
    for name, places in place.items():
        np.maximum.at(count, data.readings[name].visits, places + 1)
    first = np.cumsum(count) - count
    return np.repeat(np.arange(len(data)), count), {
        name: first[data.readings[name].visits] + places for name, places in place.items()
    }


def _conditions(robot: Robot, data: Measurements) -> list[tuple[str, list[object]]]:
    """Columns that say in which setup and under which conditions the visits were made."""
    columns: list[tuple[str, list[object]]] = []
    names = list(robot.description.setups)
    if names:
        setups = np.zeros(len(data), dtype=np.intp) if data.setups is None else data.setups
        columns.append(("setup", [names[k] for k in setups]))
    for key, values in data.context.items():
        cells: list[object] = ["" if np.isnan(value) else value for value in _shown(values, CONTEXT[key])]
        columns.append((_header(key, CONTEXT[key]), cells))
    return columns


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
        poses: Joint values.
        positions: (n_poses, n_targets, 3) [m].
        comments: Lines to put first.
        std: Standard deviation of each coordinate, (n_poses, n_targets, 3) [m], in columns `<target>_std_x` ...
    """
    columns = _pose_columns(robot, poses)
    for suffix, numbers in (("", positions), ("std_", std)):
        for t, target in enumerate(robot.target_names):
            for a, axis in enumerate("xyz"):
                if numbers is not None:
                    shown = _shown(numbers[:, t, a], "length")
                    columns.append((_header(f"{target}_{suffix}{axis}", "length"), list(shown)))
    return format_table(columns, comments)


def _header(name: str, dimension: Dimension | None) -> str:
    return name if dimension is None else f"{name} [{DISPLAY_UNIT[dimension]}]"


def _shown(numbers: FloatArray, dimension: Dimension | None) -> FloatArray:
    return numbers if dimension is None else numbers * PER_SI[dimension][DISPLAY_UNIT[dimension]]


def _pose_columns(robot: Robot, poses: Poses) -> list[tuple[str, list[object]]]:
    columns: list[tuple[str, list[object]]] = [("pose", list(poses.names))]
    for j, name in enumerate(robot.joint_names):
        dimension = robot.mechanism.dimensions[name]
        # 15 digits: 30 degrees come out as 30, not as what the way through radians leaves of them
        cells: list[object] = [float(f"{value:.15g}") for value in _shown(poses.joints[:, j], dimension)]
        columns.append((_header(name, dimension), cells))
    return columns


def _approach_columns(robot: Robot, data: Measurements) -> list[tuple[str, list[object]]]:
    """Directions of approach where they are given, of the joints of which any is known; a column says that they are."""
    if data.approach is None:
        return []
    known = np.any(data.approach != 0, axis=0)
    shown = known if np.any(known) else ~known
    return [
        (f"{_APPROACH}{name}", [int(direction) for direction in data.approach[:, j]])
        for j, name in enumerate(robot.joint_names)
        if shown[j]
    ]


def poses_of_table(table: Table, robot: Robot, used: set[str], first: int = 0) -> Poses:
    """Return the visits of a table; where it does not name its poses, they are counted on from `first`.

    Args:
        table: The table.
        robot: Whose joints they are.
        used: Columns that something is read from, beside joints and what is known of a visit.
        first: Visits before the first row.

    Raises:
        DataError: The message names file, line and column.
    """
    joints = np.stack([table.column(name, robot.mechanism.dimensions[name]) for name in robot.joint_names], axis=1)
    named = "pose" in table.names
    if named and "" in table.text("pose"):
        line = table.lines[table.text("pose").index("")]
        raise DataError(f"{table.path}, line {line}, column 'pose': is empty; name the pose, or leave the column out")
    names = tuple(table.text("pose")) if named else tuple(str(first + k + 1) for k in range(len(table.rows)))
    labels = tuple(
        f"{table.path}, line {line}" + (f" (pose {name})" if named else "")
        for line, name in zip(table.lines, names, strict=True)
    )
    context = {key: table.column(key, CONTEXT[key], gaps=True) for key in CONTEXT if key in table.names}
    approach = {f"{_APPROACH}{name}" for name in robot.joint_names}
    used = used | set(robot.joint_names) | {"pose", "setup", "instrument"} | set(context) | approach
    ignored = tuple(name for name in table.names if name not in used)
    setups = _setups(robot, table) if robot.description.setups and "setup" in table.names else None
    return Poses(joints, labels, names, table.path, ignored, comments=table.comments, context=context, setups=setups)


def _joined(parts: Sequence[Poses]) -> Poses:
    """Put the visits of several files one after another."""
    if len(parts) == 1:
        return parts[0]
    keys = dict.fromkeys(key for part in parts for key in part.context)
    setups = [part.setups for part in parts if part.setups is not None]
    return Poses(
        np.concatenate([part.joints for part in parts]),
        tuple(chain.from_iterable(part.labels for part in parts)),
        tuple(chain.from_iterable(part.names for part in parts)),
        ", ".join(part.path for part in parts),
        tuple(dict.fromkeys(chain.from_iterable(part.ignored for part in parts))),
        comments=tuple(dict.fromkeys(chain.from_iterable(part.comments for part in parts))),
        setups=np.concatenate(setups) if len(setups) == len(parts) else None,
        context={
            key: np.concatenate([part.context.get(key, np.full(len(part), np.nan)) for part in parts]) for key in keys
        },
    )


def _joined_approach(robot: Robot, tables: Sequence[Table]) -> FloatArray | None:
    """Directions of approach, where every file has a column for every joint's; None: from the order of the rows."""
    columns = [f"{_APPROACH}{name}" for name in robot.joint_names]
    present = [[name for name in columns if name in table.names] for table in tables]
    if not all(present):
        return None
    parts = []
    for table, names in zip(tables, present, strict=True):
        directions = np.zeros((len(table.rows), len(columns)))
        for name in names:
            directions[:, columns.index(name)] = np.sign(np.nan_to_num(table.column(name, None, gaps=True)))
        parts.append(directions)
    return np.concatenate(parts)


def _visits_by_pose(table: Table, poses: Poses) -> IntArray:
    """The visit of each row of a file without joint columns."""
    if "pose" not in table.names:
        raise DataError(f"{table.path}: has neither a column for every joint nor a column 'pose'; add one of them")
    first = dict(zip(poses.names[::-1], range(len(poses) - 1, -1, -1), strict=True))
    rows = []
    for line, name in zip(table.lines, table.text("pose"), strict=True):
        if name not in first:
            raise DataError(
                f"{table.path}, line {line}, column 'pose': no file with joint values has a pose '{name}'"
                f"{nearest(name, first)}"
            )
        rows.append(first[name])
    return np.array(rows, dtype=np.intp)


def _seen_in(robot: Robot, table: Table) -> list[Instrument]:
    """Instruments that a table has columns for; all, where nothing says that they may be missing."""
    if not robot.description.instruments:
        return list(robot.instruments)
    instruments = [one for one in robot.instruments if any(name in table.names for name in _named_columns(one))]
    if not instruments and set(robot.joint_names) <= set(table.names):
        return []
    if not instruments:
        raise DataError(f"{table.path}: has no column of any instrument; expected: {_expected(robot)}")
    return instruments


def _expected(robot: Robot) -> str:
    return "; ".join(dict.fromkeys(", ".join(_named_columns(one)) for one in robot.instruments))


def _named_columns(one: Instrument) -> list[str]:
    """Columns that only this instrument has: its numbers, or its words where it has no numbers."""
    return [column.name for column in one.columns()] or list(one.text_columns())


def _std_columns(one: Instrument) -> list[tuple[str, Dimension]]:
    return [(f"{one.name}_std_{axis}", part.dimension) for part in one.parts for axis in part.axes]


def columns_in(one: Instrument, table: Table) -> list[str]:
    """Return the columns of a table that an instrument reads."""
    names = [column.name for column in one.columns()] + list(one.text_columns())
    names += [] if one.label_column is None else [one.label_column]
    names += [name for name, _ in _std_columns(one)] + list(_correlation_columns(one))
    return [name for name in names if name in table.names]


def _correlation_columns(one: Instrument) -> dict[str, tuple[int, int]]:
    axes = [axis for part in one.parts for axis in part.axes]
    return {f"{one.name}_corr_{axes[i]}_{axes[j]}": (i, j) for i in range(len(axes)) for j in range(i + 1, len(axes))}


def _readings(robot: Robot, one: Instrument, table: Table, rows: IntArray) -> Readings:
    """What an instrument read in the rows of a table, whose visits are given, (n_table_rows,)."""
    columns = {column.name: table.column(column.name, column.dimension, gaps=True) for column in one.columns()}
    numbers = np.stack(list(columns.values()), axis=1) if columns else np.zeros((len(rows), 0))
    empty = np.isnan(numbers)
    wheres = [f"{table.path}, line {line}" for line in table.lines]
    some = np.flatnonzero(_labelled(robot, one, table) & ~(np.all(empty, axis=1) & (numbers.shape[1] > 0)))
    texts: dict[str, list[str]] = {}
    for name in one.text_columns():
        if name not in table.names:
            raise DataError(f"{table.path}: no column '{name}'{nearest(name, table.names)}")
        every = table.text(name)
        texts[name] = [every[k] for k in some]
    own, pairs, details = one.looked_at(texts, [wheres[k] for k in some])
    mine = np.array(own, dtype=bool)
    kept = some[mine]
    partly = np.argwhere(empty[kept])
    if len(partly):
        k, c = partly[0]
        raise DataError(
            f"{wheres[kept[k]]}, column '{list(columns)[c]}': is empty; fill it in, or leave all cells of '{one.name}'"
            " empty"
        )
    values = one.values({name: column[kept] for name, column in columns.items()})
    if not columns:  # it reads no numbers: one row stands for all
        values = np.repeat(values, len(kept), axis=0)
    numbers_of_pairs = pairs[mine] + in_setups(robot, one, _setups(robot, table))[kept]
    return Readings(rows[kept], numbers_of_pairs, values, _covariance(one, table, kept), details[mine])


def _labelled(robot: Robot, one: Instrument, table: Table) -> BoolArray:
    """Which rows the label column, if there is one, leaves to an instrument, (n_table_rows,)."""
    column = one.label_column
    if column is None:
        return np.ones(len(table.rows), dtype=bool)
    group = [other for other in robot.instruments if other.label_column == column]
    own = {c.name for c in one.columns()}
    if column not in table.names:
        sharing = [other.name for other in group if own & {c.name for c in other.columns()}]
        if len(sharing) > 1:
            raise DataError(f"{table.path}: no column '{column}', which tells {' and '.join(sharing)} apart")
        return np.ones(len(table.rows), dtype=bool)
    texts, names = table.text(column), [other.name for other in group]
    for line, text in zip(table.lines, texts, strict=True):
        if text and text not in names:
            raise DataError(f"{table.path}, line {line}, column '{column}': no {column} '{text}'{nearest(text, names)}")
    return np.array([text == one.name for text in texts], dtype=bool)


def _setups(robot: Robot, table: Table) -> IntArray:
    """The number of the setup of each row, (n_table_rows,)."""
    names = list(robot.description.setups)
    if not names:
        return np.zeros(len(table.rows), dtype=np.intp)
    if "setup" not in table.names:
        raise DataError(f"{table.path}: no column 'setup'; the description names the setups {', '.join(names)}")
    numbers = []
    for line, text in zip(table.lines, table.text("setup"), strict=True):
        if text not in names:
            raise DataError(f"{table.path}, line {line}, column 'setup': no setup '{text}'{nearest(text, names)}")
        numbers.append(names.index(text))
    return np.array(numbers, dtype=np.intp)


def _covariance(one: Instrument, table: Table, kept: IntArray) -> FloatArray | None:
    """The covariance that columns of standard deviations and correlations state; None without them."""
    names = _std_columns(one)
    present = [name for name, _ in names if name in table.names]
    if not present:
        return None
    missing = next((name for name, _ in names if name not in table.names), None)
    if missing is not None:
        raise DataError(f"{table.path}: no column '{missing}', but '{present[0]}'; give all standard deviations")
    std = np.stack([table.column(name, dimension)[kept] for name, dimension in names], axis=1)
    if np.any(std <= 0):
        k, c = np.argwhere(std <= 0)[0]
        raise DataError(
            f"{table.path}, line {table.lines[kept[k]]}, column '{names[c][0]}': a standard deviation must be positive"
        )
    correlation = np.tile(np.eye(len(names)), (len(kept), 1, 1))
    for name, (i, j) in _correlation_columns(one).items():
        if name in table.names:
            correlation[:, i, j] = correlation[:, j, i] = table.column(name, None)[kept]
    smallest = np.linalg.eigvalsh(correlation)[:, 0] if len(kept) else np.ones(0)
    if np.any(smallest <= 1e-9):
        k = int(np.argmin(smallest))
        raise DataError(f"{table.path}, line {table.lines[kept[k]]}: the correlations of '{one.name}' cannot be")
    result: FloatArray = std[:, :, None] * correlation * std[:, None, :]
    return result


def _concatenated(parts: list[Readings]) -> Readings:
    if len(parts) == 1:
        return parts[0]
    with_covariance = [part.covariance for part in parts if part.covariance is not None]
    if with_covariance and len(with_covariance) < len(parts):
        raise DataError("standard deviations are given in one file and not in another; give them in all, or in none")
    return Readings(
        np.concatenate([part.visits for part in parts]),
        np.concatenate([part.pairs for part in parts]),
        np.concatenate([part.values for part in parts]),
        np.concatenate(with_covariance) if with_covariance else None,
        np.concatenate([part.details for part in parts]),
    )
