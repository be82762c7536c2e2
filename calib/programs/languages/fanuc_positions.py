"""The positions in `/POS` of FANUC's programs as text. Numbers keep their decimals and their columns."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.core.base.errors import DataError
from calib.programs.languages.robot_program import (
    DEGREE,
    MILLIMETRE,
    Configuration,
    LeftOutError,
    Number,
    ProgramSource,
    ProgramTarget,
    cells_at,
)
from calib.programs.languages.tokens import ProgramWords, Span, word_pattern
from calib.programs.languages.visits import Place

WORDS = word_pattern(
    r"^[^\S\n]*\d*:[^\S\n]*(?:!|//)[^\n]*|^[^\S\n]*\d*:|(?i:MESSAGE)\[[^\]\n]*\]",
    r"[$#]?[^\W\d]\w*",
    r"<>|<=|>=|[-+*/%()\[\]{}=<>,.;:!&@#?^|~$]",
    r"(?<=\[)[^\S\n]*\d+[^\S\n]*:[^\]\n]*|'[^'\n]*'|\"[^\"\n]*\"",
)
_SECTION = re.compile(r"^/(\w+)", re.MULTILINE)
_CONFIG = re.compile(r"'\s*([NF])\s*([UD])\s*([TB])\s*,\s*(-?\d+)\s*,\s*(-?\d+)\s*,\s*(-?\d+)\s*'")
_POSE, _JOINTS = ("X", "Y", "Z", "W", "P", "R"), ("J1", "J2", "J3", "J4", "J5", "J6")
_TURNING = (0, 3, 4, 5)  # joints that CONFIG keeps within half a turn


def sections_of(source: ProgramSource) -> tuple[slice, slice]:
    """Return the text ranges of the instructions and of the positions of a program.

    Raises:
        DataError: The program has no such sections.
    """
    sections = {match[1]: match for match in reversed([*_SECTION.finditer(source.text)])}
    if not {"MN", "POS"} <= set(sections) or sections["MN"].start() > sections["POS"].start():
        raise DataError(f"{source.path}: has no /MN and /POS sections; save the program as text (LS)")
    end = sections["END"].start() if "END" in sections else None
    return slice(sections["MN"].end(), sections["POS"].start()), slice(sections["POS"].end(), end)


@dataclass(frozen=True)
class FanucPosition:
    """A position of `/POS`.

    Attributes:
        code: Words of the section.
        text_start: Index of the position's first word.
        groups: Names of its motion groups.
        fields: By name of each field of the first group: index of its equals sign, span of its number, and its unit.
        statements: Values after colons: UF, UT, CONFIG.
    """

    code: ProgramWords
    text_start: int
    groups: tuple[str, ...]
    fields: Mapping[str, tuple[int, Span, str]]
    statements: Mapping[str, str]

    @property
    def place(self) -> Place:
        """File and first word."""
        return 0, self.text_start

    @property
    def name(self) -> str:
        """Name in messages, such as `P[1]`."""
        return f"P[{number_at(self.code, self.text_start)}]"

    def target(self) -> ProgramTarget:
        """Return the target, with the numbers of its frame and tool.

        Letters of CONFIG compare with the reference pose. N, U, T: the same side as in that pose; F: wrist flipped, D:
        elbow down, B: behind axis 1. All turns must be 0.

        Raises:
            LeftOutError: External axes or other motion groups move, or the configuration counts turns.
            DataError: The position is not complete.
        """
        if self.groups != ("GP1",):
            raise LeftOutError("moves other motion groups, which the description does not have")
        text, line, path = self.code.source.text, self.code.line(self.text_start), self.code.source.path
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
        flags = {"flipped": match[1] == "F", "elbow": match[2] == "D", "behind": match[3] == "B"}
        ranges = dict.fromkeys(_TURNING, (-np.pi, np.pi))
        configuration = Configuration(f"CONFIG : {match[0]}", ranges, **flags)
        return ProgramTarget(line, path, self.name, cells, "xyz", configuration=configuration)

    def _error(self, what: str) -> DataError:
        return DataError(f"{self.code.location(self.text_start)}: {what}")

    def _cells(self, names: Sequence[str]) -> tuple[Number, ...]:
        """Numbers with the blanks before them, which leave room for a sign."""
        source, fields = self.code.source, [self.fields[name] for name in names]
        units = [MILLIMETRE if unit == "MM" else DEGREE for _, _, unit in fields]
        cells = cells_at(source, 0, [number for _, number, _ in fields], units)
        return tuple(
            replace(
                cell,
                start=start,
                width=number[1] - start,
                decimals=len(source.text[slice(*number)].partition(".")[2]),
            )
            for cell, (start, number, _) in zip(cells, fields, strict=True)
        )


def number_at(code: ProgramWords, at: int) -> str:
    """Return the number in brackets after a word, without its comment."""
    return code.tokens[at + 2].text.partition(":")[0].strip()


def positions_of(source: ProgramSource, part: slice) -> dict[str, FanucPosition]:
    """Return the positions of a section by their numbers as text.

    Raises:
        DataError: A position stands there twice.
    """
    code, positions = ProgramWords(source, WORDS, lines="blank", part=part), dict[str, FanucPosition]()
    for at in code.names(0, len(code.tokens) - 5):
        opening = code.partner[at + 1] + 1
        if code.tokens[at].text != "P" or not code.is_mark(at + 1, "[") or not code.is_mark(opening, "{"):
            continue
        number = number_at(code, at)
        if number in positions:
            raise DataError(f"{code.location(at)}: P[{number}] is in /POS twice; save the program again")
        positions[number] = _position(code, at, opening + 1, code.partner[opening])
    return positions


def _position(code: ProgramWords, at: int, first: int, stop: int) -> FanucPosition:
    groups, fields, written = [], dict[str, tuple[int, Span, str]](), dict[str, str]()
    for k in code.names(first, stop):
        name = code.tokens[k].text
        if name.startswith("GP") and code.is_mark(k + 1, ":"):
            groups.append(name)
        elif code.is_mark(k + 1, ":"):
            written.setdefault(name, code.tokens[k + 2].text)
        elif code.is_mark(k + 1, "="):
            behind = k + 4 if code.is_mark(k + 2, "-", "+") else k + 3
            number, unit = code.number(k + 2, behind), code.tokens[behind].text
            if number is not None and unit in ("MM", "DEG") and len(groups) < 2:
                if name in fields:
                    raise DataError(f"{code.location(k)}: {name} is given twice; save the program again")
                fields[name] = (code.tokens[k + 1].end, number, unit)
    return FanucPosition(code, at, tuple(groups), fields, written)
