"""Files of poses, measured or not: what `calib check` and `calib select` both read."""

from __future__ import annotations

from calib.data.measurement_files import read_measurements, read_poses
from calib.data.measurements import Measurements, Poses
from calib.data.tables import read_table
from calib.errors import DataError
from calib.linearisation.registration import register
from calib.model.robot import Robot


def read_pose_file(path: str, robot: Robot) -> Poses:
    """Read poses; where every row has measured positions, as `Measurements`, so that repeats of a pose are averaged.

    Raises:
        DataError: The file is not valid, or poses that are not measured have the same name.
    """
    table = read_table(path, robot.description.columns)
    positions = [f"{target}_{axis}" for target in robot.target_names for axis in "xyz"]
    if all(name in table.names and all(table.text(name)) for name in positions):
        return read_measurements(path, robot)
    poses = read_poses(path, robot)
    seen: set[str] = set()
    for label, name in zip(poses.labels, poses.names, strict=True):
        if name in seen:
            raise DataError(f"{label}: pose '{name}' is given twice; names of poses must be unique")
        seen.add(name)
    return poses


def placed(robot: Robot, *files: Poses | None) -> Robot:
    """Place a base or targets that are not known beforehand, by the first file with measured positions, if any.

    Where the targets are decides what poses can tell about them.
    """
    if not any(parameter.placement for parameter in robot.parameters):
        return robot
    data = next((poses for poses in files if isinstance(poses, Measurements)), None)
    return robot if data is None else register(robot, data)
