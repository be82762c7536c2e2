import numpy as np
import pytest
from scipy.stats import chi

from calib.errors import InputError, NotIdentifiableError
from calib.numerics.losses import CONSTANTS, LOSSES, checked_loss, efficiency, noise, scale_of, slopes, weights

ROBUST = [loss for loss in LOSSES if loss != "none"]


@pytest.mark.parametrize(("loss", "constant"), [("huber", 1.345), ("cauchy", 2.3849), ("tukey", 4.685)])
def test_for_one_coordinate_the_known_constants_give_95_percent(loss, constant):
    assert efficiency(loss, constant, k=1) == pytest.approx(0.95, abs=2e-4)


@pytest.mark.parametrize("loss", ROBUST)
def test_the_constants_for_points_of_three_coordinates_give_95_percent(loss):
    assert efficiency(loss, CONSTANTS[loss]) == pytest.approx(0.95, abs=1e-6)


@pytest.mark.parametrize("loss", ROBUST)
def test_the_centre_of_normal_points_scatters_as_the_efficiency_says(loss):
    # independent of the formula: estimate 4000 centres of 100 points each by reweighting
    points = np.random.default_rng(1).standard_normal((4000, 100, 3))
    centre = points.mean(axis=1)
    for _ in range(30):
        w = weights(loss, np.linalg.norm(points - centre[:, None], axis=2))[..., None]
        centre = np.sum(w * points, axis=1) / np.sum(w, axis=1)
    assert np.var(points.mean(axis=1)) / np.var(centre) == pytest.approx(0.95, abs=0.02)


@pytest.mark.parametrize(
    ("loss", "at_zero", "at_constant", "far"),
    [("none", 1, 1, 1), ("huber", 1, 1, 0.01), ("cauchy", 1, 0.5, 1 / 10001), ("tukey", 1, 0, 0)],
)
def test_weights_at_the_places_that_define_them(loss, at_zero, at_constant, far):
    c = min(CONSTANTS[loss], 10.0)
    np.testing.assert_allclose(weights(loss, np.array([0, c, 100 * c])), [at_zero, at_constant, far], rtol=1e-12)


@pytest.mark.parametrize("loss", LOSSES)
@pytest.mark.parametrize("distance", [0.3, 1.5, 2.5, 7.0])
def test_slopes_are_the_mean_derivative_of_the_weighted_residual(loss, distance):
    r = distance * np.array([0.6, -0.48, 0.64])

    def weighted(point):
        return weights(loss, np.linalg.norm(point)) * point

    h = 1e-6
    trace = sum((weighted(r + h * e) - weighted(r - h * e))[i] / (2 * h) for i, e in enumerate(np.eye(3)))
    assert slopes(loss, np.array(distance)) == pytest.approx(trace / 3, abs=1e-8)


def test_the_scale_of_normal_points_is_their_sigma():
    distances = 0.02 * chi(3).rvs(200000, random_state=3)
    assert scale_of(distances, 0) == pytest.approx(0.02, rel=0.005)


def test_the_scale_hardly_moves_with_five_percent_outliers():
    distances = chi(3).rvs(20000, random_state=3)
    distances[:1000] = 1e6
    assert scale_of(distances, 0) == pytest.approx(1.0, abs=0.035)  # the median moves to the 52.6 % point


@pytest.mark.parametrize("loss", LOSSES)
def test_the_noise_of_normal_points_is_found_and_costs_five_percent(loss):
    distances = 0.02 * chi(3).rvs(100000, random_state=5)
    found = noise(loss, distances, 0.02, 0.0)
    assert found.sigma == pytest.approx(0.02, rel=0.005)
    expected = 0.02 if loss == "none" else 0.02 / np.sqrt(0.95)
    assert found.effective == pytest.approx(expected, rel=0.005)
    assert found.freedom == pytest.approx(300000, rel=0.005)


def test_points_without_weight_do_not_count_as_measured():
    distances = chi(3).rvs(10000, random_state=5)
    distances[:500] = 1e3
    found = noise("tukey", distances, 1.0, 0.0)
    assert found.sigma == pytest.approx(1.0, rel=0.01)
    assert found.freedom == pytest.approx(3 * 9500, rel=0.01)
    assert found.effective == pytest.approx(1 / np.sqrt(0.95 * 0.95), rel=0.01)


def test_no_freedom_is_an_error():
    with pytest.raises(NotIdentifiableError):
        noise("tukey", np.ones(4), 1.0, 12.0)


def test_an_unknown_loss_names_the_nearest():
    with pytest.raises(InputError, match="did you mean 'tukey'"):
        checked_loss("tuckey")
