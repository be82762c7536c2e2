"""G-code programs of straight moves: where each leads, and the same program with other points in it.

Read are G0 and G1 with X, Y and Z, absolute (G90) or relative (G91), in millimetres (G21) or inches (G20), a line
without a G meaning the motion before it; until a program says otherwise, G90 and G21 hold. Lines that move nothing are
carried as they are; M, T and the macros of firmwares (`START_PRINT`) are taken for such, and to leave the machine
where it stands.

What would put the points somewhere else than X, Y and Z say is refused with its line: arcs, cycles, work offsets, G92
of an axis, tool corrections, rotary axes, subprograms, expressions, settings of steps or of the machine's geometry.
Homing and probing (G28, G29, G30) leave the machine where only its firmware knows. G90 and G91 change what E means on
some machines and on others not; a program that has E behind them must say so (M82, M83).

Written again, E is shared along a move that is cut, absolute (M82) or relative (M83); other words (F, S, P ...) stay on
its first piece, since they hold from there on. Comments stay, and all lines that are no moves.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import DataError
from calib.core.base.files import read_text
from calib.core.base.units import PER_SI

SUFFIXES = (".gcode", ".nc", ".ngc", ".g")
ROUNDING = 1e-7
"""By how much written points may be off, their decimals being limited [m]."""
MILLIMETRE, INCH = 1 / PER_SI["length"]["mm"], 25.4 / PER_SI["length"]["mm"]
"""Units of programs [m]."""
_DECIMALS = {MILLIMETRE: 4, INCH: 6}
_E_DECIMALS = 5
_LARGEST = 1e6  # of numbers in a program
_COMMENT = re.compile(r"\([^()]*\)|;.*")
_WORD = re.compile(r"([A-Z])\s*([-+]?(?:\d+\.?\d*|\.\d+))\s*", re.ASCII)
_MACRO = re.compile(r"[A-Z_]{2}\w*(\s|$)")
_HOMING = re.compile(r"(N\d+\s*)?G\s*0*(28|29|30)(\.\d+)?(?!\d)")
_TEXT = re.compile(r"(N\d+\s*)?M\s*0*(117|118)(?!\d)")
_HOMES = {"28", "29", "30"}
_OWN_WORDS = {"4", "92"}
_BESIDE_MOTION = {"3", "4", "5", "7", "8", "9"}  # spindle and coolant, which a line with X, Y, Z may switch too
_HARMLESS = {"4", "10", "11", "17", "40", "49", "54", "61", "64", "80", "94"}
_REFUSED = {
    **dict.fromkeys(("2", "3"), "arcs are not read; let the program that made it write lines (arc fitting off)"),
    **dict.fromkeys(("18", "19"), "arcs in other planes are not read; write lines"),
    "92": "moves the zero of an axis; write the program in one system of coordinates",
    "93": "speeds per move do not fit moves that are cut; write speeds per minute (G94)",
}
_CHANGED = {"92", "206", "218", "290", "428", "665", "666", "669"}  # what the machine makes of X, Y and Z
_CALLS = {"97", "98", "99"}


@dataclass(frozen=True)
class Move:
    """A straight move.

    Attributes:
        line: Its index in the lines of the program.
        start: Where it begins, in the program's coordinates [m]; None where that is not known.
        end: Where it ends [m].
        known: Whether the move before led to `start`; not so at the beginning, and after homing.
        unit: What its numbers are in [m].
        relative: Whether they count from where the machine stands.
        words: Its other words, E not among them.
        comments: As they stand on the line.
        e: E at the beginning and at the end; None without E, or where only one piece can be written.
        e_text: E as written; empty without.
        e_relative: Whether E counts from where it stands.
    """

    line: int
    start: tuple[float, ...] | None
    end: tuple[float, ...]
    known: bool
    unit: float
    relative: bool
    words: tuple[str, ...]
    comments: str
    e: tuple[float, float] | None = None
    e_text: str = ""
    e_relative: bool = False


@dataclass(frozen=True)
class GcodeProgram:
    """A program.

    Attributes:
        path: Where it came from.
        lines: Its lines.
        moves: Its straight moves, in order.
    """

    path: str
    lines: tuple[str, ...]
    moves: tuple[Move, ...]

    def label(self, move: Move) -> str:
        """Return what to call a move in messages."""
        return f"{self.path}, line {move.line + 1}"

    def rewritten(self, ways: Sequence[FloatArray] | None, comments: Sequence[str] = ()) -> str:
        """Return the program with other points.

        Args:
            ways: Of each move the points that it shall go through in straight lines, the last of them its end,
                (n_pieces, 3) [m]; None: all lines stay as they are.
            comments: Lines to put first, behind what starts a tape (`%`).

        Raises:
            DataError: A move with E is cut where the program does not say what E means.
        """
        lines = [[line] for line in self.lines]
        stands: FloatArray = np.zeros(3)
        for move, way in zip(self.moves, ways, strict=True) if ways is not None else ():
            if not move.known and move.start is not None:
                stands = np.array(move.start, dtype=np.float64)
            lines[move.line], stands = self._pieces(move, way, stands)
        first = 1 if self.lines and self.lines[0].strip() == "%" else 0
        lines.insert(first, [f"; {comment}" for comment in comments])
        return "\n".join(line for piece in lines for line in piece) + "\n"

    def _pieces(self, move: Move, way: FloatArray, stands: FloatArray) -> tuple[list[str], FloatArray]:
        """The lines of one move, and where the machine then stands [m]."""
        decimals, lines = _DECIMALS[move.unit], []
        for k, point in enumerate(way):
            numbers = np.round((point - stands if move.relative else point) / move.unit, decimals) + 0.0
            stands = stands + numbers * move.unit if move.relative else numbers * move.unit
            words = [f"{axis}{_shown(number, decimals)}" for axis, number in zip("XYZ", numbers, strict=True)]
            others = move.words[1:] if k == 0 else ()
            counter = [word for word in others if word.startswith("N")]
            words = [*counter, move.words[0], *words, *(word for word in others if word not in counter)]
            if move.e_text:
                words.append(f"E{self._share(move, k, len(way))}")
            lines.append(" ".join(word for word in words if word))
        lines[0] += f" {move.comments}" if move.comments else ""
        return lines, stands

    def _share(self, move: Move, k: int, n: int) -> str:
        """E of piece k of n."""
        if n == 1:
            return move.e_text
        if move.e is None:
            raise DataError(
                f"{self.label(move)}: is cut into {n} pieces, and nothing says what its E means; write M82 and G92 E0,"
                " or M83, before it and after every G90 and G91"
            )
        decimals = max(_E_DECIMALS, len(move.e_text.partition(".")[2]))
        start, end = move.e
        before, after = (round(start + (end - start) * share / n, decimals) for share in (k, k + 1))
        return _shown(after - before if move.e_relative else after, decimals)


def _shown(number: float, decimals: int) -> str:
    """A number with at most so many decimals, never with an exponent."""
    text = f"{number:.{decimals}f}".rstrip("0").rstrip(".") if decimals else f"{number:.0f}"
    return "0" if text in ("-0", "") else text


def read_gcode(path: Path | str, start: tuple[float, ...] | None = None) -> GcodeProgram:
    """Read a program.

    Args:
        path: The file.
        start: Where the machine stands at first and after homing, (3,) [m]; not known if not given.

    Raises:
        DataError: The message names file and line.
    """
    reader = _Reader(str(path), start)
    lines = read_text(path, "a G-code program", DataError).rstrip("\n").split("\n")
    for number, line in enumerate(lines):
        reader.read(number, line)
    if not reader.moves:
        raise DataError(f"{path}: has no straight moves (G0, G1 with X, Y or Z)")
    return GcodeProgram(str(path), tuple(lines), tuple(reader.moves))


@dataclass
class _Reader:
    """What holds from line to line."""

    path: str
    home: tuple[float, ...] | None
    moves: list[Move] = field(default_factory=list)
    at: list[float | None] = field(default_factory=list)
    known: bool = False
    motion: str = ""
    relative: bool = False
    unit: float = MILLIMETRE
    e_relative: bool | None = None
    e: float | None = None
    where: str = ""

    def __post_init__(self) -> None:
        self._lose()

    def _lose(self) -> None:
        """The firmware has moved the machine."""
        self.at, self.known = [None] * 3 if self.home is None else list(self.home), False

    def _refuse(self, why: str) -> DataError:
        return DataError(f"{self.where}: {why}")

    def read(self, number: int, line: str) -> None:
        """Take in one line."""
        self.where = f"{self.path}, line {number + 1}"
        if not line.replace("\t", " ").isprintable():
            raise self._refuse("is not text; is this a G-code program?")
        comments = " ".join(match.group().strip() for match in _COMMENT.finditer(line))
        code = _COMMENT.sub(" ", line).strip().upper()
        if not code or code.startswith("%") or _TEXT.match(code) or _MACRO.match(code):
            return
        if _HOMING.match(code):
            self._lose()
            return
        words = self._words(code)
        if words is not None:
            self._take(number, words, comments)

    def _words(self, code: str) -> list[tuple[str, str]] | None:
        """Letters and numbers of a line; None for a text that an M needs."""
        if code.startswith("/"):
            raise self._refuse("whether lines with / are run is not known; remove the line, or the mark")
        words, end = [], 0
        while match := _WORD.match(code, end):
            words.append((match[1], match[2]))
            end = match.end()
        if end < len(code):
            if words and words[0][0] == "M":
                return None
            raise self._refuse(f"'{code[end:]:.40}' is not read; write words of a letter and a number")
        large = next((word for word in words if abs(float(word[1])) > _LARGEST), None)
        if large is not None:
            raise self._refuse(f"'{large[0]}{large[1]:.20}' is beyond what any machine reads; correct it")
        return words

    def _take(self, number: int, words: list[tuple[str, str]], comments: str) -> None:
        letters = [letter for letter, _ in words if letter not in "GM"]
        if len(set(letters)) < len(letters):
            raise self._refuse("has a letter twice; write one command per line")
        numbers = dict(word for word in words if word[0] not in "GM")
        codes = {letter: [f"{float(value):g}" for word, value in words if word == letter] for letter in "GM"}
        for code in codes["M"]:
            self._m(code)
        moving = [code for code in codes["G"] if code in ("0", "1")]
        if len(moving) > 1:
            raise self._refuse("has two motions; write one command per line")
        for code, other in (("20", "21"), ("90", "91")):
            if code in codes["G"] and other in codes["G"]:
                raise self._refuse(f"has G{code} and G{other}; write one command per line")
        for code in codes["G"]:
            self._g(code, numbers)
        if _HOMES & {*codes["G"]}:
            self._lose()
        elif _OWN_WORDS & {*codes["G"]} or (not moving and {*codes["M"]} - _BESIDE_MOTION):
            return  # what stands beside these is theirs
        elif any(axis in numbers for axis in "XYZ"):
            self._move(number, words, numbers, comments)
        elif "E" in numbers:
            self._extrude(float(numbers["E"]))

    def _m(self, code: str) -> None:
        if code in _CHANGED:
            raise self._refuse(f"M{code} changes the meaning of X, Y and Z; set it outside the program")
        if code in _CALLS:
            raise self._refuse(f"M{code} calls another program; write it out")
        if code in ("82", "83"):
            self.e_relative = code == "83"

    def _g(self, code: str, numbers: dict[str, str]) -> None:
        """Take in one G; what it does not know is refused."""
        if code == "92" and set(numbers) == {"E"}:
            self.e = float(numbers["E"])
        elif code in ("0", "1"):
            self.motion = code
        elif code in ("20", "21"):
            self.unit = INCH if code == "20" else MILLIMETRE
        elif code in ("90", "91"):
            relative = code == "91"
            if relative != self.e_relative:  # it changes E too on some machines, on others it does not
                self.e_relative = None
            self.relative = relative
        elif (code not in _HARMLESS and code not in _HOMES) or (code == "10" and numbers):
            raise self._refuse(f"G{code}: {_REFUSED.get(code, 'is not read; only straight moves are (G0, G1)')}")
        elif code == "80":
            self.motion = ""

    def _extrude(self, value: float) -> tuple[float, float] | None:
        """Take in E; return it before and after, None where what it means is not known."""
        before = self.e
        if self.e_relative:
            self.e = 0.0
            return 0.0, value
        self.e = value if self.e_relative is False else None
        return None if before is None or self.e is None else (before, value)

    def _move(self, number: int, words: list[tuple[str, str]], numbers: dict[str, str], comments: str) -> None:
        wrong = next((letter for letter in numbers if letter in "ABCUVWIJKR"), None)
        if not self.motion:
            raise self._refuse("moves without G0 or G1 before it; write which of them")
        if wrong is not None:
            raise self._refuse(f"'{wrong}' does not belong to a straight move of X, Y and Z")
        end: list[float] = []
        for axis, at in zip("XYZ", self.at, strict=True):
            if at is None and (self.relative or axis not in numbers):
                raise self._refuse(
                    f"where the machine stands along {axis} is not known here; say so with --start X,Y,Z, or give X, Y"
                    " and Z in the first move and in the first after homing"
                )
            given = float(numbers[axis]) * self.unit if axis in numbers else 0.0
            end.append(given if axis in numbers and not self.relative else (at or 0.0) + given)
        # a line without a G stays one; other words keep their order
        kept = [f"{letter}{value}" for letter, value in words if letter not in "XYZE"]
        motion = next((word for word in kept if re.fullmatch(r"G0*[01](\.0*)?", word)), "")
        words_kept = (motion, *(word for word in kept if word != motion))
        e = self._extrude(float(numbers["E"])) if "E" in numbers else None
        start = None if None in self.at else tuple(float(x) for x in self.at if x is not None)
        self.moves.append(
            Move(
                number, start, tuple(end), self.known, self.unit, self.relative, words_kept, comments,
                e, numbers.get("E", ""), bool(self.e_relative),
            )
        )  # fmt: skip
        self.at, self.known = list(end), True
