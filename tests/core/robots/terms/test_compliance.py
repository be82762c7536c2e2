"""Compliance under gravity: torques against potential energy by other code, derivatives, recovery, through a loop."""

import re
from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.core.robots.joint_errors import actual_joints, term_columns
from calib.core.robots.terms.term import Context
from tests.core.robots.test_loops import by_hand, elbows
from tests.project import EXAMPLES, write_table

G = 9.81
STEP = 1e-5
HEADER = "turn [rad],lift [rad],bend [rad],ball_x [m],ball_y [m],ball_z [m]"


def link(name, mass, xyz="0 0 0"):
    inertia = '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    return f'<link name="{name}"><inertial><origin xyz="{xyz}"/><mass value="{mass}"/>{inertia}</inertial></link>\n'


def joint(name, parent, child, xyz, axis="0 1 0", kind="revolute", limits=(-3, 3)):
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/><origin xyz="{xyz}"/>'
        f'<axis xyz="{axis}"/><limit lower="{limits[0]}" upper="{limits[1]}" effort="1" velocity="1"/></joint>\n'
    )


ARM = (
    '<robot name="arm">\n'
    + link("base", 30)
    + joint("turn", "base", "post", "0 0 0.3", "0 0 1")
    + link("post", 8, "0.05 0 0.1")
    + joint("lift", "post", "upper", "0.1 0 0.2")
    + link("upper", 6, "0.2 0 0.03")
    + joint("bend", "upper", "fore", "0.5 0 0")
    + link("fore", 3, "0.25 0 0")
    + joint("mount", "fore", "tool", "0.4 0 0", kind="fixed")
    + link("tool", 2, "0 0 0.1")
    + "</robot>\n"
)
MASSES = np.array([8.0, 6.0, 3.0, 2.0])  # of the links that move
ARM_YAML = """\
urdf: arm.urdf
name_mot: [turn, lift, bend]
base: {frame: base}
targets: {ball: {frame: tool, xyz: [0, 0, 0.15]}}
parametrisation:
  - {origin: lift, components: [x, z], sigma: 1 mm}
  - {origin: bend, components: [x], sigma: 1 mm}
  - {joint: all, term: compliance}
"""


def centres(q):
    """Where the masses of the arm that move are with these joints (3,), and the ball, by trigonometry alone, (5, 3)."""
    turn, lift, bend = q

    def along(angle, x, z):  # a vector of the link, turned about y: x forward, z up
        return np.array([np.cos(angle) * x + np.sin(angle) * z, -np.sin(angle) * x + np.cos(angle) * z])

    shoulder = np.array([0.1, 0.5])
    elbow = shoulder + along(lift, 0.5, 0)
    tool = elbow + along(lift + bend, 0.4, 0)
    flat = [[0.05, 0.4], shoulder + along(lift, 0.2, 0.03), elbow + along(lift + bend, 0.25, 0)]
    flat += [tool + along(lift + bend, 0, 0.1), tool + along(lift + bend, 0, 0.15)]
    return np.array([[np.cos(turn) * x, np.sin(turn) * x, z] for x, z in flat])


def arm_at(q):
    """Where the ball is and the potential energy of the arm."""
    places = centres(q)
    return places[4], G * MASSES @ places[:4, 2]


def five_bar_at(q):
    """The same of the five-bar of the examples put upright."""
    tip, ends = by_hand(*q, 1), elbows(*q)
    return np.array([*tip, 0.02]), G * 0.2 * sum(end[1] / 2 + (end[1] + tip[1]) / 2 for end in ends)


def torques(at, q):
    """dU/dq by central differences, which through a loop is virtual work, (n, n_joints)."""
    steps = STEP * np.eye(q.shape[1])
    return np.array([[(at(row + step)[1] - at(row - step)[1]) / (2 * STEP) for step in steps] for row in q])


def columns(robot, q, context=None):
    return np.concatenate(term_columns(robot, q, context), axis=2)[:, 0]


def arm(folder, yaml=ARM_YAML):
    (folder / "arm.urdf").write_text(ARM)
    (folder / "arm.yaml").write_text(yaml)
    return calib.load(folder / "arm.yaml"), arm_at


def upright_five_bar(folder):
    """The table stands on its edge: what was y is up."""
    stand = '<link name="wall"/><joint name="stand" type="fixed"><parent link="wall"/><child link="table"/>'
    stand += f'<origin rpy="{np.pi / 2!r} 0 0"/></joint></robot>'
    text = (EXAMPLES / "five_bar.urdf").read_text().replace("</robot>", stand)
    (folder / "five_bar.urdf").write_text(text)
    description = (EXAMPLES / "five_bar.yaml").read_text().replace("pose: unknown", "pose: known")
    (folder / "five_bar.yaml").write_text(
        f"{description}\njoint_terms: [{{joint: all, term: compliance, sigma: 0.001}}]\n"
    )
    return calib.load(folder / "five_bar.yaml"), five_bar_at


def poses(robot, n, seed):
    return robot.home + np.random.default_rng(seed).uniform(-0.4, 0.4, (n, len(robot.home)))


KNEE = 2.0  # N m
PLAY = """\
  - {origin: lift, components: [ry], sigma: 3 mrad}
  - {origin: bend, components: [ry], sigma: 3 mrad}
  - {joint: all, term: gravity_backlash, torque: 2}
sigma: 0.02 mm
"""
HALF, SOFT, ZERO = np.array([0, 4e-4, 3e-4]), np.array([0, -2e-5, -3e-5]), np.array([0, 1e-3, -2e-3])


def played(folder, low, high):
    """A fit to 60 poses of the arm between these joint values, by other code: play, compliance and joint zeros."""
    robot, rng = arm(folder, ARM_YAML + PLAY)[0], np.random.default_rng(1)
    q = rng.uniform(low, high, (60, 3))
    tau = torques(arm_at, q)
    points = np.array([arm_at(row)[0] for row in q + HALF * -tau / np.sqrt(tau**2 + KNEE**2) + SOFT * tau + ZERO])
    fit = calib.fit(robot, calib.as_measurements(robot, q, points + 2e-5 * rng.standard_normal(points.shape)))
    std = dict(zip(fit.free_names, fit.statistics.std, strict=True))
    values = dict(zip((p.name for p in robot.parameters), fit.robot.values, strict=True))
    return robot, tau, values, std


def test_play_that_gravity_takes_up_is_found_where_gravity_changes_its_side(tmp_path):
    robot, tau, values, std = played(tmp_path, -2.0, 2.0)
    assert np.all(tau[:, 1:].min(axis=0) < -5 * KNEE)
    assert np.all(tau[:, 1:].max(axis=0) > 5 * KNEE)
    for name, half in (("lift", HALF[1]), ("bend", HALF[2])):
        name += ".gravity_backlash"
        assert abs(values[name] - half) < 4 * std[name] < 0.4 * half
    q = poses(robot, 8, 9)
    play = robot.with_parameters({"lift.gravity_backlash": HALF[1], "turn.gravity_backlash": HALF[1]})
    side = -torques(arm_at, q)[:, 1] / np.sqrt(torques(arm_at, q)[:, 1] ** 2 + KNEE**2)
    actual = actual_joints(play, q, term_columns(play, q))
    assert np.allclose((actual - q)[:, 1], HALF[1] * side, rtol=0, atol=1e-9)
    assert np.allclose((actual - q)[:, 0], 0.0, rtol=0, atol=1e-12)  # its axis is vertical: gravity decides nothing


def test_play_that_gravity_holds_on_one_side_is_a_zero_of_the_joint(tmp_path):
    robot, tau, _values, std = played(tmp_path, [-2.0, -0.3, -0.3], [2.0, 0.3, 0.2])
    assert np.all(tau[:, 1:].max(axis=0) < -3 * KNEE)
    for name in ("lift", "bend"):
        expected = robot.parameters[f"{name}.gravity_backlash"].sigma_si
        assert std[f"{name}.gravity_backlash"] > 0.8 * expected  # the prior alone holds it
        assert std[f"{name}.ry"] > 0.8 * expected


def loaded(robot, load, q, **changes):
    """A robot with these changes of its description, joint values, and conditions of visits that carry these masses."""
    robot = replace(robot, description=robot.description.model_copy(update=changes))
    return robot, q, replace(Context.neutral(len(load), len(robot.joint_names)), load=load)


def lifted(height, q):
    """The torque of one kilogram at a point of this height, by central differences, (n, n_joints)."""
    return torques(lambda row: (None, G * height(row)), q)


@pytest.mark.parametrize(("make", "up"), [(arm, 2), (upright_five_bar, 1)])
def test_torques_are_the_slope_of_the_potential_energy_of_links_and_of_a_payload_at_the_first_target(
    tmp_path, make, up
):
    robot, at = make(tmp_path)
    q, load = poses(robot, 12, 4), np.linspace(0.0, 7.0, 12)
    by_links, by_payload = torques(at, q), lifted(lambda row: at(row)[0][up], q)
    # differences of some 10 J by 1e-5 rad are good to 1e-9 N m, and their curvature to as much
    assert np.allclose(columns(robot, q), by_links, rtol=0, atol=1e-6)
    assert np.allclose(columns(*loaded(robot, load, q)), by_links + load[:, None] * by_payload, rtol=0, atol=1e-6)
    assert min(np.abs(by_links).max(), np.abs(by_payload).max()) > 0.3


def test_a_payload_hangs_where_the_description_says(tmp_path):
    robot, at = arm(tmp_path)
    q = poses(robot, 5, 6)
    result = columns(*loaded(robot, np.full(5, 3.0), q, payload="fore")) - torques(at, q)
    assert np.allclose(result, 3.0 * lifted(lambda row: 0.5 - 0.5 * np.sin(row[1]), q), rtol=0, atol=1e-6)
    for word, said in (
        ("fare", "payload: no link, joint or target 'fare'; did you mean 'fore'"),
        ("base", "payload: no motor moves 'base'"),
    ):
        with pytest.raises(calib.DescriptionError, match=said):
            arm(tmp_path, f"{ARM_YAML}payload: {word}\n")


def test_compliance_is_recovered_from_a_file_with_a_payload_alone(tmp_path, run_calib):
    _, at = arm(tmp_path)
    (tmp_path / "arm.urdf").write_text(re.sub("<inertial>.*?</inertial>", "", ARM, flags=re.DOTALL))
    robot = calib.load(tmp_path / "arm.yaml")
    with pytest.raises(calib.DescriptionError, match="needs masses, and the URDF has none"):
        robot.assemble(robot.home)
    (tmp_path / "arm.yaml").write_text(ARM_YAML + "payload: ball\nsigma: 0.01 mm\n")
    robot = calib.load(tmp_path / "arm.yaml")
    rng = np.random.default_rng(8)
    q, load = rng.uniform(-0.8, 0.8, (60, 3)), np.tile([0.0, 10.0], 30)
    torque = load[:, None] * lifted(lambda row: at(row)[0][2], q)
    points = np.array([at(row)[0] for row in q + [0.0, 6e-5, 9e-5] * torque]) + 1e-5 * rng.standard_normal((60, 3))
    write_table(tmp_path / "data.csv", f"{HEADER},load [kg]", q, points, load)
    run = run_calib("fit", tmp_path / "arm.yaml", tmp_path / "data.csv", "--no-pages", "--out", tmp_path / "out")
    assert run.code == 0, run.err
    calibrated = calib.load(tmp_path / "out")
    known = dict(zip((p.name for p in calibrated.parameters), calibrated.values, strict=True))
    assert known["lift.compliance"] == pytest.approx(6e-5, rel=0.05)
    assert known["bend.compliance"] == pytest.approx(9e-5, rel=0.05)
    run = run_calib("predict", tmp_path / "out", tmp_path / "data.csv", "--out", tmp_path / "predicted.csv")
    assert run.code == 0, run.err
    predicted = calib.read_measurements(tmp_path / "predicted.csv", robot).readings["ball"].values
    assert np.abs(predicted - points).max() < 6e-5  # 3 mm of bending, but for noise: the file's loads are heeded
