"""Measuring and calibrating at once: the next pose, unseen errors, the growing file, the command."""

import json
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.planning import next_pose as choice
from calib.planning.predicted_error import RootMeanSquare, predicted_rms
from calib.planning.progress import LAST, LEAST, unseen_rms
from calib.planning.watch import GrowingFile
from tests.child_programs import start
from tests.project import EXAMPLES

LINES = (EXAMPLES / "arm_simulated.csv").read_text().splitlines(keepends=True)
UNCHECKED = (
    "note: collisions are not checked: the robot file has no collision shapes, and the description names no obstacles\n"
)
HEADER = next(k for k, line in enumerate(LINES) if not line.startswith("#")) + 1  # lines up to the header
WATCH = ("watch", EXAMPLES / "arm.yaml")


def write(path, n, *more):
    """Write the first n measured poses, then further lines; return the path."""
    path.write_text("".join([*LINES[: HEADER + n], *more]))
    return path


@pytest.fixture
def growing(robot, tmp_path):
    """A file that is not there yet, and its path."""
    return GrowingFile(str(tmp_path / "growing.csv"), robot), tmp_path / "growing.csv"


@pytest.fixture(scope="module")
def candidates(robot):
    return calib.sample(robot, 20, seed=2)


@pytest.mark.parametrize("lasts", [4, 2])
def test_a_predicted_error_is_the_mean_over_positions_and_its_interval_that_of_random_parameters(lasts):
    rng = np.random.default_rng(0)
    jacobian, root = rng.standard_normal((6, 2, 3, 4)), rng.standard_normal((4, 4))
    covariance = root @ root.T
    lasting = np.arange(4) < lasts
    covariance *= lasting[:, None] == lasting
    prediction = predicted_rms(jacobian, covariance, 1.959964, lasting)
    mean = np.mean([np.trace(B @ covariance @ B.T) for B in jacobian.reshape(12, 3, 4)])
    assert prediction.value == pytest.approx(np.sqrt(mean))
    drawn = np.linalg.cholesky(covariance) @ rng.standard_normal((6, 1, 4, 4000))
    drawn[:, :, lasting] = drawn[:1, :, lasting]  # the same at every pose
    errors = jacobian @ drawn
    rms = np.sqrt(np.mean(np.sum(errors**2, axis=2), axis=(0, 1)))
    inside = np.mean((rms > prediction.low95) & (rms < prediction.high95))
    assert 0.93 < inside < 0.98  # two moments are matched, not the distribution


@pytest.mark.parametrize("n", [LEAST, LAST])
@pytest.mark.parametrize(
    ("spread", "tail"), [([1, 1, 1], 0.0), ([1, 0.3, 0.1], 0.0), ([1, 0, 0], 0.0), ([1, 1, 1], 0.4)]
)
def test_the_upper_end_of_unseen_errors_holds_as_often_as_it_says(spread, tail, n):
    rng = np.random.default_rng(1)
    size = np.exp(tail * rng.standard_normal((1500, n)))
    squares = np.sum((spread * rng.standard_normal((1500, n, 3))) ** 2, axis=2) * size**2
    true = np.sqrt(np.sum(np.square(spread)) * np.exp(2 * tail**2))  # mean of the square of a log-normal number
    intervals = [unseen_rms(list(square)) for square in squares]
    assert np.mean([true < interval.high95 for interval in intervals]) > 0.94  # 0.95 and more, less what 1500 tell
    assert np.mean([interval.low95 < true for interval in intervals]) > 0.94


def test_few_unseen_errors_tell_nothing():
    assert unseen_rms([1e-8] * (LEAST - 1)) == RootMeanSquare(np.inf, 0.0, np.inf)
    assert unseen_rms([1e-8] * LEAST).value == pytest.approx(1e-4)


@pytest.fixture(scope="module")
def errors_with(robot, data, candidates):
    """Predicted error over the candidates with 30 measured poses, and with each candidate measured too, [m]."""
    task, measured = candidates.joints, data.joints[:30]
    tried = [measured, *(np.vstack([measured, q]) for q in task)]
    now, *each = (calib.check(robot, joints, task=task).accuracy.rms for joints in tried)
    return now, np.array(each)


def test_the_next_pose_is_the_best_of_all_tried_one_by_one(robot, data, candidates, errors_with, monkeypatch):
    monkeypatch.setattr(choice, "ENOUGH", 1.0)
    chosen = choice.next_pose(robot, candidates, data[:30])
    now, each = errors_with
    assert chosen.candidate == int(np.argmin(each))
    assert chosen.before == pytest.approx(now, rel=1e-6)
    assert chosen.after == pytest.approx(min(each), rel=1e-6)


def test_of_poses_that_help_nearly_as_much_the_nearest_is_taken(robot, data, candidates, errors_with):
    now, each = errors_with
    gains, task = now**2 - each**2, candidates.joints
    good = np.flatnonzero(gains >= 0.8 * gains.max())
    for present in (task[3], task[11] + 0.1):
        chosen = choice.next_pose(robot, candidates, data[:30], present=present)
        ways = np.max(np.abs(task - present) / np.ptp(task, axis=0), axis=1)
        assert chosen.candidate == good[np.argmin(ways[good])]


def test_poses_lead_to_a_calibration_before_they_determine_the_robot(robot, candidates):
    measured: list[int] = []
    for _ in range(12):
        chosen = choice.next_pose(robot, candidates, None if not measured else candidates.joints[measured])
        assert chosen.candidate not in measured
        measured.append(chosen.candidate)
    assert np.isfinite(chosen.before)
    assert choice.next_pose(robot, calib.as_poses(robot, candidates.joints[measured]), candidates.joints) is None


@pytest.mark.quick(0)
def test_every_pose_is_judged_before_it_is_fitted(robot, data, candidates):
    watch = calib.Watch(robot, "0.1 mm", candidates=candidates)
    told = watch.update()
    assert (told.fit, told.stop, told.next_pose is None) == (None, False, False)
    assert watch.update(data[:4]).reason_without_fit is not None
    for n in range(20, 20 + LAST):
        told = watch.update(data[:n])
    squares = []
    for n in range(20, 19 + LAST):
        fit = calib.fit(robot, data[:n])
        squares.append(float(np.sum((fit.robot.positions(data.joints[[n]]) - data[[n]].points(robot)) ** 2)))
    assert told.n_unseen == len(squares) == LAST - 1
    assert told.unseen.value == pytest.approx(np.sqrt(np.mean(squares)), rel=1e-3)  # solver tolerance
    assert told.fit.robot.values == pytest.approx(calib.fit(robot, data[:39]).robot.values)


def test_of_a_finished_file_the_last_poses_are_judged_by_the_others(robot, data, candidates):
    told = calib.Watch(robot, 1e-4, candidates=candidates).update(data)
    fit = calib.fit(robot, data[:-LAST])
    off = fit.robot.positions(data[-LAST:].joints) - data[-LAST:].points(robot)
    assert told.unseen.value == pytest.approx(np.sqrt(np.mean(np.sum(off**2, axis=2))))
    assert told.stop
    assert "STOP" in str(told)


def test_it_says_stop_only_where_both_intervals_keep_the_goal(robot, data, candidates):
    told = calib.Watch(robot, 1e-4, candidates=candidates).update(data)
    good, bad = RootMeanSquare(8e-5, 7e-5, 9e-5), RootMeanSquare(9.5e-5, 8e-5, 1.1e-4)
    worse = RootMeanSquare(2e-4, 1.5e-4, 3e-4)
    for predicted, unseen, n_settled, stop, out_of_reach in (
        (good, good, told.n_settled, True, False),
        (bad, good, told.n_settled, False, False),
        (good, bad, told.n_settled, False, False),
        (good, worse, told.n_unseen, False, True),
        (good, worse, 3, False, False),
    ):
        changed = replace(told, predicted=predicted, unseen=unseen, n_settled=n_settled)
        assert (changed.stop, changed.out_of_reach) == (stop, out_of_reach)


@pytest.mark.quick(0)
def test_poses_to_check_with_are_drawn_at_random(robot, data, candidates):
    watch = calib.Watch(robot, 1e-4, candidates=candidates, seed=3)
    first = watch.update(data[:-1])  # its predicted error meets the goal
    assert first.predicted.high95 < 1e-4
    second = watch.update(data)
    assert second.next_pose.checks
    assert "drawn at random" in replace(second, goal=1e-5).report()
    again = calib.Watch(robot, 1e-4, candidates=candidates, seed=3)
    again.update(data[:-1])
    assert again.update(data).next_pose.candidate == second.next_pose.candidate
    early = calib.Watch(robot, 1e-6, candidates=candidates, seed=3).update(data)
    assert not early.next_pose.checks


@pytest.mark.quick(0)
def test_poses_since_the_goal_was_promised_are_what_counts(robot, data, candidates):
    watch = calib.Watch(robot, 2e-4, candidates=candidates)
    for n in range(20, 60):
        told = watch.update(data[:n])
        if told.lowered.high95 <= told.goal:
            promised = n
            break
    for n in range(promised + 1, promised + 1 + LEAST):
        told = watch.update(data[:n])
    assert (told.n_unseen, told.n_settled) == (LEAST, LEAST)


def test_what_is_measured_again_was_seen_and_measurements_that_do_not_go_on_are_judged_anew(robot, data, candidates):
    watch = calib.Watch(robot, 1e-4, candidates=candidates)
    watch.update(data[:30])
    before = watch.update(data[:31])
    assert watch.update(data[[*range(31), 5, 6]]).n_unseen == before.n_unseen > 0
    told = watch.update(data[20:40])
    assert (told.n_unseen, told.n_poses) == (0, 20)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [({"goal": "0.1 deg"}, "a length is expected"), ({"goal": 0.0}, "positive"), ({"goal": "fine"}, "finite number")],
)
def test_a_goal_is_a_positive_length(robot, arguments, words):
    with pytest.raises(calib.InputError, match=words):
        calib.Watch(robot, **arguments)


def test_a_half_written_line_is_waited_for(growing):
    file, path = growing
    assert file.read_changes() is None
    for n, rest, n_read in (
        (0, "", None),
        (3, LINES[HEADER + 3][:-4], 3),
        (3, LINES[HEADER + 3][:-1], None),
        (4, "", 4),
    ):
        write(path, n, rest)
        told = file.read_changes()
        assert (None if told is None else len(told)) == n_read
    assert file.read_changes() is None
    write(path, 0, LINES[HEADER].rsplit(",", 3)[0] + ",,,\n")  # a row without readings
    assert file.read_changes() is None


def test_a_file_is_followed_until_the_goal_holds(run_calib, tmp_path):
    path, state = write(tmp_path / "growing.csv", 60), tmp_path / "state.json"

    def grow():
        for k in (65, 72, 80):
            time.sleep(0.6)
            write(path, k)

    writer = threading.Thread(target=grow)
    writer.start()
    run = run_calib(*WATCH, path, "--goal", "0.08mm", "--every", "0.1", "--json", state)
    writer.join()
    assert (run.code, run.err) == (0, UNCHECKED)
    assert "not yet" in run.out
    assert "STOP" in run.out
    content = json.loads(state.read_text())
    assert content["stop"] is True
    assert content["poses"] > 60
    assert content["predicted_mm"]["high95"] <= 0.08
    assert content["next"]["joints"]["joint_1"]["unit"] == "deg"


def test_every_state_is_a_line_for_programs(run_calib):
    run = run_calib(*WATCH, EXAMPLES / "arm_simulated.csv", "--goal", "0.1mm", "--once", "--json", "-")
    (line,) = run.out.splitlines()
    content = json.loads(line)
    assert (run.code, content["stop"], content["poses"]) == (0, True, 80)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--goal", "0.1"), "write its unit, such as 0.1mm"),
        (("--goal", "0.1mm", "--view"), "leave one of them out"),
        (("--goal", "0.1mm", "--every", "0"), "--every"),
        ((), "--goal"),
    ],
)
def test_bad_input_is_one_line(run_calib, arguments, words):
    run = run_calib(*WATCH, EXAMPLES / "arm_simulated.csv", "--once", *arguments)
    assert words in run.refusal()


@pytest.mark.quick(0)
def test_too_few_poses_and_lines_that_cannot_be_read_are_errors_only_where_nobody_waits(run_calib, tmp_path):
    once = ("--goal", "0.1mm", "--once")
    run = run_calib(*WATCH, write(tmp_path / "few.csv", 4), *once)
    assert run.code == 3  # they do not determine the robot
    assert "next: pose" in run.out
    assert run.err.count("\n") == 1
    path = write(tmp_path / "few.csv", 3, "what\n", *LINES[HEADER + 3 : HEADER + 30])
    run = run_calib(*WATCH, path, *once)
    assert (run.code, run.out) == (2, "")
    assert run.err.startswith(f"calib: {path}, line {HEADER + 4}: 1 cells for")


def test_a_line_that_cannot_be_read_is_told_and_passed_over(growing):
    file, path = growing
    good, word = LINES[HEADER : HEADER + 5], LINES[HEADER + 5].replace(",", ",x", 1)
    write(path, 3, "what\n", good[3])
    assert file.read_changes().names == tuple(line.split(",")[0] for line in good[:4])
    (said,) = file.remarks()
    assert said.startswith(f"{path}, line {HEADER + 4}: 1 cells for")
    assert said.endswith("; this line is skipped until it is corrected")
    with path.open("a") as stream:
        stream.write(word + good[4])
    assert len(file.read_changes()) == 5
    (said,) = file.remarks()  # the first one is not told again
    assert said.startswith(f"{path}, line {HEADER + 6}, column 'joint_1': 'x")
    path.write_text(path.read_text().replace(word, word.replace(",x", ",", 1)))
    assert len(file.read_changes()) == 6
    assert not file.remarks()


def test_a_pose_that_cannot_be_assembled_is_passed_over(tmp_path):
    five_bar = calib.load(EXAMPLES / "five_bar.yaml")
    lines = (EXAMPLES / "five_bar_simulated.csv").read_text().splitlines(keepends=True)
    head = next(k for k, line in enumerate(lines) if not line.startswith("#")) + 1
    cells, columns = lines[head + 2].split(","), lines[head - 1].split(",")
    turned = np.radians(np.stack(np.meshgrid(*2 * [np.arange(0, 360, 15.0)]), axis=-1).reshape(-1, 2))
    never = np.degrees(turned[~five_bar.close(turned).ok][0])
    for name, angle in zip(five_bar.joint_names, never, strict=True):
        cells[columns.index(f"{name} [deg]")] = repr(float(angle))
    path = tmp_path / "growing.csv"
    path.write_text("".join([*lines[: head + 2], ",".join(cells), *lines[head + 3 : head + 6]]))
    file = GrowingFile(str(path), five_bar)
    assert len(file.read_changes()) == 5
    assert f"line {head + 3}" in file.remarks()[0]


@pytest.mark.quick(0)
def test_a_file_of_which_no_line_can_be_read_is_an_error(run_calib, tmp_path):
    path = tmp_path / "other.csv"
    wrong = "".join([*LINES[:HEADER], 120 * "what\n", *LINES[HEADER : HEADER + 5]])
    for text, said in (("a,b\n1,2\n3,4\n", "no column 'joint_1'"), (wrong, "1 cells")):
        path.write_text(text)
        run = run_calib(*WATCH, path, "--goal", "0.1mm")
        assert run.code == 2
        assert said in run.err


@pytest.mark.quick(0)
def test_ctrl_c_ends_it_in_order(tmp_path):
    command = [sys.executable, "-m", "calib", *map(str, WATCH), str(write(tmp_path / "few.csv", 4)), "--goal", "0.1mm"]
    started = start(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        while "joint_1" not in started.stdout.readline():  # it has told about the file
            pass
        time.sleep(0.2)
        started.send_signal(signal.SIGINT)
        _, err = started.communicate(timeout=30)
    finally:
        started.kill()
        started.communicate()
    assert (started.returncode, err) == (0, UNCHECKED + "ended\n")
