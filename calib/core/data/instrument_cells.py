"""Readings of one instrument in the rows of a table: numbers, words, standard deviations, correlations."""

from __future__ import annotations

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray, IntArray
from calib.core.base.errors import DataError, require_known
from calib.core.base.units import Dimension
from calib.core.data.measurement_columns import correlation_columns, std_columns
from calib.core.data.measurements import setup_pairs
from calib.core.data.robot_tables import odd_unit
from calib.core.data.tables import Table
from calib.core.instruments.kind import Instrument, Readings
from calib.core.numerics import linalg
from calib.core.robots.robot import Robot


def named_columns(instrument: Instrument) -> list[str]:
    """Return the columns that belong to this instrument alone: its numbers, or its words if it has no numbers."""
    return [column.name for column in instrument.columns()] or list(instrument.text_columns())


def columns_in(instrument: Instrument, table: Table) -> list[str]:
    """Return the columns of a table that an instrument reads."""
    names = [column.name for column in instrument.columns()] + list(instrument.text_columns())
    names += [] if instrument.label_column is None else [instrument.label_column]
    names += [name for name, _ in std_columns(instrument)] + list(correlation_columns(instrument))
    return [name for name in names if name in table.names]


def lacking_column(name: str, robot: Robot, table: Table) -> str:
    """Return the message on a column that a table lacks; none that another joint or instrument reads is offered."""
    read = {column for instrument in robot.instruments for column in columns_in(instrument, table)}
    return table.lacks(name, read | {*robot.joint_names, "pose", "setup"})


def readings_in(
    robot: Robot, instrument: Instrument, table: Table, rows: IntArray, *, own_lines: bool = False
) -> Readings:
    """Return the readings of an instrument in the rows of a table, whose visits are `rows`, (n_table_rows,).

    `own_lines`: readings keep their file and line, because other files have the joint values. A `DataError` names file,
    line and column.
    """
    lacking = next((column.name for column in instrument.columns() if column.name not in table.names), None)
    if lacking is not None:
        hint = odd_unit(table, lacking)
        if hint is not None:
            raise DataError(f"{table.path}, {hint}")
        raise DataError(
            f"{lacking_column(lacking, robot, table)} (the robot description has '{instrument.name}': rename it there,"
            " or rename the column; 'calib init URDF --out robot.yaml' writes a description)"
        )
    columns = {column.name: table.column(column.name, column.dimension, gaps=True) for column in instrument.columns()}
    numbers = np.stack(list(columns.values()), axis=1) if columns else np.zeros((len(rows), 0))
    empty = np.isnan(numbers)
    some = np.flatnonzero(_is_labelled(robot, instrument, table) & ~(np.all(empty, axis=1) & (numbers.shape[1] > 0)))
    texts: dict[str, list[str]] = {}
    for name in instrument.text_columns():
        if name not in table.names:
            raise DataError(lacking_column(name, robot, table))
        every = table.text(name)
        texts[name] = [every[k] for k in some]
    belongs, pairs, details = instrument.parse_texts(texts, [table.where(k) for k in some])
    mine = np.array(belongs, dtype=bool)
    kept = some[mine]
    partly = np.argwhere(empty[kept])
    if len(partly):
        k, column = partly[0][0], list(columns)[partly[0][1]]
        raise DataError(
            f"{table.where(kept[k], column)}: is empty; fill it in, or leave all cells of '{instrument.name}' empty"
        )
    values = instrument.values({name: column[kept] for name, column in columns.items()})
    if not columns:  # it reads no numbers: one row of values serves all
        values = np.repeat(values, len(kept), axis=0)
    numbers_of_pairs = pairs[mine] + setup_pairs(robot, instrument, setups_of(robot, table))[kept]
    every_label = labels_of_rows(table, names_of_poses(table)) if own_lines else []
    labels = tuple(every_label[k] for k in kept) if own_lines else None
    return Readings(rows[kept], numbers_of_pairs, values, _covariance(instrument, table, kept), details[mine], labels)


def names_of_poses(table: Table) -> tuple[str, ...] | None:
    """Return the name of the pose of each row; None if the table names no poses."""
    return tuple(table.text("pose")) if "pose" in table.names else None


def labels_of_rows(table: Table, poses: tuple[str, ...] | None) -> list[str]:
    """Return the name of each row in messages: file, line, and pose if `names_of_poses` names it."""
    names = [""] * len(table.rows) if poses is None else [f" (pose {name})" for name in poses]
    return [f"{table.path}, line {line}{name}" for line, name in zip(table.lines, names, strict=True)]


def _is_labelled(robot: Robot, instrument: Instrument, table: Table) -> BoolArray:
    """Mask of an instrument's rows by its label column, (n_table_rows,); all rows without one."""
    column = instrument.label_column
    if column is None:
        return np.ones(len(table.rows), dtype=bool)
    group = [other for other in robot.instruments if other.label_column == column]
    columns = {c.name for c in instrument.columns()}
    if column not in table.names:
        sharing = [other.name for other in group if columns & {c.name for c in other.columns()}]
        if len(sharing) > 1:
            raise DataError(f"{table.path}: no column '{column}', which tells {' and '.join(sharing)} apart")
        return np.ones(len(table.rows), dtype=bool)
    texts, names = table.text(column), [other.name for other in group]
    for k, text in enumerate(texts):
        if text:
            require_known(text, names, f"{table.where(k, column)}: no {column}", DataError)
    return np.array([text == instrument.name for text in texts], dtype=bool)


def setups_of(robot: Robot, table: Table) -> IntArray:
    """Return the number of the setup of each row, (n_table_rows,).

    `DataError` if the table has no such column, or a setup that the description does not name.
    """
    names = list(robot.description.setups)
    if not names:
        return np.zeros(len(table.rows), dtype=np.intp)
    if "setup" not in table.names:
        raise DataError(f"{table.path}: no column 'setup'; the description names the setups {', '.join(names)}")
    numbers = []
    for k, text in enumerate(table.text("setup")):
        require_known(text, names, f"{table.where(k, 'setup')}: no setup", DataError)
        numbers.append(names.index(text))
    return np.array(numbers, dtype=np.intp)


def _covariance(instrument: Instrument, table: Table, kept: IntArray) -> FloatArray | None:
    """The covariance stated in columns of standard deviations and correlations; None without them."""
    names = std_columns(instrument)
    correlated = [name for name in correlation_columns(instrument) if name in table.names]
    present = [name for name, _ in names if name in table.names] + correlated
    if not present:
        return None
    missing = next((name for name, _ in names if name not in table.names), None)
    if missing is not None:
        raise DataError(
            f"{table.path}: no column '{missing}' beside '{table.header(present[0])}'; give all standard deviations, or"
            " none"
        )
    std = np.stack([_column_of_readings(instrument, table, kept, name, dimension) for name, dimension in names], axis=1)
    if np.any(std <= 0):
        k, c = np.argwhere(std <= 0)[0]
        raise DataError(f"{table.where(kept[k], names[c][0])}: a standard deviation must be positive; correct it")
    correlation = np.tile(np.eye(len(names)), (len(kept), 1, 1))
    for name in correlated:
        i, j = correlation_columns(instrument)[name]
        correlation[:, i, j] = correlation[:, j, i] = _column_of_readings(instrument, table, kept, name, None)
    smallest = linalg.eigvalsh(correlation)[:, 0] if len(kept) else np.ones(0)
    if np.any(smallest <= 1e-9):
        k = int(np.argmin(smallest))
        raise DataError(
            f"{table.where(kept[k])}: the correlations of '{instrument.name}' contradict each other; correct them"
        )
    return std[:, :, None] * correlation * std[:, None, :]


def _column_of_readings(
    instrument: Instrument, table: Table, kept: IntArray, name: str, dimension: Dimension | None
) -> FloatArray:
    """A column in the rows in which an instrument read; in the others it may be empty."""
    values: FloatArray = table.column(name, dimension, gaps=True)[kept]
    if np.any(np.isnan(values)):
        where = table.where(kept[int(np.argmax(np.isnan(values)))], name)
        raise DataError(f"{where}: is empty; fill it in, because this row has a reading of '{instrument.name}'")
    return values
