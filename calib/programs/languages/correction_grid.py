"""A table for controllers that can only add a correction to a position.

At the nodes of a grid of positions, all with one orientation, the table has the correction that a nominal pose needs so
that the real robot goes there: the compensated pose (`calib.programs.reaching.compensation`) minus the pose itself.
Controllers interpolate linearly between nodes. The error of this is computed at the middle of every cell and at every
row of the program that the grid is for.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
import scipy

from calib.core.base.arrays import FloatArray, ReadOnlyArrays
from calib.core.base.errors import DataError, InputError, UnreachablePoseError
from calib.core.base.words import count_noun, listing
from calib.core.robots.robot import Robot
from calib.core.rows.frames import KnownRobot
from calib.programs.languages.straight_moves import require_nominal_controller
from calib.programs.reaching.compensation import Compensation, compensate
from calib.programs.reaching.correction_frames import Calibrated, known_robot
from calib.programs.reaching.goals import Goals

_MOST = 100_000  # nodes
_ALIKE = 1e-6  # difference of equal orientations [rad]


@dataclass(frozen=True, eq=False)
class CorrectionGrid(ReadOnlyArrays):
    """Corrections at the nodes of a grid.

    Attributes:
        nodes: Positions, x slowest and z fastest, (n, 3) [m].
        shift: Correction of the position, (n, 3) [m].
        turn: Correction of the orientation: rotation vector about the axes of the measurement frame, (n, 3) [rad];
            zero if the program has no orientations.
        position_errors, angle_errors: Errors of linear interpolation at the test positions, (n_test,) [m], [rad].
        compensation: Compensation of the nodes, then of the test positions.
    """

    nodes: FloatArray
    shift: FloatArray
    turn: FloatArray
    position_errors: FloatArray
    angle_errors: FloatArray
    compensation: Compensation

    @property
    def error_before(self) -> FloatArray:
        """Errors of the calibrated robot at the nodes without corrections, (n,) [m]."""
        return self.compensation.before[: len(self.nodes)]

    @property
    def expected_error(self) -> FloatArray:
        """Root mean square distance that remains at the nodes, (n,) [m]; NaN where unknown."""
        return self.compensation.expected[: len(self.nodes)]


def correction_grid(
    calibrated: Robot | Calibrated | KnownRobot, program: Goals, counts: tuple[int, int, int]
) -> CorrectionGrid:
    """Return the corrections over the box of a program's positions.

    Args:
        calibrated: A fit, a loaded result or a robot.
        program: Positions, all with one orientation; without orientations for a robot of three joints.
        counts: Numbers of nodes along x, y and z; 1 along an axis on which the program has one coordinate.

    Raises:
        InputError: Unusable numbers of nodes, or the robot is a delta printer.
        DataError: Several orientations, or none where the correction depends on it.
        UnreachablePoseError: A node, a cell's middle or a row is out of reach.
    """
    known = known_robot(calibrated)
    require_nominal_controller(known.robot)
    orientation = _one_orientation(known.robot, program)
    axes = _axes(program.positions, counts)
    nodes = _mesh(axes)
    middles = _mesh([0.5 * (axis[1:] + axis[:-1]) if len(axis) > 1 else axis for axis in axes])
    tried = np.concatenate([middles, program.positions])
    corrections, compensation = _corrections(known, program.target, np.concatenate([nodes, tried]), orientation)
    at_nodes, exact = corrections[: len(nodes)], corrections[len(nodes) :]
    # an axis of one node does not interpolate
    long = [k for k, axis in enumerate(axes) if len(axis) > 1]
    shape = tuple(len(axes[k]) for k in long)
    linear = scipy.interpolate.RegularGridInterpolator(tuple(axes[k] for k in long), at_nodes.reshape(*shape, 6))
    off = linear(tried[:, long]) - exact
    off_position, off_angle = (np.linalg.norm(part, axis=1) for part in np.hsplit(off, 2))
    return CorrectionGrid(nodes, at_nodes[:, :3], at_nodes[:, 3:], off_position, off_angle, compensation)


def _one_orientation(robot: Robot, program: Goals) -> FloatArray | None:
    """The orientation of all rows, (3, 3); None if the program has none and the robot needs none."""
    if program.rotations is None:
        if program.directions is not None or len(robot.joint_names) > 3:
            raise DataError(
                f"{program.labels[0]}: a correction depends on the orientation; give {program.target}_rx, _ry, _rz, the"
                " same in every row"
            )
        return None
    for label, rotation in zip(program.labels, program.rotations, strict=True):
        if np.linalg.norm(pin.log3(program.rotations[0].T @ rotation)) > _ALIKE:
            raise DataError(f"{label}: has another orientation than the first row; make one grid for each orientation")
    return program.rotations[0]


def _axes(positions: FloatArray, counts: tuple[int, int, int]) -> list[FloatArray]:
    axes = []
    for axis, low, high, count in zip("xyz", positions.min(axis=0), positions.max(axis=0), counts, strict=True):
        if count < 1 or (count == 1) != (low == high):
            extends = "does not extend: 1 node" if low == high else "extends: 2 nodes or more"
            raise InputError(f"grid: {count_noun(count, 'node')} along {axis}, where the program {extends}")
        axes.append(np.linspace(low, high, count))
    if np.prod([float(count) for count in counts]) > _MOST:
        raise InputError(f"grid: more than {_MOST} nodes; take fewer; the output states the error of interpolation")
    if all(len(axis) == 1 for axis in axes):
        raise InputError("grid: the program has a single position; compensate the program itself")
    return axes


def _mesh(axes: list[FloatArray]) -> FloatArray:
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def _corrections(
    known: KnownRobot, target: str, positions: FloatArray, rotation: FloatArray | None
) -> tuple[FloatArray, Compensation]:
    """Shift [m] and turn [rad] at positions (n, 3), as (n, 6), and the compensation behind them."""
    labels = tuple("grid at x {:.4f}, y {:.4f}, z {:.4f} m".format(*position) for position in positions)
    goals = Goals(positions, labels=labels, target=target)
    if rotation is not None:
        goals = replace(goals, rotations=np.tile(rotation, (len(positions), 1, 1)))
    compensation = compensate(known, goals)
    misses = compensation.unreached_rows()
    if misses:
        raise UnreachablePoseError(
            f"{count_noun(len(misses), 'point')} of the grid cannot be reached: {listing(misses, '; ', 3)}; make it"
            f" smaller"
        )
    if compensation.nothing_to_correct:
        return np.zeros((len(positions), 6)), compensation
    sent, turned = compensation.controller_poses(known.robot)
    turns = np.zeros((len(positions), 3))
    if rotation is not None:
        turns = np.array([pin.log3(pose @ rotation.T) for pose in turned])
    return np.hstack([sent - positions, turns]), compensation
