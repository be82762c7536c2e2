"""The best rigid transform between two sets of points, and a point from its distances.

The best rigid transform has R, t that make

    sum |q_i - (R p_i + t)|^2

smallest for points p_i known in one frame and q_i measured in another. The optimum is closed: R from the singular value
decomposition of the covariance of the centred points, with the sign of the last singular vector chosen so that
det R = +1 (a mirror is never returned), t from the centroids (Kabsch 1976, Umeyama 1991). It needs three points that
are not on one line.

References: kabsch1976, umeyama1991.

The position of a point follows from measured distances to known points without a first guess.

The known points are p_k, their centroid is p0, and q_k = p_k - p0. The unknown point is p0 + x, and all distances d_k
may be too long by one unknown length o: |q_k - x| = d_k - o. Squares minus their mean are linear in x and o:

    2 q_k . x  -  2 (d_k - mean d) o   =   (|q_k|^2 - d_k^2) - mean

If the points lie in one plane (or on one line), only the length of x is known across it: |x|^2 = mean of
(d_k - o)^2 - |q_k|^2. That gives two mirror images; only a first guess distinguishes them.
Errors of the points and distances are not weighted: the result is a first value for a fit.
"""

from __future__ import annotations

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.numerics import linalg

_DETERMINED = 1e-3  # singular values below this part of the largest count as zero
_SMALLEST = 1e-9  # a smaller length counts as zero [m]
_AS_GOOD = 2.0  # misses within this factor of the smallest do not distinguish mirror images


def nearest_rotation(matrix: FloatArray) -> FloatArray:
    """Return the rotations R that make tr(R^T matrix) largest, (..., 3, 3)."""
    u, _, vt = linalg.svd(matrix)
    u[..., 2] *= np.where(np.linalg.det(u @ vt) < 0, -1.0, 1.0)[..., None]
    return u @ vt


def best_transform(p: FloatArray, q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return R (3, 3) and t (3,) [m] of the module docstring for points p, q (n, 3) [m]."""
    centre_p, centre_q = p.mean(axis=0), q.mean(axis=0)
    rotation = nearest_rotation((q - centre_q).T @ (p - centre_p))
    return rotation, centre_q - rotation @ centre_p


def cross_matrices(points: FloatArray) -> FloatArray:
    """Return [p]x of each point, (n, 3, 3)."""
    half = np.zeros((len(points), 3, 3))
    half[:, 2, 1], half[:, 0, 2], half[:, 1, 0] = points.T
    return half - half.transpose(0, 2, 1)


def rotations_by(vectors: FloatArray) -> FloatArray:
    """Return the rotations exp([v]x) by vectors v (n, 3) [rad], (n, 3, 3)."""
    cross, length = cross_matrices(vectors), np.linalg.norm(vectors, axis=1)[:, None, None]
    angle = np.maximum(length, np.finfo(float).tiny)  # `np.sinc` takes four times as long
    along, across = np.sin(angle) / angle, 2.0 * (np.sin(angle / 2.0) / angle) ** 2
    return np.asarray(np.eye(3) + along * cross + across * (cross @ cross))


def centre(points: FloatArray, lengths: FloatArray, near: FloatArray) -> FloatArray:
    """Return the position (3,) [m] of a point at these lengths (n,) [m] from points (n, 3) [m].

    Args:
        near: A place near it, (3,) [m]: it decides between mirror images, and in directions without distances.
    """
    middle = points.mean(axis=0)
    q = points - middle
    squares = np.sum(q**2, axis=1) - lengths**2
    left, values, right = linalg.svd(2.0 * q, full_matrices=False)
    n_determined = int(np.sum(values > max(_DETERMINED * values[0], _SMALLEST)))
    along = (left.T @ (squares - squares.mean()))[:n_determined] / values[:n_determined]
    candidates = []
    for kept in sorted({n_determined, min(n_determined, 2)}):
        inside = right[:kept].T @ along[:kept]
        away = _perpendicular_vector(right[:kept], near - middle, -float(squares.mean()) - float(inside @ inside))
        candidates += [middle + inside] if kept == 3 else [middle + inside + away, middle + inside - away]
    misses = [float(np.linalg.norm(np.linalg.norm(points - candidate, axis=1) - lengths)) for candidate in candidates]
    most = _AS_GOOD * min(misses) + _SMALLEST
    good = [candidate for candidate, miss in zip(candidates, misses, strict=True) if miss <= most]
    return min(good, key=lambda candidate: float(np.linalg.norm(candidate - near)))


def _perpendicular_vector(directions: FloatArray, near: FloatArray, square: float) -> FloatArray:
    """The vector perpendicular to determined directions (k, 3) with this squared length, on the side of `near` (3,)."""
    across = near - directions.T @ (directions @ near)
    if len(directions) == 2:
        normal = np.cross(*directions)
        across = normal if across @ normal >= 0 else -normal
    elif np.linalg.norm(across) < _SMALLEST:
        across = linalg.svd(np.vstack([directions, np.zeros((1, 3))]))[2][-1]
    return np.sqrt(max(square, 0.0)) * across / np.linalg.norm(across)


def common_offset(points: FloatArray, distances: FloatArray, near: FloatArray, offset: float) -> float:
    """Return the length o by which all distances from a point are too long [m].

    Args:
        points, distances: The known points (n, 3) [m], and the distances from them (n,) [m].
        near: A place near the point, (3,) [m].
        offset: Value of o where nothing determines it [m].
    """
    middle = points.mean(axis=0)
    q = points - middle
    columns = 2.0 * np.column_stack([q, distances.mean() - distances])
    squares = np.sum(q**2, axis=1) - distances**2
    guess = np.append(near - middle, offset)
    change = linalg.lstsq(columns, squares - squares.mean() - columns @ guess, rcond=_DETERMINED)
    return offset + float(change[3])
