"""Surroundings of a robot as shapes: obstacles and parts of the tool of a description, and what other packages know.

A package registers a function in the entry point group `viz.decorations`, under the robot's name in its URDF, for
surroundings such as a target workspace. Called without arguments, the function returns shapes whose `body` is None, in
the measurement frame.
"""

from __future__ import annotations

import functools
from importlib.metadata import entry_points
from typing import Any, Literal, cast

import numpy as np

from calib import Robot
from calib.core.base.arrays import FloatArray, IntArray
from calib.core.base.errors import DescriptionError
from calib.core.robots.mechanism import rigid
from calib.motion.surroundings import ObstacleSection, ShapeSection
from viz.bodies import links_of_bodies
from viz.shapes import Colour, Shape, translation

_STONE: Colour = (0.72, 0.66, 0.58, 0.55)
_TOOL: Colour = (0.80, 0.58, 0.20, 0.6)
_PLANE = 2.5  # edge of a drawn floor, in characteristic lengths of the robot


@functools.cache  # a search through all installed packages takes a tenth of the time of a live viewer's new scene
def decorations_of(robot_name: str) -> tuple[Shape, ...]:
    """Return the shapes that installed packages give for the robot of this name."""
    return tuple(shape for entry in entry_points(group="viz.decorations", name=robot_name) for shape in entry.load()())


def surrounding_shapes(robot: Robot) -> tuple[Shape, ...]:
    """Return obstacles and shapes at targets, on the bodies that carry them.

    Raises:
        DescriptionError: A mesh cannot be read.
    """
    description, mechanism, links = robot.description, robot.mechanism, links_of_bodies(robot)
    obstacles = description.obstacles if isinstance(description.obstacles, dict) else {}
    shapes = [
        _shape(
            f"obstacle/{name}",
            links[0 if section.frame is None else mechanism.joint(section.frame)],
            section,
            _STONE,
            _PLANE * mechanism.length,
        )
        for name, section in obstacles.items()
    ]
    shapes += [
        _shape(f"{name}/shape", f"({mechanism.origin(name)})", target.shape, _TOOL, 0.0)
        for name, target in description.targets.items()
        if target.shape is not None
    ]
    return tuple(shapes)


def _shape(name: str, body: str, section: ShapeSection, colour: Colour, plane: float) -> Shape:
    T = rigid(section.xyz, section.rpy).homogeneous
    if isinstance(section, ObstacleSection) and section.plane:
        thick = plane / 500
        return Shape(name, body, "box", (plane, plane, thick), T @ translation((0.0, 0.0, -thick / 2)), colour)
    if section.kind == "mesh":
        return Shape(name, body, "mesh", (), T, colour, *_read_mesh(section))
    size = getattr(section, section.kind)
    kind = cast(Literal["box", "cylinder", "sphere"], section.kind)
    return Shape(name, body, kind, size if isinstance(size, tuple) else (size,), T, colour)


def _read_mesh(section: ShapeSection) -> tuple[FloatArray, IntArray]:
    """Corners (n, 3) [m] and triangles (m, 3) of a mesh file."""
    import trimesh

    try:
        read: Any = trimesh.load(section.mesh, force="mesh")
    except Exception as error:  # the readers of mesh files raise many kinds
        raise DescriptionError(f"{section.mesh}: the mesh cannot be read ({error})") from None
    return section.scale * np.asarray(read.vertices), np.asarray(read.faces)
