"""Measurements, poses and positions as the text of CSV files, in mm and degrees."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.arrays import FloatArray, IntArray
from calib.data.measurements import APPROACH, CONTEXT, Measurements, Poses, rank_in_visit
from calib.data.tables import format_table
from calib.errors import DataError
from calib.model.robot import Robot
from calib.units import DISPLAY_UNIT, PER_SI, Dimension


def format_measurements(robot: Robot, data: Measurements, comments: tuple[str, ...] = ()) -> str:
    """Return measurements as CSV text in mm and degrees.

    A visit at which an instrument read several things (points of a camera) has a line for each of them, which repeat
    its joint values.

    Raises:
        DataError: Simulated readings of an instrument that reads no numbers.
    """
    visits, line_of = _lines(robot, data)
    columns: dict[str, list[object]] = {
        header: [cells[k] for k in visits]
        for header, cells in [*_pose_columns(robot, data), *_conditions(robot, data), *_approach_columns(robot, data)]
    }
    for one in robot.instruments:
        readings = data.readings.get(one.name)
        if readings is None:
            continue
        dimensions = {column.name: column.dimension for column in one.columns()}
        cells: dict[str, Sequence[object]] = {
            _header(name, dimensions[name]): list(_shown(numbers, dimensions[name]))
            for name, numbers in one.cells(readings.values).items()
        }
        if one.label_column is not None:
            cells[one.label_column] = [one.name] * len(readings)
        for header, shown in (cells | one.texts(readings.pairs, readings.details)).items():
            column = columns.setdefault(header, [""] * len(visits))
            for line, cell in zip(line_of[one.name], shown, strict=True):
                column[line] = cell
        if not dimensions and np.any(readings.values):
            raise DataError(
                f"instrument '{one.name}' reads no numbers, so that no file can say by how much it missed: what it"
                " touches must be touched; give joint values at which it is"
            )
    return format_table(list(columns.items()), comments)


def _lines(robot: Robot, data: Measurements) -> tuple[IntArray, dict[str, IntArray]]:
    """The visit of each line of a file, and the line of each reading; what shares columns needs lines of its own."""
    sharing: dict[str, list[str]] = {}
    for one in robot.instruments:
        if one.name in data.readings:
            sharing.setdefault(f"column {one.label_column}" if one.label_column else one.name, []).append(one.name)
    place: dict[str, IntArray] = {}
    for names in sharing.values():
        places = rank_in_visit(np.concatenate([data.readings[name].visits for name in names]))
        ends = np.cumsum([len(data.readings[name]) for name in names])[:-1]
        place |= dict(zip(names, np.split(places, ends), strict=True))
    count = np.ones(len(data), dtype=np.intp)
    for name, places in place.items():
        np.maximum.at(count, data.readings[name].visits, places + 1)
    first = np.cumsum(count) - count
    return np.repeat(np.arange(len(data)), count), {
        name: first[data.readings[name].visits] + places for name, places in place.items()
    }


def _conditions(robot: Robot, data: Measurements) -> list[tuple[str, list[object]]]:
    """Columns that say in which setup and under which conditions the visits were made."""
    columns: list[tuple[str, list[object]]] = []
    names = list(robot.description.setups)
    if names:
        setups = np.zeros(len(data), dtype=np.intp) if data.setups is None else data.setups
        columns.append(("setup", [names[k] for k in setups]))
    for key, values in data.context.items():
        cells: list[object] = ["" if np.isnan(value) else value for value in _shown(values, CONTEXT[key])]
        columns.append((_header(key, CONTEXT[key]), cells))
    return columns


def format_positions(
    robot: Robot,
    poses: Poses,
    positions: FloatArray,
    comments: tuple[str, ...] = (),
    std: FloatArray | None = None,
) -> str:
    """Return positions of targets as CSV text in mm and degrees.

    Args:
        robot: Names joints and targets.
        poses: Joint values.
        positions: (n_poses, n_targets, 3) [m].
        comments: Lines to put first.
        std: Standard deviation of each coordinate, (n_poses, n_targets, 3) [m], in columns `<target>_std_x` ...
    """
    columns = _pose_columns(robot, poses)
    for suffix, numbers in (("", positions), ("std_", std)):
        for t, target in enumerate(robot.target_names):
            for a, axis in enumerate("xyz"):
                if numbers is not None:
                    shown = _shown(numbers[:, t, a], "length")
                    columns.append((_header(f"{target}_{suffix}{axis}", "length"), list(shown)))
    return format_table(columns, comments)


def _header(name: str, dimension: Dimension | None) -> str:
    return name if dimension is None else f"{name} [{DISPLAY_UNIT[dimension]}]"


def _shown(numbers: FloatArray, dimension: Dimension | None) -> FloatArray:
    return numbers if dimension is None else numbers * PER_SI[dimension][DISPLAY_UNIT[dimension]]


def _pose_columns(robot: Robot, poses: Poses) -> list[tuple[str, list[object]]]:
    columns: list[tuple[str, list[object]]] = [("pose", list(poses.names))]
    for j, name in enumerate(robot.joint_names):
        dimension = robot.mechanism.dimensions[name]
        # 15 digits: 30 degrees come out as 30, not as what the way through radians leaves of them
        cells: list[object] = [float(f"{value:.15g}") for value in _shown(poses.joints[:, j], dimension)]
        columns.append((_header(name, dimension), cells))
    return columns


def _approach_columns(robot: Robot, data: Measurements) -> list[tuple[str, list[object]]]:
    """Directions of approach where they are given, of the joints of which any is known; a column says that they are."""
    if data.approach is None:
        return []
    known = np.any(data.approach != 0, axis=0)
    shown = known if np.any(known) else ~known
    return [
        (f"{APPROACH}{name}", [int(direction) for direction in data.approach[:, j]])
        for j, name in enumerate(robot.joint_names)
        if shown[j]
    ]
