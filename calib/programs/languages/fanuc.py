"""Targets of FANUC's teach pendant programs as text (`.ls`): the positions of `/POS` that lines of `/MN` go to.

Each position states its user frame (UF) and tool (UT) by number; their values are in the controller, and a table of
frames gives them here (`UFRAME[1]`, `UTOOL[1]`). Position registers, offsets, increments and further motion groups are
computed at run time. An instruction ends with a semicolon, on its line or on a later one. An instruction that is no
motion, jump, assignment or known word (a call, a macro) may change frames and tools.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from calib.core.base.errors import DataError
from calib.programs.languages import tokens
from calib.programs.languages.control_flow import State, Unknown
from calib.programs.languages.reader import Data, Frames, Reader, as_selected_frame
from calib.programs.languages.robot_program import ITSELF, Configuration, Frame, LeftOutError, ProgramTarget
from calib.programs.languages.tokens import DEGREE, MILLIMETRE, Number, ProgramSource, ProgramWords, Span, word_list

_WORDS = tokens.word_pattern(
    r"^[^\S\n]*\d*:[^\S\n]*(?:!|//|--)[^\n]*|^[^\S\n]*\d*:|(?i:MESSAGE)\[[^\]\n]*\]",
    r"[$#]?[^\W\d]\w*",
    r"<>|<=|>=|[-+*/%()\[\]{}=<>,.;:!&@#?^|~$]",
    r"(?<=\[)[^\S\n]*\d+[^\S\n]*:[^\]\n]*|'[^'\n]*'|\"[^\"\n]*\"",
)
_SECTION = re.compile(r"^/(\w+)", re.MULTILINE)
_CONFIG = re.compile(r"'\s*([NF])\s*([UD])\s*([TB])\s*,\s*(-?\d+)\s*,\s*(-?\d+)\s*,\s*(-?\d+)\s*'")
_POSE, _JOINTS = ("X", "Y", "Z", "W", "P", "R"), ("J1", "J2", "J3", "J4", "J5", "J6")
_DECIMALS = 3  # of numbers in the text of controllers
_TURNING = (0, 3, 4, 5)  # joints that CONFIG keeps within half a turn
LANGUAGE, SUFFIXES = "FANUC LS", (".ls",)
_CHANGED = ("TOOL_OFFSET", "OFFSET", "VOFFSET", "INC", "CV_TCP")
_OPTIONS = word_list("FANUC OPTIONS") | {*_CHANGED}
_NUMBERED = ("UFRAME_NUM", "UTOOL_NUM")
_STATE = ("UFRAME", "UTOOL", *_NUMBERED)


def _sections(source: ProgramSource) -> tuple[slice, slice]:
    sections = {match[1]: match for match in reversed([*_SECTION.finditer(source.text)])}
    if not {"MN", "POS"} <= set(sections) or sections["MN"].start() > sections["POS"].start():
        raise DataError(f"{source.path}: has no /MN and /POS sections; save the program as text (LS)")
    end = sections["END"].start() if "END" in sections else None
    return slice(sections["MN"].end(), sections["POS"].start()), slice(sections["POS"].end(), end)


@dataclass(frozen=True, kw_only=True)
class _FanucPosition(Data):
    """A position of `/POS`.

    Attributes:
        code: Words of the section.
        groups: Names of its motion groups.
        fields: By name of each field of the first group: index of its equals sign, span of its number, and its unit.
        statements: Values after colons: UF, UT, CONFIG.
    """

    code: ProgramWords
    groups: tuple[str, ...]
    fields: Mapping[str, tuple[int, Span, str]]
    statements: Mapping[str, str]

    def target(self) -> ProgramTarget:
        """Return the target, or raise `LeftOutError` or `DataError` if it cannot be compensated or is not complete.

        Letters of CONFIG compare with the reference pose. N, U, T: the same side as in that pose; F: wrist flipped, D:
        elbow down, B: behind axis 1. All turns must be 0.
        """
        if self.groups != ("GP1",):
            raise LeftOutError("moves other motion groups, which the description does not have")
        text, line, path = self.code.source.text, self.code.line(self.span[0]), self.code.source.path
        if any(float(text[slice(*number)]) for key, (_, number, _) in self.fields.items() if key.startswith("E")):
            raise LeftOutError("moves external axes, which the description does not have")
        if set(_JOINTS) <= set(self.fields):
            return ProgramTarget(line, path, self.name, self._cells(_JOINTS), None)
        missing = next((key for key in _POSE if key not in self.fields), None)
        if missing is not None:
            raise self._error(f"{self.name} has no number for {missing}; correct it")
        if not {"UF", "UT"} <= set(self.statements):
            raise self._error(f"{self.name} does not say UF and UT; save the program again")
        cells, match = self._cells(_POSE), _CONFIG.fullmatch(self.statements.get("CONFIG", ""))
        if match is None:
            raise self._error("has no CONFIG such as 'N U T, 0, 0, 0'; save it again")
        if any(int(turn) for turn in match.groups()[3:]):
            raise LeftOutError("its configuration counts turns; only 0, 0, 0 is read")
        sides = (match[3] == "B", match[2] == "D", match[1] == "F", None)
        configuration = Configuration(f"CONFIG : {match[0]}", dict.fromkeys(_TURNING, (-np.pi, np.pi)), sides)
        return ProgramTarget(line, path, self.name, cells, "xyz", configuration=configuration)

    def _error(self, what: str) -> DataError:
        return DataError(f"{self.code.location(self.span[0])}: {what}")

    def _cells(self, names: Sequence[str]) -> tuple[Number, ...]:
        """Numbers with the blanks before them, which leave room for a sign."""
        source, cells = self.code.source, []
        for start, (first, end), unit in (self.fields[name] for name in names):
            (cell,) = source.numbers([(first, end)], [MILLIMETRE if unit == "MM" else DEGREE])
            decimals = max(_DECIMALS, len(source.text[first:end].partition(".")[2]))
            cells.append(replace(cell, start=start, width=end - start, decimals=decimals))
        return tuple(cells)


def _number_at(code: ProgramWords, at: int) -> str:
    """The number in brackets after a word, without its comment."""
    return code.word(at + 2).partition(":")[0].strip()


def _positions(source: ProgramSource, part: slice) -> dict[str, _FanucPosition]:
    code, positions = ProgramWords(source, _WORDS, lines="blank", part=part), dict[str, _FanucPosition]()
    for at in code.names(0, len(code.tokens) - 5):
        opening = code.partner[at + 1] + 1
        if code.word(at) != "P" or not code.is_mark(at + 1, "[") or not code.is_mark(opening, "{"):
            continue
        number = _number_at(code, at)
        if number in positions:
            raise DataError(f"{code.location(at)}: P[{number}] is in /POS twice; save the program again")
        positions[number] = _position(code, at, opening + 1, code.partner[opening])
    return positions


def _position(code: ProgramWords, at: int, first: int, stop: int) -> _FanucPosition:
    groups, fields, written = [], dict[str, tuple[int, Span, str]](), dict[str, str]()
    for k in code.names(first, stop):
        name = code.word(k)
        if name.startswith("GP") and code.is_mark(k + 1, ":"):
            groups.append(name)
        elif code.is_mark(k + 1, ":"):
            written.setdefault(name, code.word(k + 2))
        elif code.is_mark(k + 1, "="):
            behind = k + 4 if code.is_mark(k + 2, "-", "+") else k + 3
            number, unit = code.number(k + 2, behind), code.word(behind)
            if number is not None and unit in ("MM", "DEG") and len(groups) < 2:
                if name in fields:
                    raise DataError(f"{code.location(k)}: {name} is given twice; save the program again")
                fields[name] = (code.tokens[k + 1].end, number, unit)
    name = f"P[{_number_at(code, at)}]"
    return _FanucPosition(name, 0, (at, stop), code=code, groups=tuple(groups), fields=fields, statements=written)


class FanucReader(Reader):
    """Reads a program; user frame 0 is the robot's base, and tool 0 its flange."""

    language, known, danger = LANGUAGE, word_list("FANUC"), "change it"
    breaking, by_value, lost = False, True, _STATE

    def __init__(self, path: Path | str, frames: Frames, harmless: Collection[str]) -> None:
        source = ProgramSource.read(path, "a FANUC program as text (LS)")
        instructions, positions = _sections(source)
        code = ProgramWords(source, _WORDS, lines="blank", ends=";", part=instructions)
        super().__init__([code], dict.fromkeys(_STATE, ""), frames, harmless)
        self.positions = _positions(source, positions)
        self.given = set(harmless)

    def read(self, at: int = 0) -> None:
        """Read all instructions; a jump with a computed number may lead to any label."""
        code = self.code
        self.flow.jump("first")
        self.flow.label("any label")
        for at in code.names(0, len(code.tokens) - 3):
            if code.word(at) == "LBL" and (at == 0 or code.tokens[at - 1].kind == "end"):
                self.flow.note_jump(f"label {_number_at(self.code, at)}")
        self.flow.label("first")
        super().read()

    def _place(self, span: Span) -> str:
        """Name of the place of a motion: `P[1]`, `P[*]` where the number is computed, or `PR`."""
        if self.code.word(span[0]) == "PR":
            return "PR"
        number = self.code.tokens[span[0] + 2]
        plain = span[1] == span[0] + 4 and (number.kind == "number" or ":" in number.text)
        return f"P[{_number_at(self.code, span[0]) if plain else '*'}]"

    def names(self, first: int, stop: int) -> set[str]:
        """Return the registers and positions in a span of words."""
        names = set()
        for at in self.code.names(first, stop):
            if self.code.is_mark(at + 1, "["):
                whole = self.code.word(at) == "P"
                names.add(self._place((at, self.code.partner[at + 1] + 1)) if whole else self.code.word(at))
        return names

    def expression(self, first: int, stop: int) -> None:
        """Do nothing: expressions have no calls."""

    def statement(self, at: int, stop: int) -> None:
        """Process an instruction that follows its conditions."""
        code, opened = self.code, 0
        comma = code.find_mark(at, stop, ",")
        while comma < stop and code.word(at) in ("IF", "SELECT", "=", "ELSE"):
            self.decide(at, comma)
            self.branch(at, comma)
            at, opened = comma + 1, opened + 1
            comma = code.find_mark(at, stop, ",")
        if at < stop:
            self._action(at, stop)
        for _ in range(opened):
            self.close_block()

    def _action(self, at: int, stop: int) -> None:
        code, word = self.code, self.code.word(at)
        equals = code.find_mark(at, stop, "=")
        if word in ("J", "L", "C", "A", "S") and code.word(at + 1) in ("P", "PR") and code.is_mark(at + 2, "["):
            self._motion(at, stop)
        elif word == "IF" and code.word(stop - 1) == "THEN":
            self.act(at, [self.condition, self.branch])
        elif word == "FOR":
            self.act(at, [self.condition, self.count, self.repeat, self.pass_over])
        elif word == "ELSE":
            self.begin_branch(at, stop)
        elif word in ("ENDIF", "ENDFOR"):
            self.close(at, stop)
        elif word == "LBL" and code.is_mark(at + 1, "["):
            self.flow.label(f"label {_number_at(self.code, at)}")
        elif word == "JMP":
            plain = code.is_mark(at + 2, "[") and code.partner[at + 2] == at + 4
            self.flow.jump(f"label {_number_at(self.code, at + 1)}" if plain else "any label")
        elif word in ("END", "ABORT"):
            self.flow.jump("return")
        elif equals < stop and code.tokens[at].kind == "name":
            self._assignment(at, stop, equals)
        else:
            self.decide(at, stop)
            called = at + 1 if word == "CALL" else at
            known = self.given if word == "CALL" else self.harmless
            if code.word(called) not in known and not code.is_mark(at, "-"):
                self.call_elsewhere(code.excerpt(called, called + 1), code.line(at))

    def _assignment(self, at: int, stop: int, equals: int) -> None:
        code, word = self.code, self.code.word(at)
        names, value = self.names(at + 1, stop), code.excerpt(equals + 1, stop)
        positions = {name for name in names if name.startswith("P[")}
        if word in _NUMBERED:
            plain = equals == at + 1 and value.isdigit()
            self.flow.note_setting(word, value if plain else Unknown(f"is computed in line {code.line(at)}"))
        elif word in ("UFRAME", "UTOOL"):
            plain = code.partner[at + 1] == at + 3 and code.tokens[at + 2].kind == "number"
            key = f"{word}[{code.word(at + 2)}]" if plain else word
            self.flow.note_setting(key, Unknown(f"is set while the program runs (line {code.line(at)})"))
        elif word == "P":
            self.uses.note_change(self._place((at, code.partner[at + 1] + 1 if code.is_mark(at + 1, "[") else at + 1)))
        elif word == "PR" and not (code.word(equals + 1) == "P" and code.partner[equals + 2] + 1 == stop):
            self.uses.compute("PR", names - positions)
            self.uses.decide(positions, code.line(at))
        elif word in self.harmless or word == "PR":
            self.uses.compute(word, names)
        else:
            self.uses.decide(names, code.line(at))
            self.call_elsewhere(code.excerpt(at, at + 1), code.line(at))

    def _motion(self, at: int, stop: int) -> None:
        """Process a motion, and routines called while the robot moves."""
        code, places, first = self.code, list[Span](), at + 1
        while first < stop and code.word(first) in ("P", "PR") and code.is_mark(first + 1, "["):
            places.append((first, code.partner[first + 1] + 1))
            first = code.partner[first + 1] + 1
        self.flow.move(at, lambda state: self._targets(places, (first, stop), state))
        for left, right in code.split(first, stop):
            equals = code.find_mark(left, right, "=")
            if equals < right:
                self.run_at_any_time(left, lambda at=left, end=right, k=equals: self._assignment(at, end, k))  # type: ignore[misc]
        for k in code.names(first, stop):
            if code.word(k - 1) == "CALL" and code.word(k) not in self.given:
                shown, line = code.excerpt(k, k + 1), code.line(k)
                self.run_at_any_time(k, lambda shown=shown, line=line: self.call_elsewhere(shown, line))  # type: ignore[misc]

    # targets

    def _targets(self, places: list[Span], options: Span, state: State | None) -> None:
        changed = next((k for k in self.code.names(*options) if self.code.word(k) in _CHANGED), None)
        find = partial(self._position, options=options, changed=changed)
        self.go(places, state, find, partial(self._target, changed=changed))

    def _position(self, span: Span, options: Span, changed: int | None) -> _FanucPosition:
        name = self._place(span)
        if name == "PR":
            raise LeftOutError("is a position register; its numbers are not in the program")
        if not name[2:-1].isdigit():
            raise LeftOutError("is computed at run time")
        if name[2:-1] not in self.positions:
            raise DataError(f"{self.code.location(span[0])}: {name} is not in /POS; save the program again")
        if changed is not None and self.code.word(changed) != "INC":  # others move along with the position
            raise LeftOutError(f"is computed at run time ({self.code.excerpt(changed, changed + 1)})")
        for at in self.code.names(*options):
            known = self.code.word(at).rstrip("0123456789") in _OPTIONS
            if not known and self.code.word(at - 1) != "CALL":
                raise LeftOutError(f"has an option that is not known here ({self.code.excerpt(at, at + 1)})")
        return self.positions[name[2:-1]]

    def _target(self, position: _FanucPosition, state: State, changed: int | None) -> ProgramTarget:
        if changed is not None:
            raise LeftOutError("is computed at run time (INC)")
        if why := self.uses.why_not(position.name) or self.uses.why_not("P[*]"):
            raise LeftOutError(why)
        target = position.target()
        if target.rotation is None:
            return target
        frame = self._frame("UFRAME", "user frame", position.statements["UF"], state)
        return replace(target, frame=frame, tool=self._frame("UTOOL", "tool", position.statements["UT"], state))

    def _frame(self, kind: str, what: str, number: str, state: State) -> Frame:
        name, chosen = f"{kind}[{number}]", state[f"{kind}_NUM"]
        if isinstance(chosen, Unknown):
            raise LeftOutError(f"which {what} is selected {chosen.why}")
        if chosen not in ("", number):
            raise LeftOutError(f"belongs to {what} {number}, but {what} {chosen} is selected here")
        if number == "0":
            return ITSELF
        frame = self.frames.get(name)
        if frame is None:
            given = f"is not known; give {name} with --frames"
            raise LeftOutError(f"its {what} {given if number.isdigit() else 'is chosen at run time'}")
        for changed in (state.get(name), state[kind]):
            if isinstance(changed, Unknown):
                raise LeftOutError(f"{name} {changed.why}")
        return as_selected_frame(name, frame)
