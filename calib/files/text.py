"""Tables of other programs, rewritten as lines of this program's tables, each line at its place in the file."""

from __future__ import annotations

import re
from collections.abc import Sequence

from calib.core.base.errors import DataError
from calib.core.data.other_formats import SomeFile

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
SEEN = 40
"""Number of lines in which a header is searched."""
_AXES = ["x", "y", "z"]
_TRIPLES = (_AXES, ["rx", "ry", "rz"], ["tx", "ty", "tz"])


def cells_of(line: str) -> list[str]:
    """Return the cells of a line, separated by tabs, semicolons, commas, or else blanks."""
    separator = next((mark for mark in "\t;," if mark in line), None)
    cells = line.split(separator) if separator else re.findall(r'"[^"]*"|\S+', line)
    return [cell.strip().strip('"') for cell in cells]


def is_number(cell: str) -> bool:
    """Return whether a cell is a number, with point or comma."""
    return bool(_NUMBER.fullmatch(cell))


def unit_above(lines: Sequence[str]) -> str | None:
    """Return the unit of length in the lines above a table, or None."""
    words = _UNITS | {f"units: {unit}": unit for unit in ("mm", "m")}
    return next((unit for line in lines for word, unit in words.items() if word in line.casefold()), None)


def _numbers(cells: Sequence[str]) -> int:
    return sum(bool(_NUMBER.fullmatch(cell)) for cell in cells)


def _join_cells(cells: Sequence[str]) -> str:
    """A line of a table, with semicolons if cells contain commas."""
    mark = ";" if any("," in cell for cell in cells) else ","
    return mark.join(cells)


def _comment(line: str) -> str | None:
    """Text of a comment; None if the line is no comment."""
    mark = next((mark for mark in _MARKS if line.lstrip().startswith(mark)), None)
    return None if mark is None else line.lstrip()[len(mark) :].strip()


def _first_row(lines: Sequence[str]) -> int | None:
    """Index of the first line that is neither a comment nor empty."""
    return next((k for k, line in enumerate(lines) if line.strip() and _comment(line) is None), None)


def _header_in_comment(file: SomeFile) -> tuple[int, list[str]] | None:
    """The comment with the names of the columns, and its cells."""
    lines = file.first_lines
    row = _first_row(lines)
    if row is None or not _numbers(cells_of(lines[row])) or len(cells_of(lines[row])) < 2:
        return None
    n = len(cells_of(lines[row]))
    if _numbers(cells_of(lines[row])) < n - 4:
        return None
    for k in range(row - 1, -1, -1):
        comment = _comment(lines[k])
        if not comment:
            continue
        cells = cells_of(comment)
        named = len(cells) >= 2 and not _numbers(cells) and n - 2 <= len(cells) <= n
        return (k, cells) if named and all(cells) and len(cells) > n / 2 else None
    return None


def has_header_in_comment(file: SomeFile) -> bool:
    """Return whether the last comment above the numbers names their columns."""
    return _header_in_comment(file) is not None


def commented_header_lines(file: SomeFile) -> list[str]:
    """Return the lines with that comment as header; columns without a name get their number."""
    lines, known = file.lines, _header_in_comment(file)
    assert known is not None  # else another format would have matched
    header, names = known
    width = len(cells_of(lines[_first_row(lines) or 0]))
    names = [*names, *(f"column_{k + 1}" for k in range(len(names), width))]
    places = {name.split(" [")[0].split(" (")[0].casefold(): k for k, name in enumerate(names)}
    unit = unit_above(lines[:header])
    if all(axis in places for axis in _AXES):
        z = re.search(r"[\[(](.+)[\])]$", names[places["z"]])
        unit = z[1] if z else unit
        for axis in _AXES:
            if unit and not re.search(r"[\[(]", names[places[axis]]):
                names[places[axis]] += f" [{unit}]"
    if "target" in places and "pose" not in places:
        names[places["target"]] = "pose"
    mark = ";" if any("," in c for line in lines[header:] if "," in line for c in cells_of(line)) else ","
    return [
        mark.join(names)
        if k == header
        else f"# {comment}"
        if (comment := _comment(line)) is not None
        else mark.join(cells_of(line))
        for k, line in enumerate(lines)
    ]


def has_no_names(file: SomeFile) -> bool:
    """Return whether every line has two or more numbers alone, or three or more with texts in the same places."""
    lines = [cells_of(line) for line in file.first_lines[:-1] or file.first_lines if line.strip()]
    lines = [cells for cells in lines if not cells[0].startswith(_MARKS)]
    places = [is_number(cell) for cell in lines[0]] if lines else []
    counted = [cell for cell in lines[0] if is_number(cell)] if lines else []
    are_names = counted == [str(k + 1) for k in range(len(counted))]
    enough = len(places) > 1 and sum(places) >= min(len(places), 3) and not are_names
    return enough and all([is_number(cell) for cell in cells] == places for cells in lines[:SEEN])


def has_no_known_names(file: SomeFile) -> bool:
    """Return whether such lines have blanks between cells, or texts, so that no other reader takes them."""
    row = _first_row(file.first_lines)
    if row is None or not has_no_names(file):
        return False
    line = file.first_lines[row]
    return not re.search("[,;\t]", line) or not all(map(is_number, cells_of(line)))


def _blank_header(file: SomeFile) -> int | None:
    """Index of the line of names above numbers, both separated by blanks; rows may begin with a name."""
    k = _first_row(file.first_lines)
    rows = [] if k is None else [line for line in file.first_lines[k:-1] or file.first_lines[k:] if line.strip()][:SEEN]
    if len(rows) < 2 or any(re.search("[,;\t]", row) for row in rows):
        return None
    names, *table = [row.split() for row in rows]
    whole = all(len(cells) == len(names) and _numbers(cells) >= max(len(cells) - 1, 2) for cells in table)
    return k if whole and not _numbers(names) else None


def is_parted_by_blanks(file: SomeFile) -> bool:
    """Return whether names and the numbers below are separated by blanks."""
    return _blank_header(file) is not None


def blank_lines(file: SomeFile) -> list[str]:
    """Return the lines with commas between their cells."""
    return [line if _comment(line) is not None else ",".join(line.split()) for line in file.lines]


def numbered_lines(file: SomeFile) -> list[str]:
    """Return the lines below a header of numbers from 1."""
    rows = [line for line in file.lines if line.strip() and _comment(line) is None]
    width = len(cells_of(rows[0])) if rows else 0
    return [",".join(str(k + 1) for k in range(width)), *(_join_cells(cells_of(row)) for row in rows)]


def _axes_line(file: SomeFile) -> int | None:
    """Index of the line of X, Y, Z (or RX, RY, RZ, TX, TY, TZ) below a line of names."""
    lines = [cells_of(line) for line in file.first_lines[:SEEN]]
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


def has_names_above(file: SomeFile) -> bool:
    """Return whether a line has names above the first letter of each X, Y, Z."""
    return _axes_line(file) is not None


def named_above_lines(file: SomeFile) -> list[str]:
    """Return the lines with one header in place of names, letters and units.

    Raises:
        DataError: A second table follows.
    """
    lines, k = file.lines, _axes_line(file)
    assert k is not None  # else another format would have matched
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
    """Lines with rows from `first` on; lines above become comments, the last of them the header."""
    width, rows = len(header), list[str]()
    for line in lines[first:]:
        cells = cells_of(line)
        whole = len(cells) == width and _numbers(cells) > 0
        rows.append(_join_cells(cells) if whole else f"# {line}" if line.strip() else "")
    return [*(f"# {line}" for line in lines[: first - 1]), ",".join(header), *rows]


def motive_lines(file: SomeFile) -> list[str]:
    """Return the lines of an export of Motive with one header: NAME_x [mm], NAME_qx, ...

    Raises:
        DataError: Rows of names and of measured quantities are missing, or there are angles in place of quaternions.
    """
    lines = file.lines
    first = cells_of(lines[0])
    settings = dict(zip(first[::2], first[1::2], strict=False))
    unit = _UNITS.get(settings.get("Length Units", "").casefold(), "m")
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
            header.append(f"{name}_{letter.casefold()} [{unit}]")
        else:
            header.append("time" if letter.startswith("Time") else f"{name} {kind} {letter}".strip())
    return _with_header(
        lines, k + 1, [name if header.count(name) == 1 else f"{name} {j}" for j, name in enumerate(header)]
    )


def _u95_header(file: SomeFile) -> tuple[int, list[str]] | None:
    for k, line in enumerate(file.first_lines[:SEEN]):
        cells = cells_of(line)
        if len(cells) > 3 and any(_U95.fullmatch(cell) for cell in cells):
            return k, cells
    return None


def has_expanded_uncertainty(file: SomeFile) -> bool:
    """Return whether a header has U95."""
    return _u95_header(file) is not None


def expanded_uncertainty_lines(file: SomeFile) -> list[str]:
    """Return the lines with U95 of each axis; a point's U95 is used for each coordinate."""
    lines, known = file.lines, _u95_header(file)
    assert known is not None  # else another format would have matched
    header, names = known
    single = next((j for j, name in enumerate(names) if (m := _U95.fullmatch(name)) and not m[1]), None)

    def spread(cells: list[str], texts: Sequence[str]) -> list[str]:
        return cells if single is None else [*cells[:single], *texts, *cells[single + 1 :]]

    written = [f"U95 {m[1].upper()}" + (f" [{m[2]}]" if m[2] else "") if (m := _U95.fullmatch(n)) else n for n in names]
    unit = f" [{m[2]}]" if single is not None and (m := _U95.fullmatch(names[single])) and m[2] else ""
    table = []
    for k, line in enumerate(lines):
        cells = cells_of(line)
        if k == header:
            table.append(_semicolons(spread(written, [f"U95 {axis}{unit}" for axis in "XYZ"])))
        elif k > header and len(cells) == len(names):
            table.append(_semicolons(spread(cells, [cells[single]] * 3 if single is not None else [])))
        else:
            table.append(line if _comment(line) is not None or not line.strip() else f"# {line}")
    return table


def _semicolons(cells: Sequence[str]) -> str:
    return ";".join(cells)
