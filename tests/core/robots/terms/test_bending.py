"""Links that tilt behind their joints under gravity: against rotations and energies written out, and against a URDF
whose links hang on joints of their own."""

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import calib
from calib.core.robots.terms.term import Context
from tests.core.robots.terms.test_compliance import ARM, ARM_YAML, HEADER, G, arm, joint, link, poses, upright_five_bar
from tests.kind_checks import assert_positions_move_as_differences_say
from tests.project import write_table

ORIGINS = np.array([[0, 0, 0.3], [0.1, 0, 0.2], [0.5, 0, 0]])
AXES = np.array([[0, 0, 1.0], [0, 1.0, 0], [0, 1.0, 0]])
ACROSS = np.array([[[1.0, 0, 0], [0, 1.0, 0]], [[1.0, 0, 0], [0, 0, 1.0]], [[1.0, 0, 0], [0, 0, 1.0]]])
MASSES = [(0, 8.0, [0.05, 0, 0.1]), (1, 6.0, [0.2, 0, 0.03]), (2, 3.0, [0.25, 0.2, 0]), (2, 2.0, [0.4, 0, 0.1])]
SOFT = np.array([3e-6, 5e-6, 1e-5])  # of the arm's three joints, across [rad / (N m)]


def turned(vector):
    return Rotation.from_rotvec(vector).as_matrix()


def bent(q, tilts, load=0.0):
    """Where the arm's ball is, and the energy of its masses, links being turned by `tilts` (3, 2) across the axes."""
    rotation, position, energy = np.eye(3), np.zeros(3), 0.0
    for k in range(3):
        position = position + rotation @ ORIGINS[k]
        rotation = rotation @ turned(q[k] * AXES[k]) @ turned(tilts[k] @ ACROSS[k])
        energy += sum(G * mass * (position + rotation @ place)[2] for own, mass, place in MASSES if own == k)
    ball = position + rotation @ [0.4, 0.2, 0.15]
    return ball, energy + G * load * ball[2]


def bent_by_gravity(q, load=0.0):
    """Where the ball is when links give way; the torque is the slope of the energy of the arm that does not."""
    step, torque = 1e-5, np.zeros(6)
    for k, change in enumerate(step * np.eye(6).reshape(6, 3, 2)):
        torque[k] = (bent(q, change, load)[1] - bent(q, -change, load)[1]) / (2 * step)
    return bent(q, -SOFT[:, None] * torque.reshape(3, 2))[0]


YAML = ARM_YAML.replace("compliance", "bending").replace("xyz: [0, 0, 0.15]", "xyz: [0, 0.2, 0.15]")


def bending_arm(folder):
    """The arm of the tests of compliance, its hand to one side, so that gravity loads every joint across its axis."""
    (folder / "arm.urdf").write_text(ARM.replace('xyz="0.25 0 0"', 'xyz="0.25 0.2 0"'))
    (folder / "arm.yaml").write_text(YAML)
    return calib.load(folder / "arm.yaml")


def soft(robot):
    """The arm as soft as `bent_by_gravity` has it: the torque that a joint holds is against what gravity does."""
    return robot.with_parameters(dict(zip(["turn.bending", "lift.bending", "bend.bending"], -SOFT, strict=True)))


def test_a_bent_arm_is_where_rotations_written_out_bring_it(tmp_path):
    robot = soft(bending_arm(tmp_path))
    q, load = poses(robot, 12, 0), np.linspace(0.0, 6.0, 12)
    expected = np.array([bent_by_gravity(*row) for row in zip(q, load, strict=True)])
    context = Context.from_conditions(np.zeros_like(q), {"load": load})
    # tilts of some 0.3 mrad one after the other, or about one axis, differ by their product
    assert np.allclose(robot.positions(q, context)[:, 0], expected, rtol=0, atol=1e-7)
    straight = np.array([bent(row, np.zeros((3, 2)))[0] for row in q])
    assert np.linalg.norm(expected - straight, axis=1).min() > 1e-4
    assert np.allclose(robot.forward(q[3])[:3, 3], bent_by_gravity(q[3]), rtol=0, atol=1e-7)


def test_a_sliding_carriage_tilts_about_all_three_axes(tmp_path):
    rail = joint("rail", "floor", "carriage", "0 0 0", "1 0 0", "prismatic") + link("carriage", 4, "0.2 0.3 0")
    (tmp_path / "rail.urdf").write_text(f'<robot name="rail"><link name="floor"/>{rail}</robot>')
    robot = calib.robot(
        tmp_path / "rail.urdf",
        motors=["rail"],
        base={"frame": "floor"},
        target={"ball": {"frame": "carriage", "xyz": [0.2, 0.3, 0.0]}},
        parametrisation=[{"joint": "rail", "term": "bending", "sigma": "0.02 mrad"}],
    ).with_parameters({"rail.bending": -1e-5})
    assert (robot.parameters[0].dimension, robot.parameters[0].sigma_si) == ("angle", 2e-5)
    ball = robot.positions([[0.5]])[0, 0]
    weight = 4 * G
    roll, pitch = -1e-5 * weight * 0.3, 1e-5 * weight * 0.2  # down at +y, and down at +x
    assert np.allclose(ball, [0.7, 0.3, 0.3 * roll - 0.2 * pitch], rtol=0, atol=1e-6)
    assert np.isclose(ball[2], -1e-5 * weight * (0.3**2 + 0.2**2), rtol=1e-5)


def explicit(urdf, name):
    """A URDF in which the link behind a joint about z hangs on two more joints, about x and y."""
    behind = re.search(f'<joint name="{name}".*?<child link="(.*?)"', urdf, flags=re.DOTALL).group(1)
    pattern = f'(<joint name="{name}".*?<child link=")({behind})(")'
    urdf = re.sub(pattern, rf"\1{name}_a\3", urdf, count=1, flags=re.DOTALL)
    more = joint(f"{name}_y", f"{name}_a", f"{name}_b", "0 0 0")
    more += joint(f"{name}_x", f"{name}_b", behind, "0 0 0", "1 0 0")
    return urdf.replace("</robot>", f'<link name="{name}_a"/><link name="{name}_b"/>{more}</robot>')


def test_through_a_loop_it_is_as_a_urdf_with_joints_for_the_tilts(tmp_path):
    upright_five_bar(tmp_path)
    text, urdf = (tmp_path / "five_bar.yaml").read_text(), (tmp_path / "five_bar.urdf").read_text()
    # the five-bar stands, leans and lies askew, so that gravity tilts its links
    urdf = urdf.replace(f'rpy="{np.pi / 2!r} 0 0"', 'rpy="1.1 0.3 0.2"')
    (tmp_path / "five_bar.urdf").write_text(urdf)
    (tmp_path / "bending.yaml").write_text(text.replace("compliance", "bending"))
    robot = calib.load(tmp_path / "bending.yaml")
    motors = robot.joint_names
    for name in motors:
        urdf = explicit(urdf, name)
    (tmp_path / "explicit.urdf").write_text(urdf)
    tilts = [f"{motor}_{axis}" for motor in motors for axis in "xy"]
    text = re.sub(r"name_mot: .*", f"name_mot: [{', '.join([*motors, *tilts])}]", text)
    text = re.sub(r"urdf: .*", "urdf: explicit.urdf", text)
    text = text.replace("home: {", "home: {" + "".join(f"{name}: 0, " for name in tilts))
    (tmp_path / "explicit.yaml").write_text(text)
    other = calib.load(tmp_path / "explicit.yaml")
    robot = robot.with_parameters({f"{name}.bending": -3e-4 for name in motors})
    other = other.with_parameters({f"{name}.compliance": -3e-4 for name in tilts})
    q = poses(robot, 8, 1)
    with_tilts = np.hstack([q, np.zeros((8, len(tilts)))])
    assert np.allclose(robot.positions(q), other.positions(with_tilts), rtol=0, atol=1e-11)
    stiff = robot.with_parameters({f"{name}.bending": 0.0 for name in motors})
    assert np.abs(robot.positions(q) - stiff.positions(q)).max() > 1e-5


@pytest.mark.parametrize("term", ["bending", "compliance"])
@pytest.mark.parametrize("machine", [arm, upright_five_bar])
def test_derivatives_are_central_differences(tmp_path, machine, term):
    machine(tmp_path)
    path = next(tmp_path.glob("*.yaml"))
    path.write_text(path.read_text().replace("compliance", term))
    if machine is upright_five_bar:
        urdf = (tmp_path / "five_bar.urdf").read_text().replace(f'rpy="{np.pi / 2!r} 0 0"', 'rpy="1.1 0.3 0.2"')
        (tmp_path / "five_bar.urdf").write_text(urdf)
    robot = calib.load(path)
    rng = np.random.default_rng(2)
    at = robot.values + 0.3 * rng.standard_normal(len(robot.values)) * [p.sigma_si for p in robot.parameters]
    robot, q = robot.with_parameters(at), poses(robot, 5, 3)
    steps = [1e-2 * parameter.sigma_si for parameter in robot.parameters]
    assert_positions_move_as_differences_say(robot, q, steps=steps)


@pytest.mark.quick(0)
def test_it_is_found_in_a_file_and_chosen(tmp_path, run_calib):
    bending_arm(tmp_path)
    (tmp_path / "arm.yaml").write_text(re.sub(r"  - {joint.*\n", "", YAML) + "sigma: 0.01 mm\n")
    rng = np.random.default_rng(5)
    q, load = rng.uniform(-0.8, 0.8, (80, 3)), np.tile([0.0, 10.0], 40)
    points = np.array([bent_by_gravity(*row) for row in zip(q, load, strict=True)])
    points += 1e-5 * rng.standard_normal(points.shape)
    data = write_table(tmp_path / "data.csv", f"{HEADER},load [kg]", q, points, load)
    run = run_calib("fit", tmp_path / "arm.yaml", data, "--terms", "auto", "--no-pages", "--out", tmp_path / "out")
    assert run.code == 0, run.err
    robot = calib.load(tmp_path / "out")
    assert {type(term).__name__ for term in robot.terms} == {"Bending"}
    known = dict(zip((p.name for p in robot.parameters), robot.values, strict=True))
    for name, size in zip(["turn", "lift", "bend"], SOFT, strict=True):
        assert known[f"{name}.bending"] == pytest.approx(-size, rel=0.1, abs=1e-6)


def test_goals_are_reached_and_programs_kept_with_the_links_bent(tmp_path):
    robot = soft(bending_arm(tmp_path))
    goals = np.array([[0.8, 0.1, 0.4], [0.7, -0.3, 0.6], [0.5, 0.4, 0.3]])
    solution = calib.solve(robot, goals)
    assert np.all(solution.ok)
    reached = np.array([bent_by_gravity(row) for row in solution.q])
    assert np.allclose(reached, goals, rtol=0, atol=1e-7)
    assert np.allclose(robot.positions(solution.q)[:, 0], goals, rtol=0, atol=2e-9)
    program = poses(robot, 6, 7)
    changed = calib.compensate(robot, program, keep="position")
    assert np.all(changed.ok)
    meant = np.array([bent(row, np.zeros((3, 2)))[0] for row in program])
    assert np.allclose([bent_by_gravity(row) for row in changed.q], meant, rtol=0, atol=1e-7)


def test_terms_can_be_changed_with_and_without_tilts(tmp_path):
    robot = bending_arm(tmp_path)
    plain = robot.with_terms(())
    assert plain.mechanism.driven == plain.joint_names == robot.joint_names
    q = poses(robot, 4, 9)
    assert np.allclose(plain.positions(q), robot.positions(q), rtol=0, atol=1e-14)
    moved = plain.with_parameters({"lift.x": 0.101})
    again = moved.with_terms(robot.description.terms)
    assert np.allclose(again.positions(q), moved.positions(q), rtol=0, atol=1e-14)
    assert again.home.shape == (3,)
    (tmp_path / "arm.yaml").write_text(YAML.replace("origin: lift", "origin: 'lift:tilt_0'"))
    with pytest.raises(calib.DescriptionError, match="no joint origin 'lift:tilt_0'"):
        calib.load(tmp_path / "arm.yaml")
