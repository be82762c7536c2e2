"""Assembled configurations: values of the driven joints at commands, and how the loops close there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from calib.core.base.arrays import FloatArray, IntArray, ReadOnlyArrays, numbers_in
from calib.core.base.errors import DataError, UnreachablePoseError
from calib.core.robots import loops
from calib.core.robots.closure import LoopSolution, residual, singular_values
from calib.core.robots.joint_errors import actual_joints, term_columns
from calib.core.robots.robot_data import RobotData
from calib.core.robots.terms.term import Context

_LARGEST_JOINT = 1e6  # [m or rad]


@dataclass(frozen=True, eq=False)
class Configurations(ReadOnlyArrays):
    """Assembled configurations of a robot.

    Attributes:
        actuated: Actual values of the driven joints, (n, n_driven) [m or rad]: commands and the joints' errors, then
            how links are tilted (`calib.core.robots.mechanism`).
        passive: (n, n_passive) [m or rad].
        slope: Derivative of the closures by the passive joints, (n, n_passive, n_passive), where it is known.
        term_columns: phi of each joint term (`columns_of_terms`), (n, n_moved, n_coefficients) each.
    """

    actuated: FloatArray
    passive: FloatArray
    slope: FloatArray | None
    term_columns: tuple[FloatArray, ...] = ()

    def select(self, part: slice | IntArray) -> Configurations:
        """Return some of the configurations, (n_some,)."""
        phi = tuple(columns[part] for columns in self.term_columns)
        slope = None if self.slope is None else self.slope[part]
        return Configurations(self.actuated[part], self.passive[part], slope, phi)


def joint_vector(robot: RobotData, q: ArrayLike) -> FloatArray:
    """Return actuated joint values as (n, n_actuated); `DataError` if the shape is wrong, or a value not finite."""
    if isinstance(q, Mapping):
        raise DataError("joint values by name: give a list, [values[name] for name in robot.joint_names] [m or rad]")
    values = np.atleast_2d(numbers_in(q, "joint values"))
    if values.ndim != 2 or values.shape[1] != len(robot.joint_names):
        shape = np.shape(q)
        hint = "; for a number of poses: robot.sample(30, seed=1)" if shape == () else ""
        hint = "; joint values that reach poses: calib.solve(robot, poses)" if shape[-2:] == (4, 4) else hint
        raise DataError(
            f"joint values of shape {shape}; expected (n, {len(robot.joint_names)}) in the order"
            f" {', '.join(robot.joint_names)}{hint}"
        )
    possible = np.abs(values) <= _LARGEST_JOINT  # false for NaN
    if not np.all(possible):
        row, column = np.argwhere(~possible)[0]
        size = f"{values[row, column]:.3g} m or rad, which no robot reaches; check the value and its unit"
        why = size if np.isfinite(values[row, column]) else "not finite"
        raise DataError(f"pose {row}: joint '{robot.joint_names[column]}' is {why}")
    return values


def close(
    robot: RobotData,
    q: ArrayLike,
    seed: FloatArray | None = None,
    columns: tuple[FloatArray, ...] | None = None,
    *,
    thorough: bool = True,
    limits: bool = True,
) -> LoopSolution:
    """Solve the loops of each pose without raising; see `Robot.close`."""
    values = joint_vector(robot, q)
    actual = actual_joints(robot, values, term_columns(robot, values) if columns is None else columns)
    return loops.close(robot.mechanism, robot.mode, actual, seed, thorough=thorough, limits=limits)


def configurations_if_closed(
    robot: RobotData, q: FloatArray, seed: FloatArray | None, columns: tuple[FloatArray, ...], *, limits: bool = True
) -> Configurations | None:
    """Return the configurations of checked commands q (n, n_actuated), as `close` finds them; None if one is open."""
    actual = actual_joints(robot, q, columns)
    closed = loops.close(robot.mechanism, robot.mode, actual, seed, limits=limits)
    return Configurations(actual, closed.passive, closed.slope, columns) if np.all(closed.ok) else None


def solve_configurations(
    robot: RobotData, q: FloatArray, closed: LoopSolution, columns: tuple[FloatArray, ...] | None = None
) -> Configurations:
    """Return closed poses of commands q (n, n_actuated) as configurations."""
    phi = term_columns(robot, q) if columns is None else columns
    return Configurations(actual_joints(robot, q, phi), closed.passive, closed.slope, phi)


def assemble(
    robot: RobotData,
    q: ArrayLike,
    seed: FloatArray | None = None,
    labels: Sequence[str] | None = None,
    context: Context | None = None,
) -> Configurations:
    """Solve the loops of each pose in the assembly mode of home; see `Robot.assemble`."""
    values = joint_vector(robot, q)
    columns = term_columns(robot, values, context)
    configurations = configurations_if_closed(robot, values, seed, columns)
    if configurations is None:
        raise UnreachablePoseError(describe_open(robot, values, close(robot, values, seed, columns), labels))
    return configurations


def distances(robot: RobotData, configurations: Configurations) -> FloatArray:
    """Return each pose's distance to a singularity of the loops, (n,); see `Robot.singular_values`."""
    slope = configurations.slope
    if slope is None:
        slope = residual(robot.mechanism, configurations.actuated, configurations.passive)[1]
    return singular_values(robot.mechanism, slope)


def near_singularities(robot: RobotData, configurations: Configurations, labels: Sequence[str]) -> list[str]:
    """Return a remark on every configuration, by its label (n,), that is near a singularity of the loops.

    There small errors of parameters and joints move the passive joints far.
    """
    limit, values = robot.description.singularity_limit, distances(robot, configurations)
    return [near_singularity(labels[k], values[k], limit) for k in map(int, np.flatnonzero(values < limit))]


def near_singularity(label: str, value: float, limit: float) -> str:
    """Say that a pose with this smallest singular value is nearer to a singularity of the loops than the limit."""
    return f"{label}: {value:.2g} from a singularity of the loops (limit {limit:g})"


def describe_open(robot: RobotData, q: FloatArray, closed: LoopSolution, labels: Sequence[str] | None = None) -> str:
    """Say which of the poses q (n, n_actuated) do not close, at which loop, and by how much the first one misses."""
    poses = np.flatnonzero(~closed.ok)
    names = labels or [f"pose {k}" for k in range(len(closed.ok))]
    k = int(poses[0])
    why = loops.why_open(robot.mechanism, robot.mode, robot.mechanism.without_tilts(q[k : k + 1])[0])
    more = f" (and {len(poses) - 1} more poses)" if len(poses) > 1 else ""
    return f"{names[k]}{more}: {why}; check these joint values, or leave the pose out"
