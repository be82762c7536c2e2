"""Outliers: measured points that lie further from where the fit puts them than noise explains.

With h = B C B^T / sigma^2 (3 x 3) the leverage of a point on its own prediction and w its weight in the fit (1 without
a robust loss, 0 outside the fit), the residual r of normal data has

    cov r = sigma^2 V,      V = I + (1 - 2 w) h      (I - h for a point that was used, I + h for one that was not)

so that T^2 = r^T V^-1 r is the studentised residual: the same for a point that pulls the fit towards itself as for one
that does not. T is compared with a scale that outliers hardly move, the median of all T over that of chi(3). A point is
an outlier where 3 F(3, nu/2) exceeds (T / scale)^2 with a chance below 1 % over the number of points: good
measurements of any number show one in a set out of a hundred. (nu/2, because a median finds a scale about half as well
as the squares.)

Leverage is trace(h)/3: the part of a point's own error that its prediction follows, the mean over its coordinates;
leverages of all points, times 3, add up to the effective parameters. The largest eigenvalue of h is the same for the
direction in which it is worst. Near 1 a point cannot be judged there.

When it fails. Several outliers that agree with each other pull a least-squares fit to them; fit with a robust loss to
see them. A point of leverage near 1 is never an outlier.

Reference: cook1982, chapter 2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi
from scipy.stats import f as f_distribution

from calib.model.mechanism import FloatArray
from calib.numerics.statistics import EXACT
from calib.read_only import ReadOnlyArrays

FALSE_ALARM = 0.01
"""Chance that a set of good measurements shows an outlier."""
HIGH_LEVERAGE = 0.9
"""Largest leverage along any direction, above which a point decides its own prediction and cannot be judged."""
_MEDIAN = float(chi(3).median())
_SMALLEST = 1e-6  # eigenvalue of V below which a direction has no residual left


@dataclass(frozen=True)
class Outlier:
    """One measured point that does not fit.

    Attributes:
        pose: Index of the pose in its set.
        target: Name of the measured point.
        label: File, line and pose name.
        distance: Predicted to measured [m].
        studentised: T over its scale.
        leverage: See the module docstring.
        p_value: Chance of such a point among good measurements of this number.
    """

    pose: int
    target: str
    label: str
    distance: float
    studentised: float
    leverage: float
    p_value: float

    def __str__(self) -> str:
        return (
            f"{self.label}, {self.target}: {1e3 * self.distance:.3f} mm off, {self.studentised:.1f} times the noise"
            f" (leverage {self.leverage:.2f})"
        )


@dataclass(frozen=True, eq=False)
class Studentised(ReadOnlyArrays):
    """Every point of a set judged.

    Attributes:
        ratio: T over its scale, (n_poses, n_targets).
        leverage: Mean over the coordinates, (n_poses, n_targets).
        largest_leverage: That of the worst direction, (n_poses, n_targets).
        p_value: Chance of such a point among good measurements of this number, (n_poses, n_targets).
        scale: Scale of T [m].
    """

    ratio: FloatArray
    leverage: FloatArray
    largest_leverage: FloatArray
    p_value: FloatArray
    scale: float


def studentised(
    residuals: FloatArray,
    columns: FloatArray,
    inverse: FloatArray,
    weights: FloatArray,
    freedom: float,
    scale: float | None = None,
) -> Studentised:
    """Judge every point.

    Args:
        residuals: With the noise of one reading, (n_poses, n_targets, 3) [m].
        columns: Scaled Jacobian of the same rows, (n_poses, n_targets, 3, n_free) [m].
        inverse: R^-1 of `calib.numerics.statistics.prior_shares`, (n_free, n_free).
        weights: w of the module docstring, (n_poses, n_targets).
        freedom: Degrees of freedom of the fit.
        scale: Scale of T, if it is known from other points [m].
    """
    pulled = columns @ inverse
    own = pulled @ pulled.swapaxes(-1, -2)
    values, vectors = np.linalg.eigh(np.eye(3) + (1.0 - 2.0 * weights)[..., None, None] * own)
    along = np.squeeze(residuals[..., None, :] @ vectors, axis=-2)
    with np.errstate(divide="ignore", invalid="ignore"):
        squares = np.where(values > _SMALLEST, along**2 / values, 0.0)
    size = np.sqrt(np.sum(squares, axis=-1))
    found = float(np.median(size)) / _MEDIAN if scale is None else scale
    found = max(found, EXACT)
    ratio = size / found
    p_value = np.minimum(1.0, ratio.size * f_distribution.sf(ratio**2 / 3.0, 3, max(freedom / 2.0, 1.0)))
    own_values = np.linalg.eigvalsh(own)
    return Studentised(ratio, np.mean(own_values, axis=-1), own_values[..., -1], p_value, found)


def outliers(
    judged: Studentised, residuals: FloatArray, labels: tuple[str, ...], targets: tuple[str, ...]
) -> tuple[Outlier, ...]:
    """Return the outliers, worst first.

    Args:
        judged: From `studentised`.
        residuals: Predicted minus measured positions, (n_poses, n_targets, 3) [m].
        labels, targets: Names of poses and measured points.
    """
    places = [(int(k), int(t)) for k, t in np.argwhere(judged.p_value < FALSE_ALARM)]
    places.sort(key=lambda place: -float(judged.ratio[place]))
    return tuple(
        Outlier(
            k,
            targets[t],
            labels[k],
            float(np.linalg.norm(residuals[k, t])),
            float(judged.ratio[k, t]),
            float(judged.leverage[k, t]),
            float(judged.p_value[k, t]),
        )
        for k, t in places
    )
