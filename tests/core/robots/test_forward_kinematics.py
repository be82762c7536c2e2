"""Forward kinematics of any tree against yourdfpy, and of an edited URDF against the robot that wrote it."""

import re
from pathlib import Path

import numpy as np
import pytest
import yourdfpy

import calib
from calib.core.base.errors import DescriptionError
from tests.public_data import EXAMPLE_ROBOTS
from tests.small_robots import small_arm
from tests.urdf_trees import described, random_tree

ONE_PICOMETRE = 1e-12
"""Rounding over 20 transforms of lengths up to a few metres stays below 1e-14 m; this leaves room."""


def assert_same_kinematics_as_yourdfpy(robot, path, generator, count=3):
    other = yourdfpy.URDF.load(str(path), load_meshes=False, build_scene_graph=True)
    for _ in range(count):
        q = generator.uniform(-3, 3, len(robot.joint_names))
        other.update_cfg(dict(zip(robot.joint_names, q.tolist(), strict=True)))
        links = robot.urdf.links
        for link in links[:: max(1, len(links) // 12)]:
            expected = other.get_transform(link, robot.urdf.root)
            assert np.abs(robot.forward(q, link) - expected).max() < ONE_PICOMETRE, link


@pytest.mark.quick(0)
def test_random_trees_have_the_same_forward_kinematics_as_in_yourdfpy(tmp_path):
    generator = np.random.default_rng(11)
    for k in range(25):
        text, actuated = random_tree(generator, int(generator.integers(3, 15)))
        path = tmp_path / f"tree{k}.urdf"
        path.write_text(text)
        urdf = yourdfpy.URDF.load(str(path), build_scene_graph=False)
        ends = {joint.child for joint in urdf.robot.joints} - {joint.parent for joint in urdf.robot.joints}
        if actuated:
            robot = described(path, actuated, "l0", min(ends))
            assert_same_kinematics_as_yourdfpy(robot, path, generator)


EXAMPLES = (
    "ur_description/urdf/ur5_robot.urdf",
    "talos_data/robots/talos_full_v2.urdf",
    "tiago_description/robots/tiago_dual.urdf",
    "double_pendulum_description/urdf/double_pendulum_continuous.urdf",
    "hector_description/robots/quadrotor_base.urdf",
    "panda_description/urdf/panda.urdf",
)


@pytest.mark.parametrize("name", EXAMPLES)
def test_real_robots_have_the_same_forward_kinematics_as_in_yourdfpy(name, tmp_path):
    if not EXAMPLE_ROBOTS.is_dir():
        pytest.skip("the package example-robot-data is not installed")
    path = tmp_path / "robot.urdf"
    path.write_bytes((EXAMPLE_ROBOTS / name).read_bytes())
    urdf = calib.core.robots.urdf.text.read_urdf(path)
    moving = [j.name for j in urdf.joints if j.type in ("revolute", "continuous", "prismatic") and j.mimic is None]
    if not moving:
        with pytest.raises(DescriptionError, match="no joint moves link"):
            calib.load(path)
        return
    robot = described(path, moving, urdf.root, urdf.links[-1])
    assert_same_kinematics_as_yourdfpy(robot, path, np.random.default_rng(12), count=1)


def test_an_edited_urdf_reloads_to_the_same_kinematics(tmp_path, medrue):
    generator = np.random.default_rng(13)
    robots = [medrue, small_arm(tmp_path)]
    for k in range(5):
        text, actuated = random_tree(generator, 12)
        path = tmp_path / f"tree{k}.urdf"
        path.write_text(text)
        robots.append(described(path, actuated, "l0", "l11"))
    for robot in robots:
        size = 2e-3 if robot is medrue else 0.3
        edited = robot.with_parameters(robot.values + generator.normal(0, size, len(robot.values)))
        (tmp_path / "edited.urdf").write_bytes(edited.calibrated_urdf())
        yaml = Path(robot.path).read_text()
        yaml = re.sub("^urdf: .*$", f"urdf: {tmp_path / 'edited.urdf'}", yaml, count=1, flags=re.MULTILINE)
        if robot is medrue:  # its home is not closed with other parameters
            assembled = edited.assemble(robot.home)
            for name, value in zip(robot.passive_names, assembled.passive[0].tolist(), strict=True):
                yaml = re.sub(f"^  {name}: .*$", f"  {name}: {value!r}", yaml, flags=re.MULTILINE)
        (tmp_path / "edited.yaml").write_text(yaml)
        reloaded = calib.load(tmp_path / "edited.yaml")
        q = robot.home + generator.normal(0, 0.05, (5, len(robot.home)))
        for link in robot.urdf.links:
            assert np.abs(reloaded.forward(q, link) - edited.forward(q, link)).max() < ONE_PICOMETRE, link
        changed = robot.forward(q) - edited.forward(q)
        assert np.abs(changed).max() > 1e-4  # the edit did something
