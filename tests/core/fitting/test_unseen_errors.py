"""What can be relied on at poses that a fit has not seen: against refits without each pose, and against chance."""

from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.core.fitting.unseen_errors import accuracy, leave_one_out_errors, left_out_ratio, limit95
from calib.core.robots.accuracy_of_files import PoseUse
from tests.project import write_table
from tests.six_axis_arm import FREE, YAML, joints, noisy, write_six_axis

SIGMA = 4e-5


def test_a_limit_is_an_order_statistic_and_needs_19():
    lengths = np.random.default_rng(1).permutation(np.arange(1.0, 101.0))
    assert limit95(lengths) == 96.0  # ceil(0.95 101)
    assert limit95(lengths[lengths <= 99]) == 95.0  # 0.95 100 exactly
    assert limit95(np.arange(1.0, 20.0)) == 19.0
    assert np.isnan(limit95(np.arange(1.0, 19.0)))


@pytest.mark.parametrize("n", [19, 53, 200])
def test_one_more_error_stays_below_the_limit_whatever_the_distribution(n):
    """k / (n + 1) of all draws exactly, of heavy tails too; one standard deviation of 5000 draws is 0.3 %."""
    draws = np.random.default_rng(n).standard_cauchy((5000, n + 1)) ** 2
    below = np.mean([row[-1] <= limit95(row[:-1]) for row in draws])
    assert below == pytest.approx(np.ceil(0.95 * (n + 1) - 1e-9) / (n + 1), abs=0.012)


@pytest.mark.parametrize("loss", ["none", "tukey"])
def test_poses_left_out_one_by_one_are_those_of_refits(arm, loss):
    """Of a fit whose weights and noise stay as they are, the linear model tells each refit to second order."""
    q = joints(30)
    data = noisy(arm.with_parameters({"j2.x": 0.0502, "j3.rx": 4e-4}), q, SIGMA, 2)
    fit = calib.fit(arm, data, sigma=SIGMA, loss=loss)
    told = leave_one_out_errors(fit).after["ball"]
    assert np.all(np.linalg.norm(told, axis=1) >= np.linalg.norm(fit.identification.after["ball"], axis=1) - 1e-9)
    if loss != "none":
        return  # a refit finds other weights
    for k in (0, 7, 29):
        others = np.delete(np.arange(30), k)
        again = calib.fit(arm, data[others], validation=data[[k]], sigma=SIGMA)
        np.testing.assert_allclose(told[k], again.validation.after["ball"][0], atol=2e-7, rtol=2e-3)


@pytest.mark.parametrize(("gaps", "loss"), [(0, "none"), (12, "none"), (0, "tukey")])
def test_left_out_poses_are_further_off_than_noise_explains_by_their_errors(arm, monkeypatch, gaps, loss):
    """Used and left-out errors together are what noise is to independent poses: n f^2 for n rows that were read."""
    data = noisy(arm, joints(30), SIGMA, 8)
    values = data.readings["ball"].values.copy()
    values[:gaps, 1] = np.nan
    data = replace(data, readings={"ball": replace(data.readings["ball"], values=values)})
    fit = calib.fit(arm, data, sigma=SIGMA, loss=loss)
    used, left_out = fit.identification.after["ball"], leave_one_out_errors(fit).after["ball"]
    weights = fit.weights[:, None]
    more = np.nanmean(weights * used * left_out) / (np.nansum(weights * used**2) / fit.statistics.freedom)
    assert left_out_ratio(fit) == 1.0  # chance explains it
    monkeypatch.setattr("calib.core.fitting.unseen_errors.HARDLY", 1.1)
    assert more > 1.0
    assert left_out_ratio(fit) == pytest.approx(np.sqrt(more), rel=1e-6)


@pytest.mark.quick(0)
@pytest.mark.amount(2, 4)
def test_positions_are_known_by_the_readings_of_all_other_poses(arm, amount):
    """Against the covariance of refits without each pose, which is larger than that of the fit with all of them."""
    q, without, with_all, told = joints(30), [], [], []
    for seed in range(amount):
        data = noisy(arm.with_parameters({"j2.x": 0.0502, "j3.rx": 4e-4}), q, SIGMA, seed)
        fit = calib.fit(arm, data, sigma=SIGMA)
        told.append(fit.verdict.claim.rms**2)
        with_all.append(np.mean(fit.identification_uncertainty.distance**2))
        for k in range(30):
            again = calib.fit(arm, data[np.delete(np.arange(30), k)], sigma=SIGMA, validation=data[[k]])
            without.append(again.validation_uncertainty.distance.item() ** 2)
    assert np.mean(told) == pytest.approx(np.mean(without), rel=0.15)
    assert np.mean(told) > 1.3 * np.mean(with_all)


def test_readings_that_repeat_a_pose_are_left_out_together(arm):
    q = np.repeat(joints(20), 2, axis=0)
    names = [str(k // 2) for k in range(40)]
    points = arm.positions(q) + SIGMA * np.random.default_rng(3).standard_normal((40, 1, 3))
    data = calib.as_measurements(arm, q, points, names)
    fit = calib.fit(arm, data, sigma=SIGMA)
    told = leave_one_out_errors(fit).after["ball"]
    again = calib.fit(arm, data[np.arange(2, 40)], validation=data[[0, 1]], sigma=SIGMA)
    np.testing.assert_allclose(told[:2], again.validation.after["ball"], atol=2e-7, rtol=2e-3)


def test_a_pose_that_alone_decides_something_is_foretold_by_none(tmp_path):
    """The ball was mounted anew for one pose, which alone says where."""
    text = YAML.replace("100 mm]}", "100 mm], position: unknown}")
    arm = calib.load(write_six_axis(tmp_path, f"{text}{FREE}setups: {{first: [], second: [ball]}}\n"))
    q, header = joints(30), [*(f"j{k}" for k in range(1, 7)), "ball_x", "ball_y", "ball_z", "setup"]
    points = arm.positions(q)[:, 0] + SIGMA * np.random.default_rng(4).standard_normal((30, 3))
    setups = ["second" if k == 11 else "first" for k in range(30)]
    fit = calib.fit(arm, calib.read_measurements(write_table(tmp_path / "data.csv", header, q, points, setups), arm))
    foretold = leave_one_out_errors(fit)
    assert list(foretold.data.names) == [str(k + 1) for k in range(30) if k != 11]
    assert np.all(np.linalg.norm(foretold.after["ball"], axis=1) > 0)
    assert accuracy(fit).n_poses == 29


def test_the_poses_that_tell_most_are_taken(arm):
    data = noisy(arm, joints(60), SIGMA, 5)
    held = noisy(arm, joints(25, 8), SIGMA, 6)
    with_validation = accuracy(calib.fit(arm, data, validation=held, folds=3))
    with_folds, alone = accuracy(calib.fit(arm, data, folds=3)), accuracy(calib.fit(arm, data))
    used = [(item.poses, item.n_poses) for item in (with_validation, with_folds, alone)]
    assert used == [(PoseUse.VALIDATION, 25), (PoseUse.FOLDS, 60), (PoseUse.ONE_BY_ONE, 60)]
    fit = calib.fit(arm, data, validation=held)
    errors = np.linalg.norm((fit.robot.positions(held.joints) - held.points(arm))[:, 0], axis=1)
    assert with_validation.rms == pytest.approx(np.sqrt(np.mean(errors**2)), rel=1e-6)
    assert with_validation.limit95 == pytest.approx(np.sort(errors)[24], rel=1e-6)  # ceil(0.95 26) = 25
    assert alone.rms == pytest.approx(SIGMA * np.sqrt(3 * (1 + 26 / (180 - 26))), rel=0.15)  # noise, and what it costs
    assert "95 % within" in alone.words
