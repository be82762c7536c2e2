"""Where the table begins in files of other programs: lines above the header, a row of units below it, worksheets.

Programs of trackers and coordinate machines write facts about the measurement above the table: SpatialAnalyzer behind
`//`, others as plain lines. A header is a line without a number, and the lines below it have as many cells, with a
number in the first few. The first line is the header if it is one, and no other header is wider; else the widest header
counts, and the lines above it are comments. Two widest headers are refused.
"""

from __future__ import annotations

import csv
import io
import re
import warnings
from collections.abc import Sequence
from itertools import takewhile
from pathlib import Path
from typing import Any

from calib.core.base.errors import DataError
from calib.core.base.files import read_bytes
from calib.core.base.units import split_column

SEPARATORS = ",;\t"
COMMENTS = ("#", "//")
_NUMBER = re.compile(r"[-+]?(\d+([.,]\d*)*|[.,]\d+)([eE][-+]?\d+)?", re.ASCII)
_SEEN = 200  # lines among which the header is
_ROWS = 6  # the header and rows below it, of which one has a number
_WORKBOOKS = (".xlsx", ".xlsm")
_OTHER_SHEETS = (".xls", ".xlsb", ".ods", ".numbers")


def is_comment(line: str) -> bool:
    """Return whether a line of a file is a comment."""
    return line.lstrip().startswith(COMMENTS)


def cells_of(line: str, separator: str) -> tuple[str, ...]:
    """Return the cells of a line; one that is not CSV is a `csv.Error`."""
    if '"' in line or len(line) > csv.field_size_limit():
        return tuple(next(csv.reader([line], delimiter=separator, strict=True, skipinitialspace=True)))
    cells = line.split(separator)  # as csv does, in a third of the time
    return tuple([cell.lstrip(" ") for cell in cells] if " " in line else cells)


def separator_of(line: str) -> str:
    """Return the separator of the cells of a header: comma, semicolon or tab."""
    return max(SEPARATORS, key=re.sub('"[^"]*"', "", line).count)


def header_line(path: str, lines: Sequence[str]) -> int:
    """Return which of the first lines of a file is the header, from 0; the first with cells, if none looks like one.

    `DataError` if two lines look like a header, or numbers stand where the header should be.
    """
    kept = [k for k, line in enumerate(lines[:_SEEN]) if line.strip().strip(SEPARATORS) and not is_comment(line)]
    widths = {k: _header_width(lines, kept[n : n + _ROWS]) for n, k in enumerate(kept)}
    widest = max(widths.values(), default=0)
    best = [k for k in kept if widths[k] == widest]
    if widest == 0 or best[0] == kept[0]:
        if kept and _has_only_numbers(_split_cells(lines[kept[0]], separator_of(lines[kept[0]]))):
            raise DataError(
                f"{path}, line {kept[0] + 1}: numbers where the header should be; write a line with the names of the"
                " columns above them, such as Point,X [mm],Y [mm],Z [mm]"
            )
        return kept[0] if kept else 0
    if len(best) > 1:
        raise DataError(
            f"{path}: lines {best[0] + 1} and {best[1] + 1} both look like the header; begin every line above the"
            " right one with #"
        )
    return best[0]


def units_below(names: Sequence[str], cells: Sequence[str]) -> tuple[str | None, ...] | None:
    """Return the unit of each column, or None, from a row of units below a header; None if the row is no row of units.

    A header that has units itself has no such row.
    """
    if len(cells) != len(names) or any(split_column(name)[1] for name in names):
        return None
    units: list[str | None] = []
    for cell in map(str.strip, cells):
        units.append(_unit(cell) if cell else None)
        if cell and units[-1] is None:
            return None
    return tuple(units) if any(units) else None


def _unit(cell: str) -> str | None:
    """The unit that a cell is, in brackets or without."""
    bare = re.sub(r"^[\[(]\s*(.*?)\s*[\])]$", r"\1", cell)
    name, unit = split_column(f"x ({bare})")
    return unit if name == "x" else None


def _header_width(lines: Sequence[str], line_numbers: Sequence[int]) -> int:
    """Number of columns of a header; 0 if the first of these lines is none."""
    separator = separator_of(lines[line_numbers[0]])
    names, *below = [_split_cells(lines[k], separator) for k in line_numbers]
    filled = [name.strip() for name in names if name.strip()]
    if len(names) < 2 or 2 * len(filled) <= len(names) or any(_NUMBER.fullmatch(name) for name in filled):
        return 0
    if units_below([""] * len(names), names):
        return 0
    rows = list(takewhile(lambda cells: len(cells) == len(names), below))
    return len(names) if any(_NUMBER.fullmatch(cell.strip()) for cells in rows for cell in cells) else 0


def _has_only_numbers(cells: Sequence[str]) -> bool:
    """Whether a line has three or more numbers, perhaps after a name, as no header has."""
    filled = [cell.strip() for cell in cells[1:] if cell.strip()]
    numbers = [_NUMBER.fullmatch(cell) for cell in filled[-3:]]
    return len(numbers) == 3 and all(numbers) and any("." in cell for cell in filled[-3:])


def _split_cells(line: str, separator: str) -> tuple[str, ...]:
    try:
        return cells_of(line, separator)
    except csv.Error:  # reading the table raises this error again, with its line
        return (line,)


def is_workbook(path: Path | str) -> bool:
    """Return whether a file is a workbook of Excel; a spreadsheet of another kind is a `DataError`."""
    suffix = Path(path).suffix.lower()
    if suffix in _OTHER_SHEETS:
        raise DataError(f"{path}: spreadsheets are read as .xlsx or CSV; save it as one of these")
    return suffix in _WORKBOOKS


def workbook_lines(path: Path | str) -> list[str]:
    """Return the only sheet with cells of a workbook as lines of CSV, a line for each of its rows.

    `DataError` if openpyxl is missing, the file is no workbook, several sheets have cells, or a formula ended in an
    error.
    """
    try:
        from openpyxl import load_workbook
    except ImportError:
        raise DataError(
            f"{path}: is a workbook, and the package that reads them is not installed: pip install openpyxl"
        ) from None
    content = read_bytes(path, "a workbook", DataError)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # warnings of styles and checks that are not read
        try:
            book = load_workbook(io.BytesIO(content), read_only=True, data_only=True)
            sheets = {sheet.title: [tuple(row) for row in sheet.iter_rows()] for sheet in book.worksheets}
            book.close()
        except Exception as error:  # errors of zip files and XML, for any broken file
            reason = f"{type(error).__name__}: {error}".splitlines()[0]
            raise DataError(f"{path}: is not a workbook that can be read ({reason:.120})") from None
    filled = {title: rows for title, rows in sheets.items() if any(cell.value is not None for r in rows for cell in r)}
    if len(filled) != 1:
        names = ", ".join(f"'{title}'" for title in filled)
        raise DataError(
            f"{path}: {f'several sheets have data: {names}' if filled else 'has no data'}; give a workbook with one"
            " sheet of measurements, or save that sheet as CSV"
        )
    ((title, rows),) = filled.items()
    return _as_lines(f"{path}, sheet '{title}'", rows)


def _as_lines(where: str, rows: Sequence[tuple[Any, ...]]) -> list[str]:
    width = max(k + 1 for row in rows for k, cell in enumerate(row) if cell.value is not None)
    lines = []
    for number, row in enumerate(rows, start=1):
        wrong = next((cell for cell in row if cell.data_type == "e"), None)
        if wrong is not None:
            raise DataError(f"{where}, row {number}: a formula ended in {wrong.value}; correct it, or remove the row")
        values = [cell.value for cell in row[:width]]
        texts = ["" if value is None else " ".join(str(value).split("\n")) for value in values]
        if texts and texts[0].startswith(COMMENTS) and not any(texts[1:]):
            lines.append(texts[0])
            continue
        texts += [""] * (width - len(texts))
        lines.append(",".join(map(quote_cell, texts)))
    return lines


def quote_cell(text: str) -> str:
    """Return a cell, in quotes if it would be several cells or a comment without them."""
    return '"' + text.replace('"', '""') + '"' if re.search(r'[",;\t]|^\s*(#|//)', text) else text
