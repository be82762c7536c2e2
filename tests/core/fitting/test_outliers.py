import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2, f

import calib
from calib.core.data.tables import read_table
from calib.core.fitting.outliers import bounded_weights, studentise_errors
from calib.core.instruments.kind import Readings
from calib.core.numerics.losses import studentised
from tests.core.instruments import test_kind_pixel as pixel
from tests.six_axis_arm import FREE, NO_PRIORS, YAML, joints, measurements, write_six_axis
from tests.small_robots import ARM_YAML, write_arm
from viz.reading_errors import reading_errors_of_fit

SIGMA = 4e-5
RNG = np.random.default_rng(11)


def with_errors(arm, poses, size, n=80, seed=2):
    q = joints(n)
    positions = arm.positions(q) + SIGMA * np.random.default_rng(seed).standard_normal((n, 1, 3))
    positions[poses] += size
    return measurements(arm, q, positions)


def of_equal_readings(residuals, columns, root, widths, *more, **named):
    """`studentised` of readings of equally many rows, (n, k) and (n, k, n_free), with weights of 1."""
    n, k = residuals.shape
    reading = np.repeat(np.arange(n), k)
    span = columns.reshape(n * k, -1) @ root
    return studentised(residuals.ravel(), span, reading, widths, np.ones(n), *more, **named)


def test_a_studentised_residual_is_that_of_a_fit_without_the_point():
    # linear model, 20 points of 3 coordinates, 5 parameters; the covariance of a deleted residual is sigma^2 (I - h)^-1
    columns, y = RNG.normal(size=(20, 3, 5)), RNG.normal(size=(20, 3))
    rows, right = columns.reshape(60, 5), y.reshape(60)
    residuals = (right - rows @ np.linalg.lstsq(rows, right, rcond=None)[0]).reshape(20, 3)
    root = np.linalg.inv(np.linalg.qr(rows, mode="r"))
    test = of_equal_readings(residuals, columns, root, np.full(20, 3), 55.0, scale=1.0)
    kept = np.arange(60) // 3 != 4
    without = np.linalg.lstsq(rows[kept], right[kept], rcond=None)[0]
    deleted = y[4] - columns[4] @ without
    information = rows[kept].T @ rows[kept]
    spread = np.eye(3) + columns[4] @ np.linalg.solve(information, columns[4].T)
    assert test.ratio[4] ** 2 == pytest.approx(deleted @ np.linalg.solve(spread, deleted))


def test_readings_of_unequal_rows_raise_equally_few_false_alarms():
    # normal readings of 1, 3 and 6 rows: their ratios over the median of chi(k) are one scale, and none is an outlier
    widths = np.repeat([1, 3, 6], 3000)
    reading = np.repeat(np.arange(9000), widths)
    residuals, rest = RNG.normal(size=len(reading)), (np.zeros((len(reading), 2)), reading, widths, np.ones(9000), 3e4)
    test = studentised(residuals, *rest)
    assert test.scale == pytest.approx(1.0, rel=0.02)
    assert len(test.outliers) == 0
    for far in (5, 3006, 6007):
        residuals[reading == far] = 8.0 / np.sqrt(widths[far])
    assert sorted(studentised(residuals, *rest).outliers) == [5, 3006, 6007]


def test_a_row_that_was_not_read_says_nothing_about_its_reading():
    columns, residuals = RNG.normal(size=(30, 3, 4)), RNG.normal(size=(30, 3))
    columns[7, 1], residuals[7, 1] = 0.0, 0.0
    widths = np.full(30, 3)
    widths[7] = 2
    root = np.linalg.inv(np.linalg.qr(columns.reshape(-1, 4), mode="r"))
    test = of_equal_readings(residuals, columns, root, widths, 85.0, scale=1.0)
    h = columns[7][[0, 2]] @ root @ root.T @ columns[7][[0, 2]].T
    r = residuals[7][[0, 2]]
    assert test.ratio[7] ** 2 == pytest.approx(r @ np.linalg.solve(np.eye(2) - h, r))
    assert test.leverage[7] == pytest.approx(np.trace(h) / 2)


def test_leverages_add_up_to_the_effective_parameters(arm):
    fit = calib.fit(arm, with_errors(arm, [], 0.0))
    assert 3 * np.sum(studentise_errors(fit).leverage) == pytest.approx(fit.statistics.effective_parameters)


@pytest.mark.parametrize("loss", ["none", "huber"])
def test_weights_of_outliers_are_those_by_the_linear_fit_without_them(arm, loss):
    wrong = np.array([3, 40, 60, 79])
    fit = calib.fit(arm, with_errors(arm, wrong, [1e-3, 0, 0]), loss=loss)
    weights = fit.weights.copy()
    weights[wrong] = 0.0
    columns, residuals = fit.rows.jacobian.reshape(80, 3, -1), fit.rows.residuals.reshape(80, 3)
    covariance = np.linalg.inv(np.einsum("n,nki,nkj->ij", weights, columns, columns))
    residuals = residuals - columns @ (covariance @ np.einsum("n,nki,nk->i", weights, columns, residuals))
    shared = columns @ covariance @ columns.transpose(0, 2, 1)
    spread = np.eye(3) + (1.0 - 2.0 * weights)[:, None, None] * shared
    squares = np.einsum("ni,ni->n", residuals, np.linalg.solve(spread, residuals[:, :, None])[:, :, 0])
    scale = np.median(np.sqrt(squares / chi2.median(3)))
    limit = 3 * f.isf(0.01 / 80, 3, fit.statistics.freedom / 2)
    bounded = bounded_weights(fit)
    np.testing.assert_allclose(bounded[wrong], limit * scale**2 / squares[wrong], rtol=1e-6)
    np.testing.assert_array_equal(np.delete(bounded, wrong), np.delete(fit.weights, wrong))


@pytest.mark.parametrize("size", [5e-4, 5e-3])
def test_gross_errors_are_named_with_row_and_pose(arm, size):
    fit = calib.fit(arm, with_errors(arm, [12, 55], [0, 0, size]))
    assert {outlier.pose for outlier in fit.outliers} >= {12, 55}
    assert fit.outliers[0].label in ("row 12", "row 55")
    assert fit.outliers[0].target == "ball"
    assert "times the error expected there" in str(fit.outliers[0])
    assert (len(fit.identification.data), fit.excluded) == (80, ())  # nobody asked to leave them out


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
    nothing_to_exclude = calib.fit(arm, with_errors(arm, [], 0.0), exclude_outliers=True)
    assert (nothing_to_exclude.excluded, nothing_to_exclude.with_all) == ((), None)


def test_a_point_that_decides_its_own_prediction_is_no_outlier():
    # the last column is seen by one point only, so that its residual along it is zero whatever was measured
    columns = RNG.normal(size=(15, 3, 3))
    columns[..., 2] = 0.0
    columns[6] = np.diag([1e4, 1e4, 1e4])
    residuals = RNG.normal(size=(15, 3))
    residuals[6] = 1e-9
    root = np.linalg.inv(np.linalg.qr(columns.reshape(45, 3), mode="r"))
    test = of_equal_readings(residuals, columns, root, np.full(15, 3), 42.0)
    assert test.leverage[6] > 0.99
    assert test.p_value[6] == 1.0


def test_a_bad_validation_pose_is_named(arm):
    validation = with_errors(arm, [5], [0, 1e-3, 0], n=20, seed=8)
    fit = calib.fit(arm, with_errors(arm, [], 0.0), validation=validation)
    assert [outlier.pose for outlier in fit.validation_outliers] == [5]
    assert fit.outliers == ()


def test_a_target_of_several_is_named(tmp_path):
    yaml = ARM_YAML.partition("parametrisation:")[0] + """\
  side: {frame: hand, xyz: [0, 50 mm, 0]}
parametrisation:
  - {origin: turn, components: [x, y, z], sigma: 2 mm}
  - {origin: flange, components: [x, y], sigma: 2 mm}
"""  # fmt: skip
    robot = calib.load(write_arm(tmp_path, yaml))
    q = np.random.default_rng(0).uniform([-2, 0, -2], [2, 1, 2], (30, 3))
    positions = robot.positions(q) + SIGMA * np.random.default_rng(1).standard_normal((30, 2, 3))
    positions[9, 1, 0] += 1e-3
    fit = calib.fit(robot, measurements(robot, q, positions), exclude_outliers=True)
    assert [(outlier.pose, outlier.target) for outlier in fit.with_all.outliers] == [(9, "side")]
    assert [(outlier.pose, outlier.target, outlier.n_together) for outlier in fit.excluded] == [(9, "side", 0)]
    seen = {name: readings.visits.tolist() for name, readings in fit.identification.data.readings.items()}
    assert seen == {"tip": list(range(30)), "side": [k for k in range(30) if k != 9]}
    positions[9, 0, 0] += 1e-3  # now both are off by the same: the pose is wrong
    fit = calib.fit(robot, measurements(robot, q, positions), exclude_outliers=True)
    assert {(outlier.pose, outlier.n_together) for outlier in fit.excluded} == {(9, 2)}
    assert len(fit.identification.data) == 29


@pytest.fixture(scope="module")
def photographed(tmp_path_factory):
    """An arm and photographs of it, 0.3 px of noise: three corners off by 6 px, and one photograph of another pose."""
    arm = calib.load(write_six_axis(tmp_path_factory.mktemp("photographs"), pixel.YAML))
    q, (camera, body) = joints(30, 5), pixel.places(4)
    seen = pixel.photographs(arm.with_parameters(pixel.TRUTH), q, camera, body)
    data = pixel.data_of(arm, q, seen, sigma=0.3, seed=1)
    readings = data.readings["eye"]
    values, whole = readings.values.copy(), np.flatnonzero(readings.visits == 7)
    values[[20, 80, 120]] += [[6.0, 0.0], [0.0, -6.0], [-4.0, 4.0]]
    values[whole] += [5.0, 3.0]
    order = np.random.default_rng(3).permutation(len(values))  # as a file may have them
    readings = Readings(readings.visits[order], readings.pairs[order], values[order], None, readings.details[order])
    names = {"corners": np.flatnonzero(np.isin(order, [20, 80, 120])), "image": np.flatnonzero(np.isin(order, whole))}
    return arm, replace(data, readings={"eye": readings}), names


@pytest.mark.quick(0)
def test_a_corner_goes_by_itself_and_an_image_that_is_off_as_a_whole(photographed):
    arm, data, off = photographed
    fit = calib.fit(arm, data, exclude_outliers=True)
    alone = {outlier.reading for outlier in fit.excluded if not outlier.n_together}
    assert alone >= set(off["corners"])
    assert len(alone) <= 5  # chance may name others
    together = {(outlier.pose, outlier.n_together) for outlier in fit.excluded if outlier.n_together}
    assert together == {(7, len(off["image"]))}
    kept = np.setdiff1d(np.arange(data.n_readings), [*alone, *off["image"]])
    again = calib.fit(arm, data.with_readings({"eye": kept}))
    np.testing.assert_array_equal(fit.robot.values, again.robot.values)
    words = " ".join(fit.report().split())
    assert f"Outliers left out ({data.n_readings - len(kept)} of {data.n_readings} readings)" in words
    assert f"pose {data.names[7]}, all {len(off['image'])} readings together, such as eye p" in words
    assert not any(reason.grade == "CHECK" for reason in fit.verdict.reasons)


@pytest.mark.quick(0)
def test_a_folder_says_which_reading_of_a_photograph_is_off(photographed, tmp_path):
    arm, data, off = photographed
    fit = calib.fit(arm, data)
    fit.save(str(tmp_path / "out"))
    rows = json.loads((tmp_path / "out" / "result.json").read_text())["outliers"]
    lines = (tmp_path / "out" / "residuals.csv").read_text().splitlines()
    for row, outlier in zip(rows, fit.outliers, strict=True):
        point = int(data.readings["eye"].details[outlier.reading, 0])
        assert row["looked_at"] == f"p{point}"
        assert lines[row["row"]].split(",")[:4] == ["identification", row["pose"], "eye", f"p{point}"]
    (own,), (told,) = reading_errors_of_fit(fit), reading_errors_of_fit(calib.load_result(tmp_path / "out").fit)
    assert own.outlier.sum() == len(fit.outliers) >= 3 + len(off["image"])

    def marked(table):
        return sorted((table.labels[k], table.targets[k]) for k in np.flatnonzero(table.outlier))

    assert marked(told) == marked(own)


@pytest.mark.quick(0)
def test_a_folder_has_the_readings_that_were_left_out_too(photographed, tmp_path):
    arm, data, _ = photographed
    fit = calib.fit(arm, data, exclude_outliers=True)
    fit.save(str(tmp_path / "out"))
    table = read_table(tmp_path / "out" / "residuals.csv")
    used = fit.identification.data.n_readings
    assert table.text("set") == ["identification"] * used + ["left out"] * (data.n_readings - used)
    readings = data.readings["eye"]
    names = [(data.names[visit], f"p{int(point)}") for visit, (point,) in
             zip(readings.visits, readings.details, strict=True)]  # fmt: skip
    rows = [names.index(name) for name in zip(table.text("pose"), table.text("looked_at_point"), strict=True)]
    assert sorted(rows) == list(range(data.n_readings))
    pixels = np.stack([table.column(f"measured_{axis}", "pixel") for axis in "uv"], 1)
    np.testing.assert_allclose(pixels, readings.values[rows], rtol=0, atol=1e-9)
    errors = np.stack([table.column(f"error_after_{axis}", "pixel") for axis in "uv"], 1)
    assert np.abs(errors[used:]).max() > 5.0 > np.abs(errors[:used]).max()
    assert table.text("weight")[used:] == [""] * (data.n_readings - used)
    again = calib.load_result(tmp_path / "out").fit
    assert again.identification.data.n_readings == used
    assert again.excluded == fit.excluded


@pytest.mark.quick(0)
def test_so_many_single_readings_cannot_be_outliers(photographed):
    arm, data, _ = photographed
    readings, rng = data.readings["eye"], np.random.default_rng(1)
    chosen = rng.choice(len(readings), len(readings) // 6, replace=False)
    values = readings.values.copy()
    values[chosen] += rng.choice([-8.0, 8.0], (len(chosen), 2))
    fit = calib.fit(arm, replace(data, readings={"eye": replace(readings, values=values)}), exclude_outliers=True)
    texts = [reason.text for reason in fit.verdict.reasons if reason.code == "many_excluded"]
    assert len(texts) == 1
    assert f"of {data.n_readings} readings were excluded: so many cannot be outliers" in texts[0]


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
