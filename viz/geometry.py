"""The shapes of a robot, read from its URDF: primitives and meshes, or plain bodies in their place.

A link whose mesh cannot be loaded, and a URDF without shapes, are drawn plainly, so that the robot can still be
recognised; one note names all such links.
"""

from __future__ import annotations

from typing import Any, Literal, cast

import numpy as np

from calib import Robot
from calib.core.base.arrays import FloatArray
from calib.core.base.errors import UrdfError
from calib.core.base.words import count_noun
from calib.core.robots.urdf.meshes import find_mesh
from calib.shared.links import Link, read_links
from calib.shared.links import LinkShape as Visual
from viz.plain_links import PlainLinks
from viz.shapes import GREY, Colour, Shape, thin

_MOST_FACES = 40_000  # of one mesh; more make the page slow and do not show on a screen


def read_shapes(robot: Robot) -> tuple[tuple[Shape, ...], tuple[str, ...]]:
    """Read the shapes of a robot's URDF: its visuals; without any, its collision shapes.

    Returns:
        The shapes; and notes for the user, one for all that are not drawn as in the URDF.
    """
    plain, shapes, missing = PlainLinks(robot), [], {}
    try:
        links = read_links(robot.urdf)
    except UrdfError as error:  # drawing must not stop a calibration
        links, notes = {}, [f"{_first_line(error)}: its shapes cannot be read; drawn plainly, from joint to joint"]
    else:
        notes = []
    drawn = any(link.visuals for link in links.values())
    for name, link in links.items():
        try:
            own = _link(name, link, link.visuals if drawn else link.collisions, robot.urdf.path)
        except Exception as error:  # the readers of mesh files raise many kinds
            missing[name] = _first_line(error)
            own = plain.shapes(name)
        else:
            if own and all(shape.kind != "mesh" for shape in own):
                own += plain.gaps(name, own)
        shapes += own
    if not shapes:
        if not notes:
            notes.append(f"{robot.urdf.path}: has no shapes; drawn plainly, from joint to joint")
        shapes = [shape for link in robot.urdf.links for shape in plain.shapes(link)]
    if missing:
        first, *others = missing
        more = f", and {count_noun(len(others), 'more link')}: {', '.join(others)}" if others else ""
        notes.append(f"link '{first}': {missing[first]}{more}; drawn plainly, from joint to joint")
    return tuple(shapes), tuple(notes)


def _link(name: str, link: Link, visuals: tuple[Visual, ...], urdf_path: str) -> list[Shape]:
    if link.unknown:
        raise ValueError(f"a {link.unknown[0]} is not a shape of a URDF")
    by_visual = (_visual(f"{name}/{number}", name, visual, urdf_path) for number, visual in enumerate(visuals))
    return [shape for shapes in by_visual for shape in shapes]


def _visual(name: str, link: str, visual: Visual, urdf_path: str) -> list[Shape]:
    origin: FloatArray = visual.placement.homogeneous
    if visual.kind == "mesh":
        return _load_mesh(name, link, visual, origin, urdf_path)
    kind = cast(Literal["box", "cylinder", "sphere"], visual.kind)
    return [Shape(name, link, kind, visual.size, origin, GREY if visual.colour is None else _colour(visual.colour))]


def _load_mesh(name: str, link: str, visual: Visual, origin: FloatArray, urdf_path: str) -> list[Shape]:
    """Load a mesh file; the colour of the URDF replaces the file's own colours."""
    import trimesh

    path = find_mesh(visual.file, urdf_path)
    if path is None:
        raise FileNotFoundError(f"mesh '{visual.file}' is missing, or lies outside the robot's folder")
    scene: Any = trimesh.load(path, force="scene", ignore_broken=True)
    shapes = []
    for part, node in enumerate(scene.graph.nodes_geometry):
        T_file_part, key = scene.graph[node]
        geometry = scene.geometry[key]
        if not isinstance(geometry, trimesh.Trimesh) or not len(geometry.faces):
            continue
        vertices, faces = thin(np.asarray(geometry.vertices), np.asarray(geometry.faces), _MOST_FACES)
        points = vertices @ T_file_part[:3, :3].T + T_file_part[:3, 3]
        colour = _own_colour(geometry.visual) if visual.colour is None else _colour(visual.colour)
        shapes.append(Shape(f"{name}.{part}", link, "mesh", (), origin, colour, points * np.array(visual.size), faces))
    if not shapes:
        raise ValueError(f"mesh '{visual.file}' holds no triangles")
    return shapes


def _own_colour(visual: Any) -> Colour:
    painted = getattr(visual, "material", visual)
    parts = np.ravel(getattr(painted, "main_color", ()))
    if not visual.defined or len(parts) < 3:
        return GREY
    red, green, blue = (float(value) / 255 for value in parts[:3])
    return (red, green, blue, 1.0)


def _colour(written: tuple[float, ...]) -> Colour:
    red, green, blue, opacity = (min(1.0, max(0.0, value)) for value in written)
    return (red, green, blue, opacity)


def _first_line(error: Exception) -> str:
    text = str(error).strip().splitlines()
    return text[0] if text else type(error).__name__
