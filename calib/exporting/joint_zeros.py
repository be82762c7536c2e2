"""The joint zeros that bring the nominal model nearest to a robot without a fit.

The nominal model is fitted to positions that the robot predicts, by the same method as the zeros of a fit's files
(`calib.core.calibrating.file_robots`). Free are the zeros, and base and targets if the description calls them unknown.
Errors that base or target can explain as well as a zero are left to base or target.

When it fails. Poses at which loops of the nominal model do not close are dropped.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.calibrating.file_robots import with_zeros
from calib.core.data.in_memory import as_measurements
from calib.core.data.measurements import Measurements
from calib.core.fitting.fit import fit_data
from calib.core.fitting.settings import Settings
from calib.core.instruments.position import Position, PositionSection
from calib.core.robots.accuracy_of_files import Holds
from calib.core.robots.joint_errors import actual_joints, term_columns
from calib.core.robots.robot import Robot
from calib.core.robots.robot_files import without_terms
from calib.core.rows.registration import register

_EXACT = 1e-9  # noise of predicted positions [m]: so small that priors decide only what positions leave open
_NOTHING = 1e-12  # smaller offsets are zero [m or rad]


@dataclass(frozen=True, eq=False)
class JointZeros:
    """Joint zeros, and the errors that remain with them.

    Attributes:
        signs: 1, or -1 for a joint that counts the other way, (n_joints,).
        offsets: Offsets in sign * q + offset, (n_joints,) [m or rad].
        errors, errors_before: Error of each target with and without these zeros, (n_poses, n_targets) [m], without
            poses at which the loops of either robot do not close.
    """

    signs: FloatArray
    offsets: FloatArray
    errors: FloatArray
    errors_before: FloatArray


def joint_zeros(robot: Robot, q: FloatArray, *, fitted: float = 1.0) -> JointZeros:
    """Return the joint zeros that bring the nominal robot nearest to `robot`.

    Args:
        robot: The robot, with its current values.
        q: Poses, (n, n_joints) [m or rad].
        fitted: Part of the poses (0 to 1, from the first on) from which the offsets are found.
    """
    positions = robot.positions(q)
    actual = actual_joints(robot, q, term_columns(robot, q))[:, : q.shape[1]]
    signs = np.where(np.sum((q - q.mean(axis=0)) * (actual - actual.mean(axis=0)), axis=0) < 0, -1.0, 1.0)
    reading = tuple(Position.from_section(name, PositionSection(kind="position")) for name in robot.target_names)
    plain = replace(without_terms(robot, Holds.ZEROS).with_nominal_values(), instruments=reading)
    some = np.flatnonzero(plain.close(signs * q).ok)[: int(np.ceil(fitted * len(q)))]
    found = fit_data(with_zeros(plain), Settings(sigma=_EXACT), _read(plain, signs * q[some], positions[some])).robot
    offsets = found.values[found.coefficients]
    offsets = np.where(np.abs(offsets) < _NOTHING, 0.0, offsets)
    return JointZeros(signs, offsets, _errors(plain, signs * q + offsets, positions), _errors(plain, q, positions))


def _read(robot: Robot, q: FloatArray, positions: FloatArray) -> Measurements:
    return as_measurements(robot, q, {name: positions[:, k] for k, name in enumerate(robot.target_names)})


def _errors(plain: Robot, q: FloatArray, positions: FloatArray) -> FloatArray:
    """Error of each target after placing base and targets for these poses, (n_closed, n_targets) [m]."""
    closes = plain.close(q).ok
    placed = register(plain, _read(plain, q[closes], positions[closes]))
    return np.linalg.norm(placed.positions(q[closes]) - positions[closes], axis=2)
