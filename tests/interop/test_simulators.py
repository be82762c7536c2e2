"""Tools with the exported URDF and with their own formats, still and under gravity with servoed joints."""

import shutil
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.core.base.errors import InputError
from calib.exporting.formats import export
from tests.interop.simulators import Drake, MuJoCo, PyBullet, UrdfParser, Yourdfpy

SINGLE_PRECISION = 1e-6  # of links about 1 m from the base [m, rad]
SOFTNESS = 1e-5
"""Opening of a loop under gravity that docs/other_tools.md states [m]."""
SAG = 5e-5
"""Sag of the servos that docs/other_tools.md states, at the tool [m]; g / (2 pi 100 Hz)^2 is 2.5e-5 m for one motor."""
FORMATS = {MuJoCo: ("mjcf", "out.xml"), Drake: ("drake", "out.urdf")}
TOOLS = pytest.mark.parametrize("tool", FORMATS)


@pytest.mark.parametrize(
    ("tool", "file"),
    [
        *((MuJoCo, file) for file in ("robot.urdf", "robot.xml", "free.xml")),
        *((Drake, file) for file in ("robot.urdf", "drake.urdf", "free_drake.urdf", "robot.xml", "free.xml")),
        (PyBullet, "robot.urdf"),
        (Yourdfpy, "robot.urdf"),
        pytest.param(UrdfParser, "robot.urdf", marks=pytest.mark.quick(0)),
    ],
)
def test_every_link_is_where_pinocchio_says(case, tool, file: str) -> None:
    tolerance = SINGLE_PRECISION if tool is PyBullet else 1e-9
    assert case.largest_difference(f"{tool.__name__}, {file}", tool(case.folder / file).at) < tolerance


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


@pytest.mark.parametrize("file", ["drake.urdf", "robot.xml"])
def test_the_loops_and_the_motors_are_read(case, file: str) -> None:
    plant = Drake(case.folder / file).plant
    assert (plant.num_constraints(), plant.num_actuators()) == (3, 6)


def test_assembled_configurations_leave_no_tie_open(case) -> None:
    tool = MuJoCo(case.folder / "robot.xml")
    for values in case.joints:
        tool.put(values)
        ties = tool.open_ties()
        assert len(ties) == 9
        assert np.abs(ties).max() < 1e-12


@pytest.mark.parametrize("file", ["robot.xml", "free.xml"])
def test_the_keyframe_home_is_assembled_and_held_and_nothing_touches_the_floor(case, file: str) -> None:
    tool = MuJoCo(case.folder / file)
    model, data = tool.model, tool.data
    tool.mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    for name, value in zip(case.robot.joint_names, case.robot.home, strict=True):
        assert data.joint(name).qpos[0] == pytest.approx(value, abs=1e-12)
        assert data.actuator(name).ctrl[0] == pytest.approx(value, abs=1e-12)
    assert np.abs(tool.open_ties()).max() < 1e-12
    assert (model.nlight, model.geom("floor").contype[0], model.geom("floor").conaffinity[0]) == (1, 0, 0)


def held(tool, file, robot, q, values: dict[str, float], root: str = "world"):
    """The tool with servos at q (n,), and the joints where it rests."""
    simulator = tool(file, root)
    return simulator, simulator.hold(dict(zip(robot.joint_names, q, strict=True)), values)


@pytest.mark.quick(2)
@pytest.mark.parametrize(
    ("tool", "file"), [(MuJoCo, "robot.xml"), (MuJoCo, "free.xml"), (Drake, "drake.urdf"), (Drake, "free_drake.urdf")]
)
def test_under_gravity_the_loops_stay_closed_and_the_tool_is_where_calib_predicts(case, tool, file: str) -> None:
    opening = there = from_commanded = 0.0
    for k in range(0, 50, 7):
        simulator, actual = held(tool, case.folder / file, case.robot, case.q[k], case.joints[k])
        for a, b in case.robot.description.closed_loop:
            opening = max(opening, float(np.abs((simulator.pose(a) - simulator.pose(b))[:3, 3]).max()))
        place = simulator.pose("target_tool")[:3, 3]
        there = max(there, float(np.linalg.norm(place - case.robot.positions(actual)[0, 0])))
        from_commanded = max(from_commanded, float(np.linalg.norm(place - case.robot.positions(case.q[k])[0, 0])))
    print(f"{tool.__name__}, {file}: loops open by {opening:.1e} m; tool against predict at the joints where the servos"
          f" stand {there:.1e} m, at the commanded ones {from_commanded:.1e} m")  # fmt: skip
    assert opening < SOFTNESS
    assert there < SOFTNESS
    assert from_commanded < SAG


@TOOLS
def test_a_tilted_five_bar_is_strained_by_a_3d_constraint_and_stands_right_with_a_free_slide(
    tilted, tool, tmp_path
) -> None:
    q = tilted.home + np.array([0.0, 0.25, 0.2, 0.1, -0.2, 0.3])
    names = (*tilted.joint_names, *tilted.passive_names)
    joints = dict(zip(names, (*q, *tilted.assemble(q).passive[0]), strict=True))
    file_format, name = FORMATS[tool]
    misses = {}
    for free_slide in (False, True) if tool is MuJoCo else (True,):
        export(tilted, tmp_path / name, file_format, free_slide=free_slide)
        simulator, actual = held(tool, tmp_path / name, tilted, q, joints)
        place = simulator.pose("target_tool")[:3, 3]
        misses[free_slide] = np.linalg.norm(place - tilted.forward(q, "tool")[:3, 3])
    assert np.linalg.norm(place - tilted.forward(actual)[:3, 3]) < SOFTNESS
    assert misses[True] < SAG
    if tool is MuJoCo:
        print(f"MuJoCo, tilted five-bars: tool off by {misses[False]:.1e} m, with free slides by {misses[True]:.1e} m")
        assert misses[False] > 10 * SAG


def test_a_direction_in_which_the_mechanism_moves_is_refused_without_a_free_slide(slider_crank, tmp_path) -> None:
    with pytest.raises(InputError, match=r"direction x: .* the mechanism moves in this direction; use .*--free-slide"):
        export(slider_crank, tmp_path / "out.xml", "mjcf")
    export(slider_crank, tmp_path / "out.xml", "mjcf", free_slide=True)
    for angle in (-1.0, 0.3, 1.4):
        start = {"motor": angle, "pin": slider_crank.assemble([angle]).passive[0, 0]}
        simulator, (motor,) = held(MuJoCo, tmp_path / "out.xml", slider_crank, [angle], start)
        reach = 0.1 * np.cos(motor) + np.sqrt(0.3**2 - (0.1 * np.sin(motor)) ** 2)
        assert np.abs(simulator.pose("target_end")[:3, 3] - (reach, 0.0, 0.0)).max() < SOFTNESS


@TOOLS
def test_whole_frames_that_meet_are_tied(four_bar, tool, tmp_path) -> None:
    file_format, name = FORMATS[tool]
    export(four_bar, tmp_path / name, file_format)
    for angle in (0.9, 1.2, 1.5):
        start = {"motor": angle, "a": -angle, "foot": angle, "b": -angle}
        simulator, (motor,) = held(tool, tmp_path / name, four_bar, [angle], start, "ground")
        point = np.array([0.2 * np.cos(motor) + 0.1, 0.2 * np.sin(motor) + 0.05, 0.0])  # a parallelogram
        assert np.abs(simulator.pose("target_coupler")[:3, 3] - point).max() < SOFTNESS
        assert np.abs((simulator.pose("cut_1") - simulator.pose("cut_2"))[:3, :3]).max() < 1e-4


def test_a_follower_joint_follows_in_mujoco(tmp_path) -> None:
    joint = '<parent link="{}"/><child link="{}"/><axis xyz="{}"/><limit lower="-2" upper="2" effort="1" velocity="1"/>'
    mass = '<inertial><mass value="1"/><inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial>'
    (tmp_path / "follower.urdf").write_text(
        f'<robot name="follower"><link name="a"/><link name="b">{mass}</link><link name="c">{mass}</link>'
        f'<joint name="leader" type="prismatic">{joint.format("a", "b", "0 1 0")}</joint>'
        f'<joint name="follower" type="revolute">{joint.format("b", "c", "0 0 1")}'
        '<mimic joint="leader" multiplier="-2" offset="0.5"/></joint></robot>'
    )
    robot = calib.load(tmp_path / "follower.urdf")
    export(robot, tmp_path / "follower.xml", "mjcf")
    for value in (-0.3, 0.0, 0.4):
        start = {"leader": value, "follower": 0.5 - 2 * value}
        simulator, (leader,) = held(MuJoCo, tmp_path / "follower.xml", robot, [value], start)
        assert simulator.data.joint("follower").qpos[0] == pytest.approx(0.5 - 2 * leader, abs=1e-3)
        assert np.abs((simulator.pose("c") - robot.forward([value], "c"))[:3, :3]).max() < 1e-3


def test_meshes_load(tmp_path) -> None:
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1e-6]], dtype=float)  # as flat as meshes can be
    faces = [(0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)]
    triangles = b"".join(struct.pack("<12fH", 0, 0, 0, *corners[list(face)].ravel(), 0) for face in faces)
    (tmp_path / "flat.stl").write_bytes(b" " * 80 + struct.pack("<I", len(faces)) + triangles)
    mesh = '<geometry><mesh filename="flat.stl" scale="0.1 0.1 0.1"/></geometry>'
    (tmp_path / "arm.urdf").write_text(
        f'<robot name="arm"><link name="a"/><link name="b"><visual>{mesh}</visual><collision>{mesh}</collision></link>'
        '<joint name="j" type="continuous"><parent link="a"/><child link="b"/></joint></robot>'
    )
    export(calib.load(tmp_path / "arm.urdf"), tmp_path / "out.xml", "mjcf")
    model = MuJoCo(tmp_path / "out.xml").model
    assert (model.nmesh, model.ngeom) == (1, 3)  # the floor is one
