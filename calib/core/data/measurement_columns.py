"""Visits and their readings as columns of tables, in mm and degrees: a header and a cell for each line.

A visit at which an instrument read several things (points of a camera) has a line for each of them, with the same joint
values. Cells without a value are empty text.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from calib.core.base.arrays import FloatArray, IntArray
from calib.core.base.errors import DataError
from calib.core.base.units import DISPLAY_UNIT, Dimension, in_unit
from calib.core.instruments.kind import Instrument, Readings
from calib.core.robots.robot import Robot
from calib.core.robots.terms.terms import condition_columns as dimensions_of_conditions

APPROACH = "approach_"
"""Start of the names of columns that say from which side a joint came."""


def pose_columns(robot: Robot, names: Sequence[str], joints: FloatArray) -> dict[str, list[object]]:
    """Return pose names and joint values (n, n_actuated) [m or rad]."""
    columns: dict[str, list[object]] = {"pose": list(names)}
    return columns | {head: cells_of(values) for head, values in joint_columns(robot, joints).items()}


def joint_columns(robot: Robot, q: FloatArray) -> dict[str, FloatArray]:
    """Return joint values q (n, n_actuated) [m or rad] in the unit of tables, (n,) by header."""
    dimensions = [robot.mechanism.dimensions[name] for name in robot.joint_names]
    named = zip(robot.joint_names, dimensions, q.T, strict=True)
    return {header(name, dimension): in_table_unit(values, dimension) for name, dimension, values in named}


def cells_of(values: FloatArray) -> list[object]:
    """Return the cells of a column, (n,); empty where there is no number.

    Numbers have 15 digits, so that 30 degrees stay 30 after the conversion to radians and back.
    """
    return [float(f"{value:.15g}") if math.isfinite(value) else "" for value in values.tolist()]


def condition_columns(
    robot: Robot, n_visits: int, setups: IntArray | None, context: Mapping[str, FloatArray]
) -> dict[str, list[object]]:
    """Return setups and conditions of visits; see `calib.core.data.measurements.Poses`."""
    columns: dict[str, list[object]] = {}
    names = list(robot.description.setups)
    if names:
        columns["setup"] = [names[k] for k in (np.zeros(n_visits, dtype=np.intp) if setups is None else setups)]
    dimensions = dimensions_of_conditions(robot.terms) if context else {}
    for key, values in context.items():
        cells = in_table_unit(values, dimensions[key])
        columns[header(key, dimensions[key])] = ["" if np.isnan(value) else value for value in cells]
    return columns


def approach_columns(robot: Robot, approach: FloatArray | None) -> dict[str, list[object]]:
    """Return directions of approach (n, n_actuated), for joints with at least one known direction.

    If no direction is known, every joint has a column of zeros: without columns, readers of the file would take
    directions from the order of its rows.
    """
    if approach is None:
        return {}
    known = np.any(approach != 0, axis=0)
    seen = known if np.any(known) else ~known
    return {
        f"{APPROACH}{name}": [int(direction) for direction in approach[:, j]]
        for j, name in enumerate(robot.joint_names)
        if seen[j]
    }


def std_columns(instrument: Instrument) -> list[tuple[str, Dimension]]:
    """Return the columns of standard deviations of an instrument, with their dimensions."""
    return [(f"{instrument.name}_std_{axis}", part.dimension) for part in instrument.parts for axis in part.axes]


def correlation_columns(instrument: Instrument) -> dict[str, tuple[int, int]]:
    """Return the columns of correlations of an instrument, with the rows of the covariance that they are about."""
    axes = [axis for part in instrument.parts for axis in part.axes]
    return {
        f"{instrument.name}_corr_{axes[i]}_{axes[j]}": (i, j) for i in range(len(axes)) for j in range(i + 1, len(axes))
    }


def _noise_columns(instrument: Instrument, covariance: FloatArray) -> dict[str, Sequence[object]]:
    """Cells of standard deviations, and of correlations if there are any, from (n, n_rows, n_rows) [SI]."""
    std = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    cells: dict[str, Sequence[object]] = {
        header(name, dimension): list(in_table_unit(std[:, k], dimension))
        for k, (name, dimension) in enumerate(std_columns(instrument))
    }
    correlation = covariance / (std[:, :, None] * std[:, None, :])
    off_diagonal = {name: correlation[:, i, j] for name, (i, j) in correlation_columns(instrument).items()}
    return cells | {name: values.tolist() for name, values in off_diagonal.items() if np.any(values)}


def reading_columns(
    robot: Robot, n_visits: int, all_readings: Mapping[str, Readings]
) -> tuple[IntArray, dict[str, list[object]]]:
    """Return the visit of each line of the table, (n_lines,), and the readings, by instrument.

    `DataError` for simulated readings of a touch without contact.
    """
    visits, line_of = _lines(robot, n_visits, all_readings)
    columns: dict[str, list[object]] = {}
    for instrument in robot.instruments:
        readings = all_readings.get(instrument.name)
        if readings is None:
            continue
        dimensions = {column.name: column.dimension for column in instrument.columns()}
        cells: dict[str, Sequence[object]] = {
            header(name, dimensions[name]): list(in_table_unit(numbers, dimensions[name]))
            for name, numbers in instrument.cells(readings.values).items()
        }
        if instrument.label_column is not None:
            cells[instrument.label_column] = [instrument.name] * len(readings)
        if readings.covariance is not None:
            cells |= _noise_columns(instrument, readings.covariance)
        for name, texts in (cells | instrument.texts(readings.pairs, readings.details)).items():
            column = columns.setdefault(name, [""] * len(visits))
            for line, cell in zip(line_of[instrument.name], texts, strict=True):
                column[line] = cell
        if not dimensions and np.any(readings.values):
            raise DataError(
                f"instrument '{instrument.name}' is not in contact at these joint values, and files cannot hold the"
                " gap; give joint values at contact"
            )
    return visits, columns


def _lines(robot: Robot, n_visits: int, all_readings: Mapping[str, Readings]) -> tuple[IntArray, dict[str, IntArray]]:
    """The visit of each line, and the line of each reading; instruments that share columns need lines of their own."""
    sharing: dict[str, list[str]] = {}
    for instrument in robot.instruments:
        if instrument.name in all_readings:
            shared = f"column {instrument.label_column}" if instrument.label_column else instrument.name
            sharing.setdefault(shared, []).append(instrument.name)
    place: dict[str, IntArray] = {}
    for names in sharing.values():
        places = rank_in_visit(np.concatenate([all_readings[name].visits for name in names]))
        ends = np.cumsum([len(all_readings[name]) for name in names])[:-1]
        place |= dict(zip(names, np.split(places, ends), strict=True))
    count = np.ones(n_visits, dtype=np.intp)
    for name, places in place.items():
        np.maximum.at(count, all_readings[name].visits, places + 1)
    first = np.cumsum(count) - count
    line_of = {name: first[all_readings[name].visits] + places for name, places in place.items()}
    return np.repeat(np.arange(n_visits), count), line_of


def rank_in_visit(visits: IntArray) -> IntArray:
    """Return the number of earlier readings of the same visit, for each reading, (n,), from the visits (n,)."""
    order = np.argsort(visits, kind="stable")
    sorted_visits = visits[order]
    result = np.empty(len(visits), dtype=np.intp)
    result[order] = np.arange(len(visits)) - np.searchsorted(sorted_visits, sorted_visits)
    return result


def header(name: str, dimension: Dimension | None) -> str:
    """Return the header of a column, with its unit."""
    return name if dimension is None else f"{name} [{DISPLAY_UNIT[dimension]}]"


def in_table_unit(numbers: FloatArray, dimension: Dimension | None) -> FloatArray:
    """Return numbers (n,) [SI] in the unit of tables."""
    return numbers if dimension is None else in_unit(numbers, DISPLAY_UNIT[dimension])
