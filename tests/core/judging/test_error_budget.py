"""The error budget against robots whose causes are known: closed forms, and all orders of all causes."""

import json
import re
from itertools import combinations
from math import factorial

import numpy as np
import pytest

import calib
from calib.core.base.words import as_data
from calib.core.data.measurements import with_points
from calib.core.judging.error_budget import GEOMETRY, NOISE, PLACES, REST, UNEXPLAINED, _basis, causes_of
from calib.core.judging.findings import joint_budget
from calib.core.results.report_text import text_report
from calib.core.results.results import to_dict
from calib.core.results.sections.budget import budget_table
from calib.core.rows.observed import observe
from tests.small_robots import ARM_YAML, write_arm

SIGMA = 20e-6
TERMS = """\
  - {joint: turn, term: gain, sigma: 2 mrad}
  - {joint: wrist, term: harmonics, orders: [3], sigma: 1 mrad}
  - {joint: turn, term: curve, orders: 3, sigma: 1 mrad, found: false}
  - {joint: slide, term: backlash, sigma: 0.2 mm}
"""
HELD = "flange.rz, turn.rz, wrist.z, flange.rx, flange.ry, wrist.ry, wrist.rz, slide.z, flange.y, wrist.x, wrist.y"
GAIN, CURVES, BACKLASH = "gain and harmonics", "joint curves", "backlash"
CAUSES = (GEOMETRY, GAIN, CURVES, BACKLASH)


def arm(folder, terms=TERMS, yaml=ARM_YAML, sigma="20 um"):
    return calib.load(write_arm(folder, yaml + terms + (f"sigma: {sigma}\n" if sigma else "")))


def measured(robot, n, seed, sigma=SIGMA, repeats=1):
    """Readings of a simulated robot at random poses, each read so often."""
    generator = np.random.default_rng(seed)
    q = np.repeat(generator.uniform([-1.5, 0, -1.5], [1.5, 0.5, 1.5], (n, 3)), repeats, axis=0)
    names = [f"P{k // repeats}" for k in range(len(q))]
    blank = calib.as_measurements(robot, q, np.zeros((len(q), 1, 3)), names=names)
    points = errors_of(robot, blank) + sigma * generator.normal(size=(len(q), 3))
    return calib.as_measurements(robot, q, points[:, None, :], names=names)


def errors_of(robot, data):
    """Predicted minus read, (n, 3)."""
    at = robot.assemble(data.joints, context=data.conditions)
    return observe(robot, at, data.readings)["tip"].residuals


def by_all_orders(before, after, data, members):
    """Shapley values of the causes: what each brings, in the mean over all orders in which they can be added."""
    k, brings = len(members), {}
    for size in range(k + 1):
        for chosen in combinations(range(k), size):
            values = before.values.copy()
            for row in chosen:
                values[members[row]] = after.values[members[row]]
            e = errors_of(before.with_parameters(values), data)
            brings[frozenset(chosen)] = np.mean(np.sum(e**2, axis=1))
    result = np.zeros(k)
    for row in range(k):
        for chosen, left in brings.items():
            if row not in chosen:
                weight = factorial(len(chosen)) * factorial(k - len(chosen) - 1) / factorial(k)
                result[row] += weight * (left - brings[chosen | {row}])
    return result


@pytest.fixture(scope="module")
def mixed(tmp_path_factory):
    """A fit of a robot that is off in every way, and its truth."""
    nominal = arm(tmp_path_factory.mktemp("arm"))
    generator = np.random.default_rng(11)
    off = np.array([p.sigma_si * generator.normal() for p in nominal.parameters])
    truth = nominal.with_parameters(nominal.values + off)
    return calib.fit(nominal, measured(truth, 200, 1), validation=measured(truth, 300, 2)), truth


def shares(budget):
    return {share.cause: share for share in budget.shares}


def test_every_parameter_has_its_cause(mixed):
    by_name = dict(zip([p.name for p in mixed[0].nominal.parameters], causes_of(mixed[0].nominal), strict=True))
    assert by_name["wrist.rx"] == GEOMETRY
    assert by_name["turn.gain"] == by_name["wrist.sin3"] == GAIN
    assert by_name["slide.backlash"] == BACKLASH
    assert by_name["turn.curve_sin2"] == CURVES


def test_the_parts_add_up_and_are_those_of_all_orders(mixed):
    fit, _ = mixed
    budget, data = fit.budget, fit.validation.data
    assert budget.before == pytest.approx(np.mean(np.sum(errors_of(fit.nominal, data) ** 2, axis=1)), rel=1e-12)
    assert budget.after == pytest.approx(np.mean(np.sum(errors_of(fit.robot, data) ** 2, axis=1)), rel=1e-6)
    by_cause = {cause: np.array(causes_of(fit.nominal)) == cause for cause in CAUSES}
    others = (PLACES, NOISE, UNEXPLAINED, REST)
    joints = [share.cause for share in joint_budget(fit).shares if share.cause not in others]
    assert {"turn", "slide", "wrist"} <= set(joints)
    by_joint = {joint: np.array([name.startswith(f"{joint}.") for name in fit.free_names]) for joint in joints}
    for known, members in ((budget, by_cause), (joint_budget(fit), by_joint)):
        assert sum(share.mean_square for share in known.shares) == pytest.approx(known.before, rel=1e-12)
        expected = by_all_orders(fit.nominal, fit.robot, data, list(members.values()))
        results = [shares(known)[cause].mean_square for cause in members]
        np.testing.assert_allclose(results, expected, atol=2e-3 * known.before)  # errors are not quite linear


def test_the_parts_are_those_of_the_true_causes_within_their_uncertainty(mixed):
    fit, truth = mixed
    members = [np.array(causes_of(truth)) == cause for cause in CAUSES]
    expected = by_all_orders(fit.nominal, truth, fit.validation.data, members)
    for cause, value in zip(CAUSES, expected, strict=True):
        share = shares(fit.budget)[cause]
        assert abs(share.mean_square - value) < 4 * share.std + 2e-3 * fit.budget.before
        assert share.std < 0.3 * fit.budget.before
    left = shares(fit.budget)
    assert left[NOISE].mean_square == pytest.approx(3 * SIGMA**2, rel=1e-12)
    assert abs(left[UNEXPLAINED].mean_square) < 0.35 * 3 * SIGMA**2
    assert fit.budget.advice == "The rest is no larger than the stated noise; more modelling will not help"


def test_a_gain_alone_is_all_of_the_error_as_computed_by_hand(tmp_path):
    free = "parametrisation:\n  - {origin: turn, components: [z], sigma: 2 mm}\n"
    nominal = arm(tmp_path, "  - {joint: turn, term: gain}\n", ARM_YAML.partition("parametrisation:")[0] + free)
    truth = nominal.with_parameters({"turn.gain": 2e-3})
    fit = calib.fit(nominal, measured(truth, 60, 3), validation=measured(truth, 500, 4))
    data = fit.validation.data
    radius = np.linalg.norm(nominal.positions(data.joints)[:, 0, :2], axis=1)
    expected = np.mean((radius * 2e-3 * data.joints[:, 0]) ** 2)
    parts = shares(fit.budget)
    assert parts[GAIN].mean_square == pytest.approx(expected, rel=0.03)  # noise: 0.02 of 0.7 mm
    assert abs(parts[GEOMETRY].mean_square) < 0.01 * expected


@pytest.mark.quick(0)
def test_on_readings_that_were_used_noise_that_was_fitted_is_set_right(tmp_path):
    nominal = arm(tmp_path, "", ARM_YAML + f"priors: false\nheld: [{HELD}]\n")
    geometry, left = [], []
    for seed in range(30):  # nothing is wrong with this robot
        fit = calib.fit(nominal, measured(nominal, 15, seed))
        parts = shares(fit.budget)
        geometry.append(parts[GEOMETRY].mean_square / (3 * SIGMA**2))
        left.append(fit.budget.after / (3 * SIGMA**2))
        assert fit.budget.used
    fitted = int(np.sum(fit.free)) / 45
    assert fitted > 0.2  # without setting right, geometry would seem to explain as much
    assert abs(np.mean(geometry)) < 0.05
    assert np.mean(left) == pytest.approx(1.0, abs=0.06)


@pytest.mark.parametrize("stated", [True, False])
@pytest.mark.parametrize("repeats", [1, 3])
def test_the_advice_is_only_as_sure_as_the_noise_is_known(tmp_path, stated, repeats):
    nominal = arm(tmp_path, "", sigma="20 um" if stated else "")
    truth = nominal.with_parameters({"slide.y": 1e-3, "wrist.rx": 2e-3})
    fit = calib.fit(nominal, measured(truth, 80, 5, repeats=repeats))
    parts = shares(fit.budget)
    if repeats == 1 and not stated:
        assert set(parts) == {GEOMETRY, REST}
        assert "Without the noise, it is unknown" in fit.budget.advice
        assert to_dict(fit)["error_budget"]["noise_from"] is None
    else:
        known = "repeatability" if repeats > 1 else "the stated noise"
        assert f"The rest is no larger than {known}" in fit.budget.advice
        assert parts[NOISE].mean_square == pytest.approx(3 * SIGMA**2, rel=0.2 if repeats > 1 else 1e-9)


def test_what_no_parameter_can_explain_is_found_as_such(tmp_path):
    truth = arm(tmp_path, "  - {joint: wrist, term: harmonics, orders: [7]}\n").with_parameters({"wrist.sin7": 2e-3})
    fit = calib.fit(arm(tmp_path, ""), measured(truth, 100, 6), validation=measured(truth, 200, 7))
    parts = shares(fit.budget)[UNEXPLAINED]
    assert parts.mean_square > 5 * parts.std
    assert parts.mean_square > 5 * shares(fit.budget)[NOISE].mean_square
    assert "more modelling may help" in fit.budget.advice


def test_a_few_large_errors_are_more_than_noise_however_uncertain_their_mean_is(tmp_path):
    robot = arm(tmp_path, terms="")
    data = measured(robot, 30, 31)
    points = data.points(robot).copy()
    points[0] += 0.02
    budget = calib.fit(robot, data, validation=with_points(robot, data, points)).budget
    beyond = shares(budget)[UNEXPLAINED]
    assert beyond.mean_square < 2 * beyond.std  # one pose has all of it
    assert budget.advice.startswith("The rest is larger than the stated noise")


def test_a_base_that_was_placed_before_explains_nothing_more(tmp_path):
    nominal = arm(tmp_path, "", ARM_YAML.replace("{frame: ground}", "{frame: ground, pose: unknown}"))
    truth = nominal.with_parameters({"base.x": 0.02, "base.rz": 0.3, "slide.y": 1e-3, "wrist.rx": 2e-3})
    fit = calib.fit(nominal, measured(truth, 80, 5))
    parts = shares(fit.budget)
    assert abs(parts[PLACES].mean_square) < 0.02 * fit.budget.before


def test_what_an_unknown_base_and_the_first_joint_share_does_not_move_the_split(tmp_path):
    unknown = ARM_YAML.replace("{frame: ground}", "{frame: ground, pose: unknown}")
    parts = []
    for held in ("", "held: [turn.x, turn.y, turn.z, turn.rx, turn.ry, turn.rz]\n"):  # the base can be in their place
        nominal = arm(tmp_path, "", unknown + held)
        truth = nominal.with_parameters({"turn.z": 3e-3, "turn.ry": 2e-3, "slide.y": 1e-3, "wrist.rx": 2e-3})
        fit = calib.fit(nominal, measured(truth, 100, 5), validation=measured(truth, 100, 6))
        result = shares(fit.budget)
        parts.append([result[GEOMETRY].mean_square, result[PLACES].mean_square, result[GEOMETRY].std])
    np.testing.assert_allclose(parts[0], parts[1], rtol=0.05, atol=0.01 * fit.budget.before)


def test_less_than_the_noise_is_left_where_too_much_was_stated(tmp_path):
    nominal = arm(tmp_path, "", sigma="80 um")  # four times as much as there is
    truth = nominal.with_parameters({"turn.z": 3e-3, "slide.y": 1e-3})
    fit = calib.fit(nominal, measured(truth, 60, 5))
    left = next(row for row in budget_table(fit)["causes"] if row["cause"] == UNEXPLAINED)
    assert left["remark"] == "none: the rest is below the noise"
    assert not re.search(r"not explained.*-0\.\d", fit.report(verbose=True))


def test_the_report_and_the_result_show_the_same_budget(mixed):
    fit, _ = mixed
    table = json.loads(json.dumps(to_dict(fit)))["error_budget"]
    assert table == as_data(budget_table(fit))
    assert (table["set"], table["unit"], table["n_readings"]) == ("validation", "mm", 300)
    assert sum(row["mean_square"] for row in table["causes"]) == pytest.approx(table["rms_before"] ** 2, rel=1e-9)
    for row in table["causes"]:
        seen = row["mean_square"] >= 0
        assert (row["share"] is not None) == (row["rms"] is not None) == (row["remark"] == "") == seen
        if seen:
            assert row["share"] == pytest.approx(row["mean_square"] / table["rms_before"] ** 2, rel=1e-9)
    errors = to_dict(fit)["errors"]["validation"]["before"]
    assert table["rms_before"] == pytest.approx(errors["rms"], rel=1e-9)
    text = text_report(fit, verbose=True)
    assert "Causes of the error before calibration (poses not used)" in text
    assert f"What is left: {fit.budget.advice}" in text
    for row in table["causes"]:
        assert row["cause"] in text


def test_columns_of_rounding_span_nothing():
    """Such as turns of a target, among the rows of where its point is: no direction may hang on their digits."""
    generator = np.random.default_rng(0)
    columns, rounding = generator.normal(size=(60, 4)), 1e-17 * generator.normal(size=(60, 3))
    spanned, alone = (_basis(some) for some in (np.hstack([columns, rounding]), columns))
    np.testing.assert_allclose(spanned @ spanned.T, alone @ alone.T, atol=1e-12)
    assert spanned.shape == (60, 4)
    assert [_basis(np.zeros((60, k))).shape for k in (2, 0)] == [(60, 0), (60, 0)]
