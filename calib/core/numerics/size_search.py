"""Sizes of a mixed model: the likeliest ones, and others that the rows do not exclude.

Prior. The size of a family has a half-Cauchy density, 1 / (1 + s^2), around the expected s = 1 (gelman2006), which lets
sizes grow where rows demand it. The density of the noise and of the scatter d is flat. Whether a family is there at all
is asked by the largest density of s, which may be at s = 0. If it is known to be there (`MixedRows.present`), the
largest density of log s counts, s / (1 + s^2) times the likelihood: it is never at zero, and it is at the expected
s = 1 where rows say nothing (chung2013).

Search. Newton's steps on the logarithms of the sizes use the average information (`calib.core.numerics.mixed_model`),
which is positive, plus the curvature of the prior. A step that does not lower the cost is shortened, to the minimum of
a parabola along it, and tried again. The one start has families half as large as expected, and noise and scatter each a
part of the residuals that flat columns leave. A step leaves out sizes at a bound that would go beyond it: cut short,
they would turn it uphill. The least bound is as good as zero, and the cost has no slope by the logarithm there. So
where a search ends, sizes that are zero, or that no row sees, are raised if this promises a lower cost, and the search
goes on. With the slope b and the information I by t = s^2 at zero, the cost changes by b t + I t^2 / 2 + log(1 + t).

Draws. The likelihood is even in every size s: an absent family has its maximum at s = 0, where log s has no scale. So
the posterior is approximated by a normal one in s itself, and drawn sizes are made positive. With I Fisher's
information of the logarithms and g the gradient of -log L,

    information of s   =   I / s^2  +  max(g, 0) / s^2  +  2 / (1 + s^2)^2

the first term for a size that rows show, the second for a size that they exclude (there, g / s^2 is the slope by
s^2 / 2, which stays finite), the third for the prior. Noise and d have no prior. In its place, a third term comes from
the value that would explain all that the likeliest model leaves.

Noise alone. Scales of groups of rows are sizes without families. Without priors, their search begins with what the
columns leave of the rows of each group, unweighted: for one group this is the answer. With priors, which may explain
the same residuals as noise does, it begins with given scales. The scale of exact rows falls to rounding.

Uncertainty of found sizes. Coefficients of a family f have the prior u ~ N(0, a_f^2) in units of their sigma. The
covariance C = (J^T J + P)^-1 holds for a known size. If it was found from the same data, with logarithm N(log a, V),
the law of total covariance gives, to second order in V,

    cov u  =  C  +  G V G^T  +  sum over f of V_ff / 2  d^2 C / d(log a_f)^2
    G_f = d u / d log a_f = 2 C_f u_f,         d^2 C / d(log a_f)^2 = 8 C_f C_ff C_f^T - 4 C_f C_f^T

with C_f the columns of C that belong to f, and all values in units of a = 1. V comes from Fisher's information of the
marginal likelihood,

    H_fg = 2 |J_f^T Q J_g|^2,      J_f^T Q J_f = I - C_ff,      J_f^T Q J_g = -C_fg,      V = (H + I)^-1

where the added I is the curvature of the prior of log a_f at the expected size: if the data say nothing, V is 1 and not
infinite. Coefficients that the data decide hardly change; unseen coefficients vary as widely as their size might. On a
simulated six-axis arm with curves, single intervals of 95 % held the truth in 91.7 % of cases without this addition,
and in 95 % with it. It fails for sizes that are uncertain by more than a factor of e.

When it fails. Two families of similar columns share their effect, or one has all of it: the posterior has two maxima,
and this finds one.

Reference: gelman2006; chung2013; kass1989; patterson1971.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy

from calib.core.base.arrays import BoolArray, FloatArray, IntArray, ReadOnlyArrays
from calib.core.base.memoize import memoize
from calib.core.numerics.chances import EXACT
from calib.core.numerics.identifiability import reduce_rows
from calib.core.numerics.linear_model import LinearModel, RowGroups
from calib.core.numerics.mixed_model import MixedModel, SolvedModel, information_of_families
from calib.core.numerics.mixed_rows import FLAT, KNOWN, MixedRows, SeenColumns
from calib.core.numerics.statistics import require_freedom

_LEAST = -6.0  # logarithm of the least size of a family
_MOST = 4.0
_LEAST_PART = 1e-3  # least noise and scatter, over what would explain all that flat columns leave
_LEAST_KNOWN = 0.1  # the same, over what would explain all that columns with known priors leave, too
_LEAST_ALONE = EXACT / 10.0  # least noise where nothing scatters: all that families leave is noise then [SI]
_SMALL = 0.1  # a falling size is set to its bound below this part of the start of the search
_FALLS = 0.25  # least step of Newton by which a size falls: it is 1/2 where the cost grows with its square
_AT_BOUND = 1e-9  # difference of a logarithm from its bound
_OTHERS = 3.0  # difference of logarithms between the largest noise and what the flat columns leave of its rows alone
_LEAST_FREEDOM = 1e-6  # of a group whose rows flat columns explain but for rounding
_NOTHING = 1e-300
_STEP = 1.5  # largest step of a logarithm
_SHORTER = 0.1, 0.5  # limits of the factor by which a step is shortened
_FLAT_COST = 1e-6  # largest slope of a cost that no longer falls
_GAIN = 5e-4  # least fall of the cost for which a search continues, if not given
_FINE_GAIN = 1e-8  # the same of a search of noise alone, whose steps are quick
_RIDGE = 5e-3  # added to the information, or less where small gains count: a flat cost is left slowly
_NEAR = 1.0  # after a smaller fall of the cost, the same columns have coefficients
_ROUNDS = 80


def likeliest_sizes(
    model: MixedModel, start: FloatArray | None = None, absent: BoolArray | None = None, least_gain: float = _GAIN
) -> SolvedModel:
    """Return the model solved with the sizes of the largest posterior density.

    Args:
        start: Logarithms of the sizes to begin with, (n_sizes,); by the module docstring if not given.
        absent: Families to leave out, (n_families,): the logarithms of their sizes are -inf; none if not given.
        least_gain: Least fall of -log of the density for which a step is taken, and the search continues.
    """
    bounds = _Bounds.from_model(model)
    none = np.zeros(len(bounds.least), dtype=bool)
    if absent is not None:
        none[: len(absent)] = absent
        bounds = replace(bounds, least=np.where(none, -np.inf, bounds.least))
    begin = np.clip(bounds.first if start is None else start, bounds.least, bounds.most)
    at = _descend(model.solve(np.where(none, bounds.least, begin)), bounds, none, least_gain)
    while (raised := _raised(at, bounds, none, least_gain)) is not None:
        again = _descend(model.solve(raised), bounds, none, least_gain)
        if not _cost(again) < _cost(at) - least_gain:
            break
        at = again
    return at


def _descend(at: SolvedModel, bounds: _Bounds, none: BoolArray, least_gain: float) -> SolvedModel:
    """Solved model with the lowest cost that steps from `at` reach; sizes with the mask `none` (n_sizes,) stay."""
    model, gain = at.model, np.inf
    information: FloatArray = np.zeros((len(at.logs), len(at.logs)))
    for _ in range(_ROUNDS):
        _, slope, curvature = _prior(at)
        gradient = at.gradient + slope
        lowest, highest = at.logs <= bounds.least + _AT_BOUND, at.logs >= bounds.most - _AT_BOUND
        free = ~(none | (lowest & (gradient > 0.0)) | (highest & (gradient < 0.0)))
        if np.max(np.abs(gradient[free]), initial=0.0) < _FLAT_COST:
            break
        information = at.average_information + np.diag(curvature)
        seen = at.seen if gain < _NEAR else None  # the cost is not smooth where these change
        better = _take_step(at, gradient, information, free, bounds, least_gain, seen)
        if better is None:
            break
        gain = _cost(at) - _cost(better)
        at = better
        if gain < least_gain:
            break
    falling = (at.logs < bounds.first + np.log(_SMALL)) & (at.logs > bounds.least + _AT_BOUND) & ~none
    falling[model.n_families : model.n_families + len(model.unstated_groups)] = False  # noise is never zero
    if np.any(falling):
        falling &= at.gradient + _prior(at)[1] > _FALLS * np.diag(information)
    without = model.solve(np.where(falling, bounds.least, at.logs)) if np.any(falling) else at
    return without if _cost(without) <= _cost(at) else at


def _raised(at: SolvedModel, bounds: _Bounds, none: BoolArray, least_gain: float) -> FloatArray | None:
    """Logarithms of the sizes, zero and unseen ones raised where this promises a lower cost, (n_sizes,); else None."""
    n = at.model.n_families
    seen = np.isin(np.arange(n), at.model.family[at.seen]) & (at.logs[:n] > bounds.least[:n] + _AT_BOUND)
    unseen = np.flatnonzero(~(none[:n] | seen))
    if not len(unseen):
        return None
    slope, information = at.slope_at_zero(unseen)
    information, rest = np.maximum(information, _NOTHING), -slope - information
    root = np.sqrt(np.maximum(rest**2 - 4.0 * information * (slope + 1.0), 0.0))
    squares = np.clip((rest + root) / (2.0 * information), 0.0, np.exp(2.0 * bounds.most[unseen]))
    rises = -(slope + 0.5 * information * squares) * squares - np.log1p(squares) > 2.0 * least_gain
    if not np.any(rises):
        return None
    logs = at.logs.copy()
    logs[unseen[rises]] = 0.5 * np.log(squares[rises])
    return logs


def find_sizes(
    model: LinearModel,
    start: FloatArray,
    sought: BoolArray,
    family: IntArray,
    sizes: FloatArray,
    *,
    rough: bool = False,
) -> tuple[FloatArray, FloatArray]:
    """Find scales of groups of rows (n_groups,), and sizes of families (n_families,), without scatter.

    Rows of a group have one variance. So those of the components that they see are replaced by their triangular factor,
    and a step of the search takes no longer where there are more of them.

    Args:
        model: The rows, whitened by the stated noise, or in addition by known scales.
        start: Scales of the groups of rows to start from, (n_groups,); they matter only if there are priors.
        sought: Mask of the groups whose scales are to be found, (n_groups,); the others have the scale 1.
        family: Family of each parameter, -1 for none, (n_free,).
        sizes: Sizes to start from, over the expected ones, (n_families,); empty where there are no families.
        rough: Whether scales within a part of their uncertainty are enough.

    Raises:
        NotIdentifiableError: No degrees of freedom are left.
    """
    counts, group = model.layout.counts, model.layout.group
    if len(sizes):  # fewer columns first: all rows have many columns of families
        seen = SeenColumns.from_rows(model.jacobian, model.prior, family)
        model, family = seen.model(model), seen.family
    few = [reduce_rows(model.jacobian[own], model.residuals[own]) for own in (group == g for g in range(len(counts)))]
    rows, layout = np.vstack(few), RowGroups(np.repeat(np.arange(len(counts)), [len(own) for own in few]), counts)
    linear = replace(model, residuals=rows[:, -1], jacobian=rows[:, :-1], layout=layout)
    sought, none = sought & (counts > 0), np.zeros((len(rows), 0))
    every = MixedRows.from_linear_problem(linear, family, ~sought, np.arange(len(rows)), none)
    mixed = MixedModel.from_rows(replace(every, present=np.arange(len(sizes))))
    total = int(np.sum(counts))
    left = float(total - np.count_nonzero(mixed.family == FLAT))
    require_freedom(left, total)
    begin = np.log(np.append(sizes, start[sought])) if np.any(mixed.has_prior) else None
    at = likeliest_sizes(mixed, begin, least_gain=_GAIN if rough or len(sizes) else _FINE_GAIN)
    found, noise, _ = mixed.sizes(at.logs)
    require_freedom(left - at.freedom(np.array([KNOWN])), total)  # families explain every exact row
    return np.where(sought, noise, start), found


def scatter_given_noise(at: SolvedModel) -> float:
    """Return the scatter d, enlarged by the part that rows cannot tell from noise; 0 where they show neither.

    It is no larger than if the residuals were nothing but scatter: noise of a shape of its own, such as that of points
    that a camera reads together, can make the likeliest d several times as large.

    By the rows, d^2 is normal about its likeliest value, with a standard deviation t, and not negative; with known
    noise the deviation would be t_0. With p and F the normal density and distribution, its mean is d^2 + e(t), with
    e(t) = t p(d^2 / t) / F(d^2 / t), and

        d^2 + e(t) - e(t_0)

    counts the confusion with noise. It is d^2 where noise is stated, and where rows distinguish the two well. If d^2
    grows by 1, the variance of noise falls by k, its regression on d^2: beyond noise^2 / k none would be left.
    """
    at = _with_all_components(at)
    bounds, square = _Bounds.from_model(at.model), float(np.exp(2.0 * at.logs[-1]))
    squares = 2.0 * np.exp(2.0 * at.logs)
    known = at.information / np.outer(squares, squares) + np.diag(np.exp(-4.0 * bounds.most))
    covariance, noise = np.linalg.inv(known), np.arange(at.model.n_families, len(known) - 1)
    confused = _mean_beyond(square, covariance[-1, -1]) - _mean_beyond(square, 1.0 / known[-1, -1])
    falling = np.maximum(-covariance[noise, -1] / covariance[-1, -1], _NOTHING)
    confused = min(confused, float(np.min(np.exp(2.0 * at.logs[noise]) / falling, initial=np.inf)))
    none = at.logs[-1] <= bounds.least[-1] + _AT_BOUND
    return min(float(np.sqrt((0.0 if none else square) + max(confused, 0.0))), at.scatter_of_residuals)


def noise_given_scatter(at: SolvedModel, scatter: float) -> FloatArray:
    """Return the likeliest noise of all groups, stated or not, given sizes of families and a scatter, (n_groups,).

    The noise of groups without rows stays.
    """
    noise = at.model.sizes(at.logs)[1].copy()
    seen = np.isin(np.arange(len(noise)), at.model.rows.group)
    model, n = replace(at.model, rows=replace(at.model.rows, has_stated_noise=~seen)), at.model.n_families
    logs = np.concatenate([at.logs[:n], np.log(noise[seen]), [np.log(scatter)]])
    stays = (np.arange(len(logs)) < n) | (np.arange(len(logs)) == len(logs) - 1)
    noise[seen] = np.exp(_descend(model.solve(logs), _Bounds.from_model(model), stays, _FINE_GAIN).logs[n:-1])
    return noise


def _with_all_components(at: SolvedModel) -> SolvedModel:
    """The same sizes, with coefficients also of components that only larger sizes would show."""
    return at.model.solve(at.logs, np.arange(len(at.scale)))


def _mean_beyond(value: float, variance: float) -> float:
    """Return e of `scatter_given_noise` for a likeliest d^2 and its variance t^2."""
    std = float(np.sqrt(variance))
    return std * float(np.exp(-0.5 * (value / std) ** 2) / np.sqrt(2.0 * np.pi) / scipy.special.ndtr(value / std))


def _take_step(
    at: SolvedModel,
    gradient: FloatArray,
    information: FloatArray,
    free: BoolArray,
    bounds: _Bounds,
    least_gain: float,
    seen: IntArray | None,
) -> SolvedModel | None:
    """Solved model after a step of the free sizes that lowers the cost; None if no step promises enough."""
    inner = information[np.ix_(free, free)]
    inner[np.diag_indices_from(inner)] += min(_RIDGE, 10.0 * least_gain)
    step = np.zeros(len(gradient))
    step[free] = -np.linalg.solve(inner, gradient[free])
    while (slope := float(gradient @ step)) <= -2.0 * least_gain:  # not where it is no number
        logs = np.clip(at.logs + np.clip(step, -_STEP, _STEP), bounds.least, bounds.most)
        tried = at.model.solve(logs, seen)
        rise = _cost(tried) - _cost(at)
        if rise < 0.0:
            return tried
        step *= np.clip(0.5 * slope / (slope - rise), *_SHORTER)
    return None


def draw_sizes(at: SolvedModel, n: int, rng: np.random.Generator) -> FloatArray:
    """Return logarithms of n drawn sizes that the rows do not exclude, (n, n_sizes), from the likeliest model."""
    lower = np.linalg.cholesky(information_by_size(at))
    steps = scipy.linalg.solve_triangular(lower.T, rng.standard_normal((len(at.logs), n)), lower=False).T
    bounds = _Bounds.from_model(at.model)
    return np.clip(np.log(np.abs(np.exp(at.logs) + steps) + 1e-300), bounds.least, bounds.most)


def least_sizes(model: MixedModel) -> FloatArray:
    """Return logarithms of sizes that are as good as zero, (n_sizes,)."""
    return _Bounds.from_model(model).least


def information_by_size(at: SolvedModel) -> FloatArray:
    """Return the information of the sizes themselves by the module docstring, (n_sizes, n_sizes)."""
    at = _with_all_components(at)
    sizes, n = np.exp(at.logs), at.model.n_families
    information = at.information / np.outer(sizes, sizes)
    more = np.maximum(at.gradient, 0.0) / sizes**2
    more[:n] += 2.0 / (1.0 + sizes[:n] ** 2) ** 2
    squares, freedom = at.squares_and_freedom
    largest = (squares / np.maximum(freedom, _LEAST_FREEDOM))[at.model.unstated_groups]
    largest = np.append(largest, [at.scatter_of_residuals**2] * at.model.scatters)
    more[n:] += 1.0 / np.clip(largest, _NOTHING, 1.0 / _NOTHING)  # infinite where nothing that scatters moves a row
    return information + np.diag(more)


@dataclass(frozen=True, eq=False)
class _Bounds(ReadOnlyArrays):
    """Logarithms of the sizes that a search keeps to, (n_sizes,) each.

    Attributes:
        least: A value that is as good as zero. Flat columns may leave much that known priors explain: with a target
            whose place is known to 0.5 m, ten thousand times the noise.
        first: Start of a search.
        most: For a family much more than expected; for scatter the value that explains all that flat columns leave;
            for noise too, by the rows less the flat columns, or more where other groups may decide these columns.
    """

    least: FloatArray
    first: FloatArray
    most: FloatArray

    @staticmethod
    @memoize
    def from_model(model: MixedModel) -> _Bounds:
        flat = model.x[:, model.family == FLAT]  # orthonormal
        freedom = model.rows.stands_for - np.sum(flat**2, axis=1)
        left_by_flat = _explaining_sizes(model, model.y - flat @ (flat.T @ model.y), freedom)
        if model.scatters:
            none = np.repeat([-np.inf, 0.0, -np.inf], [model.n_families, len(left_by_flat) - 1, 1])
            left = _explaining_sizes(model, model.solve(none).whitened_residuals, freedom)
            least = np.minimum(left_by_flat + np.log(_LEAST_PART), left + np.log(_LEAST_KNOWN))
            first, most = left_by_flat - 1.0, left_by_flat
        else:
            least = np.full(len(left_by_flat), np.log(_LEAST_ALONE))
            first, most = left_by_flat, np.maximum(left_by_flat + _OTHERS, least)
        families = ([value] * model.n_families for value in (_LEAST, np.log(0.5), _MOST))
        return _Bounds(*map(np.append, families, (least, first, most)))


def _explaining_sizes(model: MixedModel, left: FloatArray, freedom: FloatArray) -> FloatArray:
    """Logarithms of the noise of groups, and of the scatter, that each alone explain what is left of the rows.

    Args:
        left: Residuals, (n_rows,).
        freedom: Degrees of freedom of each row, (n_rows,).
    """
    group, n = model.rows.group, len(model.rows.has_stated_noise)
    squares = np.bincount(group, left**2, n) / np.maximum(np.bincount(group, freedom, n), _LEAST_FREEDOM)
    squares = squares[model.unstated_groups]
    if model.scatters:
        squares = np.append(squares, np.mean(left**2) / max(float(np.mean(model.spread)), _NOTHING))
    return np.asarray(0.5 * np.log(squares + _NOTHING))


def _cost(at: SolvedModel) -> float:
    """-log of the posterior density, up to a constant."""
    return at.cost + _prior(at)[0]


def _prior(at: SolvedModel) -> tuple[float, FloatArray, FloatArray]:
    """-log of the prior, its slope by the logarithms of the sizes (n_sizes,), and its curvature (n_sizes,)."""
    n, present = at.model.n_families, at.model.rows.present
    squares = np.append(np.exp(2.0 * at.logs[:n]), np.zeros(len(at.logs) - n))
    slope = 2.0 * squares / (1.0 + squares)
    slope[present] -= 1.0
    cost = float(np.sum(np.log1p(squares))) - float(np.sum(at.logs[present]))
    return cost, slope, 4.0 * squares / (1.0 + squares) ** 2


def spread_of_sizes(covariance: FloatArray, family: IntArray) -> FloatArray:
    """Return the covariance of the logarithms of the found sizes, (n_families, n_families).

    Args:
        covariance: C of the module docstring, (n_free, n_free).
        family: Family of each parameter, -1 for none, (n_free,).
    """
    members = family == np.arange(int(np.max(family, initial=-1)) + 1)[:, None]
    return np.asarray(np.linalg.inv(information_of_families(covariance, 1.0 * members) + np.eye(len(members))))


def unseen_variances(covariance: FloatArray, family: IntArray) -> FloatArray:
    """Return the variance of the components of each family that rows do not see, (n_families,); their C is 1.

    `covariance` (n_free, n_free) and `family` (n_free,) are those of `spread_of_sizes`, of what rows see.
    """
    return np.asarray(1.0 + 2.0 * np.diag(spread_of_sizes(covariance, family)))


def variance_by_sizes(covariance: FloatArray, family: IntArray, deviations: FloatArray) -> FloatArray:
    """Return the covariance of the scaled parameters that the found sizes of families add, (n_free, n_free).

    Args:
        covariance, family: As in `spread_of_sizes`.
        deviations: u at the solution, in units of the found sizes, (n_free,).
    """
    members = [np.flatnonzero(family == number) for number in range(int(np.max(family, initial=-1)) + 1)]
    if not members:
        return np.zeros_like(covariance)
    spread = spread_of_sizes(covariance, family)
    slopes = np.stack([2.0 * covariance[:, index] @ deviations[index] for index in members], axis=1)
    added: FloatArray = slopes @ spread @ slopes.T
    for f, index in enumerate(members):
        own, bend = covariance[:, index], 4.0 * covariance[np.ix_(index, index)] - 2.0 * np.eye(len(index))
        added += spread[f, f] * (own @ bend @ own.T)
    return added
