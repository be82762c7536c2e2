import numpy as np
import pytest
from six_axis_arm import FREE, NO_PRIORS, YAML, joints, measurements, six_axis_arm, write_six_axis
from small_robots import write_arm

import calib
from calib.judging import findings
from calib.numerics.losses import Blocks, studentised

SIGMA = 4e-5
RNG = np.random.default_rng(11)


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return six_axis_arm(tmp_path_factory.mktemp("arm"))


def with_errors(arm, poses, size, n=80, seed=2):
    q = joints(n)
    positions = arm.positions(q) + SIGMA * np.random.default_rng(seed).standard_normal((n, 1, 3))
    positions[poses] += size
    return measurements(arm, q, positions)


def test_a_studentised_residual_is_that_of_a_fit_without_the_point():
    # linear model, 20 points of 3 coordinates, 5 parameters; the covariance of a deleted residual is sigma^2 (I - h)^-1
    columns, y = RNG.normal(size=(20, 3, 5)), RNG.normal(size=(20, 3))
    rows, right = columns.reshape(60, 5), y.reshape(60)
    residuals = (right - rows @ np.linalg.lstsq(rows, right, rcond=None)[0]).reshape(20, 3)
    root = np.linalg.inv(np.linalg.qr(rows, mode="r"))
    judged = studentised([Blocks(residuals, columns, np.full(20, 3), np.ones(20))], root, 55.0, scale=1.0)
    kept = np.arange(60) // 3 != 4
    without = np.linalg.lstsq(rows[kept], right[kept], rcond=None)[0]
    deleted = y[4] - columns[4] @ without
    information = rows[kept].T @ rows[kept]
    spread = np.eye(3) + columns[4] @ np.linalg.solve(information, columns[4].T)
    assert judged.ratio[4] ** 2 == pytest.approx(deleted @ np.linalg.solve(spread, deleted))


def test_readings_of_unequal_rows_raise_equally_few_false_alarms():
    # normal readings of 1, 3 and 6 rows: their ratios over the median of chi(k) are one scale, and none is an outlier
    widths = [1, 3, 6]
    blocks = [
        Blocks(RNG.normal(size=(3000, k)), np.zeros((3000, k, 2)), np.full(3000, k), np.ones(3000)) for k in widths
    ]
    judged = studentised(blocks, np.eye(2), 30000.0)
    assert judged.scale == pytest.approx(1.0, rel=0.02)
    assert len(judged.outliers) == 0
    far = [Blocks(block.residuals.copy(), block.columns, block.widths, block.weights) for block in blocks]
    for block, row in zip(far, (5, 6, 7), strict=True):
        block.residuals[row] = 8.0 / np.sqrt(block.residuals.shape[1])
    assert sorted(studentised(far, np.eye(2), 30000.0).outliers) == [5, 3006, 6007]


def test_a_row_that_was_not_read_says_nothing_about_its_reading():
    columns, residuals = RNG.normal(size=(30, 3, 4)), RNG.normal(size=(30, 3))
    columns[7, 1], residuals[7, 1] = 0.0, 0.0
    widths = np.full(30, 3)
    widths[7] = 2
    root = np.linalg.inv(np.linalg.qr(columns.reshape(-1, 4), mode="r"))
    judged = studentised([Blocks(residuals, columns, widths, np.ones(30))], root, 85.0, scale=1.0)
    h = columns[7][[0, 2]] @ root @ root.T @ columns[7][[0, 2]].T
    r = residuals[7][[0, 2]]
    assert judged.ratio[7] ** 2 == pytest.approx(r @ np.linalg.solve(np.eye(2) - h, r))
    assert judged.leverage[7] == pytest.approx(np.trace(h) / 2)


def test_leverages_add_up_to_the_effective_parameters(arm):
    fit = calib.fit(arm, with_errors(arm, [], 0.0))
    assert 3 * np.sum(findings.studentised(fit).leverage) == pytest.approx(fit.statistics.effective_parameters)


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
    assert fit.sigma < 0.5 * fit.with_all.sigma
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
    columns = RNG.normal(size=(15, 3, 3))
    columns[..., 2] = 0.0
    columns[6] = np.diag([1e4, 1e4, 1e4])
    residuals = RNG.normal(size=(15, 3))
    residuals[6] = 1e-9
    root = np.linalg.inv(np.linalg.qr(columns.reshape(45, 3), mode="r"))
    judged = studentised([Blocks(residuals, columns, np.full(15, 3), np.ones(15))], root, 42.0)
    assert judged.leverage[6] > 0.99
    assert judged.p_value[6] == 1.0


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
    fit = calib.fit(robot, measurements(robot, q, positions))
    assert [(outlier.pose, outlier.target) for outlier in fit.outliers] == [(9, "side")]


def test_an_instrument_whose_noise_is_stated_too_small_does_not_make_outliers_of_its_readings(tmp_path):
    yaml = YAML.replace("parametrisation:", "instruments:\n  ball: {kind: position, sigma: 0.01 mm}\n"
        "  other: {kind: position, target: ball, sigma: 0.1 mm}\nparametrisation:")  # fmt: skip
    robot = calib.load(write_six_axis(tmp_path, NO_PRIORS + yaml + FREE))
    rng = np.random.default_rng(3)
    q = joints(80, 4)
    exact = robot.positions(q)[:, 0]
    noise = {"ball": 1e-4, "other": 1e-4}  # ten times what is stated of the first
    read = {name: exact + sigma * rng.standard_normal(exact.shape) for name, sigma in noise.items()}
    fit = calib.fit(robot, calib.as_measurements(robot, q, read))
    assert fit.outliers == ()
