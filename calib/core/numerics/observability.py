"""Observability indices: how well a set of poses determines the parameters, as one number.

With singular values s1 >= ... >= sn of the identification Jacobian (n kept columns, m poses):

    O1 = (s1 s2 ... sn)^(1/n) / sqrt(m)      Borm and Menq 1989
    O2 = sn / s1                             Driels and Pathre 1990
    O3 = sn                                  Nahvi and Hollerbach 1994
    O4 = sn^2 / s1                           Nahvi and Hollerbach 1996
    O5 = 1 / (1/s1 + ... + 1/sn)             Sun and Hollerbach 2008

Only the order that O1 gives does not depend on the units of the parameters (a change of units multiplies every O1 by
the same number); the others are meaningful on scaled columns. None of them is a length that a user needs, as the error
predicted where the robot will work is.

The information of rows and priors on the unknowns decides the uncertainty of everything that follows. With u = (p
- p_expected) / s the scaled free parameters, J the whitened rows (each with noise 1) and P the rows of the prior
(`calib.core.numerics.prior`: a unit row for each parameter that has one), all rows carry the same noise. So priors,
readings already there and new readings simply stack,

    R = [J; P] = U S V^T            covariance of u = V S^-2 V^T = T T^T,        T = V S^-1

and every further quantity follows from T: directions outside V are not determined. The error that remains at another
place with scaled derivative B is normal with covariance (B T)(B T)^T; where B reaches outside V it has no bound. Only
noise is counted, not what the model leaves out.

Method: QR of the rows, then SVD of the small factor, so that small singular values keep their digits (R^T R would lose
half of them; it is taken for many columns with priors, where the condition shows that this does no harm). Where that
factor is far from singular, its inverse is a T as well, in a thirtieth of the time: T and T Q, with a rotation Q, have
the same products.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from calib.core.base.arrays import BoolArray, FloatArray, ReadOnlyArrays, hold
from calib.core.numerics import linalg
from calib.core.numerics.identifiability import (
    MANY_COLUMNS,
    Rank,
    factor_products,
    inverse_of_triangle,
    rank_of,
    reduce_rows,
    square_of_triangle,
)
from calib.core.numerics.prior import Prior

INDICES = ("O1", "O2", "O3", "O4", "O5")
OUTSIDE = 1e-6
"""A unit vector is undetermined if its part outside the determined directions is at least this long."""
_CLEAR = 1e-6  # if 1 / condition of a factor is larger, no singular value is near the threshold of the rank


def observability(singular_values: FloatArray, n_poses: int) -> dict[str, float]:
    """Return O1 to O5.

    >>> observability([4.0, 1.0], n_poses=4)
    {'O1': 1.0, 'O2': 0.25, 'O3': 1.0, 'O4': 0.25, 'O5': 0.8}

    All indices are 0 where the Jacobian loses rank exactly.

    Args:
        singular_values: All singular values of the Jacobian, as many as it has columns, largest first, (n,).
    """
    s = np.asarray(singular_values, dtype=float)
    if s[-1] <= 0:
        return dict.fromkeys(INDICES, 0.0)
    return {
        "O1": float(np.exp(np.mean(np.log(s))) / np.sqrt(n_poses)),
        "O2": float(s[-1] / s[0]),
        "O3": float(s[-1]),
        "O4": float(s[-1] ** 2 / s[0]),
        "O5": float(1.0 / np.sum(1.0 / s)),
    }


@dataclass(frozen=True, eq=False)
class Information(ReadOnlyArrays):
    """Information of stacked rows by their triangular `factor` R, (n_parameters, n_parameters) or fewer rows."""

    factor: FloatArray

    @cached_property
    def _decomposition(self) -> tuple[Rank, FloatArray]:
        _, values, directions = linalg.svd(self.factor)
        return rank_of(values, self.factor.shape[1]), directions

    @property
    def rank(self) -> Rank:
        """Rank of the rows."""
        return self._decomposition[0]

    @property
    def directions(self) -> FloatArray:
        """Orthonormal basis V of the determined directions, (n_parameters, rank)."""
        rank, directions = self._decomposition
        return directions[: rank.rank].T

    @property
    def strengths(self) -> FloatArray:
        """Singular value of each direction, largest first, (rank,)."""
        return self.rank.singular_values[: self.rank.rank]

    @cached_property
    def _all_clear(self) -> bool:
        """Whether the rows clearly determine every direction, so that no singular value is needed."""
        rows, columns = self.factor.shape
        return rows == columns > 0 and float(scipy.linalg.lapack.dtrcon(self.factor)[0]) >= _CLEAR

    @cached_property
    def root(self) -> FloatArray:
        """T of the module docstring, up to a rotation of its columns, (n_parameters, rank)."""
        return inverse_of_triangle(self.factor) if self._all_clear else self.directions / self.strengths

    @property
    def covariance(self) -> FloatArray:
        """T T^T, (n_parameters, n_parameters)."""
        return square_of_triangle(self.root) if self._all_clear else self.root @ self.root.T

    def solve(self, right: FloatArray) -> FloatArray:
        """Return T T^T times columns, (n_parameters, n), or times one (n_parameters,)."""
        if not self._all_clear:
            return self.root @ (self.root.T @ right)
        return np.asarray(scipy.linalg.lapack.dpotrs(self.factor, right)[0])

    def covariance_from(self, core: FloatArray) -> FloatArray:
        """Return T C T^T for a core C (rank, rank), (n_parameters, n_parameters)."""
        if not self._all_clear:
            return self.root @ core @ self.root.T
        left: FloatArray = scipy.linalg.blas.dtrmm(1.0, self.root, core)
        return np.asarray(scipy.linalg.blas.dtrmm(1.0, self.root, left, side=1, trans_a=1, overwrite_b=1))

    @cached_property
    def undetermined(self) -> BoolArray:
        """Mask of the parameters that depend on an undetermined direction, (n_parameters,)."""
        return np.sqrt(np.maximum(0.0, 1.0 - np.sum(self.directions**2, axis=1))) > OUTSIDE

    def standard_deviations(self) -> FloatArray:
        """Return the standard deviation of each scaled parameter, infinite where undetermined, (n_parameters,)."""
        return np.where(self.undetermined, np.inf, np.linalg.norm(self.root, axis=1))

    def correlations(self) -> FloatArray:
        """Return correlation coefficients, NaN where a parameter is undetermined, (n_parameters, n_parameters)."""
        norms = np.linalg.norm(self.root, axis=1)
        determined = ~self.undetermined & (norms > 0)
        unit = self.root / np.where(determined, norms, np.nan)[:, None]
        return np.clip(unit @ unit.T, -1.0, 1.0)

    def position_errors(self, rows: FloatArray) -> FloatArray:
        """Return the root mean square distance between true and predicted position at other poses, (n, n_targets) [m].

        It is infinite where a position depends on an undetermined direction.

        Args:
            rows: Scaled derivative of positions there, (n, 3 n_targets, n_parameters) [m].
        """
        projected = rows @ self.directions
        outside = np.sqrt(np.maximum(0.0, np.sum(rows**2, axis=2) - np.sum(projected**2, axis=2)))
        size = np.sqrt(np.max(np.sum(rows**2, axis=2), initial=0.0))
        variance = np.sum((projected / self.strengths) ** 2, axis=2)
        variance = np.where(outside > OUTSIDE * size, np.inf, variance)
        return np.sqrt(np.sum(variance.reshape(len(rows), -1, 3), axis=2))


def information(rows: FloatArray, priors: FloatArray | None = None) -> Information:
    """Return the information of rows and priors.

    Args:
        rows: Whitened, of scaled parameters, (..., n_parameters); leading axes are flattened.
        priors: P, (n_priors, n_parameters), of `calib.core.numerics.prior`; none if not given.
    """
    rows = rows.reshape(-1, rows.shape[-1])
    if priors is None or not len(priors):
        factor = reduce_rows(rows)
    else:
        few = rows if len(rows) <= rows.shape[1] else reduce_rows(rows)
        factor = reduce_rows(np.vstack([few, priors]))
    hold(factor)
    return Information(factor)


def posterior_information(rows: FloatArray, prior: Prior) -> Information:
    """Return the information of whitened rows (n_rows, n_parameters) and of a prior."""
    if rows.shape[1] >= MANY_COLUMNS and np.any(prior.has):
        quick = factor_products(prior.add_to(rows.T @ rows))
        if quick is not None:
            return Information(quick)
    return information(rows, prior.rows)
