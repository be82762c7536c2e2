"""Readings of joints: derivatives through loops, a known truth found again, intervals, and input that cannot be."""

from pathlib import Path

import numpy as np

import calib
from calib.core.rows.observed import predict_readings
from tests.kind_checks import assert_found
from tests.project import EXAMPLES, copied, write_table
from tests.small_robots import ARM_YAML, PARALLELOGRAM_YAML, write_arm, write_parallelogram
from viz.reading_errors import reading_errors_of_fit as readings_of_fit

TRUTH = {"right_motor.x": 0.1011, "left_elbow.x": 0.1993, "left_end.x": 0.3008, "right_elbow.x": 0.2004}
TRUTH |= {"left_motor.rz": 0.01, "right_motor.rz": -0.015}
ZERO = 2.9
"""What the encoder reads where the left elbow is straight: far from what the description says (0)."""
SIGMA = 1e-5


def five_bar(folder, encoders=""):
    """The five-bar of the examples, whose left elbow has an encoder."""
    entry = f"instruments:\n  elbow: {{kind: joint_reading, joint: left_elbow, zero: unknown}}\n{encoders}"
    edits = ("sigma: 0.02 mm", entry), ("priors: false", ""), ("pose: unknown", "pose: known")
    return calib.load(copied(folder, EXAMPLES / "five_bar.yaml", *edits))


def elbows(robot, q):
    """Angles of both elbows, by the law of cosines from where the motors and the common tip are."""
    value = dict(zip([p.name for p in robot.parameters], robot.values, strict=True))
    motor = {side: np.array([value[f"{side}_motor.x"], value[f"{side}_motor.y"]]) for side in ("left", "right")}
    crank = {side: q[:, k] + value[f"{side}_motor.rz"] for k, side in enumerate(("left", "right"))}
    knee = {
        side: motor[side] + value[f"{side}_elbow.x"] * np.stack([np.cos(crank[side]), np.sin(crank[side])], axis=1)
        for side in motor
    }
    across = knee["right"] - knee["left"]
    distance = np.linalg.norm(across, axis=1)
    a, b = value["left_end.x"], value["right_end.x"]
    along = np.arctan2(across[:, 1], across[:, 0])
    left = along + np.arccos((a**2 + distance**2 - b**2) / (2 * a * distance)) - crank["left"]
    right = along + np.pi - np.arccos((b**2 + distance**2 - a**2) / (2 * b * distance)) - crank["right"]
    return np.mod(np.stack([left, right], axis=1) + np.pi, 2 * np.pi) - np.pi


def poses(robot, n, seed):
    return robot.home + np.random.default_rng(seed).uniform(-0.3, 0.3, (n, 2))


def test_a_passive_joint_is_read_as_the_law_of_cosines_says(tmp_path):
    robot = five_bar(tmp_path, "  other: {kind: joint_reading, joint: right_elbow, offset: 10 deg}\n")
    robot = robot.with_parameters(TRUTH | {"elbow.zero": 0.2})
    q = poses(robot, 20, 1)
    read = predict_readings(robot, robot.assemble(q))
    expected = elbows(robot, q) + np.array([0.2, np.radians(10)])
    np.testing.assert_allclose(read["elbow"].values[:, 0], expected[:, 0], atol=1e-11)
    np.testing.assert_allclose(read["other"].values[:, 0], expected[:, 1], atol=1e-11)


def test_a_follower_reads_what_its_leader_does(tmp_path):
    encoders = "instruments: {c: {kind: joint_reading, joint: c}, b: {kind: joint_reading, joint: b}}\n"
    robot = calib.load(write_parallelogram(tmp_path, PARALLELOGRAM_YAML + encoders))
    q = np.array([[0.6], [1.2], [2.0]])
    read = predict_readings(robot, robot.assemble(q))
    np.testing.assert_allclose(read["c"].values, q, atol=1e-12)
    np.testing.assert_allclose(read["b"].values, -q, atol=1e-12)


def held(folder):
    """The five-bar with what an encoder of its elbow determines free: no scale, no turn of all, one zero for two."""
    robot = five_bar(folder)
    names = "left_motor.x, left_motor.y, right_motor.y, right_motor.x, left_motor.rz, right_end.x"
    yaml = Path(robot.path).read_text().replace("held: [left_motor.x, left_motor.y, right_motor.y]", f"held: [{names}]")
    Path(robot.path).write_text(yaml + "priors: false\n")
    return calib.load(robot.path)


FREE = {name: TRUTH[name] for name in ("left_elbow.x", "left_end.x", "right_elbow.x", "right_motor.rz")}


def test_an_encoder_on_a_passive_joint_calibrates_a_loop(tmp_path):
    robot = held(tmp_path)
    q = poses(robot, 40, 4)
    read = elbows(robot.with_parameters(FREE), q)[:, :1] + ZERO
    fit = calib.fit(robot, calib.as_measurements(robot, q, {"elbow": read}))
    assert_found(fit.robot, FREE | {"elbow.zero": ZERO}, 1e-8)


def test_a_file_with_an_encoder_is_fitted_and_reported_in_degrees(tmp_path, run_calib):
    robot = held(tmp_path)
    q = poses(robot, 40, 6)
    read = elbows(robot.with_parameters(FREE), q)[:, 0] + ZERO
    read += 1e-4 * np.random.default_rng(0).standard_normal(40)
    header = "left_motor [deg],right_motor [deg],elbow [deg]"
    data = write_table(tmp_path / "data.csv", header, np.degrees(q), np.degrees(read))
    run = run_calib("fit", robot.path, data, "--out", tmp_path / "out", "--verbose")
    assert run.code == 0, run.err
    assert "\nelbow.zero,0.0,165.8" in (tmp_path / "out" / "parameters.csv").read_text()
    assert "mrad (none was stated)" in run.out


def test_an_encoder_alone_of_an_arm_determines_nothing_and_says_so(tmp_path, run_calib):
    """What an encoder of a commanded joint reads depends on no link."""
    encoder = "instruments:\n  encoder: {kind: joint_reading, joint: turn, sigma: 0.1 mrad}\n"
    arm, data = write_arm(tmp_path, ARM_YAML + encoder), tmp_path / "data.csv"
    rows = [f"{k},{9 * k},{0.01 * k},{5 * k},{9 * k}\n" for k in range(9)]
    data.write_text("pose,turn [deg],slide [m],wrist [deg],encoder [deg]\n" + "".join(rows))
    run = run_calib("fit", arm, data, "--out", tmp_path / "out")
    assert (run.code, "no reading depends on any free parameter" in run.err) == (3, True)
    assert run_calib("check", arm, data).code == 0


def test_an_encoder_is_validated_and_its_error_is_drawn_along_its_axis(tmp_path):
    robot = five_bar(tmp_path, "  pen: {kind: position, sigma: 0.02 mm}\n")
    data = calib.simulate(robot.with_parameters(TRUTH), poses(robot, 24, 3), None, 3)
    fit = calib.fit(robot, data.subset(np.arange(16)), validation=data.subset(np.arange(16, 24)))
    (drawn,) = readings_of_fit(fit)
    assert (len(drawn), drawn.turns, drawn.part.name) == (24, True, "angle")
    for state in ("before", "after"):
        off = np.concatenate([getattr(errors, state)["elbow"] for errors in (fit.identification, fit.validation)])
        arrows = drawn.arrows(state)
        np.testing.assert_allclose(np.linalg.norm(arrows, axis=1), np.abs(off[:, 0]), rtol=1e-9)
        np.testing.assert_allclose(arrows[:, 2], off[:, 0], atol=0.05 * np.abs(off).max())  # the axis is nearly upright
