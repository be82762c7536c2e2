"""URDF of a robot that another program describes, written link by link."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import pinocchio as pin

from calib.core.base.arrays import FloatArray
from calib.core.base.words import listing
from calib.core.robots.urdf.text import ForeignLoop
from calib.core.robots.urdf.writing import joint_text, number_attribute

_MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


class NewUrdf:
    """A URDF to which links and joints are added.

    Attributes:
        root: Its element `robot`.
        links: Its links by name.
    """

    def __init__(self, name: str) -> None:
        self.root = Element("robot", name=name)
        self.links: dict[str, Element] = {}
        self._unread: dict[str, None] = {}  # links with collision shapes that a URDF cannot hold

    def add_link(self, name: str) -> None:
        """Add a link."""
        self.links[name] = SubElement(self.root, "link", name=name)

    def add_joint(
        self,
        name: str,
        kind: str,
        links: tuple[str, str],
        origin: pin.SE3,
        axis: FloatArray | None = None,
        limits: tuple[float, float] | None = None,
    ) -> Element:
        """Add a joint, and return it; see `joint_text`."""
        along, turned = "" if axis is None else number_attribute(axis), pin.rpy.matrixToRpy(origin.rotation)
        text = joint_text(name, kind, links, origin.translation, turned, along, limits)
        self.root.append(ElementTree.fromstring(text))
        return self.root[-1]

    def fix(self, parent: str, child: str, origin: pin.SE3) -> None:
        """Add a link that is fixed to another one."""
        self.add_joint(f"{child}_fixed", "fixed", (parent, child), origin)
        self.add_link(child)

    def cut_loop(
        self, ends: Sequence[str], names: tuple[str, str], places: Sequence[pin.SE3], *, axes: tuple[str, ...]
    ) -> ForeignLoop:
        """Add two coinciding links, fixed to the ends of a loop at these places, and return the loop.

        It holds whole frames if `axes` has rotations.
        """
        for end, name, place in zip(ends, names, places, strict=True):
            self.fix(end, name, place)
        return ForeignLoop(names, "6d" if "rx" in axes else "3d", axes)

    def add_inertia(self, link: str, origin: pin.SE3, mass: str, moments: Mapping[str, str]) -> None:
        """Add mass [kg] and moments of inertia [kg m^2] to a link; missing moments are 0."""
        element = SubElement(self.links[link], "inertial")
        SubElement(element, "origin", _origin(origin))
        SubElement(element, "mass", value=mass)
        SubElement(element, "inertia", {key: moments.get(key, "0") or "0" for key in _MOMENTS})

    def add_shape(self, link: str, role: str, parts: Sequence[tuple[pin.SE3, Element]]) -> None:
        """Add the parts of a shape to a link, none if a URDF cannot hold it; `role` is `visual` or `collision`."""
        for origin, part in parts:
            element = SubElement(self.links[link], role)
            SubElement(element, "origin", _origin(origin))
            SubElement(element, "geometry").append(part)
        if not parts and role == "collision":
            self._unread.setdefault(link)

    @property
    def remarks(self) -> list[str]:
        """A remark on the links whose collision shapes are left out, if there are any."""
        what = "collision shapes left out, which a URDF cannot hold (write 'obstacles' for them)"
        return [f"{what}: of {listing(list(self._unread))}"] if self._unread else []

    def document(self) -> bytes:
        """Return the file."""
        ElementTree.indent(self.root)
        return b'<?xml version="1.0"?>\n' + ElementTree.tostring(self.root, encoding="utf-8") + b"\n"


def _origin(place: pin.SE3) -> dict[str, str]:
    return {"xyz": number_attribute(place.translation), "rpy": number_attribute(pin.rpy.matrixToRpy(place.rotation))}
