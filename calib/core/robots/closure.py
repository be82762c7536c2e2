"""The closure residual r(a, p) of every loop, its derivatives, and how far they are from singular.

Assembly modes: which of several closed configurations a robot is in, distinguished by the signs of determinants.

Two solutions of the loops that are joined without passing a singularity have the same sign of det C_p, C_p = dr/dp.
Each strongly connected part of C_p's pattern, such as each five-bar, has its own sign: two flips cannot cancel.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray, IntArray, ReadOnlyArrays
from calib.core.numerics import linalg
from calib.core.numerics.graphs import connected_parts
from calib.core.robots import kinematics
from calib.core.robots.mechanism import Mechanism, RelativeFrame


def sweep_loops(
    shared: kinematics.SweepCache, actuated: FloatArray, passive: FloatArray, coordinates: kinematics.Coordinates
) -> tuple[FloatArray, FloatArray]:
    """Return r (n, n_rows) at poses (n, n_actuated), (n, n_passive) [m or rad], and its derivative by coordinates.

    That is C_p (n, n_rows, n_passive) by `shared.passive`, and [C_p C_a] by `shared.moving`.
    """
    mechanism = shared.mechanism
    swept = kinematics.sweep(mechanism, mechanism.all_joints(actuated, passive), mechanism.loops, shared)
    return kinematics.gaps(swept), kinematics.joint_derivative(swept, kinematics.gap_maps(swept), coordinates)


def residual(
    mechanism: Mechanism, actuated: FloatArray, passive: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return r (n, n_rows), C_p = dr/dp (n, n_rows, n_passive) and C_a = dr/da (n, n_rows, n_actuated)."""
    shared, n_passive = kinematics.SweepCache(mechanism, mechanism.loops), len(mechanism.passive)
    values = np.empty((len(actuated), len(mechanism.loop_signs)))
    slope = np.empty((*values.shape, mechanism.select_moving.shape[1]))
    for part in shared.chunks(len(actuated)):
        values[part], slope[part] = sweep_loops(shared, actuated[part], passive[part], shared.moving)
    return values, slope[:, :, :n_passive], slope[:, :, n_passive:]


def motion(
    mechanism: Mechanism,
    target: RelativeFrame,
    actuated: FloatArray,
    passive: FloatArray,
    closures: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the pose of a target in the measurement frame and how the actuated joints move it, through the loops.

    Args:
        target: The target seen from the measurement frame.
        actuated: Actuated joints, (n, n_actuated) [m or rad].
        passive: Passive joints that close the loops there, (n, n_passive) [m or rad].
        closures: [C_p C_a], (n, n_rows, n_passive + n_actuated), where it is known.

    Returns:
        Position (n, 3) [m], rotation (n, 3, 3), Jacobian (n, 6, n_actuated): [velocity of the point; angular velocity]
        in the axes of the measurement frame, per joint rate; and dp/da (n, n_passive, n_actuated).
    """
    swept = kinematics.sweep(mechanism, mechanism.all_joints(actuated, passive), (target,))
    mapping = kinematics.motion_map(swept, kinematics.motion_rows(swept, (target,), angular=True))

    signs, reduced = mechanism.direction_signs(target), swept.shared.reduced

    def derivative_by(select: FloatArray) -> FloatArray:
        coordinates = kinematics.Coordinates.from_signs(reduced, signs[None, reduced.joints], select)
        return kinematics.joint_derivative(swept, mapping, coordinates)

    jacobian = derivative_by(mechanism.select_actuated)
    by_joint: FloatArray = np.zeros((len(actuated), passive.shape[1], actuated.shape[1]))
    if mechanism.loops:
        if closures is None:
            closures = np.concatenate(residual(mechanism, actuated, passive)[1:], axis=2)
        by_joint = -np.linalg.solve(closures[:, :, : passive.shape[1]], closures[:, :, passive.shape[1] :])
        jacobian += derivative_by(mechanism.select_passive) @ by_joint
    rotation, position = kinematics.seen_frame(swept, target.a, target.b)
    return position, rotation, jacobian, by_joint


def scale_closure(mechanism: Mechanism, slope_passive: FloatArray) -> FloatArray:
    """Return C_p, (n, n_rows, n_passive), with metres over the characteristic length: pure numbers."""
    rows = np.where(mechanism.is_metre_row, 1 / mechanism.length, 1.0)
    return slope_passive * (rows[:, None] * mechanism.passive_scale)


def singular_values(mechanism: Mechanism, slope_passive: FloatArray) -> FloatArray:
    """Return the smallest singular value of the scaled C_p, (n,): 0 at a singular pose, of order 1 far from one."""
    if not mechanism.passive:
        return np.full(len(slope_passive), np.inf)
    values: FloatArray = linalg.singular_values(scale_closure(mechanism, slope_passive))
    return values[:, -1]


@dataclass(frozen=True, eq=False)
class AssemblyMode(ReadOnlyArrays):
    """A closed configuration and the signs that tell its assembly mode.

    Attributes:
        mechanism: The mechanism that it is a configuration of: the nominal one.
        actuated, passive: The configuration, (n_actuated,), (n_passive,) [m or rad].
        block_rows, block_columns: Indices of each strongly connected block of C_p, n_blocks arrays each.
        signs: Sign of each block's determinant, (n_blocks,).
    """

    mechanism: Mechanism
    actuated: FloatArray
    passive: FloatArray
    block_rows: tuple[IntArray, ...]
    block_columns: tuple[IntArray, ...]
    signs: FloatArray

    @cached_property
    def places(self) -> tuple[IntArray, IntArray, IntArray]:
        """Rows and columns of all blocks, one after another, (n_passive,), and where each ends, (n_blocks,)."""
        ends = np.cumsum([len(rows) for rows in self.block_rows])
        return np.concatenate(self.block_rows), np.concatenate(self.block_columns), ends

    def holds(self, slope: FloatArray) -> BoolArray:
        """Return which configurations are in this mode, from their C_p (n, n_passive, n_passive): (n,)."""
        return (block_signs(slope, self.block_rows, self.block_columns) == self.signs).all(axis=1)


@dataclass(frozen=True, eq=False)
class LoopSolution:
    """Solved loops.

    Attributes:
        passive: Passive joints, NaN where a pose does not close, (n, n_passive) [m or rad].
        ok: Mask of the poses that closed, (n,).
        slope: C_p at the solution, NaN where open, (n, n_passive, n_passive); None where it was not computed.
    """

    passive: FloatArray
    ok: BoolArray
    slope: FloatArray | None

    @staticmethod
    def empty(n: int, n_passive: int) -> LoopSolution:
        """Return n poses of which none is solved yet."""
        slope = np.full((n, n_passive, n_passive), np.nan)
        return LoopSolution(np.full((n, n_passive), np.nan), np.zeros(n, dtype=bool), slope)

    def take(self, other: LoopSolution, index: IntArray) -> None:
        """Store the solved ones of `other` in place, which are those of the poses `index`, (n_other,)."""
        rows = index[other.ok]
        self.passive[rows], self.ok[rows] = other.passive[other.ok], True
        if self.slope is not None and other.slope is not None:
            self.slope[rows] = other.slope[other.ok]

    def select(self, index: IntArray) -> LoopSolution:
        """Return the poses with these indices, (n,)."""
        return LoopSolution(self.passive[index], self.ok[index], None if self.slope is None else self.slope[index])


def blocks(pattern: BoolArray) -> tuple[tuple[IntArray, ...], tuple[IntArray, ...]]:
    """Split a square, structurally regular pattern (n, n) into its strongly connected diagonal blocks.

    Returns row indices and column indices of each, columns with few entries first: these are quickly eliminated.
    """
    column_of_row, entries = _match_rows(pattern), np.sum(pattern, axis=0)
    rows = connected_parts(pattern[:, column_of_row])
    columns = (np.sort(column_of_row[part]) for part in rows)
    return rows, tuple(part[np.argsort(entries[part], kind="stable")] for part in columns)


def _match_rows(pattern: BoolArray) -> IntArray:
    """Return a column for each row (n,), each used once and with an entry there; rows change columns if needed."""
    row_of_column = np.full(len(pattern), -1)

    def finds_place(row: int, visited: set[int]) -> bool:
        for column in np.flatnonzero(pattern[row]).tolist():
            if column in visited:
                continue
            visited.add(column)
            if row_of_column[column] < 0 or finds_place(int(row_of_column[column]), visited):
                row_of_column[column] = row
                return True
        return False

    for row in range(len(pattern)):
        finds_place(row, set())
    return np.argsort(row_of_column)


def block_signs(slope: FloatArray, rows: tuple[IntArray, ...], columns: tuple[IntArray, ...]) -> FloatArray:
    """Return the sign of the determinant of each block of C_p (n, n_passive, n_passive): (n, n_blocks)."""
    signs = np.empty((len(slope), len(rows)))
    for size in {len(row) for row in rows}:  # blocks of one size together: most robots have several of them
        alike = [k for k, row in enumerate(rows) if len(row) == size]
        row, column = (np.stack([indices[k] for k in alike]) for indices in (rows, columns))
        entries = slope[:, row[:, :, None], column[:, None]]
        signs[:, alike] = np.sign(entries[..., 0, 0] if size == 1 else np.linalg.det(entries))
    return signs
