"""Reader of G-code programs with straight moves.

The reader takes G0 and G1 with X, Y and Z, absolute (G90) or relative (G91), in millimetres (G21) or inches (G20). A
line without a G repeats the motion before it. A program begins in G90 and G21.

A move is refused, and the error names its line, unless everything that it depends on is known: the position of the
machine axis by axis, whether numbers are relative, their unit, and the zero and tool.
- `calib.programs.languages.gcode_dialects` lists the words that leave all this unchanged. After any other word (a
  macro, a change of tools), position and modes are unknown until the program sets them again.
- A program cannot set zero and tool again. So all moves after an unlisted word are refused if the word comes after the
  first move. Before the first move, such a word prepares the machine: the zero that results is the program's.
- Homing of all axes leads to the position that the user gives; homing of one axis may move the others.
- Always refused: words that certainly change the meaning of X, Y and Z; lines that are run elsewhere, repeatedly or
  under a condition; moves that are not straight. For unknown firmware, a line on which firmwares disagree.

G90 and G91 change the meaning of E on some machines only; a program that has E after them must state it (M82, M83).

Reading takes time in proportion to the length: a regular expression takes one word and never goes back.
"""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path

from calib.core.base.errors import DataError
from calib.core.base.files import read_bytes, read_text
from calib.programs.languages.gcode_dialects import (
    CALLING,
    CHANGING,
    CONDITIONAL,
    MILLING,
    REFUSED,
    STOPPING,
    TEXT,
    Dialect,
    find_dialect,
)
from calib.programs.languages.gcode_lines import AXES, GcodeLine, read_line, require_order, require_words
from calib.programs.languages.gcode_program import INCH, MILLIMETRE, GcodeMove, GcodeProgram

SUFFIXES = (".gcode", ".g", *MILLING)
_POINT = re.compile(r"^[^(;]*[XYZ]\s*[-+]?\d+\.(?!\d)", re.IGNORECASE)
_Modes = tuple[bool | None, bool | None, float | None]  # relative, e_relative, unit


def read_gcode(
    path: Path | str,
    start: tuple[float, ...] | None = None,
    dialect: str | None = None,
    harmless: Collection[str] = (),
) -> GcodeProgram:
    """Read a program.

    Args:
        path: The file.
        start: Position of the machine at first and after homing of all axes, (3,) [m]; None: unknown.
        dialect: The firmware, a key of `calib.programs.languages.gcode_dialects.DIALECTS`; None: derived from the file.
        harmless: Further words, such as a macro, that leave position, coordinates, modes and tool unchanged.

    Raises:
        DataError: The message names file and line.
        InputError: There is no such dialect.
    """
    lines = read_text(path, "a G-code program", DataError).rstrip("\n").split("\n")
    reader = _GcodeReader(str(path), start, find_dialect(path, lines, dialect), {word.upper() for word in harmless})
    reader.has_points = reader.dialect.fanuc and any(map(_POINT.search, lines))
    for number, line in enumerate(lines):
        reader.read(number, line)
    if not reader.moves:
        raise DataError(f"{path}: has no straight moves (G0, G1 with X, Y or Z)")
    line_end = "\r\n" if b"\r\n" in read_bytes(path, "a G-code program", DataError) else "\n"
    moves, fanuc = tuple(reader.moves), reader.dialect.fanuc
    return GcodeProgram(str(path), tuple(lines), moves, line_end, fanuc, unit_stated=reader.unit_stated or not fanuc)


@dataclass
class _GcodeReader:
    """Modes that hold from line to line; None where unknown.

    Attributes:
        has_points: Whether whole numbers are written with a point, as for FANUC.
        unit_stated: Whether the program has said G20 or G21.
        home: Position of the machine after homing of all axes [m].
        harmless_words: Words that the user declares harmless.
        position: Position of the machine, axis by axis [m].
        is_start_known: Whether the last move led to `position`.
        selected: Whether the program has selected G54.
        saved: Modes (relative, e_relative, unit) to restore, by name.
        since: The last word after which the position was unknown, and its line.
        prepared: The last word that may have moved the zero or changed the tool.
        shifted: The first such word after a move.
    """

    path: str
    home: tuple[float, ...] | None
    dialect: Dialect
    harmless_words: Collection[str]
    moves: list[GcodeMove] = field(default_factory=list)
    has_points: bool = False
    unit_stated: bool = False
    position: list[float | None] = field(default_factory=list)
    is_start_known: bool = False
    motion: str = ""
    relative: bool | None = False
    unit: float | None = MILLIMETRE
    e_relative: bool | None = None
    e: float | None = None
    tool: str = ""
    selected: bool = False
    saved: dict[str, list[_Modes]] = field(default_factory=dict)
    since: str = ""
    prepared: str = ""
    shifted: str = ""

    def __post_init__(self) -> None:
        self.position = [*(self.home or (None, None, None))]

    def read(self, number: int, text: str) -> None:
        """Process a line."""
        line = read_line(text, f"{self.path}, line {number + 1}", self.dialect)
        if line is None or line.codes[:1] == [TEXT]:
            return
        if line.name:
            self._name(line)
        elif line.tool and not self.dialect.at_once:
            self._change_tool(line)
        else:
            self._take(number, line)

    def _mark_moved(self, word: str, line: GcodeLine) -> None:
        """Record that the firmware has moved the machine to an unknown position."""
        self.position, self.is_start_known = [None] * 3, False
        self.since = f"{word:.40} (line {line.where.rpartition(' ')[2]})"

    def _forget(self, word: str, line: GcodeLine) -> None:
        self._mark_moved(word, line)
        self.relative, self.e_relative, self.e = None, None, None
        self.unit = None if self.dialect.inches else MILLIMETRE
        self.motion, self.tool, self.selected, self.prepared = "", "", False, self.since
        self.saved.clear()
        self._shift()

    def _shift(self) -> None:
        """Record that the zero or the tool may have changed."""
        self.shifted = self.shifted or (self.since if self.moves else "")

    def _name(self, line: GcodeLine) -> None:
        if line.name in CONDITIONAL:
            raise line.refusal(f"{line.name} depends on values that are not known here; write out the lines that run")
        given = {key.upper(): value for key, _, value in (part.partition("=") for part in line.rest.split())}
        self._read_other_word(line.name, line, given.get("NAME", "default"))
        if line.name == self.dialect.restoring and given.get("MOVE", "0") != "0":
            self._mark_moved(line.name, line)

    def _change_tool(self, line: GcodeLine) -> None:
        if len(line.words) > 1 or line.rest:
            raise line.refusal("has more than a tool; write one command per line")
        if line.tool not in self.harmless_words and not (line.tool == self.tool and self.dialect.same_tool):
            self._forget(line.tool, line)
            self.tool = line.tool

    def _read_other_word(self, word: str, line: GcodeLine, name: str = "default") -> None:
        """Process a word of the dialect's lists; some save and restore modes under a name."""
        if word in CHANGING:
            raise line.refusal(f"{word} changes the meaning of X, Y and Z; set it outside the program")
        if word in CALLING:
            raise line.refusal(f"{word} calls another program, or lines again; write them out")
        if word == self.dialect.saving:
            self.saved.setdefault(name, []).append((self.relative, self.e_relative, self.unit))
        elif word == self.dialect.restoring and self.saved.get(name):
            self.relative, self.e_relative, self.unit = self.saved[name][-1]
            self.e = None
            if self.dialect.restores_once:
                self.saved[name].pop()
        elif word in self.dialect.moving:
            self._mark_moved(word, line)
        elif word not in self.dialect.harmless and word not in self.harmless_words:
            self._forget(word, line)

    def _take(self, number: int, line: GcodeLine) -> None:
        require_words(line, self.dialect)
        for word in line.codes:
            if word in ("M82", "M83"):
                self.e_relative = word == "M83" or (self.dialect.e_follows and self.relative)
            elif word[0] == "M":
                self._read_other_word(word, line)
            elif word != line.homing:
                self._g(word, line)
        owner = line.owner(self.harmless_words)
        require_order(line, owner, self.dialect)
        if line.homing:
            self._home(line)
        elif "G92" in line.codes:
            self.e = float(line.argument_texts["E"])
        elif not owner and {*AXES} & {*line.argument_texts}:
            self._move(number, line)
        elif not owner and "E" in line.argument_texts:
            self._extrude(float(line.argument_texts["E"]))

    def _g(self, code: str, line: GcodeLine) -> None:
        """Process a G word other than homing, or refuse it."""
        letters = {*line.argument_texts}
        if code in ("G0", "G1"):
            self.motion = code
        elif code == "G20" and not self.dialect.inches:
            raise line.refusal(f"{self.dialect.name} does not know inches; write millimetres")
        elif code in ("G20", "G21"):
            unit = INCH if code == "G20" else MILLIMETRE
            self.e = self.e if unit == self.unit else None  # numbers of E are in this unit, too
            self.unit, self.unit_stated = unit, True
        elif code in ("G90", "G91"):
            relative = code == "G91"
            if relative != self.e_relative:  # some machines change the meaning of E too
                self.e_relative = None
            self.relative = relative
        elif code in REFUSED:
            retracts = code in ("G10", "G11") and letters <= self.dialect.retracting
            if not retracts and not (code == "G92" and letters == {"E"}):
                raise line.refusal(f"{code}: {REFUSED[code]}")
        elif code == "G54" and code not in self.dialect.harmless:  # the machine may begin in another system
            if self.moves and not self.selected:
                self._forget(code, line)
            self.selected = True
        elif code not in self.dialect.harmless | self.dialect.moving and code not in self.harmless_words:
            raise line.refusal(f"{code}: is not read; only straight moves are (G0, G1)")
        else:
            self.motion = "" if code == "G80" else self.motion
            self._read_other_word(code, line)

    def _home(self, line: GcodeLine) -> None:
        """Process homing or probing; homing one axis may move the others."""
        if line.homing != "G28":
            self._read_other_word(line.homing, line)
            return
        self._mark_moved(line.homing, line)
        letters = {*line.argument_texts, *filter(str.isalpha, line.rest.upper())}
        if self.home is not None and letters <= {*AXES, "W"} and (letters & {*AXES}) in (set(), {*AXES}):
            self.position = list(self.home)
        if self.prepared:  # homing may undo a moved zero
            self._shift()

    def _extrude(self, value: float) -> tuple[float, float] | None:
        """Process E; return its value before and after, None where its meaning is unknown."""
        before = self.e
        if self.e_relative:
            self.e = None
            return 0.0, value
        self.e = value if self.e_relative is False else None
        return None if before is None or self.e is None else (before, value)

    def _move(self, number: int, line: GcodeLine) -> None:
        unit, relative = self._require_modes(line)
        given, end = line.argument_texts, list[float]()
        for axis, at in zip(AXES, self.position, strict=True):
            if at is None and (relative or axis not in given):
                say = "" if self.home else "give the position with --start X,Y,Z, or "
                raise line.refusal(
                    f"the machine's position along {axis} is not known here{self.since and f' after {self.since}'};"
                    f" {say}give X, Y and Z in the first move and in the first move after homing"
                )
            value = float(given[axis]) * unit if axis in given else 0.0
            end.append(value if axis in given and not relative else (at or 0.0) + value)
        first = next((k for k, word in enumerate(line.words) if word[0] == "G" and float(word[1]) in (0, 1)), -1)
        lead, tail, last = self._words_in_order(line, first + 1)
        e = self._extrude(float(given["E"])) if "E" in given else None
        start = None if None in self.position else tuple(float(x) for x in self.position if x is not None)
        self.moves.append(
            GcodeMove(
                number, start, tuple(end), self.is_start_known, unit, relative, line.counter + lead, tail, last,
                line.comments, e, given.get("E", ""), bool(self.e_relative),
            )
        )  # fmt: skip
        self.position, self.is_start_known = list(end), True

    def _words_in_order(self, line: GcodeLine, behind: int) -> tuple[tuple[str, ...], ...]:
        """Return words other than X, Y, Z and E: up to the motion, behind it, and those that run when it has ended.

        `behind` is the index of the word behind the motion. Milling machines stop last, whatever the order; firmwares
        that run commands one after the other do so with all commands behind the motion.
        """
        parts: tuple[list[str], ...] = [], [], []
        all_in_order = bool(self.dialect.name) and not self.dialect.at_once
        for k, (letter, number) in enumerate(line.words):
            stops = f"{letter}{float(number):g}" in STOPPING and (self.dialect.at_once or k >= behind)
            runs_after = stops or (all_in_order and letter == "M" and k >= behind)
            if letter not in "XYZE":
                parts[2 if runs_after else k >= behind].append(f"{letter}{number}")
        return tuple(map(tuple, parts))

    def _require_modes(self, line: GcodeLine) -> tuple[float, bool]:
        """Return the unit of a move's numbers [m], and whether they are relative."""
        wrong = next((letter for letter in line.argument_texts if letter not in self.dialect.move_words), None)
        short = [x for x in AXES if self.has_points and "." not in line.argument_texts.get(x, ".")]
        short = [f"{axis}{line.argument_texts[axis]}" for axis in short if float(line.argument_texts[axis])]
        if short:
            raise line.refusal(
                f"'{short[0]}' has no point, unlike other numbers; some controls read thousandths; add it"
            )
        if not self.motion:
            raise line.refusal("moves without G0 or G1 before it; write which of them")
        if wrong is not None:
            raise line.refusal(f"'{wrong}' does not belong to a straight move of X, Y and Z")
        if self.shifted:
            options = "--harmless" if self.dialect.name else "--dialect or --harmless"
            raise line.refusal(
                f"{self.shifted} may have moved zero or axes, or changed the tool; if not, say so with {options}; else"
                " write the lines after it into a new file"
            )
        if self.relative is None or self.unit is None:
            raise line.refusal(f"{self.since} may have changed modes; write G90 or G91, and G20 or G21, after it")
        return self.unit, self.relative
