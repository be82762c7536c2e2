"""What files in every language have alike: what they say of a robot, and where their constant code lies."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from calib.functions.facts import RobotFacts
from calib.joint_terms.formula import Source
from calib.joint_terms.term import REFERENCE_TEMPERATURE

NEUTRAL = {"approach": 0.0, "time": 0.0, "temperature": REFERENCE_TEMPERATURE, "load": 0.0}
"""What each condition is where nothing is said of it."""
MEANING = {
    "approach": "direction in which each joint moved last, +1 or -1, 0 where not known, (..., n_joints)",
    "time": "as the measurements counted it [s], (...)",
    "temperature": "[degC], (...)",
    "load": "mass at the tool, beside what the URDF has [kg], (...)",
}
"""What each condition is."""
SOURCES = {
    Source.ONE: "one",
    Source.COMMAND: "command",
    Source.APPROACH: "approach",
    Source.TIME: "time",
    Source.WARMTH: "temperature",
    Source.TORQUE: "torque",
}
"""What joint errors are proportional to, as the code names it."""


def template(name: str) -> str:
    """Return code that is the same for every robot."""
    return (Path(__file__).parent / f"{name}.txt").read_text(encoding="utf-8")


def said(facts: RobotFacts, lines: Sequence[str], base: str) -> list[str]:
    """Return what a file says of a robot, line by line.

    Args:
        facts: Of the robot.
        lines: Where the numbers come from.
        base: What the file calls the pose of the measurement frame.
    """
    joints = ", ".join(f"{name} [{unit}]" for name, unit in zip(facts.joints, facts.units, strict=True))
    text = [f"The robot {facts.name}: poses of its tools from the commands of its joints.", "", *lines]
    text += ["", f"Commands: {joints}. All units are SI.", f"Tools: {', '.join(_numbered(facts.tools))}."]
    text.append("Poses are those of a tool in the measurement frame of the calibration, where that places the robot.")
    if facts.base is None:
        text.append("Joints move that frame.")
    else:
        text.append(f"{base} is the pose of that frame in the root link: it times a pose is the pose in the root link.")
    if facts.tree.closures:
        text.append("Where loops do not close, or not as they are assembled at home, the numbers are NaN.")
    return [" ".join(line.split()) for line in text]


def _numbered(names: Sequence[str]) -> list[str]:
    return [f"{k} {name}" for k, name in enumerate(names)]
