import numpy as np
import pytest

import calib
from calib.core.numerics.losses import scale_of, weights
from tests.six_axis_arm import joints, measurements

SIGMA = 4e-5


@pytest.fixture(scope="module")
def data(arm):
    """60 poses with noise of 0.04 mm, three of them 5 mm off."""
    rng = np.random.default_rng(2)
    q = joints(60)
    positions = arm.positions(q) + SIGMA * rng.standard_normal((60, 1, 3))
    positions[[7, 20, 41]] += 5e-3
    return measurements(arm, q, positions)


def distances_and_scale(fit):
    distances = np.linalg.norm(fit.identification.errors("after"), axis=1)
    return distances, scale_of(distances, np.full(60, 3), fit.statistics.effective_parameters)


@pytest.mark.parametrize("loss", ["huber", "cauchy", "tukey"])
def test_weights_are_those_of_the_residuals_that_they_lead_to(arm, data, loss):
    fit = calib.fit(arm, data, loss=loss)
    assert fit.converged
    distances, scale = distances_and_scale(fit)
    if loss == "huber":  # the others keep Huber's scale
        np.testing.assert_allclose(fit.weights, weights(loss, distances / scale, 1.6279879), atol=1e-3)
    assert set(np.argsort(fit.weights)[:3]) == set(np.argsort(-distances)[:3]) == {7, 20, 41}


@pytest.mark.parametrize("loss", ["huber", "cauchy", "tukey"])
def test_gross_errors_hardly_move_the_parameters(arm, data, loss):
    plain, robust = calib.fit(arm, data), calib.fit(arm, data, loss=loss)
    q = joints(50, seed=9)
    errors = [np.linalg.norm(fit.robot.positions(q) - arm.positions(q)) for fit in (plain, robust)]
    assert errors[1] < 0.25 * errors[0]
    assert np.max(np.abs(robust.robot.values - arm.values)[robust.free] / robust.statistics.std) < 5


def test_tukey_gives_gross_errors_no_weight_and_finds_the_noise_of_the_others(arm, data):
    fit = calib.fit(arm, data, loss="tukey")
    assert np.flatnonzero(fit.weights == 0).tolist() == [7, 20, 41]
    assert fit.sigma == pytest.approx(SIGMA, rel=0.15)  # standard error 6 %
    assert calib.fit(arm, data).sigma > 10 * SIGMA


def test_without_outliers_a_robust_fit_is_nearly_the_plain_one(arm):
    q = joints(60)
    clean = measurements(arm, q, arm.positions(q) + SIGMA * np.random.default_rng(4).standard_normal((60, 1, 3)))
    plain, robust = calib.fit(arm, clean), calib.fit(arm, clean, loss="tukey")
    apart = np.abs(plain.robot.values - robust.robot.values)[arm.is_free] / plain.statistics.std
    assert np.max(apart) < 1.0
    assert np.mean(robust.statistics.std / plain.statistics.std) == pytest.approx(1 / np.sqrt(0.95), abs=0.08)


def test_huber_minimises_its_cost(arm, data):
    fit = calib.fit(arm, data, loss="huber")
    _, scale = distances_and_scale(fit)

    def cost(robot):
        d = np.linalg.norm((robot.positions(data.joints) - data.points(arm))[:, 0], axis=1) / scale
        c = 1.6279879
        return np.sum(np.where(d < c, d**2 / 2, c * d - c**2 / 2))

    here = cost(fit.robot)
    rng = np.random.default_rng(8)
    for _ in range(20):
        step = np.zeros(len(arm.parameters))
        step[arm.is_free] = 0.3 * fit.statistics.std * rng.standard_normal(arm.is_free.sum())
        assert cost(fit.robot.with_parameters(fit.robot.values + step)) > here


def test_exact_data_with_gross_errors_come_back_exactly(arm):
    q = joints(40)
    positions = arm.positions(q)
    positions[[3, 30]] += 2e-3
    fit = calib.fit(arm, measurements(arm, q, positions), loss="tukey")
    np.testing.assert_allclose(fit.robot.values, arm.values, atol=1e-9)


@pytest.mark.parametrize(("how", "loss"), [({"loss": "cauchy"}, "cauchy"), ({"exclude_outliers": True}, "tukey")])
def test_exact_readings_have_no_noise_to_weigh_by(robot, how, loss):
    """Priors pull the fit by some hundredths of a micrometre: the readings are off by nothing else."""
    off = 0.5 * robot.parameters.sigma_si * np.random.default_rng(0).standard_normal(len(robot.values))
    q = robot.sample(60, seed=1)
    exact = calib.as_measurements(robot, q, robot.with_parameters(robot.values + off).positions(q))
    message = f"no noise by which --loss {loss} could tell .* --loss none, and without --exclude-outliers"
    with pytest.raises(calib.NotIdentifiableError, match=message):
        calib.fit(robot, exact, **how)
