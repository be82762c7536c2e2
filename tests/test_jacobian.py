"""The identification Jacobian against central differences, all parameters and all components of every origin."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import calib
from calib.linearisation.jacobian import linearise, origin_jacobian
from calib.numerics.identifiability import numerical_rank
from medrue import robot_file
from medrue.closed_form import forward
from medrue.paper_tables import table1
from medrue.workspace import target_workspace


@pytest.fixture(scope="module")
def robot():
    return calib.load(robot_file())


def relative_error(found, expected):
    """Largest difference of a column, relative to that column's largest entry (to 1 mm per unit for zero columns)."""
    scale = np.maximum(np.max(np.abs(expected), axis=(0, 1)), 1e-3)
    return np.max(np.abs(found - expected) / scale)


@pytest.mark.parametrize("values", [table1().nominal, table1().actual], ids=["nominal", "actual"])
def test_all_36_columns_agree_with_differences_of_the_closed_form(robot, values):
    q = target_workspace().q[::6]
    at = robot.with_parameters(values)
    found = linearise(at, at.assemble(q)).jacobian[:, 0]
    step = 1e-6
    expected = np.empty_like(found)
    for k in range(36):
        change = step * np.eye(36)[k]
        expected[:, :, k] = (forward(q, values + change).p_world_tool - forward(q, values - change).p_world_tool) / (
            2 * step
        )
    assert relative_error(found, expected) <= 1e-6


def test_all_six_components_of_every_origin_agree_with_differences(robot):
    q = target_workspace().q[::40]
    at = robot.with_parameters(table1().actual)
    found = origin_jacobian(at.mechanism, at.assemble(q))[1][:, 0]
    step = 1e-6
    for i, name in enumerate(at.mechanism.origin_names):
        placement = at.mechanism.placement(name)
        for component in range(6):
            xi = step * np.eye(6)[component]
            sides = []
            for sign in (1, -1):
                moved = replace(at, mechanism=at.mechanism.with_placements({name: placement * pin.exp6(sign * xi)}))
                sides.append(moved.positions(q)[:, 0])
            expected = ((sides[0] - sides[1]) / (2 * step))[:, :, None]
            column = found[:, :, 6 * i + component : 6 * i + component + 1]
            assert relative_error(column, expected) <= 1e-6, f"{name}, component {component}"


def test_positions_come_with_the_derivative(robot):
    q = target_workspace().q[::20]
    configurations = robot.assemble(q)
    linear = linearise(robot, configurations)
    assert np.max(np.abs(linear.positions[:, 0] - forward(q, table1().nominal).p_world_tool)) < 1e-11


def test_the_rank_at_nominal_is_28_of_36_with_a_wide_gap(robot):
    jacobian = linearise(robot, robot.assemble(target_workspace().q)).jacobian.reshape(-1, 36)
    rank = numerical_rank(jacobian * np.array([parameter.sigma for parameter in robot.parameters]))
    assert (rank.rank, rank.n_columns) == (28, 36)
    assert rank.largest_dropped < 1e-8 * rank.smallest_kept
    assert "rank 28 of 36 (gap: singular value 28 is" in str(rank)


def test_d31_and_d32_have_no_effect_on_the_tool(robot):
    jacobian = linearise(robot, robot.assemble(target_workspace().q)).jacobian
    names = [parameter.name for parameter in robot.parameters]
    for name in ("d31", "d32"):
        assert np.max(np.abs(jacobian[..., names.index(name)])) < 1e-12


def serial_urdf(tmp_path, rng):
    """A chain of six joints at random places, one of them prismatic, with fixed joints between."""
    parts, parent = ['<link name="l0"/>'], "l0"
    for k in range(8):
        kind = {2: "fixed", 4: "prismatic", 5: "fixed"}.get(k, "revolute")
        xyz, rpy, axis = (" ".join(map(str, rng.normal(size=3))) for _ in range(3))
        parts.append(
            f'<link name="l{k + 1}"/><joint name="j{k}" type="{kind}"><parent link="{parent}"/><child link="l{k + 1}"/>'
            f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>'
            '<limit lower="-3" upper="3" effort="1" velocity="1"/>'
            "</joint>"
        )
        parent = f"l{k + 1}"
    path = tmp_path / "chain.urdf"
    path.write_text("<robot name='chain'>" + "".join(parts) + "</robot>")
    return path


def test_every_parameter_of_a_plain_urdf_agrees_with_differences(tmp_path):
    rng = np.random.default_rng(5)
    nominal = calib.load(serial_urdf(tmp_path, rng))
    robot = nominal.with_parameters(nominal.values + 0.05 * rng.normal(size=len(nominal.values)))
    q = rng.uniform(-2, 2, (10, len(robot.joint_names)))
    found = linearise(robot, robot.assemble(q)).jacobian[:, 0]
    step, n = 1e-6, len(robot.values)
    assert n == 8 * 6 + 6 + 3
    expected = np.empty_like(found)
    for k in range(n):
        change = step * np.eye(n)[k]
        sides = [robot.with_parameters(robot.values + sign * change).positions(q)[:, 0] for sign in (1, -1)]
        expected[:, :, k] = (sides[0] - sides[1]) / (2 * step)
    assert relative_error(found, expected) <= 1e-6


def pose_loop_files(tmp_path):
    """A five-bar as a 6d closure: the second tip has a joint of its own, so that three rows close three joints."""
    names = ("ground", "left", "left_end", "right", "right_end", "tip_left", "tip_right")

    def joint(name, parent, child, xyz, kind="revolute"):
        return (
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{xyz}" rpy="0.02 -0.01 0.03"/><axis xyz="0 0 1"/>'
            '<limit lower="-7" upper="7" effort="1" velocity="1"/></joint>'
        )

    text = (
        "<robot name='pose_loop'>"
        + "".join(f'<link name="{name}"/>' for name in names)
        + "".join(
            [
                joint("motor_left", "ground", "left", "-0.1 0 0"),
                joint("motor_right", "ground", "right", "0.1 0 0"),
                joint("elbow_left", "left", "left_end", "0.3 0 0"),
                joint("elbow_right", "right", "right_end", "0.3 0 0"),
                joint("tip_left_origin", "left_end", "tip_left", "0.4 0 0", "fixed"),
                joint("tip_right_turn", "right_end", "tip_right", "0.4 0 0"),
            ]
        )
        + "</robot>"
    )
    (tmp_path / "pose_loop.urdf").write_text(text)
    return text


def test_a_6d_closure_has_an_exact_derivative_too(tmp_path):
    pose_loop_files(tmp_path)
    yaml = (
        "urdf: pose_loop.urdf\nname_mot: [motor_left, motor_right]\nclosed_loop: [[tip_left, tip_right]]\ntype: [6d]\n"
        "closed_loop_axes: [[x, y, rz]]\nbase: {frame: ground}\n"
        "targets: {tip: {frame: tip_left, xyz: [0.05, 0.02, 0.1]}}\n"
        "parametrisation: [{origin: all, components: [x, y, z], sigma: 1 mm},"
        " {origin: all, components: [rx, ry, rz], sigma: 1 mrad}]\n"
        "home: {motor_left: 2.0, motor_right: 1.1, elbow_left: LEFT, elbow_right: RIGHT, tip_right_turn: TURN}\n"
    )
    # the assembled home from the planar geometry; the tilts of the origins open it by less than the 1 mm allowed
    a, b = 2.0 + 0.03, 1.1 + 0.03
    left, right = (
        np.array([-0.1 + 0.3 * np.cos(a), 0.3 * np.sin(a)]),
        np.array([0.1 + 0.3 * np.cos(b), 0.3 * np.sin(b)]),
    )
    across = right - left
    tip = (left + right) / 2 + np.sqrt(0.16 - across @ across / 4) * np.array([-across[1], across[0]]) / np.linalg.norm(
        across
    )
    angles = [np.arctan2(*(tip - end)[::-1]) for end in (left, right)]
    values = {
        "LEFT": angles[0] - a - 0.03,
        "RIGHT": angles[1] - b - 0.03,
        "TURN": (angles[0] + 0.03) - (angles[1] + 0.03),
    }
    for key, value in values.items():
        yaml = yaml.replace(key, repr(float(value)))
    (tmp_path / "pose_loop.yaml").write_text(yaml)
    robot = calib.load(tmp_path / "pose_loop.yaml")
    q = np.array([2.0, 1.1]) + np.random.default_rng(2).uniform(-0.3, 0.3, (8, 2))
    found = linearise(robot, robot.assemble(q)).jacobian[:, 0]
    step, n = 1e-5, len(robot.values)  # the loops close to 1e-13, which a smaller step would show
    for k in range(n):
        change = step * np.eye(n)[k]
        sides = [robot.with_parameters(robot.values + sign * change).positions(q)[:, 0] for sign in (1, -1)]
        expected = ((sides[0] - sides[1]) / (2 * step))[:, :, None]
        assert relative_error(found[:, :, k : k + 1], expected) <= 1e-6, robot.parameters[k].name
