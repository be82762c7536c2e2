"""Targets of KRL, the language of KUKA: a `.src` file with the `.dat` file beside it.

The reader takes `PTP`, `LIN`, `CIRC`, `SPL` and their splines with positions (`E6POS`, `POS`, `FRAME`) and axes
(`E6AXIS`, `AXIS`), declared in either file or written out, and the tool and base that hold on every path to the motion.
A statement ends with its line; statements also begin after `THEN`, `ELSE`, `DO` and a label. A statement that is no
assignment, branch, loop or known word may set its arguments, and all frames.

A program selects tool and base by inline forms (`FDAT_ACT` with a `BAS` after it, or `STOOL2` and `SBASE` of a spline),
by `BAS(#TOOL, ...)` and `BAS(#BASE, ...)`, or by an assignment to `$TOOL` and `$BASE`. `BAS(#INITMOV, 0)` selects those
of the controller's set-up, and that the tool is on the robot. `TOOL_DATA` and `BASE_DATA` are in the controller's
`$config.dat`, or in a table of frames.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Hashable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from calib.programs.languages import tokens
from calib.programs.languages.control_flow import State, Unknown
from calib.programs.languages.reader import NO_VALUE, Data, Frames, Reader, as_selected_frame
from calib.programs.languages.robot_program import ITSELF, Configuration, Frame, LeftOutError, ProgramTarget
from calib.programs.languages.tokens import DEGREE, MILLIMETRE, Number, ProgramSource, ProgramWords, Span, word_list

SUFFIXES = (".src",)
_SELECTED = ("$TOOL", "$BASE", "$IPO_MODE")
_WORDS = tokens.word_pattern(
    r"[;&][^\n]*", r"[$#]?[^\W\d][\w$]*", r"[=<>]=|<>|[-+*/()\[\]{}=<>,.:!?^%@~|]", r"\"[^\"\n]*\"|'[^'\n]*'"
)
_BITS = re.compile(r"'(?:B(?P<binary>[01]+)|H(?P<hexadecimal>[\dA-F]+))'", re.IGNORECASE)
_BAS_HARMLESS, _BAS_FORMS = word_list("BAS"), word_list("BAS FORMS")
_POSE = ("X", "Y", "Z", "A", "B", "C")
_LISTS = ("TOOL_DATA", "BASE_DATA")
_NULL = ("$NULLFRAME", "TOOL_DATA[0]", "BASE_DATA[0]")
_AXES = ("A1", "A2", "A3", "A4", "A5", "A6")
_MOVES = ("PTP", "LIN", "CIRC", "SPTP", "SLIN", "SCIRC", "SPL")
_MODIFIERS = ("DECL", "GLOBAL", "CONST", "PUBLIC")
_NO_STATEMENTS = "EXT EXTP EXTFCT EXTFCTP IMPORT SIGNAL STRUC ENUM CHANNEL DEFDAT ENDDAT BRAKE"


def krl_frames(path: Path | str) -> Frames:
    """Return `TOOL_DATA[...]` and `BASE_DATA[...]` of a file, such as `$config.dat`."""
    reader = KrlReader(path, {}, ())
    reader.read_data(0)
    names = [name for name in reader.declared if name.startswith(("TOOL_DATA[", "BASE_DATA["))]
    frames = {name: reader.frame_named(name, reader.flow.start) for name in names}
    return {name: replace(frame, places=()) if isinstance(frame, Frame) else frame for name, frame in frames.items()}


class KrlReader(Reader):
    """Reads a program and the `.dat` file beside it, if there is one; or a data list alone.

    Frames are those that the files do not set, such as `TOOL_DATA[1]`; names are in capitals.
    """

    language, known, danger = "KRL", word_list("KRL"), "set a tool, base or frame"
    ROUTINES = "DEF DEFFCT"
    WORDS: ClassVar = {
        "begin": ROUTINES,
        "finish": "END ENDFCT",
        "close": "ENDIF ENDFOR ENDWHILE ENDLOOP ENDSWITCH",
        "pass_statement": _NO_STATEMENTS,
        "modified": " ".join(_MODIFIERS),
        "skip": "THEN DO",
        "begin_branch": "ELSE DEFAULT",
        "begin_branch condition pass_over": "CASE",
        "condition branch": "IF SWITCH",
        "repeat": "LOOP REPEAT",
        "repeat condition pass_over": "WHILE",
        "condition count repeat pass_over": "FOR",
        "end_loop": "UNTIL",
        "spline": "SPLINE PTP_SPLINE",
        "end_spline": "ENDSPLINE",
        "begin_at_any_time": "INTERRUPT TRIGGER",
        "wait": "WAIT",
        "jump": "GOTO",
        "leave_loop": "EXIT",
        "leave": "RETURN",
        "resume": "RESUME",
    }

    def __init__(self, path: Path | str, frames: Frames, harmless: Collection[str]) -> None:
        program = Path(path)
        data = [program.with_suffix(suffix) for suffix in (".dat", ".DAT", ".Dat") if program.suffix.lower() != ".dat"]
        files = [program, *[file for file in data if file.is_file()][:1]]
        codes = [ProgramWords(ProgramSource.read(file, "a KRL program"), _WORDS) for file in files]
        start: dict[str, Hashable] = {
            key: Unknown(f"nothing before it selects a {key[1:].lower()} (BAS, ${key[1:]}, an inline form)", whole=True)
            for key in _SELECTED[:2]
        }
        start |= {"$IPO_MODE": "#BASE", "FDAT_ACT": Unknown("no FDAT_ACT before it", whole=True), "DATA": ""}
        code = codes[0]
        assigned = {code.word(at) for at in code.names(1) if code.is_mark(at - 1, "=")}
        self._selecting = assigned | {*start, *_LISTS}
        super().__init__(codes, start, frames, harmless)

    def parameter(self, span: Span) -> tuple[list[str], bool]:
        """Return the name of a parameter, and whether it is a reference."""
        return [self.code.word(span[0])], self.code.word(span[1] - 1) != "IN"

    def read(self, at: int = 0) -> None:
        """Read the declarations of the other files, and all statements of the first."""
        for file in range(1, len(self.codes)):
            self.read_data(file)
        super().read(at)

    def read_data(self, file: int) -> None:
        """Read a data list."""
        code, at = self.codes[file], 0
        while at < len(code.tokens):
            stop = code.line_end(at)
            if stop > at and code.word(at) not in _NO_STATEMENTS.split():
                self._declaration(file, at, stop)
            at = stop + 1

    def wait(self, at: int, _: int) -> int:
        """Process the condition that the program waits for."""
        stop = self.code.line_end(at)
        self.decide(at + 1, stop)
        return stop

    def modified(self, at: int, _: int) -> int:
        """Process a statement that begins with DECL, GLOBAL, CONST or PUBLIC."""
        first = _behind_modifiers(self.code, at)
        if self.code.word(first) in self.words:
            return first
        stop = self.code.line_end(at)
        self._declaration(0, at, stop)
        return stop

    def begin_at_any_time(self, at: int, _: int) -> int:
        """Process `INTERRUPT DECL ... DO` and `TRIGGER ... DO`, whose statement runs while the robot moves."""
        stop, do = self.code.line_end(at), self._word(at, "DO")
        self.decide(at, do)
        if do + 1 < stop:
            self.run_at_any_time(at, lambda: self.statement(do + 1, self._word(do, "PRIO")))
        return stop

    def resume(self, at: int, behind: int) -> int:
        """Record that RESUME leaves the interrupted routine."""
        self.run_at_any_time(at, lambda: self.call_elsewhere("RESUME", self.code.line(at)))
        return behind

    def _declaration(self, file: int, at: int, stop: int) -> None:
        """Process a line that declares data or gives them their first values."""
        code, first = self.codes[file], _behind_modifiers(self.codes[file], at)
        shared = any(code.word(k) == "GLOBAL" for k in range(at, first))
        typed = first + 1 < stop and code.tokens[first + 1].kind == "name"
        kind = code.word(first) if typed else ""
        for left, right in code.split(first + typed, stop):
            equals = code.find_mark(left, right, "=")
            if equals + 1 >= right:
                continue
            if code.bracket_content(equals + 1, right, "{"):
                shown = self.sources[file].text[code.tokens[left].start : code.tokens[equals - 1].end]
                self.declare(code.text(left, equals), Data(shown, file, (equals + 1, right), kind, shared))
            else:
                self.uses.note_change(code.word(left), "is not declared as plain numbers")
            if file == 0:
                self.expression(equals + 1, right)
            self.uses.compute(code.word(left), {code.word(k) for k in code.names(equals + 1, right)})

    def statement(self, at: int, stop: int) -> None:
        """Process an assignment, a call, a motion or a declaration."""
        code, word = self.code, self.code.word(at)
        equals = code.find_mark(at, stop, "=")
        is_name, after = code.tokens[at].kind == "name", code.tokens[at + 1]
        if word.removesuffix("_REL") in _MOVES and after.text not in ("=", "[", ".", "("):
            self._move(at, stop)
        elif is_name and equals < stop and (equals == at + 1 or after.text in ("[", ".")):
            self.assign(at, stop, equals)
            self.uses.note_change(word)
            self._select_assigned(at, stop, equals)
        elif word in ("ANIN", "DIGIN") and equals < stop:  # sets a variable repeatedly while the robot moves
            self.run_at_any_time(at, lambda: self.change(code.word(at + 2)))
        elif word in self.harmless or (is_name and after.text == "(" and code.partner[at + 1] + 1 == stop):
            self.expression(at, stop)
        elif is_name and stop > at + 1 and after.kind == "name" and word != "ASYPTP":
            self._declaration(0, at, stop)
        else:
            self.note_arguments((at, stop), "is part of a statement that is not understood")
            self.call_elsewhere(code.excerpt(at, stop), code.line(at))

    def _move(self, at: int, stop: int) -> None:
        """Process a motion; after WITH, it has its own settings."""
        self.expression(at + 1, stop)
        end = min(self._word(at, "WITH"), stop)
        if end < stop:
            self._save("of the motion")
            self._read_with_clause(end, stop)
        self.flow.move(at, lambda state: self._targets(at, end, state))
        if end < stop:
            self._restore("of the motion")

    # words and numbers

    def _word(self, first: int, *words: str) -> int:
        """Return the index of the first of these words in the rest of the line, or of the line's end."""
        while self.code.tokens[first].kind != "end" and self.code.word(first) not in words:
            first = self.code.partner[first] + 1
        return first

    def _components(self, data: Data) -> dict[str, Span] | None:
        """Return the spans of the numbers in braces by component; None if some component is not a plain number."""
        code = self.codes[data.file]
        inside = code.bracket_content(*data.span, "{")
        if inside is None or data.span == NO_VALUE:
            return None
        left, right = inside
        if right > left + 1 and code.is_mark(left + 1, ":"):  # the type may come first
            left += 2
        components = dict[str, Span]()
        for start, end in code.split(left, right):
            number = code.number(start + 1, end) or _bits(code, start, end)
            if number is None or code.tokens[start].kind != "name" or code.word(start) in components:
                return None
            components[code.word(start)] = number
        return components

    def _cells(self, data: Data, names: Sequence[str]) -> tuple[Number, ...]:
        components = self._components(data) or {}
        units = [MILLIMETRE if name in "XYZ" else DEGREE for name in names]
        return self.sources[data.file].numbers([components[name] for name in names], units)

    # tools and bases

    def _constant(self, data: Data) -> Frame | None:
        """The frame that data define; None unless they are six plain numbers."""
        is_pose = set(_POSE) <= set(self._components(data) or {})
        return self.frame_of(data, self._cells(data, _POSE), "zyx") if is_pose else None

    def _frame(self, span: Span, state: State) -> Frame | Unknown:
        if self.code.bracket_content(*span, "{"):
            return self._constant(Data("", 0, span)) or Unknown("is not six plain numbers")
        return self.frame_named(self.code.text(*span), state)

    def frame_named(self, name: str, state: State) -> Frame | Unknown:
        """Return the frame with this name."""
        shown, base = name if "[" in name else name.lower(), name.partition("[")[0]
        value, data = state.get(name), self.declared.get(name)
        if name in _NULL:
            return ITSELF
        if isinstance(value, (Frame, Unknown)):
            return value
        if base in _LISTS and isinstance(state["DATA"], Unknown):
            return Unknown(f"{name} {state['DATA'].why}", whole=True)
        given = self.frames.get(name)
        safe = base in _LISTS or not (self.uses.is_set(name) or (data and data.shared and self.foreign))
        if data is not None and safe and (frame := self._constant(data)) is not None:
            return frame
        if data is not None and base in _LISTS:
            return Unknown(f"{name} is not six plain numbers", whole=True)
        if given is not None:
            return given
        return Unknown(f"{shown} is not known here; give $config.dat with --frames", whole=True)

    def _form(self, form: Hashable, state: State) -> dict[str, Hashable]:
        """Return the selections of an inline form: one that is written out, or its name."""
        if isinstance(form, Unknown):
            return dict.fromkeys(_SELECTED, form)
        name = form.name if isinstance(form, Data) else str(form)
        data = form if isinstance(form, Data) else self.declared.get(name)
        members = dict[str, str]()
        if data is not None and data.kind == "FDAT":
            code = self.codes[data.file]
            parts = code.split(data.span[0] + 1, data.span[1] - 1)
            members = {code.word(first): code.text(first + 1, stop) for first, stop in parts}
        if data is None or self.uses.is_set(name):
            why = f"{name} is {'not declared here' if data is None else 'set while the program runs'}"
        elif not {"TOOL_NO", "BASE_NO"} <= set(members):
            why = f"{name or 'FDAT_ACT'} does not say TOOL_NO and BASE_NO"
        else:
            tool, base = (self.frame_named(f"{kind}_DATA[{members[f'{kind}_NO']}]", state) for kind in ("TOOL", "BASE"))
            return dict(zip(_SELECTED, (tool, base, members.get("IPO_FRAME", "#BASE")), strict=True))
        return dict.fromkeys(_SELECTED, Unknown(why, whole=True))

    def change(self, name: str, why: str = "is set while the program runs") -> None:
        """Process a change of data, or of a frame."""
        self.uses.note_change(name, why)
        self._select(name, None, why)

    def _select(self, name: str, value: Callable[[State], Hashable] | None, why: str = "") -> None:
        """Record that a name which selects frames gets a value; without `value`, it becomes unknown."""
        if name.partition("[")[0] in self._selecting:
            self.flow.change([name], lambda state: {**state, name: value(state) if value else Unknown(why)})

    def _select_assigned(self, at: int, stop: int, equals: int) -> None:
        code, word, line = self.code, self.code.word(at), self.code.line(at)
        number = code.number(at + 2, equals - 1) if code.is_mark(at + 1, "[") and equals > at + 3 else None
        whole = code.partner[at + 1] + 1 if number else at + 1  # after the element of an array
        in_part = f"is set in part (line {line})"
        if word in ("$IPO_MODE", "FDAT_ACT"):
            is_form = code.bracket_content(equals + 1, stop, "{")
            value = Data("", 0, (equals + 1, stop), "FDAT") if is_form else code.text(equals + 1, stop)
            self._select(word, (lambda _: value) if equals == at + 1 else None, in_part)
        elif word.startswith("$") and word not in _SELECTED:
            if word not in self.harmless:
                self.flow.mark_unknown(f"is not known after {word} is set (line {line})")
        elif equals == whole:
            self._select(code.text(at, equals), lambda state: self._frame((equals + 1, stop), state))
        elif number is not None or not code.is_mark(at + 1, "["):
            self._select(code.text(at, whole), None, in_part)
        elif word in _LISTS:
            self._select("DATA", None, f"is not known after {word} is set (line {line})")

    def read_known_call(self, at: int, span: Span, *, maybe: bool) -> bool:
        """Process a call of BAS, which selects tool and base; return whether the call is known."""
        name, code = self.code.word(at), self.code
        if name != "BAS":
            return name in self.harmless
        given = code.split(*span)
        what = code.word(given[0][0]) if given else ""
        if what in ("#TOOL", "#BASE") and len(given) == 2 and not maybe:
            frame = f"{what[1:]}_DATA[{code.text(*given[1])}]"
            self._select(f"${what[1:]}", lambda state: self.frame_named(frame, state))
        elif what in _BAS_FORMS and not maybe:
            self.flow.change(_SELECTED, lambda state: {**state, **self._form(state["FDAT_ACT"], state)})
        elif what == "#INITMOV" and not maybe:
            self.flow.mark_unknown(f"is not selected after {code.excerpt(at, span[1] + 1)}", _SELECTED[:2])
            self.flow.note_setting("$IPO_MODE", "#BASE")
        elif what not in _BAS_HARMLESS:
            self.flow.mark_unknown(f"is not selected after {code.excerpt(at, span[1] + 1)}", _SELECTED)
        return True

    def spline(self, at: int, _: int) -> int:
        """Begin a spline, with its own selections after WITH."""
        stop = self.code.line_end(at)
        self._save("of the program")
        self._read_with_clause(self._word(at, "WITH"), stop)
        return stop

    def end_spline(self, at: int, _: int) -> int:
        """End a spline."""
        self._restore("of the program")
        return self.code.line_end(at)

    def _save(self, key: str) -> None:
        self.flow.change([key], lambda state: {**state, key: tuple(state[name] for name in _SELECTED)})

    def _restore(self, key: str) -> None:

        def restored(state: State) -> State:
            saved = state.get(key)
            values = saved if isinstance(saved, tuple) else [Unknown("is not known after a spline")] * 3
            return {**state, **dict(zip(_SELECTED, values, strict=True))}

        self.flow.change(_SELECTED, restored)

    def _read_with_clause(self, first: int, stop: int) -> None:
        """Process the selections of one motion or spline, after WITH."""
        code = self.code
        for left, right in code.split(first + 1, stop):
            name, line = code.word(left), code.line(left)
            if name not in _SELECTED:
                if name not in self.harmless and name != "$NULLFRAME":
                    self.flow.mark_unknown(f"is not known where {name} is set (line {line})")
            elif code.text(left + 2, left + 4) in ("STOOL(", "STOOL2(", "SBASE(", "SIPO_MODE("):
                form = code.word(left + 4)
                self._select(name, lambda state, name=name, form=form: self._form(form, state)[name])  # type: ignore[misc]
            elif code.is_mark(left + 1, "="):
                self._select_assigned(left, right, left + 1)
            else:
                self._select(name, None, f"is set in part (line {line})")

    # targets

    def _targets(self, at: int, stop: int, state: State | None) -> None:
        code, (base, _, relative), spans = self.code, self.code.word(at).partition("_"), list[Span]()
        for first, last in code.split(at + 1, stop)[: 2 if base.endswith("CIRC") else 1]:
            spans.append((first, next((k for k in range(first, last) if code.word(k).startswith("C_")), last)))
        self.go(spans, state, lambda span: self._data(span, bool(relative)), self._target)

    def _data(self, span: Span, relative: bool) -> Data:
        code, name = self.code, self.code.text(*span)
        if relative:
            raise LeftOutError("is relative to where the robot is")
        data = Data("", 0, span) if code.bracket_content(*span, "{") else self.declared.get(name)
        if data is None:
            declarable = code.name(*span) and not name.startswith("$")
            otherwise = "is not declared here" if declarable else "is computed at run time"
            raise LeftOutError(self.uses.why_not(name) or otherwise)
        return data

    def _target(self, data: Data, state: State) -> ProgramTarget:
        self.require_constant(data)
        components = self._components(data)
        if components is None:
            raise LeftOutError("is not plain numbers")
        source = self.sources[data.file]
        numbers = {key: _value(source.text[slice(*place)]) for key, place in components.items()}
        if any(numbers.get(f"E{k}", 0.0) for k in range(1, 7)):
            raise LeftOutError("moves external axes, which the description does not have")
        if set(_AXES) <= set(numbers):
            return self.target(data, self._cells(data, _AXES))
        if not set(_POSE) <= set(numbers):
            raise LeftOutError("gives only a part of a position; the rest depends on where the robot is")
        cells = self._cells(data, _POSE)
        tool, base = (as_selected_frame(key, state[key]) for key in _SELECTED[:2])
        if (mode := state["$IPO_MODE"]) != "#BASE":
            off = "the tool is not on the robot"
            raise LeftOutError(off if mode == "#TCP" else "it is not known whether the tool is on the robot")
        return self.target(data, cells, "zyx", base, tool, _configuration(numbers))


def _behind_modifiers(code: ProgramWords, at: int) -> int:
    while code.word(at) in _MODIFIERS:
        at += 1
    return at


def _bits(code: ProgramWords, start: int, end: int) -> Span | None:
    """The span in the text of S or T as bits, such as `'B010'`."""
    _, text, *span = code.tokens[end - 1]
    is_written = end == start + 2 and code.word(start) in ("S", "T") and _BITS.fullmatch(text)
    return (span[0], span[1]) if is_written else None


def _value(text: str) -> float:
    written = _BITS.fullmatch(text)
    if written is None:
        return float(text)
    return float(int(written["binary"], 2) if written["binary"] else int(written["hexadecimal"], 16))


def _configuration(numbers: Mapping[str, float]) -> Configuration | None:
    """Bits 0 and 1 of S: sides of axes 1 and 3. Bits of T: signs of the axes. Bit 2 of S adds nothing to these."""
    text = ", ".join(f"{key} {numbers[key]:g}" for key in ("S", "T") if key in numbers)
    if not text:
        return None
    ranges = {}
    if "T" in numbers:
        turns = int(numbers["T"])
        ranges = {k: (-np.inf, 0.0) if turns >> k & 1 else (0.0, np.inf) for k in range(6)}
    if "S" not in numbers:
        return Configuration(text, ranges)
    return Configuration(text, ranges, (bool(int(numbers["S"]) & 1), None, None, bool(int(numbers["S"]) & 2)))
