"""Tables of readings that belong to a table of joint values by their order, or by time, where no column `pose` says so.

Only if the robot description asks for it (`join`); what was joined is logged as a warning (logger `calib`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import DataError
from calib.core.base.words import warn_once
from calib.core.data.tables import Table
from calib.core.robots.robot import Robot
from calib.core.robots.terms.terms import condition_columns

_TIME = "time"


def join_by_pose_column(tables: Sequence[Table], robot: Robot) -> list[Table]:
    """Return tables that a column `pose` joins; it is added if the description asks to join by rows or by time.

    Raises:
        DataError: No table or several have joint values, numbers of rows differ, or there is no `time` near enough.
    """
    how, joints = robot.description.join, set(robot.commanded_names)
    if how == "pose" or len(tables) == 1:
        return list(tables)
    leaders = [table for table in tables if joints <= set(table.names)]
    if len(leaders) != 1:
        raise DataError(f"{tables[0].path}: join: {how} needs one file with joint values, not {len(leaders)}")
    every, leader = np.arange(len(leaders[0].rows)), leaders[0]
    return [
        _with_poses(table, every, every) if table is leader else _follower(table, leader, robot) for table in tables
    ]


def _follower(table: Table, leader: Table, robot: Robot) -> Table:
    """The rows of a table that belong to rows of the leader; the number of the leader's row is the pose."""
    if robot.description.join == "rows":
        if len(table.rows) != len(leader.rows):
            raise DataError(
                f"{table.path}: has {len(table.rows)} rows, and {leader.path} has {len(leader.rows)}; join: rows needs"
                " the same number"
            )
        warn_once(f"{table.path}: joined row by row with {leader.path}, as the description asks")
        return _with_poses(table, np.arange(len(table.rows)), np.arange(len(table.rows)))
    own, given = _times(table), _times(leader)
    order = np.argsort(own)
    place = np.searchsorted(own[order], given)
    pair = order[np.clip([place - 1, place], 0, len(own) - 1)]
    nearest = pair[np.argmin(np.abs(own[pair] - given), axis=0), np.arange(len(given))]
    apart, lag = np.abs(own[nearest] - given), robot.description.lag
    near = np.flatnonzero(apart <= lag)
    if len(near) == 0:
        raise DataError(
            f"{table.path}: its times are {np.min(apart):.3g} s or more from those in {leader.path}, and 'lag' allows"
            f" {lag:g} s; make their clocks agree, or give a larger 'lag' in the robot description"
        )
    warn_once(f"{table.path}: joined to {len(near)} of {len(given)} rows of {leader.path} by time, within {lag:g} s")
    return _with_poses(table, nearest[near], near)


def _times(table: Table) -> FloatArray:
    if _TIME not in table.names:
        raise DataError(f"{table.path}: no column 'time' to join by; name it so, or under 'columns' in the description")
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
