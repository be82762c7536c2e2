import numpy as np
import pytest
from six_axis_arm import joints, measurements, six_axis_arm
from small_robots import write_arm

import calib
from calib.numerics.outliers import studentised

SIGMA = 4e-5
RNG = np.random.default_rng(11)


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return six_axis_arm(tmp_path_factory.mktemp("arm"))


def with_errors(arm, poses, size, n=80, seed=2):
    q = joints(n)
    positions = arm.positions(q) + SIGMA * np.random.default_rng(seed).standard_normal((n, 1, 3))
    positions[poses] += size
    return measurements(q, positions)


def test_a_studentised_residual_is_that_of_a_fit_without_the_point():
    # linear model, 20 points of 3 coordinates, 5 parameters; the covariance of a deleted residual is sigma^2 (I - h)^-1
    columns, y = RNG.normal(size=(20, 1, 3, 5)), RNG.normal(size=(20, 1, 3))
    rows, right = columns.reshape(60, 5), y.reshape(60)
    residuals = (y.reshape(60) - rows @ np.linalg.lstsq(rows, right, rcond=None)[0]).reshape(20, 1, 3)
    inverse = np.linalg.inv(np.linalg.qr(rows, mode="r"))
    judged = studentised(residuals, columns, inverse, np.ones((20, 1)), 55.0, scale=1.0)
    kept = np.arange(60) // 3 != 4
    without = np.linalg.lstsq(rows[kept], right[kept], rcond=None)[0]
    deleted = y[4, 0] - columns[4, 0] @ without
    information = rows[kept].T @ rows[kept]
    spread = np.eye(3) + columns[4, 0] @ np.linalg.solve(information, columns[4, 0].T)
    assert judged.ratio[4, 0] ** 2 == pytest.approx(deleted @ np.linalg.solve(spread, deleted))


def test_leverages_add_up_to_the_effective_parameters(arm):
    fit = calib.fit(arm, with_errors(arm, [], 0.0))
    assert 3 * np.sum(fit.studentised.leverage) == pytest.approx(fit.statistics.effective_parameters)


@pytest.mark.parametrize("size", [5e-4, 5e-3])
def test_gross_errors_are_named_with_row_and_pose(arm, size):
    fit = calib.fit(arm, with_errors(arm, [12, 55], [0, 0, size]))
    assert {outlier.pose for outlier in fit.outliers} >= {12, 55}
    assert fit.outliers[0].label in ("row 12", "row 55")
    assert fit.outliers[0].target == "ball"
    assert "times the noise" in str(fit.outliers[0])


def test_excluded_outliers_are_told_and_both_results_kept(arm):
    data = with_errors(arm, [3, 40, 60, 79], [1e-3, 0, 0])
    fit = calib.fit(arm, data, exclude_outliers=True)
    assert sorted(outlier.pose for outlier in fit.excluded) == [3, 40, 60, 79]
    assert min(fit.excluded, key=lambda o: o.pose).label == "row 3"
    assert len(fit.identification.data) == 76
    assert len(fit.with_all.identification.data) == 80
    assert fit.statistics.sigma < 0.5 * fit.with_all.statistics.sigma
    alone = calib.fit(arm, data.subset(np.setdiff1d(np.arange(80), [3, 40, 60, 79])))
    np.testing.assert_array_equal(fit.robot.values, alone.robot.values)


def test_outliers_stay_unless_excluding_is_asked_for(arm):
    fit = calib.fit(arm, with_errors(arm, [3], [1e-3, 0, 0]))
    assert len(fit.identification.data) == 80
    assert fit.excluded == ()


def test_nothing_to_exclude_gives_the_plain_fit(arm):
    fit = calib.fit(arm, with_errors(arm, [], 0.0), exclude_outliers=True)
    assert fit.excluded == ()
    assert fit.with_all is None


def test_a_point_that_decides_its_own_prediction_is_no_outlier():
    # the last column is seen by one point only, so that its residual along it is zero whatever was measured
    columns = RNG.normal(size=(15, 1, 3, 3))
    columns[..., 2] = 0.0
    columns[6, 0] = np.diag([1e4, 1e4, 1e4])
    residuals = RNG.normal(size=(15, 1, 3))
    residuals[6] = 1e-9
    inverse = np.linalg.inv(np.linalg.qr(columns.reshape(45, 3), mode="r"))
    judged = studentised(residuals, columns, inverse, np.ones((15, 1)), 42.0)
    assert judged.leverage[6, 0] > 0.99
    assert judged.p_value[6, 0] == 1.0


def test_a_bad_validation_pose_is_named(arm):
    validation = with_errors(arm, [5], [0, 1e-3, 0], n=20, seed=8)
    fit = calib.fit(arm, with_errors(arm, [], 0.0), validation=validation)
    assert [outlier.pose for outlier in fit.validation_outliers] == [5]
    assert fit.outliers == ()


def test_a_target_of_several_is_named(tmp_path):
    yaml = """\
urdf: arm.urdf
name_mot: [turn, slide, wrist]
base: {frame: ground}
targets:
  tip: {frame: tool, xyz: [10 mm, 20 mm, 30 mm]}
  side: {frame: hand, xyz: [0, 50 mm, 0]}
parametrisation:
  - {origin: turn, components: [x, y, z], sigma: 2 mm}
  - {origin: flange, components: [x, y], sigma: 2 mm}
"""
    robot = calib.load(write_arm(tmp_path, yaml))
    q = np.random.default_rng(0).uniform([-2, 0, -2], [2, 1, 2], (30, 3))
    positions = robot.positions(q) + SIGMA * np.random.default_rng(1).standard_normal((30, 2, 3))
    positions[9, 1, 0] += 1e-3
    fit = calib.fit(robot, measurements(q, positions))
    assert [(outlier.pose, outlier.target) for outlier in fit.outliers] == [(9, "side")]
