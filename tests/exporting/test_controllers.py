"""Files for controllers and ROS: what they hold is loaded back here by other code, and what they leave is measured."""

import json
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
import yaml
from click.testing import CliRunner
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import calib
from calib.core.robots.file_formats import formats
from calib.exporting.command import command
from calib.exporting.controllers import dh_file, joint_offsets, ur_kinematics, xacro_origins
from calib.starting.command import command as init
from medrue.paper_tables import table1
from tests.project import EXAMPLES, ROOT, SHARED
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


def ur_urdf(axis: str = "0 0 1") -> str:
    """The joints of ur_description for a UR10e, with a prefix and a tool behind the flange."""

    def origin(xyz: str, rpy: str) -> str:
        return f'<origin xyz="{xyz}" rpy="{rpy}"/>'

    joints = [("left_mount", "fixed", "left_base_link", "left_base_link_inertia", origin("0 0 0", "0 0 3.14159265359"))]
    joints += [
        (f"left_{name}", "revolute", f"left_{parent}", f"left_{child}", origin(xyz, rpy), f'<axis xyz="{axis}"/>')
        for name, parent, child, xyz, rpy in UR_JOINTS
    ]
    flange = origin("0 0 0", f"0 -{HALF} -{HALF}")
    joints.append(("left_wrist_3-flange", "fixed", "left_wrist_3_link", "left_flange", flange))
    joints.append(("left_tool_mount", "fixed", "left_flange", "left_tool", origin("0.12 0.01 0.02", "0 0.1 0")))
    return urdf_of(*joints)


def ur_robot(folder: Path, changed: dict[str, float], axis: str = "0 0 1") -> calib.Robot:
    (folder / "ur.urdf").write_text(ur_urdf(axis))
    (folder / "ur.yaml").write_text(
        "urdf: ur.urdf\nname_mot: [" + ", ".join(f"left_{joint[0]}" for joint in UR_JOINTS) + "]\n"
        "base: {frame: left_base_link}\ntargets: {probe: {frame: left_tool, xyz: [0, 30 mm, 100 mm]}}\n"
        "parametrisation:\n  - {origin: all, components: [x, y, z], sigma: 1 mm}\n"
        "  - {origin: all, components: [rx, ry, rz], sigma: 1 mrad}\n"
    )
    robot = calib.load(folder / "ur.yaml")
    start = dict(zip([parameter.name for parameter in robot.parameters], robot.values.tolist(), strict=True))
    return robot.with_parameters({name: start[name] + value for name, value in changed.items()})


def shaken(robot: calib.Robot, seed: int, skip: tuple[str, ...] = ()) -> dict[str, float]:
    """A millimetre or milliradian of error for every parameter, but of origins with these names."""
    generator = np.random.default_rng(seed)
    names = [parameter.name for parameter in robot.parameters]
    return {name: float(generator.normal(0, 1e-3)) for name in names if name.rpartition(".")[0] not in skip}


def changed_arm(seed: int = 4) -> calib.Robot:
    robot = calib.load(ARM)
    return robot.with_parameters(robot.values + np.random.default_rng(seed).normal(0, 1e-3, len(robot.values)))


def ur_product(content: bytes, behind: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Poses of the tool in base_link, as ur_description builds its chain from the file."""
    kinematics = yaml.safe_load(content)["kinematics"]
    assert isinstance(kinematics.pop("hash"), str)
    assert list(kinematics) == ["shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3"]
    results = []
    for row in q:
        pose = np.diag([-1.0, -1.0, 1.0, 1.0])  # base_link to base_link_inertia: half a turn
        for entry, value in zip(kinematics.values(), row, strict=True):
            origin = np.eye(4)
            angles = zip("xyz", (entry["roll"], entry["pitch"], entry["yaw"]), strict=True)
            roll, pitch, yaw = (pin.utils.rotate(axis, float(angle)) for axis, angle in angles)
            origin[:3, :3] = yaw @ pitch @ roll
            origin[:3, 3] = entry["x"], entry["y"], entry["z"]
            turn = np.eye(4)
            turn[:3, :3] = pin.utils.rotate("z", float(value))
            pose = pose @ origin @ turn
        results.append(pose @ behind)
    return np.array(results)


def tool_behind_wrist(robot: calib.Robot) -> np.ndarray:
    """What the URDF has behind wrist_3, nominal."""
    return np.linalg.inv(robot.forward(np.zeros(6), "left_wrist_3_link")) @ robot.forward(np.zeros(6), "left_tool")


PROBE = np.array([0, 0.03, 0.1, 1.0])


def test_ur_kinematics_hold_what_is_before_wrist_3(tmp_path: Path) -> None:
    nominal = ur_robot(tmp_path, {})
    changes = shaken(nominal, 1, skip=("left_wrist_3-flange", "left_tool_mount"))
    robot = ur_robot(tmp_path, changes)
    made = ur_kinematics(robot)
    q = np.random.default_rng(2).uniform(-3, 3, (1000, 6))
    difference = ur_product(made.content, tool_behind_wrist(nominal), q) - robot.forward(q, "left_tool")
    assert np.abs(difference).max() < 1e-9
    assert "held exactly" in made.remainder.text()
    assert "held exactly" in made.statement


def test_a_turn_and_a_shift_about_the_last_axis_have_a_place(tmp_path: Path) -> None:
    nominal = ur_robot(tmp_path, {})
    robot = ur_robot(tmp_path, {"left_wrist_3-flange.z": 2e-3, "left_wrist_3-flange.rx": 5e-3})  # its x is the axis
    made = ur_kinematics(robot)
    q = np.random.default_rng(2).uniform(-3, 3, (20, 6))
    result = ur_product(made.content, tool_behind_wrist(nominal), q)
    assert np.abs(result - robot.forward(q, "left_tool")).max() < 1e-12


def test_what_ur_kinematics_leave_is_stated(tmp_path: Path) -> None:
    nominal = ur_robot(tmp_path, {})
    robot = ur_robot(tmp_path, shaken(nominal, 1))
    made = ur_kinematics(robot)
    q = np.random.default_rng(2).uniform(-3, 3, (200, 6))
    error = ur_product(made.content, tool_behind_wrist(nominal), q) - robot.forward(q, "left_tool")
    distance = np.linalg.norm(error @ PROBE, axis=1)
    assert distance.max() > 1e-4
    assert made.remainder.largest == pytest.approx(
        distance.max(), rel=1e-6
    )  # the same in every pose: it is behind all joints
    assert f"{1000 * distance.max():.4g} mm at most" in made.content.decode()


@pytest.mark.skipif(not REAL_UR10.exists(), reason="needs the UR10 of ../shared/data")
def test_a_urdf_of_ur_description(tmp_path: Path) -> None:
    (tmp_path / "ur10.yaml").write_text(
        f"urdf: {REAL_UR10}\nname_mot: [{', '.join(joint[0] for joint in UR_JOINTS)}]\nbase: {{frame: base_link}}\n"
        "targets: {tool0: {frame: tool0}}\n"
        "parametrisation: [{origin: all, components: [x, y, z], sigma: 1 mm}]\n"
    )
    robot = calib.load(tmp_path / "ur10.yaml")
    changes = shaken(robot, 5, skip=("wrist_3-flange", "flange-tool0"))
    start = dict(zip([parameter.name for parameter in robot.parameters], robot.values.tolist(), strict=True))
    robot = robot.with_parameters({name: start[name] + value for name, value in changes.items()})
    q = np.random.default_rng(2).uniform(-3, 3, (200, 6))
    difference = ur_product(ur_kinematics(robot).content, np.eye(4), q) - robot.forward(q, "wrist_3_link")
    assert np.abs(difference).max() < 1e-9


def test_the_page_has_a_row_for_every_format() -> None:
    page = (ROOT / "docs" / "howto" / "controllers.md").read_text()
    section = page.partition("## What each format holds")[2].partition("\n## ")[0]
    rows = [line.split("|")[1] for line in section.splitlines() if line.startswith("| `") and "`--format`" not in line]
    assert sorted(name for row in rows for name in re.findall("`([^`]+)`", row)) == sorted(formats())


def read_offsets(content: bytes) -> dict[str, tuple[float, float]]:
    lines = [line.split(",") for line in content.decode().splitlines() if not line.startswith("#")]
    assert lines[0] == ["joint", "sign", "offset", "unit"]
    per_unit = {"deg": np.pi / 180, "mm": 1e-3}
    return {name: (float(sign), float(offset) * per_unit[unit]) for name, sign, offset, unit in lines[1:]}


def test_joint_zeros_that_are_all_that_is_wrong_are_found(tmp_path: Path) -> None:
    """The third axis meets the tip's height only; turn and wrist are angles, slide a length."""
    robot = calib.load(write_arm(tmp_path))
    wrong = robot.with_parameters({"turn.rz": 2e-3, "slide.x": 0.25 + 3e-4, "wrist.ry": -4e-3})
    made = joint_offsets(wrong)
    result = read_offsets(made.content)
    assert {name: sign for name, (sign, _) in result.items()} == {"turn": 1, "slide": 1, "wrist": 1}
    assert [offset for _, offset in result.values()] == pytest.approx([2e-3, 3e-4, -4e-3], abs=1e-12)
    assert "held exactly" in made.remainder.text()


def test_a_joint_that_counts_the_other_way_gets_its_sign(tmp_path: Path) -> None:
    terms = ARM_YAML + "  - {joint: turn, term: gain, sigma: 0.001}\n"
    robot = calib.load(write_arm(tmp_path, terms)).with_parameters({"turn.gain": -2.0, "turn.rz": 0.01})
    assert read_offsets(joint_offsets(robot).content)["turn"] == (-1.0, pytest.approx(0.01, abs=1e-9))


def test_zeros_that_no_target_shows_stay_zero(tmp_path: Path) -> None:
    on_axis = ARM_YAML.replace("tool, xyz: [10 mm, 20 mm, 30 mm]", "hand")  # the origin of the wrist
    robot = calib.load(write_arm(tmp_path, on_axis)).with_parameters({"turn.rz": 2e-3, "wrist.ry": -4e-3})
    result = read_offsets(joint_offsets(robot).content)
    assert result["turn"][1] == pytest.approx(2e-3, abs=1e-12)
    assert abs(result["wrist"][1]) < 1e-9


def test_what_joint_zeros_leave_is_stated() -> None:
    """The file applied to a Pinocchio model of the nominal URDF, against one of the calibrated, at other poses.

    Base and target are unknown here, so that they are placed anew, by a solver of another make.
    """
    nominal, robot = calib.load(ARM), changed_arm()
    made = joint_offsets(robot)
    offsets = [offset for _, offset in read_offsets(made.content).values()]
    lower, upper = np.array([(j.lower, j.upper) for j in robot.urdf.joints if j.name in robot.joint_names]).T
    q = np.random.default_rng(6).uniform(lower, upper, (N_RANDOM, 6))
    target = robot.mechanism.targets[0]
    point = np.append(robot.mechanism.model.jointPlacements[target.b].translation, 1.0)
    expected, frames = (flange_poses(robot, q) @ point)[:, :3], flange_poses(nominal, q + offsets)

    def error(x: np.ndarray) -> np.ndarray:
        points = (frames @ np.add(point, [*x[6:], 0]))[:, :3]
        return (Rotation.from_rotvec(x[:3]).apply(points) + x[3:6] - expected).ravel()

    distance = np.linalg.norm(least_squares(error, np.zeros(9)).fun.reshape(-1, 3), axis=1)
    assert offsets[0] == pytest.approx(0, abs=1e-9)  # the base can do it
    assert "base and target placed anew" in made.statement
    assert made.remainder.rms == pytest.approx(np.sqrt(np.mean(distance**2)), rel=0.01)
    assert f"{1000 * made.remainder.rms:.4g} mm RMS" in made.content.decode()


@pytest.mark.quick(0)
def test_joint_zeros_of_a_robot_with_loops() -> None:
    """MedRUE with the paper's errors of its motors alone."""
    robot = calib.load(ROOT / "urdf" / "medrue.yaml")
    names = [parameter.name for parameter in robot.parameters]
    zeros = {name: value for name, value in zip(names, table1().actual, strict=True) if name.startswith("dq")}
    made = joint_offsets(robot.with_parameters(zeros))
    assert "held exactly" in made.remainder.text()
    assert "near home" in made.statement
    assert [offset for _, offset in read_offsets(made.content).values()] == pytest.approx(
        list(zeros.values()), abs=1e-9
    )


def test_what_a_table_leaves_of_joint_terms_is_stated(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text((ARM.parent / "arm.urdf").read_text())
    (tmp_path / "arm.yaml").write_text(
        ARM.read_text().replace("sigma: 0.03 mm", "").rstrip() + "\n  - {joint: joint_2, term: gain}\n"
    )
    robot = calib.load(tmp_path / "arm.yaml").with_parameters({"joint_2.gain": 1e-3, "joint_3.x": 1e-3})
    made = dh_file(robot, "standard")
    assert "no joint terms (of joint_2)" in made.statement
    lower, upper = np.array([(j.lower, j.upper) for j in robot.urdf.joints if j.name in robot.joint_names]).T
    q = np.random.default_rng(6).uniform(lower, upper, (N_RANDOM, 6))
    point = np.array([0.02, 0, 0.05, 1])
    error = (flange_poses(robot, q) - flange_poses(robot, q * [1, 1.001, 1, 1, 1, 1])) @ point
    distance = np.linalg.norm(error[:, :3], axis=1)
    assert made.remainder.rms == pytest.approx(np.sqrt(np.mean(distance**2)), rel=0.01)


def test_xacro_origins_are_those_of_the_calibrated_urdf() -> None:
    robot = changed_arm()
    by_name = {
        element.get("name"): [float(part) for part in element.get("value").split()]
        for element in ElementTree.fromstring(xacro_origins(robot).content)
    }
    for joint in ElementTree.fromstring(robot.calibrated_urdf()).iter("joint"):
        name, origin = joint.get("name"), joint.find("origin")
        for key in ("xyz", "rpy"):
            written = [float(part) for part in origin.get(key, "0 0 0").split()]
            assert by_name[f"{name}_{key}"] == pytest.approx(written, abs=1e-14)


XACRO = """\
<robot name="small" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:include filename="origins.xacro"/>
  <xacro:property name="reach" value="0.125"/>
  ARM
</robot>
"""


def test_a_xacro_is_read_and_takes_the_origins_back(tmp_path: Path) -> None:
    pytest.importorskip("xacro", reason="needs the package xacro")
    robot = calib.load(write_arm(tmp_path)).with_parameters({"slide.y": 1e-3, "wrist.rx": 2e-3, "flange.rz": 1e-3})
    (tmp_path / "origins.xacro").write_bytes(xacro_origins(robot).content)
    body = re.search(r"<robot.*?>(.*)</robot>", ARM_URDF, re.DOTALL).group(1)
    for name in ("turn", "slide", "wrist", "flange"):
        pattern = rf'(name="{name}".*?)<origin[^>]*>'
        origin = rf'\1<origin xyz="${{{name}_xyz}}" rpy="${{{name}_rpy}}"/>'
        body = re.sub(pattern, origin, body, count=1, flags=re.DOTALL)
    (tmp_path / "arm.urdf.xacro").write_text(XACRO.replace("ARM", body))
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
def test_arguments_without_a_value_are_named_and_kept_in_the_description(tmp_path: Path) -> None:
    pytest.importorskip("xacro", reason="needs the package xacro")
    text = MACRO.replace("</robot>", '<xacro:arm prefix="$(arg prefix)$(arg side)"/></robot>').replace(
        "<robot", '<robot name="arm"'
    )
    (tmp_path / "arm.urdf.xacro").write_text(text)
    with pytest.raises(
        calib.UrdfError, match=r"no value for prefix, side: .*--xacro prefix:=VALUE --xacro side:=VALUE"
    ):
        calib.load(tmp_path / "arm.urdf.xacro")
    arguments = [str(tmp_path / "arm.urdf.xacro"), "--xacro", "prefix:=ur_", "--out", str(tmp_path / "arm.yaml")]
    assert "no value for side" in CliRunner().invoke(init, arguments).output
    assert CliRunner().invoke(init, [*arguments, "--xacro", "side:=left_"]).exit_code == 0
    assert calib.load(tmp_path / "arm.yaml").joint_names == ("ur_left_j1",)
    (tmp_path / "lost.urdf.xacro").write_text(
        text.replace("<xacro:m", '<xacro:include filename="$(find no)/a"/><xacro:m', 1)
    )
    with pytest.raises(calib.UrdfError, match="no package 'no' around or beside the file"):
        calib.load(tmp_path / "lost.urdf.xacro")
    (tmp_path / "empty.urdf.xacro").write_text(
        '<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arg name="dof" default=""/>'
        '<xacro:include filename="arm_$(arg dof).xacro"/></robot>'
    )
    with pytest.raises(
        calib.UrdfError,
        match=r"not there \(arm_\.xacro\); these arguments are empty: dof; give them: --xacro dof:=VALUE",
    ):
        calib.load(tmp_path / "empty.urdf.xacro")


def test_without_the_package_the_message_says_how_to_get_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "first").mkdir()
    (tmp_path / "first" / "xacro.py").write_text("raise ImportError('as where it is not installed')\n")
    monkeypatch.syspath_prepend(tmp_path / "first")
    (tmp_path / "arm.urdf.xacro").write_text("<robot/>")
    with pytest.raises(calib.UrdfError, match="pip install xacro"):
        calib.load(tmp_path / "arm.urdf.xacro")


def test_mesh_paths_get_a_prefix(tmp_path: Path) -> None:
    mesh = '<visual><geometry><mesh scale="1 1 1" filename="{}"/></geometry></visual>'
    names = ("meshes/a.stl", "package://other/b.dae", "/abs/c.stl", "file:///d.stl")
    links = [f'<link name="{name}"/>' for name in ("upper", "slider", "hand", "tool")]
    urdf = ARM_URDF
    for link, name in zip(links, names, strict=True):
        urdf = urdf.replace(link, link.replace("/>", f">{mesh.format(name)}</link>"))
    write_arm(tmp_path, urdf=urdf)
    arguments = [str(tmp_path / "arm.yaml"), "--format", "urdf", "--out", str(tmp_path / "out.urdf")]
    result = CliRunner().invoke(command, [*arguments, "--meshes", "package://my_robot"])
    assert result.exit_code == 0
    expected = urdf.replace('"meshes/a.stl', '"package://my_robot/meshes/a.stl')
    assert (tmp_path / "out.urdf").read_text().startswith(expected)
    assert "start at the folder" not in result.output


def test_the_command_says_what_is_held(tmp_path: Path) -> None:
    arguments = [str(ARM), "--format", "dh", "--out", str(tmp_path / "arm.csv")]
    result = CliRunner().invoke(command, arguments)
    assert "holds the 6 joints from base_link to flange: held exactly" in result.stdout
    (tmp_path / "arm.csv").unlink()
    result = CliRunner().invoke(command, [*arguments, "--json", "-"])
    assert "held exactly" in json.loads(result.stdout)["notes"][0]


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
def test_robots_that_a_format_cannot_hold(
    file_format: str, old: str, new: str, words: str | None, tmp_path: Path
) -> None:
    path = write_arm(tmp_path, ARM_YAML.replace(old, new), ARM_URDF.replace(old, new))
    result = CliRunner().invoke(command, [str(path), "--format", file_format, "--out", str(tmp_path / "out")])
    if words is None:
        assert result.exit_code == 0
        return
    assert result.exit_code == 2
    assert words in result.output
    assert result.output.count("\n") == 1
    assert not (tmp_path / "out").exists()
