"""Rigid fits: the frame in which known points were seen, how sure that is, and which points do not fit.

Problem. Points p_i known in one frame and q_i measured in another: find R, t that make

    sum |q_i - (R p_i + t)|^2

smallest. The optimum is closed: R from the singular value decomposition of the covariance of the centred points, with
the sign of the last singular vector chosen so that det R = +1 (a mirror is never returned), t from the centroids
(Kabsch 1976, Umeyama 1991). It needs three points that are not on one line.

Uncertainty. A small change [dt; w], R -> R exp(w), moves point i by J_i [dt; w], J_i = [I  -R [p_i]x]; with noise sigma
on each component the covariance of [dt; w] is sigma^2 (sum J_i^T J_i)^-1, w in the axes of the first frame.

Outliers. With H = J (J^T J)^-1 J^T, leaving point i out lowers the sum of squares by d_i = r_i^T (I - H_ii)^+ r_i. Over
sigma^2 this is chi-square with k_i = rank(I - H_ii) degrees of freedom; where sigma is not known, d_i is compared with
what the other points leave, which is F distributed. The most surprising point goes first and the test is repeated
without it, so that one bad point does not make its neighbours look bad. Three points say little: two distances must
agree before the third can be doubted.

References: kabsch1976, umeyama1991.

Where a point is whose distances from known points were measured, without a first guess.

For points p_k with centroid p0, q_k = p_k - p0, the unknown centre p0 + x and distances d_k that all may be too long by
one unknown length o, |q_k - x| = d_k - o; squares minus their mean are linear in x and o:

    2 q_k . x  -  2 (d_k - mean d) o   =   (|q_k|^2 - d_k^2) - mean

Points in one plane (or on one line) leave x open across it but for its length: |x|^2 = mean of (d_k - o)^2 - |q_k|^2.
That gives two mirror images; nothing but a first guess tells them apart.

Errors of the points and distances are not weighed as they should be: the answer is a first value for a fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import ArrayLike

from calib.arrays import FloatArray
from calib.errors import DataError
from calib.units import millimetres

OUTLIER_PROBABILITY = 0.01
"""How often a set of points without any outlier may be said to have one."""
_COLLINEAR = 1e-6  # second extent of the points against the first
_EXACT = 1e-13  # residuals below are rounding [m]
_ROUNDING = 4 * float(np.finfo(float).eps)  # of a coordinate that was turned and moved, as part of the largest
_TOLD = 1e-3  # singular values below this part of the largest tell nothing
_SMALLEST = 1e-9  # length below which there is none [m]
_AS_GOOD = 2.0  # misses within this factor of the smallest do not tell mirror images apart


@dataclass(frozen=True, eq=False)
class RigidFit:
    """Best rigid transform `p_to = rotation p_from + translation`.

    Attributes:
        rotation: (3, 3).
        translation: (3,) [m].
        residuals: p_to - (rotation p_from + translation), (n, 3) [m].
        rms: Root mean square of the residuals' norms [m].
        sigma: Noise of one component: as given, or estimated from the residuals with 3 n - 6 degrees of freedom [m].
        covariance: Of [translation; rotation vector w, R exp(w)], (6, 6) [m, rad].
        outliers: Indices of points that do not fit, most surprising first.
    """

    rotation: FloatArray
    translation: FloatArray
    residuals: FloatArray
    rms: float
    sigma: float
    covariance: FloatArray
    outliers: tuple[int, ...]

    @property
    def transform(self) -> FloatArray:
        """Homogeneous transform T_to_from, (4, 4) [m]."""
        return homogeneous(self.rotation, self.translation)

    def apply(self, points: ArrayLike) -> FloatArray:
        """Carry points (n, 3) or (3,) [m] over to the second frame."""
        moved: FloatArray = np.asarray(points, dtype=float) @ self.rotation.T + self.translation
        return moved

    def point_covariance(self, points: ArrayLike) -> FloatArray:
        """Covariance that the frame's uncertainty gives to points carried over, (n, 3, 3) [m^2]."""
        slope = _slope(self.rotation, np.atleast_2d(np.asarray(points, dtype=float)))
        covariance: FloatArray = slope @ self.covariance @ slope.transpose(0, 2, 1)
        return covariance


def rigid_fit(
    p_from: ArrayLike, p_to: ArrayLike, sigma: float | None = None, *, names: Sequence[str] | None = None
) -> RigidFit:
    """Find the rigid transform that carries points to where they were seen.

    Args:
        p_from: Points in the first frame, (n, 3) [m].
        p_to: The same points in the second frame, (n, 3) [m].
        sigma: Noise of one component [m]; estimated from the residuals if not given.
        names: What to call the points in messages; `point 0`, ... if not given.

    Raises:
        DataError: Fewer than three points, points on one line, values that are not finite, or shapes that differ.

    Reference: kabsch1976.
    """
    p, q = _checked_points(p_from, p_to, sigma, names)
    rotation, translation = best_transform(p, q)
    residuals = q - (p @ rotation.T + translation)
    squares = float(np.sum(residuals**2))
    noise = float(np.sqrt(squares / (3 * len(p) - 6))) if sigma is None else float(sigma)
    slope = _slope(rotation, p).reshape(-1, 6)
    covariance: FloatArray = np.asarray(noise**2 * np.linalg.inv(slope.T @ slope))
    for array in (rotation, translation, residuals, covariance):
        array.flags.writeable = False
    rms = float(np.sqrt(squares / len(p)))
    return RigidFit(rotation, translation, residuals, rms, noise, covariance, _outliers(p, q, sigma))


def best_transform(p: FloatArray, q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return R (3, 3) and t (3,) [m] of the module docstring for checked points p, q (n, 3) [m]."""
    centre_p, centre_q = p.mean(axis=0), q.mean(axis=0)
    left, _, right = np.linalg.svd((q - centre_q).T @ (p - centre_p))
    proper = np.diag([1.0, 1.0, np.linalg.det(left) * np.linalg.det(right)])
    rotation = left @ proper @ right
    return rotation, centre_q - rotation @ centre_p


def _outliers(p: FloatArray, q: FloatArray, sigma: float | None) -> tuple[int, ...]:
    """Remove the most surprising point while one is too surprising; see the module docstring."""
    kept, outliers = np.arange(len(p)), []
    exact = max(_EXACT, _ROUNDING * float(max(np.max(np.abs(p)), np.max(np.abs(q)))))
    while len(kept) >= 3 and _extents(p[kept])[1] > _COLLINEAR * _extents(p[kept])[0]:
        rotation, translation = best_transform(p[kept], q[kept])
        residuals = q[kept] - (p[kept] @ rotation.T + translation)
        slope = _slope(rotation, p[kept] - p[kept].mean(axis=0))  # leverage is the same, and far from 0 it keeps digits
        surprise = _surprise(residuals, slope, sigma, OUTLIER_PROBABILITY / len(p), exact)
        worst = int(np.argmax(surprise))
        if surprise[worst] <= 1:
            break
        outliers.append(int(kept[worst]))
        kept = np.delete(kept, worst)
    return tuple(outliers)


def _surprise(
    residuals: FloatArray, slope: FloatArray, sigma: float | None, probability: float, exact: float
) -> FloatArray:
    """The drop d_i over its largest value that chance explains, (n,); 0 where nothing is left to compare with."""
    information = np.linalg.inv(np.einsum("nij,nik->jk", slope, slope))
    total, freedom = float(np.sum(residuals**2)), residuals.size - 6
    surprise = np.zeros(len(residuals))
    if total <= exact**2 * residuals.size:
        return surprise
    for k, (r, J) in enumerate(zip(residuals, slope, strict=True)):
        values, vectors = np.linalg.eigh(np.eye(3) - J @ information @ J.T)
        free = values > 1e-9
        drop, count = float(np.sum((vectors.T @ r)[free] ** 2 / values[free])), int(free.sum())
        left = freedom - count
        if count and sigma is not None:
            surprise[k] = drop / max(sigma, exact) ** 2 / scipy.special.chdtri(count, probability)
        elif count and left > 0:
            rest = max(total - drop, exact**2) / left
            surprise[k] = drop / count / rest / scipy.special.fdtri(count, left, 1.0 - probability)
    return surprise


def _checked_points(
    p_from: ArrayLike, p_to: ArrayLike, sigma: float | None, names: Sequence[str] | None
) -> tuple[FloatArray, FloatArray]:
    """Return both sets of points as (n, 3) arrays, or raise; see `rigid_fit`."""
    p, q = np.array(p_from, dtype=float), np.array(p_to, dtype=float)
    if p.ndim != 2 or p.shape[1] != 3 or p.shape != q.shape:
        raise DataError(f"rigid fit: points of shapes {p.shape} and {q.shape}; expected two arrays (n, 3)")
    labels = list(names) if names is not None else [f"point {k}" for k in range(len(p))]
    finite = np.isfinite(p).all(axis=1) & np.isfinite(q).all(axis=1)
    if not finite.all():
        raise DataError(f"rigid fit: {labels[int(np.argmin(finite))]}: a coordinate is not finite; leave the point out")
    if len(p) < 3:
        raise DataError(f"rigid fit: {len(p)} points; at least three that are not on one line are needed")
    if sigma is not None and not (np.isfinite(sigma) and sigma >= 0):
        raise DataError(f"rigid fit: sigma is {sigma} m; it must be zero or more")
    for points, which in ((p, "as given"), (q, "as measured")):
        _refuse_one_line(
            points,
            f"rigid fit: {', '.join(labels[:6])}{', ...' if len(labels) > 6 else ''} ({which})",
            3 * (sigma or 0.0),
        )
    return p, q


def _refuse_one_line(points: FloatArray, what: str, noise: float) -> None:
    """Raise where points are one point or one line, to within `noise` [m]."""
    first, second = _extents(points)
    if first <= max(1e-12, noise):
        raise DataError(f"{what} are all one point; use three points that are not on one line")
    if second <= max(_COLLINEAR * first, noise):
        raise DataError(
            f"{what} lie on one line to {millimetres(second):.2g} mm, so the turn about it stays open;"
            " add a point beside the line"
        )


def _extents(points: FloatArray) -> tuple[float, float]:
    """Largest and second largest root-mean-square extent of points about their centroid [m]."""
    values = np.linalg.svd(points - points.mean(axis=0), compute_uv=False) / np.sqrt(len(points))
    return float(values[0]), float(values[1])


def _slope(rotation: FloatArray, points: FloatArray) -> FloatArray:
    """J_i = [I  -R [p_i]x], (n, 3, 6)."""
    return np.concatenate([np.tile(np.eye(3), (len(points), 1, 1)), -rotation @ cross_matrices(points)], axis=2)


def cross_matrices(points: FloatArray) -> FloatArray:
    """Return [p]x of each point, (n, 3, 3)."""
    half = np.zeros((len(points), 3, 3))
    half[:, 2, 1], half[:, 0, 2], half[:, 1, 0] = points.T
    result: FloatArray = half - half.transpose(0, 2, 1)
    return result


def homogeneous(rotation: FloatArray, translation: FloatArray) -> FloatArray:
    """Return the homogeneous transform (4, 4) of a rotation (3, 3) and a translation (3,) [m]."""
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = rotation, translation
    return transform


def centre(points: FloatArray, lengths: FloatArray, near: FloatArray) -> FloatArray:
    """Return where a point is that has these distances from points, (3,) [m].

    Args:
        points: (n, 3) [m].
        lengths: (n,) [m].
        near: Where it may be: decides between mirror images, and stands for what nothing tells, (3,) [m].
    """
    middle = points.mean(axis=0)
    q = points - middle
    squares = np.sum(q**2, axis=1) - lengths**2
    left, values, right = np.linalg.svd(2.0 * q, full_matrices=False)
    n_told = int(np.sum(values > max(_TOLD * values[0], _SMALLEST)))
    along = (left.T @ (squares - squares.mean()))[:n_told] / values[:n_told]
    candidates = []
    for kept in sorted({n_told, min(n_told, 2)}):
        inside = right[:kept].T @ along[:kept]
        away = _across(right[:kept], near - middle, -float(squares.mean()) - float(inside @ inside))
        candidates += [middle + inside] if kept == 3 else [middle + inside + away, middle + inside - away]
    misses = [float(np.linalg.norm(np.linalg.norm(points - one, axis=1) - lengths)) for one in candidates]
    good = [one for one, miss in zip(candidates, misses, strict=True) if miss <= _AS_GOOD * min(misses) + _SMALLEST]
    return min(good, key=lambda one: float(np.linalg.norm(one - near)))


def _across(told: FloatArray, near: FloatArray, square: float) -> FloatArray:
    """The vector across told directions (k, 3) that has this squared length and points where `near` (3,) is."""
    across = near - told.T @ (told @ near)
    if len(told) == 2:
        across = np.cross(told[0], told[1]) * (1.0 if across @ np.cross(told[0], told[1]) >= 0 else -1.0)
    elif np.linalg.norm(across) < _SMALLEST:
        across = np.linalg.svd(np.vstack([told, np.zeros((1, 3))]))[2][-1]
    result: FloatArray = np.sqrt(max(square, 0.0)) * across / np.linalg.norm(across)
    return result


def common_offset(points: FloatArray, distances: FloatArray, near: FloatArray, offset: float) -> float:
    """Return the length o by which all distances from a point are too long [m].

    Args:
        points: (n, 3) [m].
        distances: (n,) [m].
        near: Where the point may be, (3,) [m].
        offset: What o may be, where nothing tells [m].
    """
    middle = points.mean(axis=0)
    q = points - middle
    columns = 2.0 * np.column_stack([q, distances.mean() - distances])
    squares = np.sum(q**2, axis=1) - distances**2
    guess = np.append(near - middle, offset)
    change = np.linalg.lstsq(columns, squares - squares.mean() - columns @ guess, rcond=_TOLD)[0]
    return offset + float(change[3])


def centre_of_sphere(points: FloatArray, near: FloatArray) -> tuple[FloatArray, float]:
    """Return centre (3,) and radius of the sphere that points (n, 3) lie on [m]; see `centre` for `near`."""
    middle = points.mean(axis=0)
    q = points - middle
    squares = np.sum(q**2, axis=1)
    columns, guess = 2.0 * q, near - middle
    x = guess + np.linalg.lstsq(columns, squares - squares.mean() - columns @ guess, rcond=_TOLD)[0]
    return middle + x, float(np.sqrt(x @ x + squares.mean()))
