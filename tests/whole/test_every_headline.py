"""Each headline of verify, check, select, compare and watch is said where it is true, and not without its cause."""

import re

import numpy as np
import pytest
import scipy

import calib
from calib.core.data.in_memory import as_poses
from tests.project import EXAMPLES
from tests.whole import headline_situations as h
from tests.whole.headline_situations import Commands, derivative, joints, measured, on_one_line


@pytest.fixture(scope="module")
def commands(tmp_path_factory):
    return Commands(tmp_path_factory.mktemp("headlines"))


HEADLINES = (  # command, situation, what is said of it, other situations, and what is said of none of them
    ("verify", "quiet", "That is less than chance explains", "agrees", "less than chance explains"),
    ("verify", "alone", "has changed by", "agrees", ""),
    ("verify", "alike", "zero of slide has changed by +0.29", "", ""),
    ("verify", "alike", "cannot tell it from a change of slide.x, wrist.x", "alone", "cannot tell it"),
    ("verify", "two", "does not explain", "alone", ""),
    ("verify", "slip", "Left out, further off than noise explains: pose 7", "agrees", "Left out"),
    ("verify", "hidden", "Judge by the ratio: most of this error", "seen", "Judge by the ratio"),
    ("verify", "faint", "they have the pattern of this change", "alone", "in common"),
    ("verify", "often", "so AP has 6 degrees of freedom less", "same setup", "degrees of freedom less"),
    ("check", "still", "With all 20: position error unbounded, because what is not determined", "base", "unbounded"),
    ("check", "still", "7 combinations of the 9 free parameters can be found from these poses; 2 are NOT", "", ""),
    ("check", "determined", "Every combination of the parameters shows in the readings.", "", ""),
    ("check", "priors", "Most of this error moves all positions as one", "two positions, determined", "as one body"),
    ("check", "singular", "Warning: 1 pose near a singularity of the loops: pose 30", "regular", "singularity"),
    ("check", "unknown place", "Not counted: other (only instruments at unknown places see it)", "base", "Not counted"),
    ("select", "nine", "(certified)", "no bound", "certified"),
    ("select", "no bound", "No bound is known for O2, and one start was tried: --starts 5 may find better",
     "starts, all, nine", "No bound"),
    ("select", "apart", "mm apart", "nine", ""),
    ("select", "priors", "All candidates together determine 13 combinations of the 30 free parameters",
     "nine", "together determine"),
    ("select", "again", "Unstated noise is assumed", "measured", "is assumed"),
    ("select", "again", "2 candidates already measured and left out", "measured", "left out"),
    ("compare", "first and longer", "first and longer: 1 parameter of the robot differs, flange.z (all", "", ""),
    ("compare", "first and elsewhere", "first and elsewhere: no parameter of the robot differs", "", ""),
    ("compare", "first and elsewhere", "; put elsewhere: base.x, base.rz.", "first and again", "put elsewhere"),
    ("compare", "first and again", "first and again: no parameter of the robot differs", "", ""),
    ("compare", "placed and moved", "placed and moved: put elsewhere: base.x.", "", ""),
    ("compare", "placed and there", "placed and there: nothing was put elsewhere.", "", ""),
    ("compare", "arm and other", "robot differs, but no single parameter is proven", "first and longer", "no single"),
    ("compare", "same readings", "no tests, because both used the same 40 readings", "", ""),
    ("compare", "same readings", "and 4 parameters without a test values", "", ""),
    ("compare", "first and again", "tested as measurements with independent noise; no reading is in both", "", ""),
    ("compare", "first and again, page", "first and again: ", "", ""),
    ("compare", "first and held", "1 parameter free in only one (wrist.x)", "first and again", "free in only one"),
    ("compare", "first and held", "on readings that it did not use", "", ""),
    ("compare", "first and again", "on poses left out in turn", "first and longer", "on the readings that it used"),
    ("watch", "twelve", "too few unseen poses yet (0)", "", ""),
    ("watch", "three", "not yet a calibration: ", "twelve", "not yet a calibration"),
    ("watch", "met", "goal 0.2 mm: STOP: it is met", "close", "STOP"),
    ("watch", "bent", "not reached, and more poses will not help: what they lower meets the goal, unseen errors do not",
     "close", "will not help"),
    ("watch", "noisy", "not reached, and more poses will not help: what they lower meets the goal, unseen errors do",
     "close", "will not help"),
    ("watch", "twelve", "can never show that the goal is met", "close, nothing, wire", "can never show"),
    ("watch", "nothing", "which determines more of what is unknown", "", ""),
    ("watch", "all measured", "every candidate that can be reached is measured; give", "twelve", "every candidate"),
    ("watch", "wire", "as far as readings show positions", "met", "as far as"),
    ("watch", "twelve", "next: pose", "bent, noisy", ""),
)  # fmt: skip


@pytest.mark.parametrize(("command", "situation", "said", "others", "less"), HEADLINES)
def test_a_headline_is_said_where_it_is_true_and_not_without_its_cause(
    commands, command, situation, said, others, less
):
    texts = getattr(commands, f"{command}_texts")
    assert said in texts[situation]
    assert not [name for name in filter(None, others.split(", ")) if (less or said) in texts[name]]


def numbers_of(pattern, text):
    """Numbers in the groups of a pattern."""
    match = re.search(pattern, text)
    assert match, text
    return [float(number) for number in match.groups()]


# verify


@pytest.fixture(scope="module")
def by_hand(commands):
    """Generalised least squares of the readings of `alone`, with the covariance of the fit and the base left open."""
    fit, q = commands.fit, joints(25, 2)
    points = measured(commands.changed(flange_z=3e-4), q, 3).points(fit.robot)
    errors = (fit.robot.positions(q) - points).ravel()
    of_robot = [name for name in fit.free_names if not name.startswith("base")]
    free = [fit.covariance.names.index(name) for name in of_robot]
    slope = derivative(fit.robot, q, of_robot)
    spread = slope @ fit.covariance.values[np.ix_(free, free)] @ slope.T
    base = derivative(fit.robot, q, [name for name in fit.free_names if name.startswith("base")])
    root = np.linalg.cholesky(fit.sigma**2 * np.eye(len(errors)) + spread)
    columns = np.column_stack([base, derivative(fit.robot, q, ["flange.z"])])
    whitened, by = (np.linalg.solve(root, matrix) for matrix in (errors, columns))
    return fit, errors, base, spread, whitened, by


@pytest.mark.quick(0)
def test_residuals_are_as_many_times_as_large_as_said(commands, by_hand):
    fit, errors, base, spread, whitened, by = by_hand
    square, m = np.linalg.lstsq(by[:, :6], whitened)[1][0], len(errors) - 6
    low, high = np.sqrt(scipy.stats.f.ppf([0.025, 0.975], m, fit.statistics.freedom))
    chance = scipy.stats.f.sf(square / m, m, fit.statistics.freedom)
    said = r"are ([\d.]+) times .* is between ([\d.]+) and ([\d.]+) in 95 .* \(p = ([\de.-]+)\)"
    assert numbers_of(said, commands.verify_texts["alone"]) == pytest.approx(
        [np.sqrt(square / m), low, high, chance],
        rel=2e-2,  # two digits of the last are said
    )
    placed = np.eye(len(errors)) - base @ np.linalg.pinv(base)
    noise = fit.sigma * np.sqrt(3 * m / len(errors))
    open_ = np.sqrt(np.trace(placed @ spread @ placed) / 25)
    said = r"over 25 poses: ([\d.]+) mm RMS.* expected: ([\d.]+) mm RMS \(noise ([\d.]+) mm, .* ([\d.]+) mm\)"
    expected = [1e3 * h.rms(placed @ errors), 1e3 * np.hypot(noise, open_), 1e3 * noise, 1e3 * open_]
    assert numbers_of(said, commands.verify_texts["alone"]) == pytest.approx(expected, abs=2e-4)


def test_residuals_that_are_too_small_are_told(commands):
    """The readings have a third of the noise; or they are those of the calibration, which are nearer to it."""
    (ratio,) = numbers_of(r"Residuals are ([\d.]+) times", commands.verify_texts["quiet"])
    assert ratio == pytest.approx(0.3 * h.SIGMA / commands.fit.sigma, rel=0.3)


def test_a_change_has_the_size_that_is_said(commands, by_hand):
    _, _, _, _, whitened, by = by_hand
    size, std = -np.linalg.lstsq(by, whitened)[0][-1], np.sqrt(np.linalg.inv(by.T @ by)[-1, -1])
    said = r"flange\.z has changed by \+([\d.]+) mm \(standard deviation ([\d.]+)\)"
    assert numbers_of(said, commands.verify_texts["alone"]) == pytest.approx([1e3 * size, 1e3 * std], abs=1e-4)


def test_changes_that_readings_cannot_tell_apart_move_the_tip_alike(commands):
    q = joints(25, 2)
    by = derivative(commands.fit.robot, q, ["slide.x", "wrist.x", "flange.z"]).T
    moved, there = (commands.fit.robot.positions(q + np.array([0, size, 0])) for size in (1e-6, 0))
    zero = (moved - there).ravel() / 1e-6
    for column, alike in ((by[1], True), (zero, True), (by[2], False)):
        scale = column @ by[0] / (column @ column)
        assert (h.rms(3e-4 * (scale * column - by[0])) < h.SIGMA) == alike


def test_one_change_that_explains_little_is_told_beside_what_it_leaves(commands):
    texts = commands.verify_texts
    name, p = re.search(
        r"A change of (\S+) by \S+ mm .* does not explain .*: the rest has p = (\S+)", texts["two"]
    ).groups()
    assert name in ("slide.x", "flange.z")
    assert float(p) < 0.005
    assert [commands.verified[name].verdict for name in ("two", "alone")] == ["calibrate again", "drifted"]
    largest = re.search(r"No change stands out: the largest, of \S+, has p = (\S+) \(sig", texts["agrees"])[1]
    assert float(largest) >= 0.005


def test_millimetres_do_not_count_what_was_left_out(commands):
    """One reading is 10 mm off; the others are where they were, and so is the base that they place."""
    said = r"over (\d+) poses: ([\d.]+) mm RMS, ([\d.]+) mm at worst"
    assert [commands.verified[name].verdict for name in ("slip", "agrees")] == ["agrees", "agrees"]
    kept = np.delete(np.arange(25), 7)
    q = joints(25, 7)
    errors = commands.fit.robot.positions(q)[kept, 0] - measured(commands.truth, q, 7).points(commands.truth)[kept, 0]
    base = derivative(commands.fit.robot, q[kept], [f"base.{c}" for c in ("x", "y", "z", "rx", "ry", "rz")])
    left = (errors.ravel() - base @ np.linalg.lstsq(base, errors.ravel())[0]).reshape(-1, 3)
    sizes = 1e3 * np.linalg.norm(left, axis=1)
    expected = [24, np.sqrt(np.mean(sizes**2)), np.max(sizes)]
    assert numbers_of(said, commands.verify_texts["slip"]) == pytest.approx(expected, abs=2e-4)


def test_the_ratio_is_said_to_count_where_uncertain_directions_hide_a_change(commands):
    """The same readings; the calibration from a corner expects more millimetres than there are."""
    hidden, seen = (commands.verified[name] for name in ("hidden", "seen"))
    assert hidden.calibration_rms > 0.9 * hidden.expected_rms
    assert hidden.errors.table()["after"]["rms"] < 1e3 * hidden.expected_rms
    assert seen.errors.table()["after"]["rms"] > 1e3 * seen.expected_rms


def test_a_change_among_residuals_that_are_no_larger_than_expected_is_explained(commands):
    faint, alone = (commands.verified[name] for name in ("faint", "alone"))
    assert faint.ratio < faint.high95
    assert alone.ratio > alone.high95


@pytest.mark.quick(0)
def test_a_plan_says_which_changes_show_and_which_never_do(commands, run_calib, tmp_path):
    _, results = commands.results
    lines = [",".join(commands.robot.joint_names), *(",".join(map(str, q)) for q in joints(20, 6))]
    (tmp_path / "plan.csv").write_text("\n".join(lines) + "\n")

    def said(change, *options):
        run = run_calib("verify", results / "arm", tmp_path / "plan.csv", "--plan", "--change", change, *options)
        assert run.code == 0, run.err
        return on_one_line(run.out)

    text = said("flange.z=0.05 mm")
    assert "Smallest changes that 20 poses of" in text
    (n,) = map(int, numbers_of(r"The first (\d+) poses show flange\.z=0\.05 mm with a chance of 90 %", text))
    by = {
        count: calib.core.judging.acceptance.visible_changes(commands.fit, joints(20, 6)[:count])
        for count in (n - 1, n)
    }
    assert [any(c.name == "flange.z" and c.visible <= 5e-5 for c in by[count]) for count in (n - 1, n)] == [False, True]
    assert "All 20 poses are too few to show flange.z=0.001 mm with a chance of 90 %; add" in said("flange.z=0.001 mm")
    never = said("turn.x=5 mm")
    assert (
        "No number of such poses shows a change of turn.x: readings do not depend on it, or the new places of" in never
    )
    by_turn, by_base = (
        derivative(commands.fit.robot, joints(20, 6), ["turn.x"]),
        derivative(commands.fit.robot, joints(20, 6), [f"base.{c}" for c in ("x", "y", "z", "rx", "ry", "rz")]),
    )
    assert np.linalg.norm(by_turn - by_base @ np.linalg.pinv(by_base) @ by_turn) < 1e-6
    assert "The first" in said("turn.x=5 mm", "--same-setup")


# check


# select


def test_a_certificate_says_what_the_choice_reaches_of_its_bound(commands):
    """That no choice exceeds the bound: tests/planning/test_selection_bound.py, test_instrument_choice.py."""
    _, selection = commands.selections["nine"]
    said = r"O1 = ([\d.e-]+): at least ([\d.]+) % of the best possible choice \(certified\)"
    reached, least = numbers_of(said, commands.select_texts["nine"])
    assert reached == pytest.approx(selection.after["O1"], rel=1e-4)
    assert least <= 100 * selection.after["O1"] / selection.bound * (1 + 1e-4) < least + 0.2


def test_other_starts_may_find_better_where_they_are_offered(commands):
    one, five = (commands.selections[name][1].after["O2"] for name in ("no bound", "starts"))
    assert five > one


def test_what_candidates_leave_undetermined_is_said(commands):
    texts, robot, few = commands.select_texts, commands.robot, commands.few_free[0]
    still = joints(20, 3) * [1, 0, 0] + [0, 0.3, 0.2]
    rank = np.linalg.matrix_rank(derivative(few, still, [p.name for p in few.parameters]), rtol=1e-7)
    assert f"Warning: all candidates together determine {rank} of 9 free parameters" in texts["still"]
    by = derivative(robot, np.vstack([joints(9, 1), joints(4, 5)]), [p.name for p in robot.parameters])
    rank = np.linalg.matrix_rank(by / np.linalg.norm(by, axis=0), rtol=1e-7)
    assert f"All candidates and measured poses together determine {rank} combinations of the 30" in texts["measured"]


# compare


def test_of_more_results_fewer_pairs_differ_by_chance(commands):
    """Each pair alone would err in one of twenty; Holm's step-down makes the p-values of three pairs larger."""
    _, folder = commands.results
    names = ("first", "again", "elsewhere")
    together = calib.compare(*(folder / name for name in names)).joint_p_values
    alone = [commands.comparisons[f"first and {name}"].joint_p_values[0] for name in names[1:]]
    assert all(p > 0.999 * single for p, single in zip(together, alone, strict=True))
    assert together[0] > 1.9 * alone[0]  # at most one pair has a smaller p, so it counts twice at least


def test_a_verdict_that_is_not_pass_is_noted(commands):
    texts = commands.compare_texts
    assert texts["same readings, page"] == ""
    for name, (one, other) in {"first and again": ("first", "again"), "placed and there": ("placed", "there")}.items():
        grades = [commands.results[0][each].verdict.grade for each in (one, other)]
        assert ("a verdict is CHECK" in texts[name]) == ("CHECK" in grades)


# watch


def test_a_goal_below_the_scatter_of_the_readings_is_told(commands):
    said = r"not yet; readings that scatter by ([\d.]+) mm RMS about the model can never show that the goal is met"
    told = commands.watched["twelve"]
    left = told.fit.robot.positions(joints(60, 9)[:12]) - measured(commands.few_free[1], joints(60, 9), 9)[:12].points()
    scatter = 1e3 * np.sqrt(3 * np.sum(left**2) / (36 - 9))
    assert numbers_of(said, commands.watch_texts["twelve"]) == pytest.approx([scatter], rel=5e-3)
    assert scatter > 1e3 * told.goal


def test_the_next_pose_lowers_the_predicted_error_by_what_is_said(commands):
    """That it does: tests/planning/test_watch.py."""
    pose = commands.watched["twelve"].next_pose
    (said,) = numbers_of(r"which lowers the predicted error by ([\d.]+) %", commands.watch_texts["twelve"])
    assert said == pytest.approx(100 * (1 - pose.after / pose.before), rel=0.03)


@pytest.mark.quick(0)
def test_candidates_that_cannot_be_reached_are_not_counted(commands):
    robot = calib.load(EXAMPLES / "five_bar.yaml")
    turned = np.stack(np.meshgrid(*2 * [np.radians(np.arange(0, 360, 30.0))]), axis=-1).reshape(-1, 2)
    reached = int(np.sum(robot.close(turned).ok))
    assert reached < len(turned)
    told = calib.Watch(robot, "0.1 mm", candidates=as_poses(robot, turned))
    data = calib.simulate(robot, robot.sample(20, seed=1), seed=2)
    (said,) = numbers_of(r"over (\d+) candidates", told.update(data).report())
    assert said == pytest.approx(reached, abs=2)  # the fit's robot reaches a little more or less
