"""The URDF as text: new joint origins are written into the file, and nothing else changes.

A URDF writer would reorder elements, drop unknown ones and round numbers again. Here the file is kept as bytes, and an
edit replaces only the changed numbers, inside the `xyz` or `rpy` attribute of a joint's `<origin>`. Everything else
keeps its bytes: comments, order, spelling of numbers, line ends, encoding.

Angles of an edited rotation come from Pinocchio's `matrixToRpy`, which is exact to 1e-15 even near pitch = +-90
degrees, and are written as the shortest decimals that read back to the same numbers. Every edited file is read back,
and must then have the requested origins.
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import DescriptionError, UrdfError, require_known
from calib.core.base.files import read_bytes
from calib.core.base.registry import list_entry_points, load_named
from calib.core.robots.urdf.reader import NUMBER, UNSUPPORTED_TYPES, Span, Triple, UrdfJoint, UrdfReader, from_root
from calib.core.robots.urdf.writing import number_attribute, shortest

_ATTRIBUTE = re.compile(rb"""([^\s=<>/'"]+)\s*=\s*("[^"]*"|'[^']*')""")
_BLANK = re.compile(rb"[ \t\r\n]*")
Edit = tuple[int, int, bytes]


@dataclass(frozen=True)
class ForeignLoop:
    """Two links that coincide.

    Attributes:
        links: Their names.
        kind: `3d`: their points; `6d`: their whole frames.
        axes: Directions that the loop holds, in the frame of the first.
    """

    links: tuple[str, str]
    kind: str
    axes: tuple[str, ...]


@dataclass(frozen=True)
class ForeignRobot:
    """Content of a file of another format beside its URDF.

    Attributes:
        motors: Joints with an actuator, in the order of the actuators.
        loops: Loops, cut open in the URDF.
        springs: Joints with a spring and no actuator.
        home: Value of each joint in the file [m or rad].
        remarks: Features that the URDF does not have.
    """

    motors: tuple[str, ...] = ()
    loops: tuple[ForeignLoop, ...] = ()
    springs: tuple[str, ...] = ()
    home: dict[str, float] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True)
class UrdfText:
    """A URDF file as bytes, with what was read from it.

    Attributes:
        source: The file's bytes.
        path: Its file, for messages.
        name: The robot's name.
        links, joints: In file order.
        root_span: Bytes of the `<robot>` start tag.
        end: Byte at which `</robot>` starts.
        foreign: Motors and loops of a file of another format.
    """

    source: bytes
    path: str
    name: str
    links: tuple[str, ...]
    joints: tuple[UrdfJoint, ...]
    root_span: Span
    end: int
    foreign: ForeignRobot = field(default_factory=ForeignRobot)

    @property
    def root(self) -> str:
        """The link that is no joint's child."""
        children = {joint.child for joint in self.joints}
        return next(link for link in self.links if link not in children)

    @property
    def joints_from_root(self) -> list[UrdfJoint]:
        """Joints with parents first, otherwise in file order."""
        return from_root(self.root, self.joints)

    def limits(self, names: Sequence[str]) -> tuple[FloatArray, FloatArray]:
        """Return lower and upper limits, (n,) each [m or rad]; infinite if the URDF has none."""
        known = {joint.name: (joint.lower, joint.upper) for joint in self.joints}
        lower, upper = np.array([known.get(name, (-math.inf, math.inf)) for name in names]).reshape(-1, 2).T
        return lower, upper

    def with_origins(self, origins: Mapping[str, tuple[Triple, Triple]]) -> bytes:
        """Return the file with the `xyz` [m] and `rpy` [rad] of the named joints' origins replaced.

        Numbers that do not change keep their spelling; a missing `<origin>` or attribute is added only if needed.
        `UrdfError` for an unknown joint, a number that is not finite, or an origin that the file cannot hold.
        """
        edits, joints = list[Edit](), {joint.name: joint for joint in self.joints}
        for unknown in origins.keys() - joints.keys():
            require_known(unknown, joints, f"{self.path}: no joint", UrdfError)
        for name, origin in origins.items():
            edits += self._origin_edits(joints[name], *origin)
        if not edits:
            return self.source
        result = apply_edits(self.source, edits)
        self._check_written(result, origins)
        return result

    def _origin_edits(self, joint: UrdfJoint, xyz: Triple, rpy: Triple) -> list[Edit]:
        changes = {key: new for key, old, new in (("xyz", joint.xyz, xyz), ("rpy", joint.rpy, rpy)) if new != old}
        if not changes:
            return []
        if joint.tag_span is None:
            raise UrdfError(
                f"{self.path}, joint '{joint.name}': comes from an XML entity, so that its origin cannot be"
                " written; expand the entities first (xmllint --noent)"
            )
        if joint.origin_span is None:
            end = joint.tag_span[1]
            blank = _BLANK.match(self.source, end)  # the following line end and indent
            attributes = " ".join(f'{key}="{number_attribute(value)}"' for key, value in changes.items())
            return [(end, end, (blank.group() if blank else b"") + f"<origin {attributes}/>".encode())]
        return _attribute_edits(self.source, joint.origin_span, changes)

    def _check_written(self, result: bytes, origins: Mapping[str, tuple[Triple, Triple]]) -> None:
        written = {joint.name: (joint.xyz, joint.rpy) for joint in parse_urdf(result, self.path).joints}
        for joint in self.joints:
            if written[joint.name] != origins.get(joint.name, (joint.xyz, joint.rpy)):
                raise UrdfError(
                    f"{self.path}, joint '{joint.name}': its <origin> is spelled in a way that cannot be"
                    ' edited; write it as <origin xyz="x y z" rpy="r p y"/>'
                )


def read_urdf(path: Path | str, arguments: Mapping[str, str] | None = None) -> UrdfText:
    """Read and check a URDF file, or a file of another format, such as a calibration of Universal Robots (YAML).

    Entry points of the group `calib.robot_readers` turn other formats into a URDF. Each is named by the file's ending,
    such as `xacro`, or by the outermost element of its XML, such as `sdf`: a function of path, content and arguments
    that returns a URDF and a `ForeignRobot`, or None. Endings decide for xacro, YAML, and files that are no XML.

    Args:
        arguments: Arguments of a xacro file, by name.

    Raises:
        UrdfError: The file is missing or unreadable, is not XML, or its joints do not form one tree; or it is a file of
            another format that cannot be turned into a URDF.
    """
    source, ending = read_bytes(path, "the path of a URDF", UrdfError), Path(path).suffix.lower()
    if arguments and ending != ".xacro":
        raise UrdfError(f"{path}: is no xacro file, and takes no arguments; leave out {', '.join(arguments)}")
    kind = {".xacro": "xacro", ".yaml": "yaml", ".yml": "yaml"}.get(ending) or _outermost(source) or ending[1:]
    for entry in list_entry_points("calib.robot_readers") if kind not in ("robot", "") else ():
        if entry.name == kind:
            urdf, foreign = load_named(entry, "reader of robots")(str(path), source, arguments or {})
            return replace(parse_urdf(urdf, str(path)), foreign=foreign or ForeignRobot())
    return parse_urdf(source, str(path))


def is_ur_kinematics(content: object) -> bool:
    """Return whether the content of a YAML file is a calibration of Universal Robots, no robot description."""
    return isinstance(content, dict) and isinstance(content.get("kinematics"), dict) and "urdf" not in content


def _outermost(source: bytes) -> str:
    """The tag of a file's outermost element, such as `mujoco` of MJCF or `sdf`; empty if it is no XML."""
    try:
        return next(ElementTree.iterparse(io.BytesIO(source), events=("start",)))[1].tag
    except (ElementTree.ParseError, StopIteration):
        return ""


def require_supported(joints: Iterable[UrdfJoint], where: str) -> None:
    """Raise `DescriptionError` if a joint is floating or planar: no joint value states its motion."""
    for joint in joints:
        if joint.type in UNSUPPORTED_TYPES:
            raise DescriptionError(
                f"{where}: joint '{joint.name}' is {joint.type}; planar and floating joints are not supported: make it"
                " of prismatic and revolute joints, or fixed if it stands still while the robot is measured"
            )


def parse_urdf(source: bytes, path: str = "<urdf>") -> UrdfText:
    """Parse URDF bytes; see `read_urdf`."""
    reader = UrdfReader(source, path)
    return UrdfText(source, path, reader.name, tuple(reader.links), tuple(reader.joints), reader.root_span, reader.end)


def apply_edits(source: bytes, edits: list[Edit]) -> bytes:
    """Replace byte ranges (start, end, replacement); all positions are those of `source`."""
    for start, end, text in sorted(edits, reverse=True):
        source = source[:start] + text + source[end:]
    return source


def _attribute_edits(source: bytes, span: Span, changes: Mapping[str, Triple]) -> list[Edit]:
    """Edits that set new numbers in the named attributes of the tag at `span`."""
    start, end = span
    tag = source[start:end]
    attributes = {match.group(1): match for match in _ATTRIBUTE.finditer(tag)}
    edits = []
    for key, value in changes.items():
        if key.encode() in attributes:
            first, last = attributes[key.encode()].span(2)
            old = tag[first + 1 : last - 1]
            edits.append((start + first + 1, start + last - 1, _respell(old, value)))
        else:
            at = start + len(b"<origin")
            edits.append((at, at, f' {key}="{number_attribute(value)}"'.encode()))
    return edits


def _respell(old: bytes, values: Triple) -> bytes:
    """Replace the changed numbers in `old`, and keep the spelling of the others."""
    text = old.decode("ascii", errors="replace")
    numbers = list(NUMBER.finditer(text))
    if len(numbers) != 3 or "&" in text:  # character references: write plain numbers
        return number_attribute(values).encode()
    for match, value in reversed(list(zip(numbers, values, strict=True))):
        if float(match.group()) != value:
            text = text[: match.start()] + shortest(value) + text[match.end() :]
    return text.encode("ascii")
