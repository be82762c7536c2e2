"""The statements of RAPID: what a module declares, sets, calls and decides, and where it moves.

Statements end with a semicolon; `IF c x := 1;` is one in one, and statements begin behind `THEN`, `DO`, `CASE ...:` and
a label too. What is no assignment, no branch or loop and no known instruction may set its arguments and all that other
modules can set.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

from calib.core.base.errors import DataError
from calib.programs.languages.control_flow import Flow, State, Unknown
from calib.programs.languages.data_uses import DataUses
from calib.programs.languages.harmless import RAPID, RAPID_SETS, call_remedy
from calib.programs.languages.robot_program import Collector, Source
from calib.programs.languages.tokens import Code, Span, word_pattern

_WORDS = word_pattern(r"![^\n]*", r"[^\W\d]\w*", r":=|<=|>=|<>|[-+*/()\[\]{}=<>,.:;\\?|%]")
_TYPES = ("ROBTARGET", "JOINTTARGET", "TOOLDATA", "WOBJDATA")
_OPERATORS = ("AND", "OR", "XOR", "NOT", "DIV", "MOD")
_MOVE = re.compile(
    r"(?:MOVE|TRIGG)(?:L|C|J|ABSJ)(?:SYNC|DO|AO|GO|IOS)?|ARC[LC](?:START|END|\d)?|SPOT(?:L|J|ML|MJ)"
    r"|(?:DISP|PAINT|SEARCH)[LC](?:START|END)?"
)
_DISPLACED = "is active here (PDispOn, PDispSet, EOffsOn)"
_MODES: dict[str, tuple[str, object]] = {
    "PDISPON": ("PDISP", None),
    "PDISPSET": ("PDISP", None),
    "PDISPOFF": ("PDISP", ""),
    "EOFFSON": ("EOFFS", None),
    "EOFFSSET": ("EOFFS", None),
    "EOFFSOFF": ("EOFFS", ""),
    "CONFL": ("CONFL", True),
    "CONFJ": ("CONFJ", True),
}


@dataclass(frozen=True)
class Data:
    """A declaration: type and name in capitals, where the name is, its value, and whether other modules can set it."""

    type: str
    name: str
    at: int
    value: Span
    array: bool
    shared: bool


class RapidStatements(ABC):
    """Reads the statements of a module.

    Args:
        source: The module.
        harmless: Routines of other modules that set nothing, in capitals.

    Attributes:
        data: Declarations of targets, tools and work objects.
        several: Names that mean several things: data of several routines, and parameters.
        foreign: The first routine that is declared nowhere here, and what it may do; empty if there is none.
    """

    def __init__(self, source: Source, harmless: Collection[str]) -> None:
        self.source, self.code = source, Code(source, _WORDS, lines="blank")
        self.harmless = RAPID | set(harmless)
        self.flow = Flow({"PDISP": "", "EOFFS": "", "CONFL": True, "CONFJ": True})
        self.uses, self.collector = DataUses(), Collector()
        self.data: list[Data] = []
        self._known = set[str]()
        self.several: set[str] = set()
        self.foreign = ""
        self.by_reference = self._routines()
        self._keywords = self._keyword_table()

    @abstractmethod
    def move(self, word: str, spans: Sequence[Span], options: Mapping[str, Span], state: State | None) -> None:
        """Take in one instruction that moves: its arguments, and what holds there."""

    def _routines(self) -> dict[str, bool]:
        """Routines of the module, and whether they can set their arguments; their parameters mean several things."""
        code, routines = self.code, {}
        for at in code.names(0, len(code.tokens) - 2):
            word = code.tokens[at].text
            if word not in ("PROC", "FUNC", "TRAP"):
                continue
            name = at + 2 if word == "FUNC" else at + 1
            end = code.partner[name + 1] if code.is_mark(name + 1, "(") else name + 1
            words = [code.tokens[k].text for k in code.names(name + 2, end)]
            routines[code.tokens[name].text] = any(mode in words for mode in ("INOUT", "PERS", "VAR", "REF"))
            for k in code.names(name + 2, end):
                if code.is_mark(k + 1, ",", ")", "\\", "|", "{"):
                    self.several.add(code.tokens[k].text)
                    self.uses.compute(code.tokens[k].text, [f"{code.tokens[name].text}()"])
        return routines

    def read(self) -> None:
        """Read all statements.

        Raises:
            DataError: A branch or loop is not closed, or a statement cannot be read.
        """
        code, end = self.code, len(self.code.tokens) - 1
        at = self._header()
        while at < end:
            token = code.tokens[at]
            if token.kind == "name" and code.is_mark(at + 1, ":"):
                self.flow.label(f"label {token.text}")
                at += 2
            elif token.kind == "name" and token.text in self._keywords:
                at = self._keywords[token.text](at)
            else:
                stop = code.until(at, end, ";")
                if stop > at:
                    self._statement(at, stop)
                at = stop + 1
                self._close_compact()
        if self.flow.routine:
            raise DataError(f"{self.source.path}: routine '{self.flow.routine.lower()}' has no end; correct it")
        self.flow.finish_all()

    def _header(self) -> int:
        """Where the module begins behind what a controller writes first: %%% ... %%%."""
        if not self.code.is_mark(0, "%"):
            return 0
        marks = [at for at in range(len(self.code.tokens)) if self.code.is_mark(at, "%")][:6]
        return marks[-1] + 1

    def _keyword_table(self) -> dict[str, Callable[[int], int]]:
        ends = dict.fromkeys(("ENDPROC", "ENDFUNC", "ENDTRAP"), self._end_routine)
        closes = dict.fromkeys(("ENDIF", "ENDFOR", "ENDWHILE", "ENDTEST"), self._close)
        return {
            **ends,
            **closes,
            **dict.fromkeys(("PROC", "FUNC", "TRAP"), self._begin_routine),
            **dict.fromkeys(("ERROR", "UNDO", "BACKWARD"), self._handler),
            **dict.fromkeys(("CONST", "PERS", "VAR"), self._declaration),
            **dict.fromkeys(("LOCAL", "TASK"), lambda at: at + 1),
            **dict.fromkeys(("ELSEIF", "ELSE", "CASE", "DEFAULT"), self._branch),
            **dict.fromkeys(("THEN", "DO"), lambda at: at + 1),
            "MODULE": self._module,
            "ENDMODULE": lambda at: at + 1,
            "RECORD": lambda at: self._behind(at, "ENDRECORD"),
            "ALIAS": lambda at: self.code.until(at, len(self.code.tokens) - 1, ";") + 1,
            "IF": self._if,
            "TEST": self._test,
            "FOR": self._for,
            "WHILE": self._while,
        }

    def _module(self, at: int) -> int:
        return self.code.partner[at + 2] + 1 if self.code.is_mark(at + 2, "(") else at + 2

    def _behind(self, at: int, word: str) -> int:
        end = len(self.code.tokens) - 1
        return next((k for k in range(at, end) if self.code.tokens[k].text == word), end) + 1

    def _begin_routine(self, at: int) -> int:
        word = self.code.tokens[at].text
        name = at + 2 if word == "FUNC" else at + 1
        self.flow.begin(self.code.tokens[name].text, self.code.where(at), at_any_time=word == "TRAP")
        return self.code.partner[name + 1] + 1 if self.code.is_mark(name + 1, "(") else name + 1

    def _handler(self, at: int) -> int:
        """An error handler runs whenever an error happens."""
        self.flow.jump("return")
        name = f"{self.flow.routine} {self.code.tokens[at].text}"
        self.flow.finish()
        self.flow.begin(name, self.code.where(at), at_any_time=True)
        return self.code.partner[at + 1] + 1 if self.code.is_mark(at + 1, "(") else at + 1

    def _end_routine(self, at: int) -> int:
        if not self.flow.routine or self.flow.blocks:
            raise DataError(f"{self.code.where(at)}: '{self.code.shown(at, at + 1)}' ends nothing; correct it")
        self.flow.finish()
        return at + 1

    def _declaration(self, at: int) -> int:
        code = self.code
        stop = code.until(at, len(code.tokens) - 1, ";")
        kind, name = code.tokens[at + 1].text, at + 2
        local = (code.tokens[at - 1].text == "LOCAL" and at > 0) or bool(self.flow.routine)
        equals = code.until(name, stop, ":=")
        word = code.tokens[name].text
        if kind in _TYPES:
            self.several |= {word} & self._known
            self._known.add(word)
            shared = code.tokens[at].text != "CONST" and not local
            data = Data(kind, word, name, (equals + 1, max(stop, equals + 1)), code.is_mark(name + 1, "{"), shared)
            if equals < stop:
                self.data.append(data)
        self._expression(equals + 1, stop)
        self.uses.compute(word, self._names(equals + 1, stop))
        return stop + 1

    def _if(self, at: int) -> int:
        stop = self._condition(at + 1)
        compact = self.code.tokens[stop].text != "THEN"
        self.flow.open_choice("IF " if compact else "IF", self.code.line(at))
        self.flow.pass_over()
        return stop

    def _close_compact(self) -> None:
        """End the branches that are one statement long."""
        while self.flow.routine and self.flow.blocks and self.flow.blocks[-1].kind == "IF ":
            self.flow.close()

    def _branch(self, at: int) -> int:
        word = self.code.tokens[at].text
        if not self.flow.routine or not self.flow.blocks or self.flow.blocks[-1].loop:
            raise DataError(f"{self.code.where(at)}: '{word}' belongs to nothing; correct it")
        self.flow.next_choice()
        if word in ("ELSE", "DEFAULT"):
            return at + 1
        end = len(self.code.tokens) - 1
        stop = self._condition(at + 1) if word == "ELSEIF" else self.code.until(at, end, ":")
        if word == "CASE":
            self._decide(at + 1, stop)
        self.flow.pass_over()
        return stop + (word == "CASE")

    def _test(self, at: int) -> int:
        stop = self._condition(at + 1)
        self.flow.open_choice("TEST", self.code.line(at))
        self.flow.pass_over()
        return stop

    def _for(self, at: int) -> int:
        self.uses.set(self.code.tokens[at + 1].text)
        stop = at + 2
        while self.code.tokens[stop].text in ("FROM", "TO", "STEP"):
            stop = self._condition(stop + 1)
        self.flow.open_loop("FOR", self.code.line(at))
        self.flow.pass_over()
        return stop

    def _while(self, at: int) -> int:
        self.flow.open_loop("WHILE", self.code.line(at))
        stop = self._condition(at + 1)
        self.flow.pass_over()
        return stop

    def _close(self, at: int) -> int:
        if not self.flow.routine or not self.flow.blocks:
            raise DataError(f"{self.code.where(at)}: '{self.code.shown(at, at + 1)}' ends nothing; correct it")
        self.flow.close()
        self._close_compact()
        return at + 1

    def _condition(self, first: int) -> int:
        """Take in an expression by which the program decides; return where it ends.

        It ends where a word follows that can follow no value.
        """
        code, at, value = self.code, first, False
        while at < len(code.tokens) - 1 and not code.is_mark(at, ";", ":="):
            token = code.tokens[at]
            if token.kind == "mark" and token.text in "([{":
                at, value = code.partner[at], True
            elif token.kind == "mark":
                if value and token.text == "%":
                    break
                value = False
            elif token.kind == "name" and token.text in _OPERATORS:
                value = False
            elif value:
                break
            else:
                value = True
            at += 1
        self._decide(first, at)
        return at

    def _decide(self, first: int, stop: int) -> None:
        self._expression(first, stop)
        self.uses.decide(self._names(first, stop), self.code.line(first))

    def _names(self, first: int, stop: int) -> set[str]:
        return {self.code.tokens[at].text for at in self.code.names(first, stop)}

    def _expression(self, first: int, stop: int) -> None:
        """Take in the functions that an expression calls."""
        for at in self.code.calls(first, stop):
            self._call(at, (at + 2, self.code.partner[at + 1]), maybe=True)

    def _call(self, at: int, span: Span, *, maybe: bool = False) -> None:
        """Take in a call of a routine with its arguments."""
        name, names = self.code.tokens[at].text, self._names(*span)
        if name in self.by_reference:
            self.uses.compute(f"{name}()", names)
            if self.by_reference[name]:
                self._set(span, f"is an argument of '{self.code.shown(at, at + 1)}', which can set it")
            self.flow.call(name, maybe=maybe)
        elif name in RAPID_SETS:
            self._set(span, f"is set by '{self.code.shown(at, at + 1)}'")
        elif name not in self.harmless:
            shown, line = self.code.shown(at, at + 1), self.code.line(at)
            self._set(span, f"is an argument of '{shown}', which is declared nowhere here and can set it")
            self.uses.decide(names, line)
            self.flow.lose(f"is not known after '{shown}' (line {line}); say --harmless {shown} if it leaves it")
            self.foreign = self.foreign or (
                f"'{shown}' (line {line}), which is declared nowhere here; say --harmless {shown} if it sets none of"
                " this module's data"
            )

    def _set(self, span: Span, why: str) -> None:
        """Note that a call can set its arguments: all names that stand bare in it."""
        for at in self.code.names(*span):
            if not self.code.is_mark(at - 1, "\\", "."):
                self.uses.set(self.code.tokens[at].text, why)

    def _statement(self, at: int, stop: int) -> None:
        """Take in an assignment, a jump or an instruction."""
        code, word = self.code, self.code.tokens[at].text
        equals = code.until(at, stop, ":=")
        if code.tokens[at].kind != "name":
            self.flow.lose(f"is not known after '{code.shown(at, stop)}' (line {code.line(at)})")
            self._set((at, stop), "is an argument of a routine that is chosen at run time")
            self.foreign = self.foreign or f"a routine that is chosen at run time (line {code.line(at)})"
        elif equals < stop and code.is_mark(at + 1, ":=", "{", "."):
            self._expression(at + 1, stop)
            self.uses.set(word)
            self.uses.compute(word, self._names(at + 1, stop))
        elif word == "GOTO":
            self.flow.jump(f"label {code.tokens[at + 1].text}")
        elif word in ("RETURN", "RAISE"):
            self._expression(at + 1, stop)
            self.uses.compute(self.flow.routine, self._names(at + 1, stop))
            self.flow.jump("return")
        elif word in ("EXIT", "EXITCYCLE", "RETRY", "TRYNEXT"):
            self.flow.jump("exit")
        elif word == "CONNECT":
            self.uses.set(code.tokens[at + 1].text)
        elif word in _MODES:
            self._mode(word, at, stop)
        elif _MOVE.fullmatch(word) and stop > at + 1:
            self._move(word, at, stop)
        else:
            self._expression(at + 1, stop)
            self._call(at, (at + 1, stop))

    def _mode(self, word: str, at: int, stop: int) -> None:
        key, value = _MODES[word]
        self._expression(at + 1, stop)
        if key.startswith("CONF"):
            self.flow.set(key, "OFF" not in self._names(at + 1, stop))
        else:
            self.flow.set(key, Unknown(_DISPLACED) if value is None else "")

    def _move(self, word: str, at: int, stop: int) -> None:
        """Take in an instruction that moves: arguments between commas, and options behind backslashes."""
        code, spans, options = self.code, list[Span](), dict[str, Span]()
        self._expression(at + 1, stop)
        for first, last in code.split(at + 1, stop):
            end = code.until(first, last, "\\")
            if end > first:
                spans.append((first, end))
            for left, right in code.split(end + 1, last, "\\"):
                behind = left + 2 if code.is_mark(left + 1, ":=", "?") else left + 1
                options[code.tokens[left].text] = (behind, right)
                if behind == left + 1 and right > behind:
                    spans.append((behind, right))
        if word.startswith("SEARCH"):
            for span in spans[1:2]:
                self._set(span, "is set by a search")
        for k in range(at, stop):
            if word.endswith("SYNC") and code.tokens[k].kind == "text":
                self._at_any_time(code.tokens[k].text.strip('"').upper(), k)
        self.flow.move(code.tokens[at].start, lambda state: self.move(word, spans, options, state))

    def _at_any_time(self, name: str, at: int) -> None:
        """Take in a routine that is called while the robot moves."""
        self.flow.begin(f"{self.flow.routine} {at}", at_any_time=True)
        if name in self.by_reference:
            self.flow.call(name)
        else:
            self.flow.lose(call_remedy(name, self.code.line(at), "change a mode of motion"))
        self.flow.finish()
