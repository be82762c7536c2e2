"""Errors and uncertainty of a robot over its workspace: a cloud of reachable positions.

Poses are drawn at random with the calibrated robot (`Robot.sample`): half of them within the joint limits, half within
the joint ranges of the measured poses, which are often a small part of the limits. Each position has two numbers: the
distance of the nominal robot from it, which calibration removes, and the standard deviation of the predicted position,
from noise and priors. Outside of the measured region this is extrapolation, and errors of the model can exceed the
standard deviation. So each point has a mark whether it lies inside: every joint within its measured range, and the
position within the convex hull of the measured positions (for a robot that moves in a plane: within their outline).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
import scipy

from calib import Robot
from calib.core.base.arrays import BoolArray, FloatArray, ReadOnlyArrays, evenly_spread
from calib.core.numerics import linalg
from viz.poses import PoseTable, PredictingRobot

SEED = 1
_ELLIPSOIDS = 40  # largest number; more would hide the robot
_CHANCE = 0.95
_FLAT = 0.01  # a hull is flat along an axis if it extends there less than this part of its largest extent


@dataclass(frozen=True, eq=False)
class WorkspaceMap(ReadOnlyArrays):
    """Errors and uncertainty over the workspace. Positions are in the measurement frame.

    Attributes:
        places: Predicted positions, (n, 3) [m].
        error: Distance of the nominal robot from them, (n,) [m]; NaN where it cannot be assembled.
        std: Standard deviation of the positions, all axes together, (n,) [m].
        is_inside: Mask of positions in the measured region, (n,).
        hull: Edges of the convex hull of measured positions, (k, 2, 3) [m].
        centres, half_axes: Ellipsoids that contain the true position with a probability of 95 % at poses of the table:
            centres, (m, 3) [m], and half axes as columns, (m, 3, 3) [m].
    """

    places: FloatArray
    error: FloatArray
    std: FloatArray
    is_inside: BoolArray
    hull: FloatArray
    centres: FloatArray
    half_axes: FloatArray


def workspace_map(calibrated: PredictingRobot, nominal: Robot, table: PoseTable, count: int) -> WorkspaceMap:
    """Return the map at `count` poses, of a calibrated robot beside the placed robot before calibration.

    Raises:
        DataError: A sliding joint has no limits, or hardly any pose can be assembled.
    """
    robot, measured_too = calibrated.robot, count // 2 if len(table) else 0
    q = robot.sample(count - measured_too, SEED)
    if measured_too:
        q = np.concatenate([q, robot.sample(measured_too, SEED, within=table.joints)])
    known = calibrated.predict(q)
    located = known.positions[:, robot.reported_targets]
    before = np.full_like(located, np.nan)
    closes = nominal.close(q).ok
    if np.any(closes):
        before[closes] = nominal.positions(q[closes])[:, robot.reported_targets]
    places = located.reshape(-1, 3)
    measured = table.measured[np.isfinite(table.measured).all(axis=1)]
    inside, edges = _are_within_hull(measured, places)
    low, high = (end(table.joints, axis=0) for end in (np.min, np.max)) if len(table) else (np.inf, -np.inf)
    centres, half_axes = _ellipsoids(calibrated, table)
    return WorkspaceMap(
        places,
        np.linalg.norm(before - located, axis=2).ravel(),
        known.reported_distance.ravel(),
        inside & np.repeat(np.all((q >= low) & (q <= high), axis=1), located.shape[1]),
        edges,
        centres,
        half_axes,
    )


def _are_within_hull(points: FloatArray, places: FloatArray) -> tuple[BoolArray, FloatArray]:
    """Mask of places (m, 3) in the hull of points (n, 3), or in their outline if these lie in a plane, and its edges.

    Returns:
        (m,), and (k, 2, 3) [m]; a hull without volume or area contains no place.
    """
    nowhere = np.zeros(len(places), dtype=bool), np.zeros((0, 2, 3))
    if not len(points):
        return nowhere
    middle = points.mean(axis=0)
    _, extents, axes = linalg.svd(points - middle, full_matrices=False)
    axes = axes[extents > _FLAT * extents[0]]
    if len(axes) < 2:
        return nowhere
    try:
        hull = scipy.spatial.Delaunay((points - middle) @ axes.T)
    except scipy.spatial.QhullError:
        return nowhere
    faces = np.sort(hull.convex_hull, axis=1)
    pairs = np.concatenate([faces[:, pair] for pair in combinations(range(faces.shape[1]), 2)])
    return hull.find_simplex((places - middle) @ axes.T) >= 0, points[np.unique(pairs, axis=0)]


def _ellipsoids(calibrated: PredictingRobot, table: PoseTable) -> tuple[FloatArray, FloatArray]:
    """Centres (m, 3) and half axes as columns (m, 3, 3) at poses spread over the table."""
    if not len(table):
        return np.zeros((0, 3)), np.zeros((0, 3, 3))
    first = np.unique(np.round(table.joints, 9), axis=0, return_index=True)[1]
    chosen = np.sort(first)[evenly_spread(len(first), _ELLIPSOIDS)]
    known = calibrated.predict(table.joints[chosen])
    sizes, axes = linalg.eigh(known.covariance.reshape(-1, 3, 3))
    reach = (
        np.sqrt(scipy.special.chdtri(3, 1 - _CHANCE)) * known.coverage_factor / scipy.special.ndtri((1 + _CHANCE) / 2)
    )
    return known.positions.reshape(-1, 3), axes * (reach * np.sqrt(np.maximum(sizes, 0.0)))[:, None, :]
