"""Targets of URScript, the language of Universal Robots.

Read are `movej`, `movel`, `movep`, `movec`, `servoj` and `servoc` with joint lists `[...]` and poses `p[...]`, literal
or variables that are set once to a literal; `get_inverse_kin(POSE, qnear=JOINTS)`; `pose_trans(FRAME, POSE)` with a
constant frame (a feature); numbers in metres and radians, or `d2r(...)`. The tool is that of `set_tcp` on every way to
the move, or `TCP` of the given frames. Functions get the values of their arguments, so none sets what it is given.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import pinocchio as pin

from calib.core.base.errors import DataError
from calib.programs.languages.control_flow import Flow, State, Unknown
from calib.programs.languages.data_uses import DataUses
from calib.programs.languages.harmless import URSCRIPT, call_remedy, names
from calib.programs.languages.orientations import pose_of
from calib.programs.languages.robot_program import (
    DEGREE,
    Collector,
    LeftOutError,
    Number,
    ProgramTarget,
    RobotProgram,
    Source,
    cells_at,
)
from calib.programs.languages.tokens import Code, Span, word_pattern

LANGUAGE, SUFFIXES = "URScript", (".script", ".urscript")
_WORDS = word_pattern(r"#[^\n]*|\$[^\n]*", r"[^\W\d]\w*", r"[=!<>]=|\*\*|[-+*/%^()\[\]{}=<>,.:;]")
_MOVES = {"movej": 1, "movel": 1, "movep": 1, "movec": 2, "servoj": 1, "servoc": 1}
_COMPUTED = names(
    "speedj speedl force_mode path_offset_enable conveyor_pulse_decode track_conveyor_linear track_conveyor_circular"
)
_ROUTINES = ("def", "thread", "sec")
_STARTS = names("def thread sec while if elif else switch case default end break continue return halt")
_NO_TOOL = "no set_tcp before it selects a tool; add one, or TCP to the frames (--frames)"


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
class _Tool:
    """Numbers of a tool [m, rad], and the place of the variable that has them."""

    values: tuple[float, ...]
    places: tuple[tuple[int, int], ...] = ()


@dataclass(frozen=True)
class _Goal:
    """A target, the frame that it is in, the constants that make the frame, and joints that it is near to."""

    literal: _Literal
    frame: pin.SE3 = field(default_factory=pin.SE3.Identity)
    constants: tuple[tuple[int, int], ...] = ()
    near: tuple[float, ...] = ()


def read_urscript(
    path: Path | str, frames: Mapping[str, pin.SE3 | str], harmless: Collection[str] = ()
) -> RobotProgram:
    """Read a program.

    Args:
        path: The file.
        frames: Tools that the program does not set: `TCP`.
        harmless: Functions defined elsewhere that select no tool.

    Raises:
        DataError: The message names file and line.
    """
    return _Reader(Source.read(path, "a URScript program"), frames.get("TCP"), harmless).program()


class _Reader:
    def __init__(self, source: Source, tool: pin.SE3 | str | None, harmless: Collection[str]) -> None:
        self.source, self.code, self.given = source, Code(source, _WORDS, fold_case=False, lines="outside"), tool
        self.harmless = URSCRIPT | set(harmless)
        self.flow = Flow({"tool": Unknown(_NO_TOOL) if tool is None else "TCP"})
        self.collector, self.uses = Collector(), DataUses()
        self.constants: dict[str, _Literal | None] = {}
        self.functions = set[str]()
        tokens = self.code.tokens
        for at in self.code.names(0, len(tokens) - 2):
            if tokens[at].text in _ROUTINES and self.code.is_mark(at + 2, "("):
                parameters = [tokens[first].text for first, _ in self.code.split(at + 3, self.code.partner[at + 2])]
                self.functions.add(tokens[at + 1].text)
                self.constants |= dict.fromkeys(parameters)
                for name in parameters:
                    self.uses.compute(name, [f"{tokens[at + 1].text}()"])

    def program(self) -> RobotProgram:
        """Read all statements, and then what holds at each move."""
        at, end = 0, len(self.code.tokens)
        while at < end:
            token = self.code.tokens[at]
            if token.kind == "line" or self.code.is_mark(at, ";", ":"):
                at += 1
            elif token.kind == "name" and token.text in _STARTS:
                at = self._keyword(at, token.text)
            else:
                stop = self._end(at)
                self._statement(at, stop)
                at = stop
        if self.flow.routine or self.flow.blocks:
            line = self.flow.blocks[-1].line if self.flow.blocks else self.source.line(len(self.source.text))
            raise DataError(f"{self.source.path}, line {line}: has a part that no 'end' ends; correct it")
        self.flow.finish_all()
        self.uses.follow()
        self.flow.follow()
        return self.collector.program(LANGUAGE, [self.source])

    def _end(self, at: int) -> int:
        """Where the statement that begins at a word ends."""
        code = self.code
        while code.tokens[at].kind != "line" and not code.is_mark(at, ";"):
            at = code.partner[at] + 1
            if code.tokens[at].kind == "name" and code.tokens[at].text in _STARTS:
                break
        return at

    def _keyword(self, at: int, word: str) -> int:
        """Take in a word that begins, ends or leaves a part of the program; return where it goes on."""
        code, flow, line = self.code, self.flow, self.code.line(at)
        stop = min(code.until(at + 1, self._end(at), ":"), self._end(at))
        if word in _ROUTINES:
            flow.begin(code.tokens[at + 1].text, code.where(at), at_any_time=word != "def")
            return stop
        if word == "end":
            if flow.blocks:
                flow.close()
            elif flow.routine:
                flow.finish()
            else:
                raise DataError(f"{code.where(at)}: 'end' ends nothing; correct it")
            return at + 1
        if word in ("elif", "else", "case", "default"):
            if not flow.blocks or flow.blocks[-1].loop:
                raise DataError(f"{code.where(at)}: '{word}' belongs to nothing; correct it")
            flow.next_choice()
        elif word == "while":
            flow.open_loop(word, line)
        names = self._expression(at + 1, stop)
        if word == "return":
            self.uses.compute(flow.routine, names)
        else:
            self.uses.decide(names, line)
        if word in ("if", "switch"):
            flow.open_choice(word, line)
        if word in ("if", "switch", "elif", "case", "while"):
            flow.pass_over()
        elif word in ("break", "continue"):
            flow.leave_loop(again=word == "continue")
        elif word in ("return", "halt"):
            flow.jump(word)
        return stop

    def _statement(self, first: int, stop: int) -> None:
        """Take in an assignment, or an expression."""
        code = self.code
        while code.tokens[first].text in ("global", "local") and first + 1 < stop:
            first += 1
        equals = code.until(first, stop, "=")
        if equals == stop:
            self._expression(first, stop)
            return
        names = self._expression(equals + 1, stop) | self._expression(first + 1, equals)
        name = code.tokens[first].text
        literal = self._literal(equals + 1, stop, name) if equals == first + 1 else None
        self.constants[name] = literal if name not in self.constants else None
        self.uses.compute(name, names)

    def _expression(self, first: int, stop: int) -> set[str]:
        """Take in the calls of an expression; return the names that it computes with."""
        code, tokens, moved = self.code, self.code.tokens, set[int]()
        for at in code.calls(first, stop):
            name, close = tokens[at].text, code.partner[at + 1]
            whole = at == first and close + 1 == stop
            if name in self.functions:
                self.uses.compute(f"{name}()", self._names(at + 2, close))
                self.flow.call(name, maybe=not whole)
            elif name in _MOVES:
                self.flow.move(tokens[at].start, lambda state, at=at: self._move(at, state))  # type: ignore[misc]
                moved.update(range(at, close + 1))
            elif name == "set_tcp":
                span = next(iter(code.split(at + 2, close)), None) if whole else None
                self.flow.change(["tool"], lambda state, span=span: {**state, "tool": self._tool(span)})  # type: ignore[misc]
            elif name in _COMPUTED:
                why = "moves the robot by an amount that it computes at run time"
                self.collector.leave(self.source, tokens[at].start, name, why)
            elif name not in self.harmless and not (at and code.is_mark(at - 1, ".")):
                why = call_remedy(name, code.line(at), "select another tool")
                self.flow.lose(why, ["tool"])
                self.uses.decide(self._names(at + 2, close), code.line(at))
        return {tokens[at].text for at in code.names(first, stop) if at not in moved}

    def _names(self, first: int, stop: int) -> set[str]:
        return {self.code.tokens[at].text for at in self.code.names(first, stop)}

    def _literal(self, first: int, stop: int, name: str = "") -> _Literal | None:
        """The list or pose of these words; None where it is none of six plain numbers."""
        code, tokens = self.code, self.code.tokens
        is_pose = (
            tokens[first].text == "p" and code.is_mark(first + 1, "[") and tokens[first].end == tokens[first + 1].start
        )
        inside = code.inside(first + is_pose, stop, "[")
        if inside is None:
            return None
        spans, units = [], []
        for left, right in code.split(*inside):
            angle = code.inside(left + 1, right, "(") if tokens[left].text == "d2r" else None
            span = code.number(*angle) if angle else code.number(left, right)
            if span is None:
                return None
            spans.append(span)
            units.append(DEGREE if angle else 1.0)
        return _Literal(cells_at(self.source, 0, spans, units), is_pose, name) if len(spans) == 6 else None

    def _constant(self, first: int, stop: int) -> _Literal | None:
        """The literal that these words are or name."""
        single = stop == first + 1 and self.code.tokens[first].kind == "name"
        return self.constants.get(self.code.tokens[first].text) if single else self._literal(first, stop)

    def _tool(self, span: Span | None) -> _Tool | Unknown:
        literal = self._constant(*span) if span else None
        if literal is None or not literal.is_pose:
            return Unknown(_NO_TOOL)
        return _Tool(literal.values, (literal.place,) if literal.name else ())

    def _move(self, at: int, state: State | None) -> None:
        """Take in the targets of a move, which may stand anywhere if they are named."""
        code = self.code
        given = code.split(at + 2, code.partner[at + 1])
        goals = sorted(given, key=lambda span: self._named(*span)[1] not in ("", "pose", "q", "pose_to", "pose_via"))
        for span in goals[: _MOVES[code.tokens[at].text]]:
            self._go(self._named(*span)[0], span[1], state)

    def _named(self, first: int, stop: int) -> tuple[int, str]:
        """Where the value of an argument begins, and its name, empty if it has none."""
        named = stop > first + 1 and self.code.is_mark(first + 1, "=")
        return (first + 2, self.code.tokens[first].text) if named else (first, "")

    def _go(self, first: int, stop: int, state: State | None) -> None:
        """Take in one target of a move."""
        start, goal = self.code.tokens[first].start, None
        try:
            goal = self._target(first, stop)
            literal, tool = goal.literal, None if state is None else state["tool"]
            why = self.uses.why_not(literal.name)
            if state is None:
                raise LeftOutError("is a place to which the program never comes")
            if why:
                raise LeftOutError(why)
            if literal.is_pose and isinstance(tool, Unknown):
                raise LeftOutError(tool.why if tool.why == _NO_TOOL else f"its tool {tool.why}")
            if literal.is_pose and isinstance(self.given, str) and tool == "TCP":
                raise LeftOutError(self.given)
        except LeftOutError as refusal:
            if goal is not None and state is not None:
                self.collector.refuse(goal.literal.cells, self.source, start)
            self.collector.leave(self.source, start, self.code.shown(first, stop), str(refusal))
            return
        pose, places = pin.SE3.Identity(), goal.constants
        if literal.is_pose and isinstance(tool, _Tool):
            pose, places = pose_of(tool.values, "vector"), places + tool.places
        elif literal.is_pose:
            assert isinstance(self.given, pin.SE3)
            pose = self.given
        target = ProgramTarget(
            self.source.line(literal.cells[0].start),
            self.source.path,
            literal.name,
            literal.cells,
            "vector" if literal.is_pose else None,
            goal.frame,
            pose,
            None,
            goal.near,
            places if literal.is_pose else (),
        )
        self.collector.take(target, self.source, start)

    def _target(self, first: int, stop: int) -> _Goal:
        literal = self._constant(first, stop) if stop > first else None
        if literal is not None:
            return _Goal(literal)
        code, word = self.code, self.code.tokens[first]
        inside = code.inside(first + 1, stop, "(")
        if word.text not in ("get_inverse_kin", "pose_trans") or word.text in self.functions or inside is None:
            single = stop == first + 1 and word.kind == "name"
            several = "is set more than once, or not to plain numbers"
            raise LeftOutError(several if single else "is computed at run time")
        given = code.split(*inside)
        if word.text == "pose_trans":
            return self._in_feature(given)
        if not given or len(given) > 4 or any(self._named(*span)[1] == "tcp" for span in given):
            raise LeftOutError("is computed at run time")
        goal = self._pose_target(*given[0])
        for left, right in given[1:2]:
            joints = self._constant(self._named(left, right)[0], right)
            if joints is not None and not joints.is_pose:
                goal = replace(goal, near=joints.values)
        return goal

    def _in_feature(self, given: list[Span]) -> _Goal:
        feature = self._constant(*given[0]) if len(given) == 2 else None
        if feature is None or not feature.is_pose:
            raise LeftOutError("is computed at run time: its frame is not constant")
        goal = self._pose_target(*given[1])
        frame = pose_of(feature.values, "vector") * goal.frame
        return replace(goal, frame=frame, constants=(feature.place, *goal.constants))

    def _pose_target(self, first: int, stop: int) -> _Goal:
        goal = self._target(first, stop)
        if not goal.literal.is_pose:
            raise LeftOutError("is computed at run time")
        return goal
