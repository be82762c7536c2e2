"""The fit as a whole: noise stated or found, repeats, loss, folds, and what a failed one leaves behind."""

import json
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.core.fitting.fit import WarmStart, minimum_of
from calib.core.fitting.problem import Problem
from calib.core.fitting.settings import Settings
from calib.core.fitting.solved_fit import Convergence
from calib.core.fitting.solving import convergence_at, place, solve_from, uncertainty_at
from calib.core.fitting.terms.candidate_terms import missing_terms
from calib.core.numerics.size_search import variance_by_sizes
from calib.core.results.result_reading import load_result, read_content
from calib.core.results.results import save
from calib.core.robots.terms.terms import parse_terms
from tests.project import EXAMPLES
from tests.public_data import motoman
from tests.six_axis_arm import FREE, YAML, joints, measurements, noisy, write_six_axis

SIGMA = 4e-5


@pytest.fixture(scope="module")
def prior_arm(tmp_path_factory):
    return calib.load(write_six_axis(tmp_path_factory.mktemp("arm"), YAML + FREE))


@pytest.fixture(scope="module")
def good(arm):
    return calib.fit(arm, noisy(arm, joints(60), SIGMA, 1))


@pytest.fixture
def failed(good):
    return replace(good, convergence=Convergence(False, "the limit of evaluations was reached", 0.01, "j1.x", True))


@pytest.mark.quick(0)
def test_lengths_that_want_to_be_infinite_are_named_at_once_and_the_others_are_found_without_them(medrue):
    """20 poses behind each other, on which a link's arc explains the readings the better the more it is a line."""
    rows = np.arange(279, 299)
    data = calib.read_measurements(EXAMPLES / "medrue_simulated.csv", medrue).subset(rows)
    fit = calib.fit(medrue, data)
    assert not fit.converged
    assert fit.convergence.receding_parameters == ("L24", "C2z")
    assert "do not determine L24, C2z" in fit.report(verbose=True)
    assert "(--fix L24)" in fit.report(verbose=True)
    assert "base_elsewhere" not in fit.verdict.to_dict()["codes"]  # it stands where the description says
    assert calib.fit(medrue, data, fix=["L24"]).converged


@pytest.mark.parametrize(("off", "stopped"), [(0.0, True), (0.0, False), (0.5, True), (0.5, False)])
def test_the_message_says_what_the_step_that_is_left_says(arm, off, stopped):
    problem = Problem.from_data(arm, noisy(arm, joints(60), SIGMA, 1))
    solved = solve_from(problem, place(problem), Settings())
    _, _, uncertainty = uncertainty_at(solved)
    values = solved.evaluation.robot.values.copy()
    values[solved.problem.unknowns.index[0]] += off * uncertainty.std[0]
    at = problem.evaluate(solved.evaluation.robot.with_parameters(values))
    message = "the sum of squares no longer changes" if stopped else "the limit of evaluations was reached"
    ended = replace(solved, evaluation=at, solution=replace(solved.solution, converged=stopped, message=message))
    end = convergence_at(ended, problem.rows(at, solved.groups), uncertainty.std)
    assert end.converged is (off == 0.0)
    assert ("no parameter would still move by more than" in end.message) is (end.converged and not stopped)
    assert ("no longer changes, but " in end.message) is (stopped and not end.converged)
    assert ("limit" in end.message) is (not stopped and not end.converged)


@pytest.mark.parametrize("loss", ["none", "huber"])
def test_the_covariance_with_curves_is_that_of_all_coefficients(prior_arm, loss):
    """Dense algebra of every coefficient: there are more than rows, so that the readings show only some of them."""
    robot = prior_arm.with_terms(parse_terms("curve"))
    q = joints(30)
    fit = calib.fit(robot, noisy(prior_arm, q + 1e-3 * np.sin(2 * q), SIGMA, 1), loss=loss)
    rows, factors, family = fit.rows, fit.statistics.factors, fit.unknowns.family
    assert len(family) > 3 * len(rows.residuals)
    prior, of_rows = np.diag(1.0 * rows.prior.has), rows.jacobian.T @ rows.jacobian
    known = np.linalg.inv(factors.slope * of_rows + prior)
    whole = known @ (prior + (factors.slope * factors.effective[0]) ** 2 * of_rows) @ known
    whole += variance_by_sizes(known, family, rows.deviations)
    expected = fit.unknowns.scales * np.sqrt(np.diag(whole))
    assert fit.statistics.shared_scatter is None
    np.testing.assert_allclose(fit.statistics.std, expected, rtol=2e-3)


def test_without_priors_the_stated_noise_changes_no_parameter(arm):
    data = noisy(arm, joints(60), SIGMA, 1)
    fitted, stated = calib.fit(arm, data), calib.fit(arm, data, sigma=3e-4)
    np.testing.assert_allclose(fitted.robot.values, stated.robot.values, atol=1e-9)
    assert fitted.sigma == pytest.approx(stated.sigma)
    assert fitted.sigma_stated is None
    assert fitted.chi_square is None
    assert stated.chi_square.value == pytest.approx(154 * (stated.sigma / 3e-4) ** 2)


def test_with_priors_the_found_noise_is_that_which_weighed_them(prior_arm):
    values = prior_arm.values + np.random.default_rng(2).standard_normal(36) * prior_arm.parameters.sigma_si
    fit = calib.fit(prior_arm, noisy(prior_arm.with_parameters(values), joints(60), SIGMA, 1))
    assert fit.scales[0] == pytest.approx(fit.sigma, rel=0.01)
    assert fit.sigma == pytest.approx(SIGMA, rel=0.2)  # standard error 6 %
    assert 20 < fit.statistics.effective_parameters < 26.5
    assert fit.statistics.freedom == pytest.approx(180 - fit.statistics.effective_parameters)


def test_the_noise_of_a_weighted_mean_is_that_of_its_readings(arm):
    """Nine readings of a pose with the same mean and their own scatter say the same of the parameters."""
    q, data = joints(40), noisy(arm, joints(40), SIGMA, 1)
    once = data.points(arm)
    scatter = np.random.default_rng(3).standard_normal((8, 1, 3))
    scatter = np.concatenate([scatter, -scatter.sum(axis=0, keepdims=True)]) * SIGMA / 3
    repeated = np.concatenate([once[:3], once[3] + scatter, once[4:]])
    q_repeated = np.concatenate([q[:3], np.tile(q[3], (9, 1)), q[4:]])
    by_covariance = replace(data.readings["ball"], covariance=np.tile(1e-10 * np.eye(3), (40, 1, 1)))
    lighter = by_covariance.covariance.copy()
    lighter[3] /= 9
    fitted = calib.fit(arm, replace(data, readings={"ball": replace(by_covariance, covariance=lighter)}))
    nine = calib.fit(arm, measurements(arm, q_repeated, repeated))  # names differ: nine poses that look alike
    np.testing.assert_allclose(fitted.robot.values, nine.robot.values, atol=1e-8)
    assert nine.statistics.freedom == pytest.approx(fitted.statistics.freedom + 24)


def test_rotating_the_frame_of_a_robust_fit_changes_nothing(tmp_path):
    # the base is free, so turned measurements turn the base alone; a loss by coordinate would depend on the axes
    robot = calib.load(write_six_axis(tmp_path, YAML.replace("frame: l0", "frame: l0, pose: unknown") + FREE))
    q = joints(60)
    positions = robot.positions(q) + SIGMA * np.random.default_rng(1).standard_normal((60, 1, 3))
    positions[[4, 30]] += 2e-3
    turn = np.linalg.qr(np.random.default_rng(5).standard_normal((3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    fits = [
        calib.fit(robot, measurements(robot, q, p), loss="tukey", sigma=SIGMA) for p in (positions, positions @ turn.T)
    ]
    np.testing.assert_allclose(fits[0].weights, fits[1].weights, atol=1e-3)
    lengths = [np.linalg.norm(fit.identification.errors("after"), axis=1) for fit in fits]
    np.testing.assert_allclose(lengths[0], lengths[1], atol=1e-7)


def test_fits_are_repeatable_to_the_last_bit(arm):
    data = noisy(arm, joints(60), SIGMA, 1)
    a, b = (calib.fit(arm, data, loss="tukey", starts=3, folds=3, seed=5) for _ in range(2))
    np.testing.assert_array_equal(a.robot.values, b.robot.values)
    np.testing.assert_array_equal(a.folds.errors.errors("after"), b.folds.errors.errors("after"))


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ({"loss": "hubert"}, "loss 'hubert'; did you mean 'huber'"),
        ({"seed": -1}, "seed -1"),
        ({"starts": 0}, "starts 0"),
    ],
)
def test_options_without_a_meaning_are_refused(arm, option, message):
    with pytest.raises(calib.InputError, match=message):
        calib.fit(arm, noisy(arm, joints(60), SIGMA, 1), **option)


def test_a_failed_fit_leaves_no_calibrated_robot(failed, tmp_path):
    save(failed, tmp_path / "out")
    content = read_content(tmp_path / "out")
    assert content["verdict"]["grade"] == "FAIL"
    assert content["verdict"]["forced"] is False
    assert content["converged"] is False
    assert not (tmp_path / "out" / "calibrated.urdf").exists()
    with pytest.raises(calib.ComputationError, match="the fit failed and gives no calibrated robot"):
        load_result(tmp_path / "out", failed.nominal)
    seen = load_result(tmp_path / "out", failed.nominal, failed_too=True).robot  # to look at, in a viewer
    np.testing.assert_allclose(seen.values, failed.robot.values)


def test_an_old_calibrated_robot_does_not_stay_beside_a_failed_result(good, failed, tmp_path):
    save(good, tmp_path / "out", pages={"report.html": b"of the old fit"})
    (tmp_path / "out" / "notes.txt").write_text("mine")
    save(failed, tmp_path / "out")
    tables = {f"{name}.csv" for name in ("parameters", "covariance", "residuals")}
    others = {".written-by-calib.json", "result.json", "fit.npz", "notes.txt", "nominal.yaml", "nominal.urdf"}
    assert {path.name for path in (tmp_path / "out").iterdir()} == tables | others


@pytest.mark.quick(0)
def test_result_and_report_of_a_fit_that_was_asked_for_everything_have_what_the_verdict_rests_on(arm, tmp_path):
    q = joints(60)
    truth = arm.with_parameters({"j2.x": 0.053, "j3.rx": 0.004})
    data = noisy(truth, q, SIGMA, 1)
    positions = data.points(arm)
    positions[8] += 1e-3
    fit = calib.fit(
        arm, measurements(arm, q, positions), sigma=SIGMA, validation=noisy(truth, joints(20, 3), SIGMA, 2),
        loss="huber", exclude_outliers=True, starts=2, folds=3,
    )  # fmt: skip
    report = fit.report(verbose=True)
    for words in (
        "Verdict:",
        "left out in turn, after",
        "Robust loss huber",
        "2 starts",
        "Cross-validation in 3 folds",
    ):
        assert words in report
    save(fit, tmp_path / "out")
    content = json.loads((tmp_path / "out" / "result.json").read_text())
    assert content["verdict"]["grade"] in ("PASS", "CHECK")
    assert content["excluded"][0]["pose"] == "8"
    assert content["excluded"][0]["where"] == "row 8"
    assert content["with_excluded"]["n_poses"] == 60
    assert content["with_excluded"]["sigma"] > content["sigma"]
    assert content["chi_square"]["freedom"] == pytest.approx(content["degrees_of_freedom"])
    assert content["position_uncertainty"]["validation"]["max"] > 0
    assert set(content["errors"]) == {"identification", "validation", "cross_validation"}
    assert content["cross_validation"]["folds"] == 3
    assert content["starts"]["count"] == 2
    assert content["effective_parameters"] == pytest.approx(26)
    keys = {"kind", "name", "dimension", "p_value", "size", "amount", "significant", "detail"}
    assert set(content["patterns"][0]) == keys
    assert content["errors"]["validation"]["after"]["p95"] > content["errors"]["validation"]["after"]["median"]


@pytest.mark.quick(1)
@pytest.mark.parametrize("sigma", [1e-3, 4.26e-5, 7e-6, 1e-6])
def test_stating_a_small_noise_keeps_a_fit_of_real_measurements_converged(shared_data, sigma):
    robot, train, _ = motoman(shared_data / "motoman_right")
    fit = calib.fit(robot, train, sigma=sigma)
    assert fit.converged
    assert fit.convergence.step_left < 1e-3  # standard deviations; it stops at 1e-5 to 1e-8


def test_a_fit_that_needs_no_ranks_of_held_parameters_differentiates_by_the_free_ones_alone(robot, data):
    some = robot.with_terms(missing_terms(robot, parse_terms("gain"))).fix(*(p.name for p in robot.parameters[1:20:3]))
    nearby = [WarmStart(), WarmStart(free_alone=True)]
    ends = [minimum_of(some, Settings(), data, nearby=near).solved.evaluation for near in nearby]
    np.testing.assert_allclose(ends[1].robot.values, ends[0].robot.values, rtol=0.0, atol=1e-9)
    widths = [next(iter(end.observed.values())).derivative.shape[2] for end in ends]
    assert widths[0] - widths[1] == np.count_nonzero(~some.is_free)


def test_a_fit_keeps_no_derivative_but_that_of_its_rows(arm):
    """And, of few rows, their span; each takes a gigabyte of a million poses."""
    data = calib.simulate(arm, arm.sample(3000, seed=1), 4e-5, 2)
    calib.fit(arm, data)  # what is made once
    tracemalloc.start()
    made = calib.fit(arm, data)
    kept = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert kept < 2.7 * made.rows.jacobian.nbytes


def test_observability_copies_a_part_of_the_rows_at_a_time(arm):
    made = calib.fit(arm, calib.simulate(arm, arm.sample(6000, seed=1), 4e-5, 2), sigma=4e-5)
    tracemalloc.start()
    indices = made.observability
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2.0 * made.rows.jacobian.nbytes  # two copies of half of the rows, and their factors
    values = np.linalg.svd(4e-5 * made.rows.jacobian, compute_uv=False)
    assert indices["O3"] == pytest.approx(values[-1], rel=1e-6)
