"""Surroundings of a robot: shapes that a package gives for a robot it knows, such as a target workspace.

A package registers a function in the entry point group `viz.decorations`, under the robot's name in its URDF; called
without arguments it returns shapes whose `body` is None, in the measurement frame. Nothing here knows any robot.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from importlib.metadata import entry_points

from viz.shapes import Shape

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
