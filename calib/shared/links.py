"""Masses and shapes of a URDF's links, for simulators, pictures and collisions.

Undeclared XML prefixes are accepted, as in most programs.
"""

from __future__ import annotations

import xml.parsers.expat
from dataclasses import dataclass
from xml.etree.ElementTree import Element, TreeBuilder

import numpy as np
import pinocchio as pin

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import UrdfError
from calib.core.robots.urdf.text import UrdfText

_KINDS = ("box", "cylinder", "sphere", "mesh")


@dataclass(frozen=True, eq=False)
class Inertial:
    """Mass properties of a link.

    Attributes:
        mass: [kg].
        centre: Centre of mass in the link frame, (3,) [m].
        inertia: About the centre of mass, in the axes of the link frame, (3, 3) [kg m^2].
    """

    mass: float
    centre: FloatArray
    inertia: FloatArray


@dataclass(frozen=True, eq=False)
class LinkShape:
    """A visual or collision geometry.

    Attributes:
        kind: `box`, `cylinder`, `sphere` or `mesh`.
        placement: Pose in the link frame.
        size: Box: edge lengths; cylinder: radius, length; sphere: radius; mesh: scale [m, or factors].
        file: Mesh file name as written, else "".
        colour: Red, green, blue, opacity, or None.
    """

    kind: str
    placement: pin.SE3
    size: tuple[float, ...]
    file: str
    colour: tuple[float, ...] | None


@dataclass(frozen=True, eq=False)
class Link:
    """A link's inertial (None if the file has none), visuals and collisions, and unknown kinds of both."""

    inertial: Inertial | None
    visuals: tuple[LinkShape, ...]
    collisions: tuple[LinkShape, ...]
    unknown: tuple[str, ...]
    unknown_collisions: tuple[str, ...]


def element_tree(source: bytes) -> Element:
    """Parse XML into elements with tags as spelled, prefixes included."""
    builder = TreeBuilder()
    parser = xml.parsers.expat.ParserCreate()
    parser.StartElementHandler = lambda tag, attributes: builder.start(tag, attributes) and None
    parser.EndElementHandler = lambda tag: builder.end(tag) and None
    parser.Parse(source, True)
    return builder.close()


def read_links(urdf: UrdfText) -> dict[str, Link]:
    """Read all links, in file order; a mass, size or origin that is not made of numbers is a `UrdfError`."""
    root = element_tree(urdf.source)
    colours = {
        str(material.get("name")): colour
        for material in root.iterfind("material")
        if (colour := _colour(material, {}, urdf.path)) is not None
    }
    return {
        str(link.get("name")): _link(link, colours, f"{urdf.path}, link '{link.get('name')}'")
        for link in root.iterfind("link")
    }


def _link(link: Element, colours: dict[str, tuple[float, ...]], where: str) -> Link:
    shapes: dict[str, list[LinkShape]] = {"visual": [], "collision": []}
    for role, of_role in shapes.items():
        for element in link.iterfind(role):
            shape = _shape(element, colours, f"{where}, {role}")
            if shape is not None:
                of_role.append(shape)
    inertial = link.find("inertial")
    return Link(
        None if inertial is None else _inertial(inertial, f"{where}, inertial"),
        tuple(shapes["visual"]),
        tuple(shapes["collision"]),
        *(tuple(kind.tag for kind in link.iterfind(f"{role}/geometry/*") if kind.tag not in _KINDS) for role in shapes),
    )


def _inertial(element: Element, where: str) -> Inertial:
    placement = _placement(element, where)
    mass, inertia = element.find("mass"), element.find("inertia")
    value = _numbers(mass.get("value", "0"), 1, where)[0] if mass is not None else 0.0
    xx, xy, xz, yy, yz, zz = (
        (0.0,) * 6
        if inertia is None
        else tuple(_numbers(inertia.get(f"i{key}", "0"), 1, where)[0] for key in ("xx", "xy", "xz", "yy", "yz", "zz"))
    )
    about = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    rotation = placement.rotation
    return Inertial(value, placement.translation.copy(), rotation @ about @ rotation.T)


def _shape(element: Element, colours: dict[str, tuple[float, ...]], where: str) -> LinkShape | None:
    geometry = element.find("geometry")
    shape = next(iter(geometry), None) if geometry is not None else None
    if shape is None or shape.tag not in _KINDS:
        return None
    size: tuple[float, ...]
    if shape.tag == "box":
        size = _numbers(shape.get("size", ""), 3, where)
    elif shape.tag == "mesh":
        size = _numbers(shape.get("scale", "1 1 1"), 3, where)
    else:
        keys = ("radius", "length") if shape.tag == "cylinder" else ("radius",)
        size = tuple(_numbers(shape.get(key, ""), 1, where)[0] for key in keys)
    material = element.find("material")
    colour = _colour(material, colours, where) if material is not None else None
    return LinkShape(shape.tag, _placement(element, where), size, shape.get("filename", ""), colour)


def _colour(material: Element, named: dict[str, tuple[float, ...]], where: str) -> tuple[float, ...] | None:
    colour = material.find("color")
    if colour is not None:
        return _numbers(colour.get("rgba", "0.5 0.5 0.5 1"), 4, where)
    return named.get(str(material.get("name")))


def _placement(element: Element, where: str) -> pin.SE3:
    origin = element.find("origin")
    if origin is None:
        return pin.SE3.Identity()
    rpy = _numbers(origin.get("rpy", "0 0 0"), 3, where)
    return pin.SE3(pin.rpy.rpyToMatrix(*rpy), np.array(_numbers(origin.get("xyz", "0 0 0"), 3, where)))


def _numbers(text: str, count: int, where: str) -> tuple[float, ...]:
    try:
        values = tuple(float(part) for part in text.split())
    except ValueError:
        values = ()
    if len(values) != count or not np.all(np.isfinite(values)):
        raise UrdfError(f"{where}: '{text}' is not {count} number{'s' * (count > 1)}")
    return values
