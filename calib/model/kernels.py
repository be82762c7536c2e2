"""Kinematics compiled with numba: closing loops, and derivatives through them, pose by pose without Python.

The same formulas as in `calib.model.continuation`, `calib.model.kinematics` and `calib.linearisation.jacobian`, which
stay the reference and work without numba; tests hold both together to 1e-12 on every robot. What is saved is what calls
from Python cost: a closed pose of twenty joints takes a few microseconds. Loops whose directions are constrained
(type 6d) are left to the reference.

A joint i has the pose (R_i, p_i) in the world, its origin (O_i, o_i) before the joint moves; its axis is S_i = [v; w]
in the joint's own frame. World twists are [v; w] with v at the world's origin.

Compiled code is kept beside this file, or where numba may write, so that only the first program ever waits for it. All
of it is in this one file, because numba compiles again only where the file of a function has changed.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from calib.arrays import BoolArray, FloatArray, IntArray
from calib.model.mechanism import Mechanism, RelativeFrame

_compiled: Any = njit(cache=True, error_model="numpy")


class Tree(NamedTuple):
    """A model as arrays; joint 0 is the world.

    Attributes:
        parents: Joint before each, (n_joints + 1,).
        rotation, translation: Placement of each origin in its parent, (n_joints + 1, 3, 3), (n_joints + 1, 3).
        axes: S of each joint, (n_joints + 1, 6).
    """

    parents: IntArray
    rotation: FloatArray
    translation: FloatArray
    axes: FloatArray


class Loops(NamedTuple):
    """Constrained rows of all loops, one after another.

    Attributes:
        a, b: Frames of the loop that each row belongs to, (n_rows,).
        axis: Which coordinate, in the axes of a, (n_rows,).
        signs: What each joint moves: +1 only b, -1 only a, else 0, (n_rows, n_joints).
        needed: How many joints, the world included, up to the last that the loops need.
    """

    a: IntArray
    b: IntArray
    axis: IntArray
    signs: FloatArray
    needed: int


def tree(mechanism: Mechanism, pairs: tuple[RelativeFrame, ...]) -> Tree:
    """Return the model around some pairs of frames as arrays; joints that do not count there stay where they are."""
    model, moving = mechanism.around(pairs)
    placements = np.array([placement.homogeneous for placement in model.jointPlacements])
    axes = np.vstack([np.zeros(6), mechanism.axes * moving[:, None]])
    parents = np.array(model.parents.tolist(), dtype=np.intp)
    return Tree(parents, placements[:, :3, :3].copy(), placements[:, :3, 3].copy(), axes)


def loops(mechanism: Mechanism) -> Loops:
    """Return the loops of a mechanism, none of which constrains directions."""
    rows = [(loop, row) for loop in mechanism.loops for row in loop.rows]
    return Loops(
        np.array([loop.a for loop, _ in rows], dtype=np.intp),
        np.array([loop.b for loop, _ in rows], dtype=np.intp),
        np.array([row for _, row in rows], dtype=np.intp),
        np.array([mechanism.between(loop) for loop, _ in rows]).reshape(len(rows), mechanism.n_joints),
        1 + max((max(loop.a, loop.b) for loop in mechanism.loops), default=0),
    )


@_compiled
def _walk(
    tree: Tree,
    count: int,
    q: FloatArray,
    O: FloatArray,  # noqa: E741
    o: FloatArray,
    R: FloatArray,
    p: FloatArray,
) -> None:
    """Fill in the poses of the first `count` joints, the world included, in one configuration q (n_joints,)."""
    A, t, S = tree.rotation, tree.translation, tree.axes
    for r in range(3):
        for c in range(3):
            O[0, r, c] = R[0, r, c] = 1.0 if r == c else 0.0
        o[0, r] = p[0, r] = 0.0
    for i in range(1, count):
        m, angle = tree.parents[i], q[i - 1]
        for r in range(3):
            for c in range(3):
                O[i, r, c] = R[m, r, 0] * A[i, 0, c] + R[m, r, 1] * A[i, 1, c] + R[m, r, 2] * A[i, 2, c]
            o[i, r] = p[m, r] + R[m, r, 0] * t[i, 0] + R[m, r, 1] * t[i, 1] + R[m, r, 2] * t[i, 2]
        x, y, z = S[i, 3], S[i, 4], S[i, 5]
        if x == 0.0 and y == 0.0 and z == 0.0:
            for r in range(3):
                for c in range(3):
                    R[i, r, c] = O[i, r, c]
                p[i, r] = o[i, r] + angle * (O[i, r, 0] * S[i, 0] + O[i, r, 1] * S[i, 1] + O[i, r, 2] * S[i, 2])
            continue
        s, c = np.sin(angle), np.cos(angle)  # Rodrigues' formula, column by column
        v = 1.0 - c
        for r in range(3):
            d, e, f = O[i, r, 0], O[i, r, 1], O[i, r, 2]
            R[i, r, 0] = d * (c + v * x * x) + e * (v * x * y + s * z) + f * (v * x * z - s * y)
            R[i, r, 1] = d * (v * x * y - s * z) + e * (c + v * y * y) + f * (v * y * z + s * x)
            R[i, r, 2] = d * (v * x * z + s * y) + e * (v * y * z - s * x) + f * (c + v * z * z)
            p[i, r] = o[i, r]


@_compiled
def _twist(O: FloatArray, o: FloatArray, i: int, xi: FloatArray, e: int, out: FloatArray, j: int) -> None:  # noqa: E741
    """Put the world twist of xi[e] in the frame of origin i, [O v + o x O w; O w], into out[j]."""
    for r in range(3):
        out[j, r] = O[i, r, 0] * xi[e, 0] + O[i, r, 1] * xi[e, 1] + O[i, r, 2] * xi[e, 2]
        out[j, 3 + r] = O[i, r, 0] * xi[e, 3] + O[i, r, 1] * xi[e, 4] + O[i, r, 2] * xi[e, 5]
    out[j, 0] += o[i, 1] * out[j, 5] - o[i, 2] * out[j, 4]
    out[j, 1] += o[i, 2] * out[j, 3] - o[i, 0] * out[j, 5]
    out[j, 2] += o[i, 0] * out[j, 4] - o[i, 1] * out[j, 3]


@_compiled
def _row(R: FloatArray, a: int, axis: int, p: FloatArray, b: int, out: FloatArray, r: int) -> None:
    """Put what a world twist moves at p_b, along an axis x of frame a, into out[r]: [x, p x x]."""
    x, y, z = R[a, 0, axis], R[a, 1, axis], R[a, 2, axis]
    out[r, 0], out[r, 1], out[r, 2] = x, y, z
    out[r, 3] = p[b, 1] * z - p[b, 2] * y
    out[r, 4] = p[b, 2] * x - p[b, 0] * z
    out[r, 5] = p[b, 0] * y - p[b, 1] * x


@_compiled
def _dot(a: FloatArray, i: int, b: FloatArray, j: int) -> float:
    return (
        a[i, 0] * b[j, 0]
        + a[i, 1] * b[j, 1]
        + a[i, 2] * b[j, 2]
        + a[i, 3] * b[j, 3]
        + a[i, 4] * b[j, 4]
        + a[i, 5] * b[j, 5]
    )


@_compiled
def _solve(A: FloatArray, B: FloatArray) -> bool:
    """Solve A X = B in place, A (n, n) and B (n, m), by elimination with pivots; False where A is singular."""
    n, m = B.shape
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if abs(A[i, k]) > abs(A[pivot, k]):
                pivot = i
        if not abs(A[pivot, k]) > 0.0:
            return False
        if pivot != k:
            for j in range(n):
                A[k, j], A[pivot, j] = A[pivot, j], A[k, j]
            for j in range(m):
                B[k, j], B[pivot, j] = B[pivot, j], B[k, j]
        for i in range(k + 1, n):
            factor = A[i, k] / A[k, k]
            if factor != 0.0:
                for j in range(k + 1, n):
                    A[i, j] -= factor * A[k, j]
                for j in range(m):
                    B[i, j] -= factor * B[k, j]
    for j in range(m):
        for i in range(n - 1, -1, -1):
            for k in range(i + 1, n):
                B[i, j] -= A[i, k] * B[k, j]
            B[i, j] /= A[i, i]
    return True


@_compiled
def close(
    tree: Tree,
    loops: Loops,
    rest: FloatArray,
    select: FloatArray,
    motors: FloatArray,
    passive: FloatArray,
    scale: FloatArray,
    enough: float,
    largest: float,
    rounds: int,
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Newton on the passive joints, in place, as `calib.model.continuation.newton` says.

    One function, because handing all these arrays to another one costs a quarter of the time.

    Args:
        tree: The model.
        loops: What must be zero.
        rest: Joint values without the passive ones, (n, n_joints).
        select: Of the passive joints, (n_joints, n_passive).
        motors: The same of the actuated joints, (n_joints, n_actuated).
        passive: Where to start; where it ends, (n, n_passive).
        scale: By what changes of passive joints are divided, (n_passive,).
        enough: Largest residual of a closed pose.
        largest: Correction up to which a start is near.
        rounds: How many corrections.

    Returns:
        C_p (n, n_passive, n_passive) and C_a (n, n_passive, n_actuated), NaN where not closed, and which poses closed
        (n,).
    """
    n, n_passive = passive.shape
    n_joints, n_actuated = motors.shape
    by_motor = np.full((n, n_passive, n_actuated), np.nan)
    slope, closed = np.full((n, n_passive, n_passive), np.nan), np.zeros(n, dtype=np.bool_)
    O, o = np.empty((n_joints + 1, 3, 3)), np.empty((n_joints + 1, 3))  # noqa: E741
    R, p = np.empty((n_joints + 1, 3, 3)), np.empty((n_joints + 1, 3))
    twists, rows, q = np.empty((n_joints, 6)), np.empty((n_passive, 6)), np.empty(n_joints)
    values, C = np.empty((n_passive, 1)), np.empty((n_passive, n_passive))
    moves, drives = np.zeros(n_joints, dtype=np.bool_), np.zeros(n_joints, dtype=np.bool_)
    for j in range(n_joints):
        moves[j] = np.any(select[j] != 0.0) and np.any(loops.signs[:, j] != 0.0)
        drives[j] = np.any(motors[j] != 0.0) and np.any(loops.signs[:, j] != 0.0)
    for k in range(n):
        last = np.inf
        for _ in range(rounds):
            for j in range(n_joints):
                q[j] = rest[k, j]
                for c in range(n_passive if moves[j] else 0):
                    q[j] += select[j, c] * passive[k, c]
            _walk(tree, loops.needed, q, O, o, R, p)
            for j in range(n_joints):
                if moves[j]:
                    _twist(O, o, j + 1, tree.axes, j + 1, twists, j)
            C[:] = 0.0
            worst = 0.0
            for r in range(n_passive):
                a, b, axis = loops.a[r], loops.b[r], loops.axis[r]
                values[r, 0] = 0.0
                for i in range(3):
                    values[r, 0] += R[a, i, axis] * (p[b, i] - p[a, i])
                worst = max(worst, abs(values[r, 0]))
                _row(R, a, axis, p, b, rows, r)
                for j in range(n_joints):
                    if loops.signs[r, j] != 0.0 and moves[j]:
                        rate = loops.signs[r, j] * _dot(rows, r, twists, j)
                        for c in range(n_passive):
                            C[r, c] += rate * select[j, c]
            if worst <= enough:
                slope[k], by_motor[k], closed[k] = C, 0.0, True
                for j in range(n_joints):
                    if drives[j]:
                        _twist(O, o, j + 1, tree.axes, j + 1, twists, j)
                        for r in range(n_passive):
                            rate = loops.signs[r, j] * _dot(rows, r, twists, j)
                            for c in range(n_actuated):
                                by_motor[k, r, c] += rate * motors[j, c]
                break
            if not _solve(C, values):
                break
            size, limit = 0.0, max(0.5 * min(last, 2 * largest), 1e-9)
            for c in range(n_passive):
                part = abs(values[c, 0] / scale[c])
                size = max(size, part) if part <= limit else np.inf  # also where it is no number
            if size > limit:
                break
            for c in range(n_passive):
                passive[k, c] -= values[c, 0]
            last = size
    return slope, by_motor, closed


@_compiled
def poses(tree: Tree, q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return O, o, R, p of configurations q (n, n_joints): (n, n_joints + 1, 3, 3) and (n, n_joints + 1, 3), twice."""
    n, count = len(q), len(tree.parents)
    O, o = np.empty((n, count, 3, 3)), np.empty((n, count, 3))  # noqa: E741
    R, p = np.empty((n, count, 3, 3)), np.empty((n, count, 3))
    for k in range(n):
        _walk(tree, count, q[k], O[k], o[k], R[k], p[k])
    return O, o, R, p


@_compiled
def motion(
    tree: Tree,
    loops: Loops,
    found: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    mapping: FloatArray,
    signs: FloatArray,
    direct: FloatArray,
    select: FloatArray,
    slope: FloatArray,
    entries: tuple[IntArray, IntArray, FloatArray],
    width: int,
) -> FloatArray:
    """Derivative through the loops, as `calib.linearisation.jacobian` says.

    Args:
        tree: The model.
        loops: Its loops.
        found: Of `poses`.
        mapping: From V_b - V_a to what is differentiated, (n, n_rows, 6).
        signs: What each joint moves: +1 only b, -1 only a, else 0, (n_joints,).
        direct: Its derivative by the passive joints beside that, (n_rows, n_passive).
        select: Of the passive joints, (n_joints, n_passive).
        slope: C_p, (n, n_passive, n_passive).
        entries: Twists of origins along which to differentiate: joint and column of each, (n_entries,), and twist,
            (n_entries, 6).
        width: Number of columns.

    Returns:
        (n, n_rows, width).
    """
    O, o, R, p = found  # noqa: E741
    n, n_rows = mapping.shape[:2]
    n_joints, n_passive = select.shape
    result = np.zeros((n, n_rows, width))
    twist, X, transposed = np.empty((1, 6)), np.empty((n_passive, n_rows)), np.empty((n_passive, n_passive))
    rows = np.empty((n_passive, 6))
    moves = np.zeros(n_joints, dtype=np.bool_)
    for j in range(n_joints):
        moves[j] = signs[j] != 0.0 and np.any(select[j] != 0.0)
    joints, columns, twists = entries
    for k in range(n):
        Ok, ok, Rk, pk, map_k = O[k], o[k], R[k], p[k], mapping[k]
        for c in range(n_passive):
            for r in range(n_rows):
                X[c, r] = direct[r, c]
            for r in range(n_passive):
                transposed[c, r] = slope[k, r, c]
        for j in range(n_joints):
            if moves[j]:
                _twist(Ok, ok, j + 1, tree.axes, j + 1, twist, 0)
                for r in range(n_rows):
                    rate = signs[j] * _dot(map_k, r, twist, 0)
                    for c in range(n_passive):
                        X[c, r] += rate * select[j, c]
        if n_passive and not _solve(transposed, X):
            X[:] = np.nan
        for i in range(n_passive):
            _row(Rk, loops.a[i], loops.axis[i], pk, loops.b[i], rows, i)
        for e in range(len(joints)):
            j, column = joints[e], columns[e]
            _twist(Ok, ok, j + 1, twists, e, twist, 0)
            if signs[j] != 0.0:
                for r in range(n_rows):
                    result[k, r, column] += signs[j] * _dot(map_k, r, twist, 0)
            for i in range(n_passive):
                if loops.signs[i, j] != 0.0:
                    opened = loops.signs[i, j] * _dot(rows, i, twist, 0)
                    for r in range(n_rows):
                        result[k, r, column] -= X[i, r] * opened
    return result
