"""The statements of KRL: what a `.src` file declares, sets, calls and decides, which frames it selects, where it moves.

A statement ends with its line; statements begin behind `THEN`, `ELSE`, `DO` and a label too. What is no assignment, no
branch or loop and no known statement may set its arguments, and all frames.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Hashable
from dataclasses import dataclass, field

from calib.core.base.errors import DataError
from calib.programs.languages.control_flow import Change, Flow, State, Unknown
from calib.programs.languages.data_uses import DataUses
from calib.programs.languages.harmless import BAS_FORMS, BAS_HARMLESS, KRL, call_remedy, names
from calib.programs.languages.robot_program import Collector, Source
from calib.programs.languages.tokens import Code, Span, word_pattern

_WORDS = word_pattern(
    r"[;&][^\n]*", r"[$#]?[^\W\d][\w$]*", r"[=<>]=|<>|[-+*/()\[\]{}=<>,.:!?^%@~|]", r"\"[^\"\n]*\"|'[^'\n]*'"
)
_MOVES = ("PTP", "LIN", "CIRC", "SPTP", "SLIN", "SCIRC", "SPL")
_SELECTED = ("$TOOL", "$BASE", "$IPO_MODE")
_ENDS = ("ENDIF", "ENDFOR", "ENDWHILE", "ENDLOOP", "ENDSWITCH")
_MODIFIERS = ("DECL", "GLOBAL", "CONST", "PUBLIC")
_NO_STATEMENTS = ("EXT", "EXTP", "EXTFCT", "EXTFCTP", "IMPORT", "SIGNAL", "STRUC", "ENUM", "CHANNEL")
_STARTS = names("ELSE CASE DEFAULT UNTIL IF WHILE LOOP REPEAT SWITCH GOTO EXIT RETURN RESUME").union(_ENDS)
_TARGETS = "a tool, base or frame"


@dataclass(frozen=True)
class Aggregate:
    """Components in braces, each with the place of its number; or none where they are not plain numbers.

    Attributes:
        file: Which of the program's files it is in.
        at: Its first word.
        name: What the program calls it.
        components: Places of its numbers by name; None: not plain numbers.
        shared: Whether other modules can set it.
    """

    file: int
    at: int
    name: str
    components: dict[str, tuple[int, int]] | None
    shared: bool = False


@dataclass(frozen=True)
class Frame:
    """A frame that is written out: numbers [m, rad], and the place of the variable that has them."""

    values: tuple[float, ...]
    places: tuple[tuple[int, int], ...] = field(default=())


class KrlStatements(ABC):
    """Reads the statements of a `.src` file, and the declarations of it and its `.dat` file.

    Args:
        sources: The files.
        harmless: Routines of other files that set no data, tool or base, in capitals.

    Attributes:
        declared: Data with braces by name; of those that are declared twice, no numbers.
        forms: Where the data of inline forms stand, by name.
        foreign: The first routine that is declared nowhere here, and what it may do; empty if there is none.
    """

    def __init__(self, sources: list[Source], harmless: Collection[str]) -> None:
        self.sources, self.codes = sources, [Code(source, _WORDS) for source in sources]
        self.code, self.harmless = self.codes[0], KRL | set(harmless)
        none = {
            key: Unknown(f"nothing before it selects a {key[1:].lower()} (BAS, ${key[1:]}, an inline form)")
            for key in _SELECTED[:2]
        }
        self.flow = Flow({**none, "$IPO_MODE": "#BASE", "FDAT_ACT": Unknown("no FDAT_ACT before it"), "DATA": ""})
        self.uses, self.collector = DataUses(), Collector()
        self.declared: dict[str, Aggregate] = {}
        self.forms: dict[str, tuple[int, Span]] = {}
        self.foreign = ""
        self._selecting = {
            self.code.tokens[at].text
            for at in self.code.names(1, len(self.code.tokens))
            if self.code.is_mark(at - 1, "=")
        } | {*_SELECTED, "FDAT_ACT", "DATA", "TOOL_DATA", "BASE_DATA"}
        self.by_reference = self._routines()
        self._keywords = self._keyword_table()

    @abstractmethod
    def frame(self, span: Span, state: State) -> Hashable:
        """Return what a tool or base is set to: a `Frame`, the name of a given one, or `Unknown`."""

    @abstractmethod
    def frame_named(self, name: str, state: State) -> Hashable:
        """Return the frame of a name."""

    @abstractmethod
    def form(self, name: str, state: State) -> tuple[Hashable, Hashable, Hashable]:
        """Return tool, base and interpolation mode of an inline form."""

    @abstractmethod
    def move(self, word: str, span: Span, state: State | None) -> None:
        """Take in one motion: its arguments, and what holds there."""

    def _routines(self) -> dict[str, bool]:
        """Routines of the file, and whether they can set their arguments."""
        code, routines = self.code, {}
        for at in code.names(0, len(code.tokens) - 2):
            if code.tokens[at].text not in ("DEF", "DEFFCT"):
                continue
            bracket = next((k for k in range(at, at + 8) if k < len(code.tokens) and code.is_mark(k, "(")), None)
            if bracket is None:
                raise DataError(f"{code.where(at)}: a routine has no brackets; correct it")
            name, parts = code.tokens[bracket - 1].text, code.split(bracket + 1, code.partner[bracket])
            routines[name] = any(code.tokens[stop - 1].text != "IN" for _, stop in parts)
            for first, _ in parts:
                self.uses.set(code.tokens[first].text, "is given to a routine when it is called")
                self.uses.compute(code.tokens[first].text, [f"{name}()"])
        return routines

    def read(self) -> None:
        """Read all statements of the first file, and the declarations of the others.

        Raises:
            DataError: A branch or loop is not closed, or a statement cannot be read.
        """
        for file in range(1, len(self.codes)):
            self.read_data(file)
        at, end = 0, len(self.code.tokens)
        while at < end:
            token = self.code.tokens[at]
            if token.kind == "line":
                at += 1
            elif token.kind == "name" and self.code.is_mark(at + 1, ":") and token.text not in self._keywords:
                self.flow.label(f"label {token.text}")
                at += 2
            elif token.kind == "name" and token.text in self._keywords:
                at = self._keywords[token.text](at)
            else:
                stop = self._end(at)
                self._statement(at, stop)
                at = stop
        if self.flow.routine:
            raise DataError(f"{self.sources[0].path}: routine '{self.flow.routine.lower()}' has no END; correct it")
        self.flow.finish_all()

    def read_data(self, file: int) -> None:
        """Read a data list."""
        code, at = self.codes[file], 0
        while at < len(code.tokens):
            stop = at
            while code.tokens[stop].kind != "line":
                stop = code.partner[stop] + 1
            if stop > at and code.tokens[at].text not in ("DEFDAT", "ENDDAT", *_NO_STATEMENTS):
                self._declaration(file, at, stop)
            at = stop + 1

    def _end(self, at: int) -> int:
        """Where the statement that begins at a word ends."""
        code = self.code
        while code.tokens[at].kind != "line":
            at = code.partner[at] + 1
            if code.tokens[at].kind == "name" and code.tokens[at].text in _STARTS:
                break
        return at

    def _line_end(self, at: int) -> int:
        while self.code.tokens[at].kind != "line":
            at = self.code.partner[at] + 1
        return at

    def _word(self, first: int, *words: str) -> int:
        """Place of the next of these words in the line, or where the line ends."""
        while self.code.tokens[first].kind != "line" and self.code.tokens[first].text not in words:
            first = self.code.partner[first] + 1
        return first

    def _keyword_table(self) -> dict[str, Callable[[int], int]]:
        return {
            **dict.fromkeys(("DEF", "DEFFCT"), self._begin_routine),
            **dict.fromkeys(("END", "ENDFCT"), self._end_routine),
            **dict.fromkeys(_ENDS, self._close),
            **dict.fromkeys(_NO_STATEMENTS, self._line_end),
            **dict.fromkeys(_MODIFIERS, self._declaration_or_interrupt),
            **dict.fromkeys(("THEN", "DO"), lambda at: at + 1),
            **dict.fromkeys(("ELSE", "CASE", "DEFAULT"), self._branch),
            **dict.fromkeys(("IF", "SWITCH"), self._choice),
            **dict.fromkeys(("WHILE", "LOOP", "REPEAT", "FOR"), self._loop),
            **dict.fromkeys(("SPLINE", "PTP_SPLINE", "ENDSPLINE"), self._spline),
            **dict.fromkeys(("INTERRUPT", "TRIGGER"), self._at_any_time),
            "UNTIL": self._until,
            "WAIT": self._wait,
            "BRAKE": self._line_end,
        }

    def _begin_routine(self, at: int) -> int:
        bracket = next(k for k in range(at, at + 8) if self.code.is_mark(k, "("))
        self.flow.begin(self.code.tokens[bracket - 1].text, self.code.where(at))
        return self.code.partner[bracket] + 1

    def _end_routine(self, at: int) -> int:
        if not self.flow.routine or self.flow.blocks:
            raise DataError(f"{self.code.where(at)}: '{self.code.tokens[at].text}' ends nothing; correct it")
        self.flow.finish()
        return at + 1

    def _close(self, at: int) -> int:
        if not self.flow.routine or not self.flow.blocks:
            raise DataError(f"{self.code.where(at)}: '{self.code.tokens[at].text}' ends nothing; correct it")
        self.flow.close()
        return at + 1

    def _branch(self, at: int) -> int:
        word = self.code.tokens[at].text
        if not self.flow.routine or not self.flow.blocks or self.flow.blocks[-1].loop:
            raise DataError(f"{self.code.where(at)}: '{word}' belongs to nothing; correct it")
        self.flow.next_choice()
        if word != "CASE":
            return at + 1
        stop = self._end(at)
        self._decide(at + 1, stop)
        self.flow.pass_over()
        return stop

    def _choice(self, at: int) -> int:
        stop = self._word(at + 1, "THEN")
        self._decide(at + 1, stop)
        self.flow.open_choice(self.code.tokens[at].text, self.code.line(at))
        self.flow.pass_over()
        return stop

    def _loop(self, at: int) -> int:
        word, stop = self.code.tokens[at].text, self._end(at)
        if word == "FOR":
            self.uses.set(self.code.tokens[at + 1].text)
            self._decide(at + 2, stop)
        self.flow.open_loop(word, self.code.line(at))
        if word == "WHILE":
            self._decide(at + 1, stop)
        if word in ("WHILE", "FOR"):
            self.flow.pass_over()
        return stop if word in ("WHILE", "FOR") else at + 1

    def _until(self, at: int) -> int:
        if not self.flow.routine or not self.flow.blocks or self.flow.blocks[-1].kind != "REPEAT":
            raise DataError(f"{self.code.where(at)}: 'UNTIL' belongs to nothing; correct it")
        stop = self._end(at)
        self._decide(at + 1, stop)
        self.flow.pass_over()
        self.flow.close()
        return stop

    def _wait(self, at: int) -> int:
        stop = self._line_end(at)
        self._decide(at + 1, stop)
        return stop

    def _declaration_or_interrupt(self, at: int) -> int:
        first = at
        while self.code.tokens[first].text in _MODIFIERS:
            first += 1
        word = self.code.tokens[first].text
        if word == "INTERRUPT" or word in ("DEF", "DEFFCT") or word in _NO_STATEMENTS:
            return first
        stop = self._line_end(at)
        self._declaration(0, at, stop)
        return stop

    def _at_any_time(self, at: int) -> int:
        """`INTERRUPT DECL ... DO` and `TRIGGER ... DO`: a statement that is run while the robot moves."""
        stop = self._line_end(at)
        do = self._word(at, "DO")
        self._decide(at, do)
        if do + 1 < stop:
            end = self._word(do, "PRIO")
            self.flow.begin(f"{self.flow.routine} {at}", at_any_time=True)
            self._statement(do + 1, end)
            self.flow.finish()
        return stop

    def _declaration(self, file: int, at: int, stop: int) -> None:
        """Take in a line that declares data, or gives them their first values."""
        code, first, shared = self.codes[file], at, False
        while code.tokens[first].text in _MODIFIERS:
            shared |= code.tokens[first].text == "GLOBAL"
            first += 1
        typed = first + 1 < stop and code.tokens[first + 1].kind == "name"
        kind = code.tokens[first].text if typed else ""
        for left, right in code.split(first + typed, stop):
            equals = code.until(left, right, "=")
            name = "".join(token.text for token in code.tokens[left:equals])
            if equals + 1 >= right:
                continue
            if kind == "FDAT":
                self.forms[name] = (file, (equals + 1, right))
            elif code.inside(equals + 1, right, "{"):
                shown = self.sources[file].text[code.tokens[left].start : code.tokens[equals - 1].end]
                twice = name in self.declared
                components = None if twice else self.components(file, equals + 1, right)
                self.declared[name] = Aggregate(file, equals + 1, shown, components, shared)
            if file == 0:
                self._expression(equals + 1, right)
            self.uses.compute(name, {code.tokens[k].text for k in code.names(equals + 1, right)})

    def components(self, file: int, first: int, stop: int) -> dict[str, tuple[int, int]] | None:
        """Return the places of the numbers in braces; None where it is not plain numbers."""
        code = self.codes[file]
        inside = code.inside(first, stop, "{")
        if inside is None:
            return None
        left, right = inside
        if right > left + 1 and code.is_mark(left + 1, ":"):  # the type may stand first
            left += 2
        components: dict[str, tuple[int, int]] = {}
        for start, end in code.split(left, right):
            number = code.number(start + 1, end)
            if number is None or code.tokens[start].kind != "name" or code.tokens[start].text in components:
                return None
            components[code.tokens[start].text] = number
        return components

    def _names(self, first: int, stop: int) -> set[str]:
        return {self.code.tokens[at].text for at in self.code.names(first, stop)}

    def _decide(self, first: int, stop: int) -> None:
        self._expression(first, stop)
        self.uses.decide(self._names(first, stop), self.code.line(first))

    def _expression(self, first: int, stop: int) -> None:
        """Take in the functions that an expression calls."""
        for at in self.code.calls(first, stop):
            if self.code.tokens[at].text not in ("AND", "OR", "NOT", "EXOR", "B_AND", "B_OR", "B_NOT", "B_EXOR"):
                self._call(at, maybe=True)

    def _call(self, at: int, *, maybe: bool = False) -> None:
        """Take in a call of a routine with its arguments in brackets."""
        name, stop = self.code.tokens[at].text, self.code.partner[at + 1]
        used, shown, line = self._names(at + 2, stop), self.code.shown(at, at + 1), self.code.line(at)
        if name == "BAS" and name not in self.by_reference:
            self._bas(at, maybe)
        elif name in self.by_reference:
            self.uses.compute(f"{name}()", used)
            if self.by_reference[name]:
                self._set(at + 2, stop, f"is an argument of '{shown}', which can set it")
            self.flow.call(name, maybe=maybe)
        elif name not in self.harmless:
            self._set(at + 2, stop, f"is an argument of '{shown}', which is declared nowhere here and can set it")
            self.uses.decide(used, line)
            self._foreign(shown, line)

    def _foreign(self, shown: str, line: int) -> None:
        self.flow.lose(call_remedy(shown, line, f"set {_TARGETS}"))
        self.foreign = self.foreign or (
            f"'{shown}' (line {line}), which is declared nowhere here; say --harmless {shown} if it sets no data"
        )

    def _set(self, first: int, stop: int, why: str) -> None:
        """Note that a call can set its arguments."""
        for at in self.code.names(first, stop):
            if not self.code.is_mark(at - 1, "."):
                self._set_name(at, why)

    def _set_name(self, at: int, why: str) -> None:
        name = self.code.tokens[at].text
        self.uses.set(name, why)
        self._select(name, None, why)

    def _select(self, name: str, value: Callable[[State], Hashable] | None, why: str = "is set in part") -> None:
        """Note that a frame, or another name that something is set to, becomes a value."""
        if name.partition("[")[0] not in self._selecting:
            return
        self.flow.change([name], lambda state: {**state, name: Unknown(why) if value is None else value(state)})

    def _statement(self, at: int, stop: int) -> None:
        """Take in an assignment, a call, a motion or a declaration."""
        code, word = self.code, self.code.tokens[at].text
        equals = code.until(at, stop, "=")
        if word.removesuffix("_REL") in _MOVES and code.tokens[at + 1].text not in ("=", "[", ".", "("):
            self._move(at, stop)
        elif code.tokens[at].kind == "name" and equals < stop and (equals == at + 1 or code.is_mark(at + 1, "[", ".")):
            self._assignment(at, equals, stop)
        elif code.tokens[at].kind == "name" and code.is_mark(at + 1, "(") and code.partner[at + 1] + 1 == stop:
            self._expression(at + 2, stop - 1)
            self._call(at)
        elif word == "GOTO":
            self.flow.jump(f"label {code.tokens[at + 1].text}")
        elif word == "EXIT":
            self.flow.leave_loop()
        elif word == "RETURN":
            self._expression(at + 1, stop)
            self.uses.compute(self.flow.routine, self._names(at + 1, stop))
            self.flow.jump("return")
        elif stop > at + 1 and code.tokens[at + 1].kind == "name" and word not in ("RESUME", "ASYPTP"):
            if word in self.harmless:
                self._expression(at, stop)
            else:
                self._declaration(0, at, stop)
        elif word == "RESUME":
            self.flow.begin(f"{self.flow.routine} {at}", at_any_time=True)
            self._foreign("RESUME", code.line(at))
            self.flow.finish()
        elif word not in self.harmless:
            self._set(at, stop, "is part of a statement that is not understood")
            self._foreign(code.shown(at, stop), code.line(at))

    def _assignment(self, at: int, equals: int, stop: int) -> None:
        code, word = self.code, self.code.tokens[at].text
        self._expression(at + 1, stop)
        value = (equals + 1, stop)
        self.uses.set(word)
        self.uses.compute(word, self._names(at + 1, stop))
        number = code.number(at + 2, equals - 1) if code.is_mark(at + 1, "[") and equals > at + 3 else None
        element = "".join(token.text for token in code.tokens[at:equals])
        if equals == at + 1 and word in ("$IPO_MODE", "FDAT_ACT"):
            self.flow.set(word, "".join(token.text for token in code.tokens[equals + 1 : stop]))
        elif word in ("$IPO_MODE", "FDAT_ACT"):
            self._select(word, None)
        elif word.startswith("$") and word not in _SELECTED:
            if word not in self.harmless:
                self.flow.lose(f"is not known after {word} is set (line {code.line(at)})")
        elif equals == at + 1 or (number is not None and code.partner[at + 1] == equals - 1):
            self._select(element, lambda state: self.frame(value, state))
        elif number is not None or not code.is_mark(at + 1, "["):
            whole = code.partner[at + 1] + 1 if number is not None else at + 1
            self._select(
                "".join(token.text for token in code.tokens[at:whole]), None, f"is set in part (line {code.line(at)})"
            )
        elif word in ("TOOL_DATA", "BASE_DATA"):
            self._select("DATA", None, f"is not known after {word} is set (line {code.line(at)})")

    def _bas(self, at: int, maybe: bool) -> None:
        """Take in a call of BAS, which selects tool and base."""
        code = self.code
        given = code.split(at + 2, code.partner[at + 1])
        what = code.tokens[given[0][0]].text if given else ""
        if what in ("#TOOL", "#BASE") and len(given) == 2 and not maybe:
            name = f"{what[1:]}_DATA[{''.join(token.text for token in code.tokens[slice(*given[1])])}]"
            self._select(f"${what[1:]}", lambda state: self.frame_named(name, state))
        elif what in BAS_FORMS and not maybe:
            self.flow.change(
                _SELECTED,
                lambda state: {**state, **dict(zip(_SELECTED, self.form(str(state["FDAT_ACT"]), state), strict=True))},
            )
        elif what not in BAS_HARMLESS:
            self.flow.lose(f"nothing behind {code.shown(at, code.partner[at + 1] + 1)} selects it", _SELECTED)

    def _spline(self, at: int) -> int:
        stop = self._line_end(at)
        if self.code.tokens[at].text == "ENDSPLINE":
            self._restore("of the program")
            return stop
        self._save("of the program")
        self._with(self._word(at, "WITH"), stop)
        return stop

    def _save(self, key: str) -> None:
        self.flow.change([key], lambda state: {**state, key: tuple(state[name] for name in _SELECTED)})

    def _restore(self, key: str) -> None:
        def restore(state: State) -> State:
            saved = state.get(key)
            values = saved if isinstance(saved, tuple) else [Unknown("is not known behind a spline")] * 3
            return {**state, **dict(zip(_SELECTED, values, strict=True))}

        self.flow.change(_SELECTED, restore)

    def _move(self, at: int, stop: int) -> None:
        """Take in a motion, with what holds for it alone behind WITH."""
        code, word = self.code, self.code.tokens[at].text
        self._expression(at + 1, stop)
        end = min(self._word(at, "WITH"), stop)
        if end < stop:
            self._save("of the motion")
            self._with(end, stop)
        self.flow.move(code.tokens[at].start, lambda state: self.move(word, (at + 1, end), state))
        if end < stop:
            self._restore("of the motion")

    def _with(self, first: int, stop: int) -> None:
        """Take in what a motion or a spline sets for itself, behind WITH."""
        code = self.code
        for left, right in code.split(first + 1, stop):
            name = code.tokens[left].text
            if name not in _SELECTED:
                if name not in self.harmless and name != "$NULLFRAME":
                    self.flow.lose(f"is not known where {name} is set (line {code.line(left)})")
                continue
            if not code.is_mark(left + 1, "="):
                self._select(name, None, f"is set in part (line {code.line(left)})")
                continue
            function = code.tokens[left + 2].text
            if function in ("STOOL", "STOOL2", "SBASE", "SIPO_MODE") and code.is_mark(left + 3, "("):
                self.flow.change([name], self._of_form(name, code.tokens[left + 4].text))
            elif name == "$IPO_MODE":
                self.flow.set(name, "".join(token.text for token in code.tokens[left + 2 : right]))
            else:
                self.flow.change([name], self._of_words(name, (left + 2, right)))

    def _of_form(self, name: str, form: str) -> Change:
        return lambda state: {**state, name: dict(zip(_SELECTED, self.form(form, state), strict=True))[name]}

    def _of_words(self, name: str, span: Span) -> Change:
        return lambda state: {**state, name: self.frame(span, state)}
