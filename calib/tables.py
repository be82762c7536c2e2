"""CSV tables with units in their headers: read with the line and column of every mistake, and written back.

A column is `name` or `name [unit]`; without a unit the numbers are SI. Lines that start with # are comments.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.errors import DataError, InputError, nearest
from calib.mechanism import FloatArray
from calib.units import Dimension, per_si, split_column

_SUSPICIOUS: dict[Dimension, tuple[float, str]] = {"angle": (4 * math.pi, "deg"), "length": (50.0, "mm")}


@dataclass(frozen=True)
class Table:
    """A CSV file as text.

    Attributes:
        path: Where it came from, for messages.
        names: Column names without units.
        units: Unit of each column, None where none is written.
        rows: Cells of each row.
        lines: Line number in the file of each row.
        comments: Comment lines without their #.
    """

    path: str
    names: tuple[str, ...]
    units: tuple[str | None, ...]
    rows: tuple[tuple[str, ...], ...]
    lines: tuple[int, ...]
    comments: tuple[str, ...]

    def column(self, name: str, dimension: Dimension) -> FloatArray:
        """Return a column of numbers in SI, (n_rows,).

        Raises:
            DataError: No such column, wrong unit, or a cell that is not a finite number.
        """
        if name not in self.names:
            raise DataError(f"{self.path}: no column '{name}'{nearest(name, self.names)}")
        index = self.names.index(name)
        try:
            divisor = per_si(self.units[index], dimension, f"{self.path}, column '{name}'")
        except InputError as error:
            raise DataError(str(error)) from None
        values = np.array(
            [self._number(row[index], line, name) for row, line in zip(self.rows, self.lines, strict=True)]
        )
        limit, unit = _SUSPICIOUS[dimension]
        if self.units[index] is None and values.size and np.max(np.abs(values)) > limit:
            line = self.lines[int(np.argmax(np.abs(values)))]
            si = "rad" if dimension == "angle" else "m"
            raise DataError(
                f"{self.path}, line {line}, column '{name}': {np.max(np.abs(values)):g} {si} is not plausible;"
                f" write the unit into the header, such as '{name} [{unit}]' (or '[{si}]' if it is right)"
            )
        return values / divisor

    def text(self, name: str) -> list[str]:
        """Return a column as text."""
        index = self.names.index(name)
        return [row[index] for row in self.rows]

    def _number(self, cell: str, line: int, name: str) -> float:
        where = f"{self.path}, line {line}, column '{name}'"
        if not cell.strip():
            raise DataError(f"{where}: is empty; fill it in, or remove the row")
        try:
            value = float(cell)
        except ValueError:
            raise DataError(f"{where}: '{cell.strip()}' is not a number") from None
        if not math.isfinite(value):
            raise DataError(f"{where}: '{cell.strip()}' is not finite; remove the row")
        return value


def read_table(path: Path | str, renamed: Mapping[str, str] | None = None) -> Table:
    """Read a CSV file.

    Args:
        path: The file.
        renamed: Foreign column names and the `name` or `name [unit]` they stand for.

    Raises:
        DataError: Missing or unreadable file, no header or rows, duplicate columns, rows of the wrong length.
    """
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise DataError(f"{path}: no such file; give a CSV file") from None
    except UnicodeDecodeError:
        raise DataError(f"{path}: is not UTF-8 text; save it as CSV in UTF-8") from None
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({(error.strerror or str(error)).lower()})") from None
    comments, kept, numbers = [], [], []
    for number, line in enumerate(text.splitlines(), start=1):
        if line.lstrip().startswith("#"):
            comments.append(line.lstrip()[1:].strip())
        elif line.strip().strip(","):
            kept.append(line)
            numbers.append(number)
    if not kept:
        raise DataError(f"{path}: is empty; expected a header line and rows of numbers")
    try:
        cells = [tuple(next(csv.reader([line], strict=True))) for line in kept]
    except csv.Error as error:
        raise DataError(f"{path}: is not CSV ({error})") from None
    names, units = _header(str(path), kept[0], cells[0], renamed or {})
    for row, number in zip(cells[1:], numbers[1:], strict=True):
        if len(row) != len(names):
            raise DataError(
                f"{path}, line {number}: {len(row)} cells for {len(names)} columns"
                + ("; write decimals with a point" if len(row) > len(names) else "")
            )
    if len(cells) == 1:
        raise DataError(f"{path}: has a header but no rows")
    return Table(str(path), names, units, tuple(cells[1:]), tuple(numbers[1:]), tuple(comments))


def _header(
    path: str, line: str, cells: tuple[str, ...], renamed: Mapping[str, str]
) -> tuple[tuple[str, ...], tuple[str | None, ...]]:
    if len(cells) == 1 and any(mark in line for mark in ";\t"):
        raise DataError(f"{path}: columns are separated by {'semicolons' if ';' in line else 'tabs'}; use commas")
    names, units = [], []
    for cell in cells:
        name, unit = split_column(renamed.get(cell.strip(), cell))
        if name == cell.strip() and name in renamed:
            name, unit = split_column(renamed[name])
        names.append(name)
        units.append(unit)
    for name in names:
        if names.count(name) > 1:
            raise DataError(f"{path}: column '{name}' appears twice; names must be unique")
    return tuple(names), tuple(units)


def format_table(columns: Sequence[tuple[str, Sequence[object]]], comments: Sequence[str] = ()) -> str:
    """Return CSV text; floats are written so that they read back exactly.

    Args:
        columns: (header, values) of each column, values of equal length.
        comments: Lines to put first, behind #.
    """
    stream = io.StringIO()
    for comment in comments:
        stream.write(f"# {comment}\n")
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow([header for header, _ in columns])
    for row in zip(*(values for _, values in columns), strict=True):
        writer.writerow([repr(float(cell)) if isinstance(cell, (float, np.floating)) else cell for cell in row])
    return stream.getvalue()
