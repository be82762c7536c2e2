"""`calib init --template`: every robot is the mechanism of its lengths, by closed forms, and can be calibrated."""

import numpy as np
import pytest

import calib
from calib.starting.templates import TEMPLATES, read_lengths

TOLERANCE = 1e-9  # loops close to 1e-12 m; far from singular poses that is some 1e-12 rad
LENGTHS = {  # none of them a default
    "four_bar": {"ground": 0.41, "crank": 0.12, "coupler": 0.36, "rocker": 0.27},
    "five_bar": {"motor_distance": 0.15, "proximal": 0.21, "distal": 0.33},
    "3rrr": {"base_radius": 0.45, "platform_radius": 0.12, "proximal": 0.22, "distal": 0.26},
    "delta": {"base_radius": 0.16, "platform_radius": 0.04, "upper_arm": 0.22, "rod": 0.52, "rod_distance": 0.09},
    "stewart": {"base_radius": 0.35, "platform_radius": 0.2, "base_pair": 0.12, "platform_pair": 0.06, "height": 0.45},
}
REACH = {"four_bar": 0.4, "five_bar": 0.3, "3rrr": 0.12, "delta": 0.3, "stewart": 0.04}  # about home [rad or m]
ANGLES = np.radians([90, 210, 330])


def robot_of(folder, name):
    urdf, description = TEMPLATES[name].files("robot.urdf", LENGTHS[name])
    (folder / "robot.urdf").write_text(urdf)
    (folder / "robot.yaml").write_text(description)
    return calib.load(folder / "robot.yaml")


def case(folder, name):
    """Lengths of a template, its robot, and 30 poses."""
    robot = robot_of(folder, name)
    off = np.random.default_rng(3).uniform(-REACH[name], REACH[name], (30, len(robot.joint_names)))
    return LENGTHS[name], robot, robot.home + off


def unit(angle):
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def meeting(item, radius_one, other, radius_other):
    """The meeting point of circles (n, 2) that lies to the left of the way from one centre to the other."""
    across = other - item
    far = np.linalg.norm(across, axis=1)
    along = (radius_one**2 - radius_other**2 + far**2) / (2 * far)
    up = np.sqrt(radius_one**2 - along**2)
    x = across / far[:, None]
    return item + along[:, None] * x + up[:, None] * np.stack([-x[:, 1], x[:, 0]], axis=1)


def test_four_bar_is_where_two_circles_meet(tmp_path):
    size, robot, q = case(tmp_path, "four_bar")
    end = size["crank"] * unit(q[:, 0])
    joint = meeting(end, size["coupler"], np.tile([size["ground"], 0.0], (30, 1)), size["rocker"])
    assert np.abs(robot.positions(q)[:, 0, :2] - (end + joint) / 2).max() < TOLERANCE


def test_five_bar_is_where_two_circles_meet(tmp_path):
    size, robot, q = case(tmp_path, "five_bar")
    left, right = (
        np.array([side * size["motor_distance"] / 2, 0]) + size["proximal"] * unit(angle)
        for side, angle in zip((-1, 1), q.T, strict=True)
    )
    assert np.abs(robot.positions(q)[:, 0, :2] - meeting(left, size["distal"], right, size["distal"])).max() < TOLERANCE


def test_3rrr_keeps_its_distal_lengths(tmp_path):
    """Inverse kinematics: each motor's angle from where the platform is, by the cosine rule."""
    size, robot, q = case(tmp_path, "3rrr")
    pose = robot.forward(q, "platform")
    assert np.ptp(pose[:, 0, 3]) > 0.02
    assert np.ptp(np.arctan2(pose[:, 1, 0], pose[:, 0, 0])) > 0.05
    for k, angle in enumerate(ANGLES):
        to = pose[:, :2, :2] @ (size["platform_radius"] * unit(angle)) + pose[:, :2, 3]
        to -= size["base_radius"] * unit(angle)
        far = np.linalg.norm(to, axis=1)
        cosine = (size["proximal"] ** 2 + far**2 - size["distal"] ** 2) / (2 * size["proximal"] * far)
        expected = np.arctan2(to[:, 1], to[:, 0]) + np.arccos(cosine)
        assert np.abs(np.angle(np.exp(1j * (expected - q[:, k])))).max() < TOLERANCE


def test_delta_inverse_by_hand(tmp_path):
    """The platform stays level; in the plane of each arm, a x + b z = c decides the motor's angle."""
    size, robot, q = case(tmp_path, "delta")
    pose = robot.forward(q, "platform")
    assert np.abs(pose[:, :3, :3] - np.eye(3)).max() < TOLERANCE
    for k, angle in enumerate(np.radians([0, 120, 240])):
        x = pose[:, :2, 3] @ unit(angle) + size["platform_radius"] - size["base_radius"]
        y, z = pose[:, :2, 3] @ unit(angle + np.pi / 2), pose[:, 2, 3]
        c = (x**2 + y**2 + z**2 + size["upper_arm"] ** 2 - size["rod"] ** 2) / (2 * size["upper_arm"])
        expected = np.arctan2(-z, x) - np.arccos(c / np.hypot(x, z))  # x cos q - z sin q = c, the arm outside
        assert np.abs(expected - q[:, k]).max() < TOLERANCE


def test_stewart_legs_are_as_long_as_their_motors_say(tmp_path):
    size, robot, q = case(tmp_path, "stewart")
    pose = robot.forward(q, "platform")
    assert np.abs(pose[:, :3, :3] - np.eye(3)).max() > 0.05
    for k in range(6):
        side, centre = (-1) ** (k + 1), np.radians(120 * (k // 2))
        foot = size["base_radius"] * unit(centre + side * np.arcsin(size["base_pair"] / 2 / size["base_radius"]))
        turn = np.radians(60) - np.arcsin(size["platform_pair"] / 2 / size["platform_radius"])
        anchor = size["platform_radius"] * unit(centre + side * turn)
        leg = pose[:, :3, :3] @ [*anchor, 0.0] + pose[:, :3, 3] - [*foot, 0.0]
        assert np.abs(np.linalg.norm(leg, axis=1) - q[:, k]).max() < TOLERANCE


@pytest.mark.quick(1)
@pytest.mark.parametrize("name", list(TEMPLATES))
def test_the_command_writes_a_robot_that_can_be_checked_and_exported(tmp_path, run_calib, name):
    first = next(iter(TEMPLATES[name].lengths))
    length = f"{first}={1e3 * LENGTHS[name][first]}mm"
    for arguments in (
        ["init", "--template", name, "--length", length, "--out", "robot.yaml"],
        ["check", "robot.yaml"],
        ["export", "robot.yaml", "--format", "mjcf", "--out", "robot.xml"],
    ):
        run = run_calib(*arguments, cwd=tmp_path)
        assert run.code == 0, run.err
    assert (tmp_path / "robot.xml").exists()


@pytest.mark.parametrize(
    ("name", "given", "complaint"),
    [
        ("delta", ["rodd=1"], "did you mean 'rod'"),
        ("delta", ["rod"], "is not NAME=VALUE"),
        ("delta", ["rod=1", "rod=2"], "is given twice"),
        ("delta", ["rod=-1"], "must be greater than 0"),
        ("delta", ["rod=3deg"], "is for an angle"),
        ("delta", ["rod=0.1"], "too short to reach"),
        ("five_bar", ["motor_distance=2"], "too short to meet"),
        ("four_bar", ["ground=2"], "longer than the other three"),
        ("3rrr", ["base_radius=2"], "cannot span"),
        ("stewart", ["base_pair=0.3"], "must be less than base_radius"),
    ],
)
def test_lengths_that_are_wrong_are_named(name, given, complaint):
    with pytest.raises(calib.InputError, match=complaint) as error:
        TEMPLATES[name].files("robot.urdf", read_lengths(name, given))
    assert "\n" not in str(error.value)
    assert error.value.exit_code == 2
