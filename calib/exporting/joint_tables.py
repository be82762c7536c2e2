"""Joint correction tables: where each joint is at each command, for controllers without a model.

A table has equal steps, with linear interpolation between them. That is off by at most h^2 / 8 times the largest second
derivative of the joint's error, of which every term knows a bound; the step h is chosen so that this stays below
`TOLERANCE`. A table reaches over the joint's limits in the URDF (two turns about zero where there are none), and a
little further, so that the way back (which command gives a wanted value) holds at the limits too. Outside, the answer
is NaN.

Only errors that depend on the joint's own command fit into a table. What else the model has (backlash, compliance,
bending, drift) is left out, and said with its size. The tables, and the joint origins that go with them, are then those
that a fit found to be best without it (`calib.core.robots.held`); the URDF with these origins lies beside the tables.
Tables and the origins of another file do not go together.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.core.base.arrays import FloatArray, ReadOnlyArrays
from calib.core.base.errors import InputError
from calib.core.base.units import Dimension, quantity_text
from calib.core.base.words import listed
from calib.core.data.table_writing import format_table
from calib.core.results.urdf import urdf_bytes
from calib.core.robots.held import Holds
from calib.core.robots.joint_errors import actual_joints, columns_of_terms
from calib.core.robots.robot import Robot
from calib.core.robots.robot_files import without_terms
from calib.core.robots.terms.term import Context, JointTerm

TOLERANCE = 4e-7
"""What interpolation may be off [rad or m]."""
_TURNS = 2.0 * np.pi  # range to either side of a joint that turns without limits [rad]
_MOST_STEPS = 200_000
_SI: dict[Dimension, str] = {"length": "m", "angle": "rad"}

_PYTHON = '''\
import math

# joint: (first command, step, where the joint then is) [rad or m]
TABLES = {
%s}


def actual(joint, command):
    """Where a joint is at `command`; NaN outside its table."""
    start, step, values = TABLES[joint]
    x = (command - start) / step
    if not -1e-9 <= x <= len(values) - 1 + 1e-9:
        return math.nan
    k = min(max(int(x), 0), len(values) - 2)
    return values[k] + (x - k) * (values[k + 1] - values[k])


def command(joint, goal):
    """The command that brings a joint to `goal`; NaN outside its table."""
    value = goal
    for _ in range(20):
        value -= actual(joint, value) - goal
    return value
'''
_C = """\
#include <math.h>

/* Joints by number: %s. Values in rad or m. */
%s
static const double *const joint_values[] = {%s};
static const double joint_start[] = {%s};
static const double joint_step[] = {%s};
static const int joint_count[] = {%s};

/* Where a joint is at `command`; NaN outside its table. */
static double joint_actual(int joint, double command) {
    const double *values = joint_values[joint];
    int n = joint_count[joint], k;
    double x = (command - joint_start[joint]) / joint_step[joint];
    if (!(x >= -1e-9 && x <= n - 1 + 1e-9)) return NAN;
    k = x < 0 ? 0 : (int)x;
    if (k > n - 2) k = n - 2;
    return values[k] + (x - k) * (values[k + 1] - values[k]);
}

/* The command that brings a joint to `goal`; NaN outside its table. */
static double joint_command(int joint, double goal) {
    double value = goal;
    int round;
    for (round = 0; round < 20; round++) value -= joint_actual(joint, value) - goal;
    return value;
}
"""


@dataclass(frozen=True, eq=False)
class JointTable(ReadOnlyArrays):
    """Where a joint is, by its command.

    Attributes:
        joint: The joint.
        dimension: Whether it slides or turns.
        commands: With equal steps, (n,) [rad or m].
        actual: Where it then is, (n,) [rad or m].
    """

    joint: str
    dimension: Dimension
    commands: FloatArray
    actual: FloatArray


def joint_tables(robot: Robot) -> tuple[JointTable, ...]:
    """Return the table of each actuated joint; terms that no table can hold do not count.

    Raises:
        InputError: The robot has no joint terms for tables, a sliding joint no limits, or a table would be too long.
    """
    require_own_terms(robot)
    kept = without_terms(robot, Holds.TABLES)
    bound, start = dict.fromkeys(kept.joint_names, 0.0), kept.coefficients.start
    for term in kept.terms:
        indices = slice(start, start := start + len(term.parameters))
        bound[term.joint] += term.curvature(kept.values[indices])
    return tuple(_table(kept, joint, curvature) for joint, curvature in bound.items())


def require_own_terms(robot: Robot) -> None:
    """Raise `InputError` where there is nothing to put into tables."""
    if not without_terms(robot, Holds.TABLES).terms:
        raise InputError(
            f"{robot.path}: has no joint terms that depend on the joint's own value alone; there is nothing to put"
            " into a table"
        )


def beside_tables(robot: Robot) -> list[str]:
    """Return what of a robot no table can hold, with its size, one line each."""
    left, start = [], robot.coefficients.start
    for term in robot.terms:
        indices = slice(start, start := start + len(term.parameters))
        if not Holds.TABLES.keeps(term):
            left.append(_left_out(robot, indices, term))
    return left


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


def _left_out(robot: Robot, indices: slice, term: JointTerm) -> str:
    """Say what of a joint's error is not in its table."""
    dimension = robot.mechanism.dimensions[term.joint]
    size = quantity_text(float(np.max(np.abs(robot.values[indices]))), dimension)
    depends_on = listed([condition.words for condition in term.depends_on])
    remainder = f"{size} {term.per}".rstrip()
    return f"{term.joint}: {term.cause} is not in the table, because it depends on {depends_on}: {remainder} remains"


def joint_table_files(robot: Robot, lines: Sequence[str] = ()) -> dict[str, bytes]:
    """Return `joint_tables.csv`, the same as Python and C with the code that applies it, and the URDF to use with it.

    Args:
        robot: The robot.
        lines: What to say in each file.

    Raises:
        InputError: See `joint_tables`.
    """
    tables = joint_tables(robot)
    said = [f"joint correction tables of {robot.name} ({robot.path})", *lines]
    said = [" ".join(line.replace("*/", "* /").split()) for line in said]
    columns: list[tuple[str, Sequence[object]]] = [
        ("joint", [table.joint for table in tables for _ in table.commands]),
        ("unit", [_SI[table.dimension] for table in tables for _ in table.commands]),
        ("commanded", [float(value) for table in tables for value in table.commands]),
        ("actual", [float(value) for table in tables for value in table.actual]),
    ]
    return {
        "joint_tables.csv": format_table(columns, said).encode(),
        "joint_tables.py": ("".join(f"# {line}\n" for line in said) + _python(tables)).encode(),
        "joint_tables.h": ("".join(f"/* {line} */\n" for line in said) + _c(tables)).encode(),
        "joint_tables.urdf": urdf_bytes(robot, ["joint origins that go with joint_tables.csv", *lines]),
    }


def _python(tables: Sequence[JointTable]) -> str:
    """The tables as a Python module."""
    entries = []
    for table in tables:
        start, step = float(table.commands[0]), _step(table)
        entries.append(
            f"    {json.dumps(table.joint)}: ({start!r}, {step!r}, [\n{_numbers(table.actual, 8)}\n    ]),\n"
        )
    return _PYTHON % "".join(entries)


def _c(tables: Sequence[JointTable]) -> str:
    """The tables as a C header."""
    names = ", ".join(f"{k} {table.joint}" for k, table in enumerate(tables)).replace("*/", "* /")
    arrays = [
        f"static const double joint_values_{k}[] = {{\n{_numbers(table.actual, 4)}\n}};"
        for k, table in enumerate(tables)
    ]
    return _C % (
        " ".join(names.split()),
        "\n".join(arrays),
        ", ".join(f"joint_values_{k}" for k in range(len(tables))),
        ", ".join(repr(float(table.commands[0])) for table in tables),
        ", ".join(repr(_step(table)) for table in tables),
        ", ".join(str(len(table.actual)) for table in tables),
    )


def _step(table: JointTable) -> float:
    return float((table.commands[-1] - table.commands[0]) / (len(table.commands) - 1))


def _numbers(values: FloatArray, indent: int) -> str:
    """Numbers in lines, so that they read back exactly."""
    text = [repr(float(value)) for value in values]
    lines = [", ".join(text[k : k + 5]) for k in range(0, len(text), 5)]
    return ",\n".join(" " * indent + line for line in lines)
