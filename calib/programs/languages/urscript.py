"""Targets of URScript, the language of Universal Robots.

Read are `movej`, `movel`, `movep`, `movec`, `servoj` and `servoc` with joint lists `[...]` and poses `p[...]`, literal
or variables that are set once to a literal; `get_inverse_kin(POSE, qnear=JOINTS)`; `pose_trans(FRAME, POSE)` with a
constant frame (a feature); numbers in metres and radians, or `d2r(...)`. The tool is that of the last `set_tcp` before
in the text, or `TCP` of the given frames.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import pinocchio as pin

from calib.programs.languages.orientations import pose_of
from calib.programs.languages.robot_program import (
    DEGREE,
    NUMBER,
    Collector,
    LeftOutError,
    Number,
    ProgramTarget,
    RobotProgram,
    Source,
    arguments,
    cells_at,
    closing,
)

LANGUAGE, SUFFIXES = "URScript", (".script", ".urscript")
_BLANK = r'"[^"\n]*"|#[^\n]*'
_MOVES = {"movej": 1, "movel": 1, "movep": 1, "movec": 2, "servoj": 1, "servoc": 1}
_CALL = re.compile(rf"\b({'|'.join(_MOVES)}|set_tcp)\s*\(")
_RELATIVE = re.compile(r"\b(speedj|speedl|force_mode|path_offset_enable|conveyor_pulse_decode|track_conveyor_\w+)\s*\(")
_ASSIGNED = re.compile(
    r"(?:^|[;\n])[ \t]*(?:global[ \t]+|local[ \t]+)?([A-Za-z_]\w*)[ \t]*(?:\[[^\]\n]*\])?[ \t]*=(?!=)"
)
_PARAMETERS = re.compile(r"\bdef[ \t]+\w+[ \t]*\(([^)\n]*)\)")
_NAME = re.compile(r"[A-Za-z_]\w*")
_ANGLE = re.compile(rf"d2r\s*\(\s*({NUMBER})\s*\)")
_KEYWORD = re.compile(r"(?:pose|q|pose_to|pose_via)\s*=\s*")
_FUNCTION = re.compile(r"(get_inverse_kin|pose_trans)\s*\(")


@dataclass(frozen=True)
class _Literal:
    """A list or a pose that is written out."""

    cells: tuple[Number, ...]
    is_pose: bool
    name: str = ""

    @property
    def values(self) -> tuple[float, ...]:
        return tuple(cell.value for cell in self.cells)

    @property
    def place(self) -> tuple[int, int]:
        return self.cells[0].file, self.cells[0].start


@dataclass(frozen=True)
class _Goal:
    """A target, the frame that it is in, the constants that make the frame, and joints that it is near to."""

    literal: _Literal
    frame: pin.SE3 = field(default_factory=pin.SE3.Identity)
    constants: tuple[tuple[int, int], ...] = ()
    near: tuple[float, ...] = ()


def read_urscript(path: Path | str, frames: Mapping[str, pin.SE3]) -> RobotProgram:
    """Read a program.

    Args:
        path: The file.
        frames: Tools that the program does not set: `TCP`.

    Raises:
        DataError: The message names file and line.
    """
    source = Source.read(path, "a URScript program", _BLANK)
    reader = _Reader(source, frames.get("TCP"))
    return reader.program()


class _Reader:
    def __init__(self, source: Source, tool: pin.SE3 | None) -> None:
        self.source, self.code, self.tool = source, source.code, tool
        self.tool_constant: tuple[tuple[int, int], ...] = ()
        self.collector = Collector()
        self.constants = self._constants()

    def _constants(self) -> dict[str, _Literal | None]:
        """Variables that are set once, to a list or pose; None for those that are set to something else, or again."""
        constants: dict[str, _Literal | None] = {}
        for match in _PARAMETERS.finditer(self.code):
            constants |= dict.fromkeys(_NAME.findall(match[1]))
        for match in _ASSIGNED.finditer(self.code):
            name, at = match[1], match.end()
            end = re.compile(r"[^\n;]*").match(self.code, at)
            assert end is not None
            first = at + len(end[0]) - len(end[0].lstrip())
            whole = "[" not in match[0]
            literal = self._literal(first, at + len(end[0].rstrip()), name) if whole and end[0].strip() else None
            constants[name] = literal if name not in constants else None
        return constants

    def _literal(self, start: int, end: int, name: str = "") -> _Literal | None:
        """The list or pose between two places; None where it is none of six plain numbers."""
        is_pose = self.code.startswith("p[", start)
        opening = start + is_pose
        if not self.code.startswith("[", opening) or closing(self.code, opening) != end - 1:
            return None
        spans, units = [], []
        for first, last in arguments(self.code, opening + 1, end - 1):
            angle = _ANGLE.fullmatch(self.code, first, last)
            if angle is None and not re.fullmatch(NUMBER, self.code[first:last]):
                return None
            spans.append(angle.span(1) if angle else (first, last))
            units.append(DEGREE if angle else 1.0)
        if len(spans) != 6:
            return None
        return _Literal(cells_at(self.source, 0, spans, units), is_pose, name)

    def program(self) -> RobotProgram:
        """Walk through the text."""
        for match in _RELATIVE.finditer(self.code):
            self.collector.leave(
                self.source, match.start(), match[1], "moves the robot by an amount that it computes at run time"
            )
        for match in _CALL.finditer(self.code):
            end = closing(self.code, match.end() - 1)
            defined = re.search(r"\bdef[ \t]+$", self.code[max(0, match.start() - 40) : match.start()])
            if defined:
                continue
            if end is None:
                self.collector.leave(self.source, match.start(), match[0], "has a bracket that is not closed")
                continue
            given = list(arguments(self.code, match.end(), end))
            if match[1] == "set_tcp":
                self._set_tool(given[:1])
                continue
            for span in self._targets_first(given)[: _MOVES[match[1]]]:
                self._go(span)
        return self.collector.program(LANGUAGE, [self.source])

    def _targets_first(self, given: list[tuple[int, int]]) -> list[tuple[int, int]]:
        """Arguments with the targets first, which may stand anywhere if they are named."""
        return sorted(given, key=lambda span: _KEYWORD.match(self.code, *span) is None and self._is_named(span))

    def _is_named(self, span: tuple[int, int]) -> bool:
        return re.compile(r"[A-Za-z_]\w*\s*=(?!=)").match(self.code, *span) is not None

    def _set_tool(self, given: list[tuple[int, int]]) -> None:
        """Take in a tool that holds from here on."""
        literal = self._constant(*given[0]) if given else None
        known = literal is not None and literal.is_pose
        self.tool = pose_of(literal.values, "vector") if known and literal else None
        self.tool_constant = (literal.place,) if known and literal else ()

    def _constant(self, start: int, end: int) -> _Literal | None:
        text = self.code[start:end]
        return self.constants.get(text) if _NAME.fullmatch(text) else self._literal(start, end)

    def _go(self, span: tuple[int, int]) -> None:
        """Take in one target of a move."""
        start, end = span
        keyword = _KEYWORD.match(self.code, start, end)
        start = keyword.end() if keyword else start
        try:
            goal = self._target(start, end)
            literal = goal.literal
            if literal.is_pose and self.tool is None:
                raise LeftOutError("no set_tcp before it selects a tool; add one, or TCP to the frames (--frames)")
        except LeftOutError as why:
            self.collector.leave(self.source, start, self.source.shown(start, end), str(why))
            return
        target = ProgramTarget(
            self.source.line(literal.cells[0].start),
            self.source.path,
            literal.name,
            literal.cells,
            "vector" if literal.is_pose else None,
            goal.frame,
            self.tool if literal.is_pose and self.tool is not None else pin.SE3.Identity(),
            None,
            goal.near,
            goal.constants + self.tool_constant if literal.is_pose else (),
        )
        self.collector.take(target, self.source, start)

    def _target(self, start: int, end: int) -> _Goal:
        literal = self._constant(start, end)
        if literal is not None:
            return _Goal(literal)
        call = _FUNCTION.match(self.code, start, end)
        if call is None or closing(self.code, call.end() - 1) != end - 1:
            name = _NAME.fullmatch(self.code[start:end])
            raise LeftOutError("is set more than once, or not to plain numbers" if name else "is computed at run time")
        given = list(arguments(self.code, call.end(), end - 1))
        if call[1] == "pose_trans":
            return self._in_feature(given)
        goal = self._pose_target(*given[0]) if given else None
        if goal is None:
            raise LeftOutError("is computed at run time")
        for first, last in given[1:2]:
            keyword = re.compile(r"qnear\s*=\s*").match(self.code, first, last)
            joints = self._constant(keyword.end() if keyword else first, last)
            if joints is not None and not joints.is_pose:
                goal = replace(goal, near=joints.values)
        return goal

    def _in_feature(self, given: list[tuple[int, int]]) -> _Goal:
        feature = self._constant(*given[0]) if len(given) == 2 else None
        if feature is None or not feature.is_pose:
            raise LeftOutError("is computed at run time: its frame is not constant")
        goal = self._pose_target(*given[1])
        frame = pose_of(feature.values, "vector") * goal.frame
        return replace(goal, frame=frame, constants=(feature.place, *goal.constants))

    def _pose_target(self, start: int, end: int) -> _Goal:
        goal = self._target(start, end)
        if not goal.literal.is_pose:
            raise LeftOutError("is computed at run time")
        return goal
