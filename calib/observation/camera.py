"""A camera: from points in its frame to pixels and back, with derivatives.

The camera's frame has its origin in the centre of projection, z along the optical axis, x to the right and y down in
the image, as OpenCV has it. With m = (x / z, y / z) and r^2 = |m|^2,

    d = m (1 + k1 r^2 + k2 r^4 + k3 r^6) + (2 p1 m_x m_y + p2 (r^2 + 2 m_x^2),  p1 (r^2 + 2 m_y^2) + 2 p2 m_x m_y)
    u = fx d_x + cx,        v = fy d_y + cy

The order of intrinsics is fx fy cx cy k1 k2 p1 p2 k3. Pixels are counted as OpenCV does: the centre of the first one is
at (0, 0).

A solver may try a camera that has a point beside or behind it, where there is no image. So that it finds its way back,
the cosine z / |p| is then replaced by one that stays positive and goes on falling, and distortion stops growing at
r^2 = 4 (63 degrees from the axis), where no such polynomial holds any more.

Reference: zhang2000; OpenCV's documentation of calib3d.
"""

from __future__ import annotations

import numpy as np

from calib.arrays import BoolArray, FloatArray

NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
"""Intrinsics in OpenCV's order."""
_GRAZING = 0.05  # cosine to the optical axis below which there is no image: 87 degrees
_WIDEST = 4.0  # r^2 beyond which distortion does not grow
_ROUNDS = 50
_SETTLED = 1e-13


def project(points: FloatArray, intrinsics: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return pixels, and how points and intrinsics move them.

    Args:
        points: In the camera's frame, (n, 3) [m].
        intrinsics: (9,) [px and numbers].

    Returns:
        Pixels (n, 2), their derivative by the points (n, 2, 3), and by the intrinsics (n, 2, 9).
    """
    plane, by_point = _on_plane(points)
    bent, by_plane, by_number = _distorted(plane, intrinsics[4:])
    focal = intrinsics[:2]
    by_intrinsics = np.zeros((len(points), 2, 9))
    by_intrinsics[:, [0, 1], [0, 1]] = bent
    by_intrinsics[:, [0, 1], [2, 3]] = 1.0
    by_intrinsics[:, :, 4:] = focal[:, None] * by_number
    return bent * focal + intrinsics[2:4], focal[:, None] * (by_plane @ by_point), by_intrinsics


def in_front(points: FloatArray) -> BoolArray:
    """Return which points (n, 3) a camera at the origin may see."""
    result: BoolArray = points[:, 2] > _GRAZING * np.linalg.norm(points, axis=1)
    return result


def rays(pixels: FloatArray, intrinsics: FloatArray) -> FloatArray:
    """Return m of the module docstring, without distortion, for pixels (n, 2): (n, 2)."""
    wanted = (pixels - intrinsics[2:4]) / intrinsics[:2]
    plane = wanted.copy()
    for _ in range(_ROUNDS):
        bent, by_plane, _ = _distorted(plane, intrinsics[4:])
        step = np.linalg.solve(by_plane, (wanted - bent)[:, :, None])[:, :, 0]
        plane = plane + np.clip(step, -0.2, 0.2)
        if np.max(np.abs(step), initial=0.0) < _SETTLED:
            break
    return plane


def _on_plane(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """M and its derivative by the points, (n, 2) and (n, 2, 3)."""
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


def _distorted(plane: FloatArray, numbers: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """d, its derivative by m, and by k1 k2 p1 p2 k3: (n, 2), (n, 2, 2), (n, 2, 5)."""
    k1, k2, p1, p2, k3 = numbers
    size = np.sum(plane**2, axis=1)
    shrink = np.sqrt(np.minimum(1.0, _WIDEST / np.maximum(size, 1e-300)))
    inside = (shrink == 1.0)[:, None, None]
    m = plane * shrink[:, None]  # where distortion is taken: m itself, or on the edge of where it holds
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
    moves = np.where(inside, np.eye(2), shrink[:, None, None] * onto)  # dm by the plane
    return plane + by_number @ numbers, np.eye(2) + bend @ moves, by_number
