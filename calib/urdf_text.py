"""The URDF as text: read the joints, and write new joint origins back touching nothing else.

A URDF writer would reorder elements, drop what it does not know and round numbers again. Here the file is kept
as bytes. The XML parser (expat) reports the byte offset of every tag; an edit replaces only the numbers that
changed, inside the `xyz` or `rpy` attribute of the joint's `<origin>`. Where nothing changes the bytes are identical.

Angles of an edited rotation are recovered with Pinocchio's `matrixToRpy`, which is exact to 1e-15 also near
pitch = +-90 degrees, and written as the shortest decimal that reads back to the same number.
"""

from __future__ import annotations

import math
import re
import xml.parsers.expat
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from calib.errors import UrdfError

Triple = tuple[float, float, float]
MOVING_TYPES = ("revolute", "continuous", "prismatic")
HELD_TYPES = ("fixed", "floating", "planar")
_ATTRIBUTE = re.compile(rb"""([^\s=<>/'"]+)\s*=\s*("[^"]*"|'[^']*')""")
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")


@dataclass(frozen=True)
class UrdfJoint:
    """One `<joint>` of the file.

    Attributes:
        name, type, parent, child: As in the file.
        xyz: Origin translation, parent link to joint [m].
        rpy: Origin rotation, fixed-axis roll, pitch, yaw [rad].
        axis: Unit axis in the joint frame.
        lower, upper: Limits [rad or m]; infinite where the file gives none.
        mimic: Name of the joint it follows, multiplier and offset, or None.
        tag_span: Bytes of the joint's start tag.
        origin_span: Bytes of the `<origin>` tag, or None where the file has none.
    """

    name: str
    type: str
    parent: str
    child: str
    xyz: Triple
    rpy: Triple
    axis: Triple
    lower: float
    upper: float
    mimic: tuple[str, float, float] | None
    tag_span: tuple[int, int]
    origin_span: tuple[int, int] | None


@dataclass(frozen=True)
class UrdfText:
    """A URDF file as bytes, with what was read from it.

    Attributes:
        source: The file's bytes.
        path: Where it came from, for messages.
        name: The robot's name.
        links: Link names in file order.
        joints: Joints in file order.
    """

    source: bytes
    path: str
    name: str
    links: tuple[str, ...]
    joints: tuple[UrdfJoint, ...]

    def with_origins(self, origins: Mapping[str, tuple[Triple, Triple]]) -> bytes:
        """Return the file with the `xyz` [m] and `rpy` [rad] of the named joints' origins replaced.

        Numbers that do not change keep their spelling; a missing `<origin>` or attribute is added only if needed.
        """
        by_name = {joint.name: joint for joint in self.joints}
        edits: list[tuple[int, int, bytes]] = []
        for name, (xyz, rpy) in origins.items():
            edits.extend(_origin_edits(self.source, by_name[name], xyz, rpy))
        result = self.source
        for start, end, text in sorted(edits, reverse=True):
            result = result[:start] + text + result[end:]
        return result


def read_urdf(path: Path | str) -> UrdfText:
    """Read and check a URDF file.

    Raises:
        UrdfError: The file is missing or unreadable, is not XML, or its joints do not form one tree.
    """
    try:
        source = Path(path).read_bytes()
    except FileNotFoundError:
        raise UrdfError(f"{path}: no such file; give the path of a URDF") from None
    except OSError as error:
        raise UrdfError(f"{path}: cannot be read ({error.strerror})") from None
    return parse_urdf(source, str(path))


def parse_urdf(source: bytes, path: str = "<urdf>") -> UrdfText:
    """Parse URDF bytes; see `read_urdf`."""
    if source.startswith((b"\xff\xfe", b"\xfe\xff")) or b"\x00" in source[:64]:
        raise UrdfError(f"{path}: UTF-16 or binary, not a text URDF; save it as UTF-8")
    reader = _Reader(source, path)
    reader.run()
    text = UrdfText(source, path, reader.name, tuple(reader.links), tuple(reader.joints))
    _check_tree(text)
    return text


class _Reader:
    """Collects links and joints while expat walks through the file."""

    def __init__(self, source: bytes, path: str) -> None:
        self.source, self.path = source, path
        self.name = ""
        self.links: list[str] = []
        self.joints: list[UrdfJoint] = []
        self._stack: list[str] = []
        self._joint: dict[str, object] = {}

    def run(self) -> None:
        parser = xml.parsers.expat.ParserCreate()
        parser.StartElementHandler = lambda tag, attributes: self._start(parser, tag, attributes)
        parser.EndElementHandler = lambda tag: self._end(tag)
        try:
            parser.Parse(self.source, True)
        except xml.parsers.expat.ExpatError as error:
            message = xml.parsers.expat.errors.messages[error.code]
            raise UrdfError(f"{self.path}, line {error.lineno}: not valid XML ({message})") from None

    def _span(self, parser: xml.parsers.expat.XMLParserType) -> tuple[int, int]:
        start = parser.CurrentByteIndex
        quote = 0
        for index in range(start, len(self.source)):
            byte = self.source[index]
            if quote:
                quote = 0 if byte == quote else quote
            elif byte in b"\"'":
                quote = byte
            elif byte == ord(">"):
                return start, index + 1
        raise UrdfError(f"{self.path}: tag at byte {start} does not end")

    def _start(self, parser: xml.parsers.expat.XMLParserType, tag: str, attributes: dict[str, str]) -> None:
        depth = len(self._stack)
        if depth == 0:
            if tag != "robot":
                raise UrdfError(f"{self.path}: the top element is <{tag}>, not <robot>; is this a URDF"
                                " (run xacro first if it is a xacro file)?")
            self.name = attributes.get("name", "")
        elif depth == 1 and tag == "link":
            self.links.append(self._required(attributes, "name", "<link>", parser))
        elif depth == 1 and tag == "joint":
            name = self._required(attributes, "name", "<joint>", parser)
            kind = self._required(attributes, "type", f"joint '{name}'", parser)
            if kind not in MOVING_TYPES + HELD_TYPES:
                raise UrdfError(f"{self.path}, joint '{name}': unknown type '{kind}';"
                                f" valid: {', '.join(MOVING_TYPES + HELD_TYPES)}")
            self._joint = {"name": name, "type": kind, "tag_span": self._span(parser), "origin_span": None,
                           "xyz": (0.0, 0.0, 0.0), "rpy": (0.0, 0.0, 0.0), "axis": (1.0, 0.0, 0.0),
                           "lower": -math.inf, "upper": math.inf, "mimic": None}
        elif depth == 2 and self._joint:
            self._joint_child(parser, tag, attributes)
        self._stack.append(tag)

    def _joint_child(self, parser: xml.parsers.expat.XMLParserType, tag: str, attributes: dict[str, str]) -> None:
        joint = self._joint
        where = f"joint '{joint['name']}'"
        if tag in ("parent", "child"):
            joint[tag] = self._required(attributes, "link", f"<{tag}> of {where}", parser)
        elif tag == "origin":
            joint["origin_span"] = self._span(parser)
            joint["xyz"] = self._triple(attributes.get("xyz", "0 0 0"), f"{where}, xyz")
            joint["rpy"] = self._triple(attributes.get("rpy", "0 0 0"), f"{where}, rpy")
        elif tag == "axis":
            axis = self._triple(attributes.get("xyz", "1 0 0"), f"{where}, axis")
            length = math.sqrt(sum(value * value for value in axis))
            if length < 1e-6 and joint["type"] in MOVING_TYPES:
                raise UrdfError(f"{self.path}, {where}: the axis has no direction")
            joint["axis"] = tuple(value / length for value in axis) if length > 0 else (1.0, 0.0, 0.0)
        elif tag == "limit" and joint["type"] != "continuous":
            joint["lower"] = self._number(attributes.get("lower", "0"), f"{where}, lower limit")
            joint["upper"] = self._number(attributes.get("upper", "0"), f"{where}, upper limit")
        elif tag == "mimic":
            joint["mimic"] = (self._required(attributes, "joint", f"<mimic> of {where}", parser),
                              self._number(attributes.get("multiplier", "1"), f"{where}, mimic multiplier"),
                              self._number(attributes.get("offset", "0"), f"{where}, mimic offset"))

    def _end(self, tag: str) -> None:
        self._stack.pop()
        if tag == "joint" and len(self._stack) == 1 and self._joint:
            for side in ("parent", "child"):
                if side not in self._joint:
                    raise UrdfError(f"{self.path}, joint '{self._joint['name']}': has no <{side}>")
            self.joints.append(UrdfJoint(**self._joint))  # type: ignore[arg-type]
            self._joint = {}

    def _required(self, attributes: dict[str, str], key: str, where: str,
                  parser: xml.parsers.expat.XMLParserType) -> str:
        if key not in attributes:
            raise UrdfError(f"{self.path}, line {parser.CurrentLineNumber}: {where} has no '{key}'")
        return attributes[key]

    def _number(self, text: str, where: str) -> float:
        try:
            value = float(text)
        except ValueError:
            raise UrdfError(f"{self.path}, {where}: '{text}' is not a number") from None
        if not math.isfinite(value):
            raise UrdfError(f"{self.path}, {where}: '{text}' is not finite")
        return value

    def _triple(self, text: str, where: str) -> Triple:
        parts = text.split()
        if len(parts) != 3:
            raise UrdfError(f"{self.path}, {where}: '{text}' is not three numbers separated by spaces")
        x, y, z = (self._number(part, where) for part in parts)
        return (x, y, z)


def _check_tree(text: UrdfText) -> None:
    """Raise unless links and joints have unique names and form exactly one tree."""
    where = text.path
    if not text.links:
        raise UrdfError(f"{where}: has no links; is this a URDF?")
    for kind, names in (("link", text.links), ("joint", tuple(joint.name for joint in text.joints))):
        repeated = sorted({name for name in names if names.count(name) > 1})
        if repeated:
            raise UrdfError(f"{where}: {kind} '{repeated[0]}' is defined twice; names must be unique")
    parent_of: dict[str, UrdfJoint] = {}
    for joint in text.joints:
        for side in (joint.parent, joint.child):
            if side not in text.links:
                raise UrdfError(f"{where}, joint '{joint.name}': link '{side}' does not exist")
        if joint.child in parent_of:
            raise UrdfError(f"{where}: link '{joint.child}' is the child of joints '{parent_of[joint.child].name}'"
                            f" and '{joint.name}'; cut the loop and name it as closed_loop in the robot description")
        parent_of[joint.child] = joint
    roots = [link for link in text.links if link not in parent_of]
    if len(roots) != 1:
        what = "joints form a ring, no root link" if not roots else f"several root links: {', '.join(roots[:5])}"
        raise UrdfError(f"{where}: {what}; a URDF is one tree")
    for link in text.links:
        seen = {link}
        while link in parent_of:
            link = parent_of[link].parent
            if link in seen:
                raise UrdfError(f"{where}: link '{link}' is its own ancestor; a URDF is one tree")
            seen.add(link)
    for joint in text.joints:
        if joint.mimic and joint.mimic[0] not in {other.name for other in text.joints}:
            raise UrdfError(f"{where}, joint '{joint.name}': mimics '{joint.mimic[0]}', which does not exist")


def _origin_edits(source: bytes, joint: UrdfJoint, xyz: Triple, rpy: Triple) -> list[tuple[int, int, bytes]]:
    """Return (start, end, replacement) byte edits that give `joint` this origin."""
    changes = {key: new for key, old, new in (("xyz", joint.xyz, xyz), ("rpy", joint.rpy, rpy)) if new != old}
    if not changes:
        return []
    if joint.origin_span is None:
        attributes = " ".join(f'{key}="{_spell(value)}"' for key, value in changes.items())
        end = joint.tag_span[1]
        return [(end, end, f"<origin {attributes}/>".encode())]
    start, end = joint.origin_span
    tag = source[start:end]
    found = {match.group(1).decode(): match for match in _ATTRIBUTE.finditer(tag)}
    edits = []
    for key, value in changes.items():
        if key in found:
            first, last = found[key].span(2)
            old = tag[first + 1:last - 1].decode(errors="replace")
            edits.append((start + first + 1, start + last - 1, _respell(old, value).encode()))
        else:
            at = start + len(b"<origin")
            edits.append((at, at, f' {key}="{_spell(value)}"'.encode()))
    return edits


def _spell(values: Triple) -> str:
    return " ".join(_shortest(value) for value in values)


def _shortest(value: float) -> str:
    return repr(float(value)) if value != 0 else "0"


def _respell(old: str, values: Triple) -> str:
    """Replace the numbers in `old` that changed, keeping the others as they were spelled."""
    numbers = list(_NUMBER.finditer(old))
    if len(numbers) != 3 or "&" in old:  # spelled with character references: write it plainly
        return _spell(values)
    for match, value in reversed(list(zip(numbers, values, strict=True))):
        if float(match.group()) != value:
            old = old[:match.start()] + _shortest(value) + old[match.end():]
    return old
