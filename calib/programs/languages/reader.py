"""What the languages of controllers have in common: statements, branches and loops, calls, data and moves.

A language says which words begin and end routines, branches and loops, how it assigns, which routines and settings it
knows, and what its targets, tools and frames look like. Reading writes down what is set and by what the program decides
(`data_uses`) and the steps of each routine (`control_flow`); then all ways are followed, and each move is taken in with
what holds there.

A routine that is not declared and not known to be harmless may set its arguments, the data that it can see, and every
setting.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, TypeVar

import pinocchio as pin

from calib.core.base.errors import DataError
from calib.programs.languages.control_flow import Flow, State, Unknown
from calib.programs.languages.data_uses import DataUses
from calib.programs.languages.robot_program import LeftOutError, ProgramTarget, RobotProgram, Source
from calib.programs.languages.tokens import Code, Span
from calib.programs.languages.visits import Place, Visit, program_of

NO_VALUE = (0, 0)
"""The words of data that are declared without a value."""


@dataclass(frozen=True)
class Data:
    """Data of a program, written out or declared.

    Attributes:
        name: What the program calls it; empty where it is written out.
        file: Which of the program's files it is in.
        span: Its words.
        kind: Its type, in capitals.
        shared: Whether other modules can set it.
    """

    name: str
    file: int
    span: Span
    kind: str = ""
    shared: bool = False

    @property
    def place(self) -> Place:
        """Where it stands."""
        return self.file, self.span[0]


@dataclass(frozen=True)
class Frame:
    """A tool or frame that is selected, and where the data of the program stand that it is."""

    pose: pin.SE3
    places: tuple[Place, ...] = ()


class Placed(Protocol):
    """What has a place in the text."""

    @property
    def place(self) -> Place:
        """Where its numbers stand."""


_Goal = TypeVar("_Goal", bound=Placed)


def spelled(words: Mapping[Callable[[int], int], str]) -> dict[str, Callable[[int], int]]:
    """Return by word what reads it, from the words by what reads them."""
    return {word: read for read, text in words.items() for word in text.split()}


class Reader(ABC):
    """Reads a program.

    Args:
        sources: Its files, the one with the statements first.
        codes: The words of each.
        start: What holds at first, by setting.
        harmless: Routines that are declared elsewhere and change nothing.
        routines: Words that begin routines with their parameters in brackets.

    Attributes:
        words: What reads the statement that begins with a word.
        declared: Data by name.
        routines: Routines of the program, and whether they can set their arguments.
        foreign: The first routine that may set data that is shared, and what to do; empty if there is none.
    """

    language: str
    assigning = "="  # the mark of an assignment
    breaking = True  # whether statements end before `words`, too
    by_value = False  # whether no routine can set its arguments
    lost: tuple[str, ...] = ()  # settings that a routine declared elsewhere may change; all if none
    danger = "change a tool, frame or mode of motion"  # that is
    words: Mapping[str, Callable[[int], int]]

    def __init__(
        self, sources: Sequence[Source], codes: Sequence[Code], start: State, harmless: Collection[str], routines: str
    ) -> None:
        self.sources, self.codes, self.code, self.harmless = sources, codes, codes[0], harmless
        self.flow, self.uses = Flow(start), DataUses()
        self.visits = list[Visit]()
        self.declared = dict[str, Data]()
        self.routines = dict[str, bool]()
        self.foreign = ""
        for at in self.code.names(0, len(self.code.tokens) - 1):
            if self.code.tokens[at].text in routines.split():
                self._find_routine(at)

    # a language says

    @abstractmethod
    def parameter(self, span: Span) -> tuple[list[str], bool]:
        """Return the names of a parameter, and whether the routine can set what is given for it."""

    @abstractmethod
    def statement(self, at: int, stop: int) -> None:
        """Take in a statement that begins with none of `words`."""

    def known_call(self, at: int, span: Span, *, maybe: bool) -> bool:
        """Take in a call of a routine that the language has, if it is one; return whether it is."""
        return self.code.tokens[at].text in self.harmless

    def change(self, name: str, why: str = "is set while the program runs") -> None:
        """Take in that data become other ones."""
        self.uses.set(name, why)

    # statements

    def program(self) -> RobotProgram:
        """Read all statements, follow the program, and take in its moves.

        Raises:
            DataError: A part is not ended, a statement cannot be read, or no target can be compensated.
        """
        self.read()
        self.uses.follow()
        self.flow.follow()
        return program_of(self.language, self.sources, self.visits)

    def read(self, at: int = 0) -> None:
        """Read all statements from a word on."""
        code, end = self.code, len(self.code.tokens) - 1
        while at < end:
            token = code.tokens[at]
            if token.kind == "end":
                at = self.skip(at)
            elif token.kind == "name" and token.text in self.words:
                at = self.words[token.text](at)
            elif token.kind == "name" and code.tokens[at + 1].text == ":":
                self.flow.label(f"label {token.text}")
                at += 2
            else:
                stop = self.end(at)
                self.statement(at, stop)
                at = stop
        path = self.sources[0].path
        if self.flow.blocks:
            raise DataError(f"{path}, line {self.flow.blocks[-1].line}: is not ended; correct it")
        if self.flow.routine:
            raise DataError(f"{path}: routine '{self.flow.routine.lower()}' has no end; correct it")
        self.flow.finish_all()

    def end(self, at: int) -> int:
        """Return where the statement that begins at a word ends."""
        tokens = self.code.tokens
        while tokens[at].kind != "end":
            at = self.code.partner[at] + 1
            if self.breaking and tokens[at].kind == "name" and tokens[at].text in self.words:
                break
        return at

    def wrong(self, at: int, why: str) -> DataError:
        """Return the error that names a word and its line."""
        return DataError(f"{self.code.where(at)}: '{self.code.shown(at, at + 1)}' {why}; correct it")

    # words that routines begin and end with

    def _routine(self, at: int) -> int:
        """The bracket of the routine that a word begins, behind its name."""
        last = min(at + 8, len(self.code.tokens))
        bracket = next((k for k in range(at + 1, last) if self.code.is_mark(k, "(")), None)
        if bracket is None:
            raise self.wrong(at, "begins a routine that has no brackets")
        return bracket

    def _find_routine(self, at: int) -> None:
        bracket = self._routine(at)
        name, settable = self.code.tokens[bracket - 1].text, False
        for span in self.code.split(bracket + 1, self.code.partner[bracket]):
            parameters, set_by_it = self.parameter(span)
            settable |= set_by_it
            for parameter in parameters:
                self.uses.set(parameter, "is given to a routine when it is called")
                self.uses.compute(parameter, [f"{name}()"])
        self.routines[name] = settable

    def begin(self, at: int, *, at_any_time: bool = False) -> int:
        """Begin a routine."""
        bracket = self._routine(at)
        self.flow.begin(self.code.tokens[bracket - 1].text, self.code.where(at), at_any_time=at_any_time)
        return self.code.partner[bracket] + 1

    def begin_thread(self, at: int) -> int:
        """Begin a routine that runs beside the others."""
        return self.begin(at, at_any_time=True)

    def finish(self, at: int) -> int:
        """End a routine."""
        if not self.flow.routine or self.flow.blocks:
            raise self.wrong(at, "ends nothing")
        self.flow.finish()
        return at + 1

    def run_at_any_time(self, at: int, take: Callable[[], None]) -> None:
        """Take in what happens while the robot moves."""
        self.flow.begin(f"{self.flow.routine} {at}", at_any_time=True)
        take()
        self.flow.finish()

    # words of branches and loops

    def skip(self, at: int) -> int:
        """Go on behind the word."""
        return at + 1

    def choose(self, at: int) -> int:
        """Begin branches, behind a condition."""
        stop = self.head(at)
        self.flow.open_choice(self.code.tokens[at].text, self.code.line(at))
        self.flow.pass_over()
        return stop

    def head(self, at: int) -> int:
        """Take in the condition behind a word; return where it ends."""
        stop = self.end(at)
        self.decide(at + 1, stop)
        return stop

    def otherwise(self, at: int) -> int:
        """Begin the next branch."""
        if not self.flow.blocks or self.flow.blocks[-1].loop:
            raise self.wrong(at, "belongs to nothing")
        self.flow.next_choice()
        return at + 1

    def choose_next(self, at: int) -> int:
        """Begin the next branch, behind a condition."""
        self.otherwise(at)
        stop = self.head(at)
        self.flow.pass_over()
        return stop

    def repeat(self, at: int) -> int:
        """Begin a loop."""
        self.flow.open_loop(self.code.tokens[at].text, self.code.line(at))
        return at + 1

    def repeat_while(self, at: int) -> int:
        """Begin a loop, behind a condition."""
        self.repeat(at)
        stop = self.head(at)
        self.flow.pass_over()
        return stop

    def count(self, at: int) -> int:
        """Begin a loop that counts."""
        stop = self.head(at)
        self.change(self.code.tokens[at + 1].text)
        self.repeat(at)
        self.flow.pass_over()
        return stop

    def until(self, at: int) -> int:
        """End a loop, behind a condition."""
        if not self.flow.blocks or self.flow.blocks[-1].kind != "REPEAT":
            raise self.wrong(at, "belongs to nothing")
        stop = self.head(at)
        self.flow.pass_over()
        self.flow.close()
        return stop

    def close(self, at: int) -> int:
        """End branches or a loop; `END` is followed by the word that began them."""
        if not self.flow.blocks or self.flow.blocks[-1].kind != self.code.tokens[at].text[3:]:
            raise self.wrong(at, "ends nothing")
        self.flow.close()
        return at + 1

    # words that lead elsewhere

    def jump(self, at: int) -> int:
        """Go to a label."""
        self.flow.jump(f"label {self.code.tokens[at + 1].text}")
        return self.end(at)

    def leave_loop(self, at: int) -> int:
        """Leave the innermost loop."""
        self.flow.leave_loop()
        return at + 1

    def begin_again(self, at: int) -> int:
        """Go to the next round of the innermost loop."""
        self.flow.leave_loop(again=True)
        return at + 1

    def leave(self, at: int) -> int:
        """Leave the routine, with a value."""
        stop = self.end(at)
        self.expression(at + 1, stop)
        self.uses.compute(self.flow.routine, self.names(at + 1, stop))
        self.flow.jump("return")
        return stop

    def halt(self, at: int) -> int:
        """Leave the program."""
        stop = self.head(at)
        self.flow.jump("halt")
        return stop

    # what statements consist of

    def names(self, first: int, stop: int) -> set[str]:
        """Return the data in some words."""
        return {self.code.tokens[at].text for at in self.code.names(first, stop)}

    def decide(self, first: int, stop: int) -> None:
        """Take in words by which the program decides."""
        self.expression(first, stop)
        self.uses.decide(self.names(first, stop), self.code.line(first))

    def expression(self, first: int, stop: int) -> None:
        """Take in the calls of an expression."""
        for at in self.code.calls(first, stop):
            close = self.code.partner[at + 1]
            self.call(at, (at + 2, close), maybe=at > first or close + 1 < stop)

    def assign(self, first: int, stop: int, equals: int) -> None:
        """Take in what an assignment computes."""
        if self.code.until(equals + 1, stop, self.assigning) < stop:
            raise self.wrong(equals, "stands twice in a statement")
        self.expression(first + 1, equals)
        self.expression(equals + 1, stop)
        self.uses.compute(self.code.tokens[first].text, self.names(first + 1, stop))

    def call(self, at: int, span: Span, *, maybe: bool = False) -> None:
        """Take in a call with its arguments, which may not happen."""
        name, shown = self.code.tokens[at].text, self.code.shown(at, at + 1)
        if name in self.routines:
            self.uses.compute(f"{name}()", self.names(*span))
            if self.routines[name]:
                self.set_arguments(span, f"is an argument of '{shown}', which can set it")
            self.flow.call(name, maybe=maybe)
        elif not self.known_call(at, span, maybe=maybe):
            self.set_arguments(span, f"is an argument of '{shown}', which is declared nowhere here and can set it")
            self.uses.decide(self.names(*span), self.code.line(at))
            self.call_elsewhere(shown, self.code.line(at))

    def call_elsewhere(self, shown: str, line: int) -> None:
        """Take in a call of a routine that is declared elsewhere."""
        called, remedy = f"'{shown}' (line {line}), which is declared nowhere here and may", f"say --harmless {shown}"
        self.flow.lose(f"is not known after {called} {self.danger}; {remedy} if it does not", self.lost)
        self.foreign = self.foreign or f"{called} set data; {remedy} if it does not"

    def set_arguments(self, span: Span, why: str) -> None:
        """Take in that all names that stand bare in a call may be set."""
        for at in self.code.names(*span) if not self.by_value else ():
            if not self.code.is_mark(at - 1, "\\", "."):
                self.change(self.code.tokens[at].text, why)

    # data and moves

    def declare(self, key: str, data: Data) -> None:
        """Take in a declaration."""
        if key in self.declared:
            self.uses.set(re.split(r"[\[{]", key)[0], "is declared in several places; name each otherwise")
            data = replace(data, span=NO_VALUE)
        self.declared[key] = data

    def require_constant(self, data: Data) -> None:
        """Raise `LeftOutError` for data that the program, or another module, sets or decides by."""
        name = data.name if self.by_value else re.split(r"[\[{]", data.name)[0].upper()
        why = self.uses.why_not(name) if name else ""
        if why or (data.shared and self.foreign):
            raise LeftOutError(why or f"may be set by {self.foreign}")

    def go(
        self,
        span: Span,
        state: State | None,
        find: Callable[[], _Goal],
        target: Callable[[_Goal, State], tuple[ProgramTarget, tuple[Place, ...]]],
    ) -> None:
        """Take in one target of a move.

        Args:
            span: Its words.
            state: What holds there; None: the program never comes there.
            find: Returns its numbers; raises `LeftOutError` where they are not in the program.
            target: Returns the target and where data stand that are its frame or tool, or raises `LeftOutError`.
        """
        where = self.sources[0].path, self.code.line(span[0])
        shown, place = self.code.shown(*span), None
        try:
            goal = find()
            if state is None:
                raise LeftOutError("is a place to which the program never comes")
            place = goal.place
            reached, frames = target(goal, state)
            self.visits.append(Visit(where, reached.name or shown, place, reached, frames=frames))
        except LeftOutError as why:
            self.visits.append(Visit(where, shown, place, why=str(why)))


def selected(what: str, value: Hashable) -> Frame:
    """Return a tool or frame that is selected.

    Raises:
        LeftOutError: It is not known.
    """
    if not isinstance(value, Frame):
        unknown = value if isinstance(value, Unknown) else Unknown("is not known")
        raise LeftOutError(unknown.why if unknown.whole else f"{what} {unknown.why}")
    return value
