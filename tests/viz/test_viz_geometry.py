"""Shapes from URDFs: primitives, meshes, and stand-ins that are announced."""

import numpy as np
import pytest
import trimesh

import calib
import medrue
from viz.bodies import bodies_of, posed_robot
from viz.geometry import read_shapes
from viz.shapes import GREY, Shape, rotation_onto_z, thin

URDF = """<robot name="arm">
 <material name="red"><color rgba="1 0 0 1"/></material>
 <link name="root">{root}</link>
 <link name="upper">{upper}</link>
 <link name="tip"/>
 <joint name="a" type="revolute"><parent link="root"/><child link="upper"/><origin xyz="0 0 0.3"/><axis xyz="0 1 0"/>
  <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
 <joint name="b" type="fixed"><parent link="upper"/><child link="tip"/><origin xyz="0.4 0 0"/></joint>
</robot>"""


def visual(geometry, material=""):
    return f'<visual><origin xyz="0 0 0.1" rpy="0 0 0"/><geometry>{geometry}</geometry>{material}</visual>'


def robot(tmp_path, root="", upper=""):
    path = tmp_path / "arm.urdf"
    path.write_text(URDF.format(root=root, upper=upper))
    return calib.load(path)


def test_primitives_keep_size_place_and_colour(tmp_path):
    red = visual('<box size="1 2 3"/>', '<material name="red"/>')
    grey = visual('<cylinder radius="0.1" length="0.5"/>') + visual('<sphere radius="0.2"/>')
    shapes, notes = read_shapes(robot(tmp_path, red, grey))
    assert notes == ()
    assert [(shape.kind, shape.size, shape.body) for shape in shapes] == [
        ("box", (1.0, 2.0, 3.0), "root"),
        ("cylinder", (0.1, 0.5), "upper"),
        ("sphere", (0.2,), "upper"),
    ]
    assert shapes[0].colour == (1.0, 0.0, 0.0, 1.0)
    assert shapes[1].colour == GREY
    np.testing.assert_allclose(shapes[0].T_body_shape[:3, 3], [0, 0, 0.1])


def test_meshes_are_loaded_with_their_scale(tmp_path):
    trimesh.creation.box((1.0, 2.0, 4.0)).export(tmp_path / "block.stl")
    shapes, notes = read_shapes(robot(tmp_path, visual('<mesh filename="block.stl" scale="0.1 0.1 0.5"/>')))
    assert notes == ()
    assert [shape.kind for shape in shapes] == ["mesh"]
    np.testing.assert_allclose(np.ptp(shapes[0].vertices, axis=0), [0.1, 0.2, 2.0], rtol=1e-6)


def test_a_mesh_far_outside_the_robot_s_folder_is_not_read(tmp_path):
    (tmp_path / "pkg" / "urdf").mkdir(parents=True)
    trimesh.creation.box((1.0, 1.0, 1.0)).export(tmp_path / "secret.stl")
    for name in ("../../secret.stl", "package://../../secret.stl", "package://x/../../../secret.stl"):
        shapes, notes = read_shapes(robot(tmp_path / "pkg" / "urdf", visual(f'<mesh filename="{name}"/>')))
        assert all(shape.kind != "mesh" for shape in shapes)
        assert len(notes) == 1
        assert name in notes[0]
    trimesh.creation.box((1.0, 1.0, 1.0)).export(tmp_path / "pkg" / "near.stl")
    shapes, notes = read_shapes(robot(tmp_path / "pkg" / "urdf", visual('<mesh filename="../near.stl"/>')))
    assert [shape.kind for shape in shapes] == ["mesh"]


def test_missing_meshes_share_one_note_and_are_drawn_with_rods(tmp_path):
    lost, gone = (visual(f'<mesh filename="{name}.stl"/>') for name in ("lost", "gone"))
    shapes, (note,) = read_shapes(robot(tmp_path, lost, gone))
    assert "link 'root': mesh 'lost.stl' is missing" in note
    assert "1 more link: upper" in note
    rod = next(shape for shape in shapes if shape.name == "upper/body")
    ends = rod.T_body_shape @ np.array([[0, 0, -0.2, 1], [0, 0, 0.2, 1]]).T
    np.testing.assert_allclose(ends[:3].T, [[0, 0, 0], [0.4, 0, 0]], atol=1e-12)
    assert {shape.body for shape in shapes} == {"root", "upper"}


@pytest.mark.parametrize(
    ("geometry", "content", "words"),
    [
        ('<mesh filename="broken.stl"/>', b"", ""),
        ('<mesh filename="broken.stl"/>', b"solid nothing", ""),
        ('<mesh filename="broken.stl"/>', b"\x00" * 90, ""),
        ('<capsule radius="1" length="2"/>', b"", "capsule"),
    ],
)
def test_a_shape_that_cannot_be_read_is_announced_and_drawn_with_rods(tmp_path, geometry, content, words):
    (tmp_path / "broken.stl").write_bytes(content)
    shapes, (note,) = read_shapes(robot(tmp_path, "", visual(geometry)))
    assert words in note
    assert any(shape.body == "upper" for shape in shapes)


def test_a_urdf_without_shapes_is_drawn_with_rods(tmp_path):
    shapes, notes = read_shapes(robot(tmp_path))
    assert "has no shapes" in notes[0]
    assert {shape.body for shape in shapes} >= {"root", "upper"}


def test_collision_shapes_are_drawn_where_there_are_no_visuals(tmp_path):
    collision = visual('<box size="1 2 3"/>').replace("visual", "collision")
    shapes, notes = read_shapes(robot(tmp_path, "", collision))
    assert "box" in {shape.kind for shape in shapes if shape.body == "upper"}
    assert notes == ()
    shapes, _ = read_shapes(robot(tmp_path, visual('<sphere radius="1"/>'), collision))
    assert "box" not in {shape.kind for shape in shapes}


def ends_in_space(robot, shapes, names):
    """Where cylinders of these names end, at the robot's home, (n, 2, 3) [m]."""
    bodies = bodies_of(robot)
    poses = bodies.poses(posed_robot(robot, bodies, robot.home[None]), 0)
    places = {name: poses[k] for k, name in enumerate(bodies.names)}
    found = []
    for name in names:
        shape = next(shape for shape in shapes if shape.name == name)
        half = np.array([[0, 0, -shape.size[1] / 2, 1], [0, 0, shape.size[1] / 2, 1]])
        found.append((places[shape.body] @ shape.T_body_shape @ half.T)[:3].T)
    return np.array(found)


def test_the_legs_of_a_stewart_platform_reach_from_their_base_joint_to_their_platform_joint():
    robot = calib.load("docs/examples/stewart.yaml")
    shapes, notes = read_shapes(robot)
    assert len(notes) == 1
    legs = range(1, 7)
    ends = ends_in_space(robot, shapes, [f"leg_{k}_tip/body" for k in legs])
    bodies = bodies_of(robot)
    poses = dict(zip(bodies.names, bodies.poses(posed_robot(robot, bodies, robot.home[None]), 0), strict=True))
    for k, (one, other) in zip(legs, ends, strict=True):
        reached = [poses[f"leg_{k}_cylinder"][:3, 3], poses[f"leg_{k}_place"][:3, 3]]
        distances = [np.linalg.norm(np.array(reached) - end, axis=1).min() for end in (one, other)]
        assert max(distances) < 1e-6  # the home of the description closes the loops so well
    assert {shape.body for shape in shapes if shape.kind == "mesh"} == {"platform"}  # a plate
    assert sum(shape.name.startswith("base/side") and shape.kind == "cylinder" for shape in shapes) == 6  # a frame
    assert not [shape for shape in shapes if "platform_at" in shape.body]  # six joints that are no mechanism
    kinds = {shape.name.split("/")[1] for shape in shapes if shape.body.startswith("leg_1")}
    assert kinds >= {"drum", "sleeve", "closure0"}  # universal, prismatic, ball


def test_own_shapes_that_do_not_reach_the_next_joint_are_joined_to_it():
    robot = calib.load("docs/examples/arm.yaml")
    shapes, notes = read_shapes(robot)
    assert notes == ()
    (ends,) = ends_in_space(robot, shapes, ["link_3/gap0"])
    np.testing.assert_allclose(np.linalg.norm(ends[1] - ends[0]), np.hypot(0.1, 0.035), atol=1e-12)


def test_medrue_has_its_rail_carriage_five_bars_support_and_reflector():
    shapes, notes = read_shapes(calib.load(medrue.robot_file()))
    assert notes == ()
    bodies = {shape.body for shape in shapes}
    assert {"base", "carriage", "probe_support", "tool"} <= bodies
    bars = {f"{name}{number}" for name in ("proximal_A", "proximal_C", "distal_B", "distal_D") for number in (1, 2)}
    assert bars <= bodies
    reflector = next(shape for shape in shapes if shape.body == "tool" and shape.kind == "sphere")
    assert reflector.size[0] == pytest.approx(0.01905)  # 1.5 inch


def test_the_rotation_onto_a_direction_is_a_rotation():
    for direction in np.vstack([np.eye(3), -np.eye(3), np.random.default_rng(1).normal(size=(20, 3))]):
        unit = direction / np.linalg.norm(direction)
        R = rotation_onto_z(unit)
        np.testing.assert_allclose(R @ [0, 0, 1], unit, atol=1e-14)
        np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-14)
        assert np.linalg.det(R) == pytest.approx(1.0)


def test_corners_enclose_a_turned_shape_and_a_mesh():
    T = np.eye(4)
    T[:3, :3] = rotation_onto_z(np.array([1.0, 0.0, 0.0]))
    T[:3, 3] = [1, 2, 3]
    tetrahedron = np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]])
    mesh = Shape("m", None, "mesh", vertices=tetrahedron, faces=np.array([[0, 1, 2]]))
    for shape, box in (
        (Shape("c", "root", "cylinder", (0.1, 2.0), T), [[0, 1.9, 2.9], [2, 2.1, 3.1]]),
        (mesh, [[0, 0, 0], [1, 2, 3]]),
    ):
        corners = shape.corners()
        np.testing.assert_allclose([corners.min(axis=0), corners.max(axis=0)], box, atol=1e-12)


def test_thinning_keeps_the_outline_and_the_limit():
    ball = trimesh.creation.icosphere(subdivisions=5)
    vertices, faces = thin(ball.vertices, ball.faces, 3000)
    assert 200 < len(faces) <= 3000
    np.testing.assert_allclose(np.ptp(vertices, axis=0), [2, 2, 2], atol=0.1)  # a grid cell is about 0.06
    same = thin(ball.vertices, ball.faces, len(ball.faces))
    assert same[1] is ball.faces
