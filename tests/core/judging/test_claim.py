"""What a fit claims: errors of poses that it has not seen, held against others and against a stated tolerance."""

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import calib
from calib.core.base.errors import DataError, DescriptionError
from calib.core.base.units import stated_tolerance
from calib.core.data.measurements import with_points
from calib.core.judging.claim import Benefit, Claim
from calib.core.judging.reasons import Code
from calib.core.robots.description import read_description
from tests.project import EXAMPLES, copied
from tests.six_axis_arm import FREE, YAML, joints, measurements, noisy, write_six_axis

SIGMA = 4e-5


def sagging(arm, truth, q, seed, *, by=1e-3):
    """Read with joints that follow a wave, which the model leaves out."""
    actual = q + by * np.sin(3 * q)
    return measurements(arm, q, noisy(truth, actual, SIGMA, seed).points(arm))


@pytest.mark.quick(0)
@pytest.mark.parametrize("by", [0.0, 1e-3])
def test_95_of_100_new_poses_are_as_close_as_claimed(arm, truth, by):
    """With the noise of readings alone, and with an error of the robot that no parameter describes."""
    within, ratios = [], []
    for seed in range(6):
        fit = calib.fit(arm, sagging(arm, truth, joints(60, seed), seed, by=by))
        new = joints(400, 100 + seed)
        read = sagging(arm, truth, new, 200 + seed, by=by).points(arm)
        off = np.linalg.norm(fit.robot.positions(new) - read, axis=2)[:, 0]
        told = fit.verdict.claim.at_measured_poses
        within.append(np.mean(off < told.limit95))
        ratios.append(np.sqrt(np.mean(off**2)) / told.rms)
    assert 0.92 < np.mean(within) <= 1.0
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.08)


def test_what_the_model_leaves_out_is_no_doubt_where_the_claim_counts_it(arm, truth):
    """A robot four times as good as before, whose rest is a pattern, is fit for use within what it claims."""
    fit = calib.fit(arm, sagging(arm, truth, joints(80), 1), validation=sagging(arm, truth, joints(40, 5), 2))
    entry = fit.verdict.to_dict()
    assert fit.verdict.grade == "PASS"
    assert "systematic" in entry["codes"]
    assert (entry["claim"]["holds"], entry["claim"]["gain"], entry["claim"]["unit"]) == (True, "better", "mm")
    told, seen = entry["claim"]["rms"], entry["claim"]["not_used"][0]
    assert seen["rms"] == pytest.approx(1e3 * fit.validation.rms("after"))
    assert 0.8 < seen["rms"] / told < 1.25
    text = fit.report().replace("\n", " ")
    assert f"The tool is within {entry['claim']['limit95']:.4f} mm of where the model says, 95 % of the time" in text


def test_poses_where_the_robot_does_something_else_break_the_claim(arm, truth):
    """Another payload, say: first the reason that is true, then the others."""
    other = sagging(arm, truth, joints(40, 5), 2, by=4e-3)
    fit = calib.fit(arm, sagging(arm, truth, joints(80), 1), validation=other)
    assert fit.verdict.grade == "CHECK"
    assert fit.verdict.reasons[0].code == "validation"
    assert not fit.verdict.claim.holds
    assert {reason.grade for reason in fit.verdict.reasons if reason.counted} == {"CHECK"}


@pytest.mark.parametrize(("by", "grade"), [(5e-5, "PASS"), (1.5e-4, "CHECK")])
def test_a_robot_that_surely_goes_on_growing_is_a_check(arm, truth, by, grade):
    """By 150 ppm in the course of the measurement, half of the error left: poses measured later are further off."""
    read = noisy(truth, joints(80, 1), SIGMA, 1).points(arm)
    grown = read + by * np.linspace(0, 1, 80)[:, None, None] * (read - read.mean(axis=0))
    fit = calib.fit(arm, measurements(arm, joints(80, 1), grown))
    assert fit.verdict.grade == grade
    assert [reason.code for reason in fit.verdict.reasons if reason.grade == "CHECK"] == ["systematic"] * (by > 1e-4)


def test_computed_data_claim_nothing_and_show_no_pattern(shop):
    computed = shop.situation(Code.NO_NOISE).there
    assert computed.verdict.claim is None
    assert computed.patterns == ()


@pytest.fixture(scope="module")
def unknown_base(tmp_path_factory):
    text = YAML.replace("{frame: l0}", "{frame: l0, pose: unknown}")
    return calib.load(write_six_axis(tmp_path_factory.mktemp("unknown"), text + FREE))


def put_up_anew(robot, data):
    """The tracker stands metres away, turned by a radian."""
    points = data.points(robot)
    return with_points(robot, data, points @ Rotation.from_euler("z", 1.0).as_matrix().T + [2.0, -1.0, 0.3])


def test_poses_read_from_elsewhere_are_judged_with_their_frame_placed_anew(unknown_base, truth):
    robot, true = unknown_base, unknown_base.with_parameters({"j2.x": 0.0512, "j3.z": 0.5991, "j4.ry": 2e-3})
    used, other = noisy(true, joints(80), SIGMA, 1), noisy(true, joints(30, 5), SIGMA, 2)
    moved = calib.fit(robot, used, validation=put_up_anew(robot, other))
    assert moved.validation.rms("after") > 1.0  # m
    verdict = moved.verdict
    assert (verdict.grade, verdict.to_dict()["codes"][0]) == ("CHECK", "frame_moved")
    assert "With the frame placed anew, the RMS error falls from" in verdict.reasons[0].text
    assert not {"validation", "worse_on_validation"} & set(verdict.to_dict()["codes"])
    assert verdict.claim.gain is Benefit.BETTER
    assert verdict.claim.unused[0].accuracy.rms == pytest.approx(np.sqrt(3) * SIGMA, rel=0.25)
    left = re.search(r"validation, frame placed anew +30 +[\d.]+ -> ([\d.]+)", moved.report())[1]
    assert float(left) == pytest.approx(1e3 * np.sqrt(3) * SIGMA, rel=0.25)  # mm; nothing is metres off
    assert not re.search(r"\de\+\d", moved.report())


def test_another_robot_fails_wherever_the_tracker_stands(unknown_base):
    robot = unknown_base
    one, another = (robot.with_parameters({"j2.x": 0.05 + x, "j3.z": 0.6 + x, "j4.ry": x}) for x in (2e-3, -2e-3))
    used, other = noisy(one, joints(80), SIGMA, 1), noisy(another, joints(30, 5), SIGMA, 2)
    moved = calib.fit(robot, used, validation=put_up_anew(robot, other)).verdict
    assert moved.grade == "FAIL"
    assert "the validation poses, their frame placed anew: RMS" in str(moved)
    assert "frame_moved" in moved.to_dict()["codes"]


@pytest.mark.parametrize(("n_bad", "holds"), [(2, True), (20, False)])
def test_a_few_bad_rows_of_many_decide_nothing_and_are_named(arm, truth, n_bad, holds):
    """Two rows of 300 are 3 mm off, and so the root mean square; the claim is about 95 of 100 poses."""
    other = noisy(truth, joints(300, 5), SIGMA, 2)
    points = other.points(arm).copy()
    points[:: 300 // n_bad, :, 2][:n_bad] += 3e-3
    fit = calib.fit(arm, noisy(truth, joints(80), SIGMA, 1), validation=with_points(arm, other, points))
    claim = fit.verdict.claim
    assert claim.unused[0].accuracy.rms > 2.0 * claim.at_measured_poses.rms
    assert claim.holds == holds
    assert fit.verdict.grade == ("PASS" if holds else "CHECK")
    named = [reason.text for reason in fit.verdict.reasons if reason.code == "outliers"]
    assert any("among the poses that were not used" in text for text in named)
    if holds:
        assert claim.unused[0].without_outliers.rms == pytest.approx(np.sqrt(3) * SIGMA, rel=0.15)
        assert "without outliers" in claim.words
        assert fit.verdict.reasons[0].code == "outliers"
        assert Claim.from_dict(claim.to_dict()).words == claim.words


def test_the_smallest_tolerance_of_the_comments_counts():
    comments = ("written by a tracker", "Tolerance: 0.2 mm", "tolerance = 50 um", "columns: 0.1 mm")
    assert stated_tolerance(comments, "a.csv") == pytest.approx(5e-5)
    assert stated_tolerance(("no tolerance here: 0.1 mm",), "a.csv") is None


@pytest.mark.parametrize(
    ("comment", "says"),
    [
        ("tolerance: 0.1", "is not a positive length with a unit; write '# tolerance: 0.1 mm'"),
        ("tolerance: -1 mm", "is not a positive length with a unit"),
        ("tolerance: 1 deg", "unit 'deg' is for an angle"),
        ("tolerance: fine", "is not a finite number with a unit"),
        ("tolerence: 0.1 mm", "did you mean 'tolerance'"),
    ],
)
def test_a_tolerance_that_is_not_understood_is_an_error(comment, says):
    with pytest.raises(DataError, match=f"a.csv: comment '{comment}'.*{says}"):
        stated_tolerance((comment,), "a.csv")


def test_a_comment_of_a_description_states_the_tolerance_but_not_one_inside_an_entry(tmp_path):
    text = (EXAMPLES / "arm.yaml").read_text()
    (tmp_path / "robot.yaml").write_text(f"#tolerance: 0.06 mm\n{text}#   tolerance: 0.01 mm\n  # tolerance: 0.01 mm\n")
    assert read_description(tmp_path / "robot.yaml").tolerance == pytest.approx(6e-5)
    (tmp_path / "robot.yaml").write_text(f"# tolerance: 0.06\n{text}")
    with pytest.raises(
        DescriptionError, match=r"robot\.yaml: comment 'tolerance: 0\.06': is not a positive length with a unit"
    ):
        read_description(tmp_path / "robot.yaml")


@pytest.mark.quick(0)
def test_a_claim_above_the_tolerance_of_file_or_description_is_no_pass(run_calib, tmp_path):
    wide, measured = "# tolerance: 0.2 mm\n", (EXAMPLES / "arm_simulated.csv").read_text()
    for head, entry, comment, broken in (
        ("", "", "", ""),
        ("", "", wide, ""),
        ("", "", "# tolerance: 0.05 mm\n", "0.05 mm"),
        ("", "tolerance: 0.06 mm\n", wide, "0.06 mm"),
        ("# tolerance: 0.06 mm\n", "tolerance: 0.2 mm\n", wide, "0.06 mm"),
    ):
        robot = copied(tmp_path, EXAMPLES / "arm.yaml", more=entry)
        robot.write_text(head + robot.read_text())
        (tmp_path / "data.csv").write_text(comment + measured)
        run = run_calib("fit", robot, "data.csv", "--no-pages", "--out", "out", cwd=tmp_path)
        assert run.code == 0, run.err
        assert f"Verdict: {'CHECK' if broken else 'PASS'}" in run.out
        words = f"CHECK: the claim is 0.0853 mm (95 % of the time), above the tolerance of {broken}"
        assert (words in " ".join(run.out.split())) == bool(broken)
