"""Shapes to draw: boxes, cylinders, spheres and meshes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from calib.core.base.arrays import FloatArray, IntArray

Colour = tuple[float, float, float, float]
GREY: Colour = (0.62, 0.66, 0.7, 1.0)
DARK: Colour = (0.3, 0.34, 0.4, 1.0)
_UPPER = np.array(np.meshgrid(*[(False, True)] * 3)).reshape(3, -1).T  # coordinates of the corners of a box


@dataclass(frozen=True, eq=False)
class Shape:
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
    size: tuple[float, ...]
    T_body_shape: FloatArray
    colour: Colour
    vertices: FloatArray
    faces: IntArray

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


def primitive(
    name: str,
    body: str | None,
    kind: Literal["box", "cylinder", "sphere"],
    size: tuple[float, ...],
    T_body_shape: FloatArray,
    colour: Colour = GREY,
) -> Shape:
    """Return a box, cylinder or sphere; the arguments are attributes of `Shape`, T_body_shape (4, 4) [m]."""
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
    """Return a mesh of corners (n, 3) [m] and triangles of their indices (m, 3), at a pose in its link (4, 4) [m]."""
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
