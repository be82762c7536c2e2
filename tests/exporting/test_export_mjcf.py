"""MJCF of URDFs as people write them: masses that simulators refuse, meshes, mimic joints, names in any alphabet."""

import re
import struct
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin
import pytest
import trimesh

import calib
from calib.core.base.errors import InputError, UrdfError
from calib.core.robots.urdf.meshes import find_mesh
from calib.core.robots.urdf.text import parse_urdf
from calib.exporting.closed_model import closed_model, possible_inertia
from calib.exporting.drake import drake_bytes
from calib.exporting.formats import export
from calib.exporting.mjcf import Mjcf
from calib.shared.links import read_links
from tests.urdf_trees import urdf_of

ARM = """<?xml version="1.0"{encoding}?>
<robot name="{name}" xmlns:xacro="x">
  <material name="red"><color rgba="1 0 0 1"/></material>
  <link name="socle"><visual><geometry><box size="0.2 0.4 0.6"/></geometry><material name="red"/></visual></link>
  <joint name="drehung-ä" type="continuous"><parent link="socle"/><child link="bras"/><axis xyz="0 0 2"/>
    <origin xyz="0 0 0.3" rpy="0.1 0.2 0.3"/></joint>
  <link name="bras"><visual><origin xyz="0.5 0 0"/><geometry><cylinder radius="0.05" length="1"/></geometry></visual>
    <collision><geometry><sphere radius="0.1"/></geometry></collision></link>
  <joint name="slide" type="prismatic"><parent link="bras"/><child link="main"/><axis xyz="1 0 0"/>
    <limit lower="-0.1" upper="0.2" effort="1" velocity="1"/></joint>
  <link name="main"><inertial><origin xyz="0 0 0.1" rpy="0 0 1.5707963267948966"/><mass value="2"/>
    <inertia ixx="1" ixy="0.1" ixz="0" iyy="2" iyz="0" izz="2.5"/></inertial></link>
  <joint name="finger" type="revolute"><parent link="main"/><child link="doigt"/><axis xyz="0 1 0"/>
    <mimic joint="slide" multiplier="-2" offset="0.5"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <link name="doigt"><inertial><mass value="0.1"/>
    <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="5"/></inertial></link>
</robot>
"""


PLAIN = ARM.format(encoding="", name="bras")


def arm(folder: Path, text: str = PLAIN) -> calib.Robot:
    """The arm with `main` as its measured link; the finger behind it follows the slide."""
    (folder / "arm.urdf").write_text(text, encoding="utf-8")
    (folder / "arm.yaml").write_text(
        "urdf: arm.urdf\nname_mot: [drehung-ä, slide]\nbase: {frame: socle}\n"
        "targets: {tip: {frame: main, xyz: [0, 0, 0.2]}}\n"
        "parametrisation: [{origin: slide, components: [x, y, z], sigma: 1 mm}]\n",
        encoding="utf-8",
    )
    return calib.load(folder / "arm.yaml")


def written(robot: calib.Robot) -> Element:
    return ElementTree.fromstring(Mjcf(closed_model(robot)).content)


def body(root: Element, name: str) -> Element:
    (result,) = (element for element in root.iter("body") if element.get("name") == name)
    return result


def floats(element: Element | None, key: str) -> list[float]:
    assert element is not None
    return [float(part) for part in element.attrib[key].split()]


def test_shapes_and_joints_mean_what_the_urdf_says(tmp_path: Path) -> None:
    root = written(arm(tmp_path))
    assert root.get("model") == "bras"
    box = body(root, "socle").find("geom")
    assert (box.get("type"), floats(box, "size"), floats(box, "rgba")) == ("box", [0.1, 0.2, 0.3], [1, 0, 0, 1])
    cylinder, sphere = body(root, "bras").findall("geom")
    assert (floats(cylinder, "size"), floats(cylinder, "pos")) == ([0.05, 0.5], [0.5, 0, 0])
    assert cylinder.get("contype") == "0"
    assert (floats(sphere, "size"), sphere.get("contype"), sphere.get("group")) == ([0.1], None, "3")
    turn, slide = body(root, "bras").find("joint"), body(root, "main").find("joint")
    assert (turn.get("name"), turn.get("type"), turn.get("range")) == ("drehung-ä", "hinge", None)
    assert (slide.get("type"), floats(slide, "range")) == ("slide", [-0.1, 0.2])
    w, x, y, z = floats(body(root, "bras"), "quat")
    assert np.abs(pin.Quaternion(w, x, y, z).matrix() - pin.rpy.rpyToMatrix(0.1, 0.2, 0.3)).max() < 1e-15
    assert floats(body(root, "target_tip"), "pos") == [0, 0, 0.2]
    (site,) = body(root, "target_tip").findall("site")
    assert (site.get("name"), site.get("pos")) == ("target_tip_site", None)


def test_inertia_is_written_in_the_axes_of_the_link(tmp_path: Path) -> None:
    inertial = body(written(arm(tmp_path)), "main").find("inertial")
    assert (floats(inertial, "mass"), floats(inertial, "pos")) == ([2.0], [0, 0, 0.1])
    # a quarter turn about z swaps x and y, and turns the sign of xy
    assert floats(inertial, "fullinertia") == pytest.approx([2, 1, 2.5, -0.1, 0, 0], abs=1e-15)


def test_masses_and_moments_that_no_moving_body_has_are_replaced_and_the_file_says_so(tmp_path: Path) -> None:
    text = Mjcf(closed_model(arm(tmp_path))).content.decode()
    assert "link bras moves and has no mass" in text
    assert "link doigt: its moments of inertia are impossible" in text
    bras, doigt = (body(ElementTree.fromstring(text), name).find("inertial") for name in ("bras", "doigt"))
    assert floats(bras, "mass") == [1e-6]
    assert floats(doigt, "fullinertia")[:3] == pytest.approx([2.5, 2.5, 5.0], rel=1e-6)


@pytest.mark.parametrize("moments", [(1, 2, 2.5), (0.1, 0.1, 0.2), (0, 0, 0), (-1, 2, 2), (1e-9, 1, 5), (3, 4, 5)])
def test_possible_inertia_is_possible_and_changes_nothing_that_is(moments: tuple[float, ...]) -> None:
    turn = pin.rpy.rpyToMatrix(0.3, -0.4, 1.1)
    given = turn @ np.diag(np.array(moments, dtype=float)) @ turn.T
    given = (given + given.T) / 2
    result = possible_inertia(given)
    least, middle, most = np.linalg.eigvalsh(result)
    assert least > 0
    assert least + middle >= most * (1 - 1e-12)
    if min(moments) > 0 and sum(sorted(moments)[:2]) > max(moments):
        assert np.array_equal(result, given)


def binary_stl(path: Path) -> None:
    triangle = struct.pack("<12fH", 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b" " * 80 + struct.pack("<I", 4) + 4 * triangle)


def with_meshes(*files: str) -> str:
    shapes = "".join(
        f'<visual><geometry><mesh filename="{file}" scale="0.001 1 1"/></geometry></visual>' for file in files
    )
    return PLAIN.replace('<link name="main">', f'<link name="main">{shapes}')


def test_meshes_that_mujoco_reads_are_named_relative_to_the_file_and_others_are_said(tmp_path: Path) -> None:
    robots = tmp_path / "pkg" / "robots"
    robots.mkdir(parents=True)
    binary_stl(tmp_path / "pkg" / "meshes" / "a b.STL")
    (tmp_path / "pkg" / "meshes" / "text.stl").write_text("solid x\n" + "facet normal 0 0 1\n" * 20)
    (tmp_path / "pkg" / "meshes" / "c.dae").write_text("<collada/>")
    names = ("package://pkg/meshes/a b.STL", "../meshes/a b.STL", "package://pkg/meshes/text.stl",
             "package://pkg/meshes/c.dae", "package://gone/d.stl", "http://far/away.stl")  # fmt: skip
    robot = arm(robots, with_meshes(*names))
    (tmp_path / "out").mkdir()
    export(robot, tmp_path / "out" / "arm.xml", "mjcf")
    text = (tmp_path / "out" / "arm.xml").read_text(encoding="utf-8")
    root = ElementTree.fromstring(text)
    (mesh,) = root.find("asset")  # the same file and scale twice is one mesh
    assert (tmp_path / "out" / mesh.get("file")).resolve() == (tmp_path / "pkg" / "meshes" / "a b.STL").resolve()
    assert floats(mesh, "scale") == [0.001, 1, 1]
    assert len([geom for geom in root.iter("geom") if geom.get("mesh") == mesh.get("name")]) == 2
    assert set(re.findall(r"mesh (\S+) left out \((not found|cannot be read)", text)) == {
        ("package://pkg/meshes/text.stl", "cannot be read"), ("package://pkg/meshes/c.dae", "cannot be read"),
        ("package://gone/d.stl", "not found"), ("http://far/away.stl", "not found"),
    }  # fmt: skip


def two_colours(path: Path) -> None:
    """A Collada file with a red box of edges 1, 2, 4 about zero, and a blue one of edge 1 about (3, 0, 0)."""
    parts = []
    for extents, x, colour in (((1.0, 2.0, 4.0), 0.0, (255, 0, 0, 255)), ((1.0, 1.0, 1.0), 3.0, (0, 0, 255, 255))):
        part = trimesh.creation.box(extents).apply_translation((x, 0.0, 0.0))
        material = trimesh.visual.material.PBRMaterial(baseColorFactor=colour)
        part.visual = trimesh.visual.TextureVisuals(material=material)
        parts.append(part)
    path.write_bytes(trimesh.exchange.dae.export_collada(parts))


def test_a_collada_mesh_becomes_one_obj_file_for_each_colour_and_is_said(tmp_path: Path, run_calib) -> None:
    two_colours(tmp_path / "c.dae")
    arm(tmp_path, with_meshes("c.dae", "c.dae"))
    (tmp_path / "out").mkdir()
    run = run_calib("export", tmp_path / "arm.yaml", "--format", "mjcf", "--out", tmp_path / "out" / "arm.xml")
    assert run.code == 0
    assert "arm_meshes" in run.err
    root = ElementTree.fromstring((tmp_path / "out" / "arm.xml").read_bytes())
    files = {mesh.get("name"): tmp_path / "out" / mesh.attrib["file"] for mesh in root.find("asset")}
    by_name = {}
    for geom in body(root, "main").findall("geom"):
        mesh = trimesh.load(files[geom.get("mesh")], force="mesh")
        by_name[tuple(floats(geom, "rgba"))] = mesh.bounds.tolist()
        assert (len(mesh.faces), mesh.is_watertight) == (12, True)
    assert by_name == {
        (1, 0, 0, 1): [[-0.5, -1, -2], [0.5, 1, 2]],
        (0, 0, 1, 1): [[2.5, -0.5, -0.5], [3.5, 0.5, 0.5]],
    }
    assert len(files) == 2


def test_a_link_whose_meshes_cannot_be_read_is_drawn_as_rods_and_named(tmp_path: Path, run_calib) -> None:
    arm(tmp_path, PLAIN.replace('<box size="0.2 0.4 0.6"/>', '<mesh filename="gone.dae"/>'))
    run = run_calib("export", tmp_path / "arm.yaml", "--format", "mjcf", "--out", tmp_path / "arm.xml")
    assert "mesh gone.dae left out (not found" in run.err
    (rod,) = body(ElementTree.fromstring((tmp_path / "arm.xml").read_bytes()), "socle").findall("geom")
    assert (rod.get("type"), floats(rod, "fromto"), rod.get("contype")) == ("capsule", [0, 0, 0, 0, 0, 0.3], "0")


def test_there_are_a_lamp_and_a_floor_that_touches_nothing(tmp_path: Path) -> None:
    world = written(arm(tmp_path)).find("worldbody")
    (floor,) = world.findall("geom")
    assert (floor.get("type"), floor.get("contype"), floor.get("conaffinity")) == ("plane", "0", "0")
    assert floats(floor, "pos") == [0, 0, 0]  # the arm stands upwards from its socle
    assert floats(world.find("light"), "pos")[2] > 0.3  # above the turning joint
    hanging = arm(tmp_path, PLAIN.replace('xyz="0 0 0.3"', 'xyz="0 0 -0.3"'))
    (floor,) = written(hanging).find("worldbody").findall("geom")
    assert floats(floor, "pos")[2] <= -0.3


def test_the_keyframe_is_home_in_the_order_of_mujocos_joints(tmp_path: Path) -> None:
    robot = arm(tmp_path, PLAIN.replace('lower="-0.1"', 'lower="0.1"'))
    root = written(robot)
    (key,) = root.find("keyframe")
    home = dict(zip(robot.joint_names, robot.home, strict=True))
    joints = [joint.get("name") for joint in root.find("worldbody").iter("joint")]
    assert joints == ["drehung-ä", "slide", "finger"]
    assert floats(key, "qpos") == pytest.approx([*home.values(), 0.5 - 2 * home["slide"]])  # a mimic joint
    assert floats(key, "ctrl") == [home[name] for name in robot.joint_names]
    assert key.get("name") == "home"


def test_meshes_are_found_through_the_paths_of_ros(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    binary_stl(tmp_path / "one" / "pkg" / "m.stl")
    binary_stl(tmp_path / "two" / "share" / "other" / "m.stl")
    assert find_mesh("package://pkg/m.stl", "/robot.urdf") is None
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "one"))
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "two"))
    assert find_mesh("package://pkg/m.stl", "/robot.urdf") == tmp_path / "one" / "pkg" / "m.stl"
    assert find_mesh("package://other/m.stl", "/robot.urdf") == tmp_path / "two" / "share" / "other" / "m.stl"


def test_a_mesh_is_read_above_the_robot_s_folder_only_where_ros_allows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    urdf = str(tmp_path / "one" / "pkg" / "robots" / "urdf" / "robot.urdf")
    Path(urdf).parent.mkdir(parents=True)
    for place in ("one/pkg/robots/meshes", "one/pkg/meshes", "one", "."):
        binary_stl(tmp_path / place / "m.stl")
    assert find_mesh("../meshes/m.stl", urdf) is not None  # beside the folder of the URDF
    outside = ("../../meshes/m.stl", "../../../m.stl", "package://x/../../m.stl", "file://../../../m.stl")
    assert [find_mesh(name, urdf) for name in outside] == [None] * 4
    (tmp_path / "one" / "pkg" / "package.xml").write_text("<package/>")
    assert find_mesh("../../meshes/m.stl", urdf) is not None
    assert find_mesh("../../../m.stl", urdf) is None
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "one"))
    assert find_mesh("../../../m.stl", urdf) is not None
    assert find_mesh("../../../../m.stl", urdf) is None


def test_a_link_named_world_that_is_not_the_root_is_refused(tmp_path: Path) -> None:
    robot = arm(tmp_path, PLAIN.replace('"doigt"', '"world"'))
    with pytest.raises(InputError, match="link 'world' is not the root link; MuJoCo keeps this name"):
        Mjcf(closed_model(robot))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('<mass value="2"/>', '<mass value="heavy"/>', "link 'main', inertial: 'heavy' is not 1 number"),
        ('size="0.2 0.4 0.6"', 'size="0.2 0.4"', "link 'socle', visual: '0.2 0.4' is not 3 numbers"),
        ('radius="0.1"', 'radius="thin"', "link 'bras', collision: 'thin' is not 1 number"),
    ],
)
def test_shapes_and_masses_that_are_no_numbers_say_where(tmp_path: Path, old: str, new: str, words: str) -> None:
    robot = arm(tmp_path, PLAIN.replace(old, new))  # loads: calibrating needs neither
    with pytest.raises(UrdfError, match=re.escape(words)):
        closed_model(robot)


@pytest.mark.parametrize("variant", ["CRLF and BOM", "Latin-1", "undeclared prefix"])
def test_any_spelling_of_the_file_gives_the_same_model(tmp_path: Path, variant: str) -> None:
    plain = ARM.format(encoding="", name="bras-é")
    (tmp_path / "plain").mkdir()
    expected = closed_model(arm(tmp_path / "plain", plain))
    robot = arm(tmp_path, plain)
    content = {
        "CRLF and BOM": b"\xef\xbb\xbf" + plain.replace("\n", "\r\n").encode(),
        "Latin-1": ARM.format(encoding=' encoding="iso-8859-1"', name="bras-é").encode("latin-1"),
        "undeclared prefix": plain.replace("</robot>", "<drake:odd/></robot>").encode(),
    }[variant]
    (tmp_path / "arm.urdf").write_bytes(content)
    robot = calib.load(tmp_path / "arm.yaml")
    comments = re.compile(rb"<!--.*?-->", re.DOTALL)
    model = closed_model(robot)
    assert comments.sub(b"", Mjcf(model).content) == comments.sub(b"", Mjcf(expected).content)
    for_drake = parse_urdf(drake_bytes(model))
    assert for_drake.links == parse_urdf(drake_bytes(expected)).links
    assert for_drake.source.startswith(content[:25])
    if variant == "CRLF and BOM":
        assert re.search(rb"[^\r]\n", for_drake.source) is None
    assert set(read_links(for_drake)) == set(for_drake.links)


def test_shapes_of_size_zero_are_left_out_and_said(tmp_path):
    pytest.importorskip("mujoco", reason="extra 'mujoco'")
    for shape in ('<box size="0 0 0"/>', '<sphere radius="0.0"/>', '<cylinder radius="0.1" length="0"/>'):
        geometry = f"<visual><geometry>{shape}</geometry></visual><collision><geometry>{shape}</geometry></collision>"
        urdf = urdf_of(("j", "revolute", "a", "b")).replace('<link name="a"/>', f'<link name="a">{geometry}</link>')
        (tmp_path / "r.urdf").write_text(urdf)
        export(calib.load(tmp_path / "r.urdf"), tmp_path / "r.xml", "mjcf", force=True)
        assert "of size zero at a left out" in (tmp_path / "r.xml").read_text()
        assert calib.load(tmp_path / "r.xml").joint_names == ("j",)  # MuJoCo reads it
