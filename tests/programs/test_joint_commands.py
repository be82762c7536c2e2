"""Commands bring joints with errors to where they should be, or are unknown."""

import numpy as np
import pytest

import calib
from calib.core.robots.joint_errors import actual_joints, term_columns
from calib.programs.reaching.joint_commands import commands_for
from tests.core.robots.terms.test_compliance import ARM, ARM_YAML, HALF, PLAY, poses
from tests.core.robots.terms.test_joint_terms import near_home, with_terms
from tests.project import EXAMPLES


def test_commands_undo_the_joint_errors(tmp_path):
    terms = ["{joint: all, term: gain}", "{joint: all, term: harmonics, orders: [1, 17]}"]
    five_bar = with_terms(tmp_path, "five_bar.yaml", terms)
    values = five_bar.values.copy()
    values[five_bar.coefficients] = 2e-3
    robot = five_bar.with_parameters(values)
    expected = near_home(robot, 8, 7)
    commands = commands_for(robot, expected)
    assert np.allclose(actual_joints(robot, commands, term_columns(robot, commands)), expected, rtol=0, atol=1e-12)


def test_commands_undo_a_coupling(tmp_path):
    first, second = calib.load(EXAMPLES / "five_bar.yaml").joint_names
    robot = with_terms(tmp_path, "five_bar.yaml", [f"{{joint: {second}, term: coupling, driven_by: {first}}}"])
    robot = robot.with_parameters({f"{second}.by_{first}": 2e-3})
    q = near_home(robot, 4, 4)
    expected = q + np.column_stack([np.zeros(4), 2e-3 * q[:, 0]])
    assert np.allclose(commands_for(robot, expected), q, rtol=0, atol=1e-12)


def test_commands_undo_play_that_gravity_takes_up(tmp_path):
    (tmp_path / "arm.urdf").write_text(ARM)
    (tmp_path / "arm.yaml").write_text(ARM_YAML + PLAY)
    robot = calib.load(tmp_path / "arm.yaml").with_parameters({"lift.gravity_backlash": HALF[1]})
    q = poses(robot, 8, 9)
    actual = actual_joints(robot, q, term_columns(robot, q))
    assert np.allclose(commands_for(robot, actual), q, rtol=0, atol=1e-9)


@pytest.mark.parametrize("upright", [-1, 1])
def test_commands_across_a_change_of_side_are_found_or_unknown(tmp_path, upright):
    (tmp_path / "arm.urdf").write_text(ARM)
    (tmp_path / "arm.yaml").write_text(ARM_YAML + PLAY.replace("torque: 2", "torque: 0.05"))
    robot = calib.load(tmp_path / "arm.yaml").with_parameters({"lift.gravity_backlash": 5e-3})
    lift = upright * np.pi / 2 + np.linspace(-0.15, 0.15, 201)  # the arm stands upright between, or hangs down
    actual = np.stack([0 * lift, lift, 0 * lift], axis=1)
    commands = commands_for(robot, actual)
    known = np.isfinite(commands).all(axis=1)
    back = actual_joints(robot, commands[known], term_columns(robot, commands[known]))
    assert np.allclose(back, actual[known], rtol=0, atol=1e-9)
    assert np.mean(known) > 0.9
