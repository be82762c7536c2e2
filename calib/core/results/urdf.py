"""The URDF of a robot's current values, optionally with a comment on their origin.

Everything but the edited origin values keeps its bytes. An export of an export is identical: where nothing is edited,
the file stays as it was, and a comment of an earlier export is replaced, never repeated.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence

from calib.core.base.letters import visible
from calib.core.base.version import PROGRAM
from calib.core.robots.robot import Robot
from calib.core.robots.robot_files import urdf_of_origins
from calib.core.robots.urdf.text import UrdfText, apply_edits, parse_urdf

_MARK = "calib: calibrated origins"
_ROUNDING = 1e-9
"""A parameter is not shown if its change is at most this in its unit [mm, deg]: 1e-3 nm or 2e-11 rad."""
_EARLIER = re.compile(rb"\r?\n?<!-- " + _MARK.encode() + rb".*?-->", re.DOTALL)


def urdf_bytes(robot: Robot, provenance: Sequence[str] | None = None) -> bytes:
    """Return the URDF with the origins of the robot's values.

    `provenance`: lines of a comment behind the `<robot>` tag, which also names the nominal file and every parameter
    that differs from nominal; None for no comment.
    """
    edited = urdf_of_origins(robot)
    if provenance is None or edited == robot.urdf.source:
        return edited
    lines = [_MARK, *provenance, *provenance_lines(robot)]
    cleaned = _EARLIER.sub(b"", edited)
    urdf = parse_urdf(cleaned, robot.urdf.path)
    return with_inserted(urdf, "\n" + comment(lines), at=urdf.root_span[1])


def source_lines(robot: Robot) -> list[str]:
    """Return the origin of a file: program, and nominal file with its checksum."""
    digest = hashlib.sha256(robot.urdf.source).hexdigest()
    hashed = "the URDF that it was read as" if robot.urdf.path.endswith((".xacro", ".xml")) else "that file"
    return [f"written by {PROGRAM} from {robot.urdf.path}", f"sha256 of {hashed}: {digest}"]


def provenance_lines(robot: Robot) -> list[str]:
    """Return the origin of a file, and every value in it that was changed by more than rounding."""
    lines, changed = source_lines(robot), []
    places = {robot.mechanism.origin(place) for place in robot.mechanism.places}
    own = [p.name.rpartition(".")[0] not in places for p in robot.parameters]  # a URDF has no instrument and no target
    for parameter, value, held in zip(robot.parameters, robot.values, own, strict=True):
        shown = float(value) * parameter.per_si
        if held and abs(shown - parameter.nominal) > _ROUNDING:
            changed.append(f"  {parameter.name}: {parameter.nominal:.9g} -> {shown:.9g} {parameter.unit}")
    if not changed:
        return [*lines, "parameters: nominal"]
    return [*lines, f"parameters that differ from nominal ({len(changed)} of {sum(own)}):", *changed]


def with_inserted(urdf: UrdfText, text: str, at: int) -> bytes:
    """Return the file with text inserted at a byte, in ASCII, with the file's line ends."""
    line_end = b"\r\n" if b"\r\n" in urdf.source else b"\n"
    return apply_edits(urdf.source, [(at, at, text.encode("ascii", "xmlcharrefreplace").replace(b"\n", line_end))])


def comment(lines: Sequence[str]) -> str:
    """Return an XML comment, one line each; ASCII, so that it fits every encoding."""
    text = "\n".join(lines).encode("ascii", "backslashreplace").decode()
    return "<!-- " + re.sub(r"-(?=-|$)", "- ", visible(text)) + "\n-->"
