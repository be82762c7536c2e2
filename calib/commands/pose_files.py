"""Files of poses, measured or not: what `calib check` and `calib select` both read."""

from __future__ import annotations

import numpy as np

from calib.arrays import BoolArray, IntArray
from calib.data.measurement_files import read_measurements
from calib.data.measurements import Measurements, Poses, check_repeats
from calib.data.plan_files import INSTRUMENT, read_plan
from calib.data.tables import Table, read_table
from calib.errors import DataError
from calib.linearisation.registration import register
from calib.model.robot import Robot
from calib.observation.kind import Readings


def read_pose_file(path: str, robot: Robot) -> Poses:
    """Read poses; as `Measurements` where some instrument read in every row: these may repeat a pose.

    Raises:
        DataError: The file is not valid, or poses that are not measured have the same name.
    """
    table = read_table(path, robot.description.columns)
    if _measured(table, robot):
        return read_measurements(path, robot)
    poses = read_plan(path, robot)
    if robot.description.instruments and INSTRUMENT in table.names:  # a row for each instrument, if need be
        check_repeats(poses, robot)
        return poses
    seen: set[str] = set()
    for label, name in zip(poses.labels, poses.names, strict=True):
        if name in seen:
            raise DataError(f"{label}: pose '{name}' is given twice; names of poses must be unique")
        seen.add(name)
    return poses


def _measured(table: Table, robot: Robot) -> bool:
    """Whether every row has all cells of some instrument."""
    measured = np.zeros(len(table.rows), dtype=bool)
    for one in robot.instruments:
        names = [*(column.name for column in one.columns()), *one.text_columns()]
        if names and set(names) <= set(table.names):
            measured |= np.all([[bool(cell) for cell in table.text(name)] for name in names], axis=0)
    return bool(np.all(measured))


def different_poses(poses: Poses) -> Poses:
    """Return each pose once, as it was visited first, with all that is to be read there in that setup."""
    numbers = poses.pose_numbers
    first = np.unique(numbers, return_index=True)[1]
    setups = np.zeros(len(poses), dtype=np.intp) if poses.setups is None else poses.setups
    same_setup = setups == setups[first][numbers]
    labels, names = (tuple(words[k] for k in first) for words in (poses.labels, poses.names))
    return Poses(
        poses.joints[first],
        labels,
        names,
        poses.path,
        poses.ignored,
        comments=poses.comments,
        setups=None if poses.setups is None else poses.setups[first],
        wanted={name: _once(found, numbers, same_setup) for name, found in poses.wanted.items()},
    )


def _once(found: Readings, numbers: IntArray, counts: BoolArray) -> Readings:
    """What is to be read at poses, of whose visits (n,) these are the numbers, once each; of visits that count."""
    said = np.column_stack([numbers[found.visits], found.pairs, found.details, counts[found.visits]])
    kept = np.sort(np.unique(said, axis=0, return_index=True)[1])
    kept = kept[counts[found.visits[kept]]]
    return Readings(numbers[found.visits[kept]], found.pairs[kept], found.values[kept], None, found.details[kept])


def placed(robot: Robot, *files: Poses | None) -> Robot:
    """Place a base or targets that are not known beforehand, by the first file with measured positions, if any.

    Where the targets are decides what poses can tell about them.
    """
    if not any(parameter.placement for parameter in robot.parameters):
        return robot
    data = next((poses for poses in files if isinstance(poses, Measurements)), None)
    return robot if data is None else register(robot, data)
