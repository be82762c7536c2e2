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

_CHUNK_COPIED = 1 << 12  # chosen columns are copied twice


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


@one_blas_thread
def linearise(
    robot: Robot, configurations: Configurations, *, turns: bool = False, joints: bool = False
) -> Linearisation:
    """Return positions of all targets and their derivative by every parameter, at the robot's current values.

    `turns` adds the derivative of the targets' orientations, `joints` derivatives by the actuated joints.
    """
    mechanism, twists, targets = robot.mechanism, motion_twists(robot, joints=joints), robot.mechanism.targets
    n, n_targets, n_rows, width = len(configurations.actuated), len(targets), 6 if turns else 3, twists.shape[1]
    positions, both = np.empty((n, n_targets, 3)), np.empty((n, n_targets, n_rows, width))
    for part, swept in sweeps(mechanism, configurations, targets):
        for t, target in enumerate(targets):
            positions[part, t] = kinematics.value(swept, target)
        relative_motion(mechanism, swept, targets, twists, angular=turns, out=both[part])
    rows, every = both.reshape(n, n_targets * n_rows, width), np.arange(len(robot.parameters))
    first = robot.coefficients.start
    jacobian = derivative_by_parameters(robot, rows, every[:first], configurations.term_columns, every)
    by_joint = both[..., first : first + len(robot.joint_names)] if joints else None
    return Linearisation(positions, jacobian.reshape(n, n_targets, n_rows, len(every)), by_joint)


def sweeps(
    mechanism: Mechanism, configurations: Configurations, pairs: tuple[RelativeFrame, ...], *, loops: bool = True
) -> Iterator[tuple[slice, kinematics.Sweep]]:
    """Yield chunks of assembled poses and their kinematics, for these pairs of frames and, for derivatives, `loops`."""
    joints = mechanism.all_joints(configurations.actuated, configurations.passive)
    needed = pairs + mechanism.loops if loops else pairs
    shared = kinematics.SweepCache(mechanism, needed, kernels(mechanism, len(joints)))
    for part in shared.chunks(len(joints)):
        yield part, kinematics.sweep(mechanism, joints[part], needed, shared, poses_only=needed == pairs)


def relative_poses(
    mechanism: Mechanism, configurations: Configurations, pairs: tuple[RelativeFrame, ...]
) -> FloatArray:
    """Return the poses of frames b in frames a at assembled poses, (n_pairs, n, 4, 4) [m]."""
    poses = np.empty((len(configurations.actuated), len(pairs), 4, 4))
    a, b = np.array([(pair.a, pair.b) for pair in pairs], dtype=np.intp).reshape(-1, 2).T
    for part, swept in sweeps(mechanism, configurations, pairs, loops=False):
        poses[part] = kinematics.relative_pose(swept, a, b)
    return poses.swapaxes(0, 1)


def relative_motion(
    mechanism: Mechanism,
    swept: kinematics.Sweep,
    pairs: tuple[RelativeFrame, ...],
    twists: FloatArray,
    *,
    angular: bool,
    out: FloatArray | None = None,
) -> FloatArray:
    """Return d[dp; dw]/d(origin twists) of frames b seen from frames a, (n, n_pairs, 3 or 6, k).

    Args:
        twists: Combinations (6 n_joints, k) of origin twists to take the derivative along: origins in the order of
            `mechanism.origin_names`, right perturbations [linear; angular] in the joint's own frame.
        angular: Whether to include dw.
        out: Array for the result, if there is one.
    """
    rows, n = kinematics.motion_rows(swept, pairs, angular=angular), len(swept.poses)
    signs = np.repeat([mechanism.direction_signs(pair) for pair in pairs], rows.shape[1] // len(pairs), axis=0)
    result = None if out is None else out.reshape(n, rows.shape[1], -1)
    moved = _motion(swept, rows, signs, twists, np.zeros((rows.shape[1], len(mechanism.passive))), result)
    return moved.reshape(n, len(pairs), -1, moved.shape[2])


def passive_motion(
    mechanism: Mechanism, swept: kinematics.Sweep, coordinate: FloatArray, twists: FloatArray
) -> FloatArray:
    """Return d(q_j)/d(origin twists) of one joint coordinate that the loops determine, (n, 1, k).

    Args:
        coordinate: d(q_j)/d(passive joints), (n_passive,); all zero for a joint that the user commands.
        twists: Combinations to take the derivative along, (6 n_joints, k).
    """
    if not np.any(coordinate):
        return np.zeros((len(swept.poses), 1, twists.shape[1]))
    no_frames, signs = np.zeros((4, 1), dtype=np.intp), np.zeros((1, mechanism.n_joints))
    return _motion(swept, no_frames, signs, twists, coordinate[None])


def _motion(
    swept: kinematics.Sweep,
    rows: IntArray,
    signs: FloatArray,
    twists: FloatArray,
    direct: FloatArray,
    out: FloatArray | None = None,
) -> FloatArray:
    """Return dx/dxi of the module docstring, (n, n_rows, k), in `out` if that is given.

    Args:
        rows: What x is: frames and coordinates (`kinematics.motion_rows`), (4, n_rows).
        signs: Sign with which each joint moves each row, (n_rows, n_joints).
        twists: As in `relative_motion`, (6 n_joints, k).
        direct: Further derivative of x by the passive joints, (n_rows, n_passive).
    """
    shared = swept.shared
    along = shared.twist_map(twists, signs)
    result = np.empty((len(swept.poses), len(signs), along.before.shape[2])) if out is None else out
    if shared.functions is not None:
        signs = np.ascontiguousarray(along.signs)
        shared.functions.motion(shared.tree, shared.loops, swept.poses, rows, signs, direct, along.entries, result)
        return result
    mapping, through = kinematics.motion_map(swept, rows), None
    if shared.mechanism.loops:
        maps = kinematics.gap_maps(swept)
        by_passive = direct + kinematics.joint_derivative(swept, mapping, along.passive)
        slope = kinematics.joint_derivative(swept, maps, shared.passive)
        opened = np.linalg.solve(slope.transpose(0, 2, 1), by_passive.transpose(0, 2, 1)).transpose(0, 2, 1)
        through = opened, maps
    kinematics.origin_derivative(swept, mapping, through, along, result)
    return result


def motion_twists(robot: Robot, *, joints: bool = False) -> FloatArray:
    """Return twists of all origins per parameter that is no coefficient, and per driven joint, (6 n_joints, k).

    Those of a driven joint, the joint's axis at its own origin, come last, with joint terms or with `joints`.
    """
    mechanism, n = robot.mechanism, robot.n_origin_parameters
    matrix = np.zeros((6 * mechanism.n_joints, robot.coefficients.start))
    for name, twist in robot.parametrisation.twists(robot.values[:n]).items():
        row = 6 * mechanism.origin_names.index(name)
        matrix[row : row + 6, :n] = twist
    if not (joints or robot.terms):
        return matrix
    by_joint = mechanism.axes[:, :, None] * mechanism.select_actuated[:, None, :]
    return np.hstack([matrix, by_joint.reshape(len(matrix), -1)])


def derivative_by_parameters(
    robot: Robot,
    derivative: FloatArray,
    by: IntArray,
    columns: tuple[FloatArray, ...],
    index: IntArray,
    out: FloatArray | None = None,
) -> FloatArray:
    """Return the derivative by some of the parameters, (n, n_rows, n_index): a part of `derivative` itself, or new.

    Args:
        derivative: By parameters that are no coefficients, then by the driven joints, (n, n_rows, k + n_driven).
        by: Numbers of these parameters, in rising order, (k,).
        columns: phi of each joint term (`columns_of_terms`), (n, n_moved, n_coefficients) each.
        index: Numbers of the parameters, in rising order, (n_index,); coefficients, and some of `by`.
        out: Array for a new result, if there is one.
    """
    first, k = robot.coefficients.start, len(by)
    filled = int(index.searchsorted(first))
    places = by.searchsorted(index[:filled])
    assert (by[places] == index[:filled]).all()  # others are not in `derivative`
    if filled == len(index) and filled > 0 and places[-1] - places[0] == filled - 1:
        return derivative[:, :, places[0] : places[-1] + 1]
    result = np.empty((*derivative.shape[:2], len(index))) if out is None else out
    for some in kinematics.chunks(len(result), _CHUNK_COPIED):
        result[some, :, :filled] = derivative[some, :, places]
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
