"""The uncertainty of parameters: covariance, intervals and the found noise of a least-squares fit with priors.

Unknowns are u = (p - p_expected) / s with scales s (the parameters' sigma). Whitened data rows have J u ~ N(r, f^2),
with f the true noise over the assumed noise (1 where it was found from the residuals, about 1 where it was
stated well). Parameters with a prior have P u ~ N(0, I) (`calib.core.numerics.prior`: mostly u ~ N(0, 1) for each).
With T T^T = (J^T J + P^T P)^-1 (`calib.core.numerics.observability`):

    S = T^T P^T P T                          the share that the priors have in each direction
    effective parameters                     n_eff = trace(I - S)       (the number of free ones without any prior)
    degrees of freedom                       rows - n_eff
    found factor                             f^2 = |r|^2 / (rows - n_eff)
    covariance of u                          C = T (f^2 (I - S) + S) T^T

E |r|^2 = f^2 (rows - n_eff) holds when the deviations are as large as the priors say; then C is also the posterior
covariance. Where the stated noise and the found noise differ, C still gives the scatter of the estimate. With several
groups of rows (instruments, or position and orientation), each with its own factor f_g from its own rows,

    f_g^2 = |r_g|^2 / (rows_g - trace(T^T J_g^T J_g T)),         C = T (sum of f_g^2 T^T J_g^T J_g T + S) T^T

Where the readings of a pose share errors, or some poses scatter more than others, beyond chance, the sum between T and
its transpose is replaced by the scatter of the poses themselves (`calib.core.numerics.clusters`).
`calib.core.numerics.size_search` adds to C where the size of some priors was found from the same data.
`calib.core.fitting.robust` gives f and its counterpart in C with a robust loss. `calib.core.fitting.curvature` adds to
the variance in intervals; this takes longer than all the rest, and is computed only when intervals are asked for.

Intervals are value +- t std, widened as above, with Student's t at 97.5 %, because the noise is found from the same
residuals. Its degrees of freedom are those above, or those of the scatter of poses if that is used and has fewer. The
data decide the share 1 - C_kk of a parameter (prior variance 1): near 1 the measurements know the value, near 0 the
prior holds it.

When it fails. The rest is linear in the parameters at the solution, and counts noise that is independent from pose to
pose. Errors that the model leaves out are not noise: `calib.core.judging.residual_patterns` tests for them.

Reference: jcgm100 (GUM), sections 4.2 and G.3; tarantola2005, section 3.2, for the resolution.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from calib.core.base.arrays import BoolArray, FloatArray, IntArray, ReadOnlyArrays, hold
from calib.core.base.errors import NotIdentifiableError
from calib.core.base.threads import one_blas_thread
from calib.core.numerics.clusters import Scatter
from calib.core.numerics.observability import Information
from calib.core.numerics.prior import Prior
from calib.core.numerics.tall import Span, slices, squares_of_rows

DECIDED_BY_DATA = 0.9
"""`identified`: the data remove at least this share of a parameter's expected variance; `prior`: at most 1 - this."""
_BY_PRIOR = 1.0 - DECIDED_BY_DATA
_ENOUGH = 0.5  # with fewer degrees of freedom, the rows of a group say nothing about its noise


@dataclass(frozen=True, eq=False)
class Factors(ReadOnlyArrays):
    """Factors on the assumed noise, from the residuals.

    Attributes:
        values: f of each group of rows, (n_groups,).
        freedom: Degrees of freedom of each group, (n_groups,).
        effective: Factor for the scatter of the parameters, in place of f in C, (n_groups,); `values`, except with a
            robust loss.
        slope: Ratio of the weight of the data against priors, with and without the robust loss; 1 if there is none.
        confirmed: Degrees of freedom among these that confirmed the assumed noise before, without residuals here.
    """

    values: FloatArray
    freedom: FloatArray
    effective: FloatArray
    slope: float = 1.0
    confirmed: float = 0.0

    @property
    def total_freedom(self) -> float:
        """Degrees of freedom of all groups."""
        return float(np.sum(self.freedom))

    @property
    def common(self) -> float:
        """One factor in place of those of all groups."""
        return float(np.sqrt(np.sum(self.freedom * self.values**2) / self.total_freedom))


class BeyondLinear:
    """Mean square error of parameters beyond the linear model, (n_free,) [m^2, rad^2], computed at first use."""

    def __init__(self, compute: Callable[[], FloatArray]) -> None:
        self._compute = compute

    @cached_property
    def values(self) -> FloatArray:
        """The mean square errors, (n_free,) [m^2, rad^2]."""
        values = one_blas_thread(self._compute)()
        hold(values)
        return values

    def __getstate__(self) -> dict[str, FloatArray]:  # values alone, without the data that `compute` holds
        return {"values": self.values}


@dataclass(frozen=True, eq=False)
class Statistics(ReadOnlyArrays):
    """Uncertainty of the free parameters.

    Attributes:
        factors: Factors on the assumed noise, from the residuals.
        freedom: Degrees of freedom, rows minus effective parameters.
        covariance: Covariance of the free parameters, (n_free, n_free) [m, rad].
        std: Standard deviations, (n_free,) [m, rad].
        data_share: Part of each that the data decide, 0 to 1, (n_free,).
        effective_parameters: Number of parameters that the data decide, n_eff of the module docstring.
        shared_scatter: Scatter of the readings of each pose, where it is larger than that of independent ones beyond
            chance; else None.
        beyond_linear: Errors beyond the linear model, which enter `half_width` only; None if there are none.
        wider: Further factor on standard deviations and intervals, (n_free,).
    """

    factors: Factors
    freedom: float
    covariance: FloatArray
    std: FloatArray
    data_share: FloatArray
    effective_parameters: float
    shared_scatter: Scatter | None = None
    beyond_linear: BeyondLinear | None = None
    wider: FloatArray | float = 1.0

    @cached_property
    def half_width(self) -> FloatArray:
        """Half the 95 % interval of each parameter, (n_free,) [m, rad]."""
        beyond = 0.0 if self.beyond_linear is None else self.beyond_linear.values
        half = self.wider * self.coverage_factor * np.sqrt((self.std / self.wider) ** 2 + beyond)
        hold(half)
        return half

    @property
    def interval_freedom(self) -> float:
        """Degrees of freedom of the intervals."""
        return self.freedom if self.shared_scatter is None else min(self.freedom, self.shared_scatter.freedom)

    @property
    def coverage_factor(self) -> float:
        """Half a 95 % interval, in standard deviations."""
        return float(scipy.special.stdtrit(self.interval_freedom, 0.975))

    def widen(self, factor: float, more: FloatArray | float = 0.0) -> Statistics:
        """Return the statistics, deviations and intervals multiplied by a factor, with further variances (n_free,)."""
        std = np.sqrt((factor * self.std) ** 2 + more)
        wider = np.divide(std, self.std, out=np.full_like(std, factor), where=self.std > 0)
        return replace(self, std=std, wider=wider * self.wider)


def status(
    data_share: FloatArray, relative_std: FloatArray, prior: BoolArray, placement: BoolArray
) -> NDArray[np.str_]:
    """Return the source of each free parameter's value, (n,).

    With a prior: `identified`, `partly` or `prior`, by the share of the prior's variance that the data removed. Without
    a prior: `identified` if the same share of the expected error's variance is gone, otherwise `weak`. A parameter of
    an unknown place of base or target has no expected error either: `placed`.

    Args:
        data_share: The attribute of `Statistics`, (n,).
        relative_std: Standard deviations over the sigmas of the description, (n,).
        prior: Mask of the parameters with a prior, (n,).
        placement: Mask of those that belong to an unknown place of base or target, (n,).
    """
    by_data = np.where(prior, data_share, 1.0 - relative_std**2) >= DECIDED_BY_DATA
    sources = {"placed": ~prior & placement, "identified": by_data, "weak": ~prior, "prior": data_share <= _BY_PRIOR}
    return np.select(list(sources.values()), list(sources), "partly")


@dataclass(frozen=True)
class ChiSquare:
    """The stated noise against the residuals.

    Attributes:
        value: |r|^2 of whitened residuals.
        freedom: Mean of `value` if the statement is right.
        p_larger, p_smaller: Chance of a value at least as large, or as small, if the statement is right.
    """

    value: float
    freedom: float
    p_larger: float
    p_smaller: float


def chi_square(factor: float, freedom: float) -> ChiSquare:
    """Compare the found noise with the stated noise; `factor` is their ratio."""
    value = freedom * factor**2
    return ChiSquare(
        value, freedom, float(scipy.special.chdtrc(freedom, value)), float(scipy.special.chdtr(freedom, value))
    )


def prior_shares(known: Information, prior: Prior) -> FloatArray:
    """Return S of the module docstring, (rank, rank), from the information of rows and priors, and the priors."""
    held = prior.times(known.root)
    return held.T @ held


def effective_parameters(known: Information, prior: Prior) -> float:
    """Return n_eff of the module docstring, the number of parameters that the rows decide and not the priors."""
    return float(known.root.shape[1] - np.sum(prior.times(known.root) ** 2))


def require_freedom(freedom: float, n_rows: int) -> None:
    """Raise `NotIdentifiableError` unless n_rows measured values leave at least one degree of freedom."""
    if freedom < 1 - 1e-9:
        raise NotIdentifiableError(
            f"{n_rows} measured values for {n_rows - max(freedom, 0.0):.0f} parameters: too few to find the"
            " uncertainty of the result. Measure more poses"
        )


def find_factors(
    residuals: FloatArray,
    span: FloatArray | Span,
    groups: IntArray,
    n_groups: int,
    confirmed: FloatArray | None = None,
) -> Factors:
    """Return the factor on the assumed noise of each group of rows.

    Args:
        residuals: Whitened, (n_rows,).
        span: J T of the whitened rows, with T of rows and priors, (n_rows, rank).
        groups: Group of each row, (n_rows,); -1 for rows that were not read.
        confirmed: Degrees of freedom with which the assumed noise was confirmed before, (n_groups,); they count like
            readings whose residuals are as large as assumed.

    Raises:
        NotIdentifiableError: No degrees of freedom are left.
    """
    own = (groups[:, None] == np.arange(n_groups)).astype(float)
    squares, freedom = residuals**2 @ own, (1.0 - squares_of_rows(span)) @ own
    if confirmed is not None:
        squares, freedom = squares + confirmed, freedom + confirmed
    require_freedom(float(np.sum(freedom)), int(np.sum(groups >= 0)))
    total = np.sum(squares) / np.sum(freedom)  # for a group whose own rows say nothing about its noise
    factor = np.sqrt(np.where(freedom > _ENOUGH, squares / np.maximum(freedom, _ENOUGH), total))
    return Factors(factor, freedom, factor, confirmed=0.0 if confirmed is None else float(np.sum(confirmed)))


def statistics(
    span: FloatArray | Span,
    groups: IntArray,
    known: Information,
    factors: Factors,
    scales: FloatArray,
    prior: Prior,
    poses: Scatter | None = None,
    beyond_linear: BeyondLinear | None = None,
    expand: Callable[[FloatArray], tuple[FloatArray, BoolArray]] | None = None,
) -> Statistics:
    """Return the statistics at the solution.

    Args:
        span: J T of the whitened rows, with T of `known`, (n_rows, rank).
        groups: Group of each row, (n_rows,); -1 for rows that were not read.
        known: Information of these rows (times the root of `factors.slope`) and of the `prior`.
        factors: Factors on the noise, from the residuals.
        scales: s of the module docstring, (n_free,) [m, rad].
        poses, beyond_linear: Attributes of the result.
        expand: Where the rows are those of components in place of parameters: returns the covariance of u
            (n_free, n_free) from that of the components, and which parameters have priors (n_free,).
    """
    core = prior_shares(known, prior)  # with a robust loss, J is times the root of the slope in T
    if poses is not None:
        core += poses.core
    elif len(factors.effective) == 1:  # the rows have the rest of the information
        core += factors.slope * factors.effective[0] ** 2 * (np.eye(len(core)) - core)
    else:
        for part in slices(len(span)):
            pulled, number = span[part], groups[part]
            for group, factor in enumerate(factors.effective):
                own = pulled[number == group]
                core += (factors.slope * factor) ** 2 * (own.T @ own)
    of_u = known.covariance_from(core)
    of_u, has_prior = (of_u, prior.has) if expand is None else expand(of_u)
    covariance = np.multiply.outer(scales, scales)
    covariance *= (of_u + of_u.T) / 2  # symmetric to the last digit
    hold(covariance)
    std, share = np.sqrt(np.diag(covariance)), np.where(has_prior, np.clip(1.0 - np.diag(of_u), 0.0, 1.0), 1.0)
    decides = effective_parameters(known, prior)
    return Statistics(factors, factors.total_freedom, covariance, std, share, decides, poses, beyond_linear)
