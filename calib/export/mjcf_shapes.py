"""The shapes of links in MJCF: boxes, cylinders, spheres, and those meshes that MuJoCo can read."""

from __future__ import annotations

import os
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import pinocchio as pin

from calib.export.links import Link, Shape, find_mesh
from calib.export.xml_text import numbers

_MAX_FACES = 200_000  # of a binary STL file, MuJoCo's limit


class Shapes:
    """Writes geoms and collects the mesh files that they need.

    Args:
        urdf_path: Where mesh files are looked for.
        folder: Where the MJCF file will lie; mesh files are named relative to it.

    Attributes:
        asset: The `<asset>` element with the meshes.
        remarks: What was left out, and why.
    """

    def __init__(self, urdf_path: str, folder: Path) -> None:
        self.urdf_path, self.folder = urdf_path, folder.resolve()
        self.asset = Element("asset")
        self.remarks: list[str] = []
        self._meshes: dict[tuple[str, tuple[float, ...]], str] = {}

    def add(self, body: Element, link: Link) -> None:
        """Add a link's shapes to its body: visuals in group 2, collisions in group 3."""
        for shape in link.visuals:
            self._geom(body, shape, {"group": "2", "contype": "0", "conaffinity": "0"})
        for shape in link.collisions:
            self._geom(body, shape, {"group": "3"})

    def _geom(self, body: Element, shape: Shape, role: dict[str, str]) -> None:
        attributes = {"type": shape.kind, **placed(shape.placement)}
        if shape.kind == "mesh":
            name = self._mesh(shape)
            if name is None:
                return
            attributes["mesh"] = name
        elif shape.kind == "box":
            attributes["size"] = numbers(edge / 2 for edge in shape.size)
        elif shape.kind == "cylinder":
            attributes["size"] = numbers((shape.size[0], shape.size[1] / 2))
        else:
            attributes["size"] = numbers(shape.size)
        if shape.colour is not None:
            attributes["rgba"] = numbers(shape.colour)
        SubElement(body, "geom", {**attributes, "mass": "0", **role})  # a link weighs what its <inertial> says

    def _mesh(self, shape: Shape) -> str | None:
        """Name of a mesh that MuJoCo can read, or None with a remark."""
        path = find_mesh(shape.file, self.urdf_path)
        if path is None or not _is_readable(path):
            why = "not found" if path is None else "neither OBJ nor binary STL of at most 200 000 faces"
            self.remarks.append(f"mesh {shape.file} left out ({why})")
            return None
        file = os.path.relpath(path, self.folder)
        key = (file, shape.size)
        if key not in self._meshes:
            self._meshes[key] = f"mesh_{len(self._meshes)}"
            attributes = {"file": file, "scale": numbers(shape.size)}
            attributes["inertia"] = "shell"  # a flat mesh has no volume, which MuJoCo would refuse
            SubElement(self.asset, "mesh", {"name": self._meshes[key], **attributes})
        return self._meshes[key]


def placed(placement: pin.SE3) -> dict[str, str]:
    """Return `pos` and `quat` of a pose; each is left out where it is zero."""
    result = {}
    if np.any(placement.translation):
        result["pos"] = numbers(placement.translation)
    if not np.array_equal(placement.rotation, np.eye(3)):
        x, y, z, w = pin.Quaternion(placement.rotation).normalized().coeffs()
        result["quat"] = numbers((w, x, y, z))
    return result


def _is_readable(path: Path) -> bool:
    """Whether MuJoCo can load a mesh: OBJ, or binary STL that is not too large."""
    if path.suffix.lower() == ".obj":
        return True
    if path.suffix.lower() != ".stl" or path.stat().st_size < 84:
        return False
    with path.open("rb") as stream:
        count = int.from_bytes(stream.read(84)[80:], "little")
    return count <= _MAX_FACES and path.stat().st_size == 84 + 50 * count
