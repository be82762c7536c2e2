"""How sure the parameters are: covariance, intervals and the found noise of a least-squares fit with priors.

Unknowns u = (p - p_nominal) / s with scales s (the parameters' sigma). Data rows J u ~ N(r, sigma^2), and for
parameters that have a prior u ~ N(0, 1). Then

    covariance of u          C = (J^T J / sigma^2 + P)^-1,     P = 1 for a prior, else 0
    effective parameters     n_eff = trace(C J^T J / sigma^2)   (the rank, where no prior takes part)
    degrees of freedom       rows - n_eff
    found noise              sigma^2 = |r|^2 / (rows - n_eff)

The part of a parameter that the data decide is 1 - C_kk (prior variance 1): near 1 the measurements know the value,
near 0 the prior holds it.

Reference: GUM (JCGM 100:2008); Tarantola 2005, section 3.2, for the resolution.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.stats import t as student_t

from calib.errors import NotIdentifiableError
from calib.mechanism import BoolArray, FloatArray

DECIDED_BY_DATA = 0.9
"""Least share of a parameter's variance that the data must remove for status `identified`; below 1 - this, `prior`."""


@dataclass(frozen=True, eq=False)
class Statistics:
    """Statistics of a fit.

    Attributes:
        sigma: Found standard deviation of one reading per axis [m].
        freedom: Degrees of freedom, rows minus effective parameters.
        covariance: Of the free parameters, (n_free, n_free) [m, rad].
        std: Their standard deviations, (n_free,) [m, rad].
        half_width: Half the 95 % interval of each, (n_free,) [m, rad].
        data_share: Part of each that the data decide, 0 to 1, (n_free,).
    """

    sigma: float
    freedom: float
    covariance: FloatArray
    std: FloatArray
    half_width: FloatArray
    data_share: FloatArray

    def status(self) -> list[str]:
        """Return `identified`, `partly` or `prior` for each free parameter."""
        return [
            "identified" if share >= DECIDED_BY_DATA else "prior" if share <= 1 - DECIDED_BY_DATA else "partly"
            for share in self.data_share
        ]


def effective_parameters(scaled_jacobian: FloatArray, has_prior: BoolArray, sigma: float) -> float:
    """Return n_eff of the module docstring for an assumed noise sigma [m]."""
    information = scaled_jacobian.T @ scaled_jacobian
    if not np.any(has_prior):
        return float(scaled_jacobian.shape[1])
    posterior = _inverse(information + sigma**2 * np.diag(has_prior.astype(float)))
    return float(np.sum(posterior * information))


def statistics(
    scaled_jacobian: FloatArray, residuals: FloatArray, scales: FloatArray, has_prior: BoolArray, sigma_assumed: float
) -> Statistics:
    """Return the statistics at the solution.

    Args:
        scaled_jacobian: d(data rows)/du, rows weighted so that all have the noise of one reading, (n_rows, n_free) [m].
        residuals: Data residuals of the same rows, (n_rows,) [m].
        scales: s of the module docstring, (n_free,) [m, rad].
        has_prior: Which parameters have a prior, (n_free,).
        sigma_assumed: Noise that weighed data against priors in the fit [m].

    Raises:
        NotIdentifiableError: No degrees of freedom are left.
    """
    freedom = len(residuals) - effective_parameters(scaled_jacobian, has_prior, sigma_assumed)
    if freedom < 1:
        raise NotIdentifiableError(
            f"{len(residuals)} measured coordinates leave {freedom:.1f} degrees of freedom; without at"
            " least one, no uncertainty can be stated: measure more poses"
        )
    sigma = float(np.sqrt(residuals @ residuals / freedom))
    information = scaled_jacobian.T @ scaled_jacobian
    prior = np.diag(has_prior.astype(float))
    # written without dividing by sigma, which is zero for exact data
    scaled_covariance = sigma**2 * _inverse(information + sigma**2 * prior)
    covariance = scales[:, None] * scaled_covariance * scales
    std: FloatArray = np.sqrt(np.diag(covariance))
    share = np.where(has_prior, 1.0 - np.diag(scaled_covariance), 1.0)
    return Statistics(sigma, freedom, covariance, std, float(student_t.ppf(0.975, freedom)) * std, share)


def _inverse(matrix: FloatArray) -> FloatArray:
    inverse: FloatArray = cho_solve(cho_factor(matrix), np.eye(len(matrix)))
    return inverse
