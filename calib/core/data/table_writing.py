"""CSV tables with units in their headers, written so that they read back exactly.

A spreadsheet runs text that starts like a formula. Such names are written with an apostrophe before them, which tells
spreadsheets that they are text, and reading takes one away: `=1+1` is written as `'=1+1`, and `'=1+1` as `''=1+1`.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from operator import itemgetter
from typing import TypeGuard

import numpy as np
from pydantic import TypeAdapter

from calib.core.base.arrays import FloatArray
from calib.core.base.letters import visible

_PART = 8192  # rows that are written together
_JSON = TypeAdapter(list[float])
_ALONE = '""\n'  # what the writer makes of an empty cell that is alone in its line
_LEAST_PLAIN, _BEYOND_PLAIN = 1e-4, 1e16  # where `repr` writes no exponent
_NUMBER = re.compile(r"[-+]?(\d+(?:\.\d*)?|\.\d+)([eE][-+]?\d+)?", re.ASCII)
_FORMULA = re.compile(r"'*[=+\-@\uff1d\uff0b\uff0d\uff20]")  # the last four: of full width
_FORMULA_IN_COMMENT = re.compile(r"([,;\t])(?=[=@\uff1d\uff0b\uff0d\uff20]|[-+](?![\d.]))")
Written = Sequence[tuple[str, Sequence[object] | FloatArray]]
"""Columns to write: header and values of each."""


def format_table(columns: Written, comments: Sequence[str] = ()) -> str:
    """Return CSV text; floats are written so that they read back exactly, and text so that no spreadsheet runs it.

    >>> print(format_table([("pose", ["A", "B"]), ("q1 [mm]", [0.1, 2.0])], ("two poses",)), end="")
    # two poses
    pose,q1 [mm]
    A,0.1
    B,2.0

    Args:
        columns: (header, values) of each column, values of equal length; of an array, cells without a number are empty.
        comments: Lines to put first, behind #.

    Raises:
        ValueError: Columns of different lengths.
    """
    return "".join(table_pieces(columns, comments))


def table_bytes(columns: Written, comments: Sequence[str] = ()) -> bytes:
    """Return the text of `format_table` in UTF-8; of a long table it is there once.

    Args:
        columns, comments: As there.

    Raises:
        ValueError: As there.
    """
    stream = io.BytesIO()
    for piece in table_pieces(columns, comments):
        stream.write(piece.encode())
    return stream.getvalue()


def table_pieces(columns: Written, comments: Sequence[str] = ()) -> Iterator[str]:
    """Yield the text of `format_table`, some rows at a time.

    Args:
        columns, comments: As there.

    Raises:
        ValueError: As there.
    """
    stream = io.StringIO()
    for comment in comments:
        apart = _FORMULA_IN_COMMENT.sub(r"\1 ", visible(comment))  # what follows a comma is a cell to a spreadsheet
        stream.write(f"# {apart}\n")
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow([_written_text(header) for header, _ in columns])
    quoting = csv.writer(stream, lineterminator="\n", quoting=csv.QUOTE_ALL)
    lengths = {len(values) for _, values in columns}
    if len(lengths) > 1:
        raise ValueError(f"columns of different lengths: {sorted(lengths)}")
    for start in range(0, max(lengths, default=0), _PART):
        written = [_written_cells(values[start : start + _PART]) for _, values in columns]
        if any(map(_like_comment, written[0])):
            for cells in zip(*written, strict=True):
                (quoting if _like_comment(cells[0]) else writer).writerow(cells)
        else:
            stream.writelines(_lines(written, [_are_numbers(values) for _, values in columns]))
        yield stream.getvalue()
        stream.seek(0)
        stream.truncate()
    yield stream.getvalue()


def _are_numbers(values: Sequence[object] | FloatArray) -> TypeGuard[FloatArray]:
    return isinstance(values, np.ndarray) and values.dtype == np.float64


def _written_cells(values: Sequence[object] | FloatArray) -> list[str]:
    """Cells of a column as they are written."""
    if _are_numbers(values):
        return _written_numbers(values)
    known: dict[str, str] = {}
    return [
        repr(float(value))
        if isinstance(value, (float, np.floating))
        else known[text]
        if (text := str(value)) in known
        else known.setdefault(text, _written_text(text))
        for value in values
    ]


def _written_numbers(values: FloatArray) -> list[str]:
    """Return what `repr` makes of each number, in a tenth of the time; empty where it is not finite.

    JSON has the same digits; it writes others where `repr` has an exponent.
    """
    numbers: list[float] = values.tolist()
    cells = _JSON.dump_json(numbers)[1:-1].decode().split(",")
    size = np.abs(values)
    for k in np.flatnonzero(~((size >= _LEAST_PLAIN) & (size < _BEYOND_PLAIN) | (size == 0.0))).tolist():
        cells[k] = repr(numbers[k]) if math.isfinite(numbers[k]) else ""
    return cells


def _lines(columns: list[list[str]], are_numbers: list[bool]) -> Iterable[str]:
    """Return the lines of columns of cells; the writer does not look into those of numbers, which need no quotes."""
    if len(columns) == 1:
        return _quoted(columns)
    parts: list[Iterable[str]] = []
    for numeric, group in groupby(zip(are_numbers, columns, strict=True), key=itemgetter(0)):
        some = [column for _, column in group]
        parts.append(
            map(",".join, zip(*some, strict=True))
            if numeric
            else ["" if line == _ALONE else line[:-1] for line in _quoted(some)]
        )
    return (f"{line}\n" for line in map(",".join, zip(*parts, strict=True)))


def _quoted(columns: list[list[str]]) -> list[str]:
    """Return lines of text cells, with quotes where they need them."""
    lines: list[str] = []
    csv.writer(_Kept(lines.append), lineterminator="\n").writerows(zip(*columns, strict=True))
    return lines


@dataclass(frozen=True)
class _Kept:
    """What a CSV writer writes to: `write` takes one line each time."""

    write: Callable[[str], object]


def _like_comment(cell: str) -> bool:
    return cell.lstrip().startswith("#")


def _like_formula(text: str) -> bool:
    return _FORMULA.match(text) is not None and _NUMBER.fullmatch(text) is None


def _written_text(text: str) -> str:
    return f"'{text}" if _like_formula(text) else text


def text_of(cell: str) -> str:
    """Return what was written as this cell: an apostrophe before a formula is taken away."""
    return cell[1:] if cell.startswith("'") and _like_formula(cell[1:]) else cell
