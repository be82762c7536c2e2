"""Surroundings of a known robot, such as a target workspace, as shapes from other packages.

A package registers a function in the entry point group `viz.decorations`, under the robot's name in its URDF. Called
without arguments, the function returns shapes whose `body` is None, in the measurement frame.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from importlib.metadata import entry_points

from viz.shapes import Shape

ENTRY_POINTS = "viz.decorations"


@functools.cache  # a search through all installed packages takes a tenth of the time of a live viewer's new scene
def decorations_of(robot_name: str) -> tuple[Shape, ...]:
    """Return the shapes that installed packages give for the robot of this name."""
    shapes: list[Shape] = []
    for entry in entry_points(group=ENTRY_POINTS):
        if entry.name == robot_name:
            give: Callable[[], tuple[Shape, ...]] = entry.load()
            shapes.extend(give())
    return tuple(shapes)
