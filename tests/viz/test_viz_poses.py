"""The pose table: from fits, folders and measurements; errors, uncertainty and outliers."""

import numpy as np
import pytest

import calib
from tests.small_robots import ARM_YAML, write_arm
from tests.viz.viz_examples import assert_saved_alike, measurements, pose_table, spoiled_fit
from viz.pose_sources import from_fit, measured_set


def small(**changes):
    poses = {"q": np.zeros((4, 2)), "measured": np.zeros((4, 3)), "before": np.ones((4, 3))}
    poses |= {"after": np.full((4, 3), 1e-3), "sigma": np.full(4, 1e-3), "spread": np.zeros((4, 3))}
    return pose_table(**(poses | changes))


def test_the_table_of_a_fit_holds_its_errors(fit):
    table = from_fit(fit)
    assert len(table) == 84 + 47
    assert table.group.count("identification") == 84
    np.testing.assert_allclose(table.error("before")[:84], fit.identification.before["tool"], atol=1e-15)
    np.testing.assert_allclose(table.error("after")[84:], fit.validation.after["tool"], atol=1e-15)
    np.testing.assert_allclose(table.after, fit.robot.positions(table.joints)[:, 0], atol=1e-10)
    np.testing.assert_allclose(table.before, fit.nominal.positions(table.joints)[:, 0], atol=1e-10)


@pytest.mark.quick(0)
def test_the_spread_of_predictions_agrees_with_random_parameters(fit):
    table = from_fit(fit)
    generator = np.random.default_rng(0)
    draws = generator.multivariate_normal(np.zeros(int(fit.free.sum())), fit.covariance.values, size=100)
    values = fit.robot.values + np.zeros((100, len(fit.free)))
    values[:, fit.free] += draws
    q = table.joints[:3]
    cloud = np.array([fit.robot.with_parameters(row).positions(q)[:, 0] for row in values])
    # 100 draws give a standard deviation to 7 %; four of these sigmas
    np.testing.assert_allclose(cloud.std(axis=0, ddof=1), table.spread[:3], rtol=0.29)


def test_a_wrong_reading_is_marked_where_it_is():
    table = from_fit(spoiled_fit())
    assert np.flatnonzero(table.outlier).tolist() == [10]
    assert set(table.group) == {"identification"}


def test_outliers_that_were_left_out_stay_in_the_table_also_of_a_folder(tmp_path):
    fit = spoiled_fit(exclude_outliers=True)
    saved = assert_saved_alike(fit, tmp_path)
    assert saved.notes == ()
    table = saved.poses
    assert table.group.count("identification") == 83
    row = table.group.index("left out")
    assert (row, table.outlier[row], table.labels[row]) == (83, True, "50")
    assert table.error("after")[row, 2] == pytest.approx(-1e-3, abs=2e-4)  # noise and uncertainty of the prediction


def test_arrays_of_a_table_are_copies_that_nobody_can_write_to():
    measured = np.zeros((4, 3))
    table = small(measured=measured)
    measured[0] = 1.0
    assert np.all(table.measured == 0)
    for array in (table.measured, table.joints, table.outlier, table.subset(np.arange(2)).after):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1


def test_residuals_over_an_unknown_sigma_are_unknown():
    assert np.isnan(small(sigma=np.array([0.0, np.nan, 1e-3, 1e-3])).normalised_residuals()[:2]).all()
    np.testing.assert_allclose(small().normalised_residuals(), 1.0)


def test_measurements_without_a_calibrated_robot_have_no_error_after(medrue):
    data = measurements(np.arange(4))
    table = measured_set(data, medrue, None, {}).table()
    assert np.isnan(table.after).all()
    np.testing.assert_allclose(table.before, medrue.positions(data.joints)[:, 0])
    assert set(table.group) == {"measured"}


def test_measurements_are_compared_with_what_is_predicted_under_their_conditions(tmp_path):
    robot = calib.load(write_arm(tmp_path, f"{ARM_YAML}  - {{joint: turn, term: temperature, sigma: 1 mrad}}\n"))
    warm, names = robot.with_parameters({"turn.temperature": 1e-3}), tuple("abcde")
    q = np.random.default_rng(0).uniform([-1, 0, -1], [1, 0.5, 1], (5, 3))
    poses = calib.Poses(q, names, names, "memory", (), context={"temperature": np.full(5, 30.0)})
    data = calib.simulate(warm, poses, 0.0, np.random.default_rng(0))
    np.testing.assert_allclose(measured_set(data, warm, None, {}).table().error("before"), 0, atol=1e-12)


def test_a_mean_of_readings_is_surer_than_one_reading():
    table = small(readings=np.array([4, 4, 1, 1]), sigma=np.array([1e-3, 1e-3, 2e-3, 2e-3]))
    np.testing.assert_allclose(table.sigma_of_reading(), 2e-3)
    np.testing.assert_allclose(table.normalised_residuals()[:, 0], [1.0, 1.0, 0.5, 0.5])


def test_poses_held_out_of_one_file_keep_their_places_in_it(medrue):
    data = measurements(np.arange(0, 420, 4))
    kept, held = (np.flatnonzero(np.arange(105) % 5 != 2), np.flatnonzero(np.arange(105) % 5 == 2))
    table = from_fit(calib.fit(medrue, data.subset(kept), validation=data.subset(held)))
    assert set(table.series) == {"memory"}
    assert table.place.tolist() == [*kept, *held]


def test_files_of_their_own_are_series_of_their_own(fit):
    table = from_fit(fit)
    assert table.series == ("memory (identification)",) * 84 + ("memory (validation)",) * 47
    assert table.place.tolist() == [*range(84), *range(47)]
