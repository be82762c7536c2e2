"""Parts of new URDFs: text for robots from tables and lengths, XML elements for robots from other formats."""

from __future__ import annotations

import html
from collections.abc import Iterable, Mapping, Sequence
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import pinocchio as pin

from calib.core.base.arrays import FloatArray

_MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


def quote_attribute(text: str) -> str:
    """Return a text as a quoted attribute value; `xml.sax.saxutils` would import a web client."""
    escaped = html.escape(text)
    for letter in "\n\r\t":
        escaped = escaped.replace(letter, f"&#{ord(letter)};")
    return f'"{escaped}"'


def robot_text(name: str, note: str, links: Sequence[str], joints: Sequence[str]) -> str:
    """Return a new URDF from names of links and texts of joints (`joint_text`); `note` is a comment at its head."""
    body = "".join([*(f"  <link name={quote_attribute(link)}/>\n" for link in links), *joints])
    return f'<?xml version="1.0"?>\n<!-- {note} -->\n<robot name={quote_attribute(name)}>\n{body}</robot>\n'


def joint_text(
    name: str,
    kind: str,
    links: tuple[str, str],
    xyz: Iterable[float],
    rpy: Iterable[float],
    axis: str,
    limits: tuple[float, float] | None,
) -> str:
    """Return the element of a joint of a new URDF; `links` are its parent and child.

    `axis` has three numbers, or none if the joint is fixed; `limits` are lowest and highest value [m or rad], or None.
    """
    parent, child = map(quote_attribute, links)
    lines = [
        f"<parent link={parent}/> <child link={child}/>",
        f'<origin xyz="{number_attribute(xyz)}" rpy="{number_attribute(rpy)}"/>',
    ]
    if axis:
        lines.append(f'<axis xyz="{axis}"/>')
    if axis and limits:
        lines.append(f'<limit lower="{limits[0]!r}" upper="{limits[1]!r}" effort="0" velocity="0"/>')
    inside = "".join(f"    {line}\n" for line in lines)
    return f'  <joint name={quote_attribute(name)} type="{kind}">\n{inside}  </joint>\n'


def number_attribute(values: Iterable[float]) -> str:
    """Return numbers as an attribute of a URDF."""
    return " ".join(shortest(value) for value in values)


def shortest(value: float) -> str:
    """Return the shortest decimal that reads back to the same number."""
    return repr(float(value)) if value != 0 else "0"


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
