"""G-code programs as written: their straight moves, and the same program with other points.

Comments are added behind a semicolon, which Marlin and Klipper need, or in parentheses, which every milling machine
reads. Parentheses do not nest, and a line of LinuxCNC has at most 255 characters. For milling machines, every number
has a point.

E is divided along a cut move, absolute (M82) or relative (M83). Other words (F, S ...) stay on the first piece, since
they hold from there on; those that run when the move has ended (M0, M30 ...), on the last. Comments and all other lines
stay unchanged.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import DataError
from calib.core.base.units import from_unit

ROUNDING = 1e-7
"""Largest error of written points from their limited decimals [m]."""
MILLIMETRE, INCH = from_unit(1.0, "mm"), from_unit(25.4, "mm")
"""Units of programs [m]."""
_DECIMALS = {MILLIMETRE: 4, INCH: 6}
_E_DECIMALS = 5
_IN_PARENTHESES = str.maketrans("();%!?~", "[],____")  # ends of comments, blocks and tapes; grbl obeys the others
_WIDEST = 100
_HEAD = re.compile(r"\s*(%\s*$|O\s*\d)", re.IGNORECASE)


@dataclass(frozen=True)
class GcodeMove:
    """A straight move.

    Attributes:
        line: Index in the lines of the program.
        start: Start in the program's coordinates [m]; None where unknown.
        end: End [m].
        is_start_known: Whether the move before led to `start`; False at the beginning and after homing.
        unit: Unit of the numbers [m].
        relative: Whether the numbers count from the machine's position.
        lead: Words up to G0 or G1; without a G, only the line number, if any.
        tail: Other words, without E.
        last: Words that run when the move has ended.
        comments: Comments on the line, as written.
        e: E at the beginning and at the end; None without E, or where the move cannot be cut.
        e_text: E as written; empty if there is none.
        e_relative: Whether E counts from its last value.
    """

    line: int
    start: tuple[float, ...] | None
    end: tuple[float, ...]
    is_start_known: bool
    unit: float
    relative: bool
    lead: tuple[str, ...]
    tail: tuple[str, ...]
    last: tuple[str, ...]
    comments: str
    e: tuple[float, float] | None = None
    e_text: str = ""
    e_relative: bool = False

    @property
    def motion(self) -> tuple[str, ...]:
        """G0 or G1 as written; empty if the line has none."""
        return tuple(word for word in self.lead[-1:] if word.startswith("G"))


@dataclass(frozen=True)
class GcodeProgram:
    """A program.

    Attributes:
        path: Its file.
        lines: Its lines.
        moves: Its straight moves in order.
        line_end: What ends its lines.
        unit_stated: Whether its unit is certain; a milling machine without G20 or G21 may begin in inches.
        fanuc: Whether FANUC may read it (`calib.programs.languages.gcode_dialects.Dialect`).
    """

    path: str
    lines: tuple[str, ...]
    moves: tuple[GcodeMove, ...]
    line_end: str = "\n"
    fanuc: bool = False
    unit_stated: bool = True

    @property
    def comment(self) -> str:
        """How its comments begin."""
        return "(" if self.fanuc else ";"

    def label(self, move: GcodeMove) -> str:
        """Return the name of a move in messages."""
        return f"{self.path}, line {move.line + 1}"

    def rewritten(self, ways: Sequence[FloatArray] | None, comments: Sequence[str] = ()) -> str:
        """Return the text of the program with other points, and comments first, after the mark that starts a tape
        (`%`) and the program's number.

        `ways` are points through which each move goes in straight lines, the last of which is its end, (n_pieces, 3)
        [m]; None: all lines stay unchanged.

        Raises:
            DataError: A move with E is cut, and the program does not define what E means.
        """
        lines = [[line] for line in self.lines]
        stands: FloatArray = np.zeros(3)
        for move, way in zip(self.moves, ways, strict=True) if ways is not None else ():
            if not move.is_start_known and move.start is not None:
                stands = np.array(move.start, dtype=np.float64)
            lines[move.line], stands = self._pieces(move, way, stands)
        first = next((k for k, line in enumerate(self.lines) if not _HEAD.match(line)), 0)
        lines.insert(first, [line for comment in comments for line in self._comment_lines(comment)])
        return "".join(line + self.line_end for piece in lines for line in piece)

    def _comment_lines(self, text: str) -> list[str]:
        if not self.fanuc:
            return [f"; {text}"]
        return [f"({line})" for line in textwrap.wrap(text.translate(_IN_PARENTHESES), _WIDEST)]

    def _pieces(self, move: GcodeMove, way: FloatArray, stands: FloatArray) -> tuple[list[str], FloatArray]:
        """The lines of one move, and where the machine then stands [m]."""
        decimals, lines = _DECIMALS[move.unit], []
        for k, point in enumerate(way):
            numbers = np.round((point - stands if move.relative else point) / move.unit, decimals) + 0.0
            stands = stands + numbers * move.unit if move.relative else numbers * move.unit
            axes = [
                f"{axis}{_format_number(number, decimals, point=self.fanuc)}"
                for axis, number in zip("XYZ", numbers, strict=True)
            ]
            words = [*move.lead, *axes, *move.tail] if k == 0 else [*move.motion, *axes]
            if move.e_text:
                words.append(f"E{self._share(move, k, len(way))}")
            lines.append(" ".join([*words, *move.last] if k == len(way) - 1 else words))
        lines[0] += f" {move.comments}" if move.comments else ""
        return lines, stands

    def _share(self, move: GcodeMove, k: int, n: int) -> str:
        """E of piece k of n."""
        if n == 1:
            return move.e_text
        if move.e is None:
            raise DataError(
                f"{self.label(move)}: is cut into {n} pieces, and the meaning of its E is unknown; write M82 and"
                " G92 E0, or M83, before it and after every G90 and G91"
            )
        decimals = max(_E_DECIMALS, len(move.e_text.partition(".")[2]))
        start, end = move.e
        before, after = (round(start + (end - start) * share / n, decimals) for share in (k, k + 1))
        return _format_number(after - before if move.e_relative else after, decimals)


def _format_number(number: float, decimals: int, *, point: bool = False) -> str:
    """A number with at most `decimals` decimals and no exponent; with a `point`, in any case."""
    text = f"{number:.{decimals}f}".rstrip("0").rstrip(".")
    text = "0" if text == "-0" else text
    return text if "." in text or not point else f"{text}.0"
