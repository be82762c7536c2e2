"""The shapes of links in MJCF: boxes, cylinders, spheres, and meshes.

MuJoCo reads OBJ and binary STL. Other meshes, such as Collada, are converted to OBJ files beside the MJCF file, one for
each colour. A link whose meshes cannot be read is drawn as rods to its joints.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import pinocchio as pin

from calib.core.base.arrays import FloatArray
from calib.core.robots.urdf.meshes import find_mesh
from calib.core.robots.urdf.writing import number_attribute
from calib.shared.links import Link, LinkShape

_MAX_FACES = 200_000  # faces of a binary STL file, MuJoCo's limit
_GREY = (0.6, 0.6, 0.6, 1.0)
_ROD = 0.06  # radius of a rod over its length


class MjcfShapes:
    """Writes geoms and collects the mesh files that they need.

    Args:
        urdf_path: Path of the URDF, from which mesh files are searched.
        path: The MJCF file; mesh files are named relative to its folder, and converted files are beside it.

    Attributes:
        asset: The `<asset>` element with the meshes.
        remarks: Shapes that could not be drawn, with reasons.
        converted: Contents of the converted mesh files.
    """

    def __init__(self, urdf_path: str, path: Path) -> None:
        self.urdf_path, self.folder = urdf_path, path.resolve().parent
        self.asset = Element("asset")
        self.remarks: list[str] = []
        self.converted: dict[Path, bytes] = {}
        self._beside = path.parent / f"{path.stem}_meshes"
        self._meshes: dict[tuple[str, tuple[float, ...]], str] = {}
        self._parts: dict[Path, list[tuple[Path, tuple[float, ...]]]] = {}

    def add(self, body: Element, link: Link, ends: list[FloatArray]) -> None:
        """Add a link's shapes to its body: visuals in group 2, collisions in group 3.

        Args:
            ends: Positions of its joints, (3,) [m] each, for rods if its visuals cannot be read.
        """
        visible = {"group": "2", "contype": "0", "conaffinity": "0"}
        drawn = [self._geom(body, shape, visible) for shape in link.visuals]
        if drawn and not any(drawn):
            self._rods(body, ends, visible)
        for shape in link.collisions:
            self._geom(body, shape, {"group": "3"})

    def _rods(self, body: Element, ends: list[FloatArray], role: dict[str, str]) -> None:
        for end in ends:
            length = float(np.linalg.norm(end))
            if length > 0:
                where = {"fromto": number_attribute((0.0, 0.0, 0.0, *end)), "size": number_attribute([_ROD * length])}
                look = {"rgba": number_attribute(_GREY), "mass": "0", **role}
                SubElement(body, "geom", {"type": "capsule", **where, **look})

    def _geom(self, body: Element, shape: LinkShape, role: dict[str, str]) -> bool:
        """Add one shape; return whether it could be read."""
        if shape.kind != "mesh" and min(shape.size) <= 0:
            self.remarks.append(f"{shape.kind} of size zero at {body.get('name')} left out; MuJoCo refuses it")
            return True
        common = {**pose_attributes(shape.placement), "mass": "0", **role}  # the mass comes from <inertial>
        if shape.kind == "mesh":
            parts = self._files_of(shape)
            for file, own_colour in parts:
                colour = {"rgba": number_attribute(shape.colour or own_colour)} if shape.colour or own_colour else {}
                SubElement(body, "geom", {"type": "mesh", "mesh": self._mesh(file, shape.size), **colour, **common})
            return bool(parts)
        halved = {"box": (0, 1, 2), "cylinder": (1,)}.get(shape.kind, ())  # MuJoCo takes half of edges and of lengths
        size = number_attribute(value / 2 if k in halved else value for k, value in enumerate(shape.size))
        colour = {} if shape.colour is None else {"rgba": number_attribute(shape.colour)}
        SubElement(body, "geom", {"type": shape.kind, "size": size, **colour, **common})
        return True

    def _files_of(self, shape: LinkShape) -> list[tuple[Path, tuple[float, ...]]]:
        """Files of a mesh that MuJoCo can read, with their colours; a remark if there are none."""
        path = find_mesh(shape.file, self.urdf_path)
        if path is None:
            self.remarks.append(f"mesh {shape.file} left out (not found; set ROS_PACKAGE_PATH, or mend its name)")
            return []
        if _is_readable(path):
            return [(path, ())]
        if path not in self._parts:
            try:
                self._parts[path] = self._convert(path)
            except Exception as error:  # readers of mesh files raise many kinds
                self._parts[path] = []
                why = (str(error).strip().splitlines() or [type(error).__name__])[0]
                self.remarks.append(f"mesh {shape.file} left out (cannot be read: {why}; save it as OBJ or binary STL)")
        return self._parts[path]

    def _convert(self, path: Path) -> list[tuple[Path, tuple[float, ...]]]:
        """Write a mesh file as OBJ files, one for each colour; `ValueError` if it has no triangles.

        Other exceptions come from the readers of mesh files.
        """
        parts = []
        for number, (colour, content) in enumerate(_obj_by_colour(path)):
            file = self._beside / f"{path.stem}_{len(self._parts)}_{number}.obj"
            self.converted[file] = content
            parts.append((file, colour))
        if not parts:
            raise ValueError("no triangles in it")
        return parts

    def _mesh(self, path: Path, scale: tuple[float, ...]) -> str:
        """Name of the asset of a mesh file, added if it is new."""
        file = os.path.relpath(path, self.folder)
        key = (file, scale)
        if key not in self._meshes:
            self._meshes[key] = f"mesh_{len(self._meshes)}"
            attributes = {"file": file, "scale": number_attribute(scale)}
            attributes["inertia"] = "shell"  # a flat mesh has no volume, which MuJoCo would refuse
            SubElement(self.asset, "mesh", {"name": self._meshes[key], **attributes})
        return self._meshes[key]


def _obj_by_colour(path: Path) -> Iterator[tuple[tuple[float, ...], bytes]]:
    import trimesh

    scene: Any = trimesh.load(path, force="scene")
    points: dict[tuple[float, ...], list[FloatArray]] = {}
    for node in scene.graph.nodes_geometry:
        T_file_part, key = scene.graph[node]
        geometry = scene.geometry[key]
        if isinstance(geometry, trimesh.Trimesh) and len(geometry.faces):
            corners = np.asarray(geometry.triangles, dtype=float) @ T_file_part[:3, :3].T + T_file_part[:3, 3]
            if np.linalg.det(T_file_part[:3, :3]) < 0:
                corners = corners[:, ::-1]  # a mirrored part would be inside out
            points.setdefault(_colour(geometry.visual), []).append(corners)
    for colour, triangles in points.items():
        vertices, index = np.unique(np.concatenate(triangles).reshape(-1, 3), axis=0, return_inverse=True)
        lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices]
        lines += [f"f {a} {b} {c}" for a, b, c in index.reshape(-1, 3) + 1 if len({a, b, c}) == 3]
        yield colour, ("\n".join(lines) + "\n").encode()


def _colour(visual: Any) -> tuple[float, ...]:
    parts = np.ravel(getattr(getattr(visual, "material", visual), "main_color", ()))
    if not visual.defined or len(parts) < 3:
        return _GREY
    return (*(round(float(value) / 255, 3) for value in parts[:3]), 1.0)


def add_surroundings(world: Element, points: FloatArray) -> None:
    """Add a lamp above the links' frames at home, (n, 3) [m], and a floor below that collides with nothing."""
    size = round(max(float(np.max(np.abs(points))), 0.1), 3)  # millimetres suffice; more digits would be rounding
    low, high = (round(float(end), 3) for end in (np.min(points[:, 2]), np.max(points[:, 2])))
    SubElement(world, "light", name="lamp", pos=number_attribute((0.0, -size, high + 2 * size)), dir="0 0.4 -1")
    floor = {"type": "plane", "size": number_attribute((3 * size, 3 * size, size / 10)), "rgba": "0.85 0.87 0.9 1"}
    floor |= {"pos": number_attribute((0.0, 0.0, low)), "group": "2", "contype": "0", "conaffinity": "0"}
    SubElement(world, "geom", {"name": "floor", **floor})


def pose_attributes(placement: pin.SE3) -> dict[str, str]:
    """Return `pos` and `quat` of a pose, without default values."""
    result = {}
    if np.any(placement.translation):
        result["pos"] = number_attribute(placement.translation)
    if not np.array_equal(placement.rotation, np.eye(3)):
        x, y, z, w = pin.Quaternion(placement.rotation).normalized().coeffs()
        result["quat"] = number_attribute((w, x, y, z))
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
