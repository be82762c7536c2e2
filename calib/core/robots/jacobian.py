"""The identification Jacobian: the exact motion of frames seen from each other by parameters, through closed loops.

With passive joints p decided by the closures r(xi, p) = 0, and x a frame b seen from a frame a:

    dx/dxi = X_xi - W C_xi        W = X_p C_p^-1

(implicit function theorem), where X and C are the derivatives of x and r by origin twists xi and passive joints. W is
found first, so that one small solve per pose serves all frames and origins; then both terms are one sum of twist maps,
times the twists of each parameter at each origin, seen in the world. Moving an actuated joint by dq equals turning its
origin by dq about the joint's own axis, so derivatives by joints are columns of the same kind. x is the twist [dp; dw]
of b seen from a, in the axes of a (`calib.core.instruments.kind`): every kind of measurement is differentiated by it.
Poses are processed in chunks that stay in the processor's cache.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from calib.core.base.arrays import FloatArray, IntArray
from calib.core.base.threads import one_blas_thread
from calib.core.robots import kinematics
from calib.core.robots.acceleration import kernels
from calib.core.robots.configurations import Configurations
from calib.core.robots.joint_errors import driven_by
from calib.core.robots.mechanism import Mechanism, RelativeFrame
from calib.core.robots.robot import Robot

_CHUNK_COMPILED = 256  # several times the number that compiled code computes at once; larger arrays need new pages


@dataclass(frozen=True, eq=False)
class Linearisation:
    """Positions of the targets and their derivatives.

    Attributes:
        positions: Targets in the measurement frame, (n, n_targets, 3) [m].
        jacobian: d(positions)/d(parameters), (n, n_targets, 3, n_parameters) [m per m or rad]; with `turns` also dw of
            the targets, in the axes of the measurement frame, (n, n_targets, 6, n_parameters).
        joint_derivative: The same by the actuated joints, with `joints`.
    """

    positions: FloatArray
    jacobian: FloatArray
    joint_derivative: FloatArray | None = None


def linearise(
    robot: Robot, configurations: Configurations, *, turns: bool = False, joints: bool = False
) -> Linearisation:
    """Return positions of all targets and their derivative by every parameter, at the robot's current values.

    Args:
        configurations: Assembled poses, from `robot.assemble`.
        turns: Whether to include the derivative of the targets' orientations.
        joints: Whether to include derivatives by the actuated joints.
    """
    if not robot.terms and not joints:
        twists = parameter_twists(robot)
        return Linearisation(*origin_jacobian(robot.mechanism, configurations, twists, turns=turns))
    twists = np.hstack([parameter_twists(robot), joint_twists(robot.mechanism)])
    positions, both = origin_jacobian(robot.mechanism, configurations, twists, turns=turns)
    n, n_targets, n_rows, width = both.shape
    every = np.arange(len(robot.parameters))
    jacobian = derivative_by_parameters(robot, both.reshape(n, -1, width), configurations.term_columns, every)
    first = robot.coefficients.start
    by_joint = both[..., first : first + len(robot.joint_names)] if joints else None
    return Linearisation(positions, jacobian.reshape(n, n_targets, n_rows, -1), by_joint)


@one_blas_thread
def origin_jacobian(
    mechanism: Mechanism,
    configurations: Configurations,
    twists: FloatArray | None = None,
    *,
    turns: bool = False,
) -> tuple[FloatArray, FloatArray]:
    """Return positions of all targets and their derivative by the right-perturbation twist of every origin.

    Args:
        configurations: Assembled poses.
        twists: Combinations (6 n_joints, k) to take the derivative along instead.
        turns: Whether dw follows dp.

    Returns:
        Positions (n, n_targets, 3) [m] and derivative (n, n_targets, 3 or 6, 6 n_joints or k), origins in the order of
        `mechanism.origin_names`, six components [linear; angular] each, in the joint's own frame.
    """
    n, n_targets = len(configurations.actuated), len(mechanism.targets)
    width = 6 * mechanism.n_joints if twists is None else twists.shape[1]
    positions = np.empty((n, n_targets, 3))
    derivative = np.empty((n, n_targets, 6 if turns else 3, width))
    for part, swept in sweeps(mechanism, configurations, mechanism.targets):
        for t, target in enumerate(mechanism.targets):
            positions[part, t] = kinematics.value(swept, target)
        relative_motion(mechanism, swept, mechanism.targets, twists, angular=turns, out=derivative[part])
    return positions, derivative


def sweeps(
    mechanism: Mechanism, configurations: Configurations, pairs: tuple[RelativeFrame, ...], *, loops: bool = True
) -> Iterator[tuple[slice, kinematics.Sweep]]:
    """Yield chunks of assembled poses and their kinematics, for these pairs of frames and, for derivatives, `loops`."""
    joints = mechanism.all_joints(configurations.actuated, configurations.passive)
    needed = pairs + mechanism.loops if loops else pairs
    functions = kernels(mechanism, len(joints))
    shared = kinematics.SweepCache(mechanism, needed, functions)
    if functions is None:
        for part in kinematics.chunks(len(joints), kinematics.n_at_once(shared.reduced)):
            yield part, kinematics.sweep(mechanism, joints[part], needed, shared, poses_only=needed == pairs)
    else:
        for start in range(0, len(joints), _CHUNK_COMPILED):
            part = slice(start, min(start + _CHUNK_COMPILED, len(joints)))
            yield part, kinematics.compiled_sweep(shared, joints[part])


def relative_poses(
    mechanism: Mechanism, configurations: Configurations, pairs: tuple[RelativeFrame, ...]
) -> FloatArray:
    """Return the poses of frames b in frames a at assembled poses, (n_pairs, n, 4, 4) [m]."""
    poses = np.empty((len(pairs), len(configurations.actuated), 4, 4))
    for part, swept in sweeps(mechanism, configurations, pairs, loops=False):
        for pair, to in zip(pairs, poses, strict=True):
            to[part] = kinematics.relative_pose(swept, pair)
    return poses


def relative_motion(
    mechanism: Mechanism,
    swept: kinematics.Sweep,
    pairs: tuple[RelativeFrame, ...],
    twists: FloatArray | None,
    *,
    angular: bool,
    out: FloatArray | None = None,
) -> FloatArray:
    """Return d[dp; dw]/d(origin twists) of frames b seen from frames a, loops closed.

    Args:
        swept: Kinematics of the poses.
        twists: Combinations (6 n_joints, k) to take the derivative along; None: every origin twist.
        angular: Whether to include dw.
        out: Array for the result, if there is one.

    Returns:
        (n, n_pairs, 3 or 6, 6 n_joints or k).
    """
    each = 6 if angular else 3
    n, n_rows = len(swept.poses), each * len(pairs)
    signs = np.repeat([mechanism.direction_signs(pair) for pair in pairs], each, axis=0)
    direct, along = np.zeros((n_rows, len(mechanism.passive))), swept.shared.twist_map(twists, signs)
    result = np.empty((n, len(pairs), each, along.before.shape[2])) if out is None else out
    if swept.shared.functions is not None:
        index = swept.index
        rows = [(index[pair.a], index[pair.b], row % 3, row // 3) for pair in pairs for row in range(each)]
        _fill_motion_compiled(swept, np.array(rows).T.copy(), along, direct, result.reshape(n, n_rows, -1))
    else:
        mapping = kinematics.motion_map(swept, pairs, angular=angular)
        _fill_motion(mechanism, swept, mapping, along, direct, result.reshape(n, n_rows, -1))
    return result


def passive_motion(
    mechanism: Mechanism, swept: kinematics.Sweep, coordinate: FloatArray, twists: FloatArray
) -> FloatArray:
    """Return d(q_j)/d(origin twists) of one joint coordinate that the loops determine, (n, 1, k).

    Args:
        swept: Kinematics of the poses.
        coordinate: d(q_j)/d(passive joints), (n_passive,); all zero for a joint that the user commands.
        twists: Combinations to take the derivative along, (6 n_joints, k).
    """
    n = len(swept.rotation)
    if not np.any(coordinate):
        return np.zeros((n, 1, twists.shape[1]))
    along = swept.shared.twist_map(twists, np.zeros((1, mechanism.n_joints)))
    result = np.empty((n, 1, along.before.shape[2]))
    if swept.shared.functions is not None:
        _fill_motion_compiled(swept, np.zeros((4, 1), dtype=np.intp), along, coordinate[None], result)
    else:
        _fill_motion(mechanism, swept, np.zeros((n, 1, 6)), along, coordinate[None], result)
    return result


def _fill_motion_compiled(
    swept: kinematics.Sweep,
    rows: IntArray,
    along: kinematics.TwistMap,
    direct: FloatArray,
    result: FloatArray,
) -> None:
    """Do the same as `_fill_motion`, by compiled code; rows (4, n_rows) are frames a and b, axis, and 1 for turns."""
    shared = swept.shared
    signs = np.ascontiguousarray(along.signs)
    shared.functions.motion(shared.tree, shared.loops, swept.poses, rows, signs, direct, along.entries, result)


def _fill_motion(
    mechanism: Mechanism,
    swept: kinematics.Sweep,
    mapping: FloatArray,
    along: kinematics.TwistMap,
    direct: FloatArray,
    result: FloatArray,
) -> None:
    """Fill `result` (n, n_rows, k) with dx/dxi of the module docstring along origin twists.

    Args:
        swept: Kinematics of the poses.
        mapping: Map from V_b - V_a to x, (n, n_rows, 6).
        direct: Further derivative of x by the passive joints, (n_rows, n_passive).
        result: Array to fill.
    """
    if not mechanism.loops:
        kinematics.origin_derivative(swept, mapping, None, along, result)
        return
    maps, (of_rows, of_loops) = kinematics.gap_maps(swept), along.passive
    by_passive = direct + kinematics.joint_derivative(swept, mapping, of_rows)
    slope = kinematics.joint_derivative(swept, maps, of_loops)
    through = np.linalg.solve(slope.transpose(0, 2, 1), by_passive.transpose(0, 2, 1)).transpose(0, 2, 1)
    kinematics.origin_derivative(swept, mapping, (through, maps), along, result)


def parameter_twists(robot: Robot) -> FloatArray:
    """Return twists of all origins per parameter, without coefficients of joint terms, (6 n_joints, k)."""
    mechanism = robot.mechanism
    matrix = np.zeros((6 * mechanism.n_joints, robot.coefficients.start))
    for name, twist in robot.parametrisation.twists(robot.values[: robot.n_origin_parameters]).items():
        row = 6 * mechanism.origin_names.index(name)
        matrix[row : row + 6, : robot.n_origin_parameters] = twist
    return matrix


def derivative_by_parameters(
    robot: Robot, derivative: FloatArray, columns: tuple[FloatArray, ...], index: IntArray
) -> FloatArray:
    """Return the derivative by some of the parameters, (n, n_rows, n_index): a part of `derivative` itself, or new.

    Args:
        robot: Its joint terms belong to the columns.
        derivative: By the parameters that are no coefficients, then by the driven joints, (n, n_rows, k + n_driven).
        columns: phi of each joint term (`columns_of_terms`), (n, n_moved, n_coefficients) each.
        index: Numbers of the parameters, in rising order, (n_index,).
    """
    first = k = robot.coefficients.start
    filled = int(np.sum(index < first))
    if filled == len(index):
        every = filled > 0 and index[-1] - index[0] == filled - 1
        return derivative[:, :, index[0] : index[-1] + 1] if every else derivative[:, :, index]
    result = np.empty((*derivative.shape[:2], len(index)))  # filled in place: there may be hundreds of coefficients
    result[:, :, :filled] = derivative[:, :, index[:filled]]
    for term, phi in zip(robot.terms, columns, strict=True):
        own = index[(index >= first) & (index < first + phi.shape[2])] - first
        first += phi.shape[2]
        if len(own):
            phi = phi if len(own) == phi.shape[2] else phi[:, :, own]
            moved = k + np.array(driven_by(term, robot.mechanism), dtype=np.intp)
            part = result[:, :, filled : filled + len(own)]
            np.matmul(derivative[:, :, moved], phi, out=part)
            filled += len(own)
    return result


def joint_twists(mechanism: Mechanism) -> FloatArray:
    """Return twists of all origins per driven joint, (6 n_joints, n_driven): the joint's axis at its own origin."""
    by_joint: FloatArray = mechanism.axes[:, :, None] * mechanism.select_actuated[:, None, :]
    return by_joint.reshape(6 * mechanism.n_joints, -1)
