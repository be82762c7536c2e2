"""Where poses off the grid may go: between the candidates.

What lies around the robot is not known; that the candidates can be measured is. So a pose may go only as far from the
nearest candidate as candidates are from each other, both in joint space and where the targets are, and not beyond the
ranges of joints and positions that the candidates span, nor beyond the joint limits of the URDF. Candidates on a
surface keep the poses near that surface. Look at the poses before sending them all the same.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from calib.base.arrays import BoolArray, FloatArray
from calib.robots.robot import Robot

_SPACING = 95  # percentile of the candidates' distances to their nearest neighbours: a few lie apart
_ROUNDING = 1e-9  # [m, or part of a distance]


@dataclass(frozen=True, eq=False)
class Region:
    """Where poses may move.

    Attributes:
        lower, upper: Joint values, (n_actuated,) [m or rad].
        low_point, high_point: Box of all targets' positions, (3 n_targets,) [m].
        scale: What one radian of each joint is compared with, (n_actuated,).
        joints, points: Candidates: joints over `scale` (n, n_actuated), and targets (n, 3 n_targets) [m].
        joint_reach, point_reach: Largest distance from the nearest of them.
        distance: Least distance between poses, see `calib.planning.exchange.Spacing` [m].
        occupied: Points of poses already measured, from `calib.planning.selection_setting.points_of`,
            (n_measured, 3 n_targets) [m].
    """

    lower: FloatArray
    upper: FloatArray
    low_point: FloatArray
    high_point: FloatArray
    scale: FloatArray
    joints: scipy.spatial.cKDTree
    points: scipy.spatial.cKDTree
    joint_reach: float
    point_reach: float
    distance: float
    occupied: FloatArray

    def holds(self, q: FloatArray, points: FloatArray) -> BoolArray:
        """Return which poses lie in the region.

        Args:
            q: Joint values, (n, n_actuated) [m or rad].
            points: Their targets, (n, 3 n_targets) [m].

        Returns:
            (n,).
        """
        margin = _ROUNDING * np.maximum(1.0, np.abs(self.high_point))
        inside = np.all((points >= self.low_point - margin) & (points <= self.high_point + margin), axis=1)
        near = self.joints.query(q / self.scale)[0] <= self.joint_reach * (1 + _ROUNDING) + _ROUNDING
        seen_near = self.points.query(points)[0] <= self.point_reach * (1 + _ROUNDING) + _ROUNDING
        result: BoolArray = inside & near & seen_near
        return result

    def apart(self, points: FloatArray, others: FloatArray) -> BoolArray:
        """Return which points keep the least distance to other poses.

        Args:
            points: (n, 3 n_targets) [m].
            others: (n_others, 3 n_targets) [m].

        Returns:
            (n,).
        """
        if self.distance == 0:
            return np.ones(len(points), dtype=bool)
        scale = np.sqrt(points.shape[1] / 3)  # of `calib.planning.selection_setting.points_of`
        everyone = np.vstack([others / scale, self.occupied])
        gaps = np.linalg.norm(points[:, None] / scale - everyone, axis=2)
        result: BoolArray = np.min(gaps, axis=1, initial=np.inf) >= self.distance
        return result


def region_of(
    robot: Robot, joints: FloatArray, positions: FloatArray, distance: float = 0.0, occupied: FloatArray | None = None
) -> Region:
    """Return the region of candidates.

    Args:
        robot: The robot, for its joint limits.
        joints: Candidates, (n, n_actuated) [m or rad].
        positions: Their targets, (n, n_targets, 3) [m].
        distance: Least distance between poses [m].
        occupied: See `Region`.
    """
    limits = {joint.name: (joint.lower, joint.upper) for joint in robot.urdf.joints}
    lower = np.array([limits[name][0] for name in robot.joint_names])
    upper = np.array([limits[name][1] for name in robot.joint_names])
    points, scale = positions.reshape(len(positions), -1), robot.mechanism.joint_scale
    joint_tree, point_tree = scipy.spatial.cKDTree(joints / scale), scipy.spatial.cKDTree(points)
    return Region(
        np.maximum(lower, np.min(joints, axis=0)),
        np.minimum(upper, np.max(joints, axis=0)),
        np.min(points, axis=0),
        np.max(points, axis=0),
        scale,
        joint_tree,
        point_tree,
        _spacing(joint_tree),
        _spacing(point_tree),
        distance,
        np.zeros((0, points.shape[1])) if occupied is None else occupied,
    )


def _spacing(tree: scipy.spatial.cKDTree) -> float:
    """How far candidates are from their nearest neighbours; 0 for one alone."""
    if tree.n < 2:
        return 0.0
    return float(np.percentile(tree.query(tree.data, k=[2])[0], _SPACING))
