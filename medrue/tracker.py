"""A simulated laser tracker: it stands somewhere, sees points with noise, and finds the world from three nests."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from calib.core.base.arrays import FloatArray
from medrue.world_frame import rigid_fit

SIGMA = 4e-5
"""Noise of one reading on each axis: the paper's tracker is good to +-40 um [m]."""
REPEATS = 5
"""Readings of each pose, averaged."""
NESTS = np.array([[0.0, 0.0, 0.0], [0.9, 0.0, 0.0], [0.0, 0.0, 0.5]])
"""Nests on the robot's frame, in the world [m]."""
NEST_NAMES = ("nest at the origin", "nest along x", "nest along z")
PLACE = pin.SE3(pin.rpy.rpyToMatrix(0.02, -0.03, 2.4), np.array([0.4, 2.6, 0.9]))
"""Where the tracker stands: its frame in the world. Only the simulation knows it."""


@dataclass(frozen=True, eq=False)
class TrackerPoints:
    """Points as the tracker saw them, transformed to the world.

    Attributes:
        positions: Mean of the repeats, in the world, (n, 3) [m].
        repeatability: Standard deviation of one reading about its point's mean, per axis [m].
        nest_outliers: Names of nests that do not fit.
        frame_sigma: Largest standard deviation that the world's uncertainty gives to a coordinate of the points [m].
    """

    positions: FloatArray
    repeatability: float
    nest_outliers: tuple[str, ...]
    frame_sigma: float


def measure(points: FloatArray, sigma: float, repeats: int, generator: np.random.Generator) -> TrackerPoints:
    """Measure points.

    Args:
        points: Points in the world, (n, 3) [m].
        sigma: Noise of one reading on each axis [m].
        repeats: Readings of each nest and each point, to be averaged.
        generator: Source of the noise.
    """
    nests = _seen(NESTS, sigma, repeats, generator).mean(axis=1)
    world = rigid_fit(nests, NESTS, sigma / np.sqrt(repeats) if sigma else None)
    readings = _seen(points, sigma, repeats, generator)
    positions = world.apply(readings.mean(axis=1))
    scatter = float(np.sqrt(np.mean(np.var(readings, axis=1, ddof=1)))) if repeats > 1 else float("nan")
    outliers = tuple(NEST_NAMES[k] for k in world.outliers)
    variances = np.diagonal(world.point_covariance(readings.mean(axis=1)), axis1=1, axis2=2)
    return TrackerPoints(positions, scatter, outliers, float(np.sqrt(variances.max())))


def _seen(points: FloatArray, sigma: float, repeats: int, generator: np.random.Generator) -> FloatArray:
    """Noisy readings in the tracker's frame, (n, repeats, 3) [m]."""
    exact = (points - PLACE.translation) @ PLACE.rotation
    return np.asarray(exact[:, None, :] + generator.normal(0.0, sigma, (len(points), repeats, 3)))
