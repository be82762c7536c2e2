"""The world as a tracker finds it: a rigid fit of nests at known places, how sure it is, and which nests do not fit.

The fit itself is `calib.core.numerics.rigid.best_transform`: q_i = R p_i + t for nests p_i seen in the tracker's frame.

Uncertainty. A small change [dt; w], R -> R exp(w), moves point i by J_i [dt; w], J_i = [I  -R [p_i]x]; with noise sigma
on each component the covariance of [dt; w] is sigma^2 (sum J_i^T J_i)^-1, w in the axes of the first frame.

Outliers. With H = J (J^T J)^-1 J^T, leaving point i out lowers the sum of squares by d_i = r_i^T (I - H_ii)^+ r_i. Over
sigma^2 this is chi-square with k_i = rank(I - H_ii) degrees of freedom; where sigma is not known, d_i is compared with
what the other points leave, which is F distributed. The most surprising point goes first and the test is repeated
without it, so that one bad point does not make its neighbours look bad. Three points say little: two distances must
agree before the third can be doubted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray
from calib.core.numerics import linalg
from calib.core.numerics.rigid import best_transform, cross_matrices

OUTLIER_PROBABILITY = 0.01
"""Chance that an outlier is reported in a set of points without one."""
_COLLINEAR = 1e-6  # points are on a line if their second extent is less than this part of the first
_EXACT = 1e-13  # residuals below are rounding [m]
_ROUNDING = 4 * float(np.finfo(float).eps)  # rounding of a transformed coordinate, as a part of the largest one


@dataclass(frozen=True, eq=False)
class RigidFit:
    """Best rigid transform `p_to = rotation p_from + translation`.

    Attributes:
        rotation: (3, 3).
        translation: (3,) [m].
        sigma: Noise of one component: as given, or estimated from the residuals with 3 n - 6 degrees of freedom [m].
        covariance: Covariance of [translation; rotation vector w, R exp(w)], (6, 6) [m, rad].
        outliers: Indices of points that do not fit, most surprising first.
    """

    rotation: FloatArray
    translation: FloatArray
    sigma: float
    covariance: FloatArray
    outliers: tuple[int, ...]

    def apply(self, points: FloatArray) -> FloatArray:
        """Carry points (n, 3) [m] over to the second frame."""
        moved: FloatArray = points @ self.rotation.T + self.translation
        return moved

    def point_covariance(self, points: FloatArray) -> FloatArray:
        """Covariance of transformed points (n, 3) that comes from the uncertain transform, (n, 3, 3) [m^2]."""
        slope = _slope(self.rotation, points)
        covariance: FloatArray = slope @ self.covariance @ slope.transpose(0, 2, 1)
        return covariance


def rigid_fit(p: FloatArray, q: FloatArray, sigma: float | None = None) -> RigidFit:
    """Find the rigid transform that carries points to where they were seen.

    Args:
        p: Points in the first frame, three or more that are not on one line, (n, 3) [m].
        q: The same points in the second frame, (n, 3) [m].
        sigma: Noise of one component [m]; estimated from the residuals if not given.

    Reference: kabsch1976.
    """
    rotation, translation = best_transform(p, q)
    squares = float(np.sum((q - (p @ rotation.T + translation)) ** 2))
    noise = float(np.sqrt(squares / (3 * len(p) - 6))) if sigma is None else float(sigma)
    slope = _slope(rotation, p).reshape(-1, 6)
    covariance: FloatArray = np.asarray(noise**2 * np.linalg.inv(slope.T @ slope))
    return RigidFit(rotation, translation, noise, covariance, _outliers(p, q, sigma))


def _outliers(p: FloatArray, q: FloatArray, sigma: float | None) -> tuple[int, ...]:
    """Remove the most surprising point while one is too surprising; see the module docstring."""
    kept, outliers = np.arange(len(p)), []
    exact = max(_EXACT, _ROUNDING * float(max(np.max(np.abs(p)), np.max(np.abs(q)))))
    while len(kept) >= 3 and _extents(p[kept])[1] > _COLLINEAR * _extents(p[kept])[0]:
        rotation, translation = best_transform(p[kept], q[kept])
        residuals = q[kept] - (p[kept] @ rotation.T + translation)
        slope = _slope(rotation, p[kept] - p[kept].mean(axis=0))  # centred: same leverage, less rounding far from 0
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
        values, vectors = linalg.eigh(np.eye(3) - J @ information @ J.T)
        free = values > 1e-9
        drop, count = float(np.sum((vectors.T @ r)[free] ** 2 / values[free])), int(free.sum())
        left = freedom - count
        if count and sigma is not None:
            surprise[k] = drop / max(sigma, exact) ** 2 / scipy.special.chdtri(count, probability)
        elif count and left > 0:
            rest = max(total - drop, exact**2) / left
            surprise[k] = drop / count / rest / scipy.special.fdtri(count, left, 1.0 - probability)
    return surprise


def _extents(points: FloatArray) -> tuple[float, float]:
    """Largest and second largest root-mean-square extent of points about their centroid [m]."""
    values = linalg.singular_values(points - points.mean(axis=0)) / np.sqrt(len(points))
    return float(values[0]), float(values[1])


def _slope(rotation: FloatArray, points: FloatArray) -> FloatArray:
    """J_i = [I  -R [p_i]x], (n, 3, 6)."""
    return np.concatenate([np.tile(np.eye(3), (len(points), 1, 1)), -rotation @ cross_matrices(points)], axis=2)
