"""Kinematics compiled with numba: closing loops, and derivatives through them, without Python.

The same formulas as in `continuation`, `kinematics` and `jacobian` of `calib.core.robots`, which stay the reference and
work without numba; tests hold both together to 1e-12 on every robot. One pose comes after the other, joint by joint.
Loops whose directions are constrained (type 6d) are left to the reference.

A frame i has the pose T_i in the world, twelve numbers: its rotation column by column, then its position
(`calib.core.robots.mechanism.flat_poses`). Frame 0 is the world; joint i, behind an origin, moves frame i + 1; its axis
is S_i = [v; w] in its own frame. World twists are [v; w] with v at the world's origin.

Compiled code is kept beside this file, or where numba may write (`is_compiled`), so that only the first program ever
waits for it, and says so. All of it is in this one file, because numba compiles again only where the file of a function
has changed. Arrays are filled element by element: numba compiles an assignment of whole arrays with the texts of its
errors, which takes longer than all of the rest.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from calib.core.base.arrays import BoolArray, FloatArray, IntArray
from calib.core.robots.mechanism import JointSubset, Mechanism

_JIT: Any = partial(njit, error_model="numpy", fastmath={"contract"})
_compiled = _JIT(cache=True)
_part = _JIT(no_cpython_wrapper=True, no_cfunc_wrapper=True)  # of compiled functions, never called from Python


class Tree(NamedTuple):
    """The moving part of a model, as arrays.

    Attributes:
        parents: Frame before each origin, (n_joints,).
        origins: Placement of each in that frame, (n_joints, 12).
        axes: S of each joint, (n_joints, 6).
    """

    parents: IntArray
    origins: FloatArray
    axes: FloatArray


class Loops(NamedTuple):
    """Constrained rows of all loops, one after another, and the coordinates: passive joints, then actuated ones.

    Attributes:
        a, b: Frames of the loop that each row belongs to, (n_rows,).
        axis: Number of the coordinate, in the axes of a, (n_rows,).
        signs: Effect of each joint: +1 moves only b, -1 only a, else 0, (n_rows, n_joints).
        leader: Coordinate that each joint follows, or -1, (n_joints,).
        factor: Factor on that coordinate, (n_joints,).
    """

    a: IntArray
    b: IntArray
    axis: IntArray
    signs: FloatArray
    leader: IntArray
    factor: FloatArray


def tree(mechanism: Mechanism, reduced: JointSubset) -> Tree:
    """Return those joints of a mechanism that count, as arrays."""
    return Tree(reduced.parents, mechanism.placements[reduced.joints], mechanism.axes[reduced.joints])


def loops(mechanism: Mechanism, reduced: JointSubset) -> Loops:
    """Return the loops of a mechanism by its joints that count; no loop constrains directions."""
    (a, b, axis), select = mechanism.loop_rows.T, mechanism.select_moving[reduced.joints]
    factor, leader = select.sum(axis=1), np.argmax(select != 0.0, axis=1)  # a joint follows one coordinate at most
    signs = np.ascontiguousarray(mechanism.loop_signs[:, reduced.joints])
    frames = reduced.places[a], reduced.places[b], axis.copy()
    return Loops(*frames, signs, np.where(factor == 0.0, -1, leader), factor)


@_part
def _walk(tree: Tree, q: FloatArray, T: FloatArray) -> None:
    """Fill in the poses of all frames, T (n_joints + 1, 12), at joints q (n_joints,)."""
    for k in range(12):
        T[0, k] = 1.0 if k in (0, 4, 8) else 0.0
    for i in range(len(q)):
        P, S, m, f = tree.origins[i], tree.axes[i], tree.parents[i], i + 1
        turns = S[3] != 0.0 or S[4] != 0.0 or S[5] != 0.0
        s, c = (np.sin(q[i]), np.cos(q[i])) if turns else (0.0, 1.0)
        for r in range(3):
            x, y, z = T[m, r], T[m, 3 + r], T[m, 6 + r]
            d, e, g = x * P[0] + y * P[1] + z * P[2], x * P[3] + y * P[4] + z * P[5], x * P[6] + y * P[7] + z * P[8]
            along = (1.0 - c) * (S[3] * d + S[4] * e + S[5] * g)  # Rodrigues' formula
            T[f, r] = c * d + S[3] * along + s * (S[5] * e - S[4] * g)
            T[f, 3 + r] = c * e + S[4] * along + s * (S[3] * g - S[5] * d)
            T[f, 6 + r] = c * g + S[5] * along + s * (S[4] * d - S[3] * e)
            slid = q[i] * (S[0] * d + S[1] * e + S[2] * g)
            T[f, 9 + r] = T[m, 9 + r] + x * P[9] + y * P[10] + z * P[11] + slid


@_part
def _twist(T: FloatArray, i: int, xi: FloatArray, V: FloatArray) -> None:
    """Put the world twist of xi (6,) in frame i, [R v + p x R w; R w], into V (6,)."""
    for r in range(3):
        V[r] = T[i, r] * xi[0] + T[i, 3 + r] * xi[1] + T[i, 6 + r] * xi[2]
        V[3 + r] = T[i, r] * xi[3] + T[i, 3 + r] * xi[4] + T[i, 6 + r] * xi[5]
    V[0] += T[i, 10] * V[5] - T[i, 11] * V[4]
    V[1] += T[i, 11] * V[3] - T[i, 9] * V[5]
    V[2] += T[i, 9] * V[4] - T[i, 10] * V[3]


@_part
def _rows(T: FloatArray, a: IntArray, b: IntArray, axis: IntArray, rows: FloatArray) -> None:
    """Fill `rows` with the motion of each row by a world twist, at p_b along an axis x of frame a: [x, p x x]."""
    for r in range(len(a)):
        i, k = b[r], 3 * axis[r]
        x, y, z = T[a[r], k], T[a[r], k + 1], T[a[r], k + 2]
        rows[r, 0], rows[r, 1], rows[r, 2] = x, y, z
        rows[r, 3] = T[i, 10] * z - T[i, 11] * y
        rows[r, 4] = T[i, 11] * x - T[i, 9] * z
        rows[r, 5] = T[i, 9] * y - T[i, 10] * x


@_part
def _dot(row: FloatArray, V: FloatArray) -> float:
    """Return the product of six numbers with six."""
    return row[0] * V[0] + row[1] * V[1] + row[2] * V[2] + row[3] * V[3] + row[4] * V[4] + row[5] * V[5]


@_part
def _add_slopes(
    tree: Tree, loops: Loops, T: FloatArray, rows: FloatArray, signs: FloatArray, V: FloatArray, C: FloatArray
) -> None:
    """Add the derivative of rows by the first coordinates to C (n_rows, n); signs say which rows a joint moves."""
    for j in range(len(loops.leader)):
        c = loops.leader[j]
        if c < 0 or c >= C.shape[1]:
            continue
        _twist(T, j + 1, tree.axes[j], V)
        for r in range(len(rows)):
            if signs[r, j] != 0.0:
                C[r, c] += signs[r, j] * loops.factor[j] * _dot(rows[r], V)


@_part
def _solve(A: FloatArray, B: FloatArray, n: int) -> float:
    """Solve A X = B for B (n, m) in place, A (n, n) being used up; return the sign of A's determinant.

    Gauss's elimination with a pivot of each column; most entries of these matrices are zero, and left out.
    """
    sign = 1.0
    for k in range(n):
        p = k
        for i in range(k + 1, n):
            p = i if abs(A[i, k]) > abs(A[p, k]) else p
        if p != k:
            sign = -sign
            for j in range(k, n):
                A[k, j], A[p, j] = A[p, j], A[k, j]
            for j in range(B.shape[1]):
                B[k, j], B[p, j] = B[p, j], B[k, j]
        sign = sign * np.sign(A[k, k])
        for i in range(k + 1, n):
            if A[i, k] != 0.0:
                f = A[i, k] / A[k, k]
                for j in range(k + 1, n):
                    A[i, j] -= f * A[k, j]
                for j in range(B.shape[1]):
                    B[i, j] -= f * B[k, j]
    for k in range(n - 1, -1, -1):
        for i in range(k + 1, n):
            if A[k, i] != 0.0:
                for j in range(B.shape[1]):
                    B[k, j] -= A[k, i] * B[i, j]
        for j in range(B.shape[1]):
            B[k, j] /= A[k, k]
    return sign


@_part
def _is_in_mode(
    C: FloatArray, blocks: tuple[IntArray, IntArray, IntArray], signs: FloatArray, A: FloatArray, none: FloatArray
) -> bool:
    """Whether the determinant of each block of C has its sign; a block is given by rows, columns, and their ends."""
    (rows, columns, ends), start = blocks, 0
    for b in range(len(ends)):
        n = ends[b] - start
        for i in range(n):
            for j in range(n):
                A[i, j] = C[rows[start + i], columns[start + j]]
        if _solve(A, none, n) != signs[b]:
            return False
        start = ends[b]
    return True


@_compiled
def close(
    tree: Tree,
    loops: Loops,
    blocks: tuple[IntArray, IntArray, IntArray],
    signs: FloatArray,
    rest: FloatArray,
    passive: FloatArray,
    scale: FloatArray,
    enough: float,
    sure: float,
    largest: float,
    rounds: int,
    slope: FloatArray,
    by_motor: FloatArray,
    closed: BoolArray,
) -> None:
    """Newton on the passive joints, in place, as `calib.core.robots.continuation.newton` says.

    Args:
        blocks, signs: `places` and `signs` of the assembly mode.
        rest: Joint values without the passive ones, (n, n_joints).
        passive: Start values, replaced by the solution, (n, n_passive).
        scale: Divisor of changes of each passive joint, (n_passive,).
        enough, sure: Largest residual of a closed pose: computed, and predicted from the two before it (0: never).
        largest, rounds: Largest first correction from a start that is near enough, and most corrections.
        slope, by_motor: Where to put C_p and C_a of closed poses, (n, n_passive, n_passive), (n, n_passive,
            n_actuated); empty: not wanted.
        closed: Where to put the mask of the poses that closed in the assembly mode, (n,).
    """
    (n, n_passive), n_joints = passive.shape, rest.shape[1]
    T, q, V = np.empty((n_joints + 1, 12)), np.empty(n_joints), np.empty(6)
    rows, C = np.empty((n_passive, 6)), np.empty((n_passive, n_passive + (by_motor.shape[2] if len(slope) else 0)))
    A, step, none = np.empty((n_passive, n_passive)), np.empty((n_passive, 1)), np.empty((n_passive, 0))
    for k in range(n):
        last, before, ok = np.inf, 0.0, False
        for _ in range(rounds):
            for j in range(n_joints):
                c = loops.leader[j]
                q[j] = rest[k, j] + (loops.factor[j] * passive[k, c] if 0 <= c < n_passive else 0.0)
            _walk(tree, q, T)
            _rows(T, loops.a, loops.b, loops.axis, rows)
            worst = 0.0
            for r in range(n_passive):
                a, b, step[r, 0] = loops.a[r], loops.b[r], 0.0
                for e in range(3):
                    step[r, 0] += rows[r, e] * (T[b, 9 + e] - T[a, 9 + e])
                worst = max(worst, abs(step[r, 0]))
                for c in range(C.shape[1]):
                    C[r, c] = 0.0
            _add_slopes(tree, loops, T, rows, loops.signs, V, C)
            ok = worst <= enough
            if ok:
                break
            for r in range(n_passive):
                for c in range(n_passive):
                    A[r, c] = C[r, c]
            _solve(A, step, n_passive)
            size, limit = 0.0, max(0.5 * min(last, 2 * largest), 1e-9)
            for c in range(n_passive):
                part = abs(step[c, 0] / scale[c])
                size = max(size, part) if part <= limit else np.inf  # also where it is no number
            if size > limit:
                break
            for c in range(n_passive):
                passive[k, c] -= step[c, 0]
            ok = worst**3 <= sure * before**2
            if ok:
                break
            last, before = size, worst
        closed[k] = ok and _is_in_mode(C, blocks, signs, A, none)
        for r in range(n_passive if ok and len(slope) else 0):
            for c in range(n_passive):
                slope[k, r, c] = C[r, c]
            for c in range(n_passive, C.shape[1]):
                by_motor[k, r, c - n_passive] = C[r, c]


@_compiled
def poses(tree: Tree, joints: FloatArray) -> FloatArray:
    """Return the poses of all frames in configurations (n, n_joints), (n, n_joints + 1, 12)."""
    n, n_joints = joints.shape
    T = np.empty((n, n_joints + 1, 12))
    for k in range(n):
        _walk(tree, joints[k], T[k])
    return T


@_compiled
def motion(
    tree: Tree,
    loops: Loops,
    T: FloatArray,
    places: IntArray,
    signs: FloatArray,
    direct: FloatArray,
    entries: tuple[IntArray, IntArray, FloatArray],
    result: FloatArray,
) -> None:
    """Derivative through the loops, as `calib.core.robots.jacobian` says.

    Args:
        T: Result of `poses`.
        places: Frames a and b of each row, which coordinate, and whether it is a turn, not a position, (4, n_rows).
        signs: `Loops.signs` of each row, then of each row of the loops, (n_rows + n_passive, n_joints).
        direct: The further derivative of the rows by the passive joints, (n_rows, n_passive).
        entries: Twists of origins along which to differentiate: joint and column of each, (n_entries,), and twist in
            the frame before the origin, (n_entries, 6).
        result: Where to put the derivative, (n, n_rows, width).
    """
    (n, n_rows, width), n_passive, (joints, columns, twists) = result.shape, direct.shape[1], entries
    maps, gaps, V = np.empty((n_rows, 6)), np.empty((n_passive, 6)), np.empty(6)
    C, A = np.empty((n_passive, n_passive)), np.empty((n_passive, n_passive))
    B, X = np.empty((n_rows, n_passive)), np.empty((n_passive, n_rows))
    for k in range(n):
        _rows(T[k], places[0], places[1], places[2], maps)
        _rows(T[k], loops.a, loops.b, loops.axis, gaps)
        for r in range(n_rows):
            for e in range(3 if places[3, r] else 0):
                maps[r, 3 + e], maps[r, e] = maps[r, e], 0.0
            for c in range(n_passive):
                B[r, c] = direct[r, c]
            for c in range(width):
                result[k, r, c] = 0.0
        for i in range(n_passive):
            for c in range(n_passive):
                C[i, c] = 0.0
        _add_slopes(tree, loops, T[k], maps, signs, V, B)
        _add_slopes(tree, loops, T[k], gaps, loops.signs, V, C)
        for c in range(n_passive):
            for i in range(n_passive):
                A[c, i] = C[i, c]
            for r in range(n_rows):
                X[c, r] = B[r, c]
        _solve(A, X, n_passive)
        for e in range(len(joints)):
            j = joints[e]
            _twist(T[k], tree.parents[j], twists[e], V)
            for r in range(n_rows):
                if signs[r, j] != 0.0:
                    result[k, r, columns[e]] += signs[r, j] * _dot(maps[r], V)
            for i in range(n_passive):
                if loops.signs[i, j] != 0.0:
                    opened = loops.signs[i, j] * _dot(gaps[i], V)
                    for r in range(n_rows):
                        result[k, r, columns[e]] -= X[i, r] * opened


def is_compiled(function: str = "motion") -> bool:
    """Whether an earlier program has compiled a function of this version of the file, or this one has; `*` is any."""
    folder, version = Path(motion.stats.cache_path), Path(__file__).stat().st_mtime
    return any(index.stat().st_mtime >= version for index in folder.glob(f"kernels.{function}-*.nbi"))
