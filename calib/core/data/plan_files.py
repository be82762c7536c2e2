"""Plans as CSV files: poses to measure, with instruments, setup and touched things.

A plan is a file of joint values. `calib select` writes one, and `calib simulate` reads one. With further columns for
readings it is a file of measurements.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from calib.core.base.arrays import BoolArray, IntArray
from calib.core.base.errors import DataError, require_known
from calib.core.data.instrument_cells import columns_in
from calib.core.data.measurement_files import read_measurements
from calib.core.data.measurements import Poses, check_repeats, setup_pairs
from calib.core.data.robot_tables import read_robot_table
from calib.core.data.table_poses import poses_of_table
from calib.core.data.tables import Source, Table
from calib.core.instruments.kind import Instrument, Readings
from calib.core.robots.robot import Robot

INSTRUMENT = "instrument"
"""Column that names the instruments to read at each pose."""
TOGETHER = "+"
"""Separator between names of instruments that read together."""


def read_plan(path: Path | str, robot: Robot) -> Poses:
    """Read joint values and the planned readings there: instruments, setup, and touched things.

    The column `instrument` names one, or several joined by `+`; an empty cell, or no such column, means all of them.
    Touched things are in the columns of the instruments that touch; without such a column they are not known. A
    `DataError` names file, line and column.
    """
    return plan_of_table(read_robot_table(path, robot), robot)


def plan_of_table(table: Table, robot: Robot) -> Poses:
    """Return the plan in a table; see `read_plan`."""
    used = {column for instrument in robot.instruments for column in columns_in(instrument, table)}
    poses, named = poses_of_table(table, robot, used), _named_instruments(robot, table)
    plan = {instrument.name: _looks(robot, instrument, table, named, poses.setups) for instrument in robot.instruments}
    stated = {name: looks for name, looks in plan.items() if looks is not None}
    if len(stated) == len(robot.instruments) and not any(len(looks) for looks in stated.values()):
        raise DataError(f"{table.path}: no row says what to read; fill in the columns of the instruments")
    return replace(poses, planned=stated)


def read_pose_files(paths: Sequence[Source], robot: Robot, table: Table | None = None) -> Poses:
    """Read poses; the result is `Measurements` if every row has a reading, or if rows repeat a pose.

    Several files are measurements that belong together; `table` is the content of a single one, if it was read before.
    `DataError` if a file is not valid, or poses that are not measured have the same name.
    """
    if len(paths) > 1:
        return read_measurements(paths, robot)
    table = read_robot_table(paths[0], robot) if table is None else table
    measured = _is_measured(table, robot)
    if np.all(measured) or (np.any(measured) and INSTRUMENT not in table.names and _repeats(table)):
        return read_measurements(paths, robot)
    poses = plan_of_table(table, robot)
    if robot.description.instruments and INSTRUMENT in table.names:  # there may be a row for each instrument
        check_repeats(poses, robot)
        return poses
    again = np.flatnonzero(np.diff(np.maximum.accumulate(poses.pose_numbers), prepend=-1) == 0)
    if len(again):
        k = int(again[0])
        raise DataError(f"{poses.labels[k]}: pose '{poses.names[k]}' is given twice; names of poses must be unique")
    return poses


def _is_measured(table: Table, robot: Robot) -> BoolArray:
    """Mask of the rows that have all cells of some instrument, (n_rows,)."""
    measured = np.zeros(len(table.rows), dtype=bool)
    for instrument in robot.instruments:
        names = [*(column.name for column in instrument.columns()), *instrument.text_columns()]
        if names and set(names) <= set(table.names):
            filled = np.ones(len(measured), dtype=bool)
            for name in names:
                filled &= np.array(table.text(name)) != ""
            measured |= filled
    return measured


def _repeats(table: Table) -> bool:
    """Whether rows repeat a pose."""
    return "pose" in table.names and len(set(table.text("pose"))) < len(table.rows)


def _named_instruments(robot: Robot, table: Table) -> list[list[str]]:
    """The instruments that each row names; none where it means all."""
    if not robot.description.instruments or INSTRUMENT not in table.names:
        return [[] for _ in table.rows]
    known = [instrument.name for instrument in robot.instruments]
    rows = [[name.strip() for name in cell.split(TOGETHER)] if cell else [] for cell in table.text(INSTRUMENT)]
    for k, names in enumerate(rows):
        for name in names:
            require_known(name, known, f"{table.where(k, INSTRUMENT)}: no instrument", DataError)
    return rows


def _looks(
    robot: Robot, instrument: Instrument, table: Table, named: list[list[str]], setups: IntArray | None
) -> Readings | None:
    """Planned readings of an instrument by the rows of a plan; None where the plan has none, or no touched thing."""
    rows = np.flatnonzero([not names or instrument.name in names for names in named])
    if instrument.columns():
        if len(rows) == len(table.rows):
            return None  # the instrument reads all that it can, as without a plan
        pairs, details = instrument.looks()
        visits, pairs, details = (
            np.repeat(rows, len(pairs)),
            np.tile(pairs, len(rows)),
            np.tile(details, (len(rows), 1)),
        )
    elif set(instrument.text_columns()) <= set(table.names):
        texts = {name: [table.text(name)[k] for k in rows] for name in instrument.text_columns()}
        belongs, pairs, details = instrument.parse_texts(texts, [table.where(k) for k in rows])
        mine = np.array(belongs, dtype=bool)
        bad = next((k for k in rows[~mine] if named[k]), None)
        if bad is not None:
            raise DataError(
                f"{table.where(bad, instrument.text_columns()[0])}: is empty, but"
                f" '{instrument.name}' is to touch something there; say what"
            )
        visits, pairs, details = rows[mine], pairs[mine], details[mine]
    else:
        return None
    shift = np.zeros(len(table.rows), dtype=np.intp) if setups is None else setup_pairs(robot, instrument, setups)
    return Readings(visits, pairs + shift[visits], np.zeros((len(visits), 0)), None, details)
