"""A simulated laser tracker: it stands somewhere, sees points with noise, and finds the world from three nests.

The world is the rigid motion q_i = R p_i + t of the nests p_i that the tracker sees onto their places q_i.

Uncertainty. A small change [dt; w], R -> R exp(w), moves point i by J_i [dt; w], J_i = [I  -R [p_i]x]; with noise sigma
on each component the covariance of [dt; w] is sigma^2 (sum J_i^T J_i)^-1, w in the tracker's axes.

Outliers. With H = J (J^T J)^-1 J^T, leaving nest i out lowers the sum of squares by d_i = r_i^T (I - H_ii)^+ r_i. Over
sigma^2 this is chi-square with rank(I - H_ii) degrees of freedom. The most surprising nest is named, if any: two
distances must agree before the third can be doubted, so that three nests never show more.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
import scipy

from calib.core.base.arrays import FloatArray
from calib.core.numerics import linalg
from calib.core.numerics.rigid import best_transform, cross_matrices

SIGMA = 4e-5
"""Noise of one reading on each axis: the paper's tracker is good to +-40 um [m]."""
REPEATS = 5
"""Readings of each nest and of each pose, averaged."""
NESTS = {
    "nest at the origin": np.array([0.0, 0.0, 0.0]),
    "nest along x": np.array([0.9, 0.0, 0.0]),
    "nest along z": np.array([0.0, 0.0, 0.5]),
}
"""Nests on the robot's frame, in the world [m]."""
PLACE = pin.SE3(pin.rpy.rpyToMatrix(0.02, -0.03, 2.4), np.array([0.4, 2.6, 0.9]))
"""Where the tracker stands: its frame in the world. Only the simulation knows it."""
OUTLIER_PROBABILITY = 0.01
"""Chance that a nest is reported although all of them fit."""


@dataclass(frozen=True, eq=False)
class World:
    """The world as a tracker finds it: `p_world = rotation p_tracker + translation`.

    Attributes:
        rotation: (3, 3).
        translation: (3,) [m].
        covariance: Covariance of [dt; w], (6, 6) [m, rad].
        outliers: Name of a nest that does not fit, if any.
    """

    rotation: FloatArray
    translation: FloatArray
    covariance: FloatArray
    outliers: tuple[str, ...]


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


def measure(points: FloatArray, generator: np.random.Generator) -> TrackerPoints:
    """Measure points in the world, (n, 3) [m], with noise from a generator."""
    world = find_world(_read(np.array(list(NESTS.values())), generator).mean(axis=1))
    readings = _read(points, generator)
    seen = readings.mean(axis=1)
    slope = _slope(world.rotation, seen)
    variances = np.einsum("nij,jk,nik->ni", slope, world.covariance, slope)
    return TrackerPoints(
        seen @ world.rotation.T + world.translation,
        float(np.sqrt(np.mean(np.var(readings, axis=1, ddof=1)))),
        world.outliers,
        float(np.sqrt(variances.max())),
    )


def _read(points: FloatArray, generator: np.random.Generator) -> FloatArray:
    """Noisy readings in the tracker's frame, (n, REPEATS, 3) [m]."""
    exact = (points - PLACE.translation) @ PLACE.rotation
    return np.asarray(exact[:, None, :] + generator.normal(0.0, SIGMA, (len(points), REPEATS, 3)))


def find_world(nests: FloatArray) -> World:
    """Find the world from the nests as the tracker sees them, their readings averaged, (3, 3) [m]."""
    places, variance = np.array(list(NESTS.values())), SIGMA**2 / REPEATS
    rotation, translation = best_transform(nests, places)
    slope = _slope(rotation, nests)
    inverse = np.linalg.inv(np.einsum("nij,nik->jk", slope, slope))
    chances = []
    for r, J in zip(places - (nests @ rotation.T + translation), slope, strict=True):
        values, vectors = linalg.eigh(np.eye(3) - J @ inverse @ J.T)
        free = values > 1e-9
        drop = float(np.sum((vectors.T @ r)[free] ** 2 / values[free]))
        chances.append(float(scipy.special.chdtrc(int(free.sum()), drop / variance)))
    least = int(np.argmin(chances))
    surprising = chances[least] < OUTLIER_PROBABILITY / len(NESTS)
    return World(rotation, translation, variance * inverse, (list(NESTS)[least],) if surprising else ())


def _slope(rotation: FloatArray, points: FloatArray) -> FloatArray:
    """J_i of the module docstring, (n, 3, 6)."""
    return np.concatenate([np.tile(np.eye(3), (len(points), 1, 1)), -rotation @ cross_matrices(points)], axis=2)
