"""Targets of RAPID, the language of ABB.

Read are the `robtarget` and `jointtarget` of `MoveL`, `MoveJ`, `MoveC`, `MoveAbsJ` and of instructions that move and do
something beside (`MoveLDO`, `TriggL`, `ArcL`, `SpotL` ...), declared as constants, persistents or variables, one by
one or in arrays, or written out. Tools (`tooldata`) and work objects (`wobjdata`) are those of the instruction,
declared in the program, or in another module, or in a table of frames. Axis configurations count while `ConfL` and
`ConfJ` are on.

Data that the program sets anywhere are no constants. Arguments are set by routines that get them as `INOUT`, `PERS`,
`VAR` or `REF`, and by all that are declared nowhere here; those may also set all data that are not `LOCAL`.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

from calib.core.base.errors import DataError
from calib.programs.languages.control_flow import State, Unknown
from calib.programs.languages.orientations import pose_of
from calib.programs.languages.rapid_statements import RapidStatements
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
from calib.programs.languages.tokens import Span

LANGUAGE, SUFFIXES = "RAPID", (".mod", ".modx", ".prg", ".sys")
_WHAT = "a RAPID module"
_TWO = re.compile(r"(MOVE|TRIGG|ARC|DISP|PAINT)C")
_ABSOLUTE = re.compile(r"\w+ABSJ")
_NONE = 8e9  # external axes that are not there say 9E9
_QUARTER = np.pi / 2
_FIXED = ("TOOL0", "WOBJ0")


def read_rapid(path: Path | str, frames: Mapping[str, pin.SE3 | str], harmless: Collection[str] = ()) -> RobotProgram:
    """Read a module.

    Args:
        path: The file.
        frames: Tools and work objects that it does not declare, by their names in capitals.
        harmless: Routines of other modules that set no data and no mode of motion, in capitals.

    Raises:
        DataError: The message names file and line.
    """
    return _Reader(Source.read(path, _WHAT), frames, harmless).program()


def rapid_frames(path: Path | str) -> dict[str, pin.SE3 | str]:
    """Return the tools and work objects that a module declares; the reason for those that cannot be used."""
    reader = _Reader(Source.read(path, _WHAT), {}, ())
    return {
        name: f"'{name.lower()}' is set by its module" if reader.uses.is_set(name.partition("{")[0]) else frame
        for name, frame in reader.frames.items()
    }


@dataclass(frozen=True)
class _Declared:
    """A target, tool or work object: type, name, where its numbers stand, and whether other modules can set it."""

    type: str
    name: str
    span: Span
    shared: bool


class _Reader(RapidStatements):
    def __init__(self, source: Source, frames: Mapping[str, pin.SE3 | str], harmless: Collection[str]) -> None:
        super().__init__(source, harmless)
        self.declared: dict[str, _Declared] = {}
        self.frames: dict[str, pin.SE3 | str] = {"TOOL0": pin.SE3.Identity(), "WOBJ0": pin.SE3.Identity(), **frames}
        self.read()
        for data in self.data:
            elements = self._elements(data.value) if data.array else [data.value]
            for k, span in enumerate(elements, 1):
                name = f"{data.name}{{{k}}}" if data.array else data.name
                if self.code.inside(*span, "["):
                    shown = self.source.text[self.code.tokens[data.at].start : self.code.tokens[data.at].end]
                    shown += name[len(data.name) :]
                    self.declared[name] = _Declared(data.type.lower(), shown, span, data.shared)
        self.frames |= {
            name: self._frame(declared) for name, declared in self.declared.items() if "data" in declared.type
        }

    def program(self) -> RobotProgram:
        """Follow the program, and take in its moves."""
        self.uses.follow()
        self.flow.follow()
        return self.collector.program(LANGUAGE, [self.source])

    def _elements(self, span: Span) -> list[Span]:
        inside = self.code.inside(*span, "[")
        return self.code.split(*inside) if inside else []

    def _numbers(self, span: Span, count: int, what: str) -> list[tuple[int, int]]:
        """Places of the plain numbers in brackets."""
        spans = self._elements(span)
        numbers = [self.code.number(*element) for element in spans]
        for number, element in zip(numbers, spans, strict=True):
            if number is None:
                raise LeftOutError(f"'{self.code.shown(*element)}' is not a plain number")
        if len(spans) != count:
            raise DataError(f"{self.code.where(span[0])}: {what} has {len(spans)} numbers; expected {count}")
        return [number for number in numbers if number is not None]

    def _pose(self, position: Span, rotation: Span) -> tuple[Number, ...]:
        spans = self._numbers(position, 3, "a position") + self._numbers(rotation, 4, "a quaternion")
        return cells_at(self.source, 0, spans, (*[MILLIMETRE] * 3, *[0.0] * 4))

    def _pose_value(self, span: Span) -> pin.SE3:
        groups = self._elements(span)
        if len(groups) != 2:
            raise DataError(f"{self.code.where(span[0])}: a frame is written [[x,y,z],[q1,q2,q3,q4]]; correct it")
        cells = self._pose(*groups)
        return pose_of([cell.value for cell in cells], "quaternion", self.code.where(span[0]))

    def _frame(self, declared: _Declared) -> pin.SE3 | str:
        """A tool or work object as a frame, or why it cannot be one."""
        groups = self._elements(declared.span)
        texts = [self.code.tokens[start].text for start, _ in groups]
        if len(groups) != (3 if declared.type == "tooldata" else 5):
            raise DataError(
                f"{self.code.where(declared.span[0])}: {declared.type} '{declared.name}' is not complete; correct it"
            )
        try:
            if declared.type == "tooldata":
                return (
                    self._pose_value(groups[1]) if texts[0] == "TRUE" else f"tool '{declared.name}' is not on the robot"
                )
            if texts[0] != "FALSE":
                return f"the robot holds work object '{declared.name}'"
            if texts[1] != "TRUE":
                return f"work object '{declared.name}' is moved by another unit"
            return self._pose_value(groups[3]) * self._pose_value(groups[4])
        except LeftOutError as why:
            return f"'{declared.name}' is not constant: {why}"

    def move(self, word: str, spans: Sequence[Span], options: Mapping[str, Span], state: State | None) -> None:
        """Take in one instruction that moves: its arguments, and what holds there."""
        targets = list(spans[: 2 if _TWO.match(word) else 1])
        search = word.startswith("SEARCH")
        if search:
            targets = [span for span in spans[:4] if self._named(span) in self.declared][-1:] or targets
        for span in targets:
            start, declared = self.code.tokens[span[0]].start, None
            try:
                if search:
                    raise LeftOutError("is where a search ends, not where the robot stops")
                declared = self._declared(word, span)
                if state is None:
                    raise LeftOutError("is a place to which the program never comes")
                self.collector.take(self._target(word, declared, spans, options, state), self.source, start)
            except LeftOutError as why:
                if declared is not None and state is not None:
                    self._refuse(declared, start)
                self.collector.leave(self.source, start, self.code.shown(*span), str(why))

    def _refuse(self, declared: _Declared, start: int) -> None:
        """Leave a target as it is everywhere, if it has plain numbers."""
        groups = self._elements(declared.span)
        first = self._elements(groups[0]) if groups else []
        number = self.code.number(*first[0]) if first else None
        if number is not None:
            self.collector.refuse(cells_at(self.source, 0, [number], [MILLIMETRE]), self.source, start)

    def _named(self, span: Span) -> str:
        """What an argument names, in capitals."""
        return "".join(self.code.tokens[at].text for at in range(*span))

    def _declared(self, word: str, span: Span) -> _Declared:
        """The numbers of a target that an argument is or names."""
        name = self._named(span)
        if self.code.inside(*span, "["):
            return _Declared("jointtarget" if _ABSOLUTE.match(word) else "robtarget", "", span, False)
        base = name.partition("{")[0]
        if base in self.several:
            raise LeftOutError("is declared in several places; name each otherwise")
        if name in self.declared and self.declared[name].type.endswith("target"):
            return self.declared[name]
        moved = self.code.tokens[span[0] + 2].text if name.startswith(("OFFS(", "RELTOOL(")) else ""
        along = f"; it moves along with {self.declared[moved].name}" if moved in self.declared else ""
        raise LeftOutError(f"is computed at run time{along}" if "(" in name else "is declared nowhere here")

    def _target(
        self, word: str, declared: _Declared, spans: Sequence[Span], options: Mapping[str, Span], state: State
    ) -> ProgramTarget:
        self._constant(declared.name.upper(), declared.shared)
        if "CORR" in options:
            raise LeftOutError("is corrected while the robot moves (\\Corr)")
        groups, line = self._elements(declared.span), self.code.line(declared.span[0])
        where = self.code.where(declared.span[0])
        if len(groups) != (2 if declared.type == "jointtarget" else 4):
            raise DataError(f"{where}: {declared.type} '{declared.name}' is not complete; correct it")
        self._without_external(groups[-1])
        if declared.type == "jointtarget":
            cells = cells_at(self.source, 0, self._numbers(groups[0], 6, "robax"), [DEGREE] * 6)
            if isinstance(state["EOFFS"], Unknown):
                raise LeftOutError(f"an offset of axes {state['EOFFS'].why}")
            return ProgramTarget(line, self.source.path, declared.name, cells, None)
        cells = self._pose(*groups[:2])
        pose_of([cell.value for cell in cells], "quaternion", where)
        for key in ("PDISP", "EOFFS"):
            displaced = state[key]
            if isinstance(displaced, Unknown):
                raise LeftOutError(f"a program displacement {displaced.why}")
        tool, frame = self._tool(word, spans), self._work_object(options)
        checked = state["CONFJ" if word.startswith(("MOVEJ", "TRIGGJ")) else "CONFL"]
        if isinstance(checked, Unknown):
            raise LeftOutError(f"whether its configuration is checked {checked.why}")
        configuration = self._configuration(groups[2]) if checked else None
        return ProgramTarget(line, self.source.path, declared.name, cells, "quaternion", frame, tool, configuration)

    def _constant(self, name: str, shared: bool) -> None:
        """Refuse data that the program, or another module, sets or decides by."""
        why = self.uses.why_not(name.partition("{")[0])
        if why:
            raise LeftOutError(why)
        if shared and self.foreign:
            raise LeftOutError(f"may be set by {self.foreign}")

    def _without_external(self, span: Span) -> None:
        values = [float(self.source.text[a:b]) for a, b in self._numbers(span, 6, "extax")]
        if any(value < _NONE for value in values):
            raise LeftOutError("moves external axes, which the description does not have")

    def _configuration(self, span: Span) -> Configuration:
        """cf1, cf4, cf6: quarter turns of axes 1, 4 and 6; cfx: its bit 4 the side of axis 1, bit 2 that of the arm."""
        quarters = [round(float(self.source.text[a:b])) for a, b in self._numbers(span, 4, "a configuration")]
        ranges = {joint: (q * _QUARTER, (q + 1) * _QUARTER) for joint, q in zip((0, 3, 5), quarters[:3], strict=True)}
        behind, elbow = bool(quarters[3] & 4), bool(quarters[3] & 2)
        return Configuration(self.code.shown(*span), ranges, behind, elbow)

    def _tool(self, word: str, spans: Sequence[Span]) -> pin.SE3:
        known = [self._named(span) for span in spans if self._named(span) in self.frames]
        known = [name for name in known if name not in self.declared or self.declared[name].type == "tooldata"]
        if not known:
            place = 4 if _TWO.match(word) else 3
            name = self.code.shown(*spans[place]) if len(spans) > place else "?"
            raise LeftOutError(f"tool '{name}' is declared nowhere here; give its module with --frames")
        return self._usable(known[-1])

    def _work_object(self, options: Mapping[str, Span]) -> pin.SE3:
        if "WOBJ" not in options:
            return pin.SE3.Identity()
        name = self._named(options["WOBJ"])
        if name not in self.frames:
            shown = self.code.shown(*options["WOBJ"])
            raise LeftOutError(f"work object '{shown}' is declared nowhere here; give its module with --frames")
        return self._usable(name)

    def _usable(self, name: str) -> pin.SE3:
        frame = self.frames[name]
        if isinstance(frame, str):
            raise LeftOutError(frame)
        if name in self.several:
            raise LeftOutError(f"'{name.lower()}' is declared in several places; name each otherwise")
        if self.uses.is_set(name.partition("{")[0]):
            raise LeftOutError(f"'{name.lower()}' is set while the program runs")
        if self.foreign and name not in _FIXED and (name not in self.declared or self.declared[name].shared):
            raise LeftOutError(f"'{name.lower()}' may be set by {self.foreign}")
        return frame
