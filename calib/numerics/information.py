"""Information: what rows and priors say about the unknowns, and how sure everything that follows from them is.

With u = (p - p_nominal) / s the scaled free parameters, J the whitened rows (each with noise 1) and P a unit row for
each parameter that has a prior (nominal +- s), all rows carry the same noise. So priors, readings already there and new
readings simply stack,

    R = [J; P] = U S V^T            covariance of u = V S^-2 V^T = T T^T,        T = V S^-1

and every question is answered from T: directions outside V are determined by nobody. The error that remains at another
place with scaled derivative B is normal with covariance (B T)(B T)^T; where B reaches outside V it has no bound. Only
noise is counted, not what the model leaves out.

Method: QR of the rows, then SVD of the small factor, so that small singular values keep their digits (forming R^T R
would lose half of them).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib.arrays import BoolArray, FloatArray, ReadOnlyArrays
from calib.numerics.identifiability import Rank, numerical_rank, reduced

OUTSIDE = 1e-6
"""A unit vector that leaves the determined directions by more than this depends on what nobody determines."""


@dataclass(frozen=True, eq=False)
class Information(ReadOnlyArrays):
    """What stacked rows determine.

    Attributes:
        rank: Rank of the rows.
        directions: Orthonormal basis V of what they determine, (n_parameters, rank).
        strengths: Singular value of each direction, largest first, (rank,).
    """

    rank: Rank
    directions: FloatArray
    strengths: FloatArray

    @cached_property
    def root(self) -> FloatArray:
        """T of the module docstring, (n_parameters, rank)."""
        result: FloatArray = self.directions / self.strengths
        return result

    @cached_property
    def undetermined(self) -> BoolArray:
        """Which parameters depend on a direction that nothing determines, (n_parameters,)."""
        return np.sqrt(np.maximum(0.0, 1.0 - np.sum(self.directions**2, axis=1))) > OUTSIDE

    def standard_deviations(self) -> FloatArray:
        """Return the standard deviation of each scaled parameter, infinite where undetermined, (n_parameters,)."""
        return np.where(self.undetermined, np.inf, np.linalg.norm(self.root, axis=1))

    def correlations(self) -> FloatArray:
        """Return correlation coefficients, NaN where a parameter is undetermined, (n_parameters, n_parameters)."""
        norms = np.linalg.norm(self.root, axis=1)
        known = ~self.undetermined & (norms > 0)
        unit = self.root / np.where(known, norms, np.nan)[:, None]
        result: FloatArray = np.clip(unit @ unit.T, -1.0, 1.0)
        return result

    def position_errors(self, rows: FloatArray) -> FloatArray:
        """Return the predicted distance between true and predicted position (root of the mean square) at other poses.

        Args:
            rows: Scaled derivative of positions there, (n, 3 n_targets, n_parameters) [m].

        Returns:
            (n, n_targets) [m]; infinite where a position depends on what the rows do not determine.
        """
        seen = rows @ self.directions
        outside = np.sqrt(np.maximum(0.0, np.sum(rows**2, axis=2) - np.sum(seen**2, axis=2)))
        size = np.sqrt(np.max(np.sum(rows**2, axis=2), initial=0.0))
        variance = np.sum((seen / self.strengths) ** 2, axis=2)
        variance = np.where(outside > OUTSIDE * size, np.inf, variance)
        result: FloatArray = np.sqrt(np.sum(variance.reshape(len(rows), -1, 3), axis=2))
        return result


def information(rows: FloatArray, priors: FloatArray | None = None) -> Information:
    """Say what rows, and priors, determine.

    Args:
        rows: Whitened, of scaled parameters, (..., n_parameters); leading axes are flattened.
        priors: P, (n_priors, n_parameters), of `prior_rows`; none if not given.
    """
    factor = reduced(rows.reshape(-1, rows.shape[-1]))
    if priors is not None and len(priors):
        factor = reduced(np.vstack([factor, priors]))
    rank = numerical_rank(factor)
    directions = np.linalg.svd(factor)[2][: rank.rank].T
    return Information(rank, directions, rank.singular_values[: rank.rank].copy())


def prior_rows(has_prior: BoolArray) -> FloatArray:
    """Return P of the module docstring, (n_priors, n_parameters), from which parameters have a prior."""
    return np.eye(len(has_prior))[has_prior]
