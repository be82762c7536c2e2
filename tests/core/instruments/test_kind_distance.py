"""Distances: a known truth found again, intervals that hold it, and input that cannot be."""

import numpy as np
import pytest

import calib
from calib.core.numerics.rigid import centre, common_offset
from calib.core.rows.observed import predict_readings
from calib.core.rows.registration import register
from tests.kind_checks import assert_found, chain_error
from tests.project import EXAMPLES, copied
from tests.six_axis_arm import HEAD, free, joints, write_six_axis
from tests.small_robots import ARM_YAML, write_arm

ORIGINS = {"j2.ry": 0.01, "j3.ry": -0.02, "j4.rx": 0.01, "j5.ry": 0.015, "j2.x": 0.052, "j3.z": 0.602, "j5.x": 0.397}
BALL = {"ball.x": 0.08, "ball.y": -0.03, "ball.z": 0.15}
TRUTH = ORIGINS | BALL
YAML = f"""\
{HEAD}priors: false
base: {{frame: l0}}
targets: {{ball: {{frame: l6, xyz: [50 mm, 20 mm, 100 mm], position: unknown}}}}
instruments:
  wire: {{kind: distance, target: ball, end: {{frame: l0, position: unknown}}, offset: unknown}}
  beam: {{kind: distance, target: ball, end: {{frame: l0, xyz: [1, 0, 0], position: unknown}}, sigma: 0.02 mm}}
  gauge: {{kind: distance, target: ball, end: {{frame: l0, xyz: [0.3, -0.9, 0.1]}}, offset: 12 mm}}
parametrisation:
{free(*ORIGINS)}"""
ENDS = {"wire": [-1.4, 0.0, 0.2], "beam": [0.9, 1.3, -0.4], "gauge": [0.3, -0.9, 0.1]}
OFFSETS = {"wire": 0.25, "beam": 0.0, "gauge": 0.012}


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return calib.load(write_six_axis(tmp_path_factory.mktemp("arm"), YAML))


def read(truth, q):
    """What the three instruments read, by plain numpy."""
    ball = truth.positions(q)[:, 0]
    return {name: np.linalg.norm(ball - end, axis=1)[:, None] + OFFSETS[name] for name, end in ENDS.items()}


def test_the_truth_is_found_from_bad_first_guesses(arm):
    q, truth = joints(60, seed=3), arm.with_parameters(TRUTH)
    ends = {f"{name}_end.{axis}": ENDS[name][k] for name in ("wire", "beam") for k, axis in enumerate("xyz")}
    fit = calib.fit(arm, calib.as_measurements(arm, q, read(truth, q)))
    assert_found(fit.robot, TRUTH | ends | {"wire.offset": OFFSETS["wire"]}, 1e-7)


def test_the_fixed_point_of_a_planar_robot_stays_on_the_side_where_it_is_believed(tmp_path):
    for side in (1, -1):
        end = f"{{frame: table, xyz: [0, 0, {0.1 * side}], position: unknown}}"
        known = ("pose: unknown", "pose: known")
        wire = ("sigma: 0.02 mm", f"instruments: {{wire: {{kind: distance, target: pen, end: {end}}}}}\n")
        robot = calib.load(copied(tmp_path, EXAMPLES / "five_bar.yaml", known, wire))
        q = robot.home + np.random.default_rng(5).uniform(-0.4, 0.4, (20, 2))
        assert chain_error(robot, q[:4], predict_readings(robot, robot.assemble(q[:4]))) <= 1e-6
        end = np.array([0.4, -0.3, 0.5 * side])
        distances = np.linalg.norm(robot.positions(q)[:, 0] - end, axis=1)
        placed = register(robot, calib.as_measurements(robot, q, {"wire": distances[:, None]}))
        np.testing.assert_allclose(placed.mechanism.placement("wire_end").translation, end, atol=1e-7)


def test_multilateration_in_space_in_a_plane_and_on_a_line():
    rng = np.random.default_rng(6)
    points, c = rng.normal(size=(12, 3)), np.array([0.7, -1.1, 2.0])
    distance = lambda p: np.linalg.norm(p - c, axis=1)  # noqa: E731
    np.testing.assert_allclose(centre(points, distance(points), np.zeros(3)), c, atol=1e-12)
    assert abs(common_offset(points, distance(points) + 0.3, np.zeros(3), 0.0) - 0.3) < 1e-12
    flat = points * [1, 1, 0]
    np.testing.assert_allclose(centre(flat, distance(flat), np.array([0, 0, 0.1])), c, atol=1e-12)
    np.testing.assert_allclose(centre(flat, distance(flat), np.array([0, 0, -0.1])), c * [1, 1, -1], atol=1e-12)
    line = points * [1, 0, 0]
    result = centre(line, distance(line), np.array([5.0, 0.0, -1.0]))
    np.testing.assert_allclose(result, [0.7, 0.0, -np.hypot(1.1, 2.0)], atol=1e-12)


def test_a_negative_distance_is_named(arm):
    columns = {"gauge_distance": np.array([1.2, 0.8, 0.9, -0.5, 1.1])}
    with pytest.raises(calib.CalibrationError, match="'gauge', reading 4: gauge_distance is -500 mm"):
        arm.instrument("gauge").values(columns)


def test_a_target_at_the_fixed_point_is_an_error(arm):
    q = joints(5)
    ball = arm.positions(q)[2, 0]
    there = arm.with_parameters({f"beam_end.{axis}": ball[k] for k, axis in enumerate("xyz")})
    data = calib.as_measurements(there, q, read(arm, q))
    with pytest.raises(calib.CalibrationError, match="instrument 'beam': its target 'ball' is within"):
        calib.core.rows.observed.observe(there, there.assemble(q), data.readings)


def test_a_ballbar_does_not_see_where_the_base_stands_and_check_says_so(tmp_path, run_calib):
    yaml = YAML.replace("base: {frame: l0}", "base: {frame: l0, pose: unknown}")
    run = run_calib("check", write_six_axis(tmp_path, yaml))
    assert run.code == 0, run.err
    open_lines = run.out.split("Hold one of each of these")[1].split("With all")[0].splitlines()[1:]
    assert [line.strip() for line in open_lines if line] == [
        "base.x, base.y, base.z, base.rx, base.ry, base.rz have no effect"
    ]


@pytest.mark.parametrize("error", [-0.01, 0.01])
def test_an_end_that_errors_of_the_robot_draw_into_the_plane_of_its_motion_is_found(tmp_path, error):
    """With the arm as drawn, its distances say that the wire ends in the plane, from where no distance sees its height.

    The arm turns about z and slides outwards: its tip is at Rz(turn) (slide + a, b, c), in closed form.
    """
    yaml = (
        ARM_YAML.partition("parametrisation:")[0]
        + """\
priors: false
instruments:
  wire: {kind: distance, target: tip, sigma: 0.01 mm, end: {frame: ground, xyz: [1, 1, 1], position: unknown}}
parametrisation: [{origin: slide, components: [x], sigma: 5 mm}]
"""
    )
    robot = calib.load(write_arm(tmp_path, yaml))
    a, b, c = robot.forward([0.0, 0.0, 0.0], "tip")[:3, 3]
    q = np.random.default_rng(2).uniform([-2, 0.1, 0], [2, 0.9, 0], (40, 3))
    out, turn = q[:, 1] + a + error, q[:, 0]
    tip = np.stack([np.cos(turn) * out - np.sin(turn) * b, np.sin(turn) * out + np.cos(turn) * b, np.full(40, c)], 1)
    end = np.array([0.9, 0.4, c + 0.03])
    read = np.linalg.norm(tip - end, axis=1) + np.random.default_rng(3).normal(0, 1e-5, 40)
    result = calib.fit(robot, calib.as_measurements(robot, q, {"wire": read[:, None]})).parameters
    for name, true in zip(("slide.x", "wire_end.x", "wire_end.y", "wire_end.z"), (0.25 + error, *end), strict=True):
        assert abs(result[name].value_si - true) < 5 * result[name].std_si < 5e-3, name
