"""Targets of KRL, the language of KUKA: a `.src` file with the `.dat` file beside it.

Read are `PTP`, `LIN`, `CIRC`, `SPL` and their splines with positions (`E6POS`, `POS`, `FRAME`) and axes (`E6AXIS`,
`AXIS`), declared in either file or written out. Tool and base are those that hold there in the text: of the inline
forms (`FDAT_ACT` or the spline's `STOOL2`, `SBASE`), of `BAS(#TOOL, ...)` and `BAS(#BASE, ...)`, or set in `$TOOL` and
`$BASE`. `TOOL_DATA` and `BASE_DATA` stand in the controller's `$config.dat`, or in a table of frames.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pinocchio as pin

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

LANGUAGE, SUFFIXES = "KRL", (".src",)
_BLANK = r'"[^"\n]*"|;[^\n]*'
_WHAT = "a KRL program"
_DECLARED = re.compile(
    r"^[ \t]*(?:DECL[ \t]+)?(?:GLOBAL[ \t]+)?(?:(E6POS|POS|FRAME|E6AXIS|AXIS|FDAT)[ \t]+)?([$\w]+(?:\[\d+\])?)[ \t]*="
    r"[ \t]*(?=\{)",
    re.IGNORECASE | re.MULTILINE,
)
_ASSIGNED = re.compile(r"^[ \t]*(?!DECL\b)(\w+)(?:\[[^\]\n]*\])?(?:\.\w+)?[ \t]*=(?!=)", re.IGNORECASE | re.MULTILINE)
_MOVE = re.compile(r"^[ \t]*(S?PTP|S?LIN|S?CIRC|SPL)(_REL)?[ \t]+([^\n]*)", re.IGNORECASE | re.MULTILINE)
_STATE = re.compile(
    r"^[ \t]*(?:(\$TOOL|\$BASE|FDAT_ACT|\$IPO_MODE)[ \t]*=[ \t]*([^\n]*)"
    r"|BAS[ \t]*\([ \t]*#(TOOL|BASE)[ \t]*,([^)\n]*)\))",
    re.IGNORECASE | re.MULTILINE,
)
_SPLINE = re.compile(
    r"^[ \t]*(?:(ENDSPLINE)\b|(?:PTP_)?SPLINE\b(?:[ \t]+WITH\b([^\n]*))?)", re.IGNORECASE | re.MULTILINE
)
_WITH = re.compile(r"(\$TOOL|\$BASE)\s*=\s*(.*)", re.IGNORECASE)
_FORM = re.compile(r"S(?:TOOL2?|BASE)\s*\(\s*(\w+)", re.IGNORECASE)
_COMPONENT = re.compile(rf"\s*([A-Z]\w*)\s+({NUMBER})\s*", re.IGNORECASE)
_MEMBER = re.compile(r"(TOOL_NO|BASE_NO)\s+(\d+)|IPO_FRAME\s+(#\w+)", re.IGNORECASE)
_POSE, _AXES = ("X", "Y", "Z", "A", "B", "C"), ("A1", "A2", "A3", "A4", "A5", "A6")
_NULL = ("$NULLFRAME", "TOOL_DATA[0]", "BASE_DATA[0]")


@dataclass(frozen=True)
class _Literal:
    """Components in braces."""

    file: int
    start: int
    name: str
    components: Mapping[str, tuple[int, int]]


@dataclass(frozen=True)
class _Held:
    """Tool and base that hold somewhere in the text, or why they are not known.

    Attributes:
        tool, base: T_flange_tool and T_base_frame.
        outside: Whether the tool is not on the robot.
        of_tool, of_base: Places of the positions that they were set to.
    """

    tool: pin.SE3 | str
    base: pin.SE3 | str
    outside: bool = False
    of_tool: tuple[tuple[int, int], ...] = ()
    of_base: tuple[tuple[int, int], ...] = ()


def read_krl(path: Path | str, frames: Mapping[str, pin.SE3 | str]) -> RobotProgram:
    """Read a program and the `.dat` file beside it, if there is one.

    Args:
        path: The `.src` file.
        frames: `TOOL_DATA[1]`, `BASE_DATA[2]`, ... that it does not set.

    Raises:
        DataError: The message names file and line.
    """
    beside = [Path(path).with_suffix(suffix) for suffix in (".dat", ".DAT", ".Dat")]
    data_files = [file for file in beside if file.is_file()][:1]
    return _Reader([Source.read(file, _WHAT, _BLANK) for file in (Path(path), *data_files)], frames).program()


def krl_frames(path: Path | str) -> dict[str, pin.SE3 | str]:
    """Return `TOOL_DATA[...]` and `BASE_DATA[...]` of a file, such as `$config.dat`."""
    return _Reader([Source.read(path, "a KRL data list", _BLANK)], {}).frames


class _Reader:
    def __init__(self, sources: list[Source], frames: Mapping[str, pin.SE3 | str]) -> None:
        self.sources, self.collector = sources, Collector()
        self.declared: dict[str, _Literal | None] = {}
        self.forms: dict[str, str] = {}
        self.frames: dict[str, pin.SE3 | str] = {**frames}
        for file, source in enumerate(sources):
            self._declarations(file, source)
        self.set_later = {match[1].upper() for match in _ASSIGNED.finditer(sources[0].code)}
        self.held = _Held(
            "nothing before it selects a tool (BAS, $TOOL, an inline form)",
            "nothing before it selects a base (BAS, $BASE, an inline form)",
        )

    def _declarations(self, file: int, source: Source) -> None:
        for match in _DECLARED.finditer(source.code):
            opening, name = match.end(), match[2].upper()
            end = closing(source.code, opening)
            if end is None or name in ("$TOOL", "$BASE"):
                continue
            if (match[1] or "").upper() == "FDAT":
                self.forms[name] = source.code[opening : end + 1]
            elif name.startswith(("TOOL_DATA[", "BASE_DATA[")):
                self.frames[name] = self._frame(file, opening, end + 1, name)
            elif match[1] or name not in self.declared:
                self.declared[name] = self._literal(file, opening, end + 1, match[2])

    def _literal(self, file: int, start: int, end: int, name: str = "") -> _Literal | None:
        """What stands in braces; None where it is not plain numbers."""
        code = self.sources[file].code
        if code[start] != "{" or closing(code, start) != end - 1:
            return None
        first = re.compile(r"\{\s*(?:\w+\s*:)?").match(code, start)  # the type may stand first
        assert first is not None
        components = {}
        for left, right in arguments(code, first.end(), end - 1):
            match = _COMPONENT.fullmatch(code, left, right)
            if match is None:
                return None
            components[match[1].upper()] = match.span(2)
        return _Literal(file, start, name, components)

    def _frame(self, file: int, start: int, end: int, name: str) -> pin.SE3 | str:
        literal = self._literal(file, start, end)
        if literal is None or not set(_POSE) <= set(literal.components):
            return f"{name} is not six plain numbers"
        return pose_of([cell.value for cell in self._cells(literal, _POSE)], "zyx")

    def _cells(self, literal: _Literal, names: tuple[str, ...]) -> tuple[Number, ...]:
        units = [MILLIMETRE if name in "XYZ" else DEGREE for name in names]
        spans = [literal.components[name] for name in names]
        return cells_at(self.sources[literal.file], literal.file, spans, units)

    def program(self) -> RobotProgram:
        """Walk through the text."""
        code = self.sources[0].code
        matches = [*_MOVE.finditer(code), *_STATE.finditer(code), *_SPLINE.finditer(code)]
        outside = self.held
        for match in sorted(matches, key=lambda match: match.start()):
            if match.re is _STATE:
                self._set(match)
            elif match.re is _SPLINE:
                if match[1]:
                    self.held = outside
                else:
                    outside = self.held
                    self._with(match.start(2), match.end(2))
            else:
                held = self.held
                self._move(match)
                self.held = held
        return self.collector.program(LANGUAGE, self.sources)

    def _set(self, match: re.Match[str]) -> None:
        """Take in a tool or base that holds from here on."""
        variable, value = (match[1] or "").upper(), (match[2] or "").strip().upper()
        if match[3]:
            self._choose(match[3].upper(), match[4].strip())
        elif variable == "$IPO_MODE":
            self.held = replace(self.held, outside=value == "#TCP")
        elif variable == "FDAT_ACT":
            self._form(value)
        else:
            self._hold(variable, match.start(2), value)

    def _hold(self, variable: str, start: int, value: str) -> None:
        """Take in what `$TOOL` or `$BASE` is set to."""
        code = self.sources[0].code
        end = closing(code, start) if value.startswith("{") else None
        frame = self._frame(0, start, end + 1, variable) if end is not None else self._named(value)
        literal = self.declared.get(value.replace(" ", ""))
        constants = ((literal.file, literal.components["X"][0]),) if literal and "X" in literal.components else ()
        if variable == "$TOOL":
            self.held = replace(self.held, tool=frame, of_tool=constants)
        else:
            self.held = replace(self.held, base=frame, of_base=constants)

    def _with(self, start: int, end: int) -> None:
        """Take in what a motion or a spline sets for itself, behind WITH."""
        code = self.sources[0].code
        for left, right in arguments(code, start, end):
            match = _WITH.match(code, left, right)
            if match is None:
                continue
            held, variable, form = self.held, match[1].upper(), _FORM.match(match[2])
            if form is None:
                self._hold(variable, match.start(2), match[2].strip().upper())
                continue
            self._form(form[1].upper())
            if variable == "$BASE":
                self.held = replace(held, base=self.held.base, of_base=(), outside=self.held.outside)
            else:
                self.held = replace(held, tool=self.held.tool, of_tool=(), outside=self.held.outside)

    def _choose(self, kind: str, number: str) -> None:
        frame = self._named(f"{kind}_DATA[{number}]")
        if kind == "TOOL":
            self.held = replace(self.held, tool=frame, of_tool=())
        else:
            self.held = replace(self.held, base=frame, of_base=())

    def _named(self, value: str) -> pin.SE3 | str:
        name = value.replace(" ", "")
        if name in _NULL:
            return pin.SE3.Identity()
        if name in self.frames:
            return self.frames[name]
        literal = self.declared.get(name)
        if literal is not None and set(_POSE) <= set(literal.components) and name not in self.set_later:
            return pose_of([cell.value for cell in self._cells(literal, _POSE)], "zyx")
        return f"{value.lower() if '[' not in name else name} is not known here; give $config.dat with --frames"

    def _form(self, name: str) -> None:
        """Take in the tool and base of an inline form."""
        members = {(m[1] or "IPO").upper(): (m[2] or m[3]).upper() for m in _MEMBER.finditer(self.forms.get(name, ""))}
        if not {"TOOL_NO", "BASE_NO"} <= set(members):
            self.held = _Held(f"{name} is declared nowhere here", f"{name} is declared nowhere here")
            return
        self._choose("TOOL", members["TOOL_NO"])
        self._choose("BASE", members["BASE_NO"])
        self.held = replace(self.held, outside=members.get("IPO") == "#TCP")

    def _move(self, match: re.Match[str]) -> None:
        """Take in one motion."""
        source, word = self.sources[0], match[1].upper()
        pieces = re.split(r"(?i)\bWITH\b", match[3])
        if len(pieces) > 1:
            self._with(match.end(3) - len(pieces[-1]), match.end(3))
        end = match.start(3) + len(pieces[0])
        spans = list(arguments(source.code, match.start(3), end))
        for span in spans[: 2 if word.endswith("CIRC") else 1]:
            start = span[0]
            stop = re.compile(r"\s+C_(?:PTP|DIS|ORI|VEL|SPL)\b.*", re.IGNORECASE | re.DOTALL)
            span = start, start + len(stop.sub("", source.code[slice(*span)]).rstrip())
            try:
                if match[2]:
                    raise LeftOutError("is relative to where the robot is")
                self.collector.take(self._target(span), source, start)
            except LeftOutError as why:
                self.collector.leave(source, start, source.shown(*span), str(why))

    def _target(self, span: tuple[int, int]) -> ProgramTarget:
        text = self.sources[0].code[slice(*span)].strip()
        name = text.upper()
        literal = self._literal(0, *span) if text.startswith("{") else self.declared.get(name)
        if literal is None:
            if name in self.declared or text.startswith("{"):
                raise LeftOutError("is not plain numbers")
            raise LeftOutError("is declared nowhere here" if re.fullmatch(r"\w+", text) else "is computed at run time")
        if name in self.set_later:
            raise LeftOutError("is set while the program runs")
        code = self.sources[literal.file].code
        numbers = {key: float(code[slice(*place)]) for key, place in literal.components.items()}
        if any(numbers.get(f"E{k}", 0.0) for k in range(1, 7)):
            raise LeftOutError("moves external axes, which the description does not have")
        path, line = self.sources[literal.file].path, self.sources[literal.file].line(literal.start)
        if set(_AXES) <= set(numbers):
            return ProgramTarget(line, path, literal.name, self._cells(literal, _AXES), None)
        if not set(_POSE) <= set(numbers):
            raise LeftOutError("gives only a part of a position; the rest depends on where the robot is")
        held = self.held
        for frame in (held.tool, held.base, "the tool is not on the robot" if held.outside else None):
            if isinstance(frame, str):
                raise LeftOutError(frame)
        assert isinstance(held.tool, pin.SE3)
        assert isinstance(held.base, pin.SE3)
        cells, configuration = self._cells(literal, _POSE), _configuration(numbers)
        return ProgramTarget(
            line,
            path,
            literal.name,
            cells,
            "zyx",
            held.base,
            held.tool,
            configuration,
            constants=held.of_base + held.of_tool,
        )


def _configuration(numbers: Mapping[str, float]) -> Configuration | None:
    """S: bit 0 the side of axis 1, bit 1 of axis 3. T: the signs of the axes. Bit 2 of S says no more than these."""
    text = ", ".join(f"{key} {numbers[key]:g}" for key in ("S", "T") if key in numbers)
    if not text:
        return None
    ranges = {}
    if "T" in numbers:
        turns = int(numbers["T"])
        ranges = {k: (-np.inf, 0.0) if turns >> k & 1 else (0.0, np.inf) for k in range(6)}
    status = int(numbers["S"]) if "S" in numbers else None
    behind, bent = (None, None) if status is None else (bool(status & 1), bool(status & 2))
    return Configuration(text, ranges, behind=behind, bent=bent)
