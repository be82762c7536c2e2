"""yourdfpy, urdf_parser_py and check_urdf (urdfdom): all read the exported files."""

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yourdfpy
from scipy.spatial.transform import Rotation


def test_yourdfpy_has_every_link_where_pinocchio_does(case) -> None:
    robot = yourdfpy.URDF.load(str(case.folder / "robot.urdf"), load_meshes=False)

    def pose(values: dict[str, float], link: str) -> np.ndarray:
        robot.update_cfg(values)
        return robot.get_transform(link, frame_from="world")

    assert case.largest_difference("yourdfpy, URDF", pose) < 1e-9


@pytest.mark.quick(0)
def test_urdf_parser_py_reads_joints_that_put_every_link_where_pinocchio_does(case) -> None:
    urdf = pytest.importorskip(
        "urdf_parser_py.urdf", reason="urdf_parser_py is not installed (in a checkout: pip install -e '.[interop]')"
    )
    robot = urdf.URDF.from_xml_string((case.folder / "robot.urdf").read_bytes())
    assert set(robot.link_map) == set(case.robot.urdf.links)

    def pose(values: dict[str, float], link: str) -> np.ndarray:
        result = np.eye(4)
        while link in robot.parent_map:
            name, link = robot.parent_map[link]
            result = transform(robot.joint_map[name], values.get(name, 0.0)) @ result
        return result

    assert case.largest_difference("urdf_parser_py, URDF", pose) < 1e-9


def transform(joint, value: float) -> np.ndarray:
    """Origin and motion of a joint, from its numbers alone."""
    result, motion = np.eye(4), np.eye(4)
    result[:3, :3] = Rotation.from_euler("xyz", joint.origin.rpy).as_matrix()
    result[:3, 3] = joint.origin.xyz
    if joint.type == "prismatic":
        motion[:3, 3] = value * np.array(joint.axis)
    elif joint.type != "fixed":
        motion[:3, :3] = Rotation.from_rotvec(value * np.array(joint.axis)).as_matrix()
    return result @ motion


@pytest.mark.quick(1)
@pytest.mark.parametrize("file", ["robot.urdf", "drake.urdf", "free_drake.urdf"])
def test_check_urdf_accepts_the_file(case, file: str) -> None:
    beside_python = Path(sys.executable).parent / "check_urdf"
    program = str(beside_python) if beside_python.exists() else shutil.which("check_urdf")
    if program is None:
        pytest.skip("check_urdf (Debian: liburdfdom-tools) is not installed")
    result = subprocess.run([program, str(case.folder / file)], capture_output=True, text=True, timeout=30, check=False)
    assert result.returncode == 0, result.stderr
    assert "Successfully Parsed XML" in result.stdout
