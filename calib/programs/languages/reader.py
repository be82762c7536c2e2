"""The common parts of controllers' languages: expressions, assignments, calls, data and moves.

A subclass for each language defines its assignments, known routines and settings, and the form of targets, tools and
frames. Reading records which data are set or decide the path (`DataUses`), and the steps of each routine
(`control_flow`). Then all paths are followed, and each move is processed with the settings that hold there.

A routine that is neither declared nor known to be harmless may set its arguments, the data that it can see, and every
setting.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

from calib.core.base.errors import DataError
from calib.core.data.tables import read_table
from calib.programs.languages.control_flow import State, Unknown
from calib.programs.languages.robot_program import (
    ITSELF,
    Configuration,
    Frame,
    LeftOutError,
    ProgramTarget,
    RobotProgram,
    Rotation,
    Visit,
    pose_of,
    program_of,
)
from calib.programs.languages.statements import Statements
from calib.programs.languages.tokens import Number, ProgramWords, Span

Frames = Mapping[str, Frame | Unknown]
"""Tools and frames by name."""


def as_selected_frame(what: str, value: Hashable) -> Frame:
    """Return the selected tool or frame; `what` names it in messages.

    Raises:
        LeftOutError: Its value is unknown.
    """
    if not isinstance(value, Frame):
        unknown = value if isinstance(value, Unknown) else Unknown("is not known")
        raise LeftOutError(unknown.why if unknown.whole else f"{what} {unknown.why}")
    return value


def read_frames(path: Path | str) -> dict[str, Frame | Unknown]:
    """Read a table of tools and frames that a program uses without declaring them.

    Columns: `name`; x, y, z [m]; rx, ry, rz [rad], about fixed axes. A tool is given in the flange, a frame in the
    robot's base.

    Raises:
        DataError: The message names file, line and column.
    """
    table = read_table(path)
    if "name" not in table.names:
        raise DataError(f"{path}: no column 'name'; it says what the program calls each tool and frame")
    names = [name.upper().replace(" ", "") for name in table.text("name")]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise DataError(f"{path}: '{twice}' is given twice; give each tool and frame once")
    columns = [table.column(name, "length") for name in "xyz"]
    columns += [table.column(name, "angle") for name in ("rx", "ry", "rz")]
    return {name: Frame(pose_of(row, "xyz")) for name, *row in zip(names, *columns, strict=True)}


NO_VALUE = (0, 0)
"""The span of data that are declared without a value."""


@dataclass(frozen=True)
class Data:
    """Data of a program, written out or declared.

    Attributes:
        name: Name in the program; empty for data written out.
        file: Index of its file in the program.
        span: Range of its words.
        kind: Type, in capitals.
        shared: Whether other modules can set it.
    """

    name: str
    file: int
    span: Span
    kind: str = ""
    shared: bool = False


_Data = TypeVar("_Data", bound=Data)


class Reader(Statements):
    """Reads a program.

    Args:
        codes: The words of its files, the file with the statements first.
        start: First value of each setting.
        frames: Tools and frames that the program does not declare, by name.
        harmless: Routines declared elsewhere that change nothing.

    Attributes:
        declared: Data by name.
        foreign: The first call that may set shared data, and the remedy, in words; empty if there is none.
    """

    language: str
    known: frozenset[str]  # built-in routines that change nothing
    assigning = "="  # the mark of an assignment
    by_value = False  # whether routines cannot set their arguments
    lost: tuple[str, ...] = ()  # settings that a routine declared elsewhere may change; empty: all
    danger = "change a tool, frame or mode of motion"  # what such a routine may do, in words

    def __init__(self, codes: Sequence[ProgramWords], start: State, frames: Frames, harmless: Collection[str]) -> None:
        super().__init__(codes, start)
        self.frames, self.harmless = frames, self.known | set(harmless)
        self.visits = list[Visit]()
        self.declared = dict[str, Data]()
        self.foreign = ""

    # defined by each language

    def read_known_call(self, at: int, span: Span, *, maybe: bool) -> bool:
        """Process the call of a built-in or harmless routine; return whether the call is known."""
        return self.code.word(at) in self.harmless

    def program(self) -> RobotProgram:
        """Read all statements, follow the program, and process its moves.

        Raises:
            DataError: A block is not closed, a statement cannot be read, or no target can be compensated.
        """
        self.read()
        self.uses.follow()
        self.flow.follow()
        return program_of(self.language, self.sources, self.visits)

    # parts of statements

    def expression(self, first: int, stop: int) -> None:
        """Process the calls of an expression."""
        for at in self.code.calls(first, stop):
            close = self.code.partner[at + 1]
            self.call(at, (at + 2, close), maybe=at > first or close + 1 < stop)

    def assign(self, first: int, stop: int, equals: int) -> None:
        """Process an assignment; a second assignment mark in the statement is an error."""
        if self.code.find_mark(equals + 1, stop, self.assigning) < stop:
            raise self.syntax_error(equals, "stands twice in a statement")
        self.expression(first + 1, equals)
        self.expression(equals + 1, stop)
        self.uses.compute(self.code.word(first), self.names(first + 1, stop))

    def call(self, at: int, span: Span, *, maybe: bool = False) -> None:
        """Process a call with its arguments; with `maybe` the program may skip it."""
        name, shown = self.code.word(at), self.code.excerpt(at, at + 1)
        if name in self.routines:
            self.uses.compute(f"{name}()", self.names(*span))
            if self.routines[name]:
                self.note_arguments(span, f"is an argument of '{shown}', which can set it")
            self.flow.call(name, maybe=maybe)
        elif not self.read_known_call(at, span, maybe=maybe):
            self.note_arguments(span, f"is an argument of '{shown}', which is not declared here and can set it")
            self.uses.decide(self.names(*span), self.code.line(at))
            self.call_elsewhere(shown, self.code.line(at))

    def call_elsewhere(self, shown: str, line: int) -> None:
        """Process a call of a routine that is declared elsewhere."""
        called, remedy = f"'{shown}' (line {line}), which is not declared here and may", f"say --harmless {shown}"
        self.flow.mark_unknown(f"is not known after {called} {self.danger}; {remedy} if it does not", self.lost)
        self.foreign = self.foreign or f"{called} set data; {remedy} if it does not"

    def note_arguments(self, span: Span, why: str) -> None:
        """Record that the call may set every name that stands alone among its arguments."""
        for at in self.code.names(*span) if not self.by_value else ():
            if not self.code.is_mark(at - 1, "\\", "."):
                self.change(self.code.word(at), why)

    # data and moves

    def declare(self, key: str, data: Data) -> None:
        """Process a declaration."""
        if key in self.declared:
            self.uses.note_change(re.split(r"[\[{]", key)[0], "is declared in several places; give each its own name")
            data = replace(data, span=NO_VALUE)
        self.declared[key] = data

    def require_constant(self, data: Data) -> None:
        """Raise `LeftOutError` for data that the program or another module sets, or that decide the path."""
        name = data.name if self.by_value else re.split(r"[\[{]", data.name)[0].upper()
        why = self.uses.why_not(name) if name else ""
        if why or (data.shared and self.foreign):
            raise LeftOutError(why or f"may be set by {self.foreign}")

    def target(
        self,
        data: Data,
        cells: tuple[Number, ...],
        rotation: Rotation | None = None,
        frame: Frame = ITSELF,
        tool: Frame = ITSELF,
        configuration: Configuration | None = None,
        near: tuple[float, ...] = (),
    ) -> ProgramTarget:
        """Return a target; see `ProgramTarget`."""
        line, path = self.codes[data.file].line(data.span[0]), self.sources[data.file].path
        return ProgramTarget(line, path, data.name, cells, rotation, frame, tool, configuration, near)

    def frame_of(self, data: Data, cells: Sequence[Number], rotation: Rotation) -> Frame:
        """Return the frame that a pose of the program defines, or raise `DataError`."""
        places = ((data.file, data.span[0]),) if data.name else ()
        return Frame(pose_of([cell.value for cell in cells], rotation), places)

    def go(
        self,
        spans: Iterable[Span],
        state: State | None,
        find: Callable[[Span], _Data],
        target: Callable[[_Data, State], ProgramTarget],
    ) -> None:
        """Process the targets of a move, each in its span of words; without a state, the program never comes there.

        `find` returns the data of a target, and `target` the target from data and settings; both raise `LeftOutError`.
        """
        for span in spans:
            visit = Visit(self.sources[0].path, self.code.line(span[0]), self.code.excerpt(*span))
            try:
                data = find(span)
                if state is None:
                    raise LeftOutError("is never reached by the program")
                visit = replace(visit, place=(data.file, data.span[0]))
                reached = target(data, state)
                visit = replace(visit, text=reached.name or visit.text, target=reached)
            except LeftOutError as why:
                visit = replace(visit, why=str(why))
            self.visits.append(visit)
