"""URDF of a robot that another program describes, as XML elements."""

from __future__ import annotations

from collections.abc import Mapping
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import pinocchio as pin

from calib.core.base.arrays import FloatArray
from calib.core.robots.urdf.writing import joint_text, number_attribute

_MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


def document(root: Element) -> bytes:
    """Return the URDF of an element `robot`."""
    ElementTree.indent(root)
    return b'<?xml version="1.0"?>\n' + ElementTree.tostring(root, encoding="utf-8") + b"\n"


def joint_element(
    root: Element,
    name: str,
    kind: str,
    links: tuple[str, str],
    origin: pin.SE3,
    axis: FloatArray | None = None,
    limits: tuple[float, float] | None = None,
) -> Element:
    """Add a joint to a robot, and return it; see `joint_text`."""
    along, turned = "" if axis is None else number_attribute(axis), pin.rpy.matrixToRpy(origin.rotation)
    root.append(ElementTree.fromstring(joint_text(name, kind, links, origin.translation, turned, along, limits)))
    return root[-1]


def inertial_element(link: Element, origin: pin.SE3, mass: str, moments: Mapping[str, str]) -> None:
    """Add mass [kg] and moments of inertia [kg m^2] to a link; missing moments are 0."""
    element = SubElement(link, "inertial")
    SubElement(element, "origin", origin_of(origin))
    SubElement(element, "mass", value=mass)
    SubElement(element, "inertia", {key: moments.get(key, "0") or "0" for key in _MOMENTS})


def shape_element(link: Element, role: str, origin: pin.SE3, shape: Element) -> None:
    """Add a shape to a link; `role` is `visual` or `collision`."""
    element = SubElement(link, role)
    SubElement(element, "origin", origin_of(origin))
    SubElement(element, "geometry").append(shape)


def origin_of(place: pin.SE3) -> dict[str, str]:
    """Return the attributes of a URDF's origin."""
    return {"xyz": number_attribute(place.translation), "rpy": number_attribute(pin.rpy.matrixToRpy(place.rotation))}


def perpendicular_axes(axis: FloatArray) -> FloatArray:
    """Return two unit vectors perpendicular to `axis` (3,) and each other, (2, 3)."""
    second = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    second /= np.linalg.norm(second)
    return np.array([second, np.cross(axis, second)])
