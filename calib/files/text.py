"""Tables of other programs, rewritten as lines of this program's tables, each line at its place in the file.

Reports of measured and nominal values, as PolyWorks, FARO's CAM2 and others write them, have one of two layouts: a row
for each coordinate of a point (`Name; Control; Nom; Meas; Dev`), or columns for each coordinate (`Name; Nominal X;
Measured X; ...`). Both become a row for each point: pose, X, Y, Z.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass

from calib.core.base.errors import DataError
from calib.core.data.layouts import quote_cell
from calib.core.data.other_formats import SomeFile
from calib.core.data.tables import read_number

_MARKS = ("//", "#", "%")
_NUMBER = re.compile(r"[-+]?(\d+[.,]?\d*|[.,]\d+)([eE][-+]?\d+)?|nan", re.ASCII | re.IGNORECASE)
_U95 = re.compile(r"u[ _]?95[ _]?\(?([xyz]?)\)?(?:\s*[\[(](.+)[\])])?", re.IGNORECASE)
_UNITS = {
    "millimeters": "mm",
    "millimetres": "mm",
    "meters": "m",
    "metres": "m",
    "micrometers": "um",
    "inches": "in",
    "feet": "ft",
}
_SEEN = 40  # lines in which a header is searched
_AXES = ["x", "y", "z"]
_TRIPLES = (_AXES, ["rx", "ry", "rz"], ["tx", "ty", "tz"])


def cells_of(line: str) -> list[str]:
    """Return the cells of a line, separated by tabs, semicolons, commas, or else blanks, all outside of quotes."""
    separator = next((mark for mark in "\t;," if mark in re.sub('"[^"]*"', "", line)), None)
    if separator is None:
        cells = re.findall(r'"[^"]*"|\S+', line)
    elif '"' in line and len(line) <= csv.field_size_limit():
        cells = next(csv.reader([line], delimiter=separator, skipinitialspace=True))
    else:
        cells = line.split(separator)
    return [cell.strip().strip('"') for cell in cells]


def _is_number(cell: str) -> bool:
    """Whether a cell is a number, with point or comma."""
    return bool(_NUMBER.fullmatch(cell))


def _unit_above(lines: Sequence[str]) -> str | None:
    """The only unit of length in the lines above a table; None if there is none, or several."""
    words, text = _UNITS | {f"units: {unit}": unit for unit in ("mm", "m")}, "\n".join(lines).casefold()
    units = {unit for word, unit in words.items() if re.search(rf"\b{word}\b", text)}
    return units.pop() if len(units) == 1 else None


def _numbers(cells: Sequence[str]) -> int:
    return sum(map(_is_number, cells))


def _join_cells(cells: Sequence[str]) -> str:
    """A line of a table, with semicolons, as commas may be decimal marks."""
    return ";".join(map(quote_cell, cells))


def _comment(line: str) -> str | None:
    """Text of a comment; None if the line is no comment."""
    mark = next((mark for mark in _MARKS if line.lstrip().startswith(mark)), None)
    return None if mark is None else line.lstrip()[len(mark) :].strip()


def _first_row(lines: Sequence[str]) -> int | None:
    """Index of the first line that is neither a comment nor empty."""
    return next((k for k, line in enumerate(lines) if line.strip() and _comment(line) is None), None)


def find_commented_header(file: SomeFile) -> tuple[int, list[str]] | None:
    """Return line and cells of the last comment above the numbers, if it names their columns; else None."""
    lines = file.first_lines
    row = _first_row(lines)
    cells = [] if row is None else cells_of(lines[row])
    n = len(cells)
    k = next((k for k in range((row or 0) - 1, -1, -1) if _comment(lines[k])), None)
    if k is None or n < 2 or _numbers(cells) < max(n - 4, 1):
        return None
    names = cells_of(_comment(lines[k]) or "")
    named = max(2, n - 2) <= len(names) <= n and len(names) > n / 2 and all(names) and not _numbers(names)
    return (k, names) if named else None


def commented_header_lines(file: SomeFile, known: tuple[int, list[str]]) -> list[str]:
    """Return the lines with that comment as header; columns without a name get their number."""
    lines, (header, names) = file.lines, known
    width = len(cells_of(lines[_first_row(lines) or 0]))
    names = [*names, *(f"column_{k + 1}" for k in range(len(names), width))]
    places = {name.split(" [")[0].split(" (")[0].casefold(): k for k, name in enumerate(names)}
    unit = _unit_above(lines[:header])
    if all(axis in places for axis in _AXES):
        z = re.search(r"[\[(](.+)[\])]$", names[places["z"]])
        unit = z[1] if z else unit
        for axis in _AXES:
            if unit and not re.search(r"[\[(]", names[places[axis]]):
                names[places[axis]] += f" [{unit}]"
    if "target" in places and "pose" not in places:
        names[places["target"]] = "pose"
    return [
        _join_cells(names)
        if k == header
        else f"# {comment}"
        if (comment := _comment(line)) is not None
        else _join_cells(cells_of(line))
        for k, line in enumerate(lines)
    ]


def has_no_names(file: SomeFile) -> bool:
    """Return whether every line has two or more numbers alone, or three or more with texts in the same places."""
    lines = [cells_of(line) for line in file.first_lines[:-1] or file.first_lines if line.strip()]
    first, *_ = lines = [cells for cells in lines if not cells[0].startswith(_MARKS)] or [[]]
    places = [_is_number(cell) for cell in first]
    counted = [cell for cell in first if _is_number(cell)]
    are_names = counted == [str(k + 1) for k in range(len(counted))]
    enough = len(places) > 1 and sum(places) >= min(len(places), 3) and not are_names
    return enough and all([_is_number(cell) for cell in cells] == places for cells in lines[:_SEEN])


def has_no_known_names(file: SomeFile) -> bool:
    """Return whether such lines have blanks between cells, or texts, so that no other reader takes them."""
    row = _first_row(file.first_lines)
    if row is None or not has_no_names(file):
        return False
    line = file.first_lines[row]
    return not re.search("[,;\t]", line) or not all(map(_is_number, cells_of(line)))


def is_separated_by_blanks(file: SomeFile) -> bool:
    """Return whether blanks separate a line of names, and the numbers below; rows may begin with a name."""
    k = _first_row(file.first_lines)
    rows = (
        [] if k is None else [line for line in file.first_lines[k:-1] or file.first_lines[k:] if line.strip()][:_SEEN]
    )
    if len(rows) < 2 or any(re.search("[,;\t]", row) for row in rows):
        return False
    names, *table = [row.split() for row in rows]
    whole = all(len(cells) == len(names) and _numbers(cells) >= max(len(cells) - 1, 2) for cells in table)
    return whole and not _numbers(names)


def blank_lines(file: SomeFile) -> list[str]:
    """Return the lines with commas between their cells."""
    return [line if _comment(line) is not None else ",".join(line.split()) for line in file.lines]


def numbered_lines(file: SomeFile) -> list[str]:
    """Return the lines below a header of numbers from 1."""
    rows = [line for line in file.lines if line.strip() and _comment(line) is None]
    width = len(cells_of(rows[0])) if rows else 0
    return [_join_cells([str(k + 1) for k in range(width)]), *(_join_cells(cells_of(row)) for row in rows)]


def find_axes(file: SomeFile) -> int | None:
    """Return the index of the line of X, Y, Z (or RX, RY, RZ, TX, TY, TZ) below a line of names; None without one."""
    lines = [cells_of(line) for line in file.first_lines[:_SEEN]]
    for k in range(1, len(lines)):
        letters, above = [_letter(cell) for cell in lines[k]], lines[k - 1]
        starts = {j for j in range(len(letters) - 2) if letters[j : j + 3] in _TRIPLES}
        named = {j for j, (cell, letter) in enumerate(zip(above, letters, strict=False)) if cell and letter}
        first = {j for j in starts if letters[j] != "tx" or j - 3 not in starts}  # after the angles of the same name
        if first and first == named:
            return k
    return None


def _letter(cell: str) -> str:
    """An axis without the number of its marker: X12 is x."""
    return re.sub(r"(?<=^[xyz])\d+$", "", cell.casefold())


def named_above_lines(file: SomeFile, k: int) -> list[str]:
    """Return the lines with one header in place of names, letters (line k) and units.

    Raises:
        DataError: A second table follows.
    """
    lines = file.lines
    for j in range(k + 1, len(lines)):
        if lines[j][:1].isalpha() and any(axis in map(_letter, cells_of(lines[j])) for axis in ("x", "tx")):
            raise DataError(f"{file.path}, line {j + 1}: a second table begins; keep one of them in the file")
    letters, above = cells_of(lines[k]), cells_of(lines[k - 1])
    units = cells_of(lines[k + 1]) if k + 1 < len(lines) else []
    has_units = bool(units) and not _numbers(units) and any(units)
    header, name = [], ""
    for j, letter in enumerate(letters):
        name = above[j].rpartition(":")[2] if j < len(above) and above[j] else name
        axis = _letter(letter).removeprefix("t")
        measured = any(axis in triple for triple in _TRIPLES) and name
        unit = f" [{units[j]}]" if has_units and j < len(units) and units[j] else ""
        header.append((f"{name}_{axis}" if measured else letter or name or f"column_{j + 1}") + unit)
    return _with_header(lines, k + 1 + has_units, header)


def _with_header(lines: Sequence[str], first: int, header: Sequence[str]) -> list[str]:
    """Lines with rows from `first` on; lines above become comments, the last of them the header.

    A row may end in separators that the header lacks. One with too few or too many numbers stays: the reader names it.
    """
    width, rows = len(header), list[str]()
    for line in lines[first:]:
        cells = cells_of(line)
        cells = cells if any(cells[width:]) else cells[:width]
        is_row = _numbers(cells) >= (1 if len(cells) == width else 2)
        rows.append(_join_cells(cells) if is_row else f"# {line}" if line.strip() else "")
    return [*(f"# {line}" for line in lines[: first - 1]), _join_cells(header), *rows]


def motive_lines(file: SomeFile) -> list[str]:
    """Return the lines of an export of Motive with one header: NAME_x [mm], NAME_qx, ...

    Raises:
        DataError: Rows of names and of measured quantities are missing, or there are angles in place of quaternions.
    """
    lines = file.lines
    first = cells_of(lines[0])
    settings = dict(zip(first[::2], first[1::2], strict=False))
    word = settings.get("Length Units", "").casefold()
    unit = f" [{_UNITS.get(word, word)}]" if word else ""
    rows = {cells[1]: cells for cells in map(cells_of, lines[:12]) if len(cells) > 2 and cells[1] in ("Name", "Type")}
    k = next((k for k, line in enumerate(lines[:14]) if cells_of(line)[:1] == ["Frame"]), None)
    unlabelled = [cells_of(line) for line in lines[1:k] if line.strip()]  # type, name, number, what is measured
    names = rows.get("Name", unlabelled[1] if len(unlabelled) == 4 else None)
    if k is None or names is None:
        raise DataError(f"{file.path}: an export of Motive without a row 'Name' above 'Frame'; export it with headers")
    if settings.get("Rotation Type", "Quaternion") != "Quaternion" and "Rotation" in cells_of(lines[k - 1]):
        raise DataError(f"{file.path}: rotations as {settings['Rotation Type']}; export them from Motive as Quaternion")
    kinds, letters = cells_of(lines[k - 1]), cells_of(lines[k])
    header = []
    for j, letter in enumerate(letters):
        name = names[j].replace(":", "_") if j < len(names) else ""
        kind = kinds[j] if j < len(kinds) else ""
        if kind == "Rotation":
            header.append(f"{name}_q{letter.casefold()}")
        elif kind == "Position":
            header.append(f"{name}_{letter.casefold()}{unit}")
        else:
            header.append("time" if letter.startswith("Time") else f"{name} {kind} {letter}".strip())
    return _with_header(
        lines, k + 1, [name if header.count(name) == 1 else f"{name} {j}" for j, name in enumerate(header)]
    )


def find_expanded_uncertainty(file: SomeFile) -> tuple[int, list[str]] | None:
    """Return line and cells of the header that has U95; None if there is none."""
    headers = ((k, cells_of(line)) for k, line in enumerate(file.first_lines[:_SEEN]))
    return next(((k, cells) for k, cells in headers if len(cells) > 3 and any(map(_U95.fullmatch, cells))), None)


def expanded_uncertainty_lines(file: SomeFile, known: tuple[int, list[str]]) -> list[str]:
    """Return the lines with U95 of each axis; a point's U95 is used for each coordinate.

    Raises:
        DataError: A row with numbers has more or fewer cells than the header.
    """
    header, names = known
    columns, points = [[name] for name in names], 0
    for column, name in zip(columns, names, strict=True):
        m = _U95.fullmatch(name)
        points += bool(m and not m[1])
        if m and (m[1] or points == 1):  # of several U95 of a point, the first counts
            column[:] = [f"U95 {axis.upper()}" + (f" [{m[2]}]" if m[2] else "") for axis in m[1] or "XYZ"]
    table = []
    for k, line in enumerate(file.lines):
        cells = cells_of(line)
        if k == header:
            table.append(_join_cells([name for column in columns for name in column]))
        elif k > header and len(cells) == len(names):
            table.append(_join_cells([cell for cell, column in zip(cells, columns, strict=True) for _ in column]))
        elif k > header and _comment(line) is None and _numbers(cells) > 1:
            raise DataError(f"{file.path}, line {k + 1}: {len(cells)} cells for {len(names)} columns")
        else:
            table.append(line if _comment(line) is not None or not line.strip() else f"# {line}")
    return table


_MEASURED = r"(?:meas(?:ured)?|actual|act)\.?"
_VALUE = re.compile(rf"{_MEASURED}(?: value)?(?:\s*[\[(](?P<unit>\w+)[\])])?", re.IGNORECASE)
_COORDINATE = re.compile(
    rf"(?:{_MEASURED}[ _]?(?P<a>[xyz])|(?P<b>[xyz])[ _]?{_MEASURED})(?:\s*[\[(](?P<unit>\w+)[\])])?", re.IGNORECASE
)
_NAMES = ("name", "object name", "object", "point", "point name", "feature", "feature name", "element", "label", "id")


@dataclass(frozen=True)
class ReportLayout:
    """The columns of a report.

    Attributes:
        header: Index of the header line.
        name: Column of names.
        values: Columns of X, Y, Z; or the single column of measured values.
        control: Column of the axis letters if X, Y, Z are in separate rows; else None.
        unit: Unit in the header, or None.
    """

    header: int
    name: int
    values: tuple[int, ...]
    control: int | None
    unit: str | None


def find_layout(file: SomeFile) -> ReportLayout | None:
    """Return the columns of a file with measured coordinates; None for another file."""
    lines = [cells_of(line) for line in file.first_lines[:_SEEN]]
    for k, cells in enumerate(lines):
        folded = [cell.casefold() for cell in cells]
        name = next((j for j, cell in enumerate(folded) if cell in _NAMES), None)
        if name is None:
            continue
        matches = [(j, m) for j, cell in enumerate(cells) if (m := _COORDINATE.fullmatch(cell))]
        found = {(m["a"] or m["b"]).casefold(): (j, m["unit"]) for j, m in matches}
        if len(found) == 3:
            return ReportLayout(k, name, tuple(found[axis][0] for axis in "xyz"), None, found["z"][1])
        value = next(((j, m["unit"]) for j, c in enumerate(cells) if (m := _VALUE.fullmatch(c))), None)
        below = [row for row in lines[k + 1 :] if len(row) == len(cells)]
        control = next((j for j in range(len(cells)) if {"X", "Y", "Z"} <= {row[j].upper() for row in below}), None)
        if value is not None and control is not None:
            return ReportLayout(k, name, (value[0],), control, value[1])
    return None


def report_lines(file: SomeFile, layout: ReportLayout) -> list[str]:
    """Return a header and a row for each point.

    Raises:
        DataError: A point does not have exactly one X, Y and Z, or a number has marks between thousands.
    """
    unit = layout.unit or _unit_above(file.lines[: layout.header + 2])
    headers, points = cells_of(file.lines[layout.header]), dict[str, dict[str, str]]()
    name = ""
    for k, line in enumerate(file.lines[layout.header + 1 :], layout.header + 2):
        cells = cells_of(line)
        if len(cells) <= max(layout.name, *layout.values, layout.control or 0):
            continue
        name = cells[layout.name] or name
        axes: Sequence[str] = "XYZ" if layout.control is None else [cells[layout.control].upper()]
        for axis, column in zip(axes, layout.values, strict=True):
            if axis in ("X", "Y", "Z") and re.search(r"\d", cells[column]):
                read_number(cells[column], f"{file.path}, line {k}, column '{headers[column]}'", ";")
                if axis in points.setdefault(name, {}):
                    raise DataError(f"{file.path}, line {k}: point '{name}' has {axis} twice; give each its own name")
                points[name][axis] = cells[column]
    for short in (name for name, axes in points.items() if len(axes) < 3):
        raise DataError(f"{file.path}: point '{short}' lacks a measured X, Y or Z; export all three")
    if not points:
        raise DataError(f"{file.path}: has no measured points below its header")
    suffix = f" [{unit}]" if unit else ""
    header = _join_cells(["pose", *(f"{axis}{suffix}" for axis in "XYZ")])
    return [header, *(_join_cells([name, *(axes[axis] for axis in "XYZ")]) for name, axes in points.items())]
