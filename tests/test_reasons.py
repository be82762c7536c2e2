"""Reasons of the verdict that no other file holds, each made true and made false; and that none is without a test."""

import dataclasses
import re
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest
from six_axis_arm import FREE, YAML, joints, measurements, noisy, six_axis_arm, write_six_axis
from small_robots import write_parallelogram

import calib
from calib.judging import rules_data, rules_model
from calib.judging.reasons import Code
from calib.judging.verdict import judge

ROOT = Path(__file__).resolve().parents[1]
SIGMA = 4e-5


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    arm = six_axis_arm(tmp_path_factory.mktemp("arm"))
    away = np.where(arm.is_free, [parameter.sigma_si for parameter in arm.parameters], 0.0) * 0.5
    true = arm.with_parameters(arm.values + away * np.random.default_rng(6).standard_normal(len(away)))
    return calib.fit(arm, noisy(true, joints(80), SIGMA, 1), sigma=SIGMA)


def told(rule, fit):
    return {reason.code: reason.text for reason in rule(fit)}


def test_a_fit_that_explains_the_poses_used_worse_than_the_nominal_robot_fails(good):
    assert told(rules_model.residuals_grew, good) == {}
    errors = good.identification
    worse = dataclasses.replace(errors, after={name: 2.0 * item for name, item in errors.before.items()})
    text = told(rules_model.residuals_grew, dataclasses.replace(good, identification=worse))["residuals_grew"]
    assert text.startswith("errors at the poses used are 2.00 times those of the nominal robot")


def test_instruments_that_contradict_each_other_are_named(tmp_path):
    """A ball bar measured another robot, the nominal one; the tracker, which is better, wins."""
    yaml = f"{YAML}{FREE}instruments:\n  ball: {{kind: position, sigma: 0.02 mm}}\n"
    yaml += "  bar: {kind: distance, target: ball, sigma: 0.2 mm, end: {frame: l0, xyz: [1, 0.5, 0]}}\n"
    arm = calib.load(write_six_axis(tmp_path, yaml))
    rng, q = np.random.default_rng(2), joints(80)
    away = np.where(arm.is_free, [parameter.sigma_si for parameter in arm.parameters], 0.0) * 0.5
    true = arm.with_parameters(arm.values + away * rng.standard_normal(len(away)))
    for barred in (true, arm):
        points = true.positions(q)[:, 0] + 2e-5 * rng.standard_normal((80, 3))
        lengths = np.linalg.norm(barred.positions(q)[:, 0] - [1, 0.5, 0], axis=1) + 2e-4 * rng.standard_normal(80)
        head = [*(f"j{k} [rad]" for k in range(1, 7)), *(f"ball_{a} [m]" for a in "xyz"), "bar_distance [m]"]
        rows = np.column_stack([q, points, lengths])
        text = "\n".join([",".join(head), *(",".join(map(repr, map(float, row))) for row in rows)])
        (tmp_path / "data.csv").write_text(text + "\n")
        fit = calib.fit(arm, calib.read_measurements(tmp_path / "data.csv", arm))
        codes = told(rules_model.residuals_grew, fit)
        if barred is true:
            assert codes == {}
        else:
            assert codes["instruments_disagree"].startswith("readings of bar, distance, fit worse than before")


def test_targets_that_were_computed_from_one_pose_are_told(tmp_path):
    yaml = YAML.replace("  ball:", "  other: {frame: l6, xyz: [0, -40 mm, 90 mm]}\n  ball:") + FREE
    arm = calib.load(write_six_axis(tmp_path, yaml))
    q, rng = joints(60), np.random.default_rng(3)
    of_pose, of_reading = 2e-4 * rng.standard_normal((60, 1, 3)), 2e-4 * rng.standard_normal((60, 2, 3))
    computed = calib.fit(arm, measurements(arm, q, arm.positions(q) + of_pose))
    text = told(rules_data.moves_as_one, computed)["moves_as_one"]
    assert text.startswith("the distances between targets other, ball are the same at every pose")
    assert "these targets were computed from one measured pose" in text
    assert told(rules_data.moves_as_one, calib.fit(arm, measurements(arm, q, arm.positions(q) + of_reading))) == {}


def test_a_robot_that_no_longer_closes_fails(tmp_path):
    robot = calib.load(write_parallelogram(tmp_path))
    q = robot.sample(30, seed=1)
    data = calib.simulate(robot, q, sigma=SIGMA, seed=2)
    fit = calib.fit(robot, data)
    assert told(rules_model.not_assembled, fit) == {}
    length = next(
        parameter
        for parameter in robot.parameters
        if parameter.name.endswith(".x") and abs(parameter.nominal_si) > 0.05
    )
    torn = fit.robot.with_parameters({length.name: 5.0})
    codes = told(rules_model.not_assembled, dataclasses.replace(fit, robot=torn))
    assert "cannot be assembled from its home configuration" in codes["not_assembled"]


def test_a_column_that_is_a_copy_fails(good):
    arm, data = good.nominal, good.identification.data
    assert told(rules_data.dead_readings, good) == {}
    copied = calib.fit(arm, calib.as_measurements(arm, data, data.points(arm)[..., [0, 0, 2]]))
    assert "equal_columns" in told(rules_data.dead_readings, copied)


def nothing_that_works(fit):
    raise KeyError("no such thing")


def no_reasons(fit):
    yield "it is warm"


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ("test_reasons:nothing_that_works", "KeyError: 'no such thing'; mend or uninstall the package"),
        ("test_reasons:not_there", "AttributeError"),
        ("test_reasons:no_reasons", "yields something else than calib.judging.reasons.Reason"),
    ],
)
def test_a_rule_of_another_package_that_does_not_work_is_named(good, monkeypatch, value, said):
    other = EntryPoint("warmth", value, "calib.reasons")
    monkeypatch.setattr("calib.judging.verdict.entry_points", lambda group: [other] if group == other.group else [])
    with pytest.raises(calib.InputError, match=re.escape(said)) as result:
        judge(dataclasses.replace(good, seconds=0.0))
    assert str(result.value).startswith(f"reason 'warmth' of the verdict ({value}): ")


def test_every_reason_has_a_test_and_a_row_of_the_page():
    """A code stands in some test file by name, and the page of failures says what to do."""
    page = (ROOT / "docs" / "howto" / "when_it_fails.md").read_text(encoding="utf-8")
    rows = re.findall(r'^\| <a id="(\w+)"></a>\*\*\1\*\*: .+ \| .+ \|$', page, re.MULTILINE)
    assert sorted(rows) == sorted(code.value for code in Code)
    texts = [path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob("test_*.py")]
    for code in Code:
        assert any(f'"{code}"' in text or f"'{code}'" in text for text in texts), f"no test names {code}"


@pytest.mark.parametrize("away", [0.0, 7e-5])
def test_few_poses_show_a_gain_by_the_noise_that_is_stated(tmp_path, away):
    """What few poses leave is no measure of chance: by that alone, origins that are 0.07 mm off each would be noise."""
    (tmp_path / "arm.urdf").write_bytes((ROOT / "docs" / "examples" / "arm.urdf").read_bytes())
    (tmp_path / "arm.yaml").write_text(
        "urdf: arm.urdf\nname_mot: [joint_1, joint_2, joint_3, joint_4, joint_5, joint_6]\nbase: {frame: base_link}\n"
        "targets: {tip: {frame: flange}}\nparametrisation: [{origin: all, components: [x, z], sigma: 1 mm}]\n"
        "sigma: 0.05 mm\n"
    )
    arm, rng = calib.load(tmp_path / "arm.yaml"), np.random.default_rng(3)
    true = arm.with_parameters(arm.values + away * arm.is_free)
    q = rng.uniform(-1, 1, (4, 6))
    fit = calib.fit(arm, calib.as_measurements(arm, q, true.positions(q)[:, 0] + 5e-5 * rng.standard_normal((4, 3))))
    assert fit.statistics.freedom < 4
    assert ("nothing_to_correct" in told(rules_model.nothing_to_correct, fit)) == (away == 0.0)
