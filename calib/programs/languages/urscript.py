"""Targets of URScript, the language of Universal Robots.

The reader takes `movej`, `movel`, `movep`, `movec`, `servoj` and `servoc` with joint lists `[...]` and poses `p[...]`,
literal or in variables that are set once to a literal; `get_inverse_kin(POSE, qnear=JOINTS)`; `pose_trans(FRAME, POSE)`
with a constant frame (a feature); numbers in metres and radians, or `d2r(...)`. The tool comes from `set_tcp` on every
path to the move, or from `TCP` in the given frames. Arguments are passed by value, so no function sets its arguments.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar

from calib.programs.languages.control_flow import State, Unknown
from calib.programs.languages.reader import Data, Frames, Reader, as_selected_frame
from calib.programs.languages.robot_program import Frame, LeftOutError, ProgramTarget, Visit
from calib.programs.languages.tokens import DEGREE, Number, ProgramSource, ProgramWords, Span, word_list, word_pattern

SUFFIXES = (".script", ".urscript")
_WORDS = word_pattern(r"#[^\n]*|\$[^\n]*", r"[^\W\d]\w*", r"[=!<>]=|\*\*|[-+*/%^()\[\]{}=<>,.:;]")
_MOVES = {"movej": 1, "movel": 1, "movep": 1, "movec": 2, "servoj": 1, "servoc": 1}
_GOALS = ("", "pose", "q", "pose_to", "pose_via")
_NO_TOOL = "no set_tcp before it selects a tool; add one, or TCP to the frames (--frames)"
_AT_RUN_TIME = "is computed at run time"
_COMPUTED = word_list("URScript COMPUTED", fold_case=False)  # functions whose motion has a goal that they compute
_MOVED_ALONG = {
    "force_mode": "end_force_mode",
    "path_offset_enable": "path_offset_disable",
    "track_conveyor_linear": "stop_conveyor_tracking",
    "track_conveyor_circular": "stop_conveyor_tracking",
}
"""Functions that begin to shift all targets at run time, and those that end it.

The name of the second is also that of a setting, which is unknown while targets are shifted.
"""


@dataclass(frozen=True, kw_only=True)
class _Goal(Data):
    """A target, its frame, and stated joints near it."""

    frame: Frame = field(default_factory=Frame)
    near: tuple[float, ...] = ()


class UrscriptReader(Reader):
    """Reads a program; `TCP` in the given frames is the tool before the first `set_tcp`."""

    language, by_value, lost, danger = "URScript", True, ("tool",), "select another tool"
    known = word_list("URScript", fold_case=False)
    ROUTINES, THREADS = "def thread sec", ("thread", "sec")
    WORDS: ClassVar = {
        "begin": ROUTINES,
        "condition branch": "if switch",
        "begin_branch condition pass_over": "elif case",
        "begin_branch": "else default",
        "repeat condition pass_over": "while",
        "close": "end",
        "leave_loop": "break",
        "begin_again": "continue",
        "leave": "return",
        "condition halt": "halt",
        "skip": "global local",
    }

    def __init__(self, path: Path | str, frames: Frames, harmless: Collection[str]) -> None:
        source = ProgramSource.read(path, "a URScript program")
        code = ProgramWords(source, _WORDS, fold_case=False, lines="outside", ends=";:")
        start = {"tool": frames.get("TCP", Unknown(_NO_TOOL, whole=True)), **dict.fromkeys(_MOVED_ALONG.values())}
        super().__init__([code], start, frames, harmless)

    def close(self, at: int, behind: int) -> int:
        """End branches, a loop or a routine; all end with the same word."""
        if not self.blocks:
            return self.finish(at, behind)
        self.close_block()
        return behind

    def statement(self, at: int, stop: int) -> None:
        """Process an assignment or an expression."""
        code, name = self.code, self.code.word(at)
        equals = code.find_mark(at, stop, "=")
        if equals == stop:
            self.expression(at, stop)
            return
        self.assign(at, stop, equals)
        if equals > at + 1 or name in self.declared or self._numbers((equals + 1, stop)) is None:
            self.uses.note_change(name, "is set more than once, or not to plain numbers")
        else:
            self.declare(name, Data(name, 0, (equals + 1, stop)))

    def names(self, first: int, stop: int) -> set[str]:
        """Return the names of data in a span of words, without the targets of moves."""
        moves = [at for at in self.code.calls(first, stop) if self.code.word(at) in _MOVES]
        moved = {k for at in moves for k in range(at, self.code.partner[at + 1])} if moves else ()
        return {self.code.word(at) for at in self.code.names(first, stop) if at not in moved}

    def read_known_call(self, at: int, span: Span, *, maybe: bool) -> bool:
        """Process a call of a built-in function, such as a move; return whether the call is known."""
        name = self.code.word(at)
        if name in _MOVES:
            self.flow.move(at, lambda state: self._move(name, span, state))
        elif name == "set_tcp":
            given = (0, 0) if maybe else next(iter(self.code.split(*span)), (0, 0))
            unknown = Unknown(_NO_TOOL, whole=True)
            self.flow.change(["tool"], lambda state: {**state, "tool": self._frame(given) or unknown})
        elif name == "assert":
            self.uses.decide(self.names(*span), self.code.line(at))
        elif name in _MOVED_ALONG.values():
            if not maybe:
                self.flow.note_setting(name, None)
        elif name in _COMPUTED:
            path, line = self.sources[0].path, self.code.line(at)
            self.uses.decide(self.names(*span), line)
            if name in _MOVED_ALONG:
                why = f"is shifted at run time by '{name}' (line {line})"
                self.flow.note_setting(_MOVED_ALONG[name], Unknown(why))
            self.visits.append(Visit(path, line, name, why="moves the robot by an amount that it computes at run time"))
        else:
            return name in self.harmless or self.code.is_mark(at - 1, ".")
        return True

    def _numbers(self, span: Span) -> tuple[Number, ...] | None:
        """The numbers of a list or pose; None unless they are six plain numbers."""
        code, spans, units = self.code, [], []
        inside = code.bracket_content(span[0] + self._is_pose(span), span[1], "[")
        for left, right in code.split(*inside) if inside else ():
            angle = code.bracket_content(left + 1, right, "(") if code.word(left) == "d2r" else None
            number = code.number(*angle) if angle else code.number(left, right)
            if number is None:
                return None
            spans.append(number)
            units.append(DEGREE if angle else 1.0)
        return code.source.numbers(spans, units) if len(spans) == 6 else None

    def _is_pose(self, span: Span) -> bool:
        first, second = self.code.tokens[span[0] : span[0] + 2]
        return first.text == "p" and second.text == "[" and first.end == second.start

    def _constant(self, span: Span) -> Data | None:
        """Six plain numbers, written out or named; else None."""
        if name := self.code.name(*span):
            return None if self.uses.is_set(name) else self.declared.get(name)
        return Data("", 0, span) if span[1] > span[0] and self._numbers(span) else None

    def _frame(self, span: Span) -> Frame | None:
        """A constant pose; else None."""
        data = self._constant(span)
        cells = self._numbers(data.span) if data is not None and self._is_pose(data.span) else None
        return None if data is None or cells is None else self.frame_of(data, cells, "vector")

    def _named_argument(self, span: Span) -> tuple[str, Span]:
        """The name of an argument, empty if it has none, and the span of its value."""
        named = span[1] > span[0] + 1 and self.code.is_mark(span[0] + 1, "=")
        return (self.code.word(span[0]), (span[0] + 2, span[1])) if named else ("", span)

    def _move(self, word: str, span: Span, state: State | None) -> None:
        """Process the targets of a move: the named arguments in `_GOALS`, or the first arguments."""
        given = sorted(map(self._named_argument, self.code.split(*span)), key=lambda pair: pair[0] not in _GOALS)
        self.go([value for _, value in given[: _MOVES[word]]], state, self._goal, self._target)

    def _target(self, data: _Goal, state: State) -> ProgramTarget:
        self.require_constant(data)
        for moved in (state[key] for key in _MOVED_ALONG.values()):
            if isinstance(moved, Unknown):
                raise LeftOutError(moved.why)
        cells = self._numbers(data.span) or ()
        if not self._is_pose(data.span):
            return self.target(data, cells)
        tool = as_selected_frame("its tool", state["tool"])
        return self.target(data, cells, "vector", data.frame, tool, near=data.near)

    def _goal(self, span: Span) -> _Goal:
        """The target that an argument writes out, names, or gives in another frame; else `LeftOutError`."""
        data = self._constant(span)
        if data is not None:
            return _Goal(data.name, data.file, data.span)
        code, word = self.code, self.code.word(span[0])
        inside = code.bracket_content(span[0] + 1, span[1], "(")
        if word not in ("get_inverse_kin", "pose_trans") or word in self.routines or inside is None:
            single = code.name(*span)
            raise LeftOutError((self.uses.why_not(single) or "is not declared here") if single else _AT_RUN_TIME)
        given = code.split(*inside)
        if word == "pose_trans":
            feature = self._frame(given[0]) if len(given) == 2 else None
            if feature is None:
                raise LeftOutError(f"{_AT_RUN_TIME}: its frame is not constant")
            goal = self._pose_goal(given[1])
            inner = goal.frame
            return replace(goal, frame=Frame(feature.pose * inner.pose, feature.places + inner.places))
        if not given or len(given) > 4 or any(self._named_argument(argument)[0] == "tcp" for argument in given):
            raise LeftOutError(_AT_RUN_TIME)
        near = self._constant(self._named_argument(given[1])[1]) if len(given) > 1 else None
        joints = self._numbers(near.span) if near is not None and not self._is_pose(near.span) else None
        return replace(self._pose_goal(given[0]), near=tuple(joint.value for joint in joints or ()))

    def _pose_goal(self, span: Span) -> _Goal:
        goal = self._goal(span)
        if not self._is_pose(goal.span):
            raise LeftOutError(_AT_RUN_TIME)
        return goal
