"""Statistics against textbook formulas and against simulation of linear models."""

import numpy as np
import pytest

from calib.core.base.errors import NotIdentifiableError
from calib.core.fitting.estimates import Covariance
from calib.core.numerics.observability import information
from calib.core.numerics.prior import Prior
from calib.core.numerics.statistics import Factors, chi_square, effective_parameters, find_factors, statistics, status

RNG = np.random.default_rng(7)


def statistics_of(rows, sigma, has_prior=None, *, freedom=9.0, scales=None, assumed=None):
    """Statistics of rows [SI] with found noise `sigma`, weighed by the noise `assumed` (the same if not given)."""
    assumed = assumed or sigma
    n = rows.shape[1]
    has_prior = np.zeros(n, dtype=bool) if has_prior is None else np.array(has_prior)
    values = np.array([sigma / assumed])
    factors = Factors(values, np.array([freedom]), values)
    known = information(rows / assumed, Prior(has_prior).rows)
    span, groups = rows / assumed @ known.root, np.zeros(len(rows), dtype=np.intp)
    return statistics(span, groups, known, factors, np.ones(n) if scales is None else scales, Prior(has_prior))


def of_line(x, y):
    """Statistics of a straight line through points, through the module under test, and the noise that it finds."""
    rows = np.column_stack([np.ones_like(x), x])
    residuals = y - rows @ np.linalg.lstsq(rows, y, rcond=None)[0]
    known, groups = information(rows), np.zeros(len(x), dtype=np.intp)
    span, none = rows @ known.root, Prior(np.zeros(2, dtype=bool))
    factors = find_factors(residuals, span, groups, 1)
    return statistics(span, groups, known, factors, np.ones(2), none), factors.values[0]


def test_a_straight_line_has_the_uncertainty_of_the_textbook():
    x = np.array([0.0, 1.0, 2.0, 3.0, 5.0, 8.0])
    result, sigma = of_line(x, 3 + 0.5 * x + RNG.normal(size=6))
    spread = np.sum((x - x.mean()) ** 2)
    assert result.std[1] == pytest.approx(sigma / np.sqrt(spread))
    assert result.std[0] == pytest.approx(sigma * np.sqrt(1 / 6 + x.mean() ** 2 / spread))
    correlation = Covariance(("a", "b"), result.covariance).correlation
    assert correlation["a", "b"] == pytest.approx(-x.mean() / np.sqrt(np.mean(x**2)))
    assert result.freedom == pytest.approx(4)
    assert result.half_width[1] == pytest.approx(2.7764451 * result.std[1])  # Student's t, 4 degrees of freedom, 97.5 %
    assert result.effective_parameters == pytest.approx(2)


def test_scales_only_change_the_unit():
    rows = RNG.normal(size=(12, 3))
    scales = np.array([1e-3, 2.0, 5e-2])
    plain, scaled = statistics_of(rows, 0.1), statistics_of(rows * scales, 0.1, scales=scales)
    np.testing.assert_allclose(scaled.covariance, plain.covariance, rtol=1e-10)


def test_one_reading_and_one_prior_combine_as_the_mean_of_two_normal_numbers():
    sigma, s = 0.3, 0.5  # reading and prior standard deviation of one length
    result = statistics_of(np.array([[s]]), sigma, [True], scales=np.array([s]))
    assert result.std[0] == pytest.approx(1 / np.sqrt(1 / sigma**2 + 1 / s**2))
    assert result.data_share[0] == pytest.approx(s**2 / (s**2 + sigma**2))
    assert result.effective_parameters == pytest.approx(result.data_share[0])


@pytest.mark.parametrize(
    ("share", "relative_std", "kind", "word"),
    [
        (0.95, 0.2, {"prior": True}, "identified"),
        (0.5, 0.7, {"prior": True}, "partly"),
        (0.05, 0.97, {"prior": True}, "prior"),
        (0.95, 0.2, {"prior": True, "placement": True}, "identified"),
        (1.0, 0.3, {}, "identified"),
        (1.0, 0.4, {}, "weak"),
        (1.0, 30.0, {}, "weak"),
        (1.0, 0.01, {"placement": True}, "placed"),
    ],
)
def test_a_status_says_what_a_value_rests_on(share, relative_std, kind, word):
    prior, placement = np.array(["prior" in kind]), np.array(["placement" in kind])
    assert status(np.array([share]), np.array([relative_std]), prior, placement).tolist() == [word]


@pytest.mark.quick(0)
def test_degrees_of_freedom_with_priors_make_the_found_noise_unbiased():
    # 12 rows, 8 parameters of very different strength; true values drawn from their priors, 20 000 times
    rows = RNG.normal(size=(12, 8)) * np.logspace(-3, 2, 8)
    sigma, has_prior = 0.7, np.ones(8, dtype=bool)
    u, y = RNG.normal(size=(20000, 8)), RNG.normal(size=(20000, 12))
    data = u @ rows.T + sigma * y
    solve = np.linalg.solve(rows.T @ rows + sigma**2 * np.eye(8), rows.T)
    residuals = data - (data @ solve.T) @ rows.T
    known, groups = information(rows / sigma, Prior(has_prior).rows), np.zeros(12, dtype=np.intp)
    assert 2 < effective_parameters(known, Prior(has_prior)) < 6
    span = rows / sigma @ known.root
    results = [find_factors(r / sigma, span, groups, 1) for r in residuals]
    assert results[0].freedom[0] == pytest.approx(12 - effective_parameters(known, Prior(has_prior)))
    variances = [(sigma * item.values[0]) ** 2 for item in results]
    assert np.mean(variances) == pytest.approx(sigma**2, rel=0.02)  # standard error 0.4 %


def test_covariance_with_priors_is_the_scatter_about_the_truth_also_where_the_stated_noise_is_wrong():
    rows = RNG.normal(size=(15, 4)) * [10.0, 1.0, 0.3, 0.01]
    sigma, assumed = 0.5, 0.2
    u = RNG.normal(size=(40000, 4))
    data = u @ rows.T + sigma * RNG.normal(size=(40000, 15))
    estimate = data @ np.linalg.solve(rows.T @ rows + assumed**2 * np.eye(4), rows.T).T
    result = statistics_of(rows, sigma, np.ones(4, dtype=bool), assumed=assumed)
    np.testing.assert_allclose(result.std, np.std(estimate - u, axis=0), rtol=0.02)


def test_only_some_parameters_have_priors():
    rows = RNG.normal(size=(9, 3))
    has_prior = np.array([False, True, False])
    expected = np.linalg.inv(rows.T @ rows / 0.25 + np.diag([0.0, 1.0, 0.0]))
    result = statistics_of(rows, 0.5, has_prior)
    np.testing.assert_allclose(result.covariance, expected, rtol=1e-10)
    assert result.data_share[0] == 1.0


def test_small_singular_values_keep_their_digits():
    # condition 1e8: a normal matrix would have none left
    q = np.linalg.qr(RNG.normal(size=(20, 2)))[0]
    np.testing.assert_allclose(statistics_of(q * [1.0, 1e-8], 1.0).std, [1.0, 1e8], rtol=1e-6)


def test_zero_noise_gives_zero_uncertainty_and_no_error():
    result = statistics_of(RNG.normal(size=(6, 2)), 0.0, assumed=1e-3)
    np.testing.assert_array_equal(result.std, 0.0)
    assert np.all(np.isnan(Covariance(("a", "b"), result.covariance).correlation))


def test_groups_of_rows_have_noise_of_their_own():
    # 40 rows at sigma 1 beside 10 at 5, assumed 1: each group's factor is unbiased, and the scatter is that of C
    rows = RNG.normal(size=(50, 4))
    groups = np.repeat([0, 1], [40, 10])
    sigma = np.where(groups == 0, 1.0, 5.0)
    y = sigma * np.random.default_rng(8).normal(size=(2000, 50))
    estimate = y @ np.linalg.pinv(rows).T
    known = information(rows)
    results = [find_factors(r, rows @ known.root, groups, 2) for r in y - estimate @ rows.T]
    # a group's residuals are also off by what the other group's noise did to the parameters, so that the weights
    # 1 : 1 leave a bias where noise differs by so much; with the right weights there is none
    weighted = rows / sigma[:, None] @ information(rows / sigma[:, None]).root
    right = (y / sigma) @ np.linalg.pinv(rows / sigma[:, None]).T
    factors = [find_factors(r / sigma, weighted, groups, 2) for r in y - right @ rows.T]
    squares = np.mean([factor.values**2 for factor in factors], axis=0)
    assert squares == pytest.approx([1.0, 1.0], rel=0.05)  # 4 standard deviations
    assert np.mean([item.values[1] for item in results]) > 3
    stated = Factors(np.array([1.0, 5.0]), np.array([36.0, 10.0]), np.array([1.0, 5.0]))
    judged_ = statistics(rows @ known.root, groups, known, stated, np.ones(4), Prior(np.zeros(4, dtype=bool)))
    np.testing.assert_allclose(judged_.std, np.std(estimate, axis=0), rtol=0.07)


def test_rows_that_were_not_read_count_for_nothing():
    rows, residuals = RNG.normal(size=(20, 3)), RNG.normal(size=20)
    gaps = np.array([4, 11])
    rows[gaps], residuals[gaps] = 0.0, 0.0
    groups = np.zeros(20, dtype=np.intp)
    groups[gaps] = -1
    kept = groups >= 0
    factors = find_factors(residuals, rows @ information(rows).root, groups, 1)
    without = find_factors(residuals[kept], rows[kept] @ information(rows[kept]).root, groups[kept], 1)
    assert factors.values[0] == pytest.approx(without.values[0], rel=1e-12)
    assert factors.freedom[0] == pytest.approx(15, rel=1e-12)


@pytest.mark.parametrize("n_rows", [2, 3])
def test_without_a_degree_of_freedom_there_are_no_statistics(n_rows):
    rows, groups = np.eye(3)[:n_rows], np.zeros(n_rows, dtype=np.intp)
    span = rows @ information(rows).root
    with pytest.raises(NotIdentifiableError, match="too few to find the uncertainty"):
        find_factors(np.zeros(n_rows), span, groups, 1)


def test_chi_square_is_that_of_the_tables():
    result = chi_square(factor=2.0, freedom=10)
    assert result.value == pytest.approx(40.0)
    assert result.p_larger == pytest.approx(1.694e-5, rel=1e-3)  # chi-square of 40 with 10 degrees of freedom
    assert result.p_larger + result.p_smaller == pytest.approx(1.0)
