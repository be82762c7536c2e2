"""Measurements: joint values of each pose and where the targets were seen."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from calib.errors import DataError
from calib.model.mechanism import FloatArray, IntArray
from calib.model.robot import Robot
from calib.read_only import ReadOnlyArrays
from calib.units import DISPLAY_UNIT, PER_SI, Dimension

_JOINTS_AGREE: dict[Dimension, float] = {"length": 1e-3, "angle": 2e-3}
"""Largest spread of a joint among repeats of one pose [m, rad]; more means that they are different poses."""
_MOVED = 1e-4  # change of a joint between two rows that counts as motion [m, rad]


@dataclass(frozen=True, eq=False)
class Poses(ReadOnlyArrays):
    """Joint values of a list of poses.

    Attributes:
        joints: Actuated joints in the robot's order, (n_poses, n_actuated) [m or rad].
        labels: What to call each pose in messages: file, line and pose name.
        names: The pose names of the file, or their running number.
        path: Where they came from.
        ignored: Columns of the file that nothing was read from.
        comments: What the file says about itself, line by line.
    """

    joints: FloatArray
    labels: tuple[str, ...]
    names: tuple[str, ...]
    path: str
    ignored: tuple[str, ...]
    comments: tuple[str, ...] = field(default=(), kw_only=True)

    def __len__(self) -> int:
        return len(self.joints)


@dataclass(frozen=True, eq=False)
class Measurements(Poses):
    """Poses with measured positions; repeats of a pose are already averaged.

    Attributes:
        positions: Mean measured positions in the measurement frame, (n_poses, n_targets, 3) [m].
        counts: How many readings each mean is of, (n_poses,).
        scatter: Standard deviation of the repeats about their mean, (n_poses, n_targets, 3) [m]; NaN without repeats,
            and where their joint values differ until `at_mean_joints` has told their motion from their scatter.
        readings: The readings of each pose, (counts[k], n_targets, 3) [m] each; empty where they are not known.
        approach: Direction in which each joint moved last before the pose was measured, +1 or -1, 0 where not known,
            and the mean over repeats, (n_poses, n_actuated). If not given: from the order of the poses.
        order: Place of each pose in the order of measurement, counted from 0, (n_poses,). If not given: as they stand.
        reading_joints: Joint values of each reading, (counts[k], n_actuated) [m or rad] each, where they differ among
            the repeats of a pose; else empty.
    """

    positions: FloatArray
    counts: IntArray
    scatter: FloatArray
    readings: tuple[FloatArray, ...] = ()
    approach: FloatArray | None = None
    order: IntArray | None = None
    reading_joints: tuple[FloatArray, ...] = ()

    @property
    def n_rows(self) -> int:
        """Number of readings, repeats counted one by one."""
        return int(self.counts.sum())

    @property
    def approach_directions(self) -> FloatArray:
        """`approach`, from the order of the poses where it is not given, (n_poses, n_actuated)."""
        return directions_of_motion(self.joints) if self.approach is None else self.approach

    @property
    def places(self) -> IntArray:
        """`order`, the poses as they stand where it is not given, (n_poses,)."""
        return np.arange(len(self)) if self.order is None else self.order

    def subset(self, index: IntArray) -> Measurements:
        """Return the poses with these indices (n,), in this order."""
        return replace(
            self,
            order=self.places[index],
            readings=tuple(self.readings[i] for i in index) if self.readings else (),
            reading_joints=tuple(self.reading_joints[i] for i in index) if self.reading_joints else (),
            approach=self.approach_directions[index],
            joints=self.joints[index],
            positions=self.positions[index],
            counts=self.counts[index],
            scatter=self.scatter[index],
            labels=tuple(self.labels[i] for i in index),
            names=tuple(self.names[i] for i in index),
        )

    def at_mean_joints(self, slope: FloatArray) -> Measurements:
        """Return the same with each reading moved to its pose's mean joint values, x - slope (q - mean q).

        What is left is scatter: repeats whose encoders differ are off by what the robot moved, too.

        Args:
            slope: d(position)/d(actuated joint) at the mean joints, (n_poses, n_targets, 3, n_actuated).
        """
        if not self.reading_joints:
            return self
        readings = tuple(
            seen - np.einsum("taj,rj->rta", by_joint, joints - joints.mean(axis=0))
            for seen, joints, by_joint in zip(self.readings, self.reading_joints, slope, strict=True)
        )
        return replace(self, readings=readings, reading_joints=(), scatter=np.array([_scatter(r) for r in readings]))

    def repeatability(self) -> float:
        """Return the pooled standard deviation of one reading about its pose's mean, per axis [m].

        NaN without repeats, and where their joint values differ: then ask the measurements that a fit holds
        (`fit.identification.data`), which knows how far the robot moved between them.
        """
        repeated = self.counts > 1
        if not np.any(repeated):
            return float("nan")
        freedom = self.counts[repeated] - 1
        squares = np.mean(self.scatter[repeated] ** 2, axis=(1, 2))
        return float(np.sqrt(np.sum(freedom * squares) / np.sum(freedom)))


def directions_of_motion(joints: FloatArray) -> FloatArray:
    """Return the direction in which each joint moved last before each pose: +1, -1, or 0 before its first motion.

    A joint that stands still keeps its direction: that is what backlash depends on.

    Args:
        joints: Joint values in the order of measurement, (n_poses, n_actuated) [m or rad].
    """
    steps = np.diff(joints, axis=0, prepend=joints[:1])
    direction = np.where(np.abs(steps) > _MOVED, np.sign(steps), 0.0)
    rows = np.where(direction != 0, np.arange(len(joints))[:, None], 0)
    last_moved = np.maximum.accumulate(rows, axis=0)
    result: FloatArray = np.take_along_axis(direction, last_moved, axis=0)
    return result


def _scatter(readings: FloatArray) -> FloatArray:
    """Standard deviation of readings (n, n_targets, 3) about their mean, (n_targets, 3); NaN of one."""
    result: FloatArray = readings.std(axis=0, ddof=1) if len(readings) > 1 else np.full(readings.shape[1:], np.nan)
    return result


def single_readings(poses: Poses, positions: FloatArray) -> Measurements:
    """Return one reading of each pose as measurements.

    Args:
        poses: Where they were taken.
        positions: Measured positions in the measurement frame, (n_poses, n_targets, 3) [m].
    """
    return Measurements(
        poses.joints,
        poses.labels,
        poses.names,
        poses.path,
        poses.ignored,
        positions,
        np.ones(len(poses), dtype=np.intp),
        np.full(positions.shape, np.nan),
        comments=poses.comments,
    )


def averaged(single: Measurements, robot: Robot) -> Measurements:
    """Average single readings that share a pose name, keeping the order in which the names first appear.

    Args:
        single: Of `single_readings`.
        robot: Names the joints.

    Raises:
        DataError: Readings with the same pose name have different joint values.
    """
    groups: dict[str, list[int]] = {}
    for row, name in enumerate(single.names):
        groups.setdefault(name, []).append(row)
    if len(groups) == len(single):
        return single
    rows_of = [np.array(rows, dtype=np.intp) for rows in groups.values()]
    for name, rows in zip(groups, rows_of, strict=True):
        _require_one_pose(single, robot, name, rows)
    directions = directions_of_motion(single.joints)
    readings = tuple(single.positions[rows] for rows in rows_of)
    own_joints = tuple(single.joints[rows] for rows in rows_of)
    moved = np.array([bool(np.any(np.ptp(joints, axis=0) > 0)) for joints in own_joints])
    scatter = np.array([_scatter(seen) for seen in readings])
    scatter[moved] = np.nan
    first = [int(rows[0]) for rows in rows_of]
    return replace(
        single,
        joints=np.array([joints.mean(axis=0) for joints in own_joints]),
        positions=np.array([seen.mean(axis=0) for seen in readings]),
        scatter=scatter,
        counts=np.array([len(rows) for rows in rows_of], dtype=np.intp),
        labels=tuple(single.labels[i] for i in first),
        names=tuple(groups),
        readings=readings,
        reading_joints=own_joints if np.any(moved) else (),
        approach=np.array([directions[rows].mean(axis=0) for rows in rows_of]),
    )


def _require_one_pose(single: Measurements, robot: Robot, name: str, rows: IntArray) -> None:
    """Raise `DataError` where the joint values of rows that share a pose name differ by more than encoders do."""
    spread = np.ptp(single.joints[rows], axis=0)
    limits = np.array([_JOINTS_AGREE[robot.mechanism.dimensions[joint]] for joint in robot.joint_names])
    if np.any(spread > limits):
        joint = int(np.argmax(spread / limits))
        dimension = robot.mechanism.dimensions[robot.joint_names[joint]]
        unit = DISPLAY_UNIT[dimension]
        raise DataError(
            f"{single.labels[rows[0]]}: joint '{robot.joint_names[joint]}' differs by"
            f" {spread[joint] * PER_SI[dimension][unit]:.3g} {unit} among the rows of pose '{name}';"
            " rows with the same pose value must repeat one pose"
        )
