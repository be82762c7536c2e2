"""Compliance under gravity: torques against potential energy by other code, derivatives, recovery, through a loop."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.linearisation.jacobian import linearise

EXAMPLES = Path(__file__).parents[1] / "docs" / "examples"
G = 9.81
STEP = 1e-5

ARM = """\
<robot name="arm">
  <link name="base"><inertial><mass value="30"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="turn" type="revolute"><parent link="base"/><child link="post"/><origin xyz="0 0 0.3"/>
    <axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
  <link name="post"><inertial><origin xyz="0.05 0 0.1"/><mass value="8"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="lift" type="revolute"><parent link="post"/><child link="upper"/><origin xyz="0.1 0 0.2"/>
    <axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
  <link name="upper"><inertial><origin xyz="0.2 0 0.03"/><mass value="6"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="bend" type="revolute"><parent link="upper"/><child link="fore"/><origin xyz="0.5 0 0"/>
    <axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
  <link name="fore"><inertial><origin xyz="0.25 0 0"/><mass value="3"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="mount" type="fixed"><parent link="fore"/><child link="tool"/><origin xyz="0.4 0 0"/></joint>
  <link name="tool"><inertial><origin xyz="0 0 0.1"/><mass value="2"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
</robot>
"""
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


def arm_at(q):
    """Where the ball is and the potential energy of an arm with these joints (3,), by trigonometry alone."""
    turn, lift, bend = q

    def along(angle, x, z):  # a vector of the link, turned about y: x forward, z up
        return np.array([np.cos(angle) * x + np.sin(angle) * z, -np.sin(angle) * x + np.cos(angle) * z])

    shoulder = np.array([0.1, 0.5])
    elbow = shoulder + along(lift, 0.5, 0)
    tool = elbow + along(lift + bend, 0.4, 0)
    centres = [
        (6.0, shoulder + along(lift, 0.2, 0.03)),
        (3.0, elbow + along(lift + bend, 0.25, 0)),
        (2.0, tool + along(lift + bend, 0, 0.1)),
    ]
    out, up = tool + along(lift + bend, 0, 0.15)
    return np.array([np.cos(turn) * out, np.sin(turn) * out, up]), sum(G * mass * centre[1] for mass, centre in centres)


def five_bar_at(q):
    """The same of the five-bar of the examples put upright, its two arms met by the intersection of two circles."""
    motors = np.array([[-0.1, 0.0], [0.1, 0.0]])
    elbows = motors + 0.2 * np.stack([np.cos(q), np.sin(q)], axis=1)
    middle, apart = elbows.mean(axis=0), elbows[1] - elbows[0]
    half = np.linalg.norm(apart) / 2
    tip = middle + np.sqrt(0.3**2 - half**2) * np.array([-apart[1], apart[0]]) / (2 * half)
    heights = [(motors[k, 1] + elbows[k, 1]) / 2 for k in (0, 1)] + [(elbows[k, 1] + tip[1]) / 2 for k in (0, 1)]
    return np.array([*tip, 0.02]), sum(G * 0.2 * height for height in heights)


def torques(at, q):
    """dU/dq by central differences, which through a loop is virtual work, (n, n_joints)."""
    steps = STEP * np.eye(q.shape[1])
    return np.array([[(at(row + step)[1] - at(row - step)[1]) / (2 * STEP) for step in steps] for row in q])


def arm(folder):
    (folder / "arm.urdf").write_text(ARM)
    (folder / "arm.yaml").write_text(ARM_YAML)
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


@pytest.fixture(params=[arm, upright_five_bar])
def machine(request, tmp_path):
    return request.param(tmp_path)


def poses(robot, n, seed):
    return robot.home + np.random.default_rng(seed).uniform(-0.4, 0.4, (n, len(robot.home)))


def test_torques_are_the_slope_of_the_potential_energy(machine):
    robot, at = machine
    q = poses(robot, 12, 0)
    found = np.hstack(robot.term_columns(q))
    # differences of some 10 J by 1e-5 rad are good to 1e-9 N m, and their curvature to as much
    assert np.allclose(found, torques(at, q), rtol=0, atol=1e-6)
    assert np.abs(found).max() > 0.3


def test_columns_agree_with_central_differences(machine):
    robot, _ = machine
    q = poses(robot, 6, 1)
    values = robot.values.copy()
    values[robot.coefficients] = 3e-4
    bent = robot.with_parameters(values)
    jacobian = linearise(bent, bent.assemble(q)).jacobian
    for k in range(*robot.coefficients.indices(len(values))):
        change = np.zeros_like(values)
        change[k] = STEP
        more, less = (bent.with_parameters(values + sign * change).positions(q) for sign in (1, -1))
        difference = (more - less) / (2 * STEP)
        assert np.allclose(jacobian[..., k], difference, rtol=0, atol=1e-6 * max(1.0, np.abs(difference).max()))


def test_compliance_is_recovered_from_data_of_other_code(machine):
    robot, at = machine
    # origins known: over these poses, those of the five-bar can do nearly what its bending does
    held = tuple(p.name for p in robot.parameters[: robot.n_origin_parameters])
    robot = replace(robot, description=robot.description.model_copy(update={"held": held}))
    q = poses(robot, 80, 2)
    given = np.array([0.0, 6e-5, 9e-5]) if len(q[0]) == 3 else np.array([4e-4, 7e-4])
    measured = np.array([at(row)[0] for row in q + given * torques(at, q)])
    measured += 1e-5 * np.random.default_rng(3).standard_normal(measured.shape)
    fit = calib.fit(robot, calib.as_measurements(robot, q, measured), sigma=1e-5)
    assert fit.converged
    index = [k for k, name in enumerate(fit.free_names) if name.endswith(".compliance")]
    found, std = fit.robot.values[robot.coefficients], fit.statistics.std[index]
    assert np.all(np.abs(found - given)[given > 0] < 4 * std[given > 0])
    assert np.all(std[given > 0] < 0.05 * given[given > 0])


def test_without_masses_compliance_is_refused(tmp_path):
    (tmp_path / "arm.urdf").write_text(re.sub("<inertial>.*?</inertial>", "", ARM, flags=re.DOTALL))
    (tmp_path / "arm.yaml").write_text(ARM_YAML)
    robot = calib.load(tmp_path / "arm.yaml")
    with pytest.raises(calib.DescriptionError, match="needs masses"):
        robot.assemble(robot.home)
