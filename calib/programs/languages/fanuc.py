"""Targets of FANUC's teach pendant programs as text (`.ls`): the positions of `/POS` that lines of `/MN` go to.

Each position says its user frame (UF) and tool (UT); what these are, the controller knows, and a table of frames says
(`UFRAME[1]`, `UTOOL[1]`). Position registers, offsets, increments and further motion groups are computed at run time.
Numbers keep their three decimals and their columns.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin

from calib.core.base.errors import DataError
from calib.programs.languages.robot_program import (
    DEGREE,
    MILLIMETRE,
    NUMBER,
    Collector,
    Configuration,
    LeftOutError,
    Number,
    ProgramTarget,
    RobotProgram,
    Source,
    cells_at,
)

LANGUAGE, SUFFIXES = "FANUC LS", (".ls",)
_BLANK = r"(?m)^\s*\d+:\s*(?:!|//)[^\n]*"
_MOTION = re.compile(r"(?m)^\s*\d*:\s*([JLCAS])\s+([^;]*);")
_PLACE = re.compile(r"P\[\s*(\w+\[[^\]]*\]|[^\]:]+?)\s*(?::[^\]]*)?\]|PR\[[^\]]*\]")
_CHANGED = re.compile(r"\b(Tool_Offset|Offset|VOFFSET|TOOL_OFFSET|OFFSET|INC|LOCK\s+PREG|CV_TCP)\b", re.IGNORECASE)
_POSITION = re.compile(r"P\[\s*(\d+)\s*(?::[^\]]*)?\]\s*\{(.*?)\}\s*;", re.DOTALL)
_GROUP = re.compile(r"GP(\d+)\s*:")
_FIELD = re.compile(rf"\b([XYZWPR]|[JE]\d)(\s*=)(\s*)({NUMBER})\s*(mm|deg)\b")
_FRAME = re.compile(r"UF\s*:\s*(\w+)\s*,\s*UT\s*:\s*(\w+)")
_CONFIG = re.compile(r"CONFIG\s*:\s*'\s*([NF])\s*([UD])\s*([TB])\s*,\s*(-?\d+)\s*,\s*(-?\d+)\s*,\s*(-?\d+)\s*'")
_POSE, _JOINTS = ("X", "Y", "Z", "W", "P", "R"), ("J1", "J2", "J3", "J4", "J5", "J6")
_TURNING = (0, 3, 4, 5)


def read_fanuc(path: Path | str, frames: Mapping[str, pin.SE3 | str]) -> RobotProgram:
    """Read a program.

    Args:
        path: The file.
        frames: `UFRAME[1]`, `UTOOL[1]`, ...; those of number 0 are the robot's base and its flange.

    Raises:
        DataError: The message names file and line.
    """
    source = Source.read(path, "a FANUC program as text (LS)", _BLANK)
    positions = source.code.find("/POS")
    if positions < 0 or "/MN" not in source.code[:positions]:
        raise DataError(f"{path}: has no /MN and /POS sections; save the program as text (LS)")
    collector = Collector()
    declared = {match[1]: match for match in _POSITION.finditer(source.code, positions)}
    for motion in _MOTION.finditer(source.code, 0, positions):
        for place in _PLACE.finditer(source.code, motion.start(2), motion.end(2)):
            if source.code[motion.start(2) : place.start()].rstrip().endswith(","):
                continue  # of an offset
            try:
                collector.take(_target(source, place, motion[2], declared, frames), source, place.start())
            except LeftOutError as why:
                collector.leave(source, place.start(), source.shown(*place.span()), str(why))
    return collector.program(LANGUAGE, [source])


def _target(
    source: Source,
    place: re.Match[str],
    motion: str,
    declared: Mapping[str, re.Match[str]],
    frames: Mapping[str, pin.SE3 | str],
) -> ProgramTarget:
    """The target of a motion."""
    changed = _CHANGED.search(motion)
    if place[0].startswith("PR"):
        raise LeftOutError("is a position register; its numbers are not in the program")
    if not place[1].isdigit():
        raise LeftOutError("is computed at run time")
    if changed:
        raise LeftOutError(f"is computed at run time ({changed[0]})")
    position = declared.get(place[1])
    if position is None:
        raise DataError(f"{source.where(place.start())}: P[{place[1]}] is not in /POS; save the program again")
    groups = _GROUP.findall(position[2])
    if groups != ["1"]:
        raise LeftOutError("moves other motion groups, which the description does not have")
    fields = {match[1]: match for match in _FIELD.finditer(source.code, *position.span(2))}
    if any(float(match[4]) for name, match in fields.items() if name.startswith("E")):
        raise LeftOutError("moves external axes, which the description does not have")
    name, line = f"P[{place[1]}]", source.line(position.start())
    if set(_JOINTS) <= set(fields):
        return ProgramTarget(line, source.path, name, _cells(source, fields, _JOINTS), None)
    if not set(_POSE) <= set(fields):
        missing = next(key for key in _POSE if key not in fields)
        raise DataError(f"{source.where(position.start())}: {name} has no number for {missing}; correct it")
    which = _FRAME.search(position[2])
    if which is None:
        raise DataError(f"{source.where(position.start())}: {name} does not say UF and UT; save the program again")
    frame, tool = (
        _frame(kind, number, frames) for kind, number in zip(("UFRAME", "UTOOL"), which.groups(), strict=True)
    )
    configuration = _configuration(source, position)
    cells = _cells(source, fields, _POSE)
    return ProgramTarget(line, source.path, name, cells, "xyz", frame, tool, configuration)


def _cells(source: Source, fields: Mapping[str, re.Match[str]], names: tuple[str, ...]) -> tuple[Number, ...]:
    """Numbers with the blanks before them, which make room for a sign."""
    cells = cells_at(
        source,
        0,
        [fields[name].span(4) for name in names],
        [MILLIMETRE if fields[name][5] == "mm" else DEGREE for name in names],
    )
    return tuple(
        replace(
            cell,
            start=fields[name].start(3),
            width=len(fields[name][3]) + len(fields[name][4]),
            decimals=len(fields[name][4].partition(".")[2]),
        )
        for cell, name in zip(cells, names, strict=True)
    )


def _frame(kind: str, number: str, frames: Mapping[str, pin.SE3 | str]) -> pin.SE3:
    if number == "0":
        return pin.SE3.Identity()
    frame = frames.get(f"{kind}[{number}]")
    if frame is None:
        why = "is chosen at run time" if not number.isdigit() else f"is not known; give {kind}[{number}] with --frames"
        raise LeftOutError(f"its {'user frame' if kind == 'UFRAME' else 'tool'} {why}")
    if isinstance(frame, str):
        raise LeftOutError(frame)
    return frame


def _configuration(source: Source, position: re.Match[str]) -> Configuration:
    """N U T: as in the reference pose; F, D, B: the wrist flipped, the elbow down, behind axis 1. Turns: all 0."""
    match = _CONFIG.search(position[2])
    if match is None:
        raise DataError(f"{source.where(position.start())}: has no CONFIG such as 'N U T, 0, 0, 0'; save it again")
    if any(int(turn) for turn in match.groups()[3:]):
        raise LeftOutError("its configuration counts turns; only 0, 0, 0 is read")
    ranges = dict.fromkeys(_TURNING, (-np.pi, np.pi))
    flags = {"flipped": match[1] == "F", "elbow": match[2] == "D", "behind": match[3] == "B"}
    return Configuration(match[0], ranges, **flags)
