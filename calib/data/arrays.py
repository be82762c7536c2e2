"""Poses and measurements that are already in memory, checked as those of a file are."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from calib.data.measurements import Measurements, Poses, averaged, single_readings
from calib.errors import DataError
from calib.model.robot import Robot

_SOURCE = "arrays"


def as_poses(robot: Robot, poses: Poses | ArrayLike, names: Sequence[str] | None = None) -> Poses:
    """Return joint values as `Poses`, naming them by their row where they come without names.

    Args:
        robot: Whose joints they are.
        poses: Poses with names, or actuated joints alone, (n_poses, n_actuated) [m or rad].
        names: Pose names of joint values, n_poses of them.

    Raises:
        DataError: Wrong shape, values that are not finite, or a wrong number of names.
    """
    if isinstance(poses, Poses):
        return poses
    joints = robot.joint_vector(poses)
    if names is not None and len(names) != len(joints):
        raise DataError(f"names: {len(names)} for {len(joints)} poses; give one for each")
    called = tuple(str(k) for k in range(len(joints))) if names is None else tuple(str(name) for name in names)
    return Poses(joints, tuple(f"pose {name}" for name in called), called, _SOURCE, ())


def as_measurements(
    robot: Robot, poses: Poses | ArrayLike, positions: ArrayLike, names: Sequence[str] | None = None
) -> Measurements:
    """Return measured positions as `Measurements`; readings with the same pose name are averaged.

    Args:
        robot: Whose joints and targets they are.
        poses: Poses with names, or actuated joints alone, (n_readings, n_actuated) [m or rad].
        positions: Measured positions in the measurement frame, (n_readings, n_targets, 3), or (n_readings, 3) for a
            robot with one target [m].
        names: Pose name of each reading; without names, every reading is a pose of its own.

    Raises:
        DataError: Wrong shape, values that are not finite, or readings of one pose whose joint values differ.
    """
    where = as_poses(robot, poses, names)
    values = np.asarray(positions, dtype=float)
    n_targets = len(robot.target_names)
    if n_targets == 1 and values.shape == (len(where), 3):
        values = values[:, None]
    if values.shape != (len(where), n_targets, 3):
        raise DataError(
            f"positions of shape {np.shape(positions)}; expected ({len(where)}, {n_targets}, 3): a row for each pose,"
            f" the targets in the order {', '.join(robot.target_names)}"
        )
    bad = np.flatnonzero(~np.isfinite(values).all(axis=(1, 2)))
    if len(bad):
        raise DataError(f"{where.labels[bad[0]]}: positions are not finite; correct them, or leave the pose out")
    return averaged(single_readings(where, values), robot)
