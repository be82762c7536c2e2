"""Poses and measurements as CSV files, checked at the door: every mistake is named by file, line and column."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from calib.data.measurements import Measurements, Poses, averaged, single_readings
from calib.data.tables import Table, format_table, read_table
from calib.errors import DataError
from calib.model.mechanism import FloatArray
from calib.model.robot import Robot
from calib.units import DISPLAY_UNIT, PER_SI


def read_poses(path: Path | str, robot: Robot) -> Poses:
    """Read joint values; one column for each actuated joint, other columns are ignored.

    Raises:
        DataError: The message names file, line and column.
    """
    table = read_table(path, robot.description.columns)
    return _poses(table, robot, used=set(robot.joint_names) | {"pose"})


def read_measurements(path: Path | str, robot: Robot) -> Measurements:
    """Read joint values and measured positions; rows with the same `pose` are averaged.

    Raises:
        DataError: The message names file, line and column.
    """
    table = read_table(path, robot.description.columns)
    measured = [f"{name}_{axis}" for name in robot.target_names for axis in "xyz"]
    poses = _poses(table, robot, used=set(robot.joint_names) | set(measured) | {"pose"})
    positions = np.stack([table.column(name, "length") for name in measured], axis=1)
    positions = positions.reshape(len(poses), len(robot.target_names), 3)
    single = single_readings(poses, positions)
    return averaged(single, robot) if "pose" in table.names else single


def format_measurements(
    robot: Robot,
    poses: Poses,
    positions: FloatArray,
    comments: tuple[str, ...] = (),
    std: FloatArray | None = None,
) -> str:
    """Return CSV text in mm and degrees.

    Args:
        robot: Names joints and targets.
        poses: Joint values.
        positions: (n_poses, n_targets, 3) [m].
        comments: Lines to put first.
        std: Standard deviation of each coordinate, (n_poses, n_targets, 3) [m], in columns `<target>_std_x` ...
    """
    columns: list[tuple[str, list[object]]] = [("pose", list(poses.names))]
    for j, name in enumerate(robot.joint_names):
        unit = DISPLAY_UNIT[robot.mechanism.dimensions[name]]
        scale = PER_SI[robot.mechanism.dimensions[name]][unit]
        # 15 digits: 30 degrees come out as 30, not as what the way through radians leaves of them
        columns.append((f"{name} [{unit}]", [float(f"{value:.15g}") for value in poses.joints[:, j] * scale]))
    for t, target in enumerate(robot.target_names):
        for a, axis in enumerate("xyz"):
            columns.append((f"{target}_{axis} [mm]", list(positions[:, t, a] * 1e3)))
    for t, target in enumerate(robot.target_names):
        for a, axis in enumerate("xyz"):
            if std is not None:
                columns.append((f"{target}_std_{axis} [mm]", list(std[:, t, a] * 1e3)))
    return format_table(columns, comments)


def _poses(table: Table, robot: Robot, used: set[str]) -> Poses:
    joints = np.stack([table.column(name, robot.mechanism.dimensions[name]) for name in robot.joint_names], axis=1)
    named = "pose" in table.names
    if named and "" in table.text("pose"):
        line = table.lines[table.text("pose").index("")]
        raise DataError(f"{table.path}, line {line}, column 'pose': is empty; name the pose, or leave the column out")
    names = tuple(table.text("pose")) if named else tuple(str(k + 1) for k in range(len(table.rows)))
    labels = tuple(
        f"{table.path}, line {line}" + (f" (pose {name})" if named else "")
        for line, name in zip(table.lines, names, strict=True)
    )
    ignored = tuple(name for name in table.names if name not in used)
    return Poses(joints, labels, names, table.path, ignored, comments=table.comments)
