"""Targets of RAPID, the language of ABB.

The reader finds each `robtarget` and `jointtarget` of `MoveL`, `MoveJ`, `MoveC`, `MoveAbsJ`, and of instructions that
do something else while they move (`MoveLDO`, `TriggL`, `ArcL`, `SpotL` ...). Targets are declared as constants,
persistents or variables, one by one or in arrays, or are written out. The instruction names its tool (`tooldata`) and
work object (`wobjdata`), which are declared in the program, in another module, or in a table of frames. Axis
configurations count while `ConfL` and `ConfJ` are on.

Statements end with a semicolon; `IF c x := 1;` is a statement within a statement. Data that the program sets anywhere
are not constant. A routine may set its `INOUT`, `PERS`, `VAR` or `REF` parameters. A routine that is not declared here
may set any of its arguments, and all data that are not `LOCAL`.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import ClassVar

import numpy as np
import pinocchio as pin

from calib.core.base.errors import DataError
from calib.programs.languages import tokens
from calib.programs.languages.control_flow import State, Unknown
from calib.programs.languages.reader import NO_VALUE, Data, Frames, Reader, as_selected_frame
from calib.programs.languages.robot_program import ITSELF, Configuration, Frame, LeftOutError, ProgramTarget, pose_of
from calib.programs.languages.tokens import DEGREE, MILLIMETRE, Number, ProgramSource, ProgramWords, Span, word_list

_WORDS = tokens.word_pattern(r"![^\n]*", r"[^\W\d]\w*", r":=|<=|>=|<>|[-+*/()\[\]{}=<>,.:;\\?|%]")
_SETTING = word_list("RAPID SETS")  # routines that set some of their arguments and nothing else
_SIZES = {"ROBTARGET": 4, "JOINTTARGET": 2, "TOOLDATA": 3, "WOBJDATA": 5}  # number of components by type
_REFERENCES = ("INOUT", "PERS", "VAR", "REF")
_TWO_TARGETS = re.compile(r"(MOVE|TRIGG|ARC|DISP|PAINT)C")
_BY_NAME = ("SETDATAVAL", "SETALLDATAVAL", "GETDATAVAL")  # set or read data, even LOCAL ones, by a name in a text
_FIXED = {"TOOL0": ITSELF, "WOBJ0": ITSELF}
SUFFIXES = (".mod", ".modx", ".prg", ".sys")
_OPERATORS = ("AND", "OR", "XOR", "NOT", "DIV", "MOD")
_MOVE = re.compile(
    r"(?:MOVE|TRIGG)(?:L|C|J|ABSJ)(?:SYNC|DO|AO|GO|IOS)?|ARC[LC](?:START|END|\d)?|SPOT(?:L|J|ML|MJ)"
    r"|(?:DISP|PAINT|SEARCH)[LC](?:START|END)?"
)
_ABSOLUTE = re.compile(r"\w+ABSJ")
_DISPLACED = Unknown("is active here (PDispOn, PDispSet, EOffsOn)")
_MODES: dict[str, tuple[str, Unknown | None]] = {
    "PDISPON": ("PDISP", _DISPLACED),
    "PDISPSET": ("PDISP", _DISPLACED),
    "PDISPOFF": ("PDISP", None),
    "EOFFSON": ("EOFFS", _DISPLACED),
    "EOFFSSET": ("EOFFS", _DISPLACED),
    "EOFFSOFF": ("EOFFS", None),
}
_NONE = 8e9  # RAPID writes 9E9 for external axes that do not exist
_QUARTER = np.pi / 2


def rapid_frames(path: Path | str) -> Frames:
    """Return the tools and work objects that a module declares; `Unknown` with the reason for unusable ones."""
    reader, frames = RapidReader(path, {}, ()), dict[str, Frame | Unknown]()
    reader.read()
    for name, data in reader.declared.items():
        if data.kind not in ("TOOLDATA", "WOBJDATA") or data.span == NO_VALUE:
            continue
        try:
            frames[name] = reader.frame(data)
        except LeftOutError as why:
            frames[name] = Unknown(str(why), whole=True)
        if reader.uses.is_set(name.partition("{")[0]):
            frames[name] = Unknown(f"'{name.lower()}' is set by its module", whole=True)
    return frames


class RapidReader(Reader):
    """Reads a module; `frames` and `harmless` are names in capitals."""

    language, known, assigning, danger = "RAPID", word_list("RAPID"), ":=", "change a mode of motion"
    ROUTINES = "PROC FUNC"
    WORDS: ClassVar = {
        "begin": ROUTINES,
        "begin_trap": "TRAP",
        "finish": "ENDPROC ENDFUNC ENDTRAP",
        "handle": "ERROR UNDO BACKWARD",
        "declaration": "CONST PERS VAR",
        "skip": "LOCAL TASK THEN DO ENDMODULE",
        "module": "MODULE",
        "record": "RECORD",
        "pass_statement": "ALIAS",
        "if_": "IF",
        "condition branch": "TEST",
        "begin_branch condition pass_over": "ELSEIF CASE",
        "begin_branch": "ELSE DEFAULT",
        "condition count repeat pass_over": "FOR",
        "repeat condition pass_over": "WHILE",
        "close": "ENDIF ENDFOR ENDWHILE ENDTEST",
        "jump": "GOTO",
        "leave": "RETURN RAISE",
        "condition halt": "EXIT EXITCYCLE RETRY TRYNEXT",
    }

    def __init__(self, path: Path | str, frames: Frames, harmless: Collection[str]) -> None:
        source = ProgramSource.read(path, "a RAPID module")
        code = ProgramWords(source, _WORDS, lines="blank", ends=";:")
        start: State = {"PDISP": None, "EOFFS": None, "CONFL": True, "CONFJ": True}
        super().__init__([code], start, {**_FIXED, **frames}, harmless)
        self.sets_by_name = any(token.text in _BY_NAME for token in code.tokens)
        self.routines |= {code.word(at + 1): False for at in code.names() if code.word(at) == "TRAP"}

    def read(self, at: int = 0) -> None:
        """Read all statements after the header of a controller: %%% ... %%%."""
        marks = [at for at in range(len(self.code.tokens)) if self.code.is_mark(at, "%")][:6]
        super().read(marks[-1] + 1 if self.code.is_mark(0, "%") else at)

    def skip(self, at: int, behind: int) -> int:
        """Go on after a word; a semicolon ends one-statement branches (`IF c x := 1;`)."""
        if self.code.word(at) == ";":
            self._close_compact()
        return behind

    def _close_compact(self) -> None:
        while self.blocks and self.blocks[-1].kind == "":
            self.close_block()

    def close(self, at: int, behind: int) -> int:
        """End branches or a loop, and the one-statement branches that they end."""
        super().close(at, behind)
        self._close_compact()
        return behind

    def module(self, at: int, _: int) -> int:
        """Go on after the name of the module and its attributes."""
        return self.code.partner[at + 2] + 1 if self.code.is_mark(at + 2, "(") else at + 2

    def record(self, at: int, _: int) -> int:
        """Go on after the declaration of a type."""
        end = len(self.code.tokens) - 1
        return next((k for k in range(at, end) if self.code.word(k) == "ENDRECORD"), end) + 1

    def begin_trap(self, at: int, _: int) -> int:
        """Begin a routine that runs at an interrupt."""
        self.flow.begin(self.code.word(at + 1), self.code.location(at), at_any_time=True)
        return at + 2

    def handle(self, at: int, _: int) -> int:
        """Begin an error handler, which runs at an error."""
        self.flow.jump("return")
        name = f"{self.flow.routine} {self.code.word(at)}"
        self.flow.finish()
        self.flow.begin(name, self.code.location(at), at_any_time=True)
        return self.code.partner[at + 1] + 1 if self.code.is_mark(at + 1, "(") else at + 1

    def declaration(self, at: int, _: int) -> int:
        """Process a declaration of data."""
        code, stop = self.code, self.end(at + 1)
        kind, name = code.word(at + 1), at + 2
        local = (at > 0 and code.word(at - 1) == "LOCAL") or bool(self.flow.routine)
        equals = code.find_mark(name, stop, ":=")
        if kind in _SIZES:
            shared = self.sets_by_name or (code.word(at) != "CONST" and not local)
            value = equals + 1, stop
            shown, key = code.excerpt(name, name + 1), code.word(name)
            if not code.is_mark(name + 1, "{"):
                self.declare(key, Data(shown, 0, value if equals < stop else NO_VALUE, kind, shared))
            inside = code.bracket_content(*value, "[") if code.is_mark(name + 1, "{") else None
            for k, span in enumerate(code.split(*inside) if inside else (), 1):
                self.declare(f"{key}{{{k}}}", Data(f"{shown}{{{k}}}", 0, span, kind, shared))
        self.expression(equals + 1, stop)
        self.uses.compute(code.word(name), self.names(equals + 1, stop))
        return stop

    def if_(self, at: int, _: int) -> int:
        """Begin branches; the condition ends before a word that cannot follow a value."""
        code, stop, value = self.code, at + 1, False
        while code.tokens[stop].kind != "end" and not code.is_mark(stop, ":="):
            token = code.tokens[stop]
            if token.kind == "mark" and token.text in "([{":
                stop, value = code.partner[stop], True
            elif token.kind == "mark" or token.text in _OPERATORS:
                if value and token.text == "%":
                    break
                value = False
            elif value:
                break
            else:
                value = True
            stop += 1
        self.decide(at + 1, stop)
        self.open_block("IF" if code.word(stop) == "THEN" else "", code.line(at))
        return self.pass_over(at, stop)

    def read_known_call(self, at: int, span: Span, *, maybe: bool) -> bool:
        """Process a call of a built-in routine, which may set its arguments; return whether the call is known."""
        name = self.code.word(at)
        if name in _SETTING:
            self.note_arguments(span, f"is set by '{self.code.excerpt(at, at + 1)}'")
        if name == "WAITUNTIL":
            self.uses.decide(self.names(*span), self.code.line(at))
        return name in _SETTING or name in self.harmless

    def statement(self, at: int, stop: int) -> None:
        """Process an assignment or an instruction."""
        code, word = self.code, self.code.word(at)
        equals = code.find_mark(at, stop, ":=")
        if code.tokens[at].kind != "name":
            self.note_arguments((at, stop), "is an argument of a routine that is chosen at run time")
            self.call_elsewhere(code.excerpt(at, stop), code.line(at))
        elif equals < stop and code.is_mark(at + 1, ":=", "{", "."):
            self.assign(at, stop, equals)
            self.uses.note_change(word)
        elif word == "CONNECT":
            self.uses.note_change(code.word(at + 1))
        elif word in ("CONFL", "CONFJ"):
            self.flow.note_setting(word, "OFF" not in self.names(at + 1, stop))
        else:
            self.expression(at + 1, stop)
            if word in _MODES:
                self.flow.note_setting(*_MODES[word])
            elif _MOVE.fullmatch(word) and stop > at + 1:
                self._move(word, at, stop)
            else:
                self.call(at, (at + 1, stop))

    def _move(self, word: str, at: int, stop: int) -> None:
        """Process a motion: arguments between commas, and options after backslashes."""
        code, spans, options = self.code, list[Span](), dict[str, Span]()
        for first, last in code.split(at + 1, stop):
            end = code.find_mark(first, last, "\\")
            if end > first:
                spans.append((first, end))
            for left, right in code.split(end + 1, last, "\\"):
                behind = left + 2 if code.is_mark(left + 1, ":=", "?") else left + 1
                options[code.word(left)] = (behind, right)
                if behind == left + 1 and right > behind:
                    spans.append((behind, right))
        if word.startswith("SEARCH"):
            for span in spans[1:2]:
                self.note_arguments(span, "is set by a search")
        for k in range(at, stop) if word.endswith("SYNC") else ():
            if code.tokens[k].kind == "text":
                self.run_at_any_time(k, lambda k=k: self._call_named(k))  # type: ignore[misc]
        self.flow.move(at, lambda state: self._targets(word, spans, options, state))

    def _call_named(self, at: int) -> None:
        """Process a call of a routine whose name is given as text."""
        name = self.code.word(at).strip('"').upper()
        if name in self.routines:
            self.flow.call(name)
        elif name not in self.harmless:
            self.call_elsewhere(name, self.code.line(at))

    def parameter(self, span: Span) -> tuple[list[str], bool]:
        """Return the names of a parameter, and whether it is a reference."""
        names = [
            self.code.word(k) for k in self.code.names(*span) if self.code.is_mark(k + 1, ",", ")", "\\", "|", "{")
        ]
        return names, bool(self.names(*span) & {*_REFERENCES})

    def _parts(self, span: Span) -> list[Span]:
        inside = self.code.bracket_content(*span, "[")
        if inside is None:
            raise LeftOutError(f"'{self.code.excerpt(*span)}' is not written out as numbers")
        return self.code.split(*inside)

    def _numbers(self, span: Span, count: int, what: str) -> list[tuple[int, int]]:
        numbers = []
        for part in self._parts(span):
            number = self.code.number(*part)
            if number is None:
                raise LeftOutError(f"'{self.code.excerpt(*part)}' is not a plain number")
            numbers.append(number)
        if len(numbers) != count:
            raise DataError(f"{self.code.location(span[0])}: {what} has {len(numbers)} numbers; expected {count}")
        return numbers

    def _values(self, span: Span, count: int, what: str) -> list[float]:
        return [float(self.sources[0].text[slice(*place)]) for place in self._numbers(span, count, what)]

    def _complete(self, data: Data) -> list[Span]:
        """Return the components of data; `DataError` if some are missing."""
        parts = self._parts(data.span)
        if len(parts) != _SIZES[data.kind]:
            what = f"{data.kind.lower()} '{data.name}' is not complete; correct it"
            raise DataError(f"{self.code.location(data.span[0])}: {what}")
        return parts

    def _pose(self, parts: Sequence[Span]) -> tuple[tuple[Number, ...], pin.SE3]:
        where = self.code.location(parts[0][0])
        if len(parts) != 2:
            raise DataError(f"{where}: a frame is written [[x,y,z],[q1,q2,q3,q4]]; correct it")
        spans = self._numbers(parts[0], 3, "a position") + self._numbers(parts[1], 4, "a quaternion")
        cells = self.code.source.numbers(spans, (*[MILLIMETRE] * 3, *[0.0] * 4))
        return cells, pose_of([cell.value for cell in cells], "quaternion", where)

    def frame(self, data: Data) -> Frame:
        """Return a tool or work object as a frame, or raise `LeftOutError`."""
        parts = self._complete(data)
        texts = [self.code.word(start) for start, _ in parts]
        if data.kind == "TOOLDATA" and texts[0] != "TRUE":
            raise LeftOutError(f"tool '{data.name}' is not on the robot")
        if data.kind == "WOBJDATA" and texts[0] != "FALSE":
            raise LeftOutError(f"the robot holds work object '{data.name}'")
        if data.kind == "WOBJDATA" and texts[1] != "TRUE":
            raise LeftOutError(f"work object '{data.name}' is moved by another unit")
        try:
            poses = [
                self._pose(self._parts(part))[1] for part in (parts[1:2] if data.kind == "TOOLDATA" else parts[3:])
            ]
        except LeftOutError as why:
            raise LeftOutError(f"'{data.name}' is not constant: {why}") from None
        return Frame(poses[0] if data.kind == "TOOLDATA" else poses[0] * poses[1])

    def _frame_in(self, spans: Sequence[Span], kind: str, what: str, usual: Sequence[Span]) -> Frame:
        """The last tool or work object in spans, or `LeftOutError` if none is declared, or the program may set it.

        It is expected in the spans `usual`, for messages.
        """
        names = [self.code.text(*span) for span in spans]
        known = [x for x in names if (self.declared[x].kind == kind if x in self.declared else x in self.frames)]
        if not known:
            shown = next((self.code.excerpt(*span) for span in usual), "?")
            raise LeftOutError(f"{what} '{shown}' is not declared here; give its module with --frames")
        name = known[-1]
        data, shown, base = self.declared.get(name), f"'{name.lower()}'", name.partition("{")[0]
        if self.uses.is_set(base):
            raise LeftOutError(f"{shown} {self.uses.why_not(base)}")
        if self.foreign and name not in _FIXED and (data is None or data.shared):
            raise LeftOutError(f"{shown} may be set by {self.foreign}")
        if data is None or data.span == NO_VALUE:
            return as_selected_frame(shown, self.frames.get(name, Unknown("is not constant: it has no value")))
        return self.frame(data)

    # targets

    def _targets(self, word: str, spans: Sequence[Span], options: Mapping[str, Span], state: State | None) -> None:
        targets = list(spans[: 2 if _TWO_TARGETS.match(word) else 1])
        if word.startswith("SEARCH"):
            targets = [span for span in spans[:4] if self.code.text(*span) in self.declared][-1:] or targets
        find = partial(self._data, word)
        self.go(targets, state, find, lambda data, state: self._target(word, data, spans, options, state))

    def _data(self, word: str, span: Span) -> Data:
        name = self.code.text(*span)
        if word.startswith("SEARCH"):
            raise LeftOutError("is where a search ends, not where the robot stops")
        if self.code.bracket_content(*span, "["):
            return Data("", 0, span, "JOINTTARGET" if _ABSOLUTE.match(word) else "ROBTARGET")
        data = self.declared.get(name)
        if data is not None and data.kind.endswith("TARGET") and data.span != NO_VALUE:
            return data
        moved = self.code.word(span[0] + 2) if name.startswith(("OFFS(", "RELTOOL(")) else ""
        along = f"; it moves along with {self.declared[moved].name}" if moved in self.declared else ""
        base = name.partition("{")[0]
        chosen = f"{base}{{1}}" in self.declared
        why = self.uses.why_not(base) or ("is chosen at run time" if chosen else "is not declared here")
        raise LeftOutError(f"is computed at run time{along}" if "(" in name else why)

    def _target(
        self, word: str, data: Data, spans: Sequence[Span], options: Mapping[str, Span], state: State
    ) -> ProgramTarget:
        self.require_constant(data)
        if "CORR" in options:
            raise LeftOutError("is corrected while the robot moves (\\Corr)")
        parts = self._complete(data)
        if any(0 != value < _NONE for value in self._values(parts[-1], 6, "extax")):
            raise LeftOutError("moves external axes, which the description does not have")
        if isinstance(state["EOFFS"], Unknown):
            raise LeftOutError(f"an offset of axes {state['EOFFS'].why}")
        if data.kind == "JOINTTARGET":
            spans = self._numbers(parts[0], 6, "robax")
            return self.target(data, self.code.source.numbers(spans, [DEGREE] * 6))
        cells, _ = self._pose(parts[:2])
        if isinstance(state["PDISP"], Unknown):
            raise LeftOutError(f"a program displacement {state['PDISP'].why}")
        tool = self._frame_in(spans, "TOOLDATA", "tool", spans[4 if _TWO_TARGETS.match(word) else 3 :])
        wobj = [options["WOBJ"]] if "WOBJ" in options else []
        frame = self._frame_in(wobj, "WOBJDATA", "work object", wobj) if wobj else ITSELF
        checked = state["CONFJ" if word.startswith(("MOVEJ", "TRIGGJ")) else "CONFL"]
        if isinstance(checked, Unknown):
            raise LeftOutError(f"whether its configuration is checked {checked.why}")
        configuration = self._configuration(parts[2]) if checked else None
        return self.target(data, cells, "quaternion", frame, tool, configuration)

    def _configuration(self, span: Span) -> Configuration:
        """cf1, cf4, cf6 are quarter turns of axes 1, 4, 6; bit 4 of cfx is the side of axis 1, bit 2 of the arm."""
        quarters = [round(value) for value in self._values(span, 4, "a configuration")]
        ranges = {joint: (q * _QUARTER, (q + 1) * _QUARTER) for joint, q in zip((0, 3, 5), quarters[:3], strict=True)}
        return Configuration(
            self.code.excerpt(*span), ranges, (bool(quarters[3] & 4), bool(quarters[3] & 2), None, None)
        )
