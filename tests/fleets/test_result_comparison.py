"""`calib compare`: only what measurements tell apart is called a real difference."""

import json
import shutil

import numpy as np
import pytest
import scipy

import calib
from calib.fleets.comparing_results import difference_covariance, holm
from tests.saved_results import with_verdict
from tests.small_robots import ARM_YAML, write_arm

SIGMA = 3e-5


@pytest.fixture(scope="module")
def fits(robot, tmp_path_factory):
    """Result folders of one simulated robot measured twice, and once more after one of its joints was shifted."""
    generator = np.random.default_rng(3)
    sigma = np.array([0.0 if p.placement else p.sigma_si for p in robot.parameters])
    truth = robot.with_parameters(robot.values + sigma * generator.normal(size=len(sigma)))
    shifted = truth.with_parameters(truth.values + 1e-4 * np.array([p.name == "joint_3.z" for p in robot.parameters]))
    unseen = calib.sample(robot, 20, generator)
    held = [calib.simulate(robot_of_fit, unseen, SIGMA, seed=9) for robot_of_fit in (truth, truth, shifted)]
    folder = tmp_path_factory.mktemp("results")
    for name, item, check in zip(("before", "again", "shifted"), (truth, truth, shifted), held, strict=True):
        data = calib.simulate(item, calib.sample(robot, 50, generator), SIGMA, generator)
        calib.fit(robot, data, validation=check).save(folder / name, pages=False)
    return folder


def test_the_covariance_of_a_difference_is_that_of_two_estimators_with_one_prior():
    generator = np.random.default_rng(1)
    sigma, none = np.array([0.5, 2.0, 1.0]), 1e9  # the last has no prior
    precision = np.array([1 / 0.5**2, 1 / 2.0**2, 0.0])
    spread = np.diag(np.append(sigma[:2], none) ** 2)
    gains, covariances = [], []
    for n in (4, 7):
        jacobian = generator.normal(size=(n, 3))
        covariances.append(np.linalg.inv(jacobian.T @ jacobian + np.diag(precision)))
        gains.append((covariances[-1] @ jacobian.T, jacobian))
    (K_a, J_a), (K_b, J_b) = gains
    by_truth = K_a @ J_a - K_b @ J_b
    by_truth[:, 2] = 0.0  # without a prior the estimate follows x: K J has a column of the unit matrix
    np.testing.assert_allclose((K_a @ J_a)[:, 2], [0, 0, 1], atol=1e-12)
    expected = by_truth @ spread @ by_truth.T + K_a @ K_a.T + K_b @ K_b.T
    np.testing.assert_allclose(difference_covariance(*covariances, precision), expected, rtol=1e-9)


def test_holm_on_a_published_pattern():
    corrected = holm(np.array([0.01, 0.04, np.nan, 0.03, 0.005]))
    np.testing.assert_allclose(corrected, [0.03, 0.06, np.nan, 0.06, 0.02])
    assert np.all(np.isnan(holm(np.array([np.nan]))))


def test_the_shifted_joint_is_a_real_difference_and_nothing_is_between_two_measurements_of_one_robot(fits):
    comparison = calib.compare(fits / "before", fits / "again", fits / "shifted")
    by_name = {difference.name: difference for difference in comparison.differences}
    real = {name: difference.real for name, difference in by_name.items() if any(difference.real)}
    assert real["joint_3.z"] == (False, True)
    assert not any(again for again, _ in real.values())
    assert comparison.joint_p_values[0] > 0.01
    assert comparison.joint_p_values[1] < 1e-6
    rows = by_name["joint_3.z"].rows
    assert rows[2]["value"] - rows[0]["value"] == pytest.approx(0.1, abs=0.03)  # 4 sigma of the difference
    pairs = {pair.names: pair for pair in comparison.pairs}
    assert list(pairs) == [("before", "again"), ("before", "shifted"), ("again", "shifted")]
    assert ["joint_3.z" in pair.real for pair in pairs.values()] == [False, True, True]
    assert pairs["again", "shifted"].together < 1e-6
    assert np.all(np.isnan(by_name["joint_1.x"].p_values))  # no one sees it: the base takes it up


def test_all_parameters_together_differ_by_the_f_distribution_of_their_joint_square(fits):
    first, other = (calib.load_result(fits / name) for name in ("before", "again"))
    shown = [first.robot.parameters[name] for name in first.free_names]
    robot = [k for k, parameter in enumerate(shown) if not parameter.placement]
    precision = np.array([1.0 / p.sigma_si**2 if p.prior else 0.0 for p in shown])
    covariances = [result.uncertainty.covariance for result in (first, other)]
    both = difference_covariance(*covariances, precision)[np.ix_(robot, robot)]
    places = first.robot.parameters.places(first.free_names)
    change = (other.robot.values - first.robot.values)[places][robot]
    scale = np.sqrt(np.diag(sum(covariances))[robot])
    inverse, rank = scipy.linalg.pinv(both / np.outer(scale, scale), atol=1e-3, rtol=0, return_rank=True)
    square = (change / scale) @ inverse @ (change / scale)
    least = min(result.content["degrees_of_freedom"] for result in (first, other))
    expected = scipy.stats.f.sf(square / rank, rank, least)
    assert calib.compare(fits / "before", fits / "again").joint_p_values[0] == pytest.approx(expected, rel=1e-3)


def test_errors_are_on_the_same_rows_where_there_are_any(fits, tmp_path):
    same = calib.compare(fits / "before", fits / "again")
    result = json.loads((fits / "before" / "result.json").read_text())
    assert [each.on for each in same.results] == ["the same 20 readings not used"] * 2
    assert same.results[0].rms == pytest.approx(result["errors"]["validation"]["after"]["rms"])
    other = calib.compare(fits / "before", fits / "shifted")
    assert [each.on for each in other.results] == ["readings that it did not use"] * 2


def test_a_fit_without_other_poses_is_compared_by_poses_left_out(fits, robot, tmp_path):
    """Errors at the readings that it used are smaller; beside errors at other poses they would look better."""
    fit = calib.fit(robot, calib.simulate(robot, calib.sample(robot, 30, np.random.default_rng(5)), SIGMA, seed=6))
    fit.save(tmp_path / "alone", pages=False)
    compared = calib.compare(fits / "before", tmp_path / "alone")
    assert compared.results[1].on == "poses left out in turn"
    assert compared.results[1].rms == pytest.approx(1e3 * fit.verdict.claim.at_measured_poses.rms)
    assert compared.results[1].rms > 1e3 * fit.rms


def test_a_failed_fit_is_not_tested(fits, tmp_path):
    shutil.copytree(fits / "again", tmp_path / "failed")
    with_verdict(tmp_path / "failed", "FAIL", "not to be used")
    comparison = calib.compare(fits / "before", tmp_path / "failed")
    assert np.isnan(comparison.joint_p_values[0])
    assert "FAIL" in comparison.report()


@pytest.mark.quick(0)
def test_the_command_prints_one_short_table_and_writes_json_and_a_page(run_calib, fits, tmp_path):
    run = run_calib("compare", fits / "before", fits / "shifted")
    assert run.code == 0
    assert len(run.out.splitlines()) < 20
    answer, *_ = run.out.split("\n\n")
    assert "1 parameter of the robot differs, joint_3.z" in " ".join(answer.split())  # what was asked stands first
    table = json.loads(run_calib("compare", fits / "before", fits / "shifted", "--json", "-").out)
    page = tmp_path / "compared.html"
    assert run_calib("compare", fits / "before", fits / "again", "--html", page, "--quiet").code == 0
    assert "joint_3.z" in page.read_text()
    assert 'id="same-rows"' in page.read_text()
    rows = {row["name"]: row for row in table["parameters"]}
    assert (rows["joint_3.z"]["real"], rows["joint_1.x"]["p_values"]) == ([True], [None])


def test_bad_input_is_one_line(run_calib, fits, tmp_path):
    other = calib.load(write_arm(tmp_path, ARM_YAML + "sigma: 20 um\n"))
    q = np.random.default_rng(0).uniform([-1.5, 0, -1.5], [1.5, 0.5, 1.5], (30, 3))
    calib.fit(other, calib.simulate(other, q, 2e-5, 1)).save(tmp_path / "other", pages=False)
    for arguments, words in (
        ([fits / "before"], "1 result given; give two or more"),
        ([fits / "before", fits / "again", fits / "before"], "is given twice"),
        ([fits / "before", fits / "again", "--html", tmp_path / "no" / "x.html"], "no such file or directory"),
        ([fits / "before", tmp_path / "nowhere"], "holds no result"),
        ([fits / "before", tmp_path / "other"], "is the result of another robot"),
    ):
        assert words in run_calib("compare", *arguments).refusal()
