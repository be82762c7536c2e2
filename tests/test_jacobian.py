"""The identification Jacobian against central differences, all parameters and all components of every origin."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from small_robots import write_pose_loop

import calib
from calib.core.numerics.identifiability import numerical_rank
from calib.core.rows.jacobian import linearise, origin_jacobian
from medrue import robot_file
from medrue.closed_form import forward
from medrue.paper_tables import table1
from medrue.workspace import target_workspace


@pytest.fixture(scope="module")
def robot():
    return calib.load(robot_file())


def relative_error(result, expected):
    """Largest difference of a column, relative to that column's largest entry (to 1 mm per unit for zero columns)."""
    scale = np.maximum(np.max(np.abs(expected), axis=(0, 1)), 1e-3)
    return np.max(np.abs(result - expected) / scale)


@pytest.mark.parametrize("values", [table1().nominal, table1().actual], ids=["nominal", "actual"])
def test_all_36_columns_agree_with_differences_of_the_closed_form(robot, values):
    q = target_workspace().q[::6]
    at = robot.with_parameters(values)
    result = linearise(at, at.assemble(q)).jacobian[:, 0]
    step = 1e-6
    expected = np.empty_like(result)
    for k in range(36):
        change = step * np.eye(36)[k]
        expected[:, :, k] = (forward(q, values + change).p_world_tool - forward(q, values - change).p_world_tool) / (
            2 * step
        )
    assert relative_error(result, expected) <= 1e-6


@pytest.mark.quick(0)
def test_all_six_components_of_every_origin_agree_with_differences(robot):
    """Along a direction in which each of them takes part."""
    q = target_workspace().q[::40]
    at = robot.with_parameters(table1().actual)
    result = origin_jacobian(at.mechanism, at.assemble(q))[1][:, 0]
    step, rng = 1e-6, np.random.default_rng(2)
    for i, name in enumerate(at.mechanism.origin_names):
        placement = at.mechanism.placement(name)
        direction, sides = rng.uniform(0.5, 1.0, 6) * rng.choice([-1, 1], 6), []
        for sign in (1, -1):
            moved = {name: placement * pin.exp6(sign * step * direction)}
            sides.append(replace(at, mechanism=at.mechanism.with_placements(moved)).positions(q)[:, 0])
        expected = (sides[0] - sides[1]) / (2 * step)
        along = result[:, :, 6 * i : 6 * i + 6] @ direction
        assert relative_error(along[:, :, None], expected[:, :, None]) <= 1e-6, name


def test_positions_come_with_the_derivative(robot):
    q = target_workspace().q[::20]
    configurations = robot.assemble(q)
    linear = linearise(robot, configurations)
    assert np.max(np.abs(linear.positions[:, 0] - forward(q, table1().nominal).p_world_tool)) < 1e-11


def test_the_rank_at_nominal_is_28_of_36_with_a_wide_gap(robot):
    jacobian = linearise(robot, robot.assemble(target_workspace().q)).jacobian.reshape(-1, 36)
    rank = numerical_rank(jacobian * np.array([parameter.sigma_si for parameter in robot.parameters]))
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
    result = linearise(robot, robot.assemble(q)).jacobian[:, 0]
    step, n = 1e-6, len(robot.values)
    assert n == 8 * 6 + 6 + 3
    expected = np.empty_like(result)
    for k in range(n):
        change = step * np.eye(n)[k]
        sides = [robot.with_parameters(robot.values + sign * change).positions(q)[:, 0] for sign in (1, -1)]
        expected[:, :, k] = (sides[0] - sides[1]) / (2 * step)
    assert relative_error(result, expected) <= 1e-6


def test_a_6d_closure_has_an_exact_derivative_too(tmp_path):
    robot = calib.load(write_pose_loop(tmp_path))
    q = np.array([2.0, 1.1]) + np.random.default_rng(2).uniform(-0.3, 0.3, (8, 2))
    result = linearise(robot, robot.assemble(q)).jacobian[:, 0]
    step, n = 1e-5, len(robot.values)  # the loops close to 1e-13, which a smaller step would show
    for k in range(n):
        change = step * np.eye(n)[k]
        sides = [robot.with_parameters(robot.values + sign * change).positions(q)[:, 0] for sign in (1, -1)]
        expected = ((sides[0] - sides[1]) / (2 * step))[:, :, None]
        assert relative_error(result[:, :, k : k + 1], expected) <= 1e-6, robot.parameters[k].name
