"""Shapes to draw: boxes, cylinders, spheres and meshes."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from calib.core.base.arrays import FloatArray, IntArray, ReadOnlyArrays

Colour = tuple[float, float, float, float]
GREY: Colour = (0.62, 0.66, 0.7, 1.0)
DARK: Colour = (0.3, 0.34, 0.4, 1.0)
_UPPER = np.array(np.meshgrid(*[(False, True)] * 3)).reshape(3, -1).T  # coordinates of the corners of a box


@dataclass(frozen=True, eq=False)
class Shape(ReadOnlyArrays):
    """A drawable shape.

    Attributes:
        name: Unique name.
        body: Link that carries it; None for a shape at rest in the measurement frame.
        kind: Kind of the shape, which decides the meaning of `size`.
        size: box: edge lengths; cylinder: radius and length along z; sphere: radius; mesh: empty [m].
        T_body_shape: Pose of the shape in its link, (4, 4) [m].
        colour: Red, green, blue, opacity, 0 to 1.
        vertices, faces: Corners and triangles of a mesh, (n, 3) [m] and (m, 3); empty otherwise.
    """

    name: str
    body: str | None
    kind: Literal["box", "cylinder", "sphere", "mesh"]
    size: tuple[float, ...] = ()
    T_body_shape: FloatArray = field(default_factory=lambda: np.eye(4))
    colour: Colour = GREY
    vertices: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    faces: IntArray = field(default_factory=lambda: np.zeros((0, 3), dtype=np.intp))

    def triangles(self) -> tuple[FloatArray, IntArray]:
        """Return the surface in its link's frame: vertices (n, 3) [m], and vertex indices of triangles, (m, 3)."""
        from trimesh import creation

        make = {
            "box": lambda: creation.box(self.size),
            "cylinder": lambda: creation.cylinder(radius=self.size[0], height=self.size[1], sections=24),
            "sphere": lambda: creation.icosphere(subdivisions=2, radius=self.size[0]),
        }
        vertices, faces = self.vertices, self.faces
        if self.kind != "mesh":
            solid = make[self.kind]()
            vertices, faces = np.array(solid.vertices), np.array(solid.faces)
        return vertices @ self.T_body_shape[:3, :3].T + self.T_body_shape[:3, 3], faces

    def corners(self) -> FloatArray:
        """Return points that enclose the shape in its link's frame, (n, 3) [m]."""
        if self.kind == "mesh":
            low, high = self.vertices.min(axis=0), self.vertices.max(axis=0)
        else:
            high = np.array(self.size) / 2 if self.kind == "box" else np.full(3, self.size[0])
            if self.kind == "cylinder":
                high[2] = self.size[1] / 2
            low = -high
        corners: FloatArray = np.where(_UPPER, high, low) @ self.T_body_shape[:3, :3].T + self.T_body_shape[:3, 3]
        return corners


def translation(point: ArrayLike) -> FloatArray:
    """Return the pose of a shape whose axes are parallel to its link's, (4, 4), at a point (3,) [m]."""
    T = np.eye(4)
    T[:3, 3] = point
    return T


def rod(name: str, body: str | None, start: FloatArray, end: FloatArray, radius: float, colour: Colour = GREY) -> Shape:
    """Return a cylinder between two different points, (3,) [m] each."""
    length = float(np.linalg.norm(end - start))
    T = translation((start + end) / 2)
    T[:3, :3] = rotation_onto_z((end - start) / length)
    return Shape(name, body, "cylinder", (radius, length), T, colour)


def thin(vertices: FloatArray, faces: IntArray, most: int) -> tuple[FloatArray, IntArray]:
    """Return corners (n, 3) [m] and at most `most` triangles (m, 3); a grid, as fine as possible, merges corners."""
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


def rotation_onto_z(direction: FloatArray) -> FloatArray:
    """Return a rotation whose third column is the unit vector `direction`, (3, 3)."""
    helper = np.eye(3)[int(np.argmin(np.abs(direction)))]
    x = np.cross(helper, direction)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(direction, x), direction], axis=1)
