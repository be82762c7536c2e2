"""Noise found from residuals: restricted maximum likelihood, against a general optimiser and dense matrices."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

from calib.core.base.errors import NotIdentifiableError
from calib.core.numerics.linear_model import LinearModel, RowGroups
from calib.core.numerics.mixed_model import MixedModel
from calib.core.numerics.mixed_rows import MixedRows
from calib.core.numerics.prior import Prior
from calib.core.numerics.size_search import find_sizes, likeliest_sizes

N_FREE = 4
NO_FAMILY = np.full(N_FREE, -1)
ONE, BOTH = np.array([True]), np.array([True, True])


def find_scales(model, start, sought):
    return find_sizes(model, start, sought, NO_FAMILY, np.ones(0))[0]


def model_of(seed, *, priors=(), groups=(40, 30), noise=(0.5, 3.0), gaps=()):
    """Rows of two groups with this noise, of which some were not read."""
    rng = np.random.default_rng(seed)
    group = np.repeat(np.arange(len(groups)), groups)
    n = len(group)
    jacobian = rng.standard_normal((n, N_FREE))
    residuals = np.array(noise)[group] * rng.standard_normal(n)
    group[list(gaps)], jacobian[list(gaps)], residuals[list(gaps)] = -1, 0.0, 0.0
    has_prior = np.isin(np.arange(N_FREE), priors)
    deviations = np.where(has_prior, rng.standard_normal(N_FREE), 0.0)
    return LinearModel(residuals, jacobian, Prior(has_prior), deviations, RowGroups.from_groups(group, len(groups)))


def of_one_group(residuals, jacobian, family):
    """Rows of one group; the parameters of families have priors."""
    group = RowGroups.from_groups(np.zeros(len(residuals), dtype=np.intp), 1)
    return LinearModel(residuals, jacobian, Prior(family >= 0), np.zeros(len(family)), group)


def deviance(model, scales):
    """Minus twice the restricted log-likelihood, with dense matrices, up to a constant."""
    read = model.layout.group >= 0
    v = np.diag(scales[model.layout.group[read]] ** 2)
    j, y = model.jacobian[read], model.residuals[read]
    inverse = np.linalg.inv(v)
    a = j.T @ inverse @ j + np.diag(model.prior.has.astype(float))
    step = -np.linalg.solve(a, j.T @ inverse @ y + np.where(model.prior.has, model.deviations, 0.0))
    left, u = y + j @ step, (model.deviations + step)[model.prior.has]
    return np.linalg.slogdet(v)[1] + np.linalg.slogdet(a)[1] + left @ inverse @ left + u @ u


def optimum(model, start, sought=BOTH, known=1.0):
    """Scales where the restricted likelihood is largest; those that are not sought are known."""
    unstated = np.flatnonzero(sought)

    def values(x):
        scales = np.full(len(sought), known)
        scales[unstated] = np.exp(x)
        return scales

    minimum = minimize(
        lambda x: deviance(model, values(x)),
        np.log(start),
        method="Nelder-Mead",
        options={"xatol": 1e-6, "fatol": 1e-10, "maxiter": 4000, "maxfev": 4000},
    )
    assert minimum.success
    return values(minimum.x)


CASES = {
    "no priors": {},
    "some priors": {"priors": (0, 2)},
    "priors": {"priors": range(N_FREE)},
    "rows that were not read": {"gaps": (2, 17, 50)},
    "one is stated": {"noise": (0.5, 1.0)},
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("seed", range(3))
def test_scales_of_groups_are_where_the_restricted_likelihood_is_largest(seed, case):
    model, sought = model_of(seed, **CASES[case]), np.array([True, case != "one is stated"])
    found = find_scales(model, np.ones(2), sought)
    np.testing.assert_allclose(found, optimum(model, np.ones(np.sum(sought)), sought), rtol=1e-3)
    assert np.all(found[~sought] == 1.0)


def test_the_start_does_not_matter():
    model = model_of(1)
    ends = [find_scales(model, np.array(start), BOTH) for start in ([1e-3, 1e-3], [1.0, 1.0], [50.0, 0.01])]
    np.testing.assert_allclose(ends[1:], ends[:1] * 2, rtol=1e-3)


def test_one_group_without_priors_has_the_noise_of_the_textbook():
    model = model_of(2, groups=(50,), noise=(0.7,))
    left = model.residuals - model.jacobian @ np.linalg.lstsq(model.jacobian, model.residuals, rcond=None)[0]
    scales = find_scales(model, np.array([1.0]), ONE)
    assert scales[0] == pytest.approx(np.sqrt(left @ left / 46), rel=1e-5)  # where the search ends


def test_too_few_rows_for_any_noise_are_an_error():
    model = model_of(2, groups=(4,), noise=(0.7,))
    with pytest.raises(NotIdentifiableError, match="too few to find the uncertainty"):
        find_scales(model, np.array([1.0]), ONE)


def test_data_without_noise_have_none():
    model = model_of(5, noise=(0.0, 0.0))
    exact = replace(model, residuals=model.jacobian @ np.ones(N_FREE))
    assert np.all(find_scales(exact, np.array([1e-4, 1e-4]), BOTH) < 1e-8)


def test_exact_rows_of_one_group_leave_the_others_their_weight():
    """Products of rows that are 1e10 times as long as others lost the others: the next search found 1e6."""
    model = model_of(7, groups=(16, 48), noise=(0.0, 1.0))
    seen = np.where(model.layout.group[:, None] == 0, [1.0, 1.0, 0.0, 0.0], 1.0)  # the others alone decide two columns
    rounding = 1e-12 * np.random.default_rng(8).standard_normal(16)
    jacobian, residuals = model.jacobian * seen, np.append(rounding, model.residuals[16:])
    exact = replace(model, jacobian=jacobian, residuals=residuals - jacobian @ np.ones(N_FREE))
    for start in (1.0, 1e-6, 1e-10):
        assert find_scales(exact, np.array([start, 1.0]), np.array([True, False]))[0] < 1e-9
    noisy = find_scales(exact, np.array([1e-10, 1.0]), BOTH)[1]
    assert noisy == pytest.approx(optimum(exact, [1.0], np.array([False, True]), known=1e-6)[1], rel=1e-3)


def test_columns_with_priors_that_are_short_beside_others_are_seen_by_little_noise():
    model = model_of(9, priors=range(N_FREE), noise=(1e-6, 2e-6))
    jacobian = model.jacobian * np.array([10.0, 1.0, 1e-2, 1e-4])  # a ten-thousandth of the longest was left out
    short = replace(model, jacobian=jacobian, residuals=model.residuals - jacobian @ (1.0 + model.deviations))
    np.testing.assert_allclose(find_scales(short, np.array([1.0, 1.0]), BOTH), [1e-6, 2e-6], rtol=0.4)  # 13 % errors


def test_a_column_that_depends_on_others_changes_nothing():
    model = model_of(10)
    dependent = replace(model, jacobian=model.jacobian @ np.diag([1.0, 1.0, 1.0, 0.0]))
    dependent.jacobian[:, 3] = dependent.jacobian[:, 0] - 2.0 * dependent.jacobian[:, 1]
    without = replace(model, jacobian=model.jacobian[:, :3], prior=Prior(np.zeros(3, bool)), deviations=np.zeros(3))
    expected = find_sizes(without, np.ones(2), BOTH, np.full(3, -1), np.ones(0))[0]
    np.testing.assert_allclose(find_scales(dependent, np.ones(2), BOTH), expected, rtol=1e-6)


def test_noise_that_priors_explain_is_the_same_in_the_next_search():
    """Its likelihood is nearly flat towards zero: each search found a tenth less than the last one."""
    model = model_of(4, priors=range(N_FREE), groups=(20, 3), noise=(0.6, 0.0))
    wide = replace(model, jacobian=3.0 * model.jacobian, residuals=model.residuals - model.jacobian @ np.ones(N_FREE))
    once = find_scales(wide, np.array([1.0, 0.03]), BOTH)
    np.testing.assert_allclose(find_scales(wide, once, BOTH), once, rtol=1e-3)


def with_families(seed):
    """Twelve coefficients of two families, of sizes 3 and 0.2, beside two parameters of neither."""
    rng = np.random.default_rng(seed)
    family = np.array([-1, -1, *[0] * 6, *[1] * 6])
    jacobian = rng.standard_normal((120, 14)) * np.array([1.0, 1.0, *[0.5] * 6, *[3.0] * 6])
    u = rng.standard_normal(14) * np.array([1.0, 1.0, 3.0, 0.2])[[0, 1, *[2] * 6, *[3] * 6]]
    residuals = 0.5 * rng.standard_normal(120) - jacobian @ u
    return of_one_group(residuals, jacobian, family), family


@pytest.mark.quick(1)
@pytest.mark.parametrize("seed", range(3))
def test_sizes_of_families_are_where_the_marginal_likelihood_is_largest(seed):
    model, family = with_families(seed)
    scales, sizes = find_sizes(model, np.ones(1), ONE, family, np.ones(2))

    def minus_twice_log(x):
        factor = np.append(np.exp(x[1:]), 1.0)[family]
        scaled = replace(model, jacobian=model.jacobian * factor, deviations=model.deviations / factor)
        likelihood = deviance(scaled, np.exp(x[:1]))
        return likelihood + 2.0 * float(np.sum(np.log1p(np.exp(2.0 * x[1:])) - x[1:]))  # half-Cauchy, of log s

    minimum = minimize(minus_twice_log, np.zeros(3), method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-10})
    assert minimum.success
    np.testing.assert_allclose([*scales, *sizes], np.exp(minimum.x), rtol=0.03)  # the search ends near


def test_a_family_that_is_not_seen_keeps_the_size_that_is_expected():
    model, family = with_families(3)
    unseen = replace(model, jacobian=model.jacobian * np.where(family == 1, 1e-9, 1.0))
    assert find_sizes(unseen, np.ones(1), ONE, family, np.array([1.0, 0.3]))[1][1] == pytest.approx(1.0, rel=0.05)


def test_noise_beside_families_counts_the_parameters_without_a_prior():
    """Of 60 rows, 36 such parameters leave 24: by the textbook, the noise is not below sqrt(RSS / 24)."""
    rng = np.random.default_rng(0)
    jacobian, family = rng.standard_normal((60, 40)), np.repeat([-1, 0], [36, 4])
    jacobian[:, 36:] *= 1e-9  # rows say nothing of the family
    residuals = rng.standard_normal(60)
    model = of_one_group(residuals, jacobian, family)
    left = residuals - jacobian[:, :36] @ np.linalg.lstsq(jacobian[:, :36], residuals, rcond=None)[0]
    scales, _ = find_sizes(model, np.ones(1), ONE, family, np.ones(1))
    assert scales[0] == pytest.approx(np.sqrt(left @ left / 24), rel=0.01)


def test_many_rows_give_what_a_few_of_the_same_products_give():
    """Rows of two groups, some not read: against the search of all rows, one by one."""
    model, family = with_families(4)
    group = np.tile([0, 1, -1], 40)
    mixed = replace(model, layout=RowGroups.from_groups(group, 2))
    scales, sizes = find_sizes(mixed, np.ones(2), np.array([True, False]), family, np.ones(2))
    read = mixed.take_rows(group >= 0)
    rows = MixedRows.from_linear_problem(read, family, np.array([False, True]), np.arange(80), np.zeros((80, 0)))
    every = likeliest_sizes(MixedModel.from_rows(replace(rows, present=np.arange(2))), np.zeros(3))
    np.testing.assert_allclose([*sizes, scales[0]], np.exp(every.logs), rtol=1e-6)
    assert scales[1] == 1.0


def test_noise_far_below_what_parameters_with_priors_explain_is_found():
    """A ten-thousandth of it: the search ended at a thousandth."""
    model, family = with_families(5)
    rng = np.random.default_rng(6)
    residuals = 1e-4 * rng.standard_normal(120) - model.jacobian @ rng.standard_normal(14)
    known = replace(model, residuals=residuals, prior=Prior(np.ones(14, dtype=bool)))
    assert find_sizes(known, np.ones(1), ONE, family, np.ones(2))[0][0] == pytest.approx(
        1e-4, rel=0.2
    )  # 7 % standard error
