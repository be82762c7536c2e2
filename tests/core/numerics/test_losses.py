import numpy as np
import pytest
from scipy.stats import chi, f

from calib.core.base.errors import NotIdentifiableError
from calib.core.numerics.losses import (
    LOSSES,
    constant,
    efficiency,
    robust_factors,
    scale_of,
    slopes,
    studentised,
    weights,
    weights_of,
)

ROBUST = [loss for loss in LOSSES if loss != "none"]


@pytest.mark.parametrize(("loss", "known"), [("huber", 1.345), ("cauchy", 2.3849), ("tukey", 4.685)])
def test_for_one_coordinate_the_known_constants_give_95_percent(loss, known):
    assert efficiency(loss, known, k=1) == pytest.approx(0.95, abs=2e-4)
    assert constant(loss, 1) == pytest.approx(known, abs=2e-3)


@pytest.mark.quick(1)
@pytest.mark.parametrize("k", [2, 3, 6])
@pytest.mark.parametrize("loss", ROBUST)
def test_the_centre_of_normal_readings_scatters_as_the_efficiency_says(loss, k):
    # independent of the formula: estimate 1500 centres of 100 readings each by reweighting
    points = np.random.default_rng(1).standard_normal((1500, 100, k))
    centre = points.mean(axis=1)
    for _ in range(30):
        w = weights(loss, np.linalg.norm(points - centre[:, None], axis=2), constant(loss, k))[..., None]
        centre = np.sum(w * points, axis=1) / np.sum(w, axis=1)
    assert np.var(points.mean(axis=1)) / np.var(centre) == pytest.approx(0.95, abs=0.02)


@pytest.mark.parametrize(
    ("loss", "at_zero", "at_constant", "far"),
    [("none", 1, 1, 1), ("huber", 1, 1, 0.01), ("cauchy", 1, 0.5, 1 / 10001), ("tukey", 1, 0, 0)],
)
def test_weights_at_the_places_that_define_them(loss, at_zero, at_constant, far):
    c = min(constant(loss, 3), 10.0)
    np.testing.assert_allclose(
        weights(loss, np.array([0, c, 100 * c]), constant(loss, 3)), [at_zero, at_constant, far], rtol=1e-12
    )


@pytest.mark.parametrize("k", [1, 3, 6])
@pytest.mark.parametrize("loss", LOSSES)
@pytest.mark.parametrize("distance", [0.3, 1.5, 2.5, 7.0])
def test_slopes_are_the_mean_derivative_of_the_weighted_residual(loss, distance, k):
    c = constant(loss, k)
    direction = np.arange(1.0, k + 1)
    r = distance * direction / np.linalg.norm(direction)

    def weighted(point):
        return weights(loss, np.linalg.norm(point), c) * point

    h = 1e-6
    trace = sum((weighted(r + h * e) - weighted(r - h * e))[i] / (2 * h) for i, e in enumerate(np.eye(k)))
    assert slopes(loss, np.array(distance), c, k) == pytest.approx(trace / k, abs=1e-8)


def test_every_reading_is_weighed_by_the_constant_of_its_own_rows():
    distances, widths = np.full(4, 2.2), np.array([3, 1, 6, 3])
    expected = [min(1.0, constant("huber", k) / 2.2) for k in (3, 1, 6, 3)]
    np.testing.assert_allclose(weights_of("huber", distances, widths), expected, rtol=1e-12)


@pytest.mark.parametrize("widths", [np.full(200_000, 3), np.random.default_rng(4).integers(1, 7, 200_000)], ids=str)
def test_the_scale_of_normal_readings_is_their_sigma_also_of_unequal_rows(widths):
    distances = 0.02 * chi(widths).rvs(random_state=3)
    assert scale_of(distances, widths, 0) == pytest.approx(0.02, rel=0.005)


def test_the_scale_hardly_moves_with_five_percent_outliers():
    distances = chi(3).rvs(20000, random_state=3)
    distances[:1000] = 1e6
    result = scale_of(distances, np.full(20000, 3), 0)
    assert result == pytest.approx(1.0, abs=0.035)  # the median moves to the 52.6 % point


@pytest.mark.parametrize("loss", LOSSES)
def test_the_noise_of_normal_points_is_found_and_costs_five_percent(loss):
    distances = 0.02 * chi(3).rvs(100000, random_state=5)
    result = robust_factors(loss, distances, np.full(100000, 3), 0.02, 0.0)
    assert result.values[0] == pytest.approx(0.02, rel=0.005)
    expected = 0.02 if loss == "none" else 0.02 / np.sqrt(0.95)
    assert result.effective[0] == pytest.approx(expected, rel=0.005)
    assert result.freedom[0] == pytest.approx(300000, rel=0.005)


def test_points_without_weight_do_not_count_as_measured():
    distances = chi(3).rvs(10000, random_state=5)
    distances[:500] = 1e3
    result = robust_factors("tukey", distances, np.full(10000, 3), 1.0, 0.0)
    assert result.values[0] == pytest.approx(1.0, rel=0.01)
    assert result.freedom[0] == pytest.approx(3 * 9500, rel=0.01)
    assert result.effective[0] == pytest.approx(1 / np.sqrt(0.95 * 0.95), rel=0.01)


def test_an_outlier_counts_as_the_largest_error_that_is_none():
    rng, reading = np.random.default_rng(6), np.repeat(np.arange(40), 3)
    residuals = rng.standard_normal(120)
    residuals[30:33] = 40.0
    none = np.zeros((120, 1))
    errors = studentised(residuals, none, reading, np.full(40, 3), np.ones(40), 100.0)
    assert errors.outliers.tolist() == [10]
    assert np.all(errors.bounded_weights[np.arange(40) != 10] == 1.0)
    bounded = errors.ratio[10] * np.sqrt(errors.bounded_weights[10])
    assert 40 * f.sf(bounded**2 / 3, 3, 50.0) == pytest.approx(0.01, rel=1e-6)


def test_no_freedom_is_an_error():
    with pytest.raises(NotIdentifiableError):
        robust_factors("tukey", np.ones(4), np.full(4, 3), 1.0, 12.0)
