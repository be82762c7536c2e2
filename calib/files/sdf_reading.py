"""Gazebo's format (SDF) read as a URDF, for `urdf: robot.sdf`.

With the poses of links, joints and frames resolved in the model (`relative_to`, `attached_to`):

    link        a link of its name in its frame
    joint       T_parent_joint; a link between them and T_joint_child unless T_joint_child is the identity
    axis        in the joint's frame; in the model's before SDF 1.5, or with `use_parent_model_frame`
    mimic       with the offset of URDF: offset - multiplier * reference
    a link that is the child of two joints
                a loop, cut open at the later joint: two coinciding links, z along its axis. It holds x and y if all
                other joints of the loop turn about parallel axes, or slide across them; else x, y and z
    plugin      the joints that it names (`joint_name`) have motors; without any, all have

When it fails. Included and nested models, and joints without an equivalent in URDF, are errors.

Reference: sdformat.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import pinocchio as pin

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import UrdfError, nearest
from calib.core.robots.mechanism import perpendicular_axes
from calib.core.robots.urdf.text import ForeignLoop, ForeignRobot
from calib.files.urdf_elements import NewUrdf

_TYPES = ("revolute", "continuous", "prismatic", "fixed")
_ENDLESS = 1e10  # SDF limits above this count as none [m or rad]
_PARALLEL = 1e-6
_MODEL = "__model__"


def read_sdf(path: str, source: bytes, *_: object) -> tuple[bytes, ForeignRobot]:
    """Return the first model of an SDF file as a URDF, and what a URDF cannot hold.

    `UrdfError` if the file is not valid, or URDF has no equivalent for its content.
    """
    try:
        root = ElementTree.fromstring(source)
    except ElementTree.ParseError as error:
        raise UrdfError(f"{path}: not valid XML ({error}); give an SDF file, or a URDF") from None
    model = next(root.iter("model"), None)
    if model is None or model.find("link") is None:
        what = "it includes others" if root.find(".//include") is not None else "it has no model with links"
        raise UrdfError(f"{path}: {what}; write one whole model, such as with gz sdf -p, or give the URDF")
    for tag in ("include", "model"):
        if model.find(tag) is not None:
            raise UrdfError(
                f"{path}: model '{model.get('name')}' holds other models; write it as one, or give the URDF"
            )
    version = [int(part) for part in root.get("version", "1.6").split(".") if part.isdigit()]
    return _SdfReader(model, version < [1, 5], path).read()


class _SdfReader:
    def __init__(self, model: Element, old: bool, path: str) -> None:
        self.model, self.old, self.path = model, old, path
        self.named = {e.get("name", ""): e for tag in ("link", "joint", "frame") for e in model.findall(tag)}
        self.urdf = NewUrdf(model.get("name") or Path(path).stem)
        self.known: dict[str, pin.SE3] = {}
        self.tree: dict[str, Element] = {}  # joint of SDF by its child

    def read(self) -> tuple[bytes, ForeignRobot]:
        for link in self.model.findall("link"):
            self._link(link)
        joints, later = self.model.findall("joint"), []
        if any(self._text(joint, "parent") == "world" for joint in joints):
            self.urdf.add_link("world")
        for joint in joints:
            child = self._end(joint, "child")
            if child in self.tree:
                later.append(joint)
            else:
                self.tree[child] = joint
                self._joint(joint, self._end(joint, "parent"), child)
        loops = [self._loop(joint) for joint in later]
        moving = [joint.get("name", "") for joint in self.tree.values() if joint.get("type") != "fixed"]
        named = [text for plugin in self.model.iter("plugin") for e in plugin.iter("joint_name") if (text := e.text)]
        motors = tuple(name for name in moving if name in named) if named or loops else tuple(moving)
        cut = [f"joint {joint.get('name')} closes a loop; the loop is cut open at this joint" for joint in later]
        remarks = (*cut, *self.urdf.remarks)
        foreign = ForeignRobot(motors, tuple(loops), home=dict.fromkeys(moving, 0.0), remarks=remarks)
        return self.urdf.document(), foreign

    def _text(self, element: Element, tag: str, default: str = "") -> str:
        return (element.findtext(tag) or default).strip()

    def _error(self, element: Element, text: str) -> UrdfError:
        return UrdfError(f"{self.path}: {element.tag} '{element.get('name', '')}': {text}")

    def _numbers(self, element: Element, text: str, count: int) -> FloatArray:
        try:
            numbers = np.array([float(part) for part in text.split()])
        except ValueError:
            numbers = np.zeros(0)
        if len(numbers) != count or not np.all(np.isfinite(numbers)):
            raise self._error(element, f"'{text}' are not {count} numbers")
        return numbers

    def _pose(self, owner: Element) -> pin.SE3:
        """The pose written in an element, in its reference frame."""
        element = owner.find("pose")
        text = "" if element is None else (element.text or "").strip()
        if element is None or not text:
            return pin.SE3.Identity()
        if element.get("rotation_format") == "quat_xyzw":
            numbers = self._numbers(owner, text, 7)
            turned = pin.Quaternion(numbers[6], *numbers[3:6]).normalized().matrix()
            return pin.SE3(turned, numbers[:3])
        numbers = self._numbers(owner, text, 6)
        angles = np.deg2rad(numbers[3:]) if element.get("degrees") == "true" else numbers[3:]
        return pin.SE3(pin.rpy.rpyToMatrix(angles), numbers[:3])

    def _place(self, name: str, waiting: tuple[str, ...] = ()) -> pin.SE3:
        """The pose of a link, a joint or a frame in the model."""
        if name in (_MODEL, "world"):
            return pin.SE3.Identity()
        if name not in self.named or name in waiting:
            why = "is placed relative to itself" if name in waiting else f"is no link{nearest(name, self.named)}"
            raise UrdfError(f"{self.path}: '{name}' {why}")
        if name not in self.known:
            element = self.named[name]
            child, body = self._text(element, "child"), element.get("attached_to", "")
            usual = {"link": "", "joint": child, "frame": body}[element.tag]
            pose = element.find("pose")
            about = ("" if pose is None else pose.get("relative_to", "")) or usual or _MODEL
            self.known[name] = self._place(about, (*waiting, name)) * self._pose(element)
        return self.known[name]

    def _end(self, joint: Element, tag: str) -> str:
        """The link at an end of a joint; the file may name a frame."""
        name = self._text(joint, tag)
        for _ in self.named:
            element = self.named.get(name)
            if element is None or element.tag == "link":
                break
            name = self._text(element, "child") if element.tag == "joint" else element.get("attached_to", "")
        if name != "world" and (name not in self.named or self.named[name].tag != "link"):
            raise self._error(joint, f"its {tag} '{self._text(joint, tag)}' is no link{nearest(name, self.named)}")
        return name

    def _axis(self, joint: Element) -> FloatArray:
        """The joint's axis in its own frame, (3,)."""
        axis = joint.find("axis")
        xyz = None if axis is None else axis.find("xyz")
        if axis is None or xyz is None:
            raise self._error(joint, "has no axis; write <axis><xyz>0 0 1</xyz></axis>")
        direction = self._numbers(joint, (xyz.text or "").strip(), 3)
        if not np.linalg.norm(direction) > 0:
            raise self._error(joint, "its axis is zero")
        of_model = self.old or self._text(axis, "use_parent_model_frame") in ("true", "1")
        frame = xyz.get("expressed_in", "") or (_MODEL if of_model else joint.get("name", ""))
        turned = self._place(joint.get("name", "")).rotation.T @ self._place(frame).rotation @ direction
        return np.asarray(turned / np.linalg.norm(turned))

    def _joint(self, joint: Element, parent: str, child: str) -> None:
        name, kind = joint.get("name", ""), joint.get("type", "")
        if kind not in _TYPES:
            raise self._error(joint, f"is {kind}, which no URDF has; make it of {', '.join(_TYPES)} joints")
        place = self._place(name)
        rest, between = place.inverse() * self._place(child), child
        if kind != "fixed" and not rest.isIdentity(1e-12):
            between = f"{child}_{name}"
            self.urdf.add_link(between)
        origin = self._place(parent).inverse() * (self._place(child) if kind == "fixed" else place)
        axis, limits = joint.find("axis"), (-np.inf, np.inf)
        limit = None if axis is None else axis.find("limit")
        if limit is not None:
            texts = (self._text(limit, "lower", "-1e16"), self._text(limit, "upper", "1e16"))
            lower, upper = (float(self._numbers(joint, text.replace("inf", "1e16"), 1)[0]) for text in texts)
            limits = (lower if lower > -_ENDLESS else -np.inf, upper if upper < _ENDLESS else np.inf)
        if not np.all(np.isfinite(limits)):
            if kind == "prismatic":
                raise self._error(joint, "slides without limits, which a URDF must have: add them")
            kind = "continuous" if kind == "revolute" else kind
        if kind == "fixed":
            self.urdf.add_joint(name, kind, (parent, between), origin)
        else:
            stated = None if kind == "continuous" else limits
            element = self.urdf.add_joint(name, kind, (parent, between), origin, self._axis(joint), stated)
            self._follow(element, joint)
        if between != child:
            self.urdf.add_joint(f"{child}_fixed", "fixed", (between, child), rest)

    def _follow(self, element: Element, joint: Element) -> None:
        mimic = joint.find("axis/mimic")
        if mimic is not None:
            factor, offset, about = (
                float(self._numbers(joint, self._text(mimic, tag, usual), 1)[0])
                for tag, usual in (("multiplier", "1"), ("offset", "0"), ("reference", "0"))
            )
            led_by = mimic.get("joint", "")
            SubElement(element, "mimic", joint=led_by, multiplier=repr(factor), offset=repr(offset - factor * about))

    def _loop(self, joint: Element) -> ForeignLoop:
        """The two links of a joint that closes a loop."""
        name, place, kind = joint.get("name", ""), self._place(joint.get("name", "")), joint.get("type", "")
        ends = self._end(joint, "parent"), self._end(joint, "child")
        axes: tuple[str, ...] = ("x", "y", "z", "rx", "ry", "rz")
        if kind not in ("revolute", "continuous", "ball", "fixed"):
            raise self._error(joint, f"closes a loop and is {kind}; close the loop at a revolute or ball joint")
        if kind in ("revolute", "continuous"):
            axis = self._axis(joint)
            place = place * pin.SE3(np.column_stack([*perpendicular_axes(axis), axis]), np.zeros(3))
            axes = axes[: 2 if self._planar(place.rotation[:, 2], ends) else 3]
        elif kind == "ball":
            axes = axes[:3]
        places = [self._place(end).inverse() * place for end in ends]
        return self.urdf.cut_loop(ends, (f"{name}_a", f"{name}_b"), places, axes=axes)

    def _planar(self, axis: FloatArray, ends: tuple[str, str]) -> bool:
        """Whether the joints between two links turn about an axis of the model, (3,), or slide across it."""
        ways = [list(self._path(end)) for end in ends]
        own = [joint for joint in ways[0] + ways[1] if (joint in ways[0]) != (joint in ways[1])]
        for joint in own:
            if joint.get("type") == "fixed":
                continue
            along = abs(float(self._place(joint.get("name", "")).rotation @ self._axis(joint) @ axis))
            if abs(along - (joint.get("type") != "prismatic")) > _PARALLEL:
                return False
        return True

    def _path(self, link: str) -> Iterator[Element]:
        while link in self.tree:
            yield self.tree[link]
            link = self._end(self.tree[link], "parent")

    def _link(self, link: Element) -> None:
        name = link.get("name", "")
        self.urdf.add_link(name)
        inertial = link.find("inertial")
        mass = "" if inertial is None else self._text(inertial, "mass")
        if inertial is not None and mass:
            moments = {e.tag: (e.text or "0").strip() for e in inertial.findall("inertia/*")}
            self.urdf.add_inertia(name, self._pose(inertial), mass, moments)
        for role in ("visual", "collision"):
            for element in link.findall(role):
                shape = self._shape(element)
                self.urdf.add_shape(name, role, [] if shape is None else [(self._pose(element), shape)])

    def _shape(self, visual: Element) -> Element | None:
        for kind, keys in (("box", ("size",)), ("sphere", ("radius",)), ("cylinder", ("radius", "length"))):
            shape = visual.find(f"geometry/{kind}")
            if shape is not None:
                return Element(kind, {key: self._text(shape, key, "1") for key in keys})
        mesh = visual.find("geometry/mesh")
        if mesh is None:
            return None
        uri = self._text(mesh, "uri").replace("file://", "").replace("model://", "package://")
        return Element("mesh", filename=uri, scale=self._text(mesh, "scale", "1 1 1"))
