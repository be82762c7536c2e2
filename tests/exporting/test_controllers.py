"""Files for controllers and ROS: what they hold is loaded back here by other code, and what they leave is measured."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import yaml

import calib
from calib.core.robots.file_formats import FormatFile, formats
from calib.exporting.controllers import dh_file, joint_offsets, ur_kinematics, xacro_origins
from medrue.paper_tables import table1
from tests.exporting.read_back import held_out, in_file, joint_zeros
from tests.project import EXAMPLES, ROOT, SHARED, copied
from tests.small_robots import ARM_URDF, ARM_YAML, write_arm
from tests.starting.test_denavit_hartenberg import flange_poses
from tests.urdf_trees import urdf_of

ARM = EXAMPLES / "arm.yaml"
REAL_UR10 = SHARED / "ur10" / "robot.urdf"
N_RANDOM = 20000
"""Random poses that show an RMS error to 0.4 %."""
HALF = "1.5707963267948966"
UR_JOINTS = (
    ("shoulder_pan_joint", "base_link_inertia", "shoulder_link", "0 0 0.1807", "0 0 0"),
    ("shoulder_lift_joint", "shoulder_link", "upper_arm_link", "0 0 0", f"{HALF} 0 0"),
    ("elbow_joint", "upper_arm_link", "forearm_link", "-0.6127 0 0", "0 0 0"),
    ("wrist_1_joint", "forearm_link", "wrist_1_link", "-0.57155 0 0.17415", "0 0 0"),
    ("wrist_2_joint", "wrist_1_link", "wrist_2_link", "0 -0.11985 0", f"{HALF} 0 0"),
    ("wrist_3_joint", "wrist_2_link", "wrist_3_link", "0 0.11655 0", f"-{HALF} 0 0"),
)


@pytest.fixture
def ur(tmp_path: Path) -> calib.Robot:
    return ur_robot(tmp_path)


def ur_robot(folder: Path) -> calib.Robot:
    """The joints of ur_description for a UR10e, with a prefix and a tool behind the flange."""

    def origin(xyz: str, rpy: str) -> str:
        return f'<origin xyz="{xyz}" rpy="{rpy}"/>'

    mount = ("left_mount", "fixed", "left_base_link", "left_base_link_inertia", origin("0 0 0", "0 0 3.14159265359"))
    joints = [
        (f"left_{name}", "revolute", f"left_{parent}", f"left_{child}", origin(xyz, rpy), '<axis xyz="0 0 1"/>')
        for name, parent, child, xyz, rpy in UR_JOINTS
    ]
    flange = ("left_wrist_3-flange", "fixed", "left_wrist_3_link", "left_flange", origin("0 0 0", f"0 -{HALF} -{HALF}"))
    tool = ("left_tool_mount", "fixed", "left_flange", "left_tool", origin("0.12 0.01 0.02", "0 0.1 0"))
    (folder / "ur.urdf").write_text(urdf_of(mount, *joints, flange, tool))
    return described_ur(folder / "ur.urdf", "left_", "left_tool, xyz: [0, 30 mm, 100 mm]", folder)


def described_ur(urdf: Path, prefix: str, target: str, folder: Path) -> calib.Robot:
    (folder / "ur.yaml").write_text(
        f"urdf: {urdf}\nname_mot: [{', '.join(prefix + joint[0] for joint in UR_JOINTS)}]\n"
        f"base: {{frame: {prefix}base_link}}\ntargets: {{probe: {{frame: {target}}}}}\n"
        "parametrisation:\n  - {origin: all, components: [x, y, z], sigma: 1 mm}\n"
        "  - {origin: all, components: [rx, ry, rz], sigma: 1 mrad}\n"
    )
    return calib.load(folder / "ur.yaml")


def shaken(robot: calib.Robot, seed: int, *skip: str) -> calib.Robot:
    """The robot with a millimetre or milliradian of error in every parameter, but of origins with these names."""
    errors = np.random.default_rng(seed).normal(0, 1e-3, len(robot.parameters))
    errors[[parameter.name.rpartition(".")[0] in skip for parameter in robot.parameters]] = 0.0
    return robot.with_parameters(robot.values + errors)


def ur_errors(nominal: calib.Robot, robot: calib.Robot, folder: Path, n: int) -> np.ndarray:
    """How far ur_description puts the target's link from where it is, (n, 4, 4)."""
    (folder / "kinematics.yaml").write_bytes(ur_kinematics(robot).content)
    q = np.random.default_rng(2).uniform(-3, 3, (n, 6))
    link = robot.description.targets["probe"].frame
    return in_file(nominal, "ur-kinematics", folder / "kinematics.yaml")(q) - robot.forward(q, link)


def test_ur_kinematics_hold_what_is_before_wrist_3(ur: calib.Robot, tmp_path: Path) -> None:
    robot = shaken(ur, 1, "left_wrist_3-flange", "left_tool_mount")
    assert np.abs(ur_errors(ur, robot, tmp_path, 1000)).max() < 1e-9
    made = ur_kinematics(robot)
    kinematics = yaml.safe_load(made.content)["kinematics"]
    assert isinstance(kinematics.pop("hash"), str)
    assert list(kinematics) == ["shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3"]
    assert "held exactly" in made.statement


def test_a_turn_and_a_shift_about_the_last_axis_have_a_place(ur: calib.Robot, tmp_path: Path) -> None:
    robot = ur.with_parameters({"left_wrist_3-flange.z": 2e-3, "left_wrist_3-flange.rx": 5e-3})  # its x is the axis
    assert np.abs(ur_errors(ur, robot, tmp_path, 20)).max() < 1e-12


def test_what_ur_kinematics_leave_is_stated(ur: calib.Robot, tmp_path: Path) -> None:
    robot = shaken(ur, 1)
    made, error = ur_kinematics(robot), ur_errors(ur, robot, tmp_path, 200)
    distance = np.linalg.norm(error @ [0, 0.03, 0.1, 1.0], axis=1).max()
    assert distance > 1e-4
    # the same in every pose: it is behind all joints
    assert f"{1000 * distance:.4g} mm at most" in made.content.decode()


@pytest.mark.skipif(not REAL_UR10.exists(), reason="needs the UR10 of ../shared/data")
def test_a_urdf_of_ur_description(tmp_path: Path) -> None:
    nominal = described_ur(REAL_UR10, "", "tool0", tmp_path)
    robot = shaken(nominal, 5, "wrist_3-flange", "flange-tool0")
    assert np.abs(ur_errors(nominal, robot, tmp_path, 200)).max() < 1e-9


def test_the_page_has_a_row_for_every_format() -> None:
    page = (ROOT / "docs" / "howto" / "controllers.md").read_text()
    section = page.partition("## What each format holds")[2].partition("\n## ")[0]
    rows = [line.split("|")[1] for line in section.splitlines() if line.startswith("| `") and "`--format`" not in line]
    assert sorted(name for row in rows for name in re.findall("`([^`]+)`", row)) == sorted(formats())


def zeros_of(robot: calib.Robot, folder: Path) -> dict[str, tuple[float, float]]:
    (folder / "zeros.csv").write_bytes(joint_offsets(robot).content)
    return joint_zeros(folder / "zeros.csv")


def test_joint_zeros_that_are_all_that_is_wrong_are_found(tmp_path: Path) -> None:
    """The third axis meets the tip's height only; turn and wrist are angles, slide a length."""
    robot = calib.load(write_arm(tmp_path))
    wrong = robot.with_parameters({"turn.rz": 2e-3, "slide.x": 0.25 + 3e-4, "wrist.ry": -4e-3})
    result = zeros_of(wrong, tmp_path)
    assert {name: sign for name, (sign, _) in result.items()} == {"turn": 1, "slide": 1, "wrist": 1}
    assert [offset for _, offset in result.values()] == pytest.approx([2e-3, 3e-4, -4e-3], abs=1e-12)
    assert "held exactly" in joint_offsets(wrong).statement


def test_a_joint_that_counts_the_other_way_gets_its_sign(tmp_path: Path) -> None:
    terms = ARM_YAML + "  - {joint: turn, term: gain, sigma: 0.001}\n"
    robot = calib.load(write_arm(tmp_path, terms)).with_parameters({"turn.gain": -2.0, "turn.rz": 0.01})
    assert zeros_of(robot, tmp_path)["turn"] == (-1.0, pytest.approx(0.01, abs=1e-9))


def test_zeros_that_no_target_shows_stay_zero(tmp_path: Path) -> None:
    on_axis = ARM_YAML.replace("tool, xyz: [10 mm, 20 mm, 30 mm]", "hand")  # the origin of the wrist
    robot = calib.load(write_arm(tmp_path, on_axis)).with_parameters({"turn.rz": 2e-3, "wrist.ry": -4e-3})
    result = zeros_of(robot, tmp_path)
    assert result["turn"][1] == pytest.approx(2e-3, abs=1e-12)
    assert abs(result["wrist"][1]) < 1e-9


def stated_rms(made: FormatFile) -> float:
    """The error [m] that a file says it leaves."""
    return float(re.search(r"target: (\S+) mm RMS", made.statement)[1]) / 1000


def random_commands(robot: calib.Robot) -> np.ndarray:
    return np.random.default_rng(6).uniform(*robot.urdf.limits(robot.joint_names), (N_RANDOM, 6))


def test_what_joint_zeros_leave_is_stated(tmp_path: Path) -> None:
    """Base and target are unknown here, so that they are placed anew, by a solver of another make."""
    nominal = calib.load(ARM)
    robot = shaken(nominal, 4)
    made, q = joint_offsets(robot), random_commands(robot)
    assert zeros_of(robot, tmp_path)["joint_1"][1] == pytest.approx(0, abs=1e-9)  # the base can do it
    target = robot.mechanism.targets[0]
    point = np.append(robot.mechanism.model.jointPlacements[target.b].translation, 1.0)
    seen = (q, (flange_poses(robot, q) @ point)[:, :3])
    rms = held_out(in_file(nominal, "joint-offsets", tmp_path / "zeros.csv"), nominal, seen, seen)
    assert "base and target placed anew" in made.statement
    assert stated_rms(made) == pytest.approx(rms, rel=0.01)
    assert made.statement in made.content.decode()


@pytest.mark.quick(0)
def test_joint_zeros_of_a_robot_with_loops(medrue: calib.Robot, tmp_path: Path) -> None:
    """MedRUE with the paper's errors of its motors alone."""
    names = [parameter.name for parameter in medrue.parameters]
    zeros = {name: value for name, value in zip(names, table1().actual, strict=True) if name.startswith("dq")}
    robot = medrue.with_parameters(zeros)
    made = joint_offsets(robot)
    assert "held exactly" in made.statement
    assert "near home" in made.statement
    found = [offset for _, offset in zeros_of(robot, tmp_path).values()]
    assert found == pytest.approx(list(zeros.values()), abs=1e-9)


def test_what_a_table_leaves_of_joint_terms_is_stated(tmp_path: Path) -> None:
    held = ("sigma: 0.03 mm", "")
    robot = calib.load(copied(tmp_path, ARM, held, more="\n  - {joint: joint_2, term: gain}\n"))
    robot = robot.with_parameters({"joint_2.gain": 1e-3, "joint_3.x": 1e-3})
    made, q = dh_file(robot, "standard"), random_commands(robot)
    assert "no joint terms (of joint_2)" in made.statement
    error = (flange_poses(robot, q) - flange_poses(robot, q * [1, 1.001, 1, 1, 1, 1])) @ [0.02, 0, 0.05, 1]
    distance = np.linalg.norm(error[:, :3], axis=1)
    assert stated_rms(made) == pytest.approx(np.sqrt(np.mean(distance**2)), rel=0.01)


def test_a_xacro_is_read_and_takes_the_origins_back(tmp_path: Path) -> None:
    pytest.importorskip("xacro", reason="needs the package xacro")
    robot = calib.load(write_arm(tmp_path)).with_parameters({"slide.y": 1e-3, "wrist.rx": 2e-3, "flange.rz": 1e-3})
    (tmp_path / "origins.xacro").write_bytes(xacro_origins(robot).content)
    reach = '<xacro:property name="reach" value="0.125"/>'
    start = '<robot name="small" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:include filename="origins.xacro"/>'
    text = re.sub("<robot.*?>", start + reach, ARM_URDF, count=1)
    for name in ("turn", "slide", "wrist", "flange"):
        pattern = rf'(name="{name}".*?)<origin[^>]*>'
        origin = rf'\1<origin xyz="${{{name}_xyz}}" rpy="${{{name}_rpy}}"/>'
        text = re.sub(pattern, origin, text, count=1, flags=re.DOTALL)
    (tmp_path / "arm.urdf.xacro").write_text(text)
    (tmp_path / "arm.yaml").write_text(ARM_YAML.replace("arm.urdf", "arm.urdf.xacro"))
    again = calib.load(tmp_path / "arm.yaml")
    q = np.random.default_rng(1).uniform(-1, 1, (20, 3))
    assert np.abs(again.positions(q) - robot.positions(q)).max() < 1e-12


MACRO = (
    '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro name="arm" params="prefix">'
    '<link name="${prefix}base"/><link name="${prefix}l1"/><joint name="${prefix}j1" type="continuous">'
    '<parent link="${prefix}base"/><child link="${prefix}l1"/></joint></xacro:macro></robot>'
)


def package(folder: Path, name: str) -> Path:
    """A folder that is a package of ROS."""
    folder.mkdir(parents=True)
    (folder / "package.xml").write_text(f"<package><name>{name}</name></package>")
    return folder


@pytest.mark.parametrize("place", ["around", "beside", "AMENT_PREFIX_PATH", "ROS_PACKAGE_PATH"])
def test_packages_are_found_without_ros(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: str) -> None:
    pytest.importorskip("xacro", reason="needs the package xacro")
    own = package(tmp_path / "src" / "robots" / "own_files", "own")
    folders = {"around": own, "beside": tmp_path / "src" / "robots" / "macros"}
    folder = folders.get(place, tmp_path / "elsewhere" / "share" / "macros")
    if place != "around":
        package(folder, "macros")
        monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "elsewhere") if place == "AMENT_PREFIX_PATH" else "")
        monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "elsewhere") if place == "ROS_PACKAGE_PATH" else "")
    (folder / "macro.xacro").write_text(MACRO)
    (own / "urdf").mkdir()
    (own / "urdf" / "arm.urdf.xacro").write_text(
        '<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:include'
        f' filename="$(find {"own" if place == "around" else "macros"})/macro.xacro"/><xacro:arm prefix="p_"/></robot>'
    )
    assert calib.load(own / "urdf" / "arm.urdf.xacro").joint_names == ("p_j1",)


@pytest.mark.quick(0)
def test_arguments_without_a_value_are_named_and_kept_in_the_description(tmp_path: Path, run_calib) -> None:
    pytest.importorskip("xacro", reason="needs the package xacro")
    text = MACRO.replace("</robot>", '<xacro:arm prefix="$(arg prefix)$(arg side)"/></robot>').replace(
        "<robot", '<robot name="arm"'
    )
    (tmp_path / "arm.urdf.xacro").write_text(text)
    said = r"no value for prefix, side: .*--xacro prefix:=VALUE --xacro side:=VALUE"
    with pytest.raises(calib.UrdfError, match=said):
        calib.load(tmp_path / "arm.urdf.xacro")
    arguments = ("init", tmp_path / "arm.urdf.xacro", "--xacro", "prefix:=ur_", "--out", tmp_path / "arm.yaml")
    assert "no value for side" in run_calib(*arguments).err
    assert run_calib(*arguments, "--xacro", "side:=left_").code == 0
    assert calib.load(tmp_path / "arm.yaml").joint_names == ("ur_left_j1",)
    lost = text.replace("<xacro:m", '<xacro:include filename="$(find no)/a"/><xacro:m', 1)
    (tmp_path / "lost.urdf.xacro").write_text(lost)
    with pytest.raises(calib.UrdfError, match="no package 'no' around or beside the file"):
        calib.load(tmp_path / "lost.urdf.xacro")
    (tmp_path / "empty.urdf.xacro").write_text(
        '<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arg name="dof" default=""/>'
        '<xacro:include filename="arm_$(arg dof).xacro"/></robot>'
    )
    said = r"not there \(arm_\.xacro\); these arguments are empty: dof; give them: --xacro dof:=VALUE"
    with pytest.raises(calib.UrdfError, match=said):
        calib.load(tmp_path / "empty.urdf.xacro")


def test_without_the_package_the_message_says_how_to_get_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "first").mkdir()
    (tmp_path / "first" / "xacro.py").write_text("raise ImportError('as where it is not installed')\n")
    monkeypatch.syspath_prepend(tmp_path / "first")
    (tmp_path / "arm.urdf.xacro").write_text("<robot/>")
    with pytest.raises(calib.UrdfError, match="pip install xacro"):
        calib.load(tmp_path / "arm.urdf.xacro")


def test_mesh_paths_get_a_prefix(tmp_path: Path, run_calib) -> None:
    mesh = '<visual><geometry><mesh scale="1 1 1" filename="{}"/></geometry></visual>'
    names = ("meshes/a.stl", "package://other/b.dae", "/abs/c.stl", "file:///d.stl")
    links = [f'<link name="{name}"/>' for name in ("upper", "slider", "hand", "tool")]
    urdf = ARM_URDF
    for link, name in zip(links, names, strict=True):
        urdf = urdf.replace(link, link.replace("/>", f">{mesh.format(name)}</link>"))
    arguments = (write_arm(tmp_path, urdf=urdf), "--format", "urdf", "--out", tmp_path / "out.urdf")
    result = run_calib("export", *arguments, "--meshes", "package://my_robot")
    assert result.code == 0
    expected = urdf.replace('"meshes/a.stl', '"package://my_robot/meshes/a.stl')
    assert (tmp_path / "out.urdf").read_text().startswith(expected)
    assert "start at the folder" not in result.out + result.err


def test_the_command_says_what_is_held(tmp_path: Path, run_calib) -> None:
    arguments = ("export", ARM, "--format", "dh", "--out", tmp_path / "arm.csv")
    assert "holds the 6 joints from base_link to flange: held exactly" in run_calib(*arguments).out
    notes = json.loads(run_calib(*arguments, "--force", "--json", "-").out)["notes"]
    assert "held exactly" in notes[0]


@pytest.mark.parametrize(
    ("file_format", "old", "new", "words"),
    [
        ("dh", "frame: ground", "frame: hand", "no joint with a motor between hand and tool"),
        ("dh", "frame: tool, xyz", "frame: ground, xyz", "no joint with a motor between ground and ground"),
        ("mdh", "ground}\n", "tool}\n", "no joint with a motor between tool and tool"),
        ("ur-kinematics", "turn", "turn", "needs the joints"),
        ("xacro", '"flange"', '"wr-ist"', None),
    ],
)
def test_robots_that_a_format_cannot_hold(file_format, old, new, words, tmp_path: Path, run_calib) -> None:
    path = write_arm(tmp_path, ARM_YAML.replace(old, new), ARM_URDF.replace(old, new))
    result = run_calib("export", path, "--format", file_format, "--out", tmp_path / "out")
    if words is None:
        assert result.code == 0
        return
    assert words in result.refusal()
    assert not (tmp_path / "out").exists()
