"""CSV tables with units in their headers, read with the line and column of every mistake.

A column is `name` or `name [unit]`; without a unit the numbers are SI. Lines that start with # or // are comments.
Commas, semicolons or tabs separate the columns; the header decides. Where they are not commas, a comma may be the
decimal mark. `calib.core.data.layouts` knows what other programs write around a table; what is guessed is logged as a
warning.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol, SupportsIndex, TypeGuard, cast

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import DataError, listed_columns, nearest
from calib.core.base.files import read_text
from calib.core.base.letters import unseen, visible
from calib.core.base.own_files import is_mark
from calib.core.base.registry import load_entry
from calib.core.base.units import Dimension, MappedColumn, check_plausible, mapped_column, per_si, split_column
from calib.core.base.words import warn_once
from calib.core.data.layouts import (
    COMMENTS,
    SEPARATORS,
    cells_of,
    header_line,
    is_comment,
    is_workbook,
    separator_of,
    units_below,
    workbook_lines,
)
from calib.core.data.other_formats import is_bag, read_other
from calib.core.data.table_writing import text_of

_LARGEST = {"length": 1e6, "angle": 1e6, "pixel": 1e6}  # [SI]
_LARGEST_NUMBER = 1e30  # largest value in other columns: squares and sums of many stay finite
IN_MEMORY = "table in memory"
"""Name in messages of a table that is no file."""
_WITH_THOUSANDS = re.compile(r"[-+]?\d+(\.\d+)+,\d*|[-+]?\d+(,\d+)+\.\d*|[-+]?\d+(,\d+){2,}", re.ASCII)
_LIKE_THOUSANDS = re.compile(r"[-+]?[1-9]\d{0,2}[.,]\d{3}", re.ASCII)
_DECIMAL = re.compile(r"[-+]?\d*[.,]\d+", re.ASCII)
_DECIMAL_COMMA = re.compile(r"[-+]?(\d+,\d*|,\d+)([eE][-+]?\d+)?", re.ASCII)


class DataFrameProtocol(Protocol):
    """A data frame, of pandas or polars."""

    columns: Any

    def __getitem__(self, name: Any, /) -> Any:
        """Return a column."""


Columns = DataFrameProtocol | Mapping[str, Sequence[object]]
"""A table in memory: columns by their headers, which are written as in files."""
Source = Path | str | Columns
"""Where a table comes from."""


def is_columns(source: object) -> TypeGuard[Columns]:
    """Return whether this is a table in memory."""
    if isinstance(source, Mapping):
        return all(isinstance(name, str) and np.ndim(column) == 1 for name, column in source.items())
    return all(hasattr(type(source), name) for name in ("columns", "head", "__getitem__"))


def is_source(source: object) -> TypeGuard[Source]:
    """Return whether this is a file or a table in memory."""
    return isinstance(source, (str, Path)) or is_columns(source)


@dataclass(frozen=True)
class Table:
    """A CSV file as text.

    Attributes:
        path: Its file, for messages.
        names: Column names without units.
        units: Unit of each column, None where none is written.
        rows: Cells of each row.
        lines: Line number in the file of each row.
        comments: Comment lines without their #.
        separator: Separator of the cells.
        maps: Conversion from cells to values (factor, offset) of the columns that need one, by name.
        headers: Names in the file of columns that are called otherwise here, by name.
    """

    path: str
    names: tuple[str, ...]
    units: tuple[str | None, ...]
    rows: tuple[tuple[str, ...], ...]
    lines: tuple[int, ...]
    comments: tuple[str, ...]
    separator: str
    maps: Mapping[str, MappedColumn] = field(default_factory=dict)
    headers: Mapping[str, str] = field(default_factory=dict)

    def header(self, name: str) -> str:
        """Return the name of a column in the file, for messages."""
        return self.headers.get(name, name)

    def lacks(self, name: str, taken: Collection[str] = ()) -> str:
        """Return the message on a column that is missing; of the columns here, those `taken` are not offered."""
        columns, used = list(map(self.header, self.names)), set(map(self.header, taken))
        hint = nearest(name, [column for column in columns if column not in used])
        hint = f"{hint} The" if hint.endswith("?") else "; the"
        return f"{self.path}: no column '{name}'{hint} file has {listed_columns(columns)}"

    def column(self, name: str, dimension: Dimension | None, *, gaps: bool = False) -> FloatArray:
        """Return a column of numbers of a dimension (None: pure numbers) in SI, (n_rows,).

        With `gaps`, cells may be empty, which gives NaN. `DataError` if there is no such column, its unit is wrong, a
        cell is no finite number, or decimal commas are mixed with points.
        """
        if name not in self.names:
            raise DataError(self.lacks(name))
        index = self.names.index(name)
        if dimension is None and self.units[index] is not None:
            raise DataError(
                f"{self.path}, column '{self.header(name)}': has a unit, but is a pure number; remove the unit"
            )
        place = f"{self.path}, column '{self.header(name)}'"
        divisor = 1.0 if dimension is None else per_si(self.units[index], dimension, place, DataError)
        values = self._numbers(name, gaps=gaps)
        if np.all(np.isnan(values)):
            return values
        worst = int(np.nanargmax(np.abs(values)))
        if self.units[index] is None and dimension is not None:
            check_plausible(values[worst], dimension, self.where(worst, name), "into the header")
        values = values / divisor
        if name in self.maps:
            mapped = self.maps[name]
            scale = 1.0 if dimension is None else per_si(mapped.unit, dimension, place)
            values = mapped.factor * values + mapped.offset / scale
        if abs(values[worst]) > _LARGEST.get(dimension or "", _LARGEST_NUMBER):
            raise DataError(
                f"{self.where(worst, name)}: {self.rows[worst][index]:.60} is beyond what any instrument measures;"
                " correct it, or leave the row out"
            )
        return values

    def text(self, name: str) -> list[str]:
        """Return a column as text, without blanks around it; one that is missing is a `DataError`."""
        if name not in self.names:
            raise DataError(self.lacks(name))
        index = self.names.index(name)
        texts = [text_of(cells[index].strip()) for cells in self.rows]
        if unseen("".join(texts)):
            row, problem = next((row, problem) for row, text in enumerate(texts) if (problem := unseen(text)))
            raise DataError(f"{self.where(row, name)}: {problem}")
        return "\n".join(texts).split("\n") if texts else []  # new: text among the cells would keep all their memory

    def _numbers(self, name: str, *, gaps: bool) -> FloatArray:
        index = self.names.index(name)
        cells = [row[index] for row in self.rows]
        if self.separator != ",":
            self._check_marks(name, cells)
        try:
            values = np.array([float(cell) for cell in cells])
            if np.all(np.isfinite(values)) and "_" not in ",".join(cells):  # float() also reads 1_000
                return values
        except ValueError:
            pass  # the error below names the cell
        return np.array(
            [
                np.nan if gaps and not cell.strip() else read_number(cell, self.where(k, name), self.separator)
                for k, cell in enumerate(cells)
            ]
        )

    def _check_marks(self, name: str, cells: Sequence[str]) -> None:
        """Raise `DataError` where a column has commas and points, as it is unclear which of them are decimal.

        So are `1.234` if another column with a unit has decimal commas, and `1,234` if one has decimal points.
        """
        comma = next((k for k, cell in enumerate(cells) if "," in cell and "." not in cell), None)
        point = next((k for k, cell in enumerate(cells) if "." in cell and "," not in cell), None)
        if comma is not None and point is not None:
            raise DataError(
                f"{self.where(comma, name)}: '{cells[comma].strip():.60}', but '{cells[point].strip():.60}' in line"
                f" {self.lines[point]}; write all decimals of a column one way"
            )
        doubtful = next((k for k, cell in enumerate(cells) if _LIKE_THOUSANDS.fullmatch(cell.strip())), None)
        if doubtful is None:
            return
        decimal = self._decimals["." if "," in cells[doubtful] else ","]
        if decimal:
            raise DataError(
                f"{self.where(doubtful, name)}: '{cells[doubtful].strip()}', but another column has '{decimal:.60}';"
                " write all decimals one way, and thousands without a mark"
            )

    @cached_property
    def _decimals(self) -> dict[str, str]:
        """For the marks `.` and `,`, a number with a unit in which it is a decimal mark; empty if there is none."""
        columns = [column for column, unit in enumerate(self.units) if unit]
        found = {}
        for mark in ".,":
            marked = (row[column].strip() for column in columns for row in self.rows if mark in row[column])
            sure = (text for text in marked if _DECIMAL.fullmatch(text) and not _LIKE_THOUSANDS.fullmatch(text))
            found[mark] = next(sure, "")
        return found

    def where(self, row: SupportsIndex, name: str = "") -> str:
        """Return the place of a row, or of its cell in a column, for messages."""
        return f"{self.path}, line {self.lines[row]}" + (f", column '{self.header(name)}'" if name else "")


def read_number(cell: str, where: str, separator: str = ",") -> float:
    """Read the number in a cell; an empty one, no number, or one that is not finite, is a `DataError`.

    Where the separator of cells is not the comma, the comma may be the decimal mark.
    """
    text = cell.strip()
    if not text:
        raise DataError(f"{where}: is empty; fill it in, or remove the row")
    hint = "; write decimals with a point" if _DECIMAL_COMMA.fullmatch(text) else ""
    if separator != ",":
        if _WITH_THOUSANDS.fullmatch(text):
            hint = "; write thousands without a mark"
        elif hint:
            text = text.replace(",", ".")
    try:
        value = float(text.replace("_", " "))
    except ValueError:
        raise DataError(f"{where}: '{text:.60}' is not a number{hint}") from None
    if not math.isfinite(value):
        raise DataError(f"{where}: '{text:.60}' is not finite; remove the row")
    return value


def read_table(
    path: Source, renamed: Mapping[str, str] | None = None, *, growing: Sequence[str] | None = None
) -> Table:
    """Read a CSV file, its columns separated by commas, semicolons or tabs; or a workbook, or a ROS bag.

    Args:
        path: The file, or the folder of a bag; or a table in memory.
        renamed: Foreign column names and the `name` or `name [unit]` they stand for.
        growing: Lines so far of a file that is still written.

    Raises:
        DataError: Unreadable file, no header or rows, duplicate columns, rows of the wrong length.
    """
    renamed = renamed or {}
    if is_columns(path):
        headers = [str(name) for name in (path if isinstance(path, Mapping) else path.columns)]
        _require_unique(IN_MEMORY, headers)
        return _table_of_columns(IN_MEMORY, [(name, list(path[name])) for name in headers], (), renamed)
    path = cast("Path | str", path)
    if growing is not None:
        return _table_of_lines(str(path), growing, renamed)
    if is_bag(path):
        columns, remarks = load_entry("calib.methods", "bags").read_bag(path)
        return _table_of_columns(str(path), columns, remarks, renamed)
    if is_workbook(path):
        return _table_of_lines(str(path), workbook_lines(path), renamed)
    other = read_other(path, renamed)
    if isinstance(other, dict):
        return _table_of_columns(str(path), list(other.items()), (), renamed)
    lines = read_text(path, "a CSV file", DataError).split("\n") if other is None else other
    return _table_of_lines(str(path), lines, renamed)


def _table_of_lines(path: str, lines: Sequence[str], renamed: Mapping[str, str]) -> Table:
    above = header_line(path, lines)
    if "\0" in "".join(lines[: above + 1]):  # as in UTF-16 without its mark, and in files that are no text
        raise DataError(f"{path}: is not UTF-8 text; give a CSV file in UTF-8")
    comments, filled = _without_comments(lines, above)
    if not filled:
        raise DataError(f"{path}: is empty; expected a header line and rows of numbers")
    first, separator = filled[0], separator_of(lines[filled[0] - 1])
    cells = {number: _cells(path, lines[number - 1], number, separator) for number in filled}
    header = cells.pop(first)
    names, units, maps, headers = _header(path, header, renamed)
    below = units_below(header, cells[filled[1]]) if cells else None
    if below:
        units = tuple(unit or other for unit, other in zip(units, below, strict=True))
        del cells[filled[1]]
    if any(line.strip() and not is_comment(line) for line in lines[:above]):
        warn_once(f"{path}: took line {first} for the header, and the lines above it for comments")
    if below:
        warn_once(f"{path}: took the line below the header for units")
    _check_widths(path, cells, len(names), first, separator)
    if not cells:
        raise DataError(f"{path}: has a header but no rows")
    rows = tuple(cells.values())
    return Table(path, names, units, rows, tuple(cells), tuple(map(visible, comments)), separator, maps, headers)


def _without_comments(lines: Sequence[str], above: int) -> tuple[list[str], list[int]]:
    """Return the comments of a file, and line numbers of header and rows; the first `above` lines count as comments."""
    comments, numbers = list[str](), list[int]()
    for number, line in enumerate(lines, start=1):
        if is_comment(line):
            if not is_mark(line):
                begun = next(mark for mark in COMMENTS if line.lstrip().startswith(mark))
                comments.append(line.lstrip().removeprefix(begun).strip())
        elif number <= above:
            comments.extend([text] if (text := line.strip().strip(SEPARATORS)) else [])
        elif line.strip().strip(SEPARATORS):
            numbers.append(number)
    return comments, numbers


def _check_widths(path: str, rows: Mapping[int, Sequence[str]], width: int, header: int, separator: str) -> None:
    """Raise `DataError` for a row, by its line, with more or fewer cells than the header in line `header`."""
    for number, cells in rows.items():
        if len(cells) != width:
            hint = "; write decimals with a point, or separate columns by semicolons"
            if width == 1:
                hint = f"; if line {header} is not the header, begin it with #"
            raise DataError(
                f"{path}, line {number}: {len(cells)} cells for {width} columns"
                + (hint if len(cells) > width and (separator == "," or width == 1) else "")
            )


def _table_of_columns(
    path: str, columns: Sequence[tuple[str, Sequence[object]]], comments: tuple[str, ...], renamed: Mapping[str, str]
) -> Table:
    names, units, maps, headers = _header(path, tuple(header for header, _ in columns), renamed)
    lengths = {header: len(cells) for header, cells in columns}
    if len(set(lengths.values())) > 1:
        header = next(header for header, length in lengths.items() if length != len(columns[0][1]))
        raise DataError(f"{path}: column '{header}' has {lengths[header]} cells, and others {len(columns[0][1])}")
    rows = tuple(zip(*([_as_text(cell) for cell in cells] for _, cells in columns), strict=True))
    if not rows:
        raise DataError(f"{path}: has no rows")
    return Table(path, names, units, rows, tuple(range(1, len(rows) + 1)), comments, ",", maps, headers)


def _require_unique(path: str, names: Sequence[str]) -> None:
    again = next((name for name in names if names.count(name) > 1), None)
    if again is not None:
        raise DataError(f"{path}: column '{again}' appears twice; names must be unique")


def _as_text(cell: object) -> str:
    """A cell as it would stand in a file; empty where there is none."""
    if cell is None or cell != cell:  # NaN, and what pandas has in its place
        return ""
    return repr(float(cell)) if isinstance(cell, (float, np.floating)) else str(cell)


def _cells(path: str, line: str, number: int, separator: str) -> tuple[str, ...]:
    try:
        return cells_of(line, separator)
    except csv.Error as error:
        raise DataError(f"{path}, line {number}: is not CSV ({error})") from None


def _header(
    path: str, cells: tuple[str, ...], renamed: Mapping[str, str]
) -> tuple[tuple[str, ...], tuple[str | None, ...], dict[str, MappedColumn], dict[str, str]]:
    """Names and units of columns, the meanings that a description gives to cells, and the names in the file."""
    names, units, maps, headers = [], [], dict[str, MappedColumn](), dict[str, str]()
    for number, cell in enumerate(cells, start=1):
        cell = text_of(cell.strip())
        name, unit = split_column(cell)
        known = renamed.get(cell, renamed.get(name))
        if known is not None:
            mapped = mapped_column(known)
            headers[mapped.name] = name
            name, unit = mapped.name, mapped.unit if cell in renamed else unit or mapped.unit
            if not mapped.plain:
                maps[name] = mapped
                warn_once(f"{path}: {name} is {mapped.words}")
        if not name:
            raise DataError(f"{path}: column {number} has no name in the header; name it, or remove it")
        names.append(name)
        units.append(unit)
    _require_unique(path, names)
    return tuple(names), tuple(units), maps, headers
