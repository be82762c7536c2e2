"""Noise found from residuals: restricted maximum likelihood, against a general optimiser and dense matrices."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

from calib.core.base.errors import NotIdentifiableError
from calib.core.numerics.linear_model import LinearModel, RowGroups
from calib.core.numerics.prior import Prior
from calib.core.numerics.prior_sizes import find_noise_with_families
from calib.core.numerics.variance_components import find_components, find_scales

N_FREE = 4
ONE, BOTH = np.array([True]), np.array([True, True])


def model_of(seed, *, priors=(), groups=(40, 30), noise=(0.5, 3.0), shared=(), visits=14):
    """Rows of two groups with this noise, and errors of joints that visits share; also columns and visits."""
    rng = np.random.default_rng(seed)
    group = np.repeat(np.arange(len(groups)), groups)
    n = len(group)
    jacobian = rng.standard_normal((n, N_FREE))
    columns = rng.standard_normal((n, len(shared) or 2))
    block = rng.permutation(np.arange(n) % visits)
    errors = rng.standard_normal((visits, columns.shape[1])) * (np.array(shared) if shared else 0.0)
    residuals = np.array(noise)[group] * rng.standard_normal(n) + np.sum(columns * errors[block], axis=1)
    has_prior = np.isin(np.arange(N_FREE), priors)
    deviations = np.where(has_prior, rng.standard_normal(N_FREE), 0.0)
    model = LinearModel(residuals, jacobian, Prior(has_prior), deviations, RowGroups.from_groups(group, len(groups)))
    return model, columns, block


def deviance(model, scales, tau, columns, block):
    """Minus twice the restricted log-likelihood, with dense matrices, up to a constant."""
    read = model.layout.group >= 0
    same = (block[:, None] == block)[np.ix_(read, read)]
    c = columns[read] * tau
    v = np.diag(scales[model.layout.group[read]] ** 2) + np.where(same, c @ c.T, 0.0)
    j, y = model.jacobian[read], model.residuals[read]
    inverse = np.linalg.inv(v)
    a = j.T @ inverse @ j + np.diag(model.prior.has.astype(float))
    step = -np.linalg.solve(a, j.T @ inverse @ y + np.where(model.prior.has, model.deviations, 0.0))
    left, u = y + j @ step, (model.deviations + step)[model.prior.has]
    return np.linalg.slogdet(v)[1] + np.linalg.slogdet(a)[1] + left @ inverse @ left + u @ u


def optimum(model, columns, block, *, start, n_shared=0, sought=BOTH):
    """Unstated scales, and standard deviations of joints, where the restricted likelihood is largest."""
    unstated = np.flatnonzero(sought)

    def values(x):
        scales = np.ones(len(sought))
        scales[unstated] = np.exp(x[: len(unstated)])
        tau = np.zeros(columns.shape[1])
        tau[:n_shared] = np.exp(x[len(unstated) :])
        return scales, tau

    minimum = minimize(
        lambda x: deviance(model, *values(x), columns, block),
        np.log(start),
        method="Nelder-Mead",
        options={"xatol": 1e-6, "fatol": 1e-10, "maxiter": 4000, "maxfev": 4000},
    )
    assert minimum.success
    return *values(minimum.x), -0.5 * minimum.fun


@pytest.mark.parametrize("priors", [(), (0, 2), range(N_FREE)], ids=["none", "some", "all"])
@pytest.mark.parametrize("seed", range(3))
def test_scales_of_groups_are_where_the_restricted_likelihood_is_largest(seed, priors):
    model, columns, block = model_of(seed, priors=priors)
    result = find_scales(model, np.array([1.0, 1.0]), BOTH)
    scales, _, likelihood = optimum(model, columns, block, start=[1.0, 1.0])
    np.testing.assert_allclose(result.scales, scales, rtol=1e-3)
    assert result.log_likelihood() == pytest.approx(likelihood, abs=1e-4)


def test_the_start_does_not_matter():
    model, _, _ = model_of(1)
    ends = [find_scales(model, np.array(start), BOTH).scales for start in ([1e-3, 1e-3], [1.0, 1.0], [50.0, 0.01])]
    np.testing.assert_allclose(ends[1:], ends[:1] * 2, rtol=1e-3)


def test_scales_that_are_stated_stay():
    model, columns, block = model_of(4, noise=(0.5, 1.0))
    first = np.array([True, False])
    result = find_scales(model, np.array([1.0, 1.0]), first)
    scales, _, _ = optimum(model, columns, block, start=[1.0], sought=first)
    assert result.scales[1] == 1.0
    assert result.scales[0] == pytest.approx(scales[0], rel=1e-3)


def test_one_group_without_priors_has_the_noise_of_the_textbook():
    model, _, _ = model_of(2, groups=(50,), noise=(0.7,))
    left = model.residuals - model.jacobian @ np.linalg.lstsq(model.jacobian, model.residuals, rcond=None)[0]
    scales = find_scales(model, np.array([1.0]), ONE)
    assert scales.scales[0] == pytest.approx(np.sqrt(left @ left / 46), rel=1e-6)


def test_rows_that_were_not_read_take_no_part():
    model, columns, block = model_of(3, shared=(4.0, 0.0))
    gaps = np.array([2, 17, 50])
    group, jacobian = model.layout.group.copy(), model.jacobian.copy()
    residuals, seen = model.residuals.copy(), columns.copy()
    group[gaps], jacobian[gaps], residuals[gaps], seen[gaps] = -1, 0.0, 0.0, 0.0
    with_gaps = replace(model, residuals=residuals, jacobian=jacobian, layout=RowGroups.from_groups(group, 2))
    kept = group >= 0
    without = replace(
        model, residuals=residuals[kept], jacobian=jacobian[kept], layout=RowGroups.from_groups(group[kept], 2)
    )
    components = find_components(with_gaps, np.ones(2), BOTH, seen, block)
    other = find_components(without, np.ones(2), BOTH, seen[kept], block[kept])
    np.testing.assert_allclose(components.scales, other.scales, rtol=1e-9)
    np.testing.assert_allclose(components.shared, other.shared, rtol=1e-6, atol=1e-9)


@pytest.mark.quick(1)
@pytest.mark.parametrize("priors", [(), range(N_FREE)], ids=["none", "all"])
@pytest.mark.parametrize("seed", range(3))
def test_shared_errors_are_where_the_restricted_likelihood_is_largest(seed, priors):
    model, columns, block = model_of(seed, priors=priors, noise=(0.5, 1.0), shared=(2.0, 1.0))
    components = find_components(model, np.array([1.0, 1.0]), BOTH, columns, block)
    scales, tau, likelihood = optimum(model, columns, block, start=[1.0, 1.0, 1.0, 1.0], n_shared=2)
    np.testing.assert_allclose(components.scales, scales, rtol=0.01)
    np.testing.assert_allclose(components.shared, tau, rtol=0.03)  # the iteration stops at changes below 1 %
    assert components.log_likelihood() == pytest.approx(likelihood, abs=0.01)


def test_where_visits_share_nothing_nothing_is_found():
    results = []
    for seed in range(30):
        model, columns, block = model_of(seed, noise=(0.5, 1.0))
        results.append(np.any(find_components(model, np.ones(2), BOTH, columns, block).shared > 0))
    assert not any(results)  # a chance of 1 in 1000 each


def test_too_few_rows_for_any_noise_are_an_error():
    model, _, _ = model_of(2, groups=(4,), noise=(0.7,))
    with pytest.raises(NotIdentifiableError, match="too few to find the uncertainty"):
        find_scales(model, np.array([1.0]), ONE)


def test_data_without_noise_have_none():
    model, columns, block = model_of(5, noise=(0.0, 0.0))
    exact = replace(model, residuals=model.jacobian @ np.ones(N_FREE))
    components = find_components(exact, np.array([1e-4, 1e-4]), BOTH, columns, block)
    assert np.all(components.scales < 1e-8)
    assert not np.any(components.shared > 0)


def with_families(seed):
    """Twelve coefficients of two families, of sizes 3 and 0.2, beside two parameters of neither."""
    rng = np.random.default_rng(seed)
    family = np.array([-1, -1, *[0] * 6, *[1] * 6])
    jacobian = rng.standard_normal((120, 14)) * np.array([1.0, 1.0, *[0.5] * 6, *[3.0] * 6])
    u = rng.standard_normal(14) * np.array([1.0, 1.0, 3.0, 0.2])[[0, 1, *[2] * 6, *[3] * 6]]
    residuals = 0.5 * rng.standard_normal(120) - jacobian @ u
    one = RowGroups.from_groups(np.zeros(120, dtype=np.intp), 1)
    return LinearModel(residuals, jacobian, Prior(family >= 0), np.zeros(14), one), family


@pytest.mark.quick(1)
@pytest.mark.parametrize("seed", range(3))
def test_sizes_of_families_are_where_the_marginal_likelihood_is_largest(seed):
    model, family = with_families(seed)
    scales, sizes = find_noise_with_families(model, ONE, family, np.array([1.0]))

    def minus_twice_log(x):
        factor = np.append(np.exp(x[1:]), 1.0)[family]
        scaled = replace(model, jacobian=model.jacobian * factor, deviations=model.deviations / factor)
        likelihood = deviance(scaled, np.exp(x[:1]), np.zeros(1), np.zeros((120, 1)), np.arange(120))
        return likelihood - 2.0 * float(np.sum(np.minimum(x[1:], 0.0)))  # the density rises up to what is expected

    minimum = minimize(minus_twice_log, np.zeros(3), method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-10})
    assert minimum.success
    np.testing.assert_allclose([*scales, *sizes], np.exp(minimum.x), rtol=0.03)  # it stops at changes below 1 %


def test_a_family_that_is_not_seen_keeps_the_size_that_is_expected():
    model, family = with_families(3)
    unseen = replace(model, jacobian=model.jacobian * np.where(family == 1, 1e-9, 1.0))
    assert find_noise_with_families(unseen, ONE, family, np.array([1.0]))[1][1] == 1.0
