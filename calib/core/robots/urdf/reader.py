"""Reading a URDF: links, joints, and the place of each joint origin in the file's bytes.

The XML parser (expat) reports the byte offset of every tag; `calib.core.robots.urdf.text` needs it to change a number
and nothing else. Unused elements and attributes (visuals, transmissions, gazebo and xacro leftovers, comments) are
skipped here and stay in the file.

Errors, each with its remedy: files that are not one tree, repeated names, numbers that are not three plain decimals
(xacro expressions, commas), two `<origin>` in one joint.
"""

from __future__ import annotations

import math
import re
import xml.parsers.expat
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from calib.core.base.errors import UrdfError, require_known
from calib.core.base.letters import unseen

Triple = tuple[float, float, float]
Span = tuple[int, int]
MOVING_TYPES = ("revolute", "continuous", "prismatic")
UNSUPPORTED_TYPES = ("floating", "planar")
HELD_TYPES = ("fixed", *UNSUPPORTED_TYPES)
NUMBER = re.compile(r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?", re.ASCII)
_TAG = re.compile(rb"""<[^\s/>"']+(?:[^"'>]|"[^"]*"|'[^']*')*>""")
MOST_LINKS = 300
"""Largest number of links: Pinocchio's data grow with the third power."""
_LARGEST = 1e9  # largest value in an origin or `<mimic>` [m or rad]: squares and products stay finite
_SHAPES = ("box", "cylinder", "capsule", "sphere", "mesh", "origin", "mass", "inertia")
_XML_HINTS = {
    "declaration not at start": "; the <?xml ...?> line must be the very first",
    "prefix": "; declare it on the top element, such as xmlns:xacro",
}
_NO_NUMBERS = ("name", "filename")
_SPACE = " \t\r\n"  # XML's; str.split() would also accept the no-break space, which other programs refuse


@dataclass(frozen=True)
class UrdfJoint:
    """A `<joint>` of the file.

    Attributes:
        name, type, parent, child: As in the file.
        xyz: Origin translation, parent link to joint [m].
        rpy: Origin rotation, fixed-axis roll, pitch, yaw [rad].
        axis: Unit axis in the joint frame.
        lower, upper: Limits [rad or m]; infinite if the file has none.
        unstated: Whether its `<limit>` states no range: both limits are missing or 0. (Programs write 0 to 0 if they do
            not know the limits.)
        mimic: Name of the joint it follows, multiplier and offset, or None.
        tag_span: Bytes of the joint's start tag; None if the joint comes from an XML entity.
        origin_span: Bytes of the `<origin>` tag, or None if the file has none.
    """

    name: str
    type: str
    parent: str
    child: str
    xyz: Triple = (0.0, 0.0, 0.0)
    rpy: Triple = (0.0, 0.0, 0.0)
    axis: Triple = (1.0, 0.0, 0.0)
    lower: float = -math.inf
    upper: float = math.inf
    mimic: tuple[str, float, float] | None = None
    tag_span: Span | None = None
    origin_span: Span | None = None
    unstated: bool = False

    @property
    def moves(self) -> bool:
        """Whether the joint moves: its type allows it, and it mimics another joint or has a range."""
        if self.type in HELD_TYPES:
            return False
        return self.mimic is not None or not self.unstated


class UrdfReader:
    """Collects the content of a `UrdfText` as expat walks through it; `UrdfError` if it is not a URDF, or no tree."""

    def __init__(self, source: bytes, path: str) -> None:
        self.source, self.path = source, path
        self.name, self.root_span, self.end = "", (0, 0), 0
        self.links: list[str] = []
        self.joints: list[UrdfJoint] = []
        self._stack: list[str] = []
        self._joint: dict[str, object] = {}
        self._seen: dict[str, dict[str, str]] = {}
        self._parser = xml.parsers.expat.ParserCreate()
        self._parser.StartElementHandler = self._start
        self._parser.EndElementHandler = self._end
        self._parser.EntityDeclHandler = self._entity
        self._parse()
        _check_tree(path, self.links, self.joints)

    def _parse(self) -> None:
        if self.source.startswith((b"\xff\xfe", b"\xfe\xff")) or b"\x00" in self.source[:64]:
            raise UrdfError(f"{self.path}: UTF-16 or binary, not a text URDF; save it as UTF-8")
        try:
            self._parser.Parse(self.source, True)
        except xml.parsers.expat.ExpatError as error:
            message = xml.parsers.expat.errors.messages[error.code]
            hint = next((hint for words, hint in _XML_HINTS.items() if words in message), "")
            raise UrdfError(
                f"{self.path}, line {error.lineno}: not valid XML ({message}){hint};"
                " a robot is a URDF, a YAML description or a result folder"
            ) from None
        except (LookupError, ValueError) as error:
            raise UrdfError(f"{self.path}: its character encoding cannot be read ({error}); save it as UTF-8") from None

    def _span(self) -> Span | None:
        """Bytes of the present tag; None if it comes from an XML entity."""
        match = _TAG.match(self.source, self._parser.CurrentByteIndex)
        return match.span() if match else None

    def _error(self, text: str) -> UrdfError:
        return UrdfError(f"{self.path}, line {self._parser.CurrentLineNumber}: {text}")

    def _entity(self, name: str, _parameter: bool, value: str | None, *_where: str | None) -> None:
        if value is None:
            raise self._error(
                f"entity '{name}' stands for another file, which is not read; put its content here (xmllint --noent)"
            )

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        depth = len(self._stack)
        if depth == 0:
            if tag != "robot":
                raise UrdfError(
                    f"{self.path}: the top element is <{tag}>, not that of a robot: <robot>, <mujoco> or <sdf>; if it"
                    " is part of a robot, give the file that includes it"
                )
            self.name = attributes.get("name", "")
            self.root_span = self._span() or (0, 0)
        elif depth == 1 and tag == "link":
            self.links.append(self._require(attributes, "name", "<link>"))
        elif depth == 1 and tag == "joint":
            self._start_joint(attributes)
        elif depth == 2 and self._joint:
            self._joint_child(tag, attributes)
        elif depth >= 2 and self._stack[1] == "link" and tag in _SHAPES:
            self._check_finite(tag, attributes)
        self._stack.append(tag)

    def _check_finite(self, tag: str, attributes: dict[str, str]) -> None:
        """Refuse shapes and masses with numbers that no program can use."""
        for key, text in attributes.items():
            for part in () if key in _NO_NUMBERS else text.split():
                try:
                    finite = abs(float(part)) < _LARGEST or key.startswith(("i", "value"))
                except ValueError:
                    continue  # a xacro leftover, for instance, which stays in the file
                if not finite or not math.isfinite(float(part)):
                    wrong = f"<{tag}> of link '{self.links[-1]}' has {key}=\"{text}\""
                    raise self._error(f"{wrong}; every number must be finite, and none beyond 1e9 m: correct it")

    def _start_joint(self, attributes: dict[str, str]) -> None:
        name = self._require(attributes, "name", "<joint>")
        kind = self._require(attributes, "type", f"joint '{name}'")
        require_known(kind, MOVING_TYPES + HELD_TYPES, f"{self.path}, joint '{name}': unknown type", UrdfError)
        self._seen = {}
        self._joint = {"name": name, "type": kind, "tag_span": self._span()}

    def _joint_child(self, tag: str, attributes: dict[str, str]) -> None:
        joint = self._joint
        where = f"joint '{joint['name']}'"
        if tag not in ("parent", "child", "origin", "axis", "limit", "mimic"):
            return
        if tag in self._seen and (tag == "origin" or self._seen[tag] != attributes):
            raise self._error(f"{where} has two <{tag}>; keep one")
        self._seen[tag] = attributes
        if tag in ("parent", "child"):
            joint[tag] = self._require(attributes, "link", f"<{tag}> of {where}")
        elif tag == "origin":
            unread = next((key for key in attributes if key not in ("xyz", "rpy") and ":" not in key), None)
            if unread is not None:
                raise self._error(f"<origin> of {where} has '{unread}', which is not read; write it as xyz and rpy")
            joint["origin_span"] = self._span()
            joint["xyz"] = self._triple(attributes.get("xyz", "0 0 0"), f"{where}, xyz")
            joint["rpy"] = self._triple(attributes.get("rpy", "0 0 0"), f"{where}, rpy")
            if joint["origin_span"] is None:  # inside an entity, which has no place in the file
                joint["tag_span"] = None
        elif tag == "axis":
            joint["axis"] = self._axis(attributes, where, joint["type"] in MOVING_TYPES)
        elif tag == "limit" and joint["type"] != "continuous":
            lower = self._number(attributes.get("lower", "0"), f"{where}, lower limit")
            upper = self._number(attributes.get("upper", "0"), f"{where}, upper limit")
            if lower > upper:
                high = f"the lower limit {lower:g} is above the upper one {upper:g}"
                raise UrdfError(f"{self.path}, {where}: {high}; correct the <limit>")
            joint["lower"] = -math.inf if lower < -_LARGEST else lower  # programs write such numbers for "none"
            joint["upper"] = math.inf if upper > _LARGEST else upper
            if lower == upper == 0.0 and joint["type"] in MOVING_TYPES:
                joint |= {"lower": -math.inf, "upper": math.inf, "unstated": True}
        elif tag == "mimic":
            joint["mimic"] = (
                self._require(attributes, "joint", f"<mimic> of {where}"),
                self._bounded_number(attributes.get("multiplier", "1"), f"{where}, mimic multiplier"),
                self._bounded_number(attributes.get("offset", "0"), f"{where}, mimic offset"),
            )

    def _axis(self, attributes: dict[str, str], where: str, moving: bool) -> Triple:
        x, y, z = self._triple(attributes.get("xyz", "1 0 0"), f"{where}, axis")
        length = math.sqrt(x * x + y * y + z * z)
        if length < 1e-6:
            if moving:
                raise UrdfError(f"{self.path}, {where}: the axis has no direction")
            return (1.0, 0.0, 0.0)
        return (x / length, y / length, z / length)

    def _end(self, tag: str) -> None:
        self._stack.pop()
        if not self._stack:
            self.end = self._parser.CurrentByteIndex
        if tag == "joint" and len(self._stack) == 1 and self._joint:
            for side in ("parent", "child"):
                if side not in self._joint:
                    raise UrdfError(f"{self.path}, joint '{self._joint['name']}': has no <{side}>")
            self.joints.append(UrdfJoint(**self._joint))  # type: ignore[arg-type]
            self._joint = {}

    def _require(self, attributes: dict[str, str], key: str, where: str) -> str:
        if not attributes.get(key):
            raise self._error(f"{where} has no '{key}'")
        if key == "name" and (problem := unseen(attributes[key])):  # other texts must be known ones
            raise self._error(problem)
        return attributes[key]

    def _number(self, text: str, where: str) -> float:
        if "$" in text:
            raise UrdfError(f"{self.path}, {where}: '{text}' is a xacro expression; run xacro on the file first")
        if not NUMBER.fullmatch(text.strip(_SPACE)):
            raise UrdfError(f"{self.path}, {where}: '{text}' is not a number")
        value = float(text)
        if not math.isfinite(value):
            raise UrdfError(f"{self.path}, {where}: '{text}' is not finite")
        return value

    def _triple(self, text: str, where: str) -> Triple:
        parts = [text] if "$" in text else re.split(f"[{_SPACE}]+", text.strip(_SPACE))
        numbers = tuple(self._bounded_number(part, where) for part in parts)
        if len(numbers) != 3:
            raise UrdfError(f"{self.path}, {where}: '{text}' is not three numbers separated by spaces")
        return numbers

    def _bounded_number(self, text: str, where: str) -> float:
        value = self._number(text, where)
        if abs(value) > _LARGEST:
            raise UrdfError(f"{self.path}, {where}: '{text}' is beyond 1e9, more than any robot needs; correct it")
        return value


def _check_tree(path: str, links: list[str], joints: list[UrdfJoint]) -> None:
    """Raise `UrdfError` unless links and joints have unique names and form exactly one tree."""
    if len(links) > MOST_LINKS:
        raise UrdfError(f"{path}: has {len(links)} links, more than {MOST_LINKS}; cut the file down to the arm")
    if not links:
        raise UrdfError(f"{path}: has no links; if it is part of a robot (macros), give the file that includes it")
    for kind, given in (("link", links), ("joint", [joint.name for joint in joints])):
        repeated = [name for name, count in Counter(given).items() if count > 1]
        if repeated:
            raise UrdfError(f"{path}: {kind} '{repeated[0]}' is defined twice; names must be unique")
    names = {joint.name for joint in joints}
    parent_of: dict[str, UrdfJoint] = {}
    for joint in joints:
        for side in (joint.parent, joint.child):
            require_known(side, links, f"{path}, joint '{joint.name}': no link", UrdfError)
        if joint.child in parent_of:
            raise UrdfError(
                f"{path}: link '{joint.child}' is the child of joints '{parent_of[joint.child].name}'"
                f" and '{joint.name}'; cut the loop and name it as closed_loop in the robot description"
            )
        parent_of[joint.child] = joint
        if joint.mimic:
            require_known(joint.mimic[0], names, f"{path}, joint '{joint.name}': mimics no joint", UrdfError)
    roots = [link for link in links if link not in parent_of]
    if len(roots) != 1:
        fault = "joints form a ring, no root link" if not roots else f"several root links: {', '.join(roots[:5])}"
        raise UrdfError(f"{path}: {fault}; a URDF is one tree")
    reached = {roots[0], *(joint.child for joint in from_root(roots[0], joints))}
    lost = next((link for link in links if link not in reached), None)
    if lost is not None:
        raise UrdfError(f"{path}: link '{lost}' is its own ancestor; a URDF is one tree")


def from_root(root: str, joints: Sequence[UrdfJoint]) -> list[UrdfJoint]:
    """Return joints that the root link carries, parents first, otherwise in file order."""
    order, waiting = list[UrdfJoint](), [root]
    while waiting:
        link = waiting.pop(0)
        carried = [joint for joint in joints if joint.parent == link]
        order += carried
        waiting = [joint.child for joint in carried] + waiting
    return order
