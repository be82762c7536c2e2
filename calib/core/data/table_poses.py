"""Poses of a table: joint values, and the conditions and directions of gravity that its columns state."""

from __future__ import annotations

import difflib
from collections.abc import Sequence

import numpy as np

from calib.core.base.arrays import FloatArray, IntArray
from calib.core.base.errors import DataError, nearest
from calib.core.base.units import quantity_text, stated_tolerance
from calib.core.data.instrument_cells import labels_of_rows, lacking_column, names_of_poses, setups_of
from calib.core.data.measurement_columns import APPROACH
from calib.core.data.measurements import Poses, states_by_order
from calib.core.data.tables import Table
from calib.core.robots.gravity import contradiction_angles, turned_joints
from calib.core.robots.robot import Robot
from calib.core.robots.terms.gravity import COLUMNS as GRAVITY_COLUMNS
from calib.core.robots.terms.gravity import GravitySection, check_read, columns_of, read_down
from calib.core.robots.terms.terms import condition_columns


def poses_of_table(table: Table, robot: Robot, used: set[str], first: int = 0) -> Poses:
    """Return the visits of a table; where it does not name its poses, they are counted on from `first`.

    `used` are columns that something else is read from. A `DataError` names file, line and column.
    """
    setups = setups_of(robot, table) if robot.description.setups and "setup" in table.names else None
    joints, sensed = _joints_of_table(table, robot, setups, robot.joint_names)
    joints.flags.writeable = False  # so its holders need no copy
    called = names_of_poses(table)
    if called is not None and "" in called:
        where = table.where(called.index(""), "pose")
        raise DataError(f"{where}: is empty; name the pose, or leave the column out")
    names = tuple(map(str, range(first + 1, first + 1 + len(table.rows)))) if called is None else called
    context, approach = conditions_of_table(table, robot, joints)
    directions = {f"{APPROACH}{name}" for name in robot.joint_names}
    used = used | sensed | set(robot.joint_names) | {"pose", "setup", "instrument"} | set(context) | directions
    ignored = tuple(name for name in table.names if name not in used)
    poses = Poses(
        joints, tuple(labels_of_rows(table, called)), names, table.path, ignored,
        comments=table.comments, context=context, approach=approach, setups=setups, robot=robot,
    )  # fmt: skip
    _check_gravity(poses, robot, table)
    stated_tolerance(table.comments, table.path)
    return poses


def _check_gravity(poses: Poses, robot: Robot, table: Table) -> None:
    """Raise `DataError` where sensors read another direction of gravity than the description states."""
    angles = contradiction_angles(robot, poses.joints, poses.conditions)
    if not np.all(np.isnan(angles)):
        k = int(np.nanargmax(angles))
        off = quantity_text(angles[k], "deg", ".0f")
        raise DataError(
            f"{table.where(k)}: the direction of gravity that was read is {off} from the one that"
            f" {robot.path} states; check gravity.down, gravity.frame and the signs (an accelerometer at rest reads"
            " upwards), or leave gravity.down out"
        )


def stands_of_table(table: Table, robot: Robot, setups: IntArray | None) -> dict[str, FloatArray]:
    """Return the joint values that inclinometers read, where the other joints are unknown, (n,) [rad] by name.

    `setups` has the setup of each row, (n,); None: the first. `DataError` if no column states the values, or only a
    sensor whose readings depend on unknowns does.
    """
    mechanism, turning = robot.nominal, [n for n in robot.commanded_names if robot.nominal.dimensions[n] == "angle"]
    for sensor, section in robot.description.inclinometers.items():
        support = mechanism.support[mechanism.frames[section.frame]]
        behind = [name for name in turning if support @ mechanism.select_actuated[:, mechanism.actuated.index(name)]]
        if behind and not columns_of(sensor).keys().isdisjoint(table.names):
            raise DataError(
                f"{table.path}: what '{sensor}' reads depends on joint '{behind[0]}', which is to be found; give"
                f" columns {' and '.join(section.joints)} in place of the sensor's"
            )
    joints, _ = _joints_of_table(table, robot, setups, robot.sensed_names)
    return {name: joints[:, robot.joint_names.index(name)] for name in robot.sensed_names}


def _joints_of_table(
    table: Table, robot: Robot, setups: IntArray | None, names: Sequence[str]
) -> tuple[FloatArray, set[str]]:
    """These joint values of a table, the others at home, (n, n_actuated), and the columns that inclinometers read."""
    sensors = robot.description.inclinometers
    sensed = {joint: name for name, section in sensors.items() for joint in section.joints}
    reading = [name for name in sensors if not columns_of(name).keys().isdisjoint(table.names)]
    joints = np.tile(robot.home, (len(table.rows), 1))
    for j, name in enumerate(robot.joint_names):
        if name not in names:
            continue
        sensor = sensed.get(name)
        if name in table.names:
            if sensor in reading:
                raise DataError(
                    f"{table.path}: column '{table.header(name)}' and inclinometer '{sensor}' give the same joint;"
                    " leave one out"
                )
            joints[:, j] = table.column(name, robot.mechanism.dimensions[name])
        elif sensor is None:
            raise DataError(
                f"{lacking_column(name, robot, table)} (if your file has another name for it, translate that name under"
                " 'columns' in the robot description)"
            )
        elif sensor not in reading:
            raise DataError(
                f"{table.path}: no column '{name}', and none of inclinometer '{sensor}' for this joint: expected"
                f" {sensor}_accelerometer_x, ..., or {sensor}_gravity_x, ..., or {sensor}_gravity_tilt_x, ..."
            )
    stated = (robot.description.gravity or GravitySection()).stated_directions(tuple(robot.description.setups))
    down = stated[np.zeros(len(joints), dtype=np.intp) if setups is None else setups]
    for name in reading:
        known = {column: dimension for column, dimension in columns_of(name).items() if column in table.names}
        cells = {column.removeprefix(f"{name}_"): table.column(column, known[column], gaps=True) for column in known}
        check_read(cells, table.path, table.lines, f"{name}_")
        sensed_down = read_down(cells)
        assert sensed_down is not None  # or it is an error by now
        turned = [robot.joint_names.index(joint) for joint in sensors[name].joints]
        joints[:, turned] = turned_joints(robot.nominal, sensors[name], joints, sensed_down, down)
        _check_tilts(robot, name, joints[:, turned], table)
    return joints, {column for name in reading for column in columns_of(name)}


def _check_tilts(robot: Robot, sensor: str, tilts: FloatArray, table: Table) -> None:
    """Raise `DataError` where two joints (n, 2) cannot be what a sensor reads, or only beyond their limits."""
    section = robot.description.inclinometers[sensor]
    lost = np.flatnonzero(np.isnan(tilts).any(axis=1))
    if len(lost):
        raise DataError(
            f"{table.where(lost[0])}: {' and '.join(section.joints)} have no values at"
            f" which '{sensor}' reads this direction of gravity; check the axes of {section.frame}, and its signs"
        )
    lower, upper = robot.urdf.limits(section.joints)
    beyond = (tilts < lower) | (tilts > upper)
    if np.any(beyond):
        k, j = np.argwhere(beyond)[0]
        read, low, high = (quantity_text(x, "deg", ".2f") for x in (tilts[k, j], lower[j], upper[j]))
        raise DataError(
            f"{table.where(k)}: what '{sensor}' reads turns {section.joints[j]} by {read}, and its"
            f" limits in the URDF are {low} and {high}; check signs (an accelerometer at rest reads upwards), the axes"
            f" of {section.frame}, units (rad without [deg]), and these limits"
        )


def conditions_of_table(
    table: Table, robot: Robot, joints: FloatArray | None = None
) -> tuple[dict[str, FloatArray], FloatArray | None]:
    """Return the conditions of the robot in each row of a table, and the directions of approach.

    Conditions are columns that terms depend on, and those of gravity where the description speaks of it, (n,) [SI] by
    name, NaN where empty; directions are 0 for joints without a column, (n, n_actuated), None where no joint has one.
    `joints` are the commands of the rows, (n, n_actuated) [m or rad]; None where they are yet to be found: then their
    order tells nothing. `DataError` if a cell, a direction of gravity or the name of a joint is wrong.
    """
    dimensions, with_gravity = condition_columns(robot.terms), robot.description.gravity is not None
    keys = [key for key in dimensions if key in table.names and (with_gravity or key not in GRAVITY_COLUMNS)]
    context = {key: table.column(key, dimensions[key], gaps=True) for key in keys}
    _check_spelling(table, robot)
    check_read(context, table.path, table.lines)
    states = {} if joints is None else states_by_order(robot, joints)
    for term in robot.terms:
        for column in term.reads():
            if column not in context and column not in states and joints is not None:
                raise DataError(f"{table.path}: no column '{column}', on which a joint term of '{term.joint}' depends")
            context.setdefault(column, states.get(column, np.zeros(len(table.rows))))
    for name in table.names:
        joint = name.removeprefix(APPROACH)
        if joint != name and joint not in robot.joint_names and difflib.get_close_matches(joint, robot.joint_names):
            raise DataError(f"{table.path}, column '{name}': no joint '{joint}'{nearest(joint, robot.joint_names)}")
    present = [(j, name) for j, joint in enumerate(robot.joint_names) if (name := f"{APPROACH}{joint}") in table.names]
    if not present:
        return context, None
    directions = np.zeros((len(table.rows), len(robot.joint_names)))
    for j, name in present:
        directions[:, j] = np.sign(np.nan_to_num(table.column(name, None, gaps=True)))
    return context, directions


def _check_spelling(table: Table, robot: Robot) -> None:
    """Raise `DataError` where a column seems to say where gravity points, but for its spelling."""
    sensed = {column for name in robot.description.inclinometers for column in columns_of(name)}
    for name in table.names if robot.description.gravity is not None else ():
        close = difflib.get_close_matches(name, GRAVITY_COLUMNS, n=1, cutoff=0.9)
        if close and close[0] not in table.names and name not in sensed:
            raise DataError(f"{table.path}: no column '{name}' says where gravity points; did you mean '{close[0]}'?")
