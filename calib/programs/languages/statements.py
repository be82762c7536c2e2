"""The order of statements in programs, in any language: routines, branches, loops and jumps.

A subclass for each language defines the words that begin and end them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

from calib.core.base.errors import DataError
from calib.programs.languages.control_flow import Flow, State
from calib.programs.languages.tokens import ProgramWords, Span

Action = Callable[[int, int], int]
"""Processes a statement from the index of its first word and the next index; returns where reading goes on."""


@dataclass
class Block:
    """Branches or a loop that are still open.

    Attributes:
        kind, line: Word that opened the block, and its line.
        loop: Whether the block is a loop.
        end: Label after the block.
        again: Label of the next branch or round.
    """

    kind: str
    line: int
    loop: bool
    end: str
    again: str


class Statements(ABC):
    """Reads the statements of a program.

    Args:
        codes: The words of its files, the file with the statements first.
        start: First value of each setting.

    Attributes:
        WORDS: Words that begin statements, by the names of the methods that process them.
        ROUTINES: Words that begin routines with their parameters in brackets.
        THREADS: Those whose routines run at the same time as the others.
        routines: Whether each routine of the program can set its arguments.
    """

    breaking = True  # whether statements end before words of `WORDS`, too
    WORDS: ClassVar[Mapping[str, str]] = {}
    ROUTINES: ClassVar[str] = ""
    THREADS: ClassVar[tuple[str, ...]] = ()

    def __init__(self, codes: Sequence[ProgramWords], start: State) -> None:
        self.sources, self.codes, self.code = [code.source for code in codes], codes, codes[0]
        self.flow, self.uses = Flow(start), DataUses()
        self._blocks: dict[str, list[Block]] = {}
        self.words: dict[str, list[Action]] = {
            word: [getattr(self, action) for action in actions.split()]
            for actions, words in self.WORDS.items()
            for word in words.split()
        }
        self.routines = dict[str, bool]()
        for at in self.code.names(0, len(self.code.tokens) - 1):
            if self.code.word(at) in self.ROUTINES.split():
                self._find_routine(at)

    def parameter(self, span: Span) -> tuple[list[str], bool]:
        """Return the names of a parameter, and whether the routine can set its argument."""
        return [self.code.word(span[0])], False

    @abstractmethod
    def statement(self, at: int, stop: int) -> None:
        """Process a statement that begins with none of `words`."""

    @abstractmethod
    def expression(self, first: int, stop: int) -> None:
        """Process the calls of an expression."""

    def names(self, first: int, stop: int) -> set[str]:
        """Return the names of data in a span of words."""
        return {self.code.word(at) for at in self.code.names(first, stop)}

    def decide(self, first: int, stop: int) -> None:
        """Record that the program's path depends on these words."""
        self.expression(first, stop)
        self.uses.decide(self.names(first, stop), self.code.line(first))

    def change(self, name: str, why: str = "is set while the program runs") -> None:
        """Record that data change."""
        self.uses.note_change(name, why)

    def read(self, at: int = 0) -> None:
        """Read all statements from a word on.

        Raises:
            DataError: A routine, a branch or a loop does not end.
        """
        code, end = self.code, len(self.code.tokens) - 1
        while at < end:
            token = code.tokens[at]
            if token.kind == "end":
                at = self.skip(at, at + 1)
            elif token.kind == "name" and token.text in self.words:
                at = self.act(at, self.words[token.text])
            elif token.kind == "name" and code.word(at + 1) == ":":
                self.flow.label(f"label {token.text}")
                at += 2
            else:
                stop = self.end(at)
                self.statement(at, stop)
                at = stop
        path = self.sources[0].path
        if self.blocks:
            raise DataError(f"{path}, line {self.blocks[-1].line}: the block that begins here has no end; add it")
        if self.flow.routine:
            raise DataError(f"{path}: routine '{self.flow.routine.lower()}' has no end; correct it")
        self.flow.finish()

    def act(self, at: int, actions: Iterable[Action]) -> int:
        """Process a word; return where reading goes on."""
        behind = at + 1
        for action in actions:
            behind = action(at, behind)
        return behind

    def end(self, at: int) -> int:
        """Return where the statement that begins at a word ends."""
        tokens = self.code.tokens
        while tokens[at].kind != "end":
            at = self.code.partner[at] + 1
            if self.breaking and tokens[at].kind == "name" and tokens[at].text in self.words:
                break
        return at

    def syntax_error(self, at: int, why: str) -> DataError:
        """Return the error that names a word and its line."""
        return DataError(f"{self.code.location(at)}: '{self.code.excerpt(at, at + 1)}' {why}; correct it")

    # words that begin and end routines

    def _routine(self, at: int) -> int:
        """The opening bracket after the name of the routine that a word begins."""
        last = min(at + 8, len(self.code.tokens))
        bracket = next((k for k in range(at + 1, last) if self.code.is_mark(k, "(")), None)
        if bracket is None:
            raise self.syntax_error(at, "begins a routine that has no brackets")
        return bracket

    def _find_routine(self, at: int) -> None:
        bracket = self._routine(at)
        name, settable = self.code.word(bracket - 1), False
        for span in self.code.split(bracket + 1, self.code.partner[bracket]):
            parameters, set_by_it = self.parameter(span)
            settable |= set_by_it
            for parameter in parameters:
                self.uses.note_change(parameter, "is given to a routine when it is called")
                self.uses.compute(parameter, [f"{name}()"])
        self.routines[name] = settable

    def begin(self, at: int, _: int) -> int:
        """Begin a routine; those of `THREADS` run at the same time as the others."""
        bracket, at_any_time = self._routine(at), self.code.word(at) in self.THREADS
        self.flow.begin(self.code.word(bracket - 1), self.code.location(at), at_any_time=at_any_time)
        return self.code.partner[bracket] + 1

    def finish(self, at: int, behind: int) -> int:
        """End the open routine, or raise `syntax_error`."""
        if not self.flow.routine or self.blocks:
            raise self.syntax_error(at, "ends nothing")
        self.flow.finish()
        return behind

    def run_at_any_time(self, at: int, take: Callable[[], None]) -> None:
        """Process statements that run while the robot moves."""
        self.flow.begin(f"{self.flow.routine} {at}", at_any_time=True)
        take()
        self.flow.finish()

    # branches and loops

    @property
    def blocks(self) -> list[Block]:
        """Open branches and loops of the routine, the innermost last."""
        return self._blocks.setdefault(self.flow.routine, [])

    def open_block(self, kind: str, line: int, *, loop: bool = False) -> None:
        """Begin branches or a loop."""
        block = Block(kind, line, loop, self.flow.new_label(), self.flow.new_label())
        self.blocks.append(block)
        if loop:
            self.flow.label(block.again)

    def close_block(self) -> None:
        """End the innermost branches or loop."""
        block = self.blocks.pop()
        if block.loop:
            self.flow.jump(block.again)
        else:
            self.flow.label(block.again)
        self.flow.label(block.end)

    def skip(self, at: int, behind: int) -> int:
        """Go on after the word."""
        return behind

    def pass_statement(self, at: int, _: int) -> int:
        """Go on after the statement, whatever its words."""
        return self.code.line_end(at)

    def condition(self, at: int, _: int) -> int:
        """Process the condition after a word."""
        stop = self.end(at)
        self.decide(at + 1, stop)
        return stop

    def branch(self, at: int, behind: int) -> int:
        """Begin branches; the program may skip the first."""
        self.open_block(self.code.word(at), self.code.line(at))
        return self.pass_over(at, behind)

    def begin_branch(self, at: int, behind: int) -> int:
        """Begin the next branch, or raise `syntax_error` outside of branches."""
        if not self.blocks or self.blocks[-1].loop:
            raise self.syntax_error(at, "belongs to nothing")
        block = self.blocks[-1]
        self.flow.jump(block.end)
        self.flow.label(block.again)
        block.again = self.flow.new_label()
        return behind

    def pass_over(self, _: int, behind: int) -> int:
        """Record that the program may skip the rest of the branch or loop."""
        block = self.blocks[-1]
        self.flow.note_jump(block.end if block.loop else block.again)
        return behind

    def count(self, at: int, behind: int) -> int:
        """Record that a loop counts with the variable after its word."""
        self.change(self.code.word(at + 1))
        return behind

    def repeat(self, at: int, behind: int) -> int:
        """Begin a loop."""
        self.open_block(self.code.word(at), self.code.line(at), loop=True)
        return behind

    def end_loop(self, at: int, behind: int) -> int:
        """End a loop with a condition, or raise `syntax_error` outside of loops."""
        if not self.blocks or self.blocks[-1].kind != "REPEAT":
            raise self.syntax_error(at, "belongs to nothing")
        behind = self.pass_over(at, self.condition(at, behind))
        self.close_block()
        return behind

    def close(self, at: int, behind: int) -> int:
        """End branches or a loop, named by the word after `END`, or raise `syntax_error`."""
        if not self.blocks or self.blocks[-1].kind != self.code.word(at)[3:]:
            raise self.syntax_error(at, "ends nothing")
        self.close_block()
        return behind

    # jumps

    def jump(self, at: int, _: int) -> int:
        """Go to a label."""
        self.flow.jump(f"label {self.code.word(at + 1)}")
        return self.end(at)

    def leave_loop(self, _: int, behind: int) -> int:
        """Leave the innermost loop."""
        for block in [block for block in self.blocks if block.loop][-1:]:
            self.flow.jump(block.end)
        return behind

    def begin_again(self, _: int, behind: int) -> int:
        """Go to the next round of the innermost loop."""
        for block in [block for block in self.blocks if block.loop][-1:]:
            self.flow.jump(block.again)
        return behind

    def leave(self, at: int, _: int) -> int:
        """Leave the routine, with a value."""
        stop = self.end(at)
        self.expression(at + 1, stop)
        self.uses.compute(self.flow.routine, self.names(at + 1, stop))
        self.flow.jump("return")
        return stop

    def halt(self, _: int, behind: int) -> int:
        """Leave the program."""
        self.flow.jump("halt")
        return behind


class DataUses:
    """The names that a program sets, computes from each other, and decides by.

    Numbers of a target may be changed only if the program does nothing else with them: does not set them, and neither
    computes other data from them, nor decides its path by them or by such data.
    """

    def __init__(self) -> None:
        self._set: dict[str, str] = {}
        self._decides: dict[str, str] = {}
        self._sources: dict[str, set[str]] = {}

    def note_change(self, name: str, why: str = "is set while the program runs") -> None:
        """Note that the program assigns a new value to a name."""
        self._set.setdefault(name, why)

    def compute(self, name: str, sources: Iterable[str]) -> None:
        """Note that a name is computed from others."""
        self._sources.setdefault(name, set()).update(sources)

    def decide(self, names: Iterable[str], line: int) -> None:
        """Note that the program's path depends on these names, or that an unknown routine gets them."""
        for name in names:
            self._decides.setdefault(name, f"also decides what the program does, in line {line}")

    def follow(self) -> None:
        """Mark all data from which deciding names are computed as deciding, too."""
        work = list(self._decides)
        while work:
            name = work.pop()
            for source in self._sources.get(name, ()):
                if source not in self._decides:
                    self._decides[source] = self._decides[name]
                    work.append(source)

    def is_set(self, name: str) -> bool:
        """Return whether the program sets a name."""
        return name in self._set

    def why_not(self, name: str) -> str:
        """Return why the numbers of a name must stay as they are; empty if they may be changed."""
        return self._set.get(name) or self._decides.get(name, "")
