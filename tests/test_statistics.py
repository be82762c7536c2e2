"""Statistics against textbook formulas and against simulation of linear models."""

import numpy as np
import pytest
from scipy import stats

from calib.errors import NotIdentifiableError
from calib.numerics.statistics import Noise, chi_square, effective_parameters, found_noise, statistics, status

RNG = np.random.default_rng(7)


def of_line(x, y):
    """Statistics of a straight line through points, through the module under test."""
    rows = np.column_stack([np.ones_like(x), x])
    residuals = y - rows @ np.linalg.lstsq(rows, y, rcond=None)[0]
    noise = found_noise(residuals, 2)
    return statistics(rows, noise, np.ones(2), np.zeros(2, dtype=bool), noise.sigma), noise


def test_a_straight_line_has_the_uncertainty_of_the_textbook():
    x = np.array([0.0, 1.0, 2.0, 3.0, 5.0, 8.0])
    found, noise = of_line(x, 3 + 0.5 * x + RNG.normal(size=6))
    known = stats.linregress(x, 3 + 0.5 * x)  # for its formula only; the residuals are ours
    assert known.slope == pytest.approx(0.5)
    spread = np.sum((x - x.mean()) ** 2)
    assert found.std[1] == pytest.approx(noise.sigma / np.sqrt(spread))
    assert found.std[0] == pytest.approx(noise.sigma * np.sqrt(1 / 6 + x.mean() ** 2 / spread))
    assert found.correlations()[0, 1] == pytest.approx(-x.mean() / np.sqrt(np.mean(x**2)))
    assert found.freedom == 4
    assert found.half_width[1] == pytest.approx(2.7764451 * found.std[1])  # Student's t, 4 degrees of freedom, 97.5 %
    assert found.effective_parameters == pytest.approx(2)


def test_standard_deviations_agree_with_linregress():
    x, y = np.linspace(0, 1, 20), RNG.normal(size=20)
    found, _ = of_line(x, y)
    known = stats.linregress(x, y)
    assert found.std[1] == pytest.approx(known.stderr)
    assert found.std[0] == pytest.approx(known.intercept_stderr)


def test_scales_only_change_the_unit():
    rows = RNG.normal(size=(12, 3))
    scales = np.array([1e-3, 2.0, 5e-2])
    noise = Noise(0.1, 9, 0.1)
    none = np.zeros(3, dtype=bool)
    plain = statistics(rows, noise, np.ones(3), none, 0.1)
    scaled = statistics(rows * scales, noise, scales, none, 0.1)
    np.testing.assert_allclose(scaled.covariance, plain.covariance, rtol=1e-10)


def test_one_reading_and_one_prior_combine_as_the_mean_of_two_normal_numbers():
    sigma, s = 0.3, 0.5  # reading and prior standard deviation of one length
    noise = Noise(sigma, 10, sigma)
    found = statistics(np.array([[s]]), noise, np.array([s]), np.array([True]), sigma)
    assert found.std[0] == pytest.approx(1 / np.sqrt(1 / sigma**2 + 1 / s**2))
    assert found.data_share[0] == pytest.approx(s**2 / (s**2 + sigma**2))
    assert found.effective_parameters == pytest.approx(found.data_share[0])


def test_a_parameter_that_the_data_do_not_see_keeps_its_prior():
    rows = np.column_stack([RNG.normal(size=30), np.zeros(30)])
    noise = Noise(1e-2, 29, 1e-2)
    found = statistics(rows, noise, np.array([1.0, 2e-3]), np.array([True, True]), 1e-2)
    assert found.std[1] == pytest.approx(2e-3)
    assert found.data_share == pytest.approx([1.0, 0.0], abs=1e-4)


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
    assert status(share, relative_std, **({"prior": False, "placement": False} | kind)) == word


def test_degrees_of_freedom_with_priors_make_the_found_noise_unbiased():
    # 12 rows, 8 parameters of very different strength; true values drawn from their priors, 20 000 times
    rows = RNG.normal(size=(12, 8)) * np.logspace(-3, 2, 8)
    sigma, has_prior = 0.7, np.ones(8, dtype=bool)
    u, y = RNG.normal(size=(20000, 8)), RNG.normal(size=(20000, 12))
    data = u @ rows.T + sigma * y
    solve = np.linalg.solve(rows.T @ rows + sigma**2 * np.eye(8), rows.T)
    residuals = data - (data @ solve.T) @ rows.T
    n_effective = effective_parameters(rows, has_prior, sigma)
    assert 2 < n_effective < 6
    variances = [found_noise(r, n_effective).sigma ** 2 for r in residuals]
    assert np.mean(variances) == pytest.approx(sigma**2, rel=0.02)  # standard error 0.4 %


def test_covariance_with_priors_is_the_scatter_about_the_truth_also_where_the_stated_noise_is_wrong():
    rows = RNG.normal(size=(15, 4)) * [10.0, 1.0, 0.3, 0.01]
    sigma, assumed = 0.5, 0.2
    u = RNG.normal(size=(40000, 4))
    data = u @ rows.T + sigma * RNG.normal(size=(40000, 15))
    estimate = data @ np.linalg.solve(rows.T @ rows + assumed**2 * np.eye(4), rows.T).T
    found = statistics(rows, Noise(sigma, 11, sigma), np.ones(4), np.ones(4, dtype=bool), assumed)
    np.testing.assert_allclose(found.std, np.std(estimate - u, axis=0), rtol=0.02)


def test_only_some_parameters_have_priors():
    rows = RNG.normal(size=(9, 3))
    has_prior = np.array([False, True, False])
    expected = np.linalg.inv(rows.T @ rows / 0.25 + np.diag([0.0, 1.0, 0.0]))
    found = statistics(rows, Noise(0.5, 6, 0.5), np.ones(3), has_prior, 0.5)
    np.testing.assert_allclose(found.covariance, expected, rtol=1e-10)
    assert found.data_share[0] == 1.0


def test_the_triangular_factor_serves_as_well_as_all_rows():
    rows, noise, none = RNG.normal(size=(50, 5)), Noise(1.0, 45, 1.0), np.zeros(5, dtype=bool)
    whole = statistics(rows, noise, np.ones(5), none, 1.0)
    small = statistics(np.linalg.qr(rows, mode="r"), noise, np.ones(5), none, 1.0)
    np.testing.assert_allclose(small.covariance, whole.covariance, rtol=1e-10)


def test_small_singular_values_keep_their_digits():
    # condition 1e8: a normal matrix would have none left
    q = np.linalg.qr(RNG.normal(size=(20, 2)))[0]
    found = statistics(q * [1.0, 1e-8], Noise(1.0, 18, 1.0), np.ones(2), np.zeros(2, dtype=bool), 1.0)
    np.testing.assert_allclose(found.std, [1.0, 1e8], rtol=1e-6)


def test_zero_noise_gives_zero_uncertainty_and_no_error():
    found = statistics(RNG.normal(size=(6, 2)), Noise(0.0, 4, 0.0), np.ones(2), np.zeros(2, dtype=bool), 1e-3)
    np.testing.assert_array_equal(found.std, 0.0)
    assert np.all(np.isnan(found.correlations()))


@pytest.mark.parametrize("n_rows", [2, 3])
def test_without_a_degree_of_freedom_there_are_no_statistics(n_rows):
    with pytest.raises(NotIdentifiableError, match="degrees of freedom"):
        found_noise(np.zeros(n_rows), 3.0)


def test_chi_square_is_that_of_the_tables():
    found = chi_square(sigma=2.0, freedom=10, sigma_stated=1.0)
    assert found.value == pytest.approx(40.0)
    assert found.p_larger == pytest.approx(1.694e-5, rel=1e-3)  # chi-square of 40 with 10 degrees of freedom
    assert found.p_larger + found.p_smaller == pytest.approx(1.0)
