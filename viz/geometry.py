"""The shapes of a robot, read from its URDF through yourdfpy: primitives and meshes, stand-ins for what is missing.

A mesh that cannot be loaded is replaced by primitives along the joint origins of its link, so that the robot can
still be recognised; a note says so. The same stand-ins draw a URDF that has no shapes at all.
"""

from __future__ import annotations

import io
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from calib import Robot
from calib.arrays import FloatArray
from calib.exporting.links import may_read_mesh
from viz.shapes import GREY, Colour, Shape, mesh, primitive, stand_ins, thinned

_MOST_FACES = 40_000  # of one mesh; more do not show on a screen and make the page slow


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
            shapes = [shape for shape in shapes if shape.body != link] + stand_ins(robot, link)
    if not shapes:
        if not notes:
            notes.append(f"{robot.urdf.path}: has no shapes; drawn as plain rods")
        shapes = [shape for link in robot.urdf.links for shape in stand_ins(robot, link)]
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
            found = str(urdf._filename_handler(fname=name))
        if not may_read_mesh(name, Path(found), robot.urdf.path):
            raise PermissionError(f"mesh '{name}' leaves the robot's folder")
        return found

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


def _colour(material: Any) -> Colour:
    if material.color is None:
        return GREY
    red, green, blue, opacity = (min(1.0, max(0.0, float(value))) for value in material.color.rgba)
    return (red, green, blue, opacity)


def _first_line(error: Exception) -> str:
    text = str(error).strip().splitlines()
    return text[0] if text else type(error).__name__
