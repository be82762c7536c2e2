"""The surroundings of MedRUE in the viewer: the target workspace, half a cylinder around a patient's leg."""

from __future__ import annotations

import numpy as np

from medrue.workspace import target_workspace
from viz.shapes import Shape

_SKIN = (0.80, 0.62, 0.52, 0.28)
_PIECES = 48  # flat pieces around the half


def leg() -> tuple[Shape, ...]:
    """Return the half cylinder on which the target workspace's positions lie, in the world frame [m]."""
    workspace = target_workspace()
    angles = np.linspace(-np.pi / 2, np.pi / 2, _PIECES + 1)[:, None]
    side = np.cross(workspace.axis, workspace.middle)
    arc = workspace.p_axis + workspace.radius * (np.cos(angles) * workspace.middle + np.sin(angles) * side)
    i = np.arange(_PIECES)
    quads = np.stack([i, i + 1, i + _PIECES + 2, i + _PIECES + 1], axis=1)
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    vertices = np.concatenate([arc, arc + workspace.length * workspace.axis])
    return (Shape("leg", None, "mesh", vertices=vertices, faces=faces, colour=_SKIN),)
