"""CSV tables with units in their headers, written so that they read back exactly.

A spreadsheet runs text that starts like a formula. Such names are written with an apostrophe before them, which tells
spreadsheets that they are text, and reading takes one away: `=1+1` is written as `'=1+1`, and `'=1+1` as `''=1+1`.
Numbers, and numbers with a unit, are no formulas.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

import numpy as np
from pydantic import TypeAdapter

from calib.core.base.arrays import FloatArray
from calib.core.base.letters import visible

_JSON = TypeAdapter(list[float])
_LEAST_PLAIN, _BEYOND_PLAIN = 1e-4, 1e16  # where `repr` writes no exponent
_ROWS = 1 << 12  # formatted together
_NEEDS_QUOTES = re.compile(r'[,"\r\n]')
_QUANTITY = re.compile(r"[-+]?(\d+(?:\.\d*)?|\.\d+)([eE][-+]?\d+)?( [a-z]+)?", re.ASCII)
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

    NaN in an array gives an empty cell. Comments are lines to put first, behind #. Columns of different lengths are a
    `ValueError`.
    """
    lines = ["# " + _FORMULA_IN_COMMENT.sub(r"\1 ", visible(comment)) for comment in comments]
    lines.append(",".join([_quote_text(header) for header, _ in columns]))
    for start in range(0, max((len(values) for _, values in columns), default=0), _ROWS):  # few cells at a time
        cells = [_format_cells(values[start : start + _ROWS]) for _, values in columns]
        cells[0] = [f'"{cell}"' if cell.lstrip().startswith("#") else cell for cell in cells[0]]  # no comment
        cells[0] = [cell or '""' for cell in cells[0]] if len(cells) == 1 else cells[0]  # no empty line
        lines += map(",".join, zip(*cells, strict=True))
    return "\n".join(lines) + "\n"


def _format_cells(values: Sequence[object] | FloatArray) -> list[str]:
    """Cells of a column as they are written."""
    if isinstance(values, np.ndarray) and values.dtype == np.float64:
        return _format_numbers(values)
    known: dict[str, str] = {}
    return [
        repr(float(value))
        if isinstance(value, (float, np.floating))
        else known[text]
        if (text := str(value)) in known
        else known.setdefault(text, _quote_text(text))
        for value in values
    ]


def _format_numbers(values: FloatArray) -> list[str]:
    """Return the text by `repr` of each number, in a fifth of the time; empty where it is not finite.

    The JSON writer gives the same digits, except where `repr` has an exponent.
    """
    numbers: list[float] = values.tolist()
    cells = _JSON.dump_json(numbers)[1:-1].decode().split(",") if numbers else []
    size = np.abs(values)
    for k in np.flatnonzero(~((size >= _LEAST_PLAIN) & (size < _BEYOND_PLAIN) | (size == 0.0))).tolist():
        cells[k] = repr(numbers[k]) if math.isfinite(numbers[k]) else ""
    return cells


def _like_formula(text: str) -> bool:
    return _FORMULA.match(text) is not None and _QUANTITY.fullmatch(text) is None


def _quote_text(text: str) -> str:
    plain = f"'{text}" if _like_formula(text) else text
    return '"' + plain.replace('"', '""') + '"' if _NEEDS_QUOTES.search(plain) else plain


def text_of(cell: str) -> str:
    """Return the text behind a cell: an apostrophe before a formula is taken away."""
    return cell[1:] if cell.startswith("'") and _like_formula(cell[1:]) else cell
