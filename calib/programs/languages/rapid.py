"""Targets of RAPID, the language of ABB.

Read are the `robtarget` and `jointtarget` of `MoveL`, `MoveJ`, `MoveC`, `MoveAbsJ` and of instructions that move and do
something beside (`MoveLDO`, `TriggL`, `ArcL`, `SpotL` ...), declared as constants, persistents or variables, one by
one or in arrays, or written out. Tools (`tooldata`) and work objects (`wobjdata`) are those of the instruction,
declared in the program, or in another module, or in a table of frames. Axis configurations count while `ConfL` and
`ConfJ` are on.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

from calib.core.base.errors import DataError
from calib.programs.languages.orientations import pose_of
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
    arguments,
    cells_at,
    closing,
)

LANGUAGE, SUFFIXES = "RAPID", (".mod", ".modx", ".prg", ".sys")
_BLANK = r'"[^"\n]*"|![^\n]*'
_TYPES = "robtarget|jointtarget|tooldata|wobjdata"
_DECLARED = re.compile(
    rf"\b(?:LOCAL\s+|TASK\s+)?(?:CONST|PERS|VAR)\s+({_TYPES})\s+(\w+)\s*(\{{[^}}]*\}})?\s*(:=)?", re.IGNORECASE
)
_STATEMENT = re.compile(
    r"(?<![\w.])((?:Move|Trigg)(?:L|C|J|AbsJ)(?:Sync|DO|AO|GO|IOs)?|Arc[LC](?:Start|End|\d)?|Spot(?:L|J|ML|MJ)"
    r"|(?:Disp|Paint|Search)[LC](?:Start|End)?|ConfL|ConfJ|PDispOn|PDispSet|PDispOff|EOffsOn|EOffsSet|EOffsOff)\b"
    r"(?!\s*:=)([^;]*);",
    re.IGNORECASE,
)
_PARAMETERS = re.compile(r"\b(?:PROC|FUNC\s+\w+)\s+\w+\s*\(([^)]*)\)", re.IGNORECASE)
_PARAMETER = re.compile(rf"\b(?:{_TYPES})\s+(\w+)", re.IGNORECASE)
_ASSIGNED = re.compile(r"(?:^|[;\n])[ \t]*(\w+)(?:\{[^}\n]*\})?(?:\.[\w.]+)?[ \t]*:=")
_TWO = re.compile(r"(Move|Trigg|Arc|Disp|Paint)C", re.IGNORECASE)
_ABSOLUTE = re.compile(r"\w+AbsJ", re.IGNORECASE)
_NONE = 8e9  # external axes that are not there say 9E9
_QUARTER = np.pi / 2


@dataclass(frozen=True)
class _Declared:
    """A constant: its type, name and the numbers in it, each with its place."""

    type: str
    name: str
    start: int
    end: int


def read_rapid(path: Path | str, frames: Mapping[str, pin.SE3 | str]) -> RobotProgram:
    """Read a module.

    Args:
        path: The file.
        frames: Tools and work objects that it does not declare, by their names in capitals.

    Raises:
        DataError: The message names file and line.
    """
    return _Reader(Source.read(path, "a RAPID module", _BLANK), frames).program()


def rapid_frames(path: Path | str) -> dict[str, pin.SE3 | str]:
    """Return the tools and work objects that a module declares; the reason for those that cannot be used."""
    return _Reader(Source.read(path, "a RAPID module", _BLANK), {}).frames


class _Reader:
    def __init__(self, source: Source, frames: Mapping[str, pin.SE3 | str]) -> None:
        self.source, self.code, self.collector = source, source.code, Collector()
        declarations = self._declarations()
        self.declared = {declared.name.upper(): declared for declared in declarations}
        self.several = self._several([declared.name.upper() for declared in declarations])
        self.frames: dict[str, pin.SE3 | str] = {"TOOL0": pin.SE3.Identity(), "WOBJ0": pin.SE3.Identity(), **frames}
        self.frames |= {
            name: self._frame(declared) for name, declared in self.declared.items() if "data" in declared.type
        }
        self.assigned = {match[1].upper() for match in _ASSIGNED.finditer(self.code)}
        self.checked, self.displaced = True, False

    def _declarations(self) -> list[_Declared]:
        declarations = []
        for match in _DECLARED.finditer(self.code):
            opening = re.compile(r"\s*\[").match(self.code, match.end())
            end = closing(self.code, opening.end() - 1) if match[4] and opening else None
            if opening is None or end is None:
                continue
            start = opening.end() - 1
            if match[3] is None:
                declarations.append(_Declared(match[1].lower(), match[2], start, end + 1))
            else:
                elements = arguments(self.code, start + 1, end)
                declarations += [
                    _Declared(match[1].lower(), f"{match[2]}{{{k}}}", *span) for k, span in enumerate(elements, 1)
                ]
        return declarations

    def _several(self, names: Sequence[str]) -> set[str]:
        """Names that mean several things in the module: constants of routines, and parameters of routines."""
        parameters = {
            name.upper() for match in _PARAMETERS.finditer(self.code) for name in _PARAMETER.findall(match[1])
        }
        return {name.partition("{")[0] for name in names if names.count(name) > 1} | parameters

    def _groups(self, start: int, end: int) -> list[tuple[int, int]]:
        return list(arguments(self.code, start + 1, end - 1))

    def _numbers(self, span: tuple[int, int], count: int, what: str) -> list[tuple[int, int]]:
        """Places of the plain numbers in brackets between two places."""
        start, end = span
        spans = self._groups(start, end) if self.code[start] == "[" and closing(self.code, start) == end - 1 else []
        odd = next((span for span in spans if not re.fullmatch(NUMBER, self.code[span[0] : span[1]])), None)
        if odd is not None:
            raise LeftOutError(f"'{self.source.shown(*odd)}' is not a plain number")
        if len(spans) != count:
            raise DataError(f"{self.source.where(start)}: {what} has {len(spans)} numbers; expected {count}")
        return spans

    def _pose(self, position: tuple[int, int], rotation: tuple[int, int]) -> tuple[Number, ...]:
        spans = self._numbers(position, 3, "a position") + self._numbers(rotation, 4, "a quaternion")
        return cells_at(self.source, 0, spans, (*[MILLIMETRE] * 3, *[0.0] * 4))

    def _pose_value(self, span: tuple[int, int]) -> pin.SE3:
        groups = self._groups(*span)
        if len(groups) != 2:
            raise DataError(f"{self.source.where(span[0])}: a frame is written [[x,y,z],[q1,q2,q3,q4]]; correct it")
        cells = self._pose(*groups)
        return pose_of([cell.value for cell in cells], "quaternion", self.source.where(span[0]))

    def _frame(self, declared: _Declared) -> pin.SE3 | str:
        """A tool or work object as a frame, or why it cannot be one."""
        groups = self._groups(declared.start, declared.end)
        texts = [self.code[start:end].strip().upper() for start, end in groups]
        if len(groups) != (3 if declared.type == "tooldata" else 5):
            raise DataError(
                f"{self.source.where(declared.start)}: {declared.type} '{declared.name}' is not complete; correct it"
            )
        try:
            if declared.type == "tooldata":
                return (
                    self._pose_value(groups[1]) if texts[0] == "TRUE" else f"tool '{declared.name}' is not on the robot"
                )
            if texts[0] == "TRUE":
                return f"the robot holds work object '{declared.name}'"
            if texts[1] == "FALSE":
                return f"work object '{declared.name}' is moved by another unit"
            return self._pose_value(groups[3]) * self._pose_value(groups[4])
        except LeftOutError as why:
            return f"'{declared.name}' is not constant: {why}"

    def program(self) -> RobotProgram:
        """Walk through the text."""
        for match in _STATEMENT.finditer(self.code):
            word, text = match[1].upper(), match[2]
            if word.startswith(("CONF", "PDISP", "EOFFS")):
                self._switch(word, text.upper())
            elif "[" in text or "," in text:
                self._move(match)
        return self.collector.program(LANGUAGE, [self.source])

    def _switch(self, word: str, text: str) -> None:
        if word in ("CONFL", "CONFJ"):
            self.checked = "OFF" not in text
        else:
            self.displaced = not word.endswith("OFF")

    def _move(self, match: re.Match[str]) -> None:
        """Take in one instruction that moves."""
        word = match[1]
        spans = [span for span in arguments(self.code, match.start(2), match.end(2)) if self.code[span[0]] != "\\"]
        # a switch such as \Conc stands before the first argument without a comma in some releases
        spans = [(self._after_switches(start, end), end) for start, end in spans]
        targets = spans[: 2 if _TWO.match(word) else 1]
        if word.upper().startswith("SEARCH"):
            targets = [span for span in spans[:4] if self._base(span) in self.declared][-1:] or spans[:1]
        for span in targets:
            try:
                if word.upper().startswith("SEARCH"):
                    raise LeftOutError("is where a search ends, not where the robot stops")
                self.collector.take(self._target(word, span, spans), self.source, span[0])
            except LeftOutError as why:
                self.collector.leave(self.source, span[0], self.source.shown(*span), str(why))

    def _after_switches(self, start: int, end: int) -> int:
        match = re.compile(r"(?:\\\w+\s+)*").match(self.code, start, end)
        return match.end() if match else start

    def _base(self, span: tuple[int, int]) -> str:
        """What an argument names, in capitals, without what is optional."""
        return re.split(r"\\", self.code[span[0] : span[1]])[0].strip().upper().replace(" ", "")

    def _target(self, word: str, span: tuple[int, int], spans: list[tuple[int, int]]) -> ProgramTarget:
        name, start, end = self._base(span), *span
        if name.partition("{")[0] in self.several:
            raise LeftOutError("is declared in several places; name each otherwise")
        if name.startswith("["):
            close = closing(self.code, start)
            declared = _Declared("jointtarget" if _ABSOLUTE.match(word) else "robtarget", "", start, (close or end) + 1)
        elif name in self.declared and self.declared[name].type.endswith("target"):
            declared = self.declared[name]
            if name.partition("{")[0] in self.assigned:
                raise LeftOutError("is set while the program runs")
        else:
            moved = re.match(r"(OFFS|RELTOOL)\(([^,]*),", name)
            along = (
                f"; it moves along with {self.declared[moved[2]].name}" if moved and moved[2] in self.declared else ""
            )
            raise LeftOutError(f"is computed at run time{along}" if "(" in name else "is declared nowhere here")
        if self.displaced:
            raise LeftOutError("a program displacement (PDispOn, PDispSet, EOffsOn) is active here")
        groups, line = self._groups(declared.start, declared.end), self.source.line(declared.start)
        expected = 2 if declared.type == "jointtarget" else 4
        if len(groups) != expected:
            raise DataError(
                f"{self.source.where(declared.start)}: {declared.type} '{declared.name}' is not complete; correct it"
            )
        self._without_external(groups[-1])
        if declared.type == "jointtarget":
            cells = cells_at(self.source, 0, self._numbers(groups[0], 6, "robax"), [DEGREE] * 6)
            return ProgramTarget(line, self.source.path, declared.name, cells, None)
        cells = self._pose(*groups[:2])
        pose_of([cell.value for cell in cells], "quaternion", self.source.where(declared.start))
        tool, frame = self._named_tool(word, spans), self._work_object(spans)
        configuration = self._configuration(groups[2]) if self.checked else None
        return ProgramTarget(line, self.source.path, declared.name, cells, "quaternion", frame, tool, configuration)

    def _without_external(self, span: tuple[int, int]) -> None:
        values = [float(self.code[a:b]) for a, b in self._numbers(span, 6, "extax")]
        if any(value < _NONE for value in values):
            raise LeftOutError("moves external axes, which the description does not have")

    def _configuration(self, span: tuple[int, int]) -> Configuration:
        """cf1, cf4, cf6: quarter turns of axes 1, 4 and 6; cfx: its bit 4 the side of axis 1, bit 2 that of the arm."""
        quarters = [round(float(self.code[a:b])) for a, b in self._numbers(span, 4, "a configuration")]
        ranges = {joint: (q * _QUARTER, (q + 1) * _QUARTER) for joint, q in zip((0, 3, 5), quarters[:3], strict=True)}
        behind, elbow = bool(quarters[3] & 4), bool(quarters[3] & 2)
        return Configuration(self.source.shown(*span), ranges, behind, elbow)

    def _named_tool(self, word: str, spans: list[tuple[int, int]]) -> pin.SE3:
        known = [self._base(span) for span in spans if self._base(span) in self.frames]
        known = [name for name in known if name not in self.declared or self.declared[name].type == "tooldata"]
        if not known:
            place = 4 if _TWO.match(word) else 3
            name = re.split(r"\\", self.code[slice(*spans[place])])[0].strip() if len(spans) > place else "?"
            raise LeftOutError(f"tool '{name}' is declared nowhere here; give its module with --frames")
        return self._usable(known[-1])

    def _work_object(self, spans: list[tuple[int, int]]) -> pin.SE3:
        for start, end in spans:
            match = re.compile(r".*?\\WObj\s*:=\s*(\w+)", re.IGNORECASE | re.DOTALL).match(self.code, start, end)
            if match:
                if match[1].upper() not in self.frames:
                    raise LeftOutError(
                        f"work object '{match[1]}' is declared nowhere here; give its module with --frames"
                    )
                return self._usable(match[1].upper())
        return pin.SE3.Identity()

    def _usable(self, name: str) -> pin.SE3:
        frame = self.frames[name]
        if isinstance(frame, str):
            raise LeftOutError(frame)
        if name in self.several:
            raise LeftOutError(f"'{name.lower()}' is declared in several places; name each otherwise")
        if name in self.assigned:
            raise LeftOutError(f"'{name.lower()}' is set while the program runs")
        return frame
