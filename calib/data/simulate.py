"""Simulated measurements: where the targets of a robot with known parameters are, plus normal noise."""

from __future__ import annotations

import numpy as np

from calib.data.measurements import Measurements, Poses, single_readings
from calib.errors import DataError, UnreachablePoseError
from calib.model.robot import Robot, describe_open


def simulate(robot: Robot, poses: Poses, sigma: float, rng: np.random.Generator) -> Measurements:
    """Return simulated measurements of a robot at its current parameter values.

    Args:
        robot: The robot that plays the truth.
        poses: Where to measure.
        sigma: Standard deviation of the noise per axis [m]; 0 for none.
        rng: Source of the noise.

    Raises:
        DataError: Sigma is not a number >= 0.
        UnreachablePoseError: A pose cannot be assembled.
    """
    if not (np.isfinite(sigma) and sigma >= 0):
        raise DataError(f"sigma {sigma:g} m: must be a number, zero or positive")
    closed = robot.close(poses.joints)
    if not np.all(closed.ok):
        raise UnreachablePoseError(describe_open(robot, poses.joints, closed, poses.labels))
    positions = robot.positions(poses.joints)
    positions = positions + sigma * rng.standard_normal(positions.shape)
    return single_readings(poses, positions)
