"""The shapes of a robot, read from its URDF through yourdfpy: primitives, meshes, and stand-ins for what is missing.

A mesh that cannot be loaded is replaced by primitives along the joint origins of its link, so that the robot can
still be recognised; a note says so. The same stand-ins draw a URDF that has no shapes at all.
"""

from __future__ import annotations

import io
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from calib import Robot
from calib.mechanism import FloatArray, IntArray

Colour = tuple[float, float, float, float]
GREY: Colour = (0.62, 0.66, 0.7, 1.0)
_MOST_FACES = 40_000  # of one mesh; more do not show on a screen and make the page slow


@dataclass(frozen=True, eq=False)
class Shape:
    """One drawable shape.

    Attributes:
        name: Unique name.
        body: Link that carries it; None for what stands still in the measurement frame.
        kind: What `size` means.
        size: box: edge lengths; cylinder: radius and length along z; sphere: radius; mesh: empty [m].
        T_body_shape: Pose of the shape in its link, (4, 4) [m].
        colour: Red, green, blue, opacity, 0 to 1.
        vertices, faces: Of a mesh, (n, 3) [m] and (m, 3); empty otherwise.
    """

    name: str
    body: str | None
    kind: Literal["box", "cylinder", "sphere", "mesh"]
    size: tuple[float, ...]
    T_body_shape: FloatArray
    colour: Colour
    vertices: FloatArray
    faces: IntArray

    def corners(self) -> FloatArray:
        """Return points that enclose the shape in its link's frame, (n, 3) [m]."""
        if self.kind == "mesh":
            low, high = self.vertices.min(axis=0), self.vertices.max(axis=0)
        else:
            high = np.array(self.size) / 2 if self.kind == "box" else np.full(3, self.size[0])
            if self.kind == "cylinder":
                high[2] = self.size[1] / 2
            low = -high
        grid = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T
        corners: FloatArray = grid @ self.T_body_shape[:3, :3].T + self.T_body_shape[:3, 3]
        return corners


def primitive(
    name: str,
    body: str | None,
    kind: Literal["box", "cylinder", "sphere"],
    size: tuple[float, ...],
    T_body_shape: FloatArray,
    colour: Colour = GREY,
) -> Shape:
    """Return a box, cylinder or sphere."""
    return Shape(
        name,
        body,
        kind,
        tuple(float(value) for value in size),
        np.array(T_body_shape, dtype=float),
        colour,
        np.empty((0, 3)),
        np.empty((0, 3), dtype=np.intp),
    )


def mesh(
    name: str,
    body: str | None,
    vertices: FloatArray,
    faces: IntArray,
    colour: Colour = GREY,
    T_body_shape: FloatArray | None = None,
) -> Shape:
    """Return a triangle mesh."""
    return Shape(
        name,
        body,
        "mesh",
        (),
        np.eye(4) if T_body_shape is None else np.array(T_body_shape, dtype=float),
        colour,
        np.array(vertices, dtype=float),
        np.array(faces, dtype=np.intp),
    )


def read_shapes(robot: Robot) -> tuple[tuple[Shape, ...], tuple[str, ...]]:
    """Read the shapes of a robot's URDF.

    Returns:
        The shapes, at least one for each link whose mesh is missing; and notes for the user, one for each thing that
        could not be drawn as the URDF asks.
    """
    shapes: list[Shape] = []
    notes: list[str] = []
    try:
        visuals, materials, find = _parse(robot)
    except Exception as error:  # yourdfpy and lxml raise many kinds; drawing must not stop a calibration
        notes.append(f"{robot.urdf.path}: its shapes cannot be read ({_first_line(error)}); drawn as plain rods")
        visuals, materials, find = {}, {}, str
    for link in robot.urdf.links:
        try:
            for number, visual in enumerate(visuals.get(link, ())):
                shapes.extend(_visual(f"{link}/{number}", link, visual, materials, find))
        except Exception as error:  # as above, from the readers of mesh files
            notes.append(f"link '{link}': {_first_line(error)}; drawn as plain rods")
            shapes = [shape for shape in shapes if shape.body != link] + _stand_ins(robot, link)
    if not shapes:
        if not notes:
            notes.append(f"{robot.urdf.path}: has no shapes; drawn as plain rods")
        shapes = [shape for link in robot.urdf.links for shape in _stand_ins(robot, link)]
    return tuple(shapes), tuple(notes)


def _parse(robot: Robot) -> tuple[dict[str, Any], dict[str, Colour], Any]:
    import yourdfpy

    with _quiet():
        urdf = yourdfpy.URDF.load(
            io.BytesIO(robot.urdf.source),
            build_scene_graph=False,
            load_meshes=False,
            mesh_dir=str(Path(robot.urdf.path).resolve().parent),
        )
    materials = {material.name: _colour(material) for material in urdf.robot.materials}
    visuals = {link.name: link.visuals for link in urdf.robot.links}

    def find(name: str) -> str:
        with _quiet():
            return str(urdf._filename_handler(fname=name))

    return visuals, materials, find


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep yourdfpy's log silent: what it could not find is reported as a note of our own."""
    logger = logging.getLogger("yourdfpy.urdf")
    before = logger.disabled
    logger.disabled = True
    try:
        yield
    finally:
        logger.disabled = before


def _visual(name: str, link: str, visual: Any, materials: dict[str, Colour], find: Any) -> list[Shape]:
    origin = np.eye(4) if visual.origin is None else np.array(visual.origin, dtype=float)
    colour = GREY
    if visual.material is not None:
        colour = (
            _colour(visual.material) if visual.material.color is not None else materials.get(visual.material.name, GREY)
        )
    geometry = visual.geometry
    if geometry.box is not None:
        return [primitive(name, link, "box", tuple(geometry.box.size), origin, colour)]
    if geometry.cylinder is not None:
        return [primitive(name, link, "cylinder", (geometry.cylinder.radius, geometry.cylinder.length), origin, colour)]
    if geometry.sphere is not None:
        return [primitive(name, link, "sphere", (geometry.sphere.radius,), origin, colour)]
    return _load_mesh(name, link, geometry.mesh, origin, None if visual.material is None else colour, find)


def _load_mesh(
    name: str, link: str, described: Any, origin: FloatArray, colour: Colour | None, find: Any
) -> list[Shape]:
    """Load a mesh file; the material of the URDF wins over the file's own colours."""
    import trimesh

    path = find(described.filename)
    if not Path(path).is_file():
        raise FileNotFoundError(f"mesh '{described.filename}' is not there")
    with _quiet():
        scene: Any = trimesh.load(path, force="scene", ignore_broken=True)
    scale = np.ones(3) if described.scale is None else np.broadcast_to(np.asarray(described.scale, dtype=float), 3)
    shapes = []
    for part, node in enumerate(scene.graph.nodes_geometry):
        T_file_part, key = scene.graph[node]
        geometry = scene.geometry[key]
        if not isinstance(geometry, trimesh.Trimesh) or not len(geometry.faces):
            continue
        vertices, faces = thinned(np.asarray(geometry.vertices), np.asarray(geometry.faces), _MOST_FACES)
        points = vertices @ T_file_part[:3, :3].T + T_file_part[:3, 3]
        own = _own_colour(geometry.visual) if colour is None else colour
        shapes.append(mesh(f"{name}.{part}", link, points * scale, faces, own, origin))
    if not shapes:
        raise ValueError(f"mesh '{described.filename}' holds no triangles")
    return shapes


def _own_colour(visual: Any) -> Colour:
    """Main colour of a mesh file's part."""
    painted = getattr(visual, "material", visual)
    parts = np.ravel(getattr(painted, "main_color", ()))
    if not visual.defined or len(parts) < 3:
        return GREY
    red, green, blue = (float(value) / 255 for value in parts[:3])
    return (red, green, blue, 1.0)


def thinned(vertices: FloatArray, faces: IntArray, most: int) -> tuple[FloatArray, IntArray]:
    """Return a mesh with at most `most` faces: vertices that share a cell of a grid, as fine as fits, become one."""
    cells = 512
    fewer_vertices, fewer = vertices, faces
    while len(fewer) > most:
        low, extent = vertices.min(axis=0), float(np.ptp(vertices, axis=0).max())
        keys = np.floor((vertices - low) / extent * cells).astype(np.int64)
        _, first, cell_of = np.unique(keys, axis=0, return_index=True, return_inverse=True)
        fewer_vertices, moved = vertices[first], cell_of.reshape(-1)[faces]
        flat = (moved[:, 0] == moved[:, 1]) | (moved[:, 1] == moved[:, 2]) | (moved[:, 2] == moved[:, 0])
        fewer = moved[~flat]
        cells //= 2
    return fewer_vertices, fewer


def _colour(material: Any) -> Colour:
    if material.color is None:
        return GREY
    red, green, blue, opacity = (min(1.0, max(0.0, float(value))) for value in material.color.rgba)
    return (red, green, blue, opacity)


def _stand_ins(robot: Robot, link: str) -> list[Shape]:
    """Rods from the link's frame to the origins of its child joints; a drum at the joint that moves the link."""
    radius = 0.04 * robot.mechanism.length
    shapes = []
    children = [joint for joint in robot.urdf.joints if joint.parent == link]
    for number, joint in enumerate(children):
        length = float(np.linalg.norm(joint.xyz))
        if length > radius:
            pose = np.eye(4)
            pose[:3, :3] = rotation_onto_z(np.array(joint.xyz) / length)
            pose[:3, 3] = np.array(joint.xyz) / 2
            shapes.append(primitive(f"{link}/rod{number}", link, "cylinder", (0.6 * radius, length), pose))
    for joint in robot.urdf.joints:
        if joint.child == link and joint.type in ("revolute", "continuous"):
            pose = np.eye(4)
            pose[:3, :3] = rotation_onto_z(np.array(joint.axis))
            shapes.append(
                primitive(f"{link}/drum", link, "cylinder", (radius, 2 * radius), pose, (0.3, 0.34, 0.4, 1.0))
            )
        elif joint.child == link and (joint.type == "prismatic" or not children):
            shapes.append(
                primitive(f"{link}/block", link, "box", (1.4 * radius,) * 3, np.eye(4), (0.3, 0.34, 0.4, 1.0))
            )
    return shapes


def rotation_onto_z(direction: FloatArray) -> FloatArray:
    """Return a rotation whose third column is the unit vector `direction`, (3, 3)."""
    helper = np.eye(3)[int(np.argmin(np.abs(direction)))]
    x = np.cross(helper, direction)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(direction, x), direction], axis=1)


def _first_line(error: Exception) -> str:
    text = str(error).strip().splitlines()
    return text[0] if text else type(error).__name__
