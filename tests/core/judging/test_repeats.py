"""Repeats of a pose: accuracy and repeatability by hand, about what the model predicts for each reading's joints."""

import re

import numpy as np
import pytest

import calib
from calib.core.fitting.error_sets import ErrorSet
from calib.core.judging.reasons import Code
from calib.core.judging.repeatability import (
    iso_figures,
    pose_error_over_repeatability,
    repeat_table,
    repeatability,
    scatter_within_poses,
)
from calib.core.results.results import to_dict
from tests.six_axis_arm import FREE, YAML, joints, write_six_axis


def errors_of(arm, names, before, after):
    """Errors [mm] of readings that repeat the poses of these names."""
    q = np.full((len(names), 6), 0.1)
    data = calib.as_measurements(arm, q, np.zeros((len(names), 3)), names)
    result = ({"ball": 1e-3 * np.array(errors, dtype=float)} for errors in (before, after))
    return ErrorSet(data, arm.instruments, *result, np.full(len(names), np.inf))


def test_accuracy_and_repeatability_by_hand(arm):
    after = np.array([[0, 0, 0], [2, 0, 0], [1, 0, 3], [7, 7, 7]])
    table = repeat_table(errors_of(arm, ["a", "a", "a", "b"], after + np.array([2, 4, -1]), after))
    lengths = np.array([np.sqrt(2), np.sqrt(2), 2.0])  # from the mean (1, 0, 1) mm
    assert (table["n_poses"], table["n_readings"]) == (1, 3)
    assert table["pose_repeatability"]["mean"] == pytest.approx(lengths.mean() + 3 * lengths.std(ddof=1))
    assert table["pose_accuracy"]["before"]["mean"] == pytest.approx(5.0)  # of (3, 4, 0) mm
    assert table["pose_accuracy"]["after"]["max"] == pytest.approx(np.sqrt(2))


def test_repeatability_pools_the_repeats_by_their_degrees_of_freedom(arm):
    generator = np.random.default_rng(3)
    names, errors, squares, freedom = [], [], 0.0, 0
    for name, count in (("a", 2), ("b", 5), ("c", 1), ("d", 3)):
        readings = generator.normal(0, 1, (count, 3))
        squares += ((readings - readings.mean(axis=0)) ** 2).sum()
        freedom += 3 * (count - 1)
        names += [name] * count
        errors += readings.tolist()
    std, result = repeatability(errors_of(arm, names, errors, errors))
    assert std == pytest.approx(1e-3 * np.sqrt(squares / freedom), rel=1e-12)
    assert result == freedom


def test_the_scatter_within_poses_counts_each_pose_of_each_target_once(tmp_path):
    """Two targets at two poses; the tool is read twice at the first, 2 mm apart, once without its z."""
    both = "targets:\n  tip: {frame: l6, xyz: [0 mm, 0 mm, 90 mm]}\n  ball"
    arm = calib.load(write_six_axis(tmp_path, YAML.replace("targets:\n  ball", both) + FREE))
    data = calib.as_measurements(arm, np.full((3, 6), 0.1), np.zeros((3, 2, 3)), ["a", "a", "b"])
    one = 1e-3 * np.array([[1.0, 0.0, np.nan], [-1.0, 0.0, 5.0], [9.0, 9.0, 9.0]])
    other = 1e-3 * np.array([[4.0, 1.0, 7.0], [4.0, -1.0, 7.0], [0.0, 0.0, 0.0]])
    errors = {"tip": one, "ball": other}
    found = scatter_within_poses(ErrorSet(data, arm.instruments, errors, errors, np.full(3, np.inf)))
    assert found == pytest.approx(1e-3 * np.sqrt((1.0 + 0.0 + 1.0 + 0.0) / 4))


def test_without_repeats_there_is_no_table_and_no_repeatability(arm):
    errors = errors_of(arm, ["a", "b"], np.ones((2, 3)), np.ones((2, 3)))
    assert repeat_table(errors) is None
    assert np.isnan(repeatability(errors)[0])
    assert repeatability(errors)[1] == 0
    ratio, chance = pose_error_over_repeatability(errors, 10)
    assert np.isnan(ratio)
    assert chance == 1.0


@pytest.mark.quick(0)
def test_the_means_of_poses_are_held_against_the_scatter_of_their_repeats(arm):
    """Analysis of variance: the ratio is an F of 3 n - n_eff and 3 n (m - 1) degrees of freedom."""
    generator = np.random.default_rng(5)
    names = np.repeat([f"p{k}" for k in range(40)], 4)
    ratios, chances = [], []
    for _ in range(200):
        noise = generator.normal(0, 0.05, (160, 3))
        ratio, chance = pose_error_over_repeatability(errors_of(arm, names, noise, noise), 0.0)
        ratios.append(ratio**2)
        chances.append(chance)
    assert np.mean(ratios) == pytest.approx(1.0, rel=0.05)
    assert np.mean(np.array(chances) < 0.1) == pytest.approx(0.1, abs=0.07)
    shifted = noise + np.repeat(generator.normal(0, 0.05, (40, 3)), 4, axis=0)
    ratio, chance = pose_error_over_repeatability(errors_of(arm, names, shifted, shifted), 0.0)
    assert ratio == pytest.approx(np.sqrt(1 + 4), rel=0.2)  # of a mean of four: 1/4 + 1 in place of 1/4
    assert chance < 1e-6


def test_repeats_weigh_and_the_noise_found_is_that_of_one_reading(shop):
    fit = shop.situation(Code.REPEATABILITY).gone
    assert fit.sigma == pytest.approx(5e-5, rel=0.15)  # standard error 3 %
    assert repeatability(fit.identification)[0] == pytest.approx(5e-5, rel=0.1)
    assert fit.statistics.freedom == pytest.approx(3 * 180 - 26)
    assert fit.statistics.shared_scatter is None
    assert (to_dict(fit)["n_poses"], to_dict(fit)["n_rows"], to_dict(fit)["n_readings"]) == (60, 180, 180)


def test_many_repeats_do_not_make_sure_of_what_the_model_leaves_out(shop):
    """Each pose is off by 0.05 mm that all its readings share: three of them tell hardly more than one."""
    arm, fit = shop.arm, shop.situation(Code.REPEATABILITY).there
    once = calib.fit(arm, fit.identification.data.subset(np.arange(0, 180, 3)))
    assert np.median(fit.statistics.std / once.statistics.std) > 0.8  # and not 1 / sqrt(3), 0.58
    error = np.abs(fit.robot.values - arm.values)[arm.is_free]
    assert np.mean(error <= fit.statistics.half_width) > 0.8


@pytest.mark.quick(0)
def test_accuracy_and_repeatability_of_validation_poses_are_told_too(shop):
    data = shop.situation(Code.REPEATABILITY).gone.identification.data
    fit = calib.fit(shop.arm, data.subset(np.arange(135)), validation=data.subset(np.arange(135, 180)))
    assert "ISO 9283-style, 15 poses not used" in fit.report(verbose=True)
    table = to_dict(fit)["repeats_validation"]
    assert table["n_readings"] == 45
    assert table["pose_accuracy"]["after"]["mean"] > to_dict(fit)["repeats"]["pose_accuracy"]["after"]["mean"]


@pytest.mark.quick(0)
def test_repeats_whose_encoders_differ_scatter_about_what_the_model_predicts(tmp_path):
    scatter = 4e-5
    yaml = f"priors: false\n{YAML}" + "  - {origin: j2, components: [x], sigma: 2 mm}\n"
    yaml = yaml.replace("frame: l0", "frame: l0, pose: unknown")  # the displacement is told in the tracker's frame
    robot = calib.load(write_six_axis(tmp_path, yaml))
    truth = robot.with_parameters({"base.x": 2.0, "base.rz": 2.2, "j2.x": 0.052})
    rng = np.random.default_rng(3)
    q = np.repeat(joints(50), 6, axis=0)
    q += rng.uniform(-8e-4, 8e-4, q.shape)
    positions = truth.positions(q)[:, 0] + scatter * rng.standard_normal((len(q), 3))
    data = calib.as_measurements(robot, q, positions, [f"p{k // 6}" for k in range(len(q))])
    fit = calib.fit(robot, data.subset(np.arange(240)), validation=data.subset(np.arange(240, 300)))
    # 200 degrees of freedom for each axis: 3 % standard error over the three
    assert repeatability(fit.identification)[0] == pytest.approx(scatter, rel=0.1)
    assert repeatability(fit.validation)[0] == pytest.approx(scatter, rel=0.2)
    # mean(l) + 3 std(l) of six readings: between 2 and 4.5 sigma for normal scatter
    assert to_dict(fit)["repeats"]["pose_repeatability"]["mean"] < 4.5e3 * scatter
    assert "repeatability" not in [reason.code for reason in fit.verdict.reasons]


def test_the_error_of_single_visits_is_told_beside_that_of_the_mean_of_repeats(truth):
    """The tool scatters by 0.1 mm along each axis from visit to visit; ten visits are read by an exact instrument."""
    generator, q = np.random.default_rng(6), np.repeat(joints(60), 10, axis=0)
    points = truth.positions(q)[:, 0] + generator.normal(0, 1e-4, (600, 3))
    fit = calib.fit(truth, calib.as_measurements(truth, q, points, np.repeat(np.arange(60), 10)))
    assert fit.verdict.claim.at_measured_poses.rms < 0.5e-4 * np.sqrt(3)
    (told,) = (line for line in fit.verdict.not_covered if line.startswith("scatter of repeats"))
    single = float(re.search(r"off by ([\d.]+) mm RMS", told)[1])
    assert single == pytest.approx(0.1 * np.sqrt(3), rel=0.1)
    once = calib.fit(truth, calib.as_measurements(truth, q[::10], points[::10]))
    assert not any(line.startswith("scatter of repeats") for line in once.verdict.not_covered)


def test_a_kind_that_shows_no_points_has_figures_without_distances(arm, monkeypatch):
    errors = errors_of(arm, ["a", "a", "b", "b"], np.zeros((4, 3)), [[0, 0, 0], [2, 0, 0], [1, 0, 3], [7, 7, 7]])
    monkeypatch.setattr(type(arm.instruments[0]), "points", lambda self, values: None)
    figures, _ = iso_figures(errors, np.random.default_rng(1))
    assert [figure.name for figure in figures] == ["AP", "RP", "AP", "RP"]
