"""What robots of one model say of the next: the statistics against dense formulas, then results, files and fits."""

import json
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

import calib
from calib.cli import group
from calib.core.fitting.unseen_errors import left_out_ratio
from calib.core.judging import findings
from calib.core.numerics.prior import Prior
from calib.fleets.hierarchy import FleetEvidence, compare_with_fleet, evidence_of_data, learn, learn_without_odd
from tests.fleets import fleet_figures
from viz.comparison_page import side_by_side

N, R = 6, 7
NOISE = 3e-5  # of docs/examples/arm.yaml [m]


def told_exactly(u, sure=1e10):
    return FleetEvidence(sure * np.eye(len(u)), sure * u)


def test_mean_and_spread_of_robots_that_are_known_exactly():
    u = np.random.default_rng(0).standard_normal((R, N)) * [0.1, 0.1, 0.1, 0.4, 0.4, 0.4]
    learned = learn([told_exactly(values) for values in u], np.array([0, 0, 0, 1, 1, 1]))
    variance = learned.variance * (learned.freedom - 2) / learned.freedom
    precision = 1 + R / variance  # of a mean that is expected to be N(0, 1)
    np.testing.assert_allclose(learned.mean, u.sum(axis=0) / variance / precision, rtol=1e-3)
    np.testing.assert_allclose(np.diag(learned.covariance), 1 / precision, rtol=1e-3)
    typical = np.repeat([np.exp(np.mean(np.log(variance[:3]))), np.exp(np.mean(np.log(variance[3:])))], 3)
    squares = np.sum((u - learned.mean) ** 2, axis=0)
    np.testing.assert_allclose(variance, (4 * typical + squares) / (4 + R - R / variance / R / precision * R), rtol=0.1)


def test_given_the_spreads_mean_and_covariance_are_those_of_the_dense_normal_model():
    rng = np.random.default_rng(1)
    jacobians = [rng.standard_normal((4, N)) for _ in range(3)]  # each shows four directions of six
    data = [rng.standard_normal(4) for _ in jacobians]
    evidence = [FleetEvidence(j.T @ j, j.T @ y) for j, y in zip(jacobians, data, strict=True)]
    learned = learn(evidence, np.zeros(N, dtype=int))
    variance = learned.variance * (learned.freedom - 2) / learned.freedom
    blocks = [np.linalg.inv(j @ np.diag(variance) @ j.T + np.eye(4)) for j in jacobians]
    dense = np.linalg.inv(np.eye(N) + sum(j.T @ b @ j for j, b in zip(jacobians, blocks, strict=True)))
    np.testing.assert_allclose(learned.covariance, dense, rtol=2e-3, atol=1e-6)
    pulled = sum(j.T @ b @ y for j, b, y in zip(jacobians, blocks, data, strict=True))
    np.testing.assert_allclose(learned.mean, dense @ pulled, rtol=5e-3, atol=1e-4)


def test_what_the_data_say_alone_is_what_is_left_of_an_estimate_without_its_prior():
    rng = np.random.default_rng(2)
    j, y, mean = rng.standard_normal((4, N)), rng.standard_normal(4), rng.standard_normal(N)
    covariance = np.linalg.inv(j.T @ j + 2 * np.eye(N))
    estimate = covariance @ (j.T @ y + 2 * mean)
    result = evidence_of_data(covariance, estimate, 2 * np.eye(N), mean, 1e9)
    np.testing.assert_allclose(result.precision, j.T @ j, atol=1e-7)
    np.testing.assert_allclose(result.information_vector, j.T @ y, atol=1e-7)


def test_one_wrong_result_is_left_out_and_changes_nothing():
    u = 0.2 * np.random.default_rng(3).standard_normal((R, 12)) + 0.5
    wrong = np.vstack([u, u[0] + 3.0 * np.eye(12)[4]])  # fifteen spreads, in one parameter
    whole, odd, _ = learn_without_odd([told_exactly(values, 1e6) for values in wrong], np.zeros(12, dtype=int))
    assert odd == (R,)
    np.testing.assert_allclose(whole.mean, learn([told_exactly(o, 1e6) for o in u], np.zeros(12, dtype=int)).mean)
    assert learn_without_odd([told_exactly(values, 1e6) for values in u], np.zeros(12, dtype=int))[1] == ()


def test_the_mean_of_squares_of_students_t_is_judged_by_its_own_quantiles():
    count, freedom = 12, 7.0
    squares = np.random.default_rng(5).standard_t(freedom, (200_000, count)) ** 2 * (freedom - 2) / freedom
    for part in (0.5, 0.05, 0.01, 0.001):
        together = np.quantile(np.mean(squares, axis=1), 1 - part)
        told = FleetEvidence(1e12 * np.eye(count), 1e12 * np.sqrt(together) * np.ones(count))
        compared = compare_with_fleet(told, np.zeros(count), np.eye(count), np.full(count, freedom))
        assert 0.5 * part < compared.p_combined < 1.5 * part


def test_products_with_a_joint_prior_are_those_with_its_inverse_covariance():
    rng = np.random.default_rng(4)
    root = rng.standard_normal((3, 3))
    covariance = root @ root.T
    correlations = covariance / np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))
    prior = Prior(np.array([True, True, False, True, True]), np.array([1, 3, 4]), correlations)
    dense = np.zeros((5, 5))
    dense[0, 0] = 1.0
    dense[np.ix_([1, 3, 4], [1, 3, 4])] = np.linalg.inv(correlations)
    u = rng.standard_normal(5)
    np.testing.assert_allclose(prior.rows.T @ prior.rows, dense, atol=1e-9)
    np.testing.assert_allclose(prior.gradient(u), dense @ u)
    np.testing.assert_allclose(prior.add_to(np.eye(5)), np.eye(5) + dense)
    assert prior.cost(u) == pytest.approx(u @ dense @ u)
    np.testing.assert_allclose(prior.root @ prior.root.T, np.where(dense != 0, prior.root @ prior.root.T, 0.0))
    some = prior.select(np.array([True, True, True, False, True]))
    np.testing.assert_array_equal(some.together, [1, 3])
    np.testing.assert_array_equal(some.correlations, correlations[np.ix_([0, 2], [0, 2])])


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Four results, the first of another model, with the mean of the model and the random numbers behind them."""
    folder, rng = tmp_path_factory.mktemp("fleet"), np.random.default_rng(5)
    robot = calib.load(fleet_figures.ROBOT)
    mean = fleet_figures.made_up(robot, rng)
    return robot, folder, fleet_figures.results_of(robot, folder, 4, rng, mean, wrong=True), mean


def run(*arguments):
    return CliRunner().invoke(group, ["fleet", *map(str, arguments)])


def test_the_command_names_the_odd_one_and_writes_a_robot_that_few_poses_calibrate(results):
    robot, folder, folders, mean = results
    files = [folder / name for name in ("fleet.yaml", "fleet.html", "fleet.json")]
    done = run(*folders, "--out", files[0], "--html", files[1], "--json", files[2])
    assert done.exit_code == 0, done.output
    told = json.loads(files[2].read_text())
    assert [member["odd"] for member in told["robots"]] == [True, False, False, False]
    assert [robot["name"] for robot in told["robots"]] == ["robot_1", "robot_2", "robot_3", "robot_4"]
    assert [robot["folder"] for robot in told["robots"]] == [str(member) for member in folders]
    page = files[1].read_text().partition('<h2 id="provenance"')[0]
    assert str(folder) not in page
    assert "UNLIKE the others" in page
    assert all(p.name in page for p in robot.parameters if not p.placement)
    known, rng = calib.load(files[0]), np.random.default_rng(6)
    truth = fleet_figures.one_more(robot, mean, rng)
    data = calib.simulate(truth, robot.sample(5, rng), seed=rng)
    fit = calib.fit(known, data)
    far, _, held = fleet_figures.measures(fit, truth, robot.sample(50, rng))
    assert far < 0.5  # mm; nominal robots are off by several, and without the fleet there is no answer
    assert held > 0.8
    assert fit.nominal.description.fleet.unlike == ()
    check_minimum(fit, known, data)


def test_what_the_fleet_knows_of_the_noise_makes_no_pattern_of_it(tmp_path):
    """Good readings show a pattern in one of a hundred fits."""
    rng = np.random.default_rng(9)
    robot = fleet_figures.described(tmp_path, known=False)
    mean = fleet_figures.made_up(robot, rng)
    known = fleet_figures.knowing(robot, mean, fleet_figures.SPREAD)
    for _ in range(3):
        truth = fleet_figures.one_more(robot, mean, rng)
        fit = calib.fit(known, calib.simulate(truth, robot.sample(12, rng), seed=rng))
        assert "systematic" not in [reason.code for reason in fit.verdict.reasons]
        assert left_out_ratio(fit) < 2  # errors of left-out poses are as large as noise and covariance say
        j, effect = fit.rows.jacobian, rng.standard_normal((len(fit.rows.residuals), 1))
        left = effect - j @ np.linalg.solve(fit.rows.prior.add_to(j.T @ j), j.T @ effect)
        deviation = 1.0 / np.sqrt(np.sum(effect * left))  # rows have the noise 1, which the fleet has confirmed
        assert findings.linear(fit).sizes(effect)[1] == pytest.approx(deviation, rel=0.1)


def check_minimum(fit, known, data):
    """The fit is where readings and the joint normal prior of the file, multiplied, are most likely."""
    fleet = known.description.fleet
    spreads = np.array([float(parameter.spread) for parameter in fleet.parameters.values()])
    unsure = np.array([parameter.unsure for parameter in fleet.parameters.values()])
    inverse = np.linalg.inv(np.outer(spreads, spreads) * (np.eye(len(spreads)) + unsure @ unsure.T))
    place = [known.parameters.index(known.parameters[name]) for name in fleet.parameters]
    mean = np.array([known.parameters[k].nominal_si for k in place])
    mean += [float(parameter.offset) for parameter in fleet.parameters.values()]
    target = [(k, p) for k, p in enumerate(known.parameters) if p.placement and p.prior]
    read = data.readings["reflector"].values

    def cost(values):
        away = values[place] - mean
        residuals = known.with_parameters(values).positions(data.joints)[:, 0] - read
        of_target = sum(((values[k] - p.nominal_si) / p.sigma_si) ** 2 for k, p in target)
        return np.sum(residuals**2) / NOISE**2 + away @ inverse @ away + of_target

    least = cost(fit.robot.values)
    rng, std = np.random.default_rng(7), np.sqrt(np.diag(fit.statistics.covariance))
    for _ in range(5):
        step = np.zeros(len(known.parameters))
        step[fit.free] = 0.05 * std * rng.standard_normal(len(std))
        assert cost(fit.robot.values + step) > least


@pytest.mark.quick(0)
def test_the_answer_fits_on_a_screen_and_the_rest_comes_with_verbose(results):
    robot, _, folders, _ = results
    shown, everything = run(*folders).output, run(*folders, "--verbose").output
    assert "Uncertainty of means: counts noise and priors" in everything
    names = [p.name for p in robot.parameters if not p.placement]
    assert all(f"\n{name} " in everything for name in names)
    fleet = calib.fleet(*folders)
    away = np.abs(fleet.mean - fleet.nominal) / fleet.mean_std
    surest = {p.name for p in np.array(fleet.parameters, dtype=object)[np.argsort(-away)[:12]]}
    assert {name for name in names if f"\n{name} " in shown} == surest
    assert f"{len(names) - 12} more parameters differ less clearly from nominal: --verbose prints them" in shown
    many = replace(fleet, members=fleet.members[1:] * 8 + fleet.members[:1])  # the one that is unlike comes last
    assert len(many.report().splitlines()) <= 40
    assert f"{fleet.members[0].name} " in many.report()
    assert "13 more robots are more like the others" in many.report()
    assert len(many.report(verbose=True).splitlines()) > 60


def dict_of(robot):
    return dict(zip((p.name for p in robot.parameters), robot.values, strict=True))


def test_bad_input_is_one_line_that_says_what_to_do(results, tmp_path):
    _, folder, folders, _ = results
    first, second = folders[:2]
    for arguments, said in (
        ((first,), "1 result given; give those of two or more robots"),
        ((first, first), "is given twice"),
        ((first, folder / "arm.yaml"), "arm.yaml: holds no result"),
        ((first, folder / "nowhere"), "nowhere: holds no result"),
        ((first, second, "--out", tmp_path / "fleet.json"), "ends in .yaml"),
    ):
        done = run(*arguments)
        assert done.exit_code == 2
        assert said in done.output
    changed = shutil.copytree(second, tmp_path / "changed")
    assert "both are of one robot" in run(second, changed).output
    (changed / "nominal.urdf").write_bytes((changed / "nominal.urdf").read_bytes().replace(b"0.4", b"0.5"))
    assert "was changed after the fit" in run(first, changed).output
    mine = tmp_path / "mine.yaml"
    mine.write_text("mine: 1\n")
    assert run(first, second, "--out", mine).exit_code == 2
    assert mine.read_text() == "mine: 1\n"


def test_results_with_other_parameters_or_of_another_robot_are_refused(results, tmp_path):
    robot, _, folders, _ = results
    data = calib.simulate(robot, robot.sample(30, 1), seed=1)
    calib.fit(robot.fix("joint_4.z"), data).save(tmp_path / "held", pages=False)
    done = run(folders[1], tmp_path / "held")
    assert done.exit_code == 2
    assert "has no free parameter 'joint_4.z'" in done.output


@pytest.mark.quick(0)
def test_a_failed_result_that_was_forced_is_named(results, tmp_path):
    robot, _, folders, _ = results
    noisy = calib.simulate(robot, robot.sample(30, 2), sigma=2e-2, seed=2)  # m: no robot is that bad
    failed = calib.fit(robot, noisy.joints, noisy.readings["reflector"].values)
    assert failed.verdict.grade == "FAIL"
    failed.save(tmp_path / "failed", pages=False)
    assert run(*folders[1:3], tmp_path / "failed").exit_code == 3
    failed.save(tmp_path / "forced", pages=False, force=True)
    said = " ".join(run(*folders[1:3], tmp_path / "forced").output.split())
    assert "Verdict FAIL: forced; " in said.replace(f"{tmp_path.name}/", "")
    assert not any(note.startswith("Verdict") for note in calib.fleet(*folders[1:3]).notes)


@pytest.mark.quick(0)
def test_a_description_with_a_fleet_of_other_parameters_is_refused(results, tmp_path):
    _, _, folders, _ = results
    calib.fleet(*folders[1:3]).save(tmp_path / "fleet.yaml")
    text = (tmp_path / "fleet.yaml").read_text()
    for old, new, said in (
        ("    joint_2.x:", "    joint_2.w:", "fleet: no parameter 'joint_2.w'; 'joint_2' has joint_2.rx"),
        ("robots: 2", "robots: 1", "fleet.robots"),
        ("spread: ", "spread: -", "spread must be positive"),
    ):
        assert old in text
        (tmp_path / "bad.yaml").write_text(text.replace(old, new, 1))
        with pytest.raises(calib.DescriptionError, match=said):
            calib.load(tmp_path / "bad.yaml")


def test_the_page_draws_the_interval_of_every_robot_in_spreads_of_the_fleet(results):
    folders = results[2]
    fleet = calib.fleet(*folders)
    drawn = {}  # of each robot and parameter: left end, mark, right end
    for panel in side_by_side(fleet).panels:
        layers = [layer for layer in panel["layers"] if layer["kind"] in ("bars", "points")]
        for bars, points in zip(layers[::2], layers[1::2], strict=True):
            for text, *ends in zip(points["texts"], bars["left"], points["x"], bars["right"], strict=True):
                drawn[tuple(re.split(r"(?: \(unlike\))?, |: ", text)[:2])] = ends
    assert len(drawn) == len(folders) * len(fleet.parameters)
    for member, values, stds in zip(fleet.members, fleet.values, fleet.stds, strict=True):
        for k, parameter in enumerate(fleet.parameters):
            left, mark, right = drawn[member.name, parameter.name]
            assert mark == pytest.approx((values[k] - fleet.mean[k]) / fleet.spread[k], rel=1e-4, abs=1e-9)
            assert mark - left == pytest.approx(1.96 * stds[k] / fleet.spread[k], rel=1e-3)
            assert right - mark == pytest.approx(1.96 * stds[k] / fleet.spread[k], rel=1e-3)
