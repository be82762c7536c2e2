"""What a result folder says about the readings of its fit: `residuals.csv`, with what `result.json` knows of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calib import Robot
from calib.core.base.arrays import FloatArray, IntArray
from calib.core.base.errors import DataError
from calib.core.base.units import error_scale
from calib.core.data.measurements import Poses, in_setups, measurements
from calib.core.data.tables import Table, read_table
from calib.core.fitting.error_sets import STATES, ErrorSet
from calib.core.instruments.kind import Instrument, Readings
from calib.core.results.result_reading import read_result
from viz.poses import EXCLUDED, IDENTIFICATION


@dataclass(frozen=True, eq=False)
class Saved:
    """The readings of a result folder.

    Attributes:
        sets: Readings and errors of each set, by its name, which is the path of the measurements, too.
        sigmas: Noise of one reading of each instrument that measures points, per axis, by its name [m].
        outliers: Numbers of the readings of each set that are outliers, by instrument.
    """

    sets: Mapping[str, ErrorSet]
    sigmas: Mapping[str, float]
    outliers: Mapping[str, Mapping[str, IntArray]]


def read_saved(folder: Path | str, robot: Robot) -> Saved:
    """Return the readings that a result folder holds.

    Args:
        folder: The folder.
        robot: The robot that it is of.

    Raises:
        DataError: A file is missing, broken, or belongs to another robot.
    """
    path = Path(folder) / "residuals.csv"
    table, content = read_table(path), read_result(folder)
    for name in ("set", "pose", "target"):
        if name not in table.names:
            raise DataError(f"{path}: no column '{name}'; run the fit again")
    known = [instrument.name for instrument in robot.instruments]
    stranger = next((name for name in table.text("target") if name not in known), None)
    if stranger is not None:
        raise DataError(f"{path}: no instrument of {robot.path} is called '{stranger}'; run the fit again")
    groups = np.array(table.text("set"))
    if IDENTIFICATION not in groups:
        raise DataError(f"{path}: has no rows of the set '{IDENTIFICATION}'; run the fit again")
    sets = {str(group): _error_set(robot, table, np.flatnonzero(groups == group)) for group in dict.fromkeys(groups)}
    marked = groups == EXCLUDED
    marked[[row["row"] - 1 for row in content["outliers"] if row.get("row", len(groups) + 1) <= len(groups)]] = True
    targets = np.array(table.text("target"))
    outliers = {
        group: {name: np.flatnonzero(marked[(groups == group) & (targets == name)]) for name in errors.data.readings}
        for group, errors in sets.items()
    }
    return Saved(sets, _sigmas(robot, content), outliers)


def _sigmas(robot: Robot, content: dict[str, Any]) -> dict[str, float]:
    positions = {
        (instrument.name, part.name)
        for instrument in robot.instruments
        for part in instrument.parts
        if part.is_position
    }
    return {
        block["name"]: part["sigma"] / error_scale("length")
        for block in content.get("instruments", ())
        for part in block["parts"]
        if (block["name"], part["name"]) in positions and part["sigma"] is not None
    }


def _error_set(robot: Robot, table: Table, rows: IntArray) -> ErrorSet:
    """The readings in these rows of the file, with their errors."""
    joints = [table.column(name, robot.mechanism.dimensions[name])[rows] for name in robot.joint_names]
    labels, targets = ([table.text(name)[row] for row in rows] for name in ("pose", "target"))
    cells = [(label, *values) for label, *values in zip(labels, *joints, strict=True)]
    points = {instrument.name for instrument in robot.instruments if any(part.is_position for part in instrument.parts)}
    visits = _visits(cells, targets, points)
    first = np.unique(visits, return_index=True)[1]
    names = tuple(labels[row] for row in first)
    group = table.text("set")[rows[0]]
    poses = Poses(np.stack(joints, axis=1)[first], tuple(f"pose {name}" for name in names), names, group, ())
    readings: dict[str, Readings] = {}
    errors: dict[str, dict[str, FloatArray]] = {state: {} for state in STATES}
    for instrument in robot.instruments:
        of_instrument = np.flatnonzero(np.array(targets) == instrument.name)
        if len(of_instrument):
            readings[instrument.name] = _readings(robot, instrument, table, rows[of_instrument], visits[of_instrument])
            for state in STATES:
                errors[state][instrument.name] = _errors(instrument, table, rows[of_instrument], state)
    data = measurements(poses, readings)
    return ErrorSet(data, robot.instruments, errors["before"], errors["after"], np.full(len(first), np.nan))


def _visits(cells: list[tuple[object, ...]], targets: list[str], points: set[str]) -> IntArray:
    """A number for each row: rows of one visit follow each other, have the same cells, and none of `points` twice."""
    numbers: list[int] = []
    seen: set[str] = set()
    for k, (cell, target) in enumerate(zip(cells, targets, strict=True)):
        new = k == 0 or cell != cells[k - 1] or target in seen
        numbers.append(numbers[-1] + new if numbers else 0)
        seen = (set() if new else seen) | ({target} & points)
    return np.array(numbers, dtype=np.intp)


def _readings(robot: Robot, instrument: Instrument, table: Table, rows: IntArray, visits: IntArray) -> Readings:
    columns = {
        column.name: table.column(
            f"measured_{column.name.removeprefix(f'{instrument.name}_')}", column.dimension, gaps=True
        )
        for column in instrument.columns()
    }
    values = instrument.values({name: numbers[rows] for name, numbers in columns.items()})
    values = np.broadcast_to(values, (len(rows), values.shape[1]))  # a touch has none
    words = {name: [table.text(f"looked_at_{name}")[row] for row in rows] for name in instrument.text_columns()}
    _, pairs, details = instrument.looked_at(words, [f"{table.path}, row {row + 1}" for row in rows])
    setups = list(robot.description.setups)
    if setups and "setup" in table.names:
        named = table.text("setup")
        stranger = next((named[row] for row in rows if named[row] not in setups), None)
        if stranger is not None:
            raise DataError(f"{table.path}: no setup of {robot.path} is called '{stranger}'; run the fit again")
        pairs = pairs + in_setups(
            robot, instrument, np.array([setups.index(named[row]) for row in rows], dtype=np.intp)
        )
    return Readings(visits, pairs, values, None, details)


def _errors(instrument: Instrument, table: Table, rows: IntArray, state: str) -> FloatArray:
    return np.stack(
        [
            table.column(f"error_{state}_{axis}", part.dimension, gaps=True)[rows]
            for part in instrument.parts
            for axis in part.axes
        ],
        axis=1,
    )
