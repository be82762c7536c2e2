"""Files of poses, as commands of several capabilities use them: each pose once, and targets placed by measurements."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.core.base.arrays import BoolArray, IntArray
from calib.core.data.measurements import Measurements, Poses
from calib.core.instruments.kind import Readings
from calib.core.robots.robot import Robot
from calib.core.rows.registration import register


def different_poses(poses: Poses) -> Poses:
    """Return each pose once, in the order of first visits, with its planned readings in the setup of that visit."""
    numbers = poses.pose_numbers
    if poses.n_poses == len(poses):
        return poses
    first = np.unique(numbers, return_index=True)[1]
    setups = np.zeros(len(poses), dtype=np.intp) if poses.setups is None else poses.setups
    same_setup = setups == setups[first][numbers]
    plan = {name: _each_once(readings, numbers, same_setup) for name, readings in poses.planned.items()}
    return replace(poses.subset(first), planned=plan)


def _each_once(readings: Readings, numbers: IntArray, counts: BoolArray) -> Readings:
    """Planned readings of the visits that count, each once, with the visits' new numbers (n,)."""
    looks = np.column_stack([numbers[readings.visits], readings.pairs, readings.details, counts[readings.visits]])
    kept = np.sort(np.unique(looks, axis=0, return_index=True)[1])
    kept = kept[counts[readings.visits[kept]]]
    return Readings(
        numbers[readings.visits[kept]], readings.pairs[kept], readings.values[kept], None, readings.details[kept]
    )


def place_by_files(robot: Robot, *files: Poses | None) -> Robot:
    """Place an unknown base or unknown targets by the first file with measured positions, if any.

    The information of poses depends on the place of the targets.
    """
    if not any(parameter.placement for parameter in robot.parameters):
        return robot
    data = next((poses for poses in files if isinstance(poses, Measurements)), None)
    return robot if data is None else register(robot, data)
