"""How a camera stands to a body whose points it sees: poses from a few points each, many views at once.

Each view is a least-squares problem in six unknowns: points of the body X_j, seen along rays m_j. It is solved from 24
orientations of the body (those of a cube), with the depth that the spread of the rays suggests, by damped Gauss-Newton
steps that all problems take together. Three points leave up to four answers and four in a plane sometimes two; views
with fewer than four points are not solved, and whoever uses a pose must expect that some are the wrong answer
(`calib.observation.camera_places`).

From many points in one frame (`resection`), the pose is found linearly instead: with rows [m]x (P X) = 0 for a matrix P
of 3 x 4 numbers, or of 3 x 3 where the points lie in a plane.

References: hartley2004, chapter 7.
"""

from __future__ import annotations

import numpy as np
import scipy

from calib.arrays import BoolArray, FloatArray, IntArray
from calib.observation.camera import project
from calib.observation.hand_eye import nearest_rotation
from calib.observation.rotations import cross_matrices

LEAST_POINTS = 4
"""Points of a view from which its pose follows."""
_PLAIN = np.array([1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])  # a camera whose pixels are m itself
_FLAT = 1e-3  # thickness over width of points that lie in a plane
_ROUNDS = 30


def cube_rotations() -> FloatArray:
    """Return the 24 rotations of a cube, (24, 3, 3)."""
    result: FloatArray = scipy.spatial.transform.Rotation.create_group("O").as_matrix()
    return result


def plane_errors(points: FloatArray, seen: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return m - m_seen of points (n, 3) [m] in the camera's frame, (n, 2), and its derivative by these, (n, 2, 3)."""
    plane, by_point, _ = project(points, _PLAIN)
    return plane - seen, by_point


def view_poses(points: FloatArray, seen: FloatArray, view: IntArray, n_views: int) -> tuple[FloatArray, FloatArray]:
    """Return the pose of the body in each view and its error per ray; inf where it was not solved.

    Args:
        points: In the body's frame, (n, 3) [m].
        seen: Their rays m, (n, 2).
        view: View of each, (n,).
        n_views: Number of views.

    Returns:
        Poses (n_views, 4, 4) [m], root mean square errors of m (n_views,).
    """
    counts = np.bincount(view, minlength=n_views)
    order = np.argsort(view, kind="stable")
    width = int(counts.max(initial=1))
    body, rays_, there = np.zeros((n_views, width, 3)), np.zeros((n_views, width, 2)), np.zeros((n_views, width), bool)
    place = np.arange(len(view)) - np.repeat(np.cumsum(counts) - counts, counts)
    body[view[order], place], rays_[view[order], place] = points[order], seen[order]
    there[view[order], place] = True
    starts = cube_rotations()
    k = len(starts)
    body, rays_, there = (np.repeat(array, k, axis=0) for array in (body, rays_, there))
    poses = _first_poses(body, rays_, there, np.tile(starts, (n_views, 1, 1)))
    poses, miss = _settled(poses, body, rays_, there)
    miss = miss.reshape(n_views, k)
    best = np.argmin(miss, axis=1)
    found = poses.reshape(n_views, k, 4, 4)[np.arange(n_views), best]
    error = np.sqrt(miss[np.arange(n_views), best] / np.maximum(counts, 1))
    return found, np.where(counts >= LEAST_POINTS, error, np.inf)


def _first_poses(body: FloatArray, seen: FloatArray, there: BoolArray, turned: FloatArray) -> FloatArray:
    """Poses at the depth that the spread of the rays suggests."""
    n = np.maximum(np.sum(there, axis=1), 1)[:, None]
    middle = np.sum(body * there[:, :, None], axis=1) / n
    ray = np.sum(seen * there[:, :, None], axis=1) / n
    size = np.sqrt(np.sum(((body - middle[:, None]) * there[:, :, None]) ** 2, axis=(1, 2)))
    spread = np.sqrt(np.sum(((seen - ray[:, None]) * there[:, :, None]) ** 2, axis=(1, 2)))
    depth = 0.8 * size / np.maximum(spread, 1e-9)
    poses = np.tile(np.eye(4), (len(body), 1, 1))
    poses[:, :3, :3] = turned
    ahead = np.hstack([ray, np.ones((len(ray), 1))]) * depth[:, None]
    poses[:, :3, 3] = ahead - np.einsum("kab,kb->ka", turned, middle)
    return poses


def _errors(poses: FloatArray, body: FloatArray, seen: FloatArray, there: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Errors (n, 2 width) and their derivative by [dp; dw] of the body's pose, (n, 2 width, 6)."""
    n, width = there.shape
    turned = np.einsum("kab,kjb->kja", poses[:, :3, :3], body)
    errors, by_point = plane_errors((turned + poses[:, None, :3, 3]).reshape(-1, 3), seen.reshape(-1, 2))
    by_pose = np.concatenate([by_point, -by_point @ cross_matrices(turned.reshape(-1, 3))], axis=2)
    weight = there.reshape(-1, 1).astype(float)
    return (errors * weight).reshape(n, 2 * width), (by_pose * weight[:, :, None]).reshape(n, 2 * width, 6)


def _settled(poses: FloatArray, body: FloatArray, seen: FloatArray, there: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Poses after damped Gauss-Newton steps, and their squared errors (n,)."""
    damping = np.full(len(poses), 1e-3)
    errors, by_pose = _errors(poses, body, seen, there)
    cost = np.sum(errors**2, axis=1)
    for _ in range(_ROUNDS):
        square = by_pose.transpose(0, 2, 1) @ by_pose
        pull = by_pose.transpose(0, 2, 1) @ errors[:, :, None]
        diagonal = np.diagonal(square, axis1=1, axis2=2)
        added = damping[:, None] * diagonal + 1e-12 * np.max(diagonal, axis=1, keepdims=True) + 1e-300
        step = -np.linalg.solve(square + added[:, :, None] * np.eye(6), pull)[:, :, 0]
        tried = poses.copy()
        tried[:, :3, :3] = scipy.spatial.transform.Rotation.from_rotvec(step[:, 3:]).as_matrix() @ poses[:, :3, :3]
        tried[:, :3, 3] += step[:, :3]
        new_errors, new_by_pose = _errors(tried, body, seen, there)
        new_cost = np.sum(new_errors**2, axis=1)
        better = new_cost < cost
        poses = np.where(better[:, None, None], tried, poses)
        errors = np.where(better[:, None], new_errors, errors)
        by_pose = np.where(better[:, None, None], new_by_pose, by_pose)
        cost = np.where(better, new_cost, cost)
        damping = np.clip(np.where(better, damping / 5.0, damping * 5.0), 1e-12, 1e12)
    return poses, cost


def resection(points: FloatArray, seen: FloatArray) -> list[FloatArray]:
    """Return poses of a frame in the camera's, (4, 4) [m] each, in which points (n, 3) lie along rays (n, 2).

    Fewer than six points, or four in a plane, give none.
    """
    middle = points.mean(axis=0)
    _, size, axes = np.linalg.svd(points - middle, full_matrices=False)
    scale = float(np.sqrt(np.mean(np.sum((points - middle) ** 2, axis=1)))) or 1.0
    if len(points) < LEAST_POINTS or len(size) < 3 or size[1] < _FLAT * size[0]:
        return []
    axes = axes * np.sign(np.linalg.det(axes))
    local = (points - middle) @ axes.T / scale
    found = [_from_plane(local[:, :2], seen)]
    if size[2] > _FLAT * size[0] and len(points) >= 6:
        found.append(_from_space(local, seen))
    result: list[FloatArray] = []
    for rotation, translation in found:
        pose: FloatArray = np.eye(4)
        pose[:3, :3] = rotation @ axes
        pose[:3, 3] = scale * translation - pose[:3, :3] @ middle
        result.append(pose)
    return result


def _smallest(seen: FloatArray, numbers: FloatArray) -> FloatArray:
    """The matrix P (3, k) of which |[m]x (P X)|^2 is smallest, with P X in front of the camera; X (n, k)."""
    n, k = numbers.shape
    rows = np.zeros((n, 2, 3, k))
    rows[:, 0, 0], rows[:, 0, 2] = numbers, -seen[:, :1] * numbers
    rows[:, 1, 1], rows[:, 1, 2] = numbers, -seen[:, 1:] * numbers
    matrix: FloatArray = np.linalg.svd(rows.reshape(2 * n, 3 * k), full_matrices=False)[2][-1].reshape(3, k)
    return matrix * (np.sign(np.sum(numbers @ matrix[2])) or 1.0)


def _from_space(local: FloatArray, seen: FloatArray) -> tuple[FloatArray, FloatArray]:
    matrix = _smallest(seen, np.hstack([local, np.ones((len(local), 1))]))
    size = np.cbrt(np.linalg.det(matrix[:, :3]))
    if size <= 0:  # a mirror image: rounding or noise decides; the nearest rotation is as good as any
        size = float(np.mean(np.linalg.svd(matrix[:, :3])[1]))
    return nearest_rotation(matrix[:, :3]), matrix[:, 3] / max(float(size), 1e-12)


def _from_plane(local: FloatArray, seen: FloatArray) -> tuple[FloatArray, FloatArray]:
    matrix = _smallest(seen, np.hstack([local, np.ones((len(local), 1))]))
    size = max(float(np.mean(np.linalg.norm(matrix[:, :2], axis=0))), 1e-12)
    x, y = matrix[:, 0] / size, matrix[:, 1] / size
    return nearest_rotation(np.stack([x, y, np.cross(x, y)], axis=1)), matrix[:, 2] / size
