"""Poses of frames seen from each other, and how joints and origins move them, for many configurations at once.

Everything a calibration needs is one primitive: frame b seen from frame a (`RelativeFrame`). A loop closure demands
that it is zero; a tracker measures it. With world twists V = [v; w] of the two frames (v at the world's origin), and
T_b in a written as (R_ab, p_ab):

    translation p_ab = R_a^T (p_b - p_a)      d p_ab = R_a^T [ I  -[p_b]x ] (V_b - V_a)
    log6(T_ab)                                d log6 = Jlog6(T_ab) Ad(T_b)^-1 (V_b - V_a)

Both are a (rows, 6) `map` of the twist difference, exact also where a loop is open. Joints that move both frames
alike drop out of V_b - V_a.

* A joint's column of Pinocchio's world Jacobian is its V per joint rate.
* A twist xi of the frame before origin i, in its own axes, is V = Ad(T_before) xi in the world. So a **right**
  perturbation `placement * exp6(xi)`, xi = [linear; angular] in the joint's own frame, is Ad(T_before placement) xi.

Pinocchio has no batch interface, so a loop in Python runs over the poses; all further algebra runs on arrays of poses.
The model has only the joints that matter (`JointSubset`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin

from calib.core.base.arrays import FloatArray, IntArray
from calib.core.robots.mechanism import JointSubset, Mechanism, RelativeFrame, flat_poses

CHUNK = 64
"""Number of poses to compute at a time: their arrays stay in the processor's cache, without new pages of memory."""
_JOINTS_AT_ONCE = 48 * CHUNK
_CHUNK_COMPILED = 256  # several times the number that compiled code computes at once; larger arrays need new pages
_AT_HOME = np.array([1.0, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0])


def chunks(n: int, size: int = CHUNK) -> Iterator[slice]:
    """Yield n poses in parts of about equal size, at most 1.5 times `size`, so that no part is small."""
    count = max(round(n / size), min(n, 1))
    for k in range(count):
        yield slice(k * n // count, (k + 1) * n // count)


def twists_in_world(swept: Sweep, joints: IntArray, twists: FloatArray) -> FloatArray:
    """Return Ad(T_before) xi, (n, 6, n_twists), of twists xi (n_twists, 6) before origins, `joints` (n_twists,)."""
    before, (n, k) = swept.shared.reduced.parents[joints], (len(swept.poses), len(joints))
    frames, at = np.unique(before, return_inverse=True)
    spread = np.zeros((len(frames), 3, 2, k))  # R xi of all frames and twists is one product
    spread[at, :, :, np.arange(k)] = twists.reshape(k, 2, 3).transpose(0, 2, 1)
    axes = swept.rotation[:, frames].transpose(0, 2, 1, 3).reshape(3 * n, 3 * len(frames))
    turned = (axes @ spread.reshape(3 * len(frames), 2 * k)).reshape(n, 3, 2, k)
    result = turned.transpose(0, 2, 1, 3).reshape(n, 6, k)
    x, y, z = swept.translation[:, before].transpose(2, 0, 1)
    u, v, w = result[:, 3:].transpose(1, 0, 2)
    result[:, 0] += y * w - z * v
    result[:, 1] += z * u - x * w
    result[:, 2] += x * v - y * u
    return result


@dataclass(frozen=True, eq=False)
class TwistMap:
    """Twists of origins along which to differentiate some rows.

    Attributes:
        twists: Combinations, (6 n_joints, k).
        signs: Sign with which each origin moves each row and each row of the loops, (n_rows + n_loop_rows, n_reduced).
        n_rows: Number of rows without those of the loops.
        before: The twists in the frames before the origins that count, (n_reduced, 6, k).
        reduced: The joints that count.
        select: E of the passive joints, (n_joints, n_passive).
    """

    twists: FloatArray
    signs: FloatArray
    n_rows: int
    before: FloatArray
    reduced: JointSubset
    select: FloatArray

    @cached_property
    def passive(self) -> Coordinates:
        """The passive joints, as they move the rows."""
        return Coordinates.from_signs(self.reduced, self.signs[: self.n_rows], self.select)

    @cached_property
    def entries(self) -> tuple[IntArray, IntArray, FloatArray]:
        """Joint and column of each twist that is not zero, (n_entries,), and the twist, (n_entries, 6)."""
        joints, columns = np.nonzero(np.any(self.before != 0.0, axis=1))
        return joints, columns, self.before[joints, :, columns]

    @cached_property
    def signs_of_entries(self) -> tuple[FloatArray, FloatArray]:
        """Sign by which each entry moves each row, (n_rows, n_entries), and each row of the loops."""
        signs = self.signs[:, self.entries[0]]
        return signs[: self.n_rows], signs[self.n_rows :]

    @cached_property
    def sums(self) -> FloatArray | None:
        """Column of each entry, as ones, (n_entries, k); None: no two share one."""
        columns, every = self.entries[1], np.arange(self.before.shape[2])
        return None if len(np.unique(columns)) == len(columns) else (columns[:, None] == every).astype(float)


@dataclass(frozen=True, eq=False)
class Coordinates:
    """Joints that follow coordinates, and the signs by which they move some rows.

    Attributes:
        joints: Place of each joint among those that count, (n_followers,).
        weights: Sign of each in each row, times its motion for one unit of its coordinate, (n_rows or 1, n_followers).
        sums: 1 where a joint follows a coordinate, else 0, (n_followers, n_coordinates); None: one each, in order.
    """

    joints: IntArray
    weights: FloatArray
    sums: FloatArray | None

    @classmethod
    def from_signs(cls, reduced: JointSubset, signs: FloatArray, select: FloatArray) -> Coordinates:
        """Return the joints that follow some coordinates.

        Args:
            signs: Effect of each joint: +1 moves only b, -1 only a, else 0, (n_rows or 1, n_reduced).
            select: E of the coordinates, (n_joints, n_coordinates).
        """
        left = select[reduced.joints]
        coordinate, joints = np.nonzero(left.T)
        every = np.arange(left.shape[1])
        sums = None if np.array_equal(coordinate, every) else (coordinate[:, None] == every).astype(float)
        return cls(joints, signs[:, joints] * left[joints, coordinate], sums)


class SweepCache:
    """Data shared by sweeps over many poses of a mechanism, for these pairs of frames, computed once.

    `functions` are the compiled ones, where these compute the poses.
    """

    def __init__(self, mechanism: Mechanism, pairs: tuple[RelativeFrame, ...], functions: Any = None) -> None:
        self.mechanism, self.functions, self._pairs = mechanism, functions, pairs
        self.reduced = mechanism.reduced_to(pairs)
        self._along: TwistMap | None = None

    @cached_property
    def pinocchio(self) -> tuple[pin.Model, pin.Data, FloatArray, FloatArray]:
        """Pinocchio's model and data, and arrays for its results.

        These are `flat_poses` of all joints, (n_joints, 12), and the Jacobian, (n_velocities, 6).
        """
        model = self.mechanism.model_around(self._pairs)
        data = pin.Data(model)
        return model, data, flat_poses(data.oMi)[1:], data.J.T

    def chunks(self, n: int) -> Iterator[slice]:
        """Yield n poses in parts small enough for the processor's cache: larger ones if few joints count."""
        few_joints = max(CHUNK, _JOINTS_AT_ONCE // max(len(self.reduced.joints), 1))
        return chunks(n, few_joints if self.functions is None else _CHUNK_COMPILED)

    @cached_property
    def passive(self) -> Coordinates:
        """The passive joints, as they move the rows of the loops."""
        return self._moving_loops(self.mechanism.select_passive)

    @cached_property
    def moving(self) -> Coordinates:
        """The passive joints, then the driven ones, as they move the rows of the loops."""
        return self._moving_loops(self.mechanism.select_moving)

    def _moving_loops(self, select: FloatArray) -> Coordinates:
        return Coordinates.from_signs(self.reduced, self.mechanism.loop_signs[:, self.reduced.joints], select)

    @cached_property
    def tree(self) -> Any:
        """The model as arrays for compiled code."""
        return self.functions.tree(self.mechanism, self.reduced)

    @cached_property
    def loops(self) -> Any:
        """Rows of all loops, as compiled code has them."""
        return self.functions.loops(self.mechanism, self.reduced)

    @cached_property
    def loop_rows(self) -> tuple[IntArray, IntArray, IntArray]:
        """Places of frames a and b, and coordinate, of each row of the loops, (n_loop_rows,)."""
        a, b, axis = self.mechanism.loop_rows.T
        return self.reduced.places[a], self.reduced.places[b], axis

    def twist_map(self, twists: FloatArray, signs: FloatArray) -> TwistMap:
        """Return a `TwistMap` of twists (6 n_joints, k) and signs (n_rows, n_joints); that of the last call is kept."""
        last, counts, n_rows = self._along, self.reduced.joints, len(signs)
        signs = np.concatenate([signs, self.mechanism.loop_signs])[:, counts]
        if last is None or last.twists is not twists or not np.array_equal(last.signs, signs):
            before = self.mechanism.twists_before(twists)[counts]
            last = self._along = TwistMap(twists, signs, n_rows, before, self.reduced, self.mechanism.select_passive)
        return last


@dataclass(frozen=True, eq=False)
class Sweep:
    """Kinematics of `n` configurations.

    Attributes:
        shared: Data shared with the sweeps of other poses.
        poses: `flat_poses` of the world, then of each frame of a joint that counts, (n, n_reduced + 1, 12).
        jacobian: World Jacobian, columns per joint that counts, (n, 6, n_reduced); None where it is not needed, as by
            compiled code.
    """

    shared: SweepCache
    poses: FloatArray
    jacobian: FloatArray | None

    @property
    def index(self) -> IntArray:
        """Position of a joint index in the second axis of `rotation` and `translation`, (n_joints + 1,)."""
        return self.shared.reduced.places

    @cached_property
    def rotation(self) -> FloatArray:
        """World rotation of each of the frames, (n, n_reduced + 1, 3, 3)."""
        n, count, _ = self.poses.shape
        return self.poses[:, :, :9].reshape(n, count, 3, 3).transpose(0, 1, 3, 2)

    @cached_property
    def translation(self) -> FloatArray:
        """World position of each of the frames [m], (n, n_reduced + 1, 3)."""
        return self.poses[:, :, 9:]

    @cached_property
    def loop_frames(self) -> tuple[FloatArray, FloatArray]:
        """Axis of each row of the loops, and position of its frame b, in the world, (n, n_loop_rows, 3)."""
        a, b, axis = self.shared.loop_rows
        return self.rotation.transpose(0, 1, 3, 2)[:, a, axis], self.translation[:, b]


def sweep(
    mechanism: Mechanism,
    joints: FloatArray,
    pairs: tuple[RelativeFrame, ...],
    shared: SweepCache | None = None,
    *,
    poses_only: bool = False,
) -> Sweep:
    """Run Pinocchio, or compiled code, over the configurations `joints`, (n, n_joints) [m or rad].

    "World" is where the robot stands after the joints that move all frames of `pairs` alike (`Mechanism.reduced_to`).

    Args:
        joints: Configurations.
        shared: Data that other sweeps for these pairs have computed.
        poses_only: Whether the Jacobian is not needed; compiled code never computes it.
    """
    shared = SweepCache(mechanism, pairs) if shared is None else shared
    if shared.functions is not None:
        return Sweep(shared, shared.functions.poses(shared.tree, joints[:, shared.reduced.joints]), None)
    model, data, seen, moved = shared.pinocchio
    n, q = len(joints), np.ascontiguousarray(joints[:, shared.reduced.joints])
    poses = np.empty((n, len(seen) + 1, 12))
    poses[:, 0] = _AT_HOME
    if poses_only:
        for at, to in zip(q, poses[:, 1:], strict=True):
            pin.forwardKinematics(model, data, at)
            to[:] = seen
        return Sweep(shared, poses, None)
    jacobian = np.empty((n, len(seen), 6))
    for at, to, to_jacobian in zip(q, poses[:, 1:], jacobian, strict=True):
        pin.computeJointJacobians(model, data, at)
        to[:], to_jacobian[:] = seen, moved
    return Sweep(shared, poses, jacobian.transpose(0, 2, 1))


def value(swept: Sweep, pair: RelativeFrame) -> FloatArray:
    """Return the pair's constrained components, (n, n_rows) [m, rad]."""
    if pair.full_pose:
        logs = [pin.log6(pin.SE3(pose)).vector for pose in relative_pose(swept, pair.a, pair.b)]
        return np.array(logs).reshape(-1, 6)[:, pair.rows]
    a, b = swept.index[pair.a], swept.index[pair.b]
    offset = swept.translation[:, b] - swept.translation[:, a]
    translation: FloatArray = np.matmul(offset[:, None, :], swept.rotation[:, a])[:, 0, :]
    return translation[:, pair.rows]


def gaps(swept: Sweep) -> FloatArray:
    """Return `value` of all loops, one loop's rows after the other's, (n, n_rows) [m, rad]; faster than one by one."""
    loops = swept.shared.mechanism.loops
    if any(loop.full_pose for loop in loops):
        return np.concatenate([value(swept, loop) for loop in loops], axis=1)
    axes, points = swept.loop_frames
    return np.einsum("nij,nij->ni", axes, points - swept.translation[:, swept.shared.loop_rows[0]])


def gap_maps(swept: Sweep) -> FloatArray:
    """Return `twist_map` of all loops, from each row's own V_b - V_a, (n, n_rows, 6); faster than one by one."""
    loops = swept.shared.mechanism.loops
    if any(loop.full_pose for loop in loops):
        return np.concatenate([twist_map(swept, loop) for loop in loops], axis=1)
    axes, points = swept.loop_frames
    return _with_moments(points, axes)


def seen_frame(swept: Sweep, a: int | IntArray, b: int | IntArray) -> tuple[FloatArray, FloatArray]:
    """Return rotation (n, 3, 3) and position (n, 3) [m] of frame b in frame a; (n, k, ...) of k pairs."""
    from_a, to_b = swept.index[a], swept.index[b]
    inverse_a = np.swapaxes(swept.rotation[:, from_a], -1, -2)
    offset = swept.translation[:, to_b] - swept.translation[:, from_a]
    return np.matmul(inverse_a, swept.rotation[:, to_b]), np.matmul(inverse_a, offset[..., None])[..., 0]


def relative_pose(swept: Sweep, a: int | IntArray, b: int | IntArray) -> FloatArray:
    """Return the pose of frame b in frame a, (n, 4, 4) [m]; (n, k, ...) of k pairs."""
    rotation, position = seen_frame(swept, a, b)
    poses = np.zeros((*position.shape[:-1], 4, 4))
    poses[..., :3, :3], poses[..., :3, 3], poses[..., 3, 3] = rotation, position, 1.0
    return poses


def twist_map(swept: Sweep, pair: RelativeFrame) -> FloatArray:
    """Return the (n, n_rows, 6) map from V_b - V_a (world twists) to the derivative of `value`."""
    a, b = swept.index[pair.a], swept.index[pair.b]
    if pair.full_pose:
        return _pose_map(swept, a, b)[:, pair.rows]
    rows = swept.rotation[:, a].transpose(0, 2, 1)[:, pair.rows]
    return _with_moments(swept.translation[:, b, None], rows)


def _with_moments(points: FloatArray, rows: FloatArray) -> FloatArray:
    """Return [r, p x r]: times a twist, the motion r^T (v + w x p) of points p (n, 1 or k, 3) along r (n, k, 3)."""
    x, y, z = points[:, :, 0], points[:, :, 1], points[:, :, 2]
    u, v, w = rows[:, :, 0], rows[:, :, 1], rows[:, :, 2]
    result = np.empty((*rows.shape[:2], 6))
    result[:, :, :3] = rows
    result[:, :, 3] = y * w - z * v  # `np.cross` takes twice as long
    result[:, :, 4] = z * u - x * w
    result[:, :, 5] = x * v - y * u
    return result


def _pose_map(swept: Sweep, a: int, b: int) -> FloatArray:
    maps = np.empty((len(swept.rotation), 6, 6))
    for k in range(len(maps)):
        world_a = pin.SE3(swept.rotation[k, a], swept.translation[k, a])
        world_b = pin.SE3(swept.rotation[k, b], swept.translation[k, b])
        maps[k] = pin.Jlog6(world_a.actInv(world_b)) @ world_b.toActionMatrixInverse()
    return maps


def motion_rows(swept: Sweep, pairs: tuple[RelativeFrame, ...], *, angular: bool) -> IntArray:
    """Return frames a and b, axis, and 1 for a turn, of each row of [dp; dw], (4, n_rows), pair by pair.

    [dp; dw] is the motion of each b in the axes of its a; without `angular`, dp alone.
    """
    every, index = range(6 if angular else 3), swept.index
    return np.array([(index[pair.a], index[pair.b], row % 3, row // 3) for pair in pairs for row in every]).T.copy()


def motion_map(swept: Sweep, rows: IntArray) -> FloatArray:
    """Return the map from V_b - V_a (world twists) to rows (4, n_rows) of `motion_rows`, (n, n_rows, 6).

    dp = R_a^T [I  -[p_b]x] (V_b - V_a),    dw = R_a^T [0  I] (V_b - V_a)
    """
    a, b, axis, turns = rows
    axes, is_turn = swept.rotation.transpose(0, 1, 3, 2)[:, a, axis], turns == 1
    result = _with_moments(swept.translation[:, b], axes)
    result[:, is_turn, :3], result[:, is_turn, 3:] = 0.0, axes[:, is_turn]
    return result


def joint_derivative(swept: Sweep, mapping: FloatArray, coordinates: Coordinates) -> FloatArray:
    """Return d(value)/d(coordinates), (n, n_rows, n_coordinates), from a `twist_map` or `motion_map` (n, n_rows, 6)."""
    assert swept.jacobian is not None  # compiled code does not come here
    moved: FloatArray = np.matmul(mapping, swept.jacobian[:, :, coordinates.joints]) * coordinates.weights
    return moved if coordinates.sums is None else moved @ coordinates.sums


def origin_derivative(
    swept: Sweep, mapping: FloatArray, loops: tuple[FloatArray, FloatArray] | None, along: TwistMap, result: FloatArray
) -> None:
    """Fill `result` (n, n_rows, k) with map (V_b - V_a) along origin twists, minus their effect through the loops.

    `loops`: by how much the opening of each loop's row moves the rows, (n, n_rows, n_loop_rows), and `gap_maps`.
    """
    n, n_rows = mapping.shape[:2]
    joints, columns, twists = along.entries
    world, (own, in_loops) = twists_in_world(swept, joints, twists), along.signs_of_entries
    moved = np.matmul(mapping, world)
    moved *= own
    if loops is not None:
        through, maps = loops
        opened = np.matmul(maps, world)
        opened *= in_loops
        moved -= np.matmul(through, opened)
    if along.sums is None:
        result.fill(0.0)
        result[:, :, columns] = moved
    else:
        np.matmul(moved.reshape(n * n_rows, -1), along.sums, out=result.reshape(n * n_rows, -1))
