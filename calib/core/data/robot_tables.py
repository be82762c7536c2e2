"""Tables of a robot whose columns other programs have named: `J1 (deg)` ... `J6 (deg)`, `X (mm)`, `Y (mm)`, `Z (mm)`.

Columns are taken for joints where no joint has a column of its name, and each joint has one with the same letters and
figures (`Joint 1` for `joint_1`), or all are numbered from 1. Columns X, Y, Z are the position that is read, where one
instrument reads positions and has no columns; so are NAME_x, NAME_y, NAME_z of the only NAME. U95 X, U95 Y, U95 Z
next to them are twice the standard deviations of a reading. A column needs its unit for that, because it is not known
whether a robot's program writes degrees. What is guessed is logged as a warning (logger `calib`). A description may
name the columns of files under `columns`; then nothing is guessed.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

from calib.core.base.errors import DataError, nearest
from calib.core.base.units import DISPLAY_UNIT, PER_SI, MappedColumn
from calib.core.base.words import warn_once
from calib.core.data.tables import Source, Table, read_table
from calib.core.robots.robot import Robot

_NUMBERED = re.compile(r"(?:j|a|q|ax|axis|joint|theta|motor)0*(\d+)")
_AXES = ("x", "y", "z")
_NAMED = re.compile(r"(.+)_[xyz]")
_U95 = re.compile(r"U95 ([XYZ])")
_UNITS = (*PER_SI["length"], *PER_SI["angle"])
_UNIT_WRITTEN = re.compile(rf"(?P<name>.*[^\s_])(?:\s*\((?P<unit>[^()]+)\)|[\s_]+(?P<ending>{'|'.join(_UNITS)}))")


def read_robot_table(source: Source, robot: Robot, *, growing: Sequence[str] | None = None) -> Table:
    """Read a table as `calib.core.data.tables.read_table` does, its columns called as the robot's.

    `DataError` also if a guessed column has no readable unit, or blanks separate the columns.
    """
    table = read_table(source, robot.description.columns, growing=growing)
    if len(table.names) == 1 and table.names[0] not in robot.joint_names and len(table.rows[0][0].split()) > 1:
        raise DataError(f"{table.path}: blanks separate the columns; write commas, semicolons or tabs between them")
    _check_units(robot, table)
    joints = _joints(robot, table)
    guessed = joints | _positions(robot, table, {*joints, *robot.joint_names})
    spread = _deviation_columns(robot, table, guessed)
    guessed |= spread
    if not guessed:
        return table
    bare = next((name for name in guessed if name not in spread and table.units[table.names.index(name)] is None), None)
    if bare is not None:
        unit = DISPLAY_UNIT[robot.mechanism.dimensions[guessed[bare]]]
        raise DataError(
            f"{table.path}, column '{bare}': looks like '{guessed[bare]}', but has no unit; write it into the header,"
            f" such as '{bare} [{unit}]', or call the column '{guessed[bare]}'"
        )
    text = ", ".join(f"{name} for {meant}" for name, meant in guessed.items())
    warn_once(f"{table.path}: took columns {text}; `columns` in the robot description says what they really are")
    halved = {guessed[name]: MappedColumn(guessed[name], None, factor=0.5) for name in spread}
    return replace(
        table,
        names=tuple(guessed.get(name, name) for name in table.names),
        maps={**table.maps, **halved},
        headers={**table.headers, **{meant: table.header(name) for name, meant in guessed.items()}},
    )


def _deviation_columns(robot: Robot, table: Table, guessed: Mapping[str, str]) -> dict[str, str]:
    """Columns U95 of X, Y and Z, and the standard deviations that their halves are; none where one is missing."""
    instrument, columns = _coordinates(robot)
    found = {name: match[1].lower() for name in table.names if (match := _U95.fullmatch(name))}
    if sorted(found.values()) != list(_AXES) or not columns or not set(columns) <= {*table.names, *guessed.values()}:
        return {}
    return {name: f"{instrument}_std_{axis}" for name, axis in found.items()}


def _coordinates(robot: Robot) -> tuple[str, list[str]]:
    """The only instrument that reads positions, and its columns; none if there are several or none."""
    reading = [instrument for instrument in robot.instruments if instrument.reads_positions]
    return (reading[0].name, [column.name for column in reading[0].columns()]) if len(reading) == 1 else ("", [])


def _check_units(robot: Robot, table: Table) -> None:
    """Raise `DataError` if only the spelling of units keeps columns from being those of the joints."""
    odd = _odd_units(table)
    split = [odd.get(name, (name, unit)) for name, unit in zip(table.names, table.units, strict=True)]
    names, units = tuple(name for name, _ in split), tuple(unit for _, unit in split)
    if not odd or set(robot.joint_names) & set(table.names) or len(set(names)) < len(names):
        return
    meant = {*_joints(robot, replace(table, names=names, units=units)), *robot.joint_names}
    hint = next((_hint(name, *written) for name, written in odd.items() if written[0] in meant), None)
    if hint is not None:
        raise DataError(f"{table.path}, {hint}")


def odd_unit(table: Table, column: str) -> str | None:
    """Return advice on a column that would be the one of this name, or coordinate, if its unit were readable."""
    same = {_plain(column), column.rpartition("_")[2]}
    return next((_hint(name, *odd) for name, odd in _odd_units(table).items() if _plain(odd[0]) in same), None)


def _odd_units(table: Table) -> dict[str, tuple[str, str]]:
    """Columns without a unit whose names may end in one: the name before it, and the unit."""
    bare = [name for name, unit in zip(table.names, table.units, strict=True) if unit is None]
    matches = {name: match for name in bare if (match := _UNIT_WRITTEN.fullmatch(name))}
    return {name: (match["name"], match["unit"] or match["ending"]) for name, match in matches.items()}


def _hint(column: str, name: str, unit: str) -> str:
    if unit not in _UNITS:
        return f"column '{column}': unknown unit '{unit}'{nearest(unit, _UNITS)}"
    return f"column '{column}': write its unit in brackets: '{name} [{unit}]'"


def _plain(name: str) -> str:
    return re.sub(r"[\W_]", "", name.casefold())


def _joints(robot: Robot, table: Table) -> dict[str, str]:
    """Joints by the columns that stand for them; none if a column has a joint's name, or if a joint has no column."""
    joints = robot.joint_names
    if set(joints) & set(table.names):
        return {}
    same = {name: joint for joint in joints for name in table.names if _plain(name) == _plain(joint)}
    if sorted(same.values()) == sorted(joints):
        return same
    numbers = {name: int(match.group(1)) for name in table.names if (match := _NUMBERED.fullmatch(_plain(name)))}
    counted = list(range(1, len(joints) + 1))
    if sorted(numbers.values()) != counted:
        return {}
    in_names = [int(end.group(1)) for joint in joints if (end := re.search(r"(\d+)\D*$", joint))]
    order = in_names if sorted(in_names) == counted else counted
    return {name: joints[order.index(number)] for name, number in numbers.items()}


def _positions(robot: Robot, table: Table, joints: set[str]) -> dict[str, str]:
    """Columns X, Y, Z, unless joints, and the coordinates that they stand for; none where their meaning is unclear."""
    units = {name: unit for name, unit in zip(table.names, table.units, strict=True) if name not in joints}
    axes = {name: _plain(name) for name in units if _plain(name) in _AXES and units[name]}
    _, columns = _coordinates(robot)
    if not axes:  # else take the axes of a single named body
        named = {match[1] for name in units if units[name] and (match := _NAMED.fullmatch(name))}
        whole = [name for name in named if all(f"{name}_{axis}" in units for axis in _AXES)]
        axes = {f"{whole[0]}_{axis}": axis for axis in _AXES} if len(whole) == 1 else {}
    if sorted(axes.values()) != list(_AXES) or not columns or set(columns) & set(table.names):
        return {}
    return {name: columns[_AXES.index(axis)] for name, axis in axes.items()}
