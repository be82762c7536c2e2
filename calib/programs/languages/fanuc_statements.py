"""The instructions of FANUC's teach pendant programs: what they set, call and decide, and where they move.

An instruction ends with a semicolon, on its line or on a later one. What is no motion, no jump, no assignment and no
known instruction (a call, a macro) may change frames and tools.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection

from calib.core.base.errors import DataError
from calib.programs.languages.control_flow import Flow, State, Unknown
from calib.programs.languages.data_uses import DataUses
from calib.programs.languages.harmless import FANUC, call_remedy
from calib.programs.languages.robot_program import Collector, Source
from calib.programs.languages.tokens import Code, Span, word_pattern

WORDS = word_pattern(
    r"^[^\S\n]*\d*:[^\S\n]*(?:!|//)[^\n]*|^[^\S\n]*\d*:|(?i:MESSAGE)\[[^\]\n]*\]",
    r"[$#]?[^\W\d]\w*",
    r"<>|<=|>=|[-+*/%()\[\]{}=<>,.;:!&@#?^|~$]",
    r"(?<=\[)[^\S\n]*\d+[^\S\n]*:[^\]\n]*|'[^'\n]*'|\"[^\"\n]*\"",
)
_NUMBERED = ("UFRAME_NUM", "UTOOL_NUM")
_STATE = ("UFRAME", "UTOOL", *_NUMBERED)


class FanucStatements(ABC):
    """Reads the instructions of a program.

    Args:
        source: The file.
        code: Words of its instructions.
        harmless: Programs and macros that change no frame and no tool, in capitals.
    """

    def __init__(self, source: Source, code: Code, harmless: Collection[str]) -> None:
        self.source, self.code, self.harmless = source, code, FANUC | set(harmless)
        self.flow = Flow(dict.fromkeys(_STATE, ""))
        self.uses, self.collector = DataUses(), Collector()
        self.given = set(harmless)

    @abstractmethod
    def move(self, places: list[Span], options: Span, state: State | None) -> None:
        """Take in one motion: its places and the words behind them, and what holds there."""

    def read(self) -> None:
        """Read all instructions.

        Raises:
            DataError: A branch or loop is not closed, or a statement cannot be read.
        """
        code, end = self.code, len(self.code.tokens) - 1
        labels = [
            code.tokens[at + 2].text.partition(":")[0].strip()
            for at in range(end - 3)
            if code.tokens[at].text == "LBL" and (at == 0 or code.is_mark(at - 1, ";"))
        ]
        self.flow.begin("program")
        self.flow.jump("first")
        self.flow.label("any label")
        for label in labels:
            self.flow.maybe(f"label {label}")
        self.flow.label("first")
        at = 0
        while at < end:
            stop = code.until(at, end, ";")
            if stop > at:
                self._instruction(at, stop)
            at = stop + 1
        if self.flow.blocks:
            raise DataError(f"{self.source.path}, line {self.flow.blocks[-1].line}: is not ended; correct it")
        self.flow.finish()

    def place(self, span: Span) -> str:
        """Return what a place of a motion is called: `P[1]`, `P[*]` where the number is computed, or `PR`."""
        if self.code.tokens[span[0]].text == "PR":
            return "PR"
        number = self.code.tokens[span[0] + 2]
        plain = span[1] == span[0] + 4 and (number.kind == "number" or ":" in number.text)
        return f"P[{number.text.partition(':')[0].strip() if plain else '*'}]"

    def called(self, at: int) -> bool:
        """Return whether a name is what a call before it calls."""
        return at > 0 and self.code.tokens[at - 1].text == "CALL"

    def _names(self, first: int, stop: int) -> set[str]:
        """Registers and positions in some words."""
        names = set()
        for at in self.code.names(first, stop):
            if self.code.is_mark(at + 1, "["):
                whole = self.code.tokens[at].text == "P"
                names.add(self.place((at, self.code.partner[at + 1] + 1)) if whole else self.code.tokens[at].text)
        return names

    def _lose(self, name: str, at: int) -> None:
        self.flow.lose(call_remedy(name, self.code.line(at), "change it"), _STATE)

    def _instruction(self, at: int, stop: int) -> None:
        """Take in an instruction, behind the conditions on which it is carried out."""
        code, opened = self.code, 0
        comma = code.until(at, stop, ",")
        while comma < stop and code.tokens[at].text in ("IF", "SELECT", "=", "ELSE"):
            self.uses.decide(self._names(at, comma), code.line(at))
            self.flow.open_choice(code.tokens[at].text, code.line(at))
            self.flow.pass_over()
            at, opened = comma + 1, opened + 1
            comma = code.until(at, stop, ",")
        if at < stop:
            self._action(at, stop)
        for _ in range(opened):
            self.flow.close()

    def _action(self, at: int, stop: int) -> None:
        code, flow, word = self.code, self.flow, self.code.tokens[at].text
        if word in ("J", "L", "C", "A", "S") and code.tokens[at + 1].text in ("P", "PR") and code.is_mark(at + 2, "["):
            self._motion(at, stop)
        elif word == "IF" and code.tokens[stop - 1].text == "THEN":
            self.uses.decide(self._names(at, stop), code.line(at))
            flow.open_choice(word, code.line(at))
            flow.pass_over()
        elif word == "FOR":
            self.uses.decide(self._names(at, stop), code.line(at))
            flow.open_loop(word, code.line(at))
            flow.pass_over()
        elif word in ("ELSE", "ENDIF", "ENDFOR"):
            self._block(word, at)
        elif word == "LBL" and code.is_mark(at + 1, "["):
            flow.label(f"label {code.tokens[at + 2].text.partition(':')[0].strip()}")
        elif word == "JMP":
            plain = code.is_mark(at + 2, "[") and code.partner[at + 2] == at + 4
            flow.jump(f"label {code.tokens[at + 3].text.partition(':')[0].strip()}" if plain else "any label")
        elif word in ("END", "ABORT"):
            flow.jump("return")
        elif code.until(at, stop, "=") < stop and code.tokens[at].kind == "name":
            self._assignment(at, stop)
        elif word == "CALL":
            self._called(at + 1, stop)
        elif word not in self.harmless and not code.is_mark(at, "-"):
            self.uses.decide(self._names(at, stop), code.line(at))
            self._lose(code.shown(at, at + 1), at)
        else:
            self.uses.decide(self._names(at, stop), code.line(at))

    def _block(self, word: str, at: int) -> None:
        blocks = self.flow.blocks
        if not blocks or blocks[-1].loop != (word == "ENDFOR"):
            raise DataError(f"{self.code.where(at)}: '{word}' belongs to nothing; correct it")
        if word == "ELSE":
            self.flow.next_choice()
        else:
            self.flow.close()

    def _called(self, at: int, stop: int) -> None:
        """Take in a call of a program."""
        self.uses.decide(self._names(at, stop), self.code.line(at))
        if self.code.tokens[at].text not in self.given:
            self._lose(self.code.shown(at, at + 1), at)

    def _assignment(self, at: int, stop: int) -> None:
        """Take in what sets registers, outputs, frames and positions."""
        code, word = self.code, self.code.tokens[at].text
        equals = code.until(at, stop, "=")
        names, value = self._names(at + 1, stop), self.code.shown(equals + 1, stop)
        if word in _NUMBERED:
            plain = equals == at + 1 and value.isdigit()
            self.flow.set(word, value if plain else Unknown(f"is computed in line {code.line(at)}"))
        elif word in ("UFRAME", "UTOOL"):
            plain = code.partner[at + 1] == at + 3 and code.tokens[at + 2].kind == "number"
            key = f"{word}[{code.tokens[at + 2].text}]" if plain else word
            self.flow.set(key, Unknown(f"is set while the program runs (line {code.line(at)})"))
        elif word == "P":
            self.uses.set(self.place((at, code.partner[at + 1] + 1 if code.is_mark(at + 1, "[") else at + 1)))
        elif word == "PR":
            bare = code.tokens[equals + 1].text == "P" and code.partner[equals + 2] + 1 == stop
            if bare:
                self.uses.compute("PR", names)
            else:
                self.uses.compute("PR", names - {name for name in names if name.startswith("P[")})
                self.uses.decide({name for name in names if name.startswith("P[")}, code.line(at))
        elif word in self.harmless:
            self.uses.compute(word, names)
        else:
            self.uses.decide(names, code.line(at))
            self._lose(code.shown(at, at + 1), at)

    def _motion(self, at: int, stop: int) -> None:
        """Take in a motion, and what is called while the robot moves."""
        code, places, first = self.code, list[Span](), at + 1
        while first < stop and code.tokens[first].text in ("P", "PR") and code.is_mark(first + 1, "["):
            places.append((first, code.partner[first + 1] + 1))
            first = code.partner[first + 1] + 1
        self.flow.move(code.tokens[at].start, lambda state: self.move(places, (first, stop), state))
        for k in code.names(first, stop):
            if self.called(k) and code.tokens[k].text not in self.given:
                self.flow.begin(f"call {k}", at_any_time=True)
                self._lose(code.shown(k, k + 1), k)
                self.flow.finish()
