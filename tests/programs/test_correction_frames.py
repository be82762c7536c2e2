"""Programs are meant in a frame that measurements know: no good robot is harmed, and what is promised is kept."""

import json
from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.core.results.result_reading import load_result
from calib.core.rows.frames import KnownRobot
from calib.core.rows.prediction import ParameterUncertainty
from calib.programs.reaching.correction_frames import measurement_frame, program_frame
from tests.core.rows.test_common_motion import ELSEWHERE, arm
from tests.programs.compensated_robots import FORMS, OF_THREE_AXES, Trial, described, lengths, rms


def program(robot, n=20):
    return robot.sample(n, seed=5)


@pytest.fixture(scope="module")
def nominal_delta(tmp_path_factory):
    """A delta that is exactly as described, calibrated, and its result."""
    folder = tmp_path_factory.mktemp("delta")
    trial = Trial.of(described("delta", folder, "unknown"), errors=False, seed=1)
    trial.fit.save(folder / "result", pages=False)
    return trial, folder / "result"


@pytest.mark.quick(0)
@pytest.mark.parametrize(
    "name",
    [pytest.param("five_bar", marks=pytest.mark.amount(1, 4)), pytest.param("delta", marks=pytest.mark.amount(0, 2))],
)
def test_robots_with_errors_are_off_by_what_is_promised_of_every_form_of_program(tmp_path, name, amount):
    """Base and tool unknown; row by row, one standard deviation of such a ratio is 0.15 to 0.2 of these few robots."""
    nominal, errors = described(name, tmp_path, "unknown"), {}
    for seed in range(amount):
        trial = Trial.of(nominal, errors=True, seed=seed)
        assert not trial.fit.known_robot.nothing_to_correct
        for form, judge in FORMS.items():
            if form not in OF_THREE_AXES or name == "delta":
                errors.setdefault(form, []).append(judge(trial, trial.fit.known_robot)[""])
    for form, cells in errors.items():
        after, promised, _, before, _ = (np.concatenate(part) for part in zip(*cells, strict=True))
        assert 0.6 < rms(after / promised) < 1.5, form
        assert form == "solve" or rms(after) < 0.03 * rms(before), form


@pytest.mark.quick(0)
def test_what_a_point_of_unknown_place_leaves_open_is_counted_and_not_corrected(tmp_path):
    """The last origin may be off by 1 mm, the point by the half; of s together the first is 0.8 s +- 0.447 mm."""
    nominal = arm(tmp_path, "known", "unknown, sigma: 0.5 mm")
    trial = Trial.of(nominal, errors=True, seed=7)
    together = sum(
        value - parameter.nominal_si
        for parameter, value in zip(nominal.parameters, trial.truth.values, strict=True)
        if parameter.name in ("j6.x", "ball.x")
    )
    after, expected, high95, *_ = FORMS["joints"](trial, trial.known(False))[""]
    assert expected == pytest.approx(np.hypot(0.8 * together, 1e-3 * np.sqrt(0.2)), rel=0.02)  # the noise is small
    assert 0.5 * rms(expected) < rms(after) < rms(high95)
    compensation = calib.compensate(trial.known(False), trial.program)
    for angles in (compensation.expected_angle, compensation.high95_angle):
        # only errors of joints turn this robot, as far as noise that is not stated could be these
        assert np.all(angles[compensation.ok] < 5e-5)
    unharmed = Trial.of(nominal, errors=False, seed=1)
    moved = FORMS["joints"](unharmed, unharmed.known(False))[""][0]
    assert rms(moved) < 0.05e-3  # though the point is elsewhere by 0.5 mm


@pytest.mark.quick(0)
@pytest.mark.parametrize("name", ["five_bar", pytest.param("rail_and_five_bar", marks=pytest.mark.amount(0, 1))])
def test_a_good_robot_stays_as_it_is_and_would_not_be_harmed_either_way(tmp_path, name):
    """These moved by 0.15 to 0.47 mm, ten to forty times what was promised, along what priors alone hold."""
    nominal = described(name, tmp_path, "unknown")
    trial = Trial.of(nominal, errors=False, seed=0)
    known = trial.fit.known_robot
    assert known.nothing_to_correct
    kept = calib.compensate(trial.fit, trial.program)
    np.testing.assert_array_equal(kept.q, trial.program)
    assert kept.nothing_to_correct
    corrected = calib.compensate(replace(known, nothing_to_correct=False), trial.program)
    moved = lengths(nominal.positions(corrected.q)[:, 0] - nominal.positions(trial.program)[:, 0])
    assert rms(moved) < 1.6 * rms(corrected.expected) < 0.03e-3
    # what is not corrected is counted into what is expected
    assert kept.expected == pytest.approx(np.hypot(kept.before, corrected.expected), rel=0.05)


def test_a_robot_that_only_stands_elsewhere_is_laid_exactly(tmp_path):
    robot = arm(tmp_path)
    there = robot.with_parameters(ELSEWHERE | {"ball.x": 0.08, "ball.z": 0.07})
    q = program(robot)
    for joints in (q[:12], np.zeros((0, 6))):  # measured, or around home
        frame = program_frame(KnownRobot(there, None, joints, nothing_to_correct=False))
        assert np.abs(frame.meant.forward(q) - there.forward(q)).max() < 1e-9
    assert "nominal robot's base frame" in frame.words
    assert np.isnan(frame.predict(q).covariance).all()  # the robot's uncertainty is not stated


@pytest.mark.quick(0)
def test_uncertainty_beside_common_motion_follows_parameters_as_differences_say(tmp_path):
    nominal = described("five_bar", tmp_path, "unknown")
    rng = np.random.default_rng(2)
    own = [p for p in nominal.parameters if not p.placement]
    small = {p.name: p.nominal_si + 0.05 * p.sigma_si * rng.standard_normal() for p in own}
    robot, joints, q = nominal.with_parameters(small | ELSEWHERE), program(nominal, 30), program(nominal, 40)[30:]

    def off(moved):
        """Where it is in the frame of the program."""
        frame = program_frame(KnownRobot(moved, None, joints, nothing_to_correct=False))
        return frame.robot.positions(q)[:, 0] - frame.meant.positions(q)[:, 0]

    step, names = 1e-5, [parameter.name for parameter in nominal.parameters]
    for name in ("left_motor.y", "right_end.x", "base.ry"):
        k = names.index(name)
        parameter, free = nominal.parameters[k], np.arange(len(names)) == k
        sure = ParameterUncertainty(free, np.array([[1.0]]), 1.96)
        spread = program_frame(KnownRobot(robot, sure, joints, nothing_to_correct=False)).predict(q).std[:, 0]
        there, back = (off(robot.with_parameters({parameter.name: robot.values[k] + h})) for h in (step, -step))
        assert np.abs(np.abs(there - back) / (2 * step) - spread).max() < 2e-3  # its errors turn links by 0.2 mrad
        assert not parameter.placement or spread.max() < 2e-3, parameter.name  # a place moves nothing


def test_an_unknown_orientation_of_the_tool_is_laid_too(tmp_path):
    robot = arm(
        tmp_path, tool="unknown, orientation: unknown", extra="instruments: {six: {kind: pose, target: ball}}\n"
    )
    there = robot.with_parameters(ELSEWHERE | {"ball.rx": 0.3, "ball.ry": -0.2, "ball.y": 0.05})
    q = program(robot)
    frame = program_frame(KnownRobot(there, None, q[:12], nothing_to_correct=False))
    assert np.abs(frame.meant.forward(q) - there.forward(q)).max() < 1e-9


def test_a_measured_frame_counts_all_that_moves_positions(tmp_path):
    nominal = described("five_bar", tmp_path, "known")
    trial = Trial.of(nominal, errors=True, seed=3)
    frames = program_frame(trial.fit.known_robot), measurement_frame(trial.fit.known_robot)
    absolute = trial.fit.predict(trial.program)
    for frame in frames:
        assert frame.words == "in the measurement frame"
        np.testing.assert_allclose(frame.predict(trial.program).covariance, absolute.covariance, rtol=1e-9, atol=1e-24)


def test_goals_in_the_measurement_frame_are_missed_by_what_is_expected(nominal_delta):
    """The nominal robot reaches them where nothing is to be corrected, laid on the calibrated one."""
    trial, _ = nominal_delta
    goals = trial.fit.robot.positions(trial.program[:20])[:, 0]
    solution = calib.solve(trial.fit, goals)
    assert solution.ok.all()
    missed = lengths(trial.truth.positions(solution.q)[:, 0] - goals)
    assert rms(missed) < rms(solution.expected.distance) < 0.1e-3
    assert np.abs(solution.q - trial.program[:20]).max() > 1e-6
    corrected = calib.solve(replace(trial.fit.known_robot, nothing_to_correct=False), goals)
    np.testing.assert_allclose(corrected.q, trial.program[:20], atol=1e-7)
    assert np.isnan(calib.solve(trial.fit.robot, goals).expected.distance).all()


def test_along_coordinates_that_are_not_asked_for_nothing_is_expected(tmp_path):
    trial = Trial.of(described("five_bar", tmp_path, "known"), errors=True, seed=3)
    goals = trial.fit.robot.positions(trial.program[:5])[:, 0]
    in_plane = np.column_stack([goals[:, :2], np.full(5, np.nan)])
    solution = calib.solve(trial.fit, in_plane)
    spread = trial.fit.predict(solution.q).std[:, 0]
    assert solution.expected.distance == pytest.approx(np.hypot(spread[:, 0], spread[:, 1]), rel=1e-6)


@pytest.mark.quick(0)
def test_a_result_folder_knows_the_frame_as_the_fit_does(nominal_delta):
    trial, folder = nominal_delta
    known, again = trial.fit.known_robot, load_result(folder, trial.nominal).known_robot
    assert again.nothing_to_correct
    np.testing.assert_allclose(again.joints, known.joints, rtol=1e-14)
    frames = [program_frame(replace(item, nothing_to_correct=False)) for item in (known, again)]
    assert frames[0].words == frames[1].words
    here, there = (frame.predict(trial.program) for frame in frames)
    np.testing.assert_allclose(here.covariance, there.covariance, rtol=1e-4, atol=1e-16)  # of (10 um)^2
    assert np.abs(frames[0].meant.positions(trial.program) - frames[1].meant.positions(trial.program)).max() < 1e-10


@pytest.mark.quick(0)
def test_commands_leave_a_good_robot_alone_and_say_so(nominal_delta, tmp_path, run_calib):
    folder = nominal_delta[1]
    (tmp_path / "part.gcode").write_text("G28\nG90\nG1 X10 Y0 Z-400 F600\nG1 X-20.5 Y15 ; there\n")
    names = ("tool_x [mm]", "tool_y [mm]", "tool_z [mm]")
    (tmp_path / "box.csv").write_text(f"{','.join(names)}\n-20,-20,-400\n20,20,-390\n")
    (tmp_path / "joints.csv").write_text("arm_1,arm_2,arm_3\n0.1,0.2,-0.05\n0,0.125,0.1\n")
    done = {
        name: run_calib("compensate", folder, tmp_path / source, "--out", tmp_path / f"out_{source}", *options)
        for name, source, options in (
            ("moves", "part.gcode", ()),
            ("grid", "box.csv", ("--grid", "2,2,2")),
            ("rows", "joints.csv", ("--json", tmp_path / "rows.json")),
        )
    }
    for item in done.values():
        assert item.code == 0, item.err
        assert f"the verdict of {folder} is that nothing is to be corrected" in item.out
        assert "is expected to be off by 0.0" in item.out
        assert "Errors are in the nominal robot's base frame (fitted to the calibrated robot" in item.out
    written = (tmp_path / "out_part.gcode").read_text()
    assert written.splitlines()[1:-1] == (tmp_path / "part.gcode").read_text().splitlines()
    table = [line.split(",") for line in (tmp_path / "out_box.csv").read_text().splitlines()[2:-1]]
    assert np.all(np.array(table, dtype=float)[:, 3:] == 0)
    rows = json.loads((tmp_path / "rows.json").read_text())
    assert rows["nothing_to_correct"]
    assert "Expected errors count noise and priors, " in done["moves"].out
    assert {"noise and priors", "frame"} <= set(rows["contains"])
    assert [row["joints"]["arm_2 [deg]"] for row in rows["rows"]] == pytest.approx(np.degrees([0.2, 0.125]), abs=1e-12)


@pytest.mark.quick(0)
def test_solve_writes_what_is_expected_at_each_target(nominal_delta, tmp_path, run_calib):
    trial, folder = nominal_delta
    goal = 1e3 * trial.fit.robot.positions(trial.program[:1])[0, 0]
    (tmp_path / "goals.csv").write_text("tool_x [mm],tool_y [mm],tool_z [mm]\n" + ",".join(map(repr, goal.tolist())))
    out, content = tmp_path / "out.csv", tmp_path / "out.json"
    done = run_calib("solve", folder, tmp_path / "goals.csv", "--out", out, "--json", content)
    assert done.code == 0, done.err
    assert "The real robot is expected to be off by 0.0" in done.out
    assert "Errors are in the measurement frame, base and targets where the calibration found them." in done.out
    header, cells = (line.split(",") for line in out.read_text().splitlines()[1:-1])
    row = dict(zip(header, map(float, cells), strict=True))
    assert 0 < row["low95 [mm]"] < row["expected [mm]"] < row["high95 [mm]"] < 0.2
    assert json.loads(content.read_text())["targets"][0]["expected_mm"] == pytest.approx(row["expected [mm]"])
    plain = run_calib("solve", folder / "nominal.yaml", tmp_path / "goals.csv", "--skip-unreachable", "--out", out)
    assert "expected" not in plain.out
    assert "expected" not in out.read_text() if plain.code == 0 else plain.code == 2
