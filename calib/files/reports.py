"""Reports of measured and nominal values, as PolyWorks, FARO's CAM2 and others write them.

Two layouts: a row for each coordinate of a point (`Name; Control; Nom; Meas; Dev`), or columns for each coordinate
(`Name; Nominal X; Measured X; ...`). Both become a row for each point: pose, X, Y, Z.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from calib.core.base.errors import DataError
from calib.core.data.other_formats import SomeFile
from calib.files.text import SEEN, cells_of, is_number, unit_above

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
    lines = [cells_of(line) for line in file.first_lines[:SEEN]]
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
        DataError: A point does not have exactly one X, Y and Z.
    """
    unit = layout.unit or unit_above(file.lines[: layout.header + 2])
    points: dict[str, dict[str, str]] = {}
    name = ""
    for k, line in enumerate(file.lines[layout.header + 1 :], layout.header + 2):
        cells = cells_of(line)
        if len(cells) <= max(layout.name, *layout.values, layout.control or 0):
            continue
        name = cells[layout.name] or name
        axes: Sequence[str] = "XYZ" if layout.control is None else [cells[layout.control].upper()]
        for axis, column in zip(axes, layout.values, strict=True):
            if axis in ("X", "Y", "Z") and is_number(cells[column]):
                if axis in points.setdefault(name, {}):
                    raise DataError(f"{file.path}, line {k}: point '{name}' has {axis} twice; give each its own name")
                points[name][axis] = cells[column]
    for short in (name for name, axes in points.items() if len(axes) < 3):
        raise DataError(f"{file.path}: point '{short}' lacks a measured X, Y or Z; export all three")
    if not points:
        raise DataError(f"{file.path}: has no measured points below its header")
    suffix = f" [{unit}]" if unit else ""
    header = ";".join(["pose", *(f"{axis}{suffix}" for axis in "XYZ")])
    return [header, *(";".join([name, *(axes[axis] for axis in "XYZ")]) for name, axes in points.items())]
