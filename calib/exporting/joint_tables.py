"""Joint correction tables: actual joint values by commands, for controllers without a model.

A table has equal steps, with linear interpolation. Its error is at most h^2 / 8 times the largest second derivative of
the joint's error, which every term can bound; the step h keeps this below `TOLERANCE`. A table covers the joint's
limits in the URDF (two turns about zero without limits), and a little more, so that its inverse (the command for a
wanted value) exists at the limits too.

Only errors that depend on the joint's own command fit into a table. Other parts of the model (backlash, compliance,
bending, drift) are left out; the file states their size. The tables, and the joint origins that go with them, are then
those that a fit found best without these parts (`calib.core.robots.accuracy_of_files`); the URDF with these origins is
beside the tables. Tables must not be used with the origins of another file.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.core.base.arrays import FloatArray, ReadOnlyArrays
from calib.core.base.errors import InputError
from calib.core.base.units import ERROR_UNIT, Dimension, quantity_text
from calib.core.base.words import listing
from calib.core.data.table_writing import format_table
from calib.core.results.urdf import urdf_bytes
from calib.core.robots.accuracy_of_files import Holds
from calib.core.robots.joint_errors import actual_joints, columns_of_terms
from calib.core.robots.robot import Robot
from calib.core.robots.robot_files import without_terms
from calib.core.robots.terms.term import Context

TOLERANCE = 4e-7
"""Largest error of the interpolation [rad or m]."""
_TURNS = 2.0 * np.pi  # range to either side for a revolute joint without limits [rad]
_MOST_STEPS = 200_000
_SI: dict[Dimension, str] = {"length": "m", "angle": "rad"}


@dataclass(frozen=True, eq=False)
class JointTable(ReadOnlyArrays):
    """Actual values of a joint by its commands.

    Attributes:
        joint: Name of the joint.
        dimension: `length` or `angle`.
        commands: Commands with equal steps, (n,) [rad or m].
        actual: Actual values there, (n,) [rad or m].
    """

    joint: str
    dimension: Dimension
    commands: FloatArray
    actual: FloatArray


def joint_tables(robot: Robot) -> tuple[JointTable, ...]:
    """Return the table of each actuated joint, without terms that no table can hold.

    Raises:
        InputError: No joint term fits into tables, a sliding joint has no limits, or a table would be too long.
    """
    require_own_terms(robot)
    kept = without_terms(robot, Holds.TABLES)
    bound = dict.fromkeys(kept.joint_names, 0.0)
    for term, values in kept.term_values():
        bound[term.joint] += term.curvature(values)
    return tuple(_table(kept, joint, curvature) for joint, curvature in bound.items())


def require_own_terms(robot: Robot) -> None:
    """Raise `InputError` if no term fits into tables."""
    if not without_terms(robot, Holds.TABLES).terms:
        raise InputError(
            f"{robot.path}: has no joint terms that depend on the joint's own value alone; there is nothing to put"
            " into a table"
        )


def lost_by_tables(robot: Robot) -> list[str]:
    """Return the errors of a robot that no table can hold, with their sizes, one line each."""
    lines = []
    for term, values in robot.term_values():
        if not Holds.TABLES.keeps(term):
            size = quantity_text(float(np.max(np.abs(values))), ERROR_UNIT[robot.mechanism.dimensions[term.joint]])
            columns = [f"the column '{name}'" for name in term.reads()]
            depends_on = listing([*(condition.words for condition in term.depends_on), *columns])
            left = f"because it depends on {depends_on}: {f'{size} {term.per}'.rstrip()} remains"
            lines.append(f"{term.joint}: {term.cause} is not in the table, {left}")
    return lines


def _table(robot: Robot, joint: str, curvature: float) -> JointTable:
    j, dimension = robot.joint_names.index(joint), robot.mechanism.dimensions[joint]
    described = next(candidate for candidate in robot.urdf.joints if candidate.name == joint)
    low, high = described.lower, described.upper
    if not (np.isfinite(high - low) and high > low):
        if dimension == "length":
            raise InputError(f"{robot.urdf.path}: joint '{joint}' slides without limits; give it some for its table")
        low, high = -_TURNS, _TURNS

    def actual(commands: FloatArray) -> FloatArray:
        q = np.zeros((len(commands), len(robot.joint_names)))
        q[:, j] = commands
        columns = columns_of_terms(robot.terms, robot.mechanism, q, Context.neutral(*q.shape))
        return actual_joints(robot, q, columns)[:, j]

    ends = np.linspace(low, high, 1001)
    margin = 2.0 * float(np.max(np.abs(actual(ends) - ends))) + TOLERANCE
    low, high = low - margin, high + margin
    n_steps = max(int(np.ceil((high - low) * np.sqrt(curvature / (8.0 * TOLERANCE)))), 1)
    if n_steps > _MOST_STEPS:
        raise InputError(f"{robot.path}: joint '{joint}': a table of its errors would need {n_steps} steps")
    commands = low + np.arange(n_steps + 1) * ((high - low) / n_steps)
    return JointTable(joint, dimension, commands, actual(commands))


def joint_table_files(robot: Robot, lines: Sequence[str] = ()) -> dict[str, bytes]:
    """Return `joint_tables.csv`, and the URDF to use with it; `lines` are comments of each file.

    Raises:
        InputError: See `joint_tables`.
    """
    tables = joint_tables(robot)
    header = [f"joint correction tables of {robot.name} ({robot.path}); linear between the rows", *lines]
    rows = [
        (table.joint, _SI[table.dimension], *values)
        for table in tables
        for values in zip(table.commands.tolist(), table.actual.tolist(), strict=True)
    ]
    columns = list(zip(("joint", "unit", "commanded", "actual"), zip(*rows, strict=True), strict=True))
    return {
        "joint_tables.csv": format_table(columns, header).encode(),
        "joint_tables.urdf": urdf_bytes(robot, ["joint origins that go with joint_tables.csv", *lines]),
    }
