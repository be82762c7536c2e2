"""How sure the parameters are: covariance, intervals and the found noise of a least-squares fit with priors.

Unknowns u = (p - p_nominal) / s with scales s (the parameters' sigma). Data rows J u ~ N(r, sigma^2), and for
parameters that have a prior u ~ N(0, 1). With sigma_a the noise that weighed data against priors, and P = 1 for a
prior, else 0:

    A = J^T J + sigma_a^2 P                             R^T R = A      (QR of the stacked rows, never of J^T J)
    S = sigma_a^2 R^-T P R^-1                           the share that the priors have in each direction
    effective parameters     n_eff = trace(I - S)       (the number of free ones, where no prior takes part)
    degrees of freedom       rows - n_eff
    found noise              sigma^2 = |r|^2 / (rows - n_eff)
    covariance of u          C = R^-1 (sigma^2 (I - S) + sigma_a^2 S) R^-T

E |r|^2 = sigma^2 (rows - n_eff) holds when the deviations are as large as the priors say; then C is also the
posterior covariance. Where sigma_a was stated and the found noise differs, C still says how far the estimate scatters.
A robust loss changes what a residual tells: see `calib.identification.robust`, which gives sigma and its counterpart in
C.

Intervals are value +- t std with Student's t at 97.5 % and the degrees of freedom above, because sigma is found from
the same residuals. The part of a parameter that the data decide is 1 - C_kk (prior variance 1): near 1 the
measurements know the value, near 0 the prior holds it.

When it fails. All of it is linear in the parameters at the solution, and counts noise that is independent from reading
to reading. Errors that the model leaves out are not noise: `calib.identification.systematic` tests for them.

Reference: jcgm100 (GUM), sections 4.2 and G.3; tarantola2005, section 3.2, for the resolution.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.linalg import solve_triangular
from scipy.stats import chi2
from scipy.stats import t as student_t

from calib.errors import NotIdentifiableError
from calib.model.mechanism import BoolArray, FloatArray
from calib.read_only import ReadOnlyArrays

DECIDED_BY_DATA = 0.9
"""Share of a parameter's expected variance that the data must remove for `identified`; up to 1 - this, `prior`."""
Status = Literal["identified", "partly", "prior", "weak", "placed", "held"]
"""What a parameter's value rests on; see `status`."""
_BY_PRIOR = 1.0 - DECIDED_BY_DATA
EXACT = 1e-9
"""Noise below this [m] is rounding: the data were computed, not measured."""


@dataclass(frozen=True)
class Noise:
    """What the residuals say about the noise.

    Attributes:
        sigma: Standard deviation of one reading per axis [m].
        freedom: Degrees of freedom that it was found with.
        effective: Noise that gives the scatter of the parameters [m]; `sigma`, except with a robust loss.
        slope: How much less the data weigh against priors than without a robust loss; 1 without one.
    """

    sigma: float
    freedom: float
    effective: float
    slope: float = 1.0


@dataclass(frozen=True, eq=False)
class Statistics(ReadOnlyArrays):
    """Statistics of a fit.

    Attributes:
        sigma: Found standard deviation of one reading per axis [m].
        freedom: Degrees of freedom, rows minus effective parameters.
        covariance: Of the free parameters, (n_free, n_free) [m, rad].
        std: Their standard deviations, (n_free,) [m, rad].
        half_width: Half the 95 % interval of each, (n_free,) [m, rad].
        data_share: Part of each that the data decide, 0 to 1, (n_free,).
        effective_parameters: How many parameters the data decide, n_eff of the module docstring.
    """

    sigma: float
    freedom: float
    covariance: FloatArray
    std: FloatArray
    half_width: FloatArray
    data_share: FloatArray
    effective_parameters: float

    @property
    def coverage_factor(self) -> float:
        """How many standard deviations make half a 95 % interval."""
        return float(student_t.ppf(0.975, self.freedom))

    def correlations(self) -> FloatArray:
        """Return the correlation coefficients of the free parameters, (n_free, n_free); NaN where nothing scatters."""
        with np.errstate(divide="ignore", invalid="ignore"):
            unit = self.covariance / self.std / self.std[:, None]
        result: FloatArray = np.clip(unit, -1.0, 1.0)
        return result


def status(data_share: float, relative_std: float, *, prior: bool, placement: bool) -> Status:
    """Return what a free parameter's value rests on.

    With a prior: `identified`, `partly` or `prior`, by the share of the prior's variance that the data removed. Without
    one the measurements alone decide, so that only their precision can be judged: `identified` where the same share of
    the expected error's variance is gone, `weak` where they say little more than the drawing. An unknown place of base
    or target has neither a prior nor a drawing to compare with: `placed`.

    Args:
        data_share: Of `Statistics`.
        relative_std: Standard deviation over the sigma of the description.
        prior: Whether the parameter has a prior.
        placement: Whether it is part of an unknown place of base or target.
    """
    if prior:
        return "identified" if data_share >= DECIDED_BY_DATA else "prior" if data_share <= _BY_PRIOR else "partly"
    if placement:
        return "placed"
    return "identified" if 1.0 - relative_std**2 >= DECIDED_BY_DATA else "weak"


@dataclass(frozen=True)
class ChiSquare:
    """The stated noise against the residuals.

    Attributes:
        value: |r|^2 / sigma_stated^2.
        freedom: What it is on average if the statement is right.
        p_larger, p_smaller: Chance of a value at least as large, or as small, if the statement is right.
    """

    value: float
    freedom: float
    p_larger: float
    p_smaller: float


def chi_square(sigma: float, freedom: float, sigma_stated: float) -> ChiSquare:
    """Compare a found noise with a stated one [m]."""
    value = freedom * (sigma / sigma_stated) ** 2
    return ChiSquare(value, freedom, float(chi2.sf(value, freedom)), float(chi2.cdf(value, freedom)))


def prior_shares(scaled_jacobian: FloatArray, has_prior: BoolArray, sigma: float) -> tuple[FloatArray, FloatArray]:
    """Return R^-1 and S of the module docstring, (n_free, n_free) each.

    Args:
        scaled_jacobian: J, or any matrix with the same J^T J, such as its R factor, (n, n_free) [m].
        has_prior: Which parameters have a prior, (n_free,).
        sigma: sigma_a [m].
    """
    stacked = np.vstack([scaled_jacobian, sigma * np.eye(len(has_prior))[has_prior]])
    inverse: FloatArray = solve_triangular(np.linalg.qr(stacked, mode="r"), np.eye(len(has_prior)))
    held = inverse[has_prior]
    return inverse, sigma**2 * held.T @ held


def effective_parameters(scaled_jacobian: FloatArray, has_prior: BoolArray, sigma: float) -> float:
    """Return n_eff of the module docstring.

    Args:
        scaled_jacobian: J, or any matrix with the same J^T J, such as its R factor, (n, n_free) [m].
        has_prior: Which parameters have a prior, (n_free,).
        sigma: Assumed noise [m].
    """
    if not np.any(has_prior):
        return float(len(has_prior))
    return float(len(has_prior) - np.trace(prior_shares(scaled_jacobian, has_prior, sigma)[1]))


def found_noise(residuals: FloatArray, n_effective: float) -> Noise:
    """Return the noise of plain least squares.

    Args:
        residuals: Data residuals with the noise of one reading, (n_rows,) [m].
        n_effective: Effective parameters.

    Raises:
        NotIdentifiableError: No degrees of freedom are left.
    """
    freedom = len(residuals) - n_effective
    require_freedom(freedom, len(residuals))
    sigma = float(np.sqrt(residuals @ residuals / freedom))
    return Noise(sigma, freedom, sigma)


def require_freedom(freedom: float, n_rows: int) -> None:
    """Raise `NotIdentifiableError` unless at least one degree of freedom is left of n_rows coordinates."""
    if freedom < 1 - 1e-9:
        raise NotIdentifiableError(
            f"{n_rows} measured coordinates leave {max(freedom, 0.0):.1f} degrees of freedom; without at"
            " least one, no uncertainty can be stated: measure more poses"
        )


def statistics(
    scaled_jacobian: FloatArray, noise: Noise, scales: FloatArray, has_prior: BoolArray, sigma_assumed: float
) -> Statistics:
    """Return the statistics at the solution.

    Args:
        scaled_jacobian: d(data rows)/du, rows weighted so that all have the noise of one reading, (n_rows, n_free) [m],
            or any matrix with the same J^T J.
        noise: What the residuals say.
        scales: s of the module docstring, (n_free,) [m, rad].
        has_prior: Which parameters have a prior, (n_free,).
        sigma_assumed: Noise that weighed data against priors in the fit [m].
    """
    sigma_prior = sigma_assumed / np.sqrt(noise.slope)
    inverse, share = prior_shares(scaled_jacobian, has_prior, sigma_prior)
    core = noise.effective**2 * (np.eye(len(share)) - share) + sigma_prior**2 * share
    scaled_covariance = inverse @ core @ inverse.T
    covariance = scales[:, None] * scaled_covariance * scales
    std: FloatArray = np.sqrt(np.diag(covariance))
    decided = np.where(has_prior, np.clip(1.0 - np.diag(scaled_covariance), 0.0, 1.0), 1.0)
    half_width = float(student_t.ppf(0.975, noise.freedom)) * std
    n_effective = float(len(has_prior) - np.trace(share))
    return Statistics(noise.sigma, noise.freedom, covariance, std, half_width, decided, n_effective)
