"""Robots from MuJoCo's files: kinematics as MuJoCo computes them, loops, what URDF cannot hold, `calib init`."""

import sys

import numpy as np
import pinocchio as pin
import pytest
import trimesh

import calib
from calib.core.base.errors import UrdfError
from calib.core.robots.urdf.meshes import find_mesh
from calib.core.robots.urdf.text import read_urdf
from calib.files.mjcf_reading import read_mjcf
from calib.shared.pose_check import check_poses
from tests.core.robots.test_loops import by_hand

mujoco = pytest.importorskip("mujoco")

ARM = """<mujoco model="odd"><compiler angle="degree"/>
<default><default class="sliding"><joint type="slide" axis="1 0 0"/></default></default>
<worldbody><geom type="plane" size="1 1 .1"/>
 <body name="base" pos=".1 .2 .3" euler="10 20 30"><geom size=".1"/>
  <body name="upper" pos="0 0 .3" quat=".9 .1 .3 .2">
   <joint name="turn" axis="0 1 1" pos=".05 .02 -.01" range="-90 90" ref="20"/>
   <joint name="push" class="sliding" pos=".3 .1 0" ref=".07" range="-.5 .5"/>
   <geom type="capsule" size=".02 .1"/>
   <body name="fore" pos=".4 0 0" euler="0 40 0"><joint name="wrist"/>
    <geom type="box" size=".1 .02 .03" pos=".1 0 0" mass="2"/>
    <site name="tip" pos=".2 .01 .02" euler="10 0 30"/>
    <body name="jaw" pos=".1 0 0"><joint name="jaw" type="slide" ref="0.01" range="0 .1"/><geom size=".01"/></body>
   </body></body></body></worldbody>
<equality><joint joint1="jaw" joint2="wrist" polycoef=".002 .03 0 0 0"/></equality>
<actuator><motor joint="turn"/><motor joint="push"/><position joint="wrist"/></actuator></mujoco>"""

FOLLOWS = '<joint joint1="jaw" joint2="wrist" polycoef=".002 .03 0 0 0"/>'
CLOTH = '<flexcomp name="c" type="grid" count="3 3 1" spacing=".1 .1 .1" radius=".01" mass="1"/>'
TENDON = '<tendon><fixed name="t"><joint joint="jaw" coef="1"/></fixed></tendon>'

LEFT = 2.199114857512855
FIVE_BAR = """<mujoco model="five_bar"><compiler angle="radian"/><worldbody><body name="table" euler=".3 .2 .1">
 <geom size=".01"/>
 <body name="left" pos="-.1 0 0" euler="0 0 {left}"><joint name="left_motor"/><geom size=".01" pos=".2 0 0"/>
  <body name="left_distal" pos=".2 0 0" euler="0 0 -1.4396290718713562"><joint name="left_elbow"/>
   <geom size=".01" pos=".3 0 0"/><site name="pen" pos=".3 0 0"/></body></body>
 <body name="right" pos=".1 0 0" euler="0 0 {right}"><joint name="right_motor"/><geom size=".01" pos=".2 0 0"/>
  <body name="right_distal" pos=".2 0 0" euler="0 0 {elbow}"><joint name="right_elbow"/>
   <geom size=".01" pos=".3 0 0"/><site name="end" pos=".3 0 0"/></body></body>
</body></worldbody><equality>{tie}</equality>
<actuator><motor joint="left_motor"/><motor joint="right_motor"/></actuator></mujoco>"""


def five_bar(tie):
    """The right arm is the mirror of the left one, so that both ends meet on the y axis."""
    return FIVE_BAR.format(left=LEFT, right=np.pi - LEFT, elbow=1.4396290718713562, tie=tie)


CONNECT = '<connect name="tie" body1="left_distal" body2="right_distal" anchor=".3 0 0"/>'


def test_frames_are_where_mujoco_has_them(tmp_path):
    (tmp_path / "arm.xml").write_text(ARM)
    robot = calib.load(tmp_path / "arm.xml")
    assert robot.joint_names == ("turn", "push", "wrist")
    assert robot.target_names == ("tip",)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
    data, q = mujoco.MjData(model), np.random.default_rng(0).uniform(-1.0, 1.0, (40, 3))
    for turn, push, wrist in q:
        data.qpos[:] = turn, push, wrist, 0.01 + 0.002 + 0.03 * wrist
        mujoco.mj_kinematics(model, data)
        for link in ("base", "upper", "fore", "jaw", "tip"):
            seen = data.site(link) if link == "tip" else data.body(link)
            pose = np.linalg.inv(robot.forward([turn, push, wrist], "world")) @ robot.forward([turn, push, wrist], link)
            assert np.allclose(pose[:3, 3], seen.xpos, rtol=0, atol=1e-12)
            assert np.allclose(pose[:3, :3], seen.xmat.reshape(3, 3), rtol=0, atol=1e-12)
    assert np.allclose(robot.joint_limits[0], np.deg2rad((-90, 90)))


def test_a_file_with_loops_is_closed_in_every_command(tmp_path, run_calib):
    (tmp_path / "five_bar.xml").write_text(five_bar(CONNECT))
    by_hand = (
        "urdf: five_bar.xml\nname_mot: [left_motor, right_motor]\nbase: {frame: table, pose: unknown}\n"
        "targets: {pen: {frame: pen, position: unknown}}\n"
        "parametrisation: [{origin: all, components: [x, y, z], sigma: 1 mm}]\n"
    )
    (tmp_path / "by_hand.yaml").write_text(by_hand)
    (tmp_path / "open.yaml").write_text(by_hand + "closed_loop: []\n")
    plain, described = calib.load(tmp_path / "five_bar.xml"), calib.load(tmp_path / "by_hand.yaml")
    for robot in (plain, described, calib.robot(tmp_path / "five_bar.xml", target="pen")):
        assert robot.joint_names == ("left_motor", "right_motor")
        assert robot.passive_names == ("left_elbow", "right_elbow")
    q = np.array([[0.1, -0.2]])
    assert np.allclose(plain.forward(q, "pen"), described.forward(q, "pen"), rtol=0, atol=1e-12)
    assert calib.load(tmp_path / "open.yaml").passive_names == ()
    done = run_calib("sample", "five_bar.xml", "-n", "2", "--out", "poses.csv", cwd=tmp_path)
    assert done.code == 0
    said = "note: the arm is taken to end at pen; another end, such as end: calib init --target NAME\n"
    assert done.err.startswith(said)


LEG = """<mujoco model="leg"><worldbody><body name="hip"><geom size=".02"/>
 <body name="shin" pos="0 0 -.4"><joint name="knee" axis="0 1 0" range="-1 1"/><geom size=".02" pos=".1 0 -.2"/>
  <body name="tarsus" pos=".1 0 -.4"><joint name="ankle" axis="0 1 0"/><geom size=".02" pos=".1 0 0"/>
   <site name="foot" pos=".2 0 -.1"/>
   <body name="heel" pos="-.05 0 0"><joint name="heel" axis="0 1 0" stiffness="1250"/><geom size=".01"/></body></body>
 </body><body name="rod" pos="0 .03 -.1"><joint name="rod" type="ball"/><geom size=".01" pos=".02 0 -.3"/></body>
</body></worldbody><equality><connect name="achilles" body1="rod" body2="heel" anchor=".05 -.03 -.7"/></equality>
<actuator><motor joint="knee"/></actuator></mujoco>"""


def test_a_leg_with_a_spring_and_a_rod_gets_a_description(tmp_path, run_calib):
    (tmp_path / "leg.xml").write_text(LEG)
    done = run_calib("init", "leg.xml", "--target", "foot", "--out", "leg.yaml", cwd=tmp_path)
    assert done.code == 0, done.err
    assert "rod_x and rod_y: the spin of this rod about itself moves nothing" in done.out
    assert "springs count as motors, with columns for their deflections: heel" in done.out
    robot = calib.load(tmp_path / "leg.yaml")
    assert (robot.joint_names, {*robot.passive_names}) == (("knee", "heel"), {"ankle", "rod_x", "rod_y"})
    q = np.array([[0.02, 0.0], [-0.03, 0.05]])
    rod = np.linalg.inv(robot.forward(q, "rod")) @ robot.forward(q, "achilles_b")  # the rod keeps its length
    assert np.allclose(np.linalg.norm(rod[:, :3, 3], axis=1), np.linalg.norm((0.05, -0.03, -0.7)), rtol=0, atol=1e-9)


def test_meshes_beside_a_relative_path_are_found(tmp_path, monkeypatch):
    (tmp_path / "arm" / "assets").mkdir(parents=True)
    trimesh.creation.box((0.1, 0.1, 0.1)).export(tmp_path / "arm" / "assets" / "box.stl")
    (tmp_path / "arm" / "arm.xml").write_text(
        '<mujoco><compiler meshdir="assets"/><asset><mesh name="box" file="box.stl"/></asset><worldbody><body name="a">'
        '<joint name="j"/><geom type="mesh" mesh="box"/></body></worldbody></mujoco>'
    )
    for folder, path in ((tmp_path, "arm/arm.xml"), (tmp_path / "arm", "arm.xml")):
        monkeypatch.chdir(folder)
        file = read_urdf(path).source.decode().split('filename="')[1].split('"')[0]
        assert find_mesh(file, path) is not None


def test_masses_are_those_of_mujoco(tmp_path):
    (tmp_path / "arm.xml").write_text(ARM)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
    data = mujoco.MjData(model)
    data.qpos[:] = 0.3, -0.2, 0.5, 0.01 + 0.002 + 0.03 * 0.5
    mujoco.mj_forward(model, data)
    built = pin.buildModelFromXML(read_urdf(tmp_path / "arm.xml").source.decode())
    assert pin.computeTotalMass(built) == pytest.approx(np.sum(model.body_mass) - model.body("base").mass[0])
    q = pin.neutral(built)
    for name, value in zip(("turn", "push", "jaw"), (0.3, -0.2, data.qpos[3]), strict=True):
        q[built.joints[built.getJointId(name)].idx_q] = value
    wrist = built.joints[built.getJointId("wrist")]
    q[wrist.idx_q : wrist.idx_q + 2] = np.cos(0.5), np.sin(0.5)
    torques = pin.computeGeneralizedGravity(built, built.createData(), q)
    for name in ("turn", "push", "wrist", "jaw"):
        number = model.joint(name).dofadr[0]
        own = torques[built.joints[built.getJointId(name)].idx_v]
        assert own == pytest.approx(data.qfrc_bias[number], abs=1e-9)


@pytest.mark.parametrize(
    ("tie", "kind", "axes"),
    [
        (CONNECT, "3d", ("x", "y")),
        ('<connect name="tie" site1="pen" site2="end"/>', "3d", ("x", "y")),
        ('<weld name="tie" site1="pen" site2="end"/>', "6d", ("x", "y", "z", "rx", "ry", "rz")),
    ],
)
def test_loops_are_cut_open_and_hold_the_directions_that_move(tmp_path, tie, kind, axes):
    (tmp_path / "five_bar.xml").write_text(five_bar(tie))
    _, read = read_mjcf(str(tmp_path / "five_bar.xml"))
    assert read.motors == ("left_motor", "right_motor")
    assert [(loop.links, loop.kind, loop.axes) for loop in read.loops] == [(("tie_a", "tie_b"), kind, axes)]


def test_a_five_bar_moves_as_its_circles_say(tmp_path, run_calib):
    (tmp_path / "five_bar.xml").write_text(five_bar(CONNECT))
    arguments = ["init", "five_bar.xml", "--target", "pen", "--measure", "tracker", "--out", "robot.yaml"]
    assert run_calib(*arguments, cwd=tmp_path).code == 0
    robot = calib.load(tmp_path / "robot.yaml")
    assert robot.passive_names == ("left_elbow", "right_elbow")
    q = np.random.default_rng(1).uniform(-0.3, 0.3, (30, 2))
    pen = [[*by_hand(LEFT + left, np.pi - LEFT + right, 1), 0.0] for left, right in q]
    result = np.linalg.inv(robot.forward(q, "table")) @ robot.forward(q, "pen")
    assert np.allclose(result[:, :3, 3], pen, rtol=0, atol=1e-9)


def test_ball_joints_are_three_hinges_and_free_bodies_stand_still(tmp_path, run_calib):
    (tmp_path / "ball.xml").write_text(
        '<mujoco><worldbody><body name="base"><freejoint/><geom size=".1"/><body name="arm" pos="0 0 1">'
        '<joint name="k" type="ball" pos="0 .1 .2"/><geom size=".1" pos="0 0 1"/></body></body></worldbody></mujoco>'
    )
    said = run_calib("init", "ball.xml", "--out", "ball.yaml", cwd=tmp_path).out
    assert "body base moves freely in the file, and stands still here" in said
    assert "ball joint k is three hinges, k_x, k_y and k_z" in said
    robot = calib.load(tmp_path / "ball.yaml")
    q = np.random.default_rng(2).uniform(-1.0, 1.0, (20, 3))
    result = np.linalg.inv(robot.forward(q, "world")) @ robot.forward(q, "arm")
    centre = result[:, :3, :3] @ [0.0, 0.1, 0.2] + result[:, :3, 3]
    assert np.allclose(centre, [0.0, 0.1, 1.2], rtol=0, atol=1e-12)  # the ball stays where it is


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("<mujoco><worldbody>", "MuJoCo cannot read it: XML parse error"),
        (ARM.replace(".03 0 0 0", ".03 1 0 0"), "is not linear, or not between two joints"),
        (ARM.replace(' joint2="wrist"', ""), "is not linear, or not between two joints"),
        (
            ARM.replace("<equality>", f"{TENDON}<equality>").replace(FOLLOWS, '<tendon tendon1="t"/>'),
            "ties neither bodies nor joints",
        ),
        ('<mujoco><include file="missing.xml"/></mujoco>', "MuJoCo cannot read it"),
        (ARM.replace(' range="0 .1"', ""), "joint 'jaw' slides without a range"),
        ("<mujoco/>", "there is nothing to calibrate"),
        (ARM.replace("</worldbody>", f"{CLOTH}</worldbody>"), "has soft bodies (flex)"),
        (five_bar(CONNECT).replace("actuator", "sensor").replace("motor joint", "jointpos joint"), "no joint has an"),
    ],
)  # fmt: skip
def test_what_cannot_be_read_is_said_in_one_line(tmp_path, run_calib, text, said):
    (tmp_path / "robot.xml").write_text(text)
    done = run_calib("init", "robot.xml", "--out", "robot.yaml", cwd=tmp_path)
    assert said in done.refusal()
    assert "robot.xml" in done.err
    assert not (tmp_path / "robot.yaml").exists()


def test_without_mujoco_the_way_is_named(tmp_path, monkeypatch):
    (tmp_path / "arm.xml").write_text(ARM)
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(UrdfError, match=r"arm\.xml: is an MJCF file.*pip install mujoco"):
        calib.load(tmp_path / "arm.xml")


SHAPED = """<mujoco model="shaped"><compiler angle="radian"/><default><geom contype="0" conaffinity="0" group="2"/>
<default class="hit"><geom contype="1" conaffinity="1" group="3"/></default></default><worldbody>
<geom class="hit" type="plane" size="1 1 .1" pos="0 0 -9"/>
<body name="a"><geom class="hit" type="cylinder" size=".05 .05"/><geom size=".01"/>
 <body name="b" pos="0 0 .2"><joint name="j1" axis="0 0 1" range="-3 3"/><geom size=".01"/>
 <body name="c" pos="0 0 .1"><joint name="j2" axis="0 1 0" range="-2 2"/><geom size=".01"/>
  <geom class="hit" type="capsule" size=".04 .15" pos="0 0 .2"/>
  <body name="d" pos="0 0 .4"><joint name="j3" axis="0 1 0" range="-3 3"/><geom size=".01"/>
   <geom class="hit" type="capsule" size=".03 .12" pos="0 0 .16"/>
   <geom class="hit" type="ellipsoid" size=".01 .01 .02"/>
   <body name="e" pos="0 0 .34"><joint name="j4" axis="0 1 0" range="-3 3"/><geom size=".01"/>
    <geom class="hit" type="box" size=".03 .02 .1" pos="0 0 .12"/><site name="tip" pos="0 0 .2"/>
</body></body></body></body></body></worldbody></mujoco>"""


def test_shapes_that_collide_in_mujoco_collide_here(tmp_path, run_calib):
    (tmp_path / "arm.xml").write_text(SHAPED)
    robot = calib.robot(tmp_path / "arm.xml", self_clearance=0.0)
    q = robot.sample(300, 1)
    check, model = check_poses(robot, q), mujoco.MjModel.from_xml_string(SHAPED)
    data, theirs = mujoco.MjData(model), []
    for row in q:
        data.qpos[:] = row
        mujoco.mj_forward(model, data)
        theirs.append(any(contact.dist < 0 and 0 not in model.geom_bodyid[contact.geom] for contact in data.contact))
    assert check.unchecked == ""
    assert 0.05 < np.mean(theirs) < 0.95
    assert np.mean(check.is_free == theirs) <= 0.01  # contacts by less than what both round
    run = run_calib("init", "arm.xml", "--out", "arm.yaml", cwd=tmp_path)
    assert "ollision shapes left out, which a URDF cannot hold (write 'obstacles' for them): of world, d" in run.out


def test_warnings_of_mujoco_are_notes_and_leave_no_file(tmp_path, monkeypatch, caplog):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.xml").write_text(ARM.replace('axis="0 1 1"', 'axis="0 1 nan"'))
    with pytest.raises(UrdfError, match="'nan' is not a number"):
        calib.load("a.xml")
    assert "a.xml: MuJoCo says: XML contains a 'NaN'" in caplog.text
    assert [path.name for path in tmp_path.iterdir()] == ["a.xml"]
