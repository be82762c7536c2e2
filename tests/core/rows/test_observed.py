"""What instruments read and how it moves, against central differences, through loops and for every place and setup."""

import numpy as np
import pinocchio as pin
import pytest

import calib
from calib.core.instruments.kind import Readings
from calib.core.robots.jacobian import linearise
from calib.core.rows.observed import observe, predict_readings
from medrue.workspace import target_workspace
from tests.kind_checks import chain_error
from tests.project import EXAMPLES, ROOT
from tests.small_robots import ARM_YAML, write_arm, write_pose_loop

STEP = 1e-6
TWO_SETUPS = (
    ARM_YAML.replace("frame: ground", "frame: ground, pose: unknown")
    .replace("30 mm]", "30 mm], position: unknown")
    .replace("targets:\n", "targets:\n  elbow: {frame: slider, xyz: [0, 0.1, 0]}\n")
) + (
    "instruments:\n  one: {kind: position, target: tip}\n  two: {kind: position, target: elbow}\n"
    "setups: {first: [], second: [base], third: [base, tip]}\n"
)


def arm(folder):
    robot = calib.load(write_arm(folder, TWO_SETUPS))
    moved = np.random.default_rng(5).uniform(-0.3, 0.3, len(robot.parameters)) * [p.placement for p in robot.parameters]
    return robot.with_parameters(robot.values + moved), np.random.default_rng(1).uniform([-2, 0, -2], [2, 1, 2], (7, 3))


def five_bar(_):
    robot = calib.load(EXAMPLES / "five_bar.yaml")
    return robot.with_parameters({"base.x": 0.5, "base.rz": 0.7}), robot.home + np.linspace(-0.2, 0.2, 5)[:, None]


def pose_loop(folder):
    robot = calib.load(write_pose_loop(folder))
    return robot, robot.home + np.linspace(-0.1, 0.1, 5)[:, None]


def medrue(_):
    return calib.load(ROOT / "urdf" / "medrue.yaml"), np.array(target_workspace().q)[::140]


@pytest.fixture(params=[arm, five_bar, pose_loop, medrue], ids=lambda case: case.__name__)
def case(request, tmp_path):
    """A robot, joint values, and readings of all its instruments: out of order, some visits twice, some not at all."""
    robot, q = request.param(tmp_path)
    rng = np.random.default_rng(3)
    readings = {}
    for instrument in robot.instruments:
        visits = rng.permutation(np.r_[1 : len(q), 2, 2])
        pairs = rng.integers(0, len(robot.pairs[instrument.name]), len(visits))
        values = rng.standard_normal((len(visits), instrument.n_rows))
        readings[instrument.name] = Readings(visits, pairs, values, None, np.zeros((len(visits), 0)))
    return robot, q, readings


@pytest.mark.quick(0)
def test_derivatives_by_parameters_are_those_of_central_differences(case):
    assert chain_error(*case) <= 1e-6


def test_derivatives_by_some_parameters_are_a_part_of_those_by_all(case):
    robot, q, readings = case
    configurations, some = robot.assemble(q), np.arange(1, len(robot.parameters), 3)
    every = observe(robot, configurations, readings, joints=True)
    for name, item in observe(robot, configurations, readings, joints=True, by=some).items():
        np.testing.assert_allclose(item.derivative_by(some), every[name].derivative_by(some), rtol=1e-12, atol=1e-14)
        np.testing.assert_allclose(item.derivative_by(some[2:4]), every[name].jacobian[..., some[2:4]], atol=1e-14)
        np.testing.assert_allclose(item.joint_derivative, every[name].joint_derivative, rtol=1e-12, atol=1e-14)
        with pytest.raises(AssertionError):
            item.derivative_by(some - 1)


def test_unknowns_of_instruments_are_counted_among_the_chosen_parameters(tmp_path):
    """A zero of an encoder, and two focal lengths of a camera of which the second alone is chosen."""
    yaml = ARM_YAML + (
        "instruments:\n  encoder: {kind: joint_reading, joint: wrist, zero: unknown}\n"
        "  eye: {kind: pixel, target: tip, camera: {frame: ground}, intrinsics: {fx: 900, fy: 910, cx: 500, cy: 400},"
        " image: [1000, 800], points: {a: [0, 0, 0], b: [50 mm, 0, 0]}, unknown_intrinsics: {fx: 20, fy: 20}}\n"
    )
    robot = calib.load(write_arm(tmp_path, yaml))
    configurations = robot.assemble(np.random.default_rng(1).uniform([-2, 0, -2], [2, 1, 2], (7, 3)))
    readings = predict_readings(robot, configurations)
    every = observe(robot, configurations, readings, joints=True)
    n = len(robot.parameters)
    for some in ([3, n - 1], [3, n - 3, n - 1], [3]):
        for name, item in observe(robot, configurations, readings, joints=True, by=np.array(some)).items():
            np.testing.assert_allclose(item.derivative_by(np.array(some)), every[name].jacobian[..., some], atol=1e-9)
            np.testing.assert_allclose(item.joint_derivative, every[name].joint_derivative, atol=1e-9)
    assert np.any(every["eye"].jacobian[..., n - 1])
    assert np.all(every["encoder"].jacobian[..., n - 3] == 1.0)


def test_derivatives_by_joints_are_those_of_central_differences(case):
    robot, q, readings = case
    observed = observe(robot, robot.assemble(q), readings, joints=True)
    for j, change in enumerate(STEP * np.eye(q.shape[1])):
        ahead, behind = (observe(robot, robot.assemble(q + s * change), readings) for s in (1, -1))
        for name in readings:
            numeric = (ahead[name].residuals - behind[name].residuals) / (2 * STEP)
            np.testing.assert_allclose(observed[name].joint_derivative[..., j], numeric, atol=2e-8)


def test_residuals_are_predicted_minus_read_from_the_place_of_the_setup(case):
    robot, q, readings = case
    configurations = robot.assemble(q)
    predicted = predict_readings(robot, configurations, readings)
    for name, item in observe(robot, configurations, readings).items():
        np.testing.assert_allclose(item.residuals, predicted[name].values - readings[name].values, atol=1e-14)


def test_in_every_setup_a_target_is_seen_from_where_the_tracker_then_stands(tmp_path):
    """Against plain matrices: the base and the tip of each setup are places of their own."""
    robot, q = arm(tmp_path)
    everywhere = Readings(np.repeat(np.arange(7), 3), np.tile([0, 1, 2], 7), np.zeros((21, 3)), None, np.zeros((21, 0)))
    readings = predict_readings(robot, robot.assemble(q), {"one": everywhere})["one"]
    value = dict(zip((p.name for p in robot.parameters), robot.values, strict=True))

    def place(name):
        turn = np.array([value.get(f"{name}.{c}", 0.0) for c in ("rx", "ry", "rz")])
        return pin.SE3(pin.exp3(turn), np.array([value[f"{name}.{c}"] for c in "xyz"])).homogeneous

    flange = robot.forward(q, "tool")  # tool seen from the measurement frame of the first setup
    for pair, (base, tip) in enumerate((("base", "tip"), ("base@second", "tip"), ("base@third", "tip@third"))):
        chosen = readings.pairs == pair
        seen = place(base) @ np.linalg.inv(place("base")) @ flange[readings.visits[chosen]] @ place(tip)
        np.testing.assert_allclose(readings.values[chosen], seen[:, :3, 3], atol=1e-12)


def test_without_instruments_readings_are_the_positions_of_the_targets(tmp_path):
    yaml = ARM_YAML.replace("targets:\n", "targets:\n  elbow: {frame: slider}\n")
    robot = calib.load(write_arm(tmp_path, yaml))
    q = np.random.default_rng(1).uniform([-2, 0, -2], [2, 1, 2], (70, 3))  # more than one chunk
    configurations = robot.assemble(q)
    predicted = predict_readings(robot, configurations)
    assert list(predicted) == ["elbow", "tip"]
    stacked = np.stack([predicted[name].values for name in predicted], axis=1)
    np.testing.assert_allclose(stacked, robot.positions(q), atol=1e-15)
    linear = linearise(robot, configurations)
    for k, observation in enumerate(observe(robot, configurations, predicted).values()):
        np.testing.assert_allclose(observation.residuals, 0.0, atol=1e-15)
        np.testing.assert_allclose(observation.jacobian, linear.jacobian[:, k], atol=1e-12)
