"""MuJoCo: the exported URDF and MJCF, still and under gravity with servoed joints."""

import struct
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import calib
from calib.core.base.errors import InputError
from calib.core.commands.predict import command as predict
from calib.core.data.measurement_files import read_measurements
from calib.exporting.formats import export
from tests.core.data.test_parameter_files import parameter_file

mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed (in a checkout: pip install -e '.[interop]')")

SOFTNESS = 1e-5
"""Opening of a loop under gravity that docs/other_tools.md states [m]."""
SAG = 5e-5
"""Sag of the servos that docs/other_tools.md states, at the tool [m]; g / (2 pi 100 Hz)^2 is 2.5e-5 m for one motor."""


def put(model, data, values: dict[str, float]) -> None:
    for name, value in values.items():
        data.qpos[model.joint(name).qposadr[0]] = value


@pytest.mark.parametrize("file", ["robot.urdf", "robot.xml", "free.xml"])
def test_every_link_is_where_pinocchio_says(case, file: str) -> None:
    model = mujoco.MjModel.from_xml_path(str(case.folder / file))
    data = mujoco.MjData(model)

    def move(values: dict[str, float]) -> None:
        put(model, data, values)
        mujoco.mj_kinematics(model, data)

    def pose(link: str):
        body = data.body(link)
        result = np.eye(4)
        result[:3, :3], result[:3, 3] = body.xmat.reshape(3, 3), body.xpos
        return result

    assert case.largest_difference(f"MuJoCo, {file}", move, pose) < 1e-9


def test_assembled_configurations_leave_no_tie_open(case) -> None:
    model = mujoco.MjModel.from_xml_path(str(case.folder / "robot.xml"))
    data = mujoco.MjData(model)
    for values in case.joints:
        put(model, data, values)
        mujoco.mj_forward(model, data)
        equalities = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
        assert equalities.sum() == 9
        assert np.abs(data.efc_pos[equalities]).max() < 1e-12


def hold(file: Path, robot: calib.Robot, q: np.ndarray, values: dict[str, float], seconds: float = 1.0):
    """Simulate with servos at q until the robot rests; returns the data and the joints where it stands."""
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    put(model, data, values)
    for name, value in zip(robot.joint_names, q, strict=True):
        data.actuator(name).ctrl[0] = value
    mujoco.mj_step(model, data, nstep=int(seconds / model.opt.timestep))
    mujoco.mj_forward(model, data)
    assert np.abs(data.qvel).max() < 1e-5
    return data, np.array([data.joint(name).qpos[0] for name in robot.joint_names])


@pytest.mark.parametrize("file", ["robot.xml", "free.xml"])
def test_the_keyframe_home_is_assembled_and_held_and_nothing_touches_the_floor(case, file: str) -> None:
    model = mujoco.MjModel.from_xml_path(str(case.folder / file))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    home = dict(zip(case.robot.joint_names, case.robot.home, strict=True))
    for name, value in home.items():
        assert data.joint(name).qpos[0] == pytest.approx(value, abs=1e-12)
        assert data.actuator(name).ctrl[0] == pytest.approx(value, abs=1e-12)
    mujoco.mj_forward(model, data)
    assert np.abs(data.efc_pos[data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY]).max() < 1e-12
    assert (model.nlight, model.geom("floor").contype[0], model.geom("floor").conaffinity[0]) == (1, 0, 0)


@pytest.mark.parametrize("file", ["robot.xml", "free.xml"])
def test_under_gravity_the_loops_stay_closed_and_the_tool_is_where_calib_predicts(case, file: str, tmp_path) -> None:
    rows = list(range(0, 50, 7))
    stood, tools, opening = [], [], 0.0
    for k in rows:
        data, actual = hold(case.folder / file, case.robot, case.q[k], case.joints[k])
        for a, b in case.robot.description.closed_loop:
            opening = max(opening, float(np.abs(data.body(a).xpos - data.body(b).xpos).max()))
        stood.append(actual)
        tools.append(data.body("target_tool").xpos.copy())
    there = np.linalg.norm(np.array(tools) - predict_by_command(case.robot, np.array(stood), tmp_path), axis=1).max()
    from_commanded = np.linalg.norm(np.array(tools) - case.robot.positions(case.q[rows])[:, 0], axis=1).max()
    print(f"MuJoCo, {file}: loops open by {opening:.1e} m; tool against predict at the joints where the servos stand"
          f" {there:.1e} m, at the commanded ones {from_commanded:.1e} m")  # fmt: skip
    assert opening < SOFTNESS
    assert there < SOFTNESS
    assert from_commanded < SAG


def predict_by_command(robot: calib.Robot, q: np.ndarray, folder: Path) -> np.ndarray:
    """Tool positions from `calib predict`, with the robot's values from a parameter file."""
    header = ",".join(f"{name} [{'m' if name == 'q1' else 'rad'}]" for name in robot.joint_names)
    np.savetxt(folder / "joints.csv", q, delimiter=",", header=header, comments="", fmt="%.17g")
    (folder / "values.csv").write_text(parameter_file(robot))
    out = folder / "predicted.csv"
    arguments = [robot.path, str(folder / "joints.csv"), "--parameters", str(folder / "values.csv"), "--out", str(out)]
    result = CliRunner().invoke(predict, arguments)
    assert result.exit_code == 0, result.output
    return read_measurements(out, robot).points(robot)[:, 0]


def test_a_tilted_five_bar_is_strained_by_a_3d_constraint_and_stands_right_with_a_free_slide(tilted, tmp_path) -> None:
    q = tilted.home + np.array([0.0, 0.25, 0.2, 0.1, -0.2, 0.3])
    configurations = tilted.assemble(q)
    joints = dict(zip(tilted.joint_names, q, strict=True)) | dict(
        zip(tilted.passive_names, configurations.passive[0], strict=True)
    )
    expected = tilted.forward(q, "tool")[:3, 3]
    misses = {}
    for free_slide in (False, True):
        export(tilted, tmp_path / "out.xml", "mjcf", free_slide=free_slide)
        data, actual = hold(tmp_path / "out.xml", tilted, q, joints)
        misses[free_slide] = np.linalg.norm(data.body("target_tool").xpos - expected)
        if free_slide:
            assert np.linalg.norm(data.body("target_tool").xpos - tilted.forward(actual)[:3, 3]) < SOFTNESS
    print(f"MuJoCo, tilted five-bars: tool off by {misses[False]:.1e} m, with free slides by {misses[True]:.1e} m")
    assert misses[True] < SAG
    assert misses[False] > 10 * SAG


def test_a_direction_in_which_the_mechanism_moves_is_refused_without_a_free_slide(slider_crank, tmp_path) -> None:
    with pytest.raises(InputError, match=r"direction x: .* the mechanism moves in this direction; use .*--free-slide"):
        export(slider_crank, tmp_path / "out.xml", "mjcf")
    export(slider_crank, tmp_path / "out.xml", "mjcf", free_slide=True)
    for angle in (-1.0, 0.3, 1.4):
        start = {"motor": angle, "pin": slider_crank.assemble([angle]).passive[0, 0]}
        data, actual = hold(tmp_path / "out.xml", slider_crank, np.array([angle]), start)
        reach = 0.1 * np.cos(actual[0]) + np.sqrt(0.3**2 - (0.1 * np.sin(actual[0])) ** 2)
        assert np.abs(data.body("target_end").xpos - (reach, 0.0, 0.0)).max() < SOFTNESS


def test_whole_frames_that_meet_are_welded(four_bar, tmp_path) -> None:
    export(four_bar, tmp_path / "out.xml", "mjcf")
    for angle in (0.9, 1.2, 1.5):
        start = {"motor": angle, "a": -angle, "foot": angle, "b": -angle}
        data, actual = hold(tmp_path / "out.xml", four_bar, np.array([angle]), start)
        point = np.array([0.2 * np.cos(actual[0]) + 0.1, 0.2 * np.sin(actual[0]) + 0.05, 0.0])  # a parallelogram
        assert np.abs(data.body("target_coupler").xpos - point).max() < SOFTNESS
        assert np.abs(data.body("cut_1").xmat - data.body("cut_2").xmat).max() < 1e-4


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
        data, actual = hold(tmp_path / "follower.xml", robot, np.array([value]), start)
        assert data.joint("follower").qpos[0] == pytest.approx(0.5 - 2 * actual[0], abs=1e-3)
        expected = robot.forward([value], "c")[:3, :3]
        assert np.abs(data.body("c").xmat.reshape(3, 3) - expected).max() < 1e-3


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
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "out.xml"))
    assert (model.nmesh, model.ngeom) == (1, 3)  # the floor is one
