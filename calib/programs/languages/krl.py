"""Targets of KRL, the language of KUKA: a `.src` file with the `.dat` file beside it.

The reader takes `PTP`, `LIN`, `CIRC`, `SPL` and their splines with positions (`E6POS`, `POS`, `FRAME`) and axes
(`E6AXIS`, `AXIS`), declared in either file or written out, and the tool and base that hold on every path to the motion
(`krl_frames`). A statement ends with its line; statements also begin after `THEN`, `ELSE`, `DO` and a label. A
statement that is no assignment, branch, loop or known word may set its arguments, and all frames.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from calib.programs.languages.control_flow import State
from calib.programs.languages.frames import Frame, Frames, as_selected_frame
from calib.programs.languages.krl_frames import SELECTED, KrlFrames
from calib.programs.languages.reader import Data, Reached
from calib.programs.languages.robot_program import Configuration, LeftOutError, ProgramSource
from calib.programs.languages.tokens import Span

SUFFIXES = (".src",)
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


class KrlReader(KrlFrames):
    """Reads a program and the `.dat` file beside it, if there is one; or a data list alone."""

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
        super().__init__([ProgramSource.read(file, "a KRL program") for file in files], frames, harmless)

    def parameter(self, span: Span) -> tuple[list[str], bool]:
        """Return the name of a parameter, and whether it is a reference."""
        return [self.code.tokens[span[0]].text], self.code.tokens[span[1] - 1].text != "IN"

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
            if stop > at and code.tokens[at].text not in _NO_STATEMENTS.split():
                self._declaration(file, at, stop)
            at = stop + 1

    def wait(self, at: int, _: int) -> int:
        """Process the condition that the program waits for."""
        stop = self.code.line_end(at)
        self.decide(at + 1, stop)
        return stop

    def modified(self, at: int, _: int) -> int:
        """Process a statement that begins with DECL, GLOBAL, CONST or PUBLIC."""
        first = at
        while self.code.tokens[first].text in _MODIFIERS:
            first += 1
        if self.code.tokens[first].text in self.words:
            return first
        stop = self.code.line_end(at)
        self._declaration(0, at, stop)
        return stop

    def begin_at_any_time(self, at: int, _: int) -> int:
        """Process `INTERRUPT DECL ... DO` and `TRIGGER ... DO`, whose statement runs while the robot moves."""
        stop, do = self.code.line_end(at), self.word(at, "DO")
        self.decide(at, do)
        if do + 1 < stop:
            self.run_at_any_time(at, lambda: self.statement(do + 1, self.word(do, "PRIO")))
        return stop

    def resume(self, at: int, behind: int) -> int:
        """Record that RESUME leaves the interrupted routine."""
        self.run_at_any_time(at, lambda: self.call_elsewhere("RESUME", self.code.line(at)))
        return behind

    def _declaration(self, file: int, at: int, stop: int) -> None:
        """Process a line that declares data or gives them their first values."""
        code, first = self.codes[file], at
        while code.tokens[first].text in _MODIFIERS:
            first += 1
        shared = any(code.tokens[k].text == "GLOBAL" for k in range(at, first))
        typed = first + 1 < stop and code.tokens[first + 1].kind == "name"
        kind = code.tokens[first].text if typed else ""
        for left, right in code.split(first + typed, stop):
            equals = code.find_mark(left, right, "=")
            if equals + 1 >= right:
                continue
            if code.bracket_content(equals + 1, right, "{"):
                shown = self.sources[file].text[code.tokens[left].start : code.tokens[equals - 1].end]
                self.declare(code.text(left, equals), Data(shown, file, (equals + 1, right), kind, shared))
            else:
                self.uses.note_change(code.tokens[left].text, "is not declared as plain numbers")
            if file == 0:
                self.expression(equals + 1, right)
            names = {code.tokens[k].text for k in code.names(equals + 1, right)}
            self.uses.compute(code.tokens[left].text, names)

    def statement(self, at: int, stop: int) -> None:
        """Process an assignment, a call, a motion or a declaration."""
        code, word = self.code, self.code.tokens[at].text
        equals = code.find_mark(at, stop, "=")
        is_name, after = code.tokens[at].kind == "name", code.tokens[at + 1]
        if word.removesuffix("_REL") in _MOVES and after.text not in ("=", "[", ".", "("):
            self._move(at, stop)
        elif is_name and equals < stop and (equals == at + 1 or after.text in ("[", ".")):
            self.assign(at, stop, equals)
            self.uses.note_change(word)
            self.select_assigned(at, stop, equals)
        elif word in ("ANIN", "DIGIN") and equals < stop:  # sets a variable repeatedly while the robot moves
            self.run_at_any_time(at, lambda: self.change(code.tokens[at + 2].text))
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
        end = min(self.word(at, "WITH"), stop)
        if end < stop:
            self.save("of the motion")
            self.read_with_clause(end, stop)
        self.flow.move(self.code.tokens[at].start, lambda state: self._targets(at, end, state))
        if end < stop:
            self.restore("of the motion")

    # targets

    def _targets(self, at: int, stop: int, state: State | None) -> None:
        code, (base, _, relative) = self.code, self.code.tokens[at].text.partition("_")
        for first, last in code.split(at + 1, stop)[: 2 if base.endswith("CIRC") else 1]:
            end = next((k for k in range(first, last) if code.tokens[k].text.startswith("C_")), last)
            span = first, end
            self.go(span, state, lambda span=span: self._data(span, bool(relative)), self._target)  # type: ignore[misc]

    def _data(self, span: Span, relative: bool) -> Data:
        """The numbers of a target, written out or declared."""
        code, name = self.code, self.code.text(*span)
        if relative:
            raise LeftOutError("is relative to where the robot is")
        data = Data("", 0, span) if code.bracket_content(*span, "{") else self.declared.get(name)
        if data is None:
            single = span[1] == span[0] + 1 and code.tokens[span[0]].kind == "name" and not name.startswith("$")
            otherwise = "is not declared here" if single else "is computed at run time"
            raise LeftOutError(self.uses.why_not(name) or otherwise)
        return data

    def _target(self, data: Data, state: State) -> Reached:
        self.require_constant(data)
        components = self.components(data)
        if components is None:
            raise LeftOutError("is not plain numbers")
        source = self.sources[data.file]
        numbers = {key: float(source.text[slice(*place)]) for key, place in components.items()}
        if any(numbers.get(f"E{k}", 0.0) for k in range(1, 7)):
            raise LeftOutError("moves external axes, which the description does not have")
        if set(_AXES) <= set(numbers):
            return self.target(data, self.cells(data, _AXES))
        cells = self.pose_cells(data)
        if cells is None:
            raise LeftOutError("gives only a part of a position; the rest depends on where the robot is")
        tool, base = (as_selected_frame(key, state[key]) for key in SELECTED[:2])
        mode = state["$IPO_MODE"]
        if mode != "#BASE":
            raise LeftOutError(
                "the tool is not on the robot" if mode == "#TCP" else "it is not known whether the tool is on the robot"
            )
        return self.target(data, cells, "zyx", base, tool, _configuration(numbers))


def _configuration(numbers: Mapping[str, float]) -> Configuration | None:
    """Bits 0 and 1 of S: sides of axes 1 and 3. Bits of T: signs of the axes. Bit 2 of S adds nothing to these."""
    text = ", ".join(f"{key} {numbers[key]:g}" for key in ("S", "T") if key in numbers)
    if not text:
        return None
    ranges = {}
    if "T" in numbers:
        turns = int(numbers["T"])
        ranges = {k: (-np.inf, 0.0) if turns >> k & 1 else (0.0, np.inf) for k in range(6)}
    status = int(numbers["S"]) if "S" in numbers else None
    behind, elbow_bent = (None, None) if status is None else (bool(status & 1), bool(status & 2))
    return Configuration(text, ranges, behind=behind, elbow_bent=elbow_bent)
