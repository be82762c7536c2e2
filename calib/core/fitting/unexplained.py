"""Errors of joints that residuals show beside noise, and that no parameter describes.

Residuals larger than the noise say that something is left out: gears, play, a bending link. Where the robot will be off
by it at another pose is not known; how much, is. It is told as an error of each joint that is another one at each pose,
so that a position feels it by its lever, in the directions in which joints move it:

    covariance of x(q) = B C B^T + delta^2 sum over joints of (s_j dx/dq_j)(s_j dx/dq_j)^T

with delta in rad, s_j the characteristic length of the robot for a joint that slides and 1 for one that turns. Delta is
the most likely one (patterson1971). With t^2 = r^2 / k of residuals r, k = 1 - leverage the part of a row that is not
fitted, h^2 the sum over joints of (s_j dr/dq_j)^2, and v the variance of the noise, all whitened by what is stated,

    -2 log likelihood = sum of k (log V + t^2 / V),        V = v + delta^2 h^2

Its slope by delta^2, sum of k h^2 (t^2 - V) / V^2, is zero at the solution; where it is negative at delta = 0 already,
delta is 0. So rows that joints hardly move say nothing, and delta does not jump: a test of whether anything is left out
would leave out what is too small for it, which still makes intervals too narrow.

Noise is known where it is stated: v = 1. Where it is not, poses that were read n times over tell it: their scatter,
with f degrees of freedom and the sum of squares S, has no part in the model. Then r is the mean of such a component,
V = v / n + delta^2 h^2, and f log v + S / v is added, from which v follows for every delta. Where neither is so,
nothing separates what is left out from noise.

Delta is no part of the covariance of parameters: these are found with residuals as large as they are.

When it fails. A stated noise that is too small counts as an error of the joints. What the parameters took up shows in
no residual: at poses unlike those measured the robot may be further off. Gross errors that a robust loss lets through
count, too. Of a robot that its parameters describe, noise alone makes delta larger than 0 in about half of all fits.

Reference: patterson1971.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import scipy

from calib.core.base.arrays import BoolArray, FloatArray, IntArray, ReadOnlyArrays
from calib.core.rows.rows import Layout

_AGAIN = 10
"""Readings beyond the first of their pose from which their scatter tells the noise."""
_DECIDED = 1e-6  # part of a component that is not fitted, below which its residual says nothing
_DOUBLINGS = 60


def unexplained_joint_error(
    layout: Layout, residuals: FloatArray, by_joint: FloatArray, weights: FloatArray, leverage: FloatArray
) -> float:
    """Return delta of the module docstring [rad]; 0 where noise explains the residuals, or is not known.

    Args:
        layout: Of the rows.
        residuals: Whitened by the stated noise alone, (n_rows,).
        by_joint: Their derivative by the joints, scaled by s_j, whitened likewise, (n_rows, n_joints).
        weights: Of a robust loss, of each row, (n_rows,).
        leverage: Part of each weighted row that its own prediction follows, (n_rows,).
    """
    levers = np.sum(by_joint**2, axis=1)
    parts = list(_known_noise(layout, residuals, levers, weights, leverage))
    if not any(np.any(part.lever > 0.0) for part in parts):
        return 0.0

    def slope(square: float) -> float:
        return sum(part.slope(square) for part in parts)

    if slope(0.0) <= 0.0:
        return 0.0
    unit = sum(float(np.sum(part.kept * part.squares)) for part in parts)
    unit /= sum(float(np.sum(part.kept * part.lever)) for part in parts)
    most = next((unit * 2.0**k for k in range(_DOUBLINGS) if slope(unit * 2.0**k) < 0.0), None)
    if most is None:  # noise is nothing beside rounding
        return float(np.sqrt(unit))
    return float(np.sqrt(most * scipy.optimize.brentq(lambda part: slope(part * most), 0.0, 1.0)))


@dataclass(frozen=True, eq=False)
class _Known(ReadOnlyArrays):
    """Components of readings whose noise is known.

    Attributes:
        squares: t^2, (n,).
        kept: k, (n,).
        lever: h^2, (n,).
        count: Over how many readings each is a mean, (n,).
        scatter, freedom: S and f of readings of the same pose; 0 where the noise is stated.
    """

    squares: FloatArray
    kept: FloatArray
    lever: FloatArray
    count: FloatArray
    scatter: float = 0.0
    freedom: float = 0.0

    @staticmethod
    def of(
        residuals: FloatArray, lever: FloatArray, weight: FloatArray, left: FloatArray, count: FloatArray | None = None
    ) -> _Known:
        """Return them from r, h^2, weights, parts that are not fitted, and counts (1 without them), (n,) each."""
        use = left > _DECIDED
        count = np.ones(len(left)) if count is None else count
        return _Known(residuals[use] ** 2 / left[use], (weight * left)[use], lever[use], count[use])

    def slope(self, square: float) -> float:
        """Return twice the slope of the log likelihood by delta^2, at this delta^2."""
        total = self._noise(square) / self.count + square * self.lever
        return float(np.sum(self.kept * self.lever * (self.squares - total) / total**2))

    def _noise(self, square: float) -> float:
        """Return the most likely v at a delta^2."""
        if self.freedom == 0.0:
            return 1.0

        def slope(log: float) -> float:
            noise = float(np.exp(log))
            total = noise / self.count + square * self.lever
            moved = np.sum(self.kept * (self.squares - total) / (self.count * total**2))
            return float(moved) * noise + self.scatter / noise - self.freedom

        least = np.log(self.scatter / (self.freedom + np.sum(self.kept)))  # where even residuals of zero pull up
        most = np.log(max(self.scatter / self.freedom, float(np.max(self.count * self.squares))))
        return float(np.exp(scipy.optimize.brentq(slope, least - 1.0, most + 1.0)))


def _known_noise(
    layout: Layout, residuals: FloatArray, levers: FloatArray, weights: FloatArray, leverage: FloatArray
) -> Iterator[_Known]:
    """Yield what is known of each group of rows whose noise is known; arguments as above, and h^2 of each row."""
    for g, group in enumerate(layout.groups):
        rows = (layout.group == g) & (weights > 0.0)
        if group.stated:
            yield _Known.of(residuals[rows], levers[rows], weights[rows], 1.0 - leverage[rows])
            continue
        same = _component(layout, rows)
        weight = weights[rows]
        total = np.bincount(same, weight)
        mean, lever = (np.bincount(same, weight * values[rows]) / total for values in (residuals, levers))
        scatter = float(np.sum(weight * (residuals[rows] - mean[same]) ** 2))
        freedom = float(np.sum(np.maximum(total - 1.0, 0.0)))
        if freedom >= _AGAIN and scatter > 0.0:
            left = 1.0 - np.bincount(same, leverage[rows])
            known = _Known.of(mean, lever, np.minimum(total, 1.0), left, np.maximum(total, 1.0))
            yield replace(known, scatter=scatter, freedom=freedom)


def _component(layout: Layout, rows: BoolArray) -> IntArray:
    """Number the components of readings that some rows are, the same for every reading of a pose."""
    component = np.arange(layout.n_rows) - np.searchsorted(layout.reading, layout.reading)
    reader = np.searchsorted(layout.start, layout.reading, side="right")
    places = np.stack([layout.pose_of_row, reader, component])[:, rows]
    return np.unique(places, axis=1, return_inverse=True)[1].reshape(-1)
