"""CSV tables with units in their headers, written so that they read back exactly.

A spreadsheet runs text that starts like a formula. Such names are written with an apostrophe before them, which tells
spreadsheets that they are text, and reading takes one away: `=1+1` is written as `'=1+1`, and `'=1+1` as `''=1+1`.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Sequence

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.letters import visible

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
    stream = io.StringIO()
    for comment in comments:
        apart = _FORMULA_IN_COMMENT.sub(r"\1 ", visible(comment))  # what follows a comma is a cell to a spreadsheet
        stream.write(f"# {apart}\n")
    writer = csv.writer(stream, lineterminator="\n")
    quoting = csv.writer(stream, lineterminator="\n", quoting=csv.QUOTE_ALL)
    writer.writerow([_written_text(header) for header, _ in columns])
    for cells in zip(*(_written_cells(values) for _, values in columns), strict=True):
        (quoting if cells[0].lstrip().startswith("#") else writer).writerow(cells)
    return stream.getvalue()


def _written_cells(values: Sequence[object] | FloatArray) -> list[str]:
    """Cells of a column as they are written."""
    if isinstance(values, np.ndarray) and values.dtype == np.float64:
        return [repr(number) if math.isfinite(number) else "" for number in values.tolist()]
    return [
        repr(float(value)) if isinstance(value, (float, np.floating)) else _written_text(str(value)) for value in values
    ]


def _like_formula(text: str) -> bool:
    return _FORMULA.match(text) is not None and _NUMBER.fullmatch(text) is None


def _written_text(text: str) -> str:
    return f"'{text}" if _like_formula(text) else text


def text_of(cell: str) -> str:
    """Return what was written as this cell: an apostrophe before a formula is taken away."""
    return cell[1:] if cell.startswith("'") and _like_formula(cell[1:]) else cell
