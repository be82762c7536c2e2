"""Points of a body by name, from a CSV file: columns `point`, `x`, `y`, `z`, with units in the header."""

from __future__ import annotations

import csv
import math
from pathlib import Path

from calib.errors import DescriptionError, InputError
from calib.units import per_si, split_column

_COLUMNS = ("point", "x", "y", "z")


def read_points(path: Path) -> dict[str, tuple[float, float, float]]:
    """Return points by name [m].

    Raises:
        DescriptionError: No such file, a column that is missing or has a wrong unit, a cell that is no number, or a
        name
            that comes twice.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError):
        raise DescriptionError(f"{path}: cannot be read; give a CSV file with columns point, x, y, z") from None
    rows = [(k, row) for k, row in enumerate(csv.reader(lines), 1) if row and not row[0].lstrip().startswith("#")]
    header = [split_column(cell) for cell in rows[0][1]] if rows else []
    names = [name for name, _ in header]
    missing = next((name for name in _COLUMNS if name not in names), None)
    if missing is not None:
        raise DescriptionError(f"{path}: no column '{missing}'; expected point, x, y, z")
    place = [names.index(name) for name in _COLUMNS]
    try:
        divisors = [per_si(header[k][1], "length", f"{path}, column '{names[k]}'") for k in place[1:]]
    except InputError as error:
        raise DescriptionError(str(error)) from None
    found: dict[str, tuple[float, float, float]] = {}
    for line, row in rows[1:]:
        if len(row) != len(names):
            raise DescriptionError(f"{path}, line {line}: {len(row)} cells for {len(names)} columns")
        name = row[place[0]].strip()
        if not name or name in found:
            raise DescriptionError(f"{path}, line {line}: {f'point {name!r} comes twice' if name else 'has no name'}")
        x, y, z = (_number(row[k], f"{path}, line {line}, column '{names[k]}'") for k in place[1:])
        found[name] = (x / divisors[0], y / divisors[1], z / divisors[2])
    if not found:
        raise DescriptionError(f"{path}: has no points")
    return found


def _number(cell: str, where: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise DescriptionError(f"{where}: '{cell.strip():.60}' is not a number")
    return value
