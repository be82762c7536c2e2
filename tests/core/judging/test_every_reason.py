"""Every reason of the verdict is said where it is true, with right numbers, and not where its cause is gone.

And copies of rows, rules of other packages, and the page of reasons.
"""

import dataclasses
import re
from importlib.metadata import EntryPoint
from types import SimpleNamespace

import numpy as np
import pytest

import calib
from calib.core.fitting.pose_checks import tied_joints
from calib.core.judging import rules_model
from calib.core.judging.next_step import next_step
from calib.core.judging.reasons import Code
from calib.core.judging.rules_data import copied_visits
from calib.core.judging.verdict import judge
from tests.core.judging.situations import GRADES, SIGMA, SITUATIONS, rms
from tests.project import EXAMPLES, ROOT
from tests.six_axis_arm import joints, measurements, noisy


def test_every_reason_has_a_situation_and_nothing_else_has():
    assert set(SITUATIONS) == set(Code)


@pytest.mark.parametrize("code", list(SITUATIONS), ids=str)
def test_a_reason_is_said_where_it_is_true_and_not_without_its_cause(shop, code):
    made = shop.situation(code)
    texts = [reason.text for reason in made.reasons(made.there) if reason.code == code]
    match = next(filter(None, (re.search(made.says, text) for text in texts)), None)
    assert match, made.reasons(made.there)
    assert [float(number) for number in match.groups()] == pytest.approx(list(made.numbers), rel=made.within), texts
    assert code not in [reason.code for reason in made.reasons(made.gone)], made.gone.verdict
    if made.rule is None:
        grades = [reason.grade for reason in made.there.verdict.reasons]
        assert grades == sorted(grades, key=["FAIL", "CHECK", "PASS"].index)
    if code in GRADES:
        (reason,) = (reason for reason in made.there.verdict.reasons if reason.code == code)
        assert (made.there.verdict.grade, reason.grade) == (GRADES[code], GRADES[code])
        assert GRADES[code] != "PASS" or (reason.counted and made.there.verdict.claim.holds)
        assert GRADES[code] != "FAIL" or made.there.verdict.claim is None  # such numbers must not be used


@pytest.mark.parametrize(
    ("code", "cause", "contradicted"),
    [
        ("beyond_curves", "worse_on_validation", "no_gain"),  # "no gain beyond the uncertainty" beside "worse"
        ("likely_mistake", "noise_as_large_as_robot", "systematic"),  # "the target sits 595 mm elsewhere on its link"
        ("equal_columns", "equal_columns", "instruments_disagree"),
        ("poses_equal", "poses_equal", "noise_as_large_as_robot"),
    ],
)
def test_no_reason_stands_beside_what_it_contradicts(shop, code, cause, contradicted):
    codes = shop.situation(Code(code)).there.verdict.to_dict()["codes"]
    assert cause in codes
    assert contradicted not in codes


CORRECT = "correct the data or the description as the reasons say, and fit again: calib fit ROBOT DATA"
POSES, HOLD_OUT, LEAVE_OUT = (
    "see what these poses do not determine, and measure others: calib check ROBOT DATA",
    "test the result on poses of the file that it is fitted to: calib fit ROBOT DATA --validate 0.25 --out DIR-2",
    "fit again without the outliers: calib fit ROBOT DATA --exclude-outliers --out DIR-2",
)
ANSWERS = {
    CORRECT: ("likely_mistake", "misread", "lengths_scaled", "equal_columns", "base_elsewhere", "copied", "no_noise",
              "zero_readings", "doubtful_readings", "noise_as_large_as_robot", "residuals_grew",
              "instruments_disagree", "turns_not_counted"),
    POSES: ("worse_on_validation", "no_gain", "other_minimum", "rank_unclear", "not_linear", "poses_equal"),
    HOLD_OUT: ("frame_moved", "used_for_both"),
    LEAVE_OUT: ("outliers", "blocks_disagree"),
}  # fmt: skip


@pytest.mark.parametrize(("code", "step"), [(code, step) for step, codes in ANSWERS.items() for code in codes])
def test_the_next_step_answers_the_reason(shop, code, step):
    """Outliers, terms and more poses are no answer to a mistake, that is to readings that mean something else."""
    said = str(next_step(shop.situation(Code(code)).there))
    assert said == step or (step == CORRECT and said.startswith(step))
    assert step != CORRECT or not re.search("--(exclude|terms|starts|validate)", said)


def codes_of(fit):
    return fit.verdict.to_dict()["codes"]


def test_readings_from_elsewhere_are_no_outliers_and_no_errors_of_the_robot(shop):
    moved = shop.situation(Code.FRAME_MOVED).there
    assert codes_of(moved) == ["frame_moved", "validation"]  # the base is called known, so that it is not placed anew
    assert not re.search("robot has errors|describes its own", str(moved.verdict))
    by_noise = shop.situation(Code.VALIDATION).there
    assert "There the robot has errors that the poses used do not show" in str(by_noise.verdict)


def test_poses_that_lie_close_together_do_not_show_that_a_frame_moved(shop):
    """What the robot does there, it does at all of them: here, two waves that the model does not have."""

    def measured(q, seed):
        off = q.copy()
        off[:, 1:3] += 5e-4 * np.sin(q[:, 1:3] * [2, 3])
        return measurements(shop.arm, q, noisy(shop.truth, off, SIGMA, seed).points(shop.arm))

    corner = 0.1 * joints(30, 5) + 0.5
    fit = calib.fit(shop.arm, measured(joints(80), 1), validation=measured(corner, 2))
    points = fit.validation.data.points(shop.arm)
    errors = (fit.robot.positions(corner) - points).reshape(-1, 3)
    assert rms(errors - errors.mean(axis=0)) < 0.3 * rms(errors)
    assert "frame_moved" not in codes_of(fit)


def test_noise_below_its_statement_leads_to_a_smaller_statement_and_not_to_joint_terms(shop):
    small, other = (noisy(shop.truth, q, size * SIGMA, 1) for q, size in ((joints(80), 0.3), (joints(30, 5), 2.0)))
    fit = calib.fit(shop.arm, small, sigma=SIGMA, validation=other)
    assert "noise found is only 0.27 times what was stated" in str(fit.verdict)
    assert str(next_step(fit)).startswith("state a smaller noise, or leave out what was read twice, and fit again: ")
    assert "noise" not in codes_of(calib.fit(shop.arm, small, validation=other))


def test_noise_that_no_robot_leaves_is_not_taken_apart(shop):
    """Joint 3 stands 30 mrad sin(3 q) off; half a milliradian of it is named (`SYSTEMATIC`)."""
    off = joints(80).copy()
    off[:, 2] += 0.03 * np.sin(3 * off[:, 2])
    data = measurements(shop.arm, joints(80), noisy(shop.truth, off, SIGMA, 1).points(shop.arm))
    fit = calib.fit(shop.arm, data, sigma=SIGMA)
    assert any(pattern.significant for pattern in fit.patterns)
    assert codes_of(fit) == ["noise"]
    assert next_step(fit).command == "calib fit ROBOT DATA --sigma-mm 0.04 --out DIR-2"


def test_where_one_reading_makes_such_noise_the_next_step_leaves_it_out(shop):
    points = shop.used.points(shop.arm).copy()
    points[17] *= 1.5
    fit = calib.fit(shop.arm, measurements(shop.arm, joints(80), points), sigma=SIGMA)
    assert fit.verdict.grade == "FAIL"
    assert codes_of(fit)[0] == "noise"
    assert next_step(fit).command == "calib fit ROBOT DATA --sigma-mm 0.04 --exclude-outliers --out DIR-2"


def test_what_was_tried_is_kept_and_not_offered_again(shop):
    """Neither outliers nor terms explain what depends on two joints."""
    there = shop.situation(Code.BLOCKS_DISAGREE).there
    fit = calib.fit(there.nominal, there.identification.data, terms="auto", exclude_outliers=True)
    assert "systematic" in codes_of(fit)
    again = "calib fit ROBOT DATA --terms auto --exclude-outliers --validate 0.25 --out DIR"
    assert next_step(fit).command == again
    many = next_step(shop.situation(Code.MANY_EXCLUDED).there)
    assert many.command == "calib fit ROBOT DATA --exclude-outliers --out DIR-2"
    assert many.aim.startswith("correct the data")


def with_copies(data, rows):
    return data.subset(np.concatenate([np.arange(len(data)), rows]))


def test_copies_are_named_whichever_of_them_are_held_out(arm):
    data = with_copies(noisy(arm, joints(63), SIGMA, 1), [7, 30])
    held_out = set()
    for seed in range(3):
        used, other = data.split(validation=0.25, seed=seed)
        held_out.add(len(other) - other.n_poses)
        verdict = calib.fit(arm, used, validation=other).verdict
        assert (verdict.grade, verdict.reasons[0].code) == ("CHECK", "copied")
        assert verdict.reasons[0].text.startswith("2 of 65 readings are copies")
    assert held_out > {0}  # of some, the fit has used fewer than three in a hundred


def test_one_copied_row_of_a_hundred_is_no_matter(arm):
    verdict = calib.fit(arm, with_copies(noisy(arm, joints(99), SIGMA, 1), [7])).verdict
    assert "copied" not in verdict.to_dict()["codes"]


@pytest.mark.parametrize(("step", "scatter"), [(1e-7, 2e-5), (1e-4, 2e-5), (1e-4, 1e-6)])
def test_honest_repeats_are_no_copies(arm, step, scatter):
    """Twenty poses, each read three times: in fine steps, in steps coarser than they scatter, and without scatter."""
    q = np.repeat(joints(20), 3, axis=0)
    points = arm.positions(q) + scatter * np.random.default_rng(2).standard_normal((60, 1, 3))
    data = measurements(arm, q, step * np.round(points / step))
    assert len(copied_visits(arm, data)) == 0


def test_copies_among_honest_repeats_are_found(arm):
    q = np.repeat(joints(20), 2, axis=0)
    points = arm.positions(q) + 2e-5 * np.random.default_rng(2).standard_normal((40, 1, 3))
    data = with_copies(measurements(arm, q, 1e-7 * np.round(points / 1e-7)), [3, 4, 5])
    np.testing.assert_array_equal(copied_visits(arm, data), [40, 41, 42])


def nothing_that_works(fit):
    raise KeyError("no such thing")


def no_reasons(fit):
    yield "it is warm"


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (f"{__name__}:nothing_that_works", "KeyError: 'no such thing'; mend or uninstall the package"),
        (f"{__name__}:not_there", "AttributeError"),
        (f"{__name__}:no_reasons", "yields something other than calib.core.judging.reasons.Reason"),
    ],
)
def test_a_rule_of_another_package_that_does_not_work_is_named(shop, monkeypatch, value, said):
    other = EntryPoint("warmth", value, "calib.reasons")
    listed = {"calib.reasons": [other]}
    monkeypatch.setattr("calib.core.judging.verdict.list_entry_points", lambda group: listed.get(group, []))
    with pytest.raises(calib.InputError, match=re.escape(said)) as result:
        judge(dataclasses.replace(shop.good, seconds=0.0))
    assert str(result.value).startswith(f"reason 'warmth' of the verdict ({value}): ")


def test_every_reason_has_a_row_of_the_page():
    """The page of failures says what to do."""
    page = (ROOT / "docs" / "howto" / "when_it_fails.md").read_text(encoding="utf-8")
    rows = re.findall(r'^\| <a id="(\w+)"></a>\*\*\1\*\*: .+ \| .+ \|$', page, re.MULTILINE)
    assert sorted(rows) == sorted(code.value for code in Code)


@pytest.mark.parametrize("away", [0.0, 7e-5])
def test_few_poses_show_a_gain_by_the_noise_that_is_stated(tmp_path, away):
    """What few poses leave is no measure of chance: by that alone, origins that are 0.07 mm off each would be noise."""
    (tmp_path / "arm.urdf").write_bytes((EXAMPLES / "arm.urdf").read_bytes())
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
    codes = [reason.code for reason in rules_model.nothing_to_correct(fit)]
    assert ("nothing_to_correct" in codes) == (away == 0.0)


def test_of_eighteen_joints_only_those_that_are_tied_are_named():
    """A linkage holds the sum of three passive joints, which an arm reads with all of its others."""
    q = np.random.default_rng(2).uniform(-1, 1, (60, 18)) * np.linspace(0.1, 2.0, 18)
    q[:, 11] = 0.4 - q[:, 4] - q[:, 8]
    names = tuple(f"j{k + 1}" for k in range(18))
    assert tied_joints(SimpleNamespace(joint_names=names), q) == [(("j5", "j9", "j12"), 2)]
