"""A camera: from points in its frame to pixels and back, with derivatives; and poses of bodies from their pixels.

The camera's frame has its origin in the centre of projection, z along the optical axis, x to the right and y down in
the image, as OpenCV has it. With m = (x / z, y / z) and r^2 = |m|^2,

    d = m (1 + k1 r^2 + k2 r^4 + k3 r^6) + (2 p1 m_x m_y + p2 (r^2 + 2 m_x^2),  p1 (r^2 + 2 m_y^2) + 2 p2 m_x m_y)
    u = fx d_x + cx,        v = fy d_y + cy

The order of intrinsics is fx fy cx cy k1 k2 p1 p2 k3. Pixels are counted as OpenCV does: the centre of the first one is
at (0, 0).

A solver may try a camera with a point outside of its view or behind it, where there is no image. So that it can return,
the cosine z / |p| is then replaced by a function that stays positive and keeps falling, and distortion stops growing at
r^2 = 4 (63 degrees from the axis), since no such polynomial is valid beyond.

Poses of a body in the camera follow from a few points in each view, for many views at once (`view_poses`). Each view is
a least-squares problem in six unknowns: points X_j of the body, seen along rays m_j. Damped Gauss-Newton steps, taken
for all problems together, start from 24 orientations of the body (those of a cube), at the depth that follows from the
spread of the rays. Three points allow up to four solutions, and four points in a plane sometimes two. Views with fewer
than four points are not solved, and some of the poses may be wrong (`calib.core.instruments.camera_places`).

From many points in one frame, the pose is found linearly (`resection`): with rows [m]x (P X) = 0 for a matrix P of
3 x 4 numbers, or of 3 x 3 numbers where the points lie in a plane.

References: zhang2000; OpenCV's documentation of calib3d; hartley2004, chapter 7.
"""

from __future__ import annotations

import numpy as np
import scipy

from calib.core.base.arrays import BoolArray, FloatArray, IntArray
from calib.core.numerics import linalg
from calib.core.numerics.rigid import cross_matrices, nearest_rotation

NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
"""Intrinsics in OpenCV's order."""
_GRAZING = 0.05  # no image if the cosine to the optical axis is less: 87 degrees
_WIDEST = 4.0  # distortion does not grow for larger r^2
_SETTLED = 1e-13
LEAST_POINTS = 4
"""Least number of points of a view for its pose."""
_PLAIN = np.array([1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])  # a camera whose pixels are m itself
_FLAT = 1e-3  # thickness over width of points that lie in a plane
_ROUNDS = 30


def project(points: FloatArray, intrinsics: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return pixels, and their derivatives by points and intrinsics.

    Args:
        points: Points in the camera's frame, (n, 3) [m].
        intrinsics: (9,) [px and numbers].

    Returns:
        Pixels (n, 2), their derivative by the points (n, 2, 3), and by the intrinsics (n, 2, 9).
    """
    plane, by_point = _project_on_plane(points)
    distorted, by_plane, by_number = _distort(plane, intrinsics[4:])
    focal = intrinsics[:2]
    by_intrinsics = np.zeros((len(points), 2, 9))
    by_intrinsics[:, [0, 1], [0, 1]] = distorted
    by_intrinsics[:, [0, 1], [2, 3]] = 1.0
    by_intrinsics[:, :, 4:] = focal[:, None] * by_number
    return distorted * focal + intrinsics[2:4], focal[:, None] * (by_plane @ by_point), by_intrinsics


def is_in_front(points: FloatArray) -> BoolArray:
    """Return a mask (n,) of the points (n, 3) [m] in front of a camera at the origin."""
    return points[:, 2] > _GRAZING * np.linalg.norm(points, axis=1)


def is_in_lens(points: FloatArray, intrinsics: FloatArray) -> BoolArray:
    """Return a mask (n,) of points (n, 3) [m] where distorted radii grow outwards; beyond, the image folds back."""
    k1, k2, k3 = intrinsics[[4, 5, 8]]
    turns = np.roots([7 * k3, 5 * k2, 3 * k1, 1.0])  # r^2 where d(r + k1 r^3 + k2 r^5 + k3 r^7) / dr = 0
    real = turns.real[(np.abs(turns.imag) < 1e-12) & (turns.real > 0)]
    return np.sum(_project_on_plane(points)[0] ** 2, axis=1) < np.min(real, initial=np.inf)


def rays(pixels: FloatArray, intrinsics: FloatArray) -> FloatArray:
    """Return m of the module docstring for pixels (n, 2), with distortion removed, (n, 2)."""
    distorted = (pixels - intrinsics[2:4]) / intrinsics[:2]
    plane = distorted.copy()
    for _ in range(_ROUNDS):
        distorted_plane, by_plane, _ = _distort(plane, intrinsics[4:])
        step = np.linalg.solve(by_plane, (distorted - distorted_plane)[:, :, None])[:, :, 0]
        plane = plane + np.clip(step, -0.2, 0.2)
        if np.max(np.abs(step), initial=0.0) < _SETTLED:
            break
    return plane


def _project_on_plane(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The point m and its derivative by the points, (n, 2) and (n, 2, 3)."""
    length = np.maximum(np.linalg.norm(points, axis=1), 1e-9)
    unit = points / length[:, None]
    low = unit[:, 2] < _GRAZING
    rest = 2.0 - np.where(low, unit[:, 2], _GRAZING) / _GRAZING
    cosine = np.where(low, _GRAZING / rest, unit[:, 2])
    slope = np.where(low, 1.0 / rest**2, 1.0)
    plane = unit[:, :2] / cosine[:, None]
    by_unit = np.zeros((len(points), 2, 3))
    by_unit[:, [0, 1], [0, 1]] = (1.0 / cosine)[:, None]
    by_unit[:, :, 2] = -plane * (slope / cosine)[:, None]
    onto = (np.eye(3) - unit[:, :, None] * unit[:, None, :]) / length[:, None, None]
    return plane, by_unit @ onto


def _distort(plane: FloatArray, numbers: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """d, its derivative by m, and by k1 k2 p1 p2 k3: (n, 2), (n, 2, 2), (n, 2, 5)."""
    k1, k2, p1, p2, k3 = numbers
    size = np.sum(plane**2, axis=1)
    shrink = np.sqrt(np.minimum(1.0, _WIDEST / np.maximum(size, 1e-300)))
    inside = (shrink == 1.0)[:, None, None]
    m = plane * shrink[:, None]  # argument of the distortion: m, or on the edge of the valid range of the polynomial
    x, y = m.T
    r2 = x**2 + y**2
    radial = k1 * r2 + k2 * r2**2 + k3 * r2**3
    slope = k1 + 2 * k2 * r2 + 3 * k3 * r2**2
    by_number = np.stack(
        [
            m * r2[:, None],
            m * (r2**2)[:, None],
            np.stack([2 * x * y, r2 + 2 * y**2], axis=1),
            np.stack([r2 + 2 * x**2, 2 * x * y], axis=1),
            m * (r2**3)[:, None],
        ],
        axis=2,
    )
    turned = np.empty((len(m), 2, 2))
    turned[:, 0, 0] = 2 * p1 * y + 6 * p2 * x
    turned[:, 0, 1] = turned[:, 1, 0] = 2 * p1 * x + 2 * p2 * y
    turned[:, 1, 1] = 6 * p1 * y + 2 * p2 * x
    bend = radial[:, None, None] * np.eye(2) + 2 * slope[:, None, None] * m[:, :, None] * m[:, None, :] + turned
    onto = np.eye(2) - plane[:, :, None] * plane[:, None, :] / np.maximum(size, 1e-300)[:, None, None]
    moves = np.where(inside, np.eye(2), shrink[:, None, None] * onto)  # derivative of m by `plane`
    return plane + by_number @ numbers, np.eye(2) + bend @ moves, by_number


def cube_rotations() -> FloatArray:
    """Return the 24 rotations of a cube, (24, 3, 3)."""
    return scipy.spatial.transform.Rotation.create_group("O").as_matrix()


def plane_errors(points: FloatArray, seen: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return m - m_seen of points (n, 3) [m] in the camera's frame, (n, 2), and its derivative by them, (n, 2, 3)."""
    plane, by_point, _ = project(points, _PLAIN)
    return plane - seen, by_point


def view_poses(points: FloatArray, seen: FloatArray, view: IntArray, n_views: int) -> tuple[FloatArray, FloatArray]:
    """Return the pose of the body in each view, (n_views, 4, 4) [m], and its root mean square error of m, (n_views,).

    Args:
        points: Points in the body's frame, (n, 3) [m].
        seen: Their rays m, (n, 2).
        view: View of each, (n,). Views with few points are not solved; their error is infinite.
    """
    counts = np.bincount(view, minlength=n_views)
    order = np.argsort(view, kind="stable")
    width = int(counts.max(initial=1))
    body, rays_ = (np.zeros((n_views, width, k)) for k in (3, 2))
    present = np.zeros((n_views, width), dtype=bool)
    place = np.arange(len(view)) - np.repeat(np.cumsum(counts) - counts, counts)
    body[view[order], place], rays_[view[order], place] = points[order], seen[order]
    present[view[order], place] = True
    starts = cube_rotations()
    k = len(starts)
    body, rays_, present = (np.repeat(array, k, axis=0) for array in (body, rays_, present))
    poses = _first_poses(body, rays_, present, np.tile(starts, (n_views, 1, 1)))
    poses, miss = _refine_poses(poses, body, rays_, present)
    miss = miss.reshape(n_views, k)
    best = np.argmin(miss, axis=1)
    best_poses = poses.reshape(n_views, k, 4, 4)[np.arange(n_views), best]
    error = np.sqrt(miss[np.arange(n_views), best] / np.maximum(counts, 1))
    return best_poses, np.where(counts >= LEAST_POINTS, error, np.inf)


def _first_poses(body: FloatArray, seen: FloatArray, present: BoolArray, turned: FloatArray) -> FloatArray:
    """Poses at the depth that follows from the spread of the rays."""
    n = np.maximum(np.sum(present, axis=1), 1)[:, None]
    middle = np.sum(body * present[:, :, None], axis=1) / n
    ray = np.sum(seen * present[:, :, None], axis=1) / n
    size = np.sqrt(np.sum(((body - middle[:, None]) * present[:, :, None]) ** 2, axis=(1, 2)))
    spread = np.sqrt(np.sum(((seen - ray[:, None]) * present[:, :, None]) ** 2, axis=(1, 2)))
    depth = 0.8 * size / np.maximum(spread, 1e-9)
    poses = np.tile(np.eye(4), (len(body), 1, 1))
    poses[:, :3, :3] = turned
    ahead = np.hstack([ray, np.ones((len(ray), 1))]) * depth[:, None]
    poses[:, :3, 3] = ahead - np.einsum("kab,kb->ka", turned, middle)
    return poses


def _errors(poses: FloatArray, body: FloatArray, seen: FloatArray, present: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Errors (n, 2 width) and their derivative by [dp; dw] of the body's pose, (n, 2 width, 6)."""
    n, width = present.shape
    turned = np.einsum("kab,kjb->kja", poses[:, :3, :3], body)
    errors, by_point = plane_errors((turned + poses[:, None, :3, 3]).reshape(-1, 3), seen.reshape(-1, 2))
    by_pose = np.concatenate([by_point, -by_point @ cross_matrices(turned.reshape(-1, 3))], axis=2)
    weight = present.reshape(-1, 1).astype(float)
    return (errors * weight).reshape(n, 2 * width), (by_pose * weight[:, :, None]).reshape(n, 2 * width, 6)


def _refine_poses(
    poses: FloatArray, body: FloatArray, seen: FloatArray, present: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Poses after damped Gauss-Newton steps, and their squared errors (n,)."""
    damping = np.full(len(poses), 1e-3)
    errors, by_pose = _errors(poses, body, seen, present)
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
        new_errors, new_by_pose = _errors(tried, body, seen, present)
        new_cost = np.sum(new_errors**2, axis=1)
        better = new_cost < cost
        poses = np.where(better[:, None, None], tried, poses)
        errors = np.where(better[:, None], new_errors, errors)
        by_pose = np.where(better[:, None, None], new_by_pose, by_pose)
        cost = np.where(better, new_cost, cost)
        damping = np.clip(np.where(better, damping / 5.0, damping * 5.0), 1e-12, 1e12)
    return poses, cost


def resection(points: FloatArray, seen: FloatArray) -> list[FloatArray]:
    """Return poses of a frame in the camera, (4, 4) [m] each, at which its points (n, 3) lie on rays (n, 2).

    The list is empty for fewer than `LEAST_POINTS` points, or points on a line. It has two poses for six or more points
    that are not in a plane, else one.
    """
    middle = points.mean(axis=0)
    _, size, axes = linalg.svd(points - middle, full_matrices=False)
    scale = float(np.sqrt(np.mean(np.sum((points - middle) ** 2, axis=1)))) or 1.0
    if len(points) < LEAST_POINTS or len(size) < 3 or size[1] < _FLAT * size[0]:
        return []
    axes = axes * np.sign(np.linalg.det(axes))
    local = (points - middle) @ axes.T / scale
    solutions = [_from_plane(local[:, :2], seen)]
    if size[2] > _FLAT * size[0] and len(points) >= 6:
        solutions.append(_from_space(local, seen))
    result: list[FloatArray] = []
    for rotation, translation in solutions:
        pose: FloatArray = np.eye(4)
        pose[:3, :3] = rotation @ axes
        pose[:3, 3] = scale * translation - pose[:3, :3] @ middle
        result.append(pose)
    return result


def _smallest(seen: FloatArray, numbers: FloatArray) -> FloatArray:
    """The matrix P (3, k) for which |[m]x (P X)|^2 is smallest, with P X in front of the camera, for X (n, k)."""
    n, k = numbers.shape
    rows = np.zeros((n, 2, 3, k))
    rows[:, 0, 0], rows[:, 0, 2] = numbers, -seen[:, :1] * numbers
    rows[:, 1, 1], rows[:, 1, 2] = numbers, -seen[:, 1:] * numbers
    matrix: FloatArray = linalg.svd(rows.reshape(2 * n, 3 * k), full_matrices=False)[2][-1].reshape(3, k)
    return matrix * (np.sign(np.sum(numbers @ matrix[2])) or 1.0)


def _from_space(local: FloatArray, seen: FloatArray) -> tuple[FloatArray, FloatArray]:
    matrix = _smallest(seen, np.hstack([local, np.ones((len(local), 1))]))
    size = np.cbrt(np.linalg.det(matrix[:, :3]))
    if size <= 0:  # a mirror image, by rounding or noise: the nearest rotation is as good as any
        size = float(np.mean(linalg.svd(matrix[:, :3])[1]))
    return nearest_rotation(matrix[:, :3]), matrix[:, 3] / max(float(size), 1e-12)


def _from_plane(local: FloatArray, seen: FloatArray) -> tuple[FloatArray, FloatArray]:
    matrix = _smallest(seen, np.hstack([local, np.ones((len(local), 1))]))
    size = max(float(np.mean(np.linalg.norm(matrix[:, :2], axis=0))), 1e-12)
    x, y = matrix[:, 0] / size, matrix[:, 1] / size
    return nearest_rotation(np.stack([x, y, np.cross(x, y)], axis=1)), matrix[:, 2] / size
