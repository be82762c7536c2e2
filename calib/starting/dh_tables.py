"""Robots from Denavit-Hartenberg tables in CSV files (`calib.shared.denavit_hartenberg`).

One row for each joint, in the order of the chain: `joint`, `type` (revolute, prismatic or fixed), `theta`, `d`, `a`,
`alpha` and, where it is needed, `beta`, with units in the header; `offset` (added to theta or d), `sign` (1 or -1),
`lower`, `upper`. Cells of `offset`, `lower` and `upper` may carry their own unit, such as `250 mm`, because they are
lengths in one row and angles in another. A comment `# convention: standard` or `# convention: modified` says which
convention the rows follow, because nothing else in a table does.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import pinocchio as pin

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import DataError, nearest, require_known
from calib.core.base.units import DISPLAY_UNIT, Dimension, check_plausible, per_si, quantity
from calib.core.data.tables import Table, read_number, read_table
from calib.core.robots.urdf.reader import Triple
from calib.core.robots.urdf.writing import joint_text, robot_text
from calib.shared.denavit_hartenberg import (
    CONVENTION_MARK,
    CONVENTIONS,
    KINDS,
    NUMBERS,
    Convention,
    DhRow,
    DhTable,
    Kind,
    new_name,
    x_transform,
    z_transform,
)

_NEEDED = ("theta", "d", "a", "alpha")
_COLUMNS = ("joint", "type", *NUMBERS, "offset", "sign", "lower", "upper")
_SHORT: Mapping[str, Kind] = {"r": "revolute", "p": "prismatic", "f": "fixed"}
_FAR_AWAY = 5.0  # distance of an origin, along the joint's axis, from the joint before it [m]
_BASE_LINK, LAST_LINK = "base_link", "flange"


def urdf_of_table(path: Path | str, convention: str | None = None) -> str:
    """Return the URDF of a table (`read_dh`): links `base_link`, `link_1`, ..., `flange`, and a joint for each row."""
    return _urdf_text(read_dh(path, convention), Path(path).stem)


def read_dh(path: Path | str, convention: str | None = None) -> DhTable:
    """Read a table; `convention` is needed if the file does not say it.

    A `DataError` names line and column of what is missing or wrong.
    """
    table = read_table(path)
    for name in table.names:
        require_known(name, _COLUMNS, f"{path}: unknown column", DataError)
    for name in _NEEDED:
        if name not in table.names:
            raise DataError(
                f"{path}: no column '{name}'; a Denavit-Hartenberg table has {', '.join(_NEEDED)}, with units"
            )
    meant = _convention(table, convention)
    rows = _rows(table)
    names = [row.name for row in rows]
    again = next((k for k, name in enumerate(names) if name in names[:k]), None)
    if again is not None:
        raise DataError(
            f"{path}, line {table.lines[again]}: joint '{names[again]}' appears twice; names must be unique"
        )
    if all(row.kind == "fixed" for row in rows):
        raise DataError(f"{path}: every row is fixed; there is no joint that moves")
    return DhTable(meant, rows)


def _convention(table: Table, given: str | None) -> Convention:
    marked = [text.removeprefix(CONVENTION_MARK).strip() for text in table.comments if text.startswith(CONVENTION_MARK)]
    for word in [*marked, *([given] if given else [])]:
        require_known(word, CONVENTIONS, f"{table.path}: unknown convention", DataError)
        if given and word != given:
            raise DataError(
                f"{table.path}: says 'convention: {word}', but --convention is {given}; correct one of them"
            )
    stated = given or (marked[0] if marked else "")
    for convention in CONVENTIONS:
        if convention == stated:
            return convention
    raise DataError(
        f"{table.path}: nothing says which convention it follows; add --convention standard (Denavit and Hartenberg,"
        " Paul), --convention modified (Craig, Khalil), or a line '# convention: ...'"
    )


def _rows(table: Table) -> tuple[DhRow, ...]:
    given = {
        name: table.column(name, dimension, gaps=True) for name, dimension in NUMBERS.items() if name in table.names
    }
    rows = []
    for k in range(len(table.rows)):
        kind = _kind(table, k)
        variable = {"revolute": "theta", "prismatic": "d", "fixed": ""}[kind]
        values = {}
        for name, column in given.items():
            if math.isnan(column[k]) and name not in (variable, "beta"):
                raise DataError(
                    f"{table.where(k, name)}: is empty; fill it in, with 0 if there is no such length or angle"
                )
            values[name] = 0.0 if math.isnan(column[k]) else float(column[k])
        dimension = NUMBERS[variable] if variable else None
        offset, lower, upper = (_cell(table, name, k, dimension) for name in ("offset", "lower", "upper"))
        if variable and offset is not None:
            values[variable] += offset
        if (lower is None) != (upper is None) or (lower is not None and upper is not None and lower >= upper):
            raise DataError(f"{table.where(k)}: the limits need a lower and a larger upper value")
        if kind == "prismatic" and lower is None:
            raise DataError(
                f"{table.where(k)}: a prismatic joint needs limits, without which no URDF is valid; add"
                " columns lower and upper, such as '0 mm' and '250 mm'"
            )
        limits = {} if lower is None or upper is None else {"lower": lower, "upper": upper}
        rows.append(DhRow(_text(table, "joint", k, f"joint_{k + 1}"), kind, **values, sign=_sign(table, k), **limits))
    return tuple(rows)


def _text(table: Table, name: str, k: int, default: str) -> str:
    """A cell as text; the default where there is no such column."""
    if name not in table.names:
        return default
    text = table.text(name)[k]
    if not text:
        raise DataError(f"{table.where(k, name)}: is empty; fill it in")
    return text


def _kind(table: Table, k: int) -> Kind:
    text = _text(table, "type", k, "revolute").lower()
    for kind in KINDS:
        if _SHORT.get(text, text) == kind:
            return kind
    raise DataError(f"{table.where(k)}: unknown type '{text}'{nearest(text, KINDS)}")


def _sign(table: Table, k: int) -> float:
    text = _text(table, "sign", k, "1")
    if text not in ("1", "+1", "-1", "1.0", "-1.0"):
        raise DataError(f"{table.where(k)}: sign '{text}'; must be 1 or -1")
    return float(text)


def _cell(table: Table, name: str, k: int, dimension: Dimension | None) -> float | None:
    """A number with the unit of its cell or else of its column, in SI; None if there is none."""
    if name not in table.names or not table.text(name)[k]:
        return None
    text, where = table.text(name)[k], table.where(k, name)
    if dimension is None:
        raise DataError(f"{where}: the row is fixed and has no {name}; leave the cell empty")
    if text[-1].isalpha():
        return quantity(text, dimension, where, DataError)
    unit = table.units[table.names.index(name)]
    number = read_number(text, where, table.separator)
    if unit is None:
        check_plausible(number, dimension, where, f"after the number, such as '{text} {DISPLAY_UNIT[dimension]}'")
    return number / per_si(unit, dimension, where, DataError)


def _urdf_text(table: DhTable, name: str) -> str:
    joints: list[str] = []
    links = [_BASE_LINK]
    rest = pin.SE3.Identity()
    last_moves = table.rows[-1].kind != "fixed"
    for k, row in enumerate(table.rows, start=1):
        origin, rest = _origin(table.convention, rest, row)
        if row.kind == "revolute":
            origin, rest = _slide_origin(origin, rest)
        links.append(LAST_LINK if k == len(table.rows) and not last_moves else f"link_{k}")
        joints.append(_joint(row, links[-2], links[-1], origin))
    if last_moves:
        links.append(LAST_LINK)
        taken = [row.name for row in table.rows]
        joints.append(_joint(DhRow(new_name(f"{LAST_LINK}_joint", taken), "fixed"), links[-2], LAST_LINK, rest))
    note = f"From a Denavit-Hartenberg table ({table.convention}); effort and velocity are 0: the table has none."
    return robot_text(name, note, links, joints)


def _origin(convention: Convention, rest: pin.SE3, row: DhRow) -> tuple[pin.SE3, pin.SE3]:
    """The URDF origin of a row's joint, and the transform that remains for the next row."""
    along_z, along_x = z_transform(row.theta, row.d), x_transform(row.a, row.alpha, row.beta)
    if convention == "modified":
        return rest * along_x * along_z, pin.SE3.Identity()
    return (rest * along_z * along_x, pin.SE3.Identity()) if row.kind == "fixed" else (rest * along_z, along_x)


def _slide_origin(origin: pin.SE3, rest: pin.SE3) -> tuple[pin.SE3, pin.SE3]:
    """The origin of a revolute joint; a far origin is moved along the axis to the height of the joint before.

    In tables with nearly parallel axes (calibrated robots of Universal Robots) d is hundreds of metres in one row, and
    as much back in the next. An origin may be anywhere on its axis: the next row moves back, and no pose changes.
    """
    away = float(origin.translation @ origin.rotation[:, 2])
    if abs(away) < _FAR_AWAY:
        return origin, rest
    return origin * z_transform(0.0, -away), z_transform(0.0, away) * rest


def _joint(row: DhRow, parent: str, child: str, origin: pin.SE3) -> str:
    limits = (row.lower, row.upper) if math.isfinite(row.lower) and math.isfinite(row.upper) else None
    kind = "continuous" if row.kind == "revolute" and not limits else row.kind
    xyz, rpy = (_triple(v) for v in (origin.translation, pin.rpy.matrixToRpy(origin.rotation)))
    axis = "" if row.kind == "fixed" else f"0 0 {row.sign:.0f}"
    return joint_text(row.name, kind, (parent, child), xyz, rpy, axis, limits)


def _triple(values: FloatArray) -> Triple:
    return float(values[0]), float(values[1]), float(values[2])
