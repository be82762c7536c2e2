"""Targets of FANUC's teach pendant programs as text (`.ls`): the positions of `/POS` that lines of `/MN` go to.

Each position says its user frame (UF) and tool (UT); what these are, the controller knows, and a table of frames says
(`UFRAME[1]`, `UTOOL[1]`). Position registers, offsets, increments and further motion groups are computed at run time.
Numbers keep their three decimals and their columns.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pinocchio as pin

from calib.core.base.errors import DataError
from calib.programs.languages.control_flow import State, Unknown
from calib.programs.languages.fanuc_statements import WORDS, FanucStatements
from calib.programs.languages.harmless import names
from calib.programs.languages.robot_program import (
    DEGREE,
    MILLIMETRE,
    Configuration,
    LeftOutError,
    Number,
    ProgramTarget,
    RobotProgram,
    Source,
    cells_at,
)
from calib.programs.languages.tokens import Code, Span

LANGUAGE, SUFFIXES = "FANUC LS", (".ls",)
_SECTION = re.compile(r"^/(\w+)", re.MULTILINE)
_CONFIG = re.compile(r"'\s*([NF])\s*([UD])\s*([TB])\s*,\s*(-?\d+)\s*,\s*(-?\d+)\s*,\s*(-?\d+)\s*'")
_CHANGED = ("TOOL_OFFSET", "OFFSET", "VOFFSET", "INC", "CV_TCP")
_KNOWN = names(
    """FINE ACC CR WJNT RT_LD AP_LD PTH BREAK MROT SKIP LBL TA TB DB DA SEC MSEC MM CM MIN DEG INCH EV PSPD P SPS SPOT
    CALL     TIME BEFORE AFTER MAX_SPEED WELD_SPEED ON OFF R DO RO GO AO F PULSE ARC START END WEAVE SINE"""
)
_POSE, _JOINTS = ("X", "Y", "Z", "W", "P", "R"), ("J1", "J2", "J3", "J4", "J5", "J6")
_TURNING = (0, 3, 4, 5)


def read_fanuc(path: Path | str, frames: Mapping[str, pin.SE3 | str], harmless: Collection[str] = ()) -> RobotProgram:
    """Read a program.

    Args:
        path: The file.
        frames: `UFRAME[1]`, `UTOOL[1]`, ...; those of number 0 are the robot's base and its flange.
        harmless: Programs and macros that change no frame and no tool, in capitals.

    Raises:
        DataError: The message names file and line.
    """
    source = Source.read(path, "a FANUC program as text (LS)")
    sections = {match[1]: match for match in reversed([*_SECTION.finditer(source.text)])}
    if not {"MN", "POS"} <= set(sections) or sections["MN"].start() > sections["POS"].start():
        raise DataError(f"{path}: has no /MN and /POS sections; save the program as text (LS)")
    end = sections["END"].start() if "END" in sections else None
    positions = _positions(Code(source, WORDS, lines="blank", part=slice(sections["POS"].end(), end)))
    instructions = Code(source, WORDS, lines="blank", part=slice(sections["MN"].end(), sections["POS"].start()))
    return _Reader(source, instructions, positions, frames, harmless).program()


@dataclass(frozen=True)
class _Position:
    """A position of `/POS`.

    Attributes:
        code: Words of the section.
        at: Its first word.
        groups: Its motion groups.
        fields: Of its first group the place of the number of each field, from behind the equals sign, and its unit.
        frame, tool: Numbers of its user frame and tool, as written; empty where it has none.
        configuration: As written, with quotes; empty where it has none.
    """

    code: Code
    at: int
    groups: tuple[str, ...]
    fields: Mapping[str, tuple[int, Span, str]]
    frame: str
    tool: str
    configuration: str


def _positions(code: Code) -> dict[str, _Position]:
    """Positions of the section by number."""
    positions: dict[str, _Position] = {}
    for at in code.names(0, len(code.tokens) - 5):
        if (
            code.tokens[at].text != "P"
            or not code.is_mark(at + 1, "[")
            or not code.is_mark(code.partner[at + 1] + 1, "{")
        ):
            continue
        number = code.tokens[at + 2].text.partition(":")[0].strip()
        if number in positions:
            raise DataError(f"{code.where(at)}: P[{number}] is in /POS twice; save the program again")
        opening = code.partner[at + 1] + 1
        positions[number] = _position(code, at, opening + 1, code.partner[opening])
    return positions


def _position(code: Code, at: int, first: int, stop: int) -> _Position:
    groups, fields, said = [], dict[str, tuple[int, Span, str]](), dict[str, str]()
    for k in code.names(first, stop):
        name = code.tokens[k].text
        if name.startswith("GP") and code.is_mark(k + 1, ":"):
            groups.append(name)
        elif code.is_mark(k + 1, ":"):
            said.setdefault(name, code.tokens[k + 2].text)
        elif code.is_mark(k + 1, "="):
            behind = k + 4 if code.is_mark(k + 2, "-", "+") else k + 3
            number = code.number(k + 2, behind)
            unit = code.tokens[behind].text
            if number is not None and unit in ("MM", "DEG") and len(groups) < 2:
                if name in fields:
                    raise DataError(f"{code.where(k)}: {name} is given twice; save the program again")
                fields[name] = (code.tokens[k + 1].end, number, unit)
    return _Position(code, at, tuple(groups), fields, *(said.get(key, "") for key in ("UF", "UT", "CONFIG")))


class _Reader(FanucStatements):
    def __init__(
        self,
        source: Source,
        code: Code,
        positions: Mapping[str, _Position],
        frames: Mapping[str, pin.SE3 | str],
        harmless: Collection[str],
    ) -> None:
        super().__init__(source, code, harmless)
        self.positions, self.frames = positions, frames

    def program(self) -> RobotProgram:
        """Read the instructions, follow the program, and take in its moves."""
        self.read()
        self.uses.follow()
        self.flow.follow()
        return self.collector.program(LANGUAGE, [self.source])

    def move(self, places: list[Span], options: Span, state: State | None) -> None:
        """Take in one motion: its places and the words behind them, and what holds there."""
        for span in places:
            start, position = self.code.tokens[span[0]].start, None
            try:
                found, changed = self._position(span), self._changed(options)
                if changed.upper() in ("", "INC"):  # others move along with the position
                    position = found
                if changed:
                    raise LeftOutError(f"is computed at run time ({changed})")
                if state is None:
                    raise LeftOutError("is a place to which the program never comes")
                self.collector.take(self._target(found, state), self.source, start)
            except LeftOutError as why:
                if position is not None and position.fields:
                    name = "J1" if "J1" in position.fields else "X"
                    if name in position.fields:
                        self.collector.refuse(self._cells(position, (name,)), self.source, start)
                self.collector.leave(self.source, start, self.code.shown(*span), str(why))

    def _changed(self, options: Span) -> str:
        """A word behind the places that changes the target; a word that is not known."""
        for at in self.code.names(*options):
            token = self.code.tokens[at]
            if token.text in _CHANGED:
                return self.code.shown(at, at + 1)
        for at in self.code.names(*options):
            text = self.code.tokens[at].text
            if text.rstrip("0123456789") not in ("CNT", "ACC", "CR", *_KNOWN) and not self.called(at):
                raise LeftOutError(f"has an option that is not known here ({self.code.shown(at, at + 1)})")
        return ""

    def _position(self, span: Span) -> _Position:
        name = self.place(span)
        if name == "PR":
            raise LeftOutError("is a position register; its numbers are not in the program")
        if not name[2:-1].isdigit():
            raise LeftOutError("is computed at run time")
        if name[2:-1] not in self.positions:
            raise DataError(f"{self.code.where(span[0])}: {name} is not in /POS; save the program again")
        return self.positions[name[2:-1]]

    def _target(self, position: _Position, state: State) -> ProgramTarget:
        """The target of a motion."""
        code, fields, where = position.code, position.fields, position.code.where(position.at)
        name = f"P[{code.tokens[position.at + 2].text.partition(':')[0].strip()}]"
        why = self.uses.why_not(name) or self.uses.why_not("P[*]")
        if why:
            raise LeftOutError(why)
        if position.groups != ("GP1",):
            raise LeftOutError("moves other motion groups, which the description does not have")
        if any(float(self.source.text[slice(*fields[key][1])]) for key in fields if key.startswith("E")):
            raise LeftOutError("moves external axes, which the description does not have")
        line = code.line(position.at)
        if set(_JOINTS) <= set(fields):
            return ProgramTarget(line, self.source.path, name, self._cells(position, _JOINTS), None)
        if not set(_POSE) <= set(fields):
            missing = next(key for key in _POSE if key not in fields)
            raise DataError(f"{where}: {name} has no number for {missing}; correct it")
        if not position.frame or not position.tool:
            raise DataError(f"{where}: {name} does not say UF and UT; save the program again")
        frame, tool = (
            self._frame(kind, number, state) for kind, number in (("UFRAME", position.frame), ("UTOOL", position.tool))
        )
        configuration = _configuration(where, position.configuration)
        cells = self._cells(position, _POSE)
        return ProgramTarget(line, self.source.path, name, cells, "xyz", frame, tool, configuration)

    def _cells(self, position: _Position, names: tuple[str, ...]) -> tuple[Number, ...]:
        """Numbers with the blanks before them, which make room for a sign."""
        fields = [position.fields[name] for name in names]
        units = [MILLIMETRE if unit == "MM" else DEGREE for _, _, unit in fields]
        cells = cells_at(self.source, 0, [number for _, number, _ in fields], units)
        return tuple(
            replace(
                cell,
                start=start,
                width=number[1] - start,
                decimals=len(self.source.text[slice(*number)].partition(".")[2]),
            )
            for cell, (start, number, _) in zip(cells, fields, strict=True)
        )

    def _frame(self, kind: str, number: str, state: State) -> pin.SE3:
        what = "user frame" if kind == "UFRAME" else "tool"
        selected = state[f"{kind}_NUM"]
        if isinstance(selected, Unknown):
            raise LeftOutError(f"which {what} is selected {selected.why}")
        if selected not in ("", number):
            raise LeftOutError(f"is of {what} {number}, and {selected} is selected here")
        if number == "0":
            return pin.SE3.Identity()
        name = f"{kind}[{number}]"
        frame = self.frames.get(name)
        if frame is None:
            given = f"is not known; give {name} with --frames"
            raise LeftOutError(f"its {what} {given if number.isdigit() else 'is chosen at run time'}")
        for changed in (state.get(name), state[kind]):
            if isinstance(changed, Unknown):
                raise LeftOutError(f"{name} {changed.why}")
        if isinstance(frame, str):
            raise LeftOutError(frame)
        return frame


def _configuration(where: str, text: str) -> Configuration:
    """N U T: as in the reference pose; F, D, B: the wrist flipped, the elbow down, behind axis 1. Turns: all 0."""
    match = _CONFIG.fullmatch(text)
    if match is None:
        raise DataError(f"{where}: has no CONFIG such as 'N U T, 0, 0, 0'; save it again")
    if any(int(turn) for turn in match.groups()[3:]):
        raise LeftOutError("its configuration counts turns; only 0, 0, 0 is read")
    ranges = dict.fromkeys(_TURNING, (-np.pi, np.pi))
    flags = {"flipped": match[1] == "F", "elbow": match[2] == "D", "behind": match[3] == "B"}
    return Configuration(f"CONFIG : {text}", ranges, **flags)
