"""What stands around a robot: shapes that a package gives for a robot it knows, such as a target workspace.

A package registers a function in the entry point group `viz.decorations`, under the robot's name in its URDF; called
without arguments it returns shapes whose `body` is None, in the measurement frame. Nothing here knows any robot.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from importlib.metadata import entry_points

import numpy as np

from calib.core.base.arrays import FloatArray
from viz.shapes import Colour, Shape, mesh

ENTRY_POINTS = "viz.decorations"


@functools.cache  # to look through all installed packages is a tenth of a live viewer's new scene
def decorations_of(robot_name: str) -> tuple[Shape, ...]:
    """Return the shapes that installed packages give for the robot of this name."""
    shapes: list[Shape] = []
    for entry in entry_points(group=ENTRY_POINTS):
        if entry.name == robot_name:
            give: Callable[[], tuple[Shape, ...]] = entry.load()
            shapes.extend(give())
    return tuple(shapes)


def half_cylinder(
    name: str,
    start: FloatArray,
    axis: FloatArray,
    middle: FloatArray,
    radius: float,
    length: float,
    colour: Colour,
    pieces: int = 48,
) -> Shape:
    """Return half a cylinder's surface.

    Args:
        name: Unique name.
        start: Start of the axis in the measurement frame, (3,) [m].
        axis: Unit direction of the axis, (3,).
        middle: Unit direction from the axis to the middle of the half, (3,), square to `axis`.
        radius, length: Of the cylinder [m].
        colour: Red, green, blue, opacity.
        pieces: Flat pieces around the half.
    """
    angles = np.linspace(-np.pi / 2, np.pi / 2, pieces + 1)
    side = np.cross(axis, middle)
    arc = radius * (np.cos(angles)[:, None] * middle + np.sin(angles)[:, None] * side)
    vertices = np.concatenate([start + arc, start + arc + length * np.asarray(axis)])
    i = np.arange(pieces)
    quads = np.stack([i, i + 1, i + pieces + 2, i + pieces + 1], axis=1)
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return mesh(name, None, vertices, faces, colour)
