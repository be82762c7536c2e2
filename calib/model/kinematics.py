"""Poses of frames seen from each other, and how joints and origins move them, for many configurations at once.

Everything a calibration needs is one primitive: frame b seen from frame a (`RelativeFrame`). A loop closure demands
that it is zero; a tracker measures it. With world twists V = [v; w] of the two frames (v at the world's origin), and
T_b in a written as (R_ab, p_ab):

    translation p_ab = R_a^T (p_b - p_a)      d p_ab = R_a^T [ I  -[p_b]x ] (V_b - V_a)
    log6(T_ab)                                d log6 = Jlog6(T_ab) Ad(T_b)^-1 (V_b - V_a)

Both are a (rows, 6) `map` of the twist difference, exact also where a loop is open. Joints that move both frames
alike drop out of V_b - V_a.

* A joint's column of Pinocchio's world Jacobian is its V per joint rate.
* An origin's block of Pinocchio's kinematic regressor (world frame) is its V per twist xi of the **right**
  perturbation `placement * exp6(xi)`, xi = [linear; angular] in the joint's own frame.

Pinocchio has no batch interface, so the poses are looped over in Python, through views of its data that are fetched
once; all further algebra runs on arrays of poses.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from calib.arrays import FloatArray
from calib.model.mechanism import Mechanism, RelativeFrame


@dataclass(frozen=True, eq=False)
class Sweep:
    """Kinematics of `n` configurations.

    Attributes:
        index: Position of a joint index in the second axis of `rotation` and `translation`.
        rotation: World rotation of each wanted frame, (n, n_frames, 3, 3).
        translation: World position of each wanted frame [m], (n, n_frames, 3).
        jacobian: World Jacobian, columns per joint, (n, 6, n_joints).
        leaves: Joint indices whose regressors were taken.
        regressor: World kinematic regressor of each leaf, (n, n_leaves, 6, 6 n_joints); empty if not wanted.
        compiled: What takes the place of Jacobian and regressors, if compiled code has computed the poses.
    """

    index: dict[int, int]
    rotation: FloatArray
    translation: FloatArray
    jacobian: FloatArray
    leaves: tuple[int, ...]
    regressor: FloatArray
    compiled: CompiledPoses | None = None


@dataclass(frozen=True, eq=False)
class CompiledPoses:
    """Poses of every joint, as compiled code has computed them; see `calib.model.kernels`.

    Attributes:
        functions: The compiled functions.
        tree: The model as arrays.
        found: Poses of origins and joints.
    """

    functions: Any
    tree: Any
    found: tuple[FloatArray, FloatArray, FloatArray, FloatArray]


def compiled_sweep(functions: Any, mechanism: Mechanism, joints: FloatArray, pairs: tuple[RelativeFrame, ...]) -> Sweep:
    """Return the sweep of `sweep` without Jacobian and regressors, by compiled code.

    Args:
        functions: The compiled functions.
        mechanism: The robot.
        joints: Configurations, (n, n_joints) [m or rad].
        pairs: Frames that are needed.
    """
    tree = functions.tree(mechanism, pairs)
    found = functions.poses(tree, joints)
    nothing = np.empty(0)
    index = {frame: frame for frame in range(mechanism.n_joints + 1)}
    return Sweep(index, found[2], found[3], nothing, (), nothing, CompiledPoses(functions, tree, found))


def sweep(
    mechanism: Mechanism, joints: FloatArray, pairs: tuple[RelativeFrame, ...], *, regressors: bool = False
) -> Sweep:
    """Run Pinocchio over the configurations `joints`, (n, n_joints) [m or rad].

    "World" is where the robot stands after the joints that move all frames of `pairs` alike (`Mechanism.around`).
    """
    model, moving = mechanism.around(pairs)
    joints = joints * moving
    spare = mechanism.workspaces.setdefault(pairs, [])
    try:
        space = spare.pop()  # a list, so that two threads never get the same one
    except IndexError:
        space = _Workspace.of(model, pairs)
    data, jacobian_view, translation_views = space.data, space.jacobian, space.translations
    leaves = regressor_leaves(mechanism, pairs) if regressors else ()
    n = len(joints)
    rotation = np.empty((n, len(space.frames), 3, 3))
    translation = np.empty((n, len(space.frames), 3))
    jacobian = np.empty((n, 6, model.nv))
    regressor = np.empty((n, len(leaves), 6, 6 * model.nv))
    compute, regress, world = pin.computeJointJacobians, pin.computeJointKinematicRegressor, pin.ReferenceFrame.WORLD
    for k in range(n):
        compute(model, data, joints[k])
        jacobian[k] = jacobian_view
        for f, view in enumerate(space.rotations):
            rotation[k, f] = view
            translation[k, f] = translation_views[f]
        for f, leaf in enumerate(leaves):
            regressor[k, f] = regress(model, data, leaf, world)
    spare.append(space)
    index = {frame: f for f, frame in enumerate(space.frames)}
    return Sweep(index, rotation, translation, jacobian, leaves, regressor)


@dataclass(frozen=True, eq=False)
class _Workspace:
    """Pinocchio's data and views of it, which follow every later computation; dearer to make than one pose to compute.

    Attributes:
        data: Of the model.
        frames: Joint indices of the wanted frames, in order.
        rotations, translations: World pose of each of them, (3, 3) and (3,) [m].
        jacobian: World Jacobian, (6, n_joints).
    """

    data: pin.Data
    frames: tuple[int, ...]
    rotations: tuple[FloatArray, ...]
    translations: tuple[FloatArray, ...]
    jacobian: FloatArray

    @classmethod
    def of(cls, model: pin.Model, pairs: tuple[RelativeFrame, ...]) -> _Workspace:
        data = model.createData()
        pin.computeJointJacobians(model, data, pin.neutral(model))  # sizes the views
        frames = tuple(sorted({frame for pair in pairs for frame in (pair.a, pair.b)}))
        poses = [data.oMi[frame] for frame in frames]
        return cls(data, frames, tuple(p.rotation for p in poses), tuple(p.translation for p in poses), data.J)


def regressor_leaves(mechanism: Mechanism, pairs: tuple[RelativeFrame, ...]) -> tuple[int, ...]:
    """Return frames whose regressors together cover every origin that the pairs depend on."""
    frames = {frame for pair in pairs for frame in (pair.a, pair.b)} - {0}
    support = mechanism.support
    return tuple(sorted(f for f in frames if not any(support[other, f - 1] for other in frames if other != f)))


def value(swept: Sweep, pair: RelativeFrame) -> FloatArray:
    """Return the pair's constrained components, (n, n_rows) [m, rad]."""
    if pair.full_pose:
        logs = [pin.log6(pin.SE3(pose)).vector for pose in relative_pose(swept, pair)]
        return np.array(logs).reshape(-1, 6)[:, pair.rows]
    a, b = swept.index[pair.a], swept.index[pair.b]
    offset = swept.translation[:, b] - swept.translation[:, a]
    translation: FloatArray = np.matmul(offset[:, None, :], swept.rotation[:, a])[:, 0, :]
    return translation[:, pair.rows]


def gaps(swept: Sweep, pairs: tuple[RelativeFrame, ...]) -> tuple[FloatArray, FloatArray]:
    """Return `value` and `twist_map` of several pairs, one pair's rows after the other's; faster than one by one.

    Returns:
        Constrained components (n, n_rows) [m, rad], and the map from each row's own V_b - V_a, (n, n_rows, 6).
    """
    if any(pair.full_pose for pair in pairs):
        values, maps = zip(*((value(swept, pair), twist_map(swept, pair)) for pair in pairs), strict=True)
        return np.concatenate(values, axis=1), np.concatenate(maps, axis=1)
    rows = [(swept.index[pair.a], swept.index[pair.b], row) for pair in pairs for row in pair.rows]
    a, b, axis = (list(part) for part in zip(*rows, strict=True))
    axes, at = swept.rotation.transpose(0, 1, 3, 2)[:, a, axis], swept.translation[:, b]
    components: FloatArray = np.sum(axes * (at - swept.translation[:, a]), axis=2)
    return components, np.concatenate([axes, _moments(at, axes)], axis=2)


def relative_pose(swept: Sweep, pair: RelativeFrame) -> FloatArray:
    """Return the pose of frame b in frame a, (n, 4, 4) [m]."""
    a, b = swept.index[pair.a], swept.index[pair.b]
    inverse_a = swept.rotation[:, a].transpose(0, 2, 1)
    poses = np.tile(np.eye(4), (len(inverse_a), 1, 1))
    poses[:, :3, :3] = inverse_a @ swept.rotation[:, b]
    poses[:, :3, 3] = np.einsum("nij,nj->ni", inverse_a, swept.translation[:, b] - swept.translation[:, a])
    return poses


def twist_map(swept: Sweep, pair: RelativeFrame) -> FloatArray:
    """Return the (n, n_rows, 6) map from V_b - V_a (world twists) to the derivative of `value`."""
    a, b = swept.index[pair.a], swept.index[pair.b]
    if pair.full_pose:
        return _pose_map(swept, a, b)[:, pair.rows]
    rows = swept.rotation[:, a].transpose(0, 2, 1)[:, pair.rows]
    # r^T (v + w x p) = r^T v + (p x r)^T w
    return np.concatenate([rows, _moments(swept.translation[:, b, None], rows)], axis=2)


def _moments(points: FloatArray, rows: FloatArray) -> FloatArray:
    """Return p x r for points p (n, 1 or k, 3) and rows r (n, k, 3); `np.cross` takes twice as long."""
    x, y, z = points[:, :, 0], points[:, :, 1], points[:, :, 2]
    u, v, w = rows[:, :, 0], rows[:, :, 1], rows[:, :, 2]
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=2)


def _pose_map(swept: Sweep, a: int, b: int) -> FloatArray:
    maps = np.empty((len(swept.rotation), 6, 6))
    for k in range(len(maps)):
        world_a = pin.SE3(swept.rotation[k, a], swept.translation[k, a])
        world_b = pin.SE3(swept.rotation[k, b], swept.translation[k, b])
        maps[k] = pin.Jlog6(world_a.actInv(world_b)) @ world_b.toActionMatrixInverse()
    return maps


def motion_map(swept: Sweep, pair: RelativeFrame, *, angular: bool) -> FloatArray:
    """Return the (n, 3 or 6, 6) map from V_b - V_a (world twists) to [dp; dw], the motion of b in the axes of a.

    dp = R_a^T [I  -[p_b]x] (V_b - V_a),    dw = R_a^T [0  I] (V_b - V_a)

    Args:
        swept: Of the poses.
        pair: The frames.
        angular: Whether dw is wanted too.
    """
    a, b = swept.index[pair.a], swept.index[pair.b]
    axes = swept.rotation[:, a].transpose(0, 2, 1)
    linear = np.concatenate([axes, _moments(swept.translation[:, b, None], axes)], axis=2)
    if not angular:
        return linear
    turning = np.concatenate([np.zeros_like(axes), axes], axis=2)
    return np.concatenate([linear, turning], axis=1)


def joint_derivative(swept: Sweep, mapping: FloatArray, columns: FloatArray) -> FloatArray:
    """Return d(value)/d(joint coordinates), (n, n_rows, n_columns).

    Args:
        mapping: From `twist_map`.
        columns: `mechanism.between(pair)[:, None] * selection`, (n_joints, n_columns).
    """
    n = len(mapping)
    rates = (swept.jacobian.reshape(6 * n, len(columns)) @ columns).reshape(n, 6, columns.shape[1])
    result: FloatArray = np.matmul(mapping, rates)
    return result


def origin_derivative(mechanism: Mechanism, swept: Sweep, terms: list[tuple[FloatArray, FloatArray]]) -> FloatArray:
    """Return sum over terms of map (V_b - V_a) per origin twist, (n, n_rows, 6 n_joints).

    Args:
        terms: (twist map (n, n_rows, 6), sign per joint from `Mechanism.between` (n_joints,)) of each pair.
    """
    n, n_rows = terms[0][0].shape[:2]
    result = np.zeros((n, n_rows, 6 * mechanism.n_joints))
    signs = np.array([sign for _, sign in terms])
    groups: dict[tuple[int, tuple[float, ...]], list[int]] = {}
    for origin in range(mechanism.n_joints):
        if np.any(signs[:, origin]):
            leaf = next(f for f, frame in enumerate(swept.leaves) if mechanism.support[frame, origin])
            groups.setdefault((leaf, tuple(signs[:, origin])), []).append(origin)
    for (leaf, pattern), origins in groups.items():
        combined = sum(sign * terms[t][0] for t, sign in enumerate(pattern) if sign)
        columns = (6 * np.array(origins)[:, None] + np.arange(6)).ravel()
        result[:, :, columns] = np.matmul(combined, swept.regressor[:, leaf][:, :, columns])
    return result
