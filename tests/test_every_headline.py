"""Each headline of verify, check, select, compare and watch is said where it is true, and not without its cause."""

import ast
import re
from pathlib import Path

import headline_situations as h
import numpy as np
import pytest
import scipy
from headline_situations import Commands, derivative, joints, measured, on_one_line

import calib
from calib.core.data.in_memory import as_poses
from calib.planning.next_steps import after_check

ROOM = Path(calib.__file__).parent
ALWAYS = {
    "verify": [
        "times as large as expected, each direction weighted by its uncertainty."
        " If the robot is unchanged, that is between",
        "in 95 of 100 cases (p =",
        "Position errors over",
        "mm at worst; expected:",
        "mm RMS (noise",
        "mm, uncertainty of the calibration",
        "mm), at most",
        "Changes that were looked for, by size over standard deviation;",
    ],
    "check": [
        "Predicted position error against number of poses, mm",
        ": position error",
        "best of these: RMS",
        "mm per axis",
        "parameters, poses alone:",
        "free parameters can be found from these poses",
        "Hardly improved by these poses (more than",
        "% of the expected error is left):",
    ],
    "select": [
        ", chosen by",
        "Indices (scaled columns; task: predicted position error)",
        "Order of measurement: travel",
        "in the candidates' order",
        "s in all,",
        "chosen, not scaled:",
        "s for the choice",
    ],
}
"""What stands beside every result."""
ELSEWHERE = [
    "show with a chance of",  # the plan: tests/test_verify.py
    "Smallest changes that",
    "more stay near nominal",  # tests/test_bad_measurements.py
    ", then moved off the grid",  # the file: tests/test_select_command.py
    ", in order of measurement",
    "; the efficiency is that of the free candidates",  # obstacles: tests/test_motion.py
    "if all candidates were free (",
    "; positions are predicted",
    "results side by side",  # no sentence
    "std after fit",
    "the fit of",  # failed fits: tests/test_result_comparison.py
]
SOURCES = {
    "verify": ["core/results/acceptance_text.py"],
    "check": ["planning/assessment_text.py", "core/rows/determination.py"],
    "select": ["planning/selection_text.py"],
    "compare": ["core/results/comparison_report.py", "core/results/comparing_results.py"],
    "watch": ["planning/progress.py"],
}


@pytest.fixture(scope="module")
def commands(tmp_path_factory):
    return Commands(tmp_path_factory.mktemp("headlines"))


def sentences(path):
    """Parts of texts in a file, of three words and more; no docstrings, and nothing that is raised."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    skipped = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            skipped.add(node.value)
        elif isinstance(node, ast.Raise):
            skipped |= set(ast.walk(node))
    constants = [node for node in ast.walk(tree) if isinstance(node, ast.Constant) and node not in skipped]
    texts = (on_one_line(node.value) for node in constants if isinstance(node.value, str))
    return [text for text in texts if len(text.split()) > 2]


@pytest.mark.parametrize("command", list(SOURCES))
def test_every_sentence_is_said_somewhere_and_not_everywhere(commands, command):
    texts = [text.lower() for text in getattr(commands, f"{command}_texts").values()]
    found = [part for name in SOURCES[command] for part in sentences(ROOM / name) if part not in ELSEWHERE]
    assert len(found) > 10
    for part in found:
        n_said = sum(part.lower() in text for text in texts)
        assert n_said > 0, f"never said: {part}"
        assert (n_said == len(texts)) == (part in ALWAYS.get(command, [])), f"said in {n_said} of {len(texts)}: {part}"


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


def test_changes_that_readings_cannot_tell_apart_move_the_tip_alike(commands):
    texts = commands.verify_texts
    assert "slide.x has changed by +0.29" in texts["alike"]
    assert "cannot tell it from a change of wrist.x, zero of slide" in texts["alike"]
    assert "cannot tell it" not in texts["alone"]
    q = joints(25, 2)
    by = derivative(commands.fit.robot, q, ["slide.x", "wrist.x", "flange.z"]).T
    moved, there = (commands.fit.robot.positions(q + np.array([0, size, 0])) for size in (1e-6, 0))
    zero = (moved - there).ravel() / 1e-6
    for column, alike in ((by[1], True), (zero, True), (by[2], False)):
        scale = column @ by[0] / (column @ column)
        assert (h.rms(3e-4 * (scale * column - by[0])) < h.SIGMA) == alike


def test_the_ratio_is_said_to_count_where_uncertain_directions_hide_a_change(commands):
    """The same readings; the calibration from a corner expects more millimetres than there are."""
    hidden, seen = (commands.verified[name] for name in ("hidden", "seen"))
    assert "Judge by the ratio: the few directions" in commands.verify_texts["hidden"]
    assert hidden.left_open > 0.9 * hidden.promised
    assert hidden.errors.table()["after"]["rms"] < 1e3 * hidden.promised
    assert "Judge by the ratio" not in commands.verify_texts["seen"]
    assert seen.errors.table()["after"]["rms"] > 1e3 * seen.promised


def test_a_change_among_residuals_that_are_no_larger_than_expected_is_explained(commands):
    faint, alone = (commands.verified[name] for name in ("faint", "alone"))
    assert faint.ratio < faint.high95
    assert "what they have in common is this change" in commands.verify_texts["faint"]
    assert alone.ratio > alone.high95
    assert "in common" not in commands.verify_texts["alone"]


# check


def test_changes_that_no_reading_shows_move_nothing(commands):
    texts, robot = commands.check_texts, commands.few_free[0]
    assert "Every combination of the parameters shows in the readings." in texts["determined"]
    said = re.search(r"These poses cannot tell apart: (.*?) To determine", texts["still"])[1]
    still = joints(20, 3) * [1, 0, 0] + [0, 0.3, 0.2]
    units = {"mm": 1e-3, "deg": np.pi / 180}
    terms = re.findall(r"(?:(from|\+) )?(?:([\d.e-]+) (mm|deg) of )?(-?)([a-z]\w*\.\w+)", said)
    groups: list[dict[str, float]] = []
    side = 1.0
    for link, amount, unit, minus, name in terms:
        side = {"": 1.0, "from": -1.0, "+": side}[link]
        if not link:
            groups.append({})
        groups[-1][name] = side * (-1 if minus else 1) * float(amount or 1) * units[unit or "mm"]
    assert len(groups) == 2, said
    for group in groups:
        by = derivative(robot, still, list(group))
        assert h.rms(by @ list(group.values())) < 2e-3 * 1e-3  # digits shown


def test_poses_near_a_singularity_are_counted(commands):
    """The links of the parallelogram lie on each other at the last pose."""
    assert "Warning: 1 pose near a singularity of the loops: pose 30" in commands.check_texts["singular"]
    assert "singularity" not in commands.check_texts["regular"]


def test_a_target_that_is_read_from_an_unknown_place_is_not_counted(commands):
    assert "Not counted: other, read from unknown places only." in commands.check_texts["unknown place"]
    assert "Not counted" not in commands.check_texts["base"]


def test_after_a_check_the_next_step_is_what_the_poses_need(commands):
    robot, q = commands.few_free[0], joints(20, 3)
    poses, data = as_poses(robot, q), measured(robot, q, 1)
    good, bad = (commands.checked[name] for name in ("base", "still"))
    assert "calib sample r.yaml" in after_check(good, "r.yaml", poses, (), {})
    hold = "Next: hold parameters that are named above (`held` in the description), or add poses, and check again: "
    assert after_check(bad, "r.yaml", poses, ("p.csv",), {}) == f"{hold}calib check r.yaml p.csv"
    assert after_check(bad, "r.yaml", data, ("d.csv",), {}) == f"{hold}calib check r.yaml d.csv"
    assert "fit these measurements: calib fit r.yaml d.csv" in after_check(good, "r.yaml", data, ("d.csv",), {})
    assert "choose the poses to measure: calib select" in after_check(good, "r.yaml", poses, ("p.csv",), {})


# select


def scaled_rows(robot, q):
    return derivative(robot, q, [p.name for p in robot.parameters]) * [p.sigma_si for p in robot.parameters]


def o1(scaled):
    """The first observability index of these rows, three for each pose."""
    values = np.linalg.svd(scaled, compute_uv=False)
    return float(np.exp(np.mean(np.log(np.maximum(values, 1e-300)))) / np.sqrt(len(scaled) / 3))


def o1_of(robot, q):
    return o1(scaled_rows(robot, q))


def test_poses_off_the_grid_are_as_much_better_as_is_said(commands):
    robot = commands.few_free[0]
    for name, beyond in (("off grid", True), ("edges", False)):
        poses, selection = commands.selections[name]
        on, off = o1_of(robot, poses.joints[selection.chosen]), o1_of(robot, selection.joints)
        text = commands.select_texts[name]
        assert numbers_of(r"Moved off the grid: ([\d.]+) % better than the choice from", text) == pytest.approx(
            [100 * (off / on - 1)], abs=0.02
        )
        assert (off > selection.bound) == beyond == ("better than any choice" in text)
    (beyond,) = numbers_of(r", ([\d.]+) % better than any choice from them can be", commands.select_texts["off grid"])
    _, selection = commands.selections["off grid"]
    assert beyond == pytest.approx(100 * (o1_of(robot, selection.joints) / selection.bound - 1), abs=0.02)
    assert "Moved off" not in commands.select_texts["nine"]


def test_what_candidates_leave_undetermined_is_said(commands):
    texts, robot, few = commands.select_texts, commands.robot, commands.few_free[0]
    still = joints(20, 3) * [1, 0, 0] + [0, 0.3, 0.2]
    rank = np.linalg.matrix_rank(derivative(few, still, [p.name for p in few.parameters]), rtol=1e-7)
    assert f"Warning: all candidates together determine {rank} of 9 free parameters" in texts["still"]
    by = derivative(robot, np.vstack([joints(9, 1), joints(4, 5)]), [p.name for p in robot.parameters])
    rank = np.linalg.matrix_rank(by / np.linalg.norm(by, axis=0), rtol=1e-7)
    assert f"All candidates and measured poses together determine {rank} combinations of the 30" in texts["measured"]
    assert "All candidates together determine 13 combinations of the 30 free parameters" in texts["priors"]
    assert "together determine" not in texts["nine"]


def test_assumed_noise_and_measured_candidates_are_said_where_there_are_any(commands):
    assert "Unstated noise is assumed" in commands.select_texts["again"]
    assert "2 candidates already measured and left out" in commands.select_texts["again"]
    assert not re.search("is assumed|left out", commands.select_texts["measured"])


# compare


def test_what_differs_is_what_was_changed(commands):
    texts = commands.compare_texts
    assert "first and longer: 1 parameter of the robot differs, flange.z (all" in texts["first and longer"]
    assert "first and elsewhere: no parameter of the robot differs" in texts["first and elsewhere"]
    assert "; put elsewhere: base.x, base.rz." in texts["first and elsewhere"]
    assert "first and again: no parameter of the robot differs" in texts["first and again"]
    assert "put elsewhere" not in texts["first and again"]
    assert "placed and moved: put elsewhere: base.x." in texts["placed and moved"]
    assert "placed and there: nothing was put elsewhere." in texts["placed and there"]


def test_notes_say_what_was_used_and_why_others_may_differ(commands):
    texts = commands.compare_texts
    assert "no tests, because both used the same 40 readings" in texts["same readings"]
    assert "and 4 parameters without a test values" in texts["same readings"]
    assert "fit 1 and fit 2: not tested." in texts["same readings, page"]
    assert "tested as measurements with independent noise; no reading is in both" in texts["first and again"]
    assert "not tested" not in texts["first and again, page"]
    assert "1 parameter free in one alone (wrist.x)" in texts["first and held"]
    assert "free in one alone" not in texts["first and again"]
    assert "on readings that it did not use" in texts["first and held"]
    assert "on poses left out in turn" in texts["first and again"]
    assert "left out in turn" not in texts["first and longer"]
    for name, (one, other) in {"first and again": ("first", "again"), "placed and there": ("placed", "there")}.items():
        grades = [commands.results[0][each].verdict.grade for each in (one, other)]
        assert ("a verdict is CHECK" in texts[name]) == ("CHECK" in grades)


# watch


def test_more_poses_do_not_help_where_the_model_or_the_noise_is_what_is_left(commands):
    """A wave of the slide that no parameter has; and readings that scatter by 0.35 mm, with a goal of 0.25 mm."""
    for name in ("bent", "noisy"):
        text, told = commands.watch_texts[name], commands.watched[name]
        assert "not reached, and more poses will not help: the predicted error meets the goal, unseen errors do" in text
        assert told.predicted.high95 < told.goal < told.unseen.low95
        assert "next: pose" not in text
    assert commands.watched["noisy"].fit.sigma * np.sqrt(3) > commands.watched["noisy"].goal
    assert "will not help" not in commands.watch_texts["close"]


def test_a_goal_below_the_scatter_of_the_readings_is_told(commands):
    said = r"not yet; readings that scatter by ([\d.]+) mm RMS about the model can never show that it is met"
    told = commands.watched["twelve"]
    left = told.fit.robot.positions(joints(60, 9)[:12]) - measured(commands.few_free[1], joints(60, 9), 9)[:12].points()
    scatter = 1e3 * np.sqrt(3 * np.sum(left**2) / (36 - 9))
    assert numbers_of(said, commands.watch_texts["twelve"]) == pytest.approx([scatter], rel=5e-3)
    assert scatter > 1e3 * told.goal
    for name in ("close", "nothing", "wire"):
        assert "can never show" not in commands.watch_texts[name]


def test_candidates_that_cannot_be_reached_are_not_counted(commands):
    robot = calib.load(Path(__file__).parents[1] / "docs" / "examples" / "five_bar.yaml")
    turned = np.stack(np.meshgrid(*2 * [np.radians(np.arange(0, 360, 30.0))]), axis=-1).reshape(-1, 2)
    reached = int(np.sum(robot.close(turned).ok))
    assert reached < len(turned)
    told = calib.Watch(robot, "0.1 mm", candidates=as_poses(robot, turned))
    data = calib.simulate(robot, robot.sample(20, seed=1), seed=2)
    (said,) = numbers_of(r"over (\d+) candidates", told.update(data).report())
    assert said == pytest.approx(reached, abs=2)  # the fit's robot reaches a little more or less
