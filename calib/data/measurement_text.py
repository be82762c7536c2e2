"""Measurements, poses and positions as the text of CSV files, in mm and degrees."""

from __future__ import annotations

from calib.arrays import FloatArray
from calib.data.measurement_columns import header, shown
from calib.data.measurements import Measurements, Poses
from calib.data.tables import format_table
from calib.model.robot import Robot


def format_measurements(robot: Robot, data: Measurements, comments: tuple[str, ...] = ()) -> str:
    """Return measurements as CSV text in mm and degrees; see `calib.data.measurement_columns`."""
    return format_table(list(data.columns(robot).items()), comments)


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
    columns = poses.columns(robot)
    for suffix, numbers in (("", positions), ("std_", std)):
        for t, target in enumerate(robot.target_names):
            for a, axis in enumerate("xyz"):
                if numbers is not None:
                    columns[header(f"{target}_{suffix}{axis}", "length")] = list(shown(numbers[:, t, a], "length"))
    return format_table(list(columns.items()), comments)
