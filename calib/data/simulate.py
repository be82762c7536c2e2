"""Simulated measurements: where the targets of a robot with known parameters are, plus normal noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from calib.data.arrays import as_poses
from calib.data.measurements import Measurements, Poses, single_readings
from calib.errors import DataError
from calib.model.robot import Robot


def simulate(robot: Robot, poses: Poses | ArrayLike, sigma: float, rng: np.random.Generator) -> Measurements:
    """Return simulated measurements of a robot at its current parameter values.

    Args:
        robot: The robot that plays the truth.
        poses: Where to measure: poses, or joint values alone, (n, n_actuated) [m or rad].
        sigma: Standard deviation of the noise per axis [m]; 0 for none.
        rng: Source of the noise.

    Raises:
        DataError: Sigma is not a number >= 0.
        UnreachablePoseError: A pose cannot be assembled.
    """
    if not (np.isfinite(sigma) and sigma >= 0):
        raise DataError(f"sigma {sigma:g} m: must be a number, zero or positive")
    where = as_poses(robot, poses)
    robot.assemble(where.joints, labels=where.labels)  # says which pose cannot be
    positions = robot.positions(where.joints)
    positions = positions + sigma * rng.standard_normal(positions.shape)
    said = (f"simulated measurements of {robot.name}", f"normal noise, sigma {1e3 * sigma:g} mm per axis")
    return single_readings(replace(where, comments=said), positions)
