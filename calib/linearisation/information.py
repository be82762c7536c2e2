"""Information: what poses and priors say about the parameters, and how well positions are known then.

With u = (p - p_nominal) / s the scaled free parameters, A the rows of the scaled Jacobian [m] and P the rows sigma e_k
of those parameters k that have a prior (nominal +- s), both kinds of rows carry the noise sigma of one reading. So
priors, poses already measured and new poses simply stack,

    R = [A; P] = U S V^T            covariance of u = sigma^2 V S^-2 V^T

and every question is answered from S and V: directions outside V are determined by nobody. The error that remains at
another pose with scaled Jacobian B is normal with covariance sigma^2 (B V S^-1)(B V S^-1)^T; where B reaches outside V
it has no bound. Only noise is counted, not what the model leaves out.

Method: QR of the rows, then SVD of the small factor, so that small singular values keep their digits (forming R^T R
would lose half of them).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from calib.errors import DataError, InputError
from calib.model.mechanism import BoolArray, FloatArray
from calib.model.parameters import Parameter
from calib.model.robot import Robot
from calib.numerics.identifiability import Rank, numerical_rank, reduced
from calib.read_only import ReadOnlyArrays

ASSUMED_SIGMA = 1e-4
"""Noise of one reading per axis where nobody states it [m]; whoever uses it must say so."""
OUTSIDE = 1e-6
"""A unit vector that leaves the determined directions by more than this depends on what nobody determines."""


def measurement_sigma(robot: Robot, stated: float | None = None) -> tuple[float, bool]:
    """Return the noise of one reading per axis [m] and whether it is only assumed.

    Args:
        robot: Its description may state the noise.
        stated: The noise [m], if the caller knows it.

    Raises:
        DataError: It is not a positive number.
    """
    sigma = stated if stated is not None else robot.description.sigma
    if sigma is None:
        return ASSUMED_SIGMA, True
    if not (np.isfinite(sigma) and sigma > 0):
        raise DataError(f"sigma {sigma:g} m: must be a positive number")
    return sigma, False


def require_free(robot: Robot) -> None:
    """Raise unless some parameter is free.

    Raises:
        InputError: All are held.
    """
    if not np.any(robot.free):
        raise InputError(f"{robot.path}: held: names every parameter, so there is nothing to identify; free some")


def scaled_rows(jacobian: FloatArray, parameters: Iterable[Parameter], chosen: BoolArray) -> FloatArray:
    """Return the chosen columns, each times its parameter's sigma, with the coordinates of a pose in one axis.

    Args:
        jacobian: d(positions)/d(parameters), (n_poses, n_targets, 3, n_parameters) [m per m or rad].
        parameters: All parameters.
        chosen: Columns to keep, (n_parameters,).

    Returns:
        (n_poses, 3 n_targets, n_chosen) [m].
    """
    scales = np.array([parameter.sigma for parameter in parameters])
    rows = jacobian[..., chosen] * scales[chosen]
    result: FloatArray = rows.reshape(len(rows), -1, rows.shape[-1])
    return result


def prior_rows(parameters: Iterable[Parameter], chosen: BoolArray, sigma: float) -> FloatArray:
    """Return the rows P of the module docstring, (n_priors, n_chosen) [m]."""
    kept = [parameter for parameter, use in zip(parameters, chosen, strict=True) if use]
    has_prior = np.array([parameter.prior for parameter in kept], dtype=bool)
    result: FloatArray = sigma * np.eye(len(kept))[has_prior]
    return result


@dataclass(frozen=True, eq=False)
class Information(ReadOnlyArrays):
    """What stacked rows determine.

    Attributes:
        rank: Rank of the rows.
        directions: Orthonormal basis V of what they determine, (n_parameters, rank).
        strengths: Singular value of each direction, largest first, (rank,) [m].
    """

    rank: Rank
    directions: FloatArray
    strengths: FloatArray

    @property
    def undetermined(self) -> BoolArray:
        """Which parameters depend on a direction that nothing determines, (n_parameters,)."""
        return np.sqrt(np.maximum(0.0, 1.0 - np.sum(self.directions**2, axis=1))) > OUTSIDE

    def standard_deviations(self, sigma: float) -> FloatArray:
        """Return the standard deviation of each scaled parameter, infinite where undetermined, (n_parameters,)."""
        spread = sigma * np.linalg.norm(self.directions / self.strengths, axis=1)
        return np.where(self.undetermined, np.inf, spread)

    def correlations(self) -> FloatArray:
        """Return correlation coefficients, NaN where a parameter is undetermined, (n_parameters, n_parameters)."""
        factor = self.directions / self.strengths
        norms = np.linalg.norm(factor, axis=1)
        known = ~self.undetermined & (norms > 0)
        unit = factor / np.where(known, norms, np.nan)[:, None]
        result: FloatArray = np.clip(unit @ unit.T, -1.0, 1.0)
        return result

    def position_errors(self, rows: FloatArray, sigma: float) -> FloatArray:
        """Return the predicted distance between true and predicted position (root of the mean square) at other poses.

        Args:
            rows: Scaled Jacobian there, (n, 3 n_targets, n_parameters) [m].
            sigma: Noise of one reading per axis [m].

        Returns:
            (n, n_targets) [m]; infinite where a position depends on what the rows do not determine.
        """
        seen = rows @ self.directions
        outside = np.sqrt(np.maximum(0.0, np.sum(rows**2, axis=2) - np.sum(seen**2, axis=2)))
        size = np.sqrt(np.max(np.sum(rows**2, axis=2), initial=0.0))
        variance = sigma**2 * np.sum((seen / self.strengths) ** 2, axis=2)
        variance = np.where(outside > OUTSIDE * size, np.inf, variance)
        result: FloatArray = np.sqrt(np.sum(variance.reshape(len(rows), -1, 3), axis=2))
        return result


def information(rows: FloatArray, more: FloatArray | None = None) -> Information:
    """Stack rows and say what they determine.

    Args:
        rows: Scaled Jacobian, (..., n_parameters) [m]; leading axes are flattened.
        more: Further rows of the same noise, such as priors, (n_more, n_parameters) [m].
    """
    width = rows.shape[-1]
    flat = rows.reshape(-1, width)
    if more is not None and len(more):
        flat = np.vstack([flat, more])
    factor = reduced(flat)
    rank = numerical_rank(factor)
    directions = np.linalg.svd(factor)[2][: rank.rank].T
    return Information(rank, directions, rank.singular_values[: rank.rank].copy())
