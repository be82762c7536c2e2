"""Kinematics compiled with numba: closing loops, and derivatives through them, pose by pose without Python.

The same formulas as in `calib.robots.continuation`, `calib.robots.kinematics` and `calib.rows.jacobian`, which
stay the reference and work without numba; tests hold both together to 1e-12 on every robot. What is saved is what calls
from Python cost: a closed pose of twenty joints takes a few microseconds. Loops whose directions are constrained
(type 6d) are left to the reference.

A frame i has the pose T_i in the world, twelve numbers: its rotation column by column, then its position
(`calib.robots.mechanism.flat_poses`). Frame 0 is the world; joint i, behind an origin, moves frame i + 1; its axis is
S_i = [v; w] in its own frame. World twists are [v; w] with v at the world's origin.

Compiled code is kept beside this file, or where numba may write (`kept`), so that only the first program ever waits for
it, and says so. All of it is in this one file, because numba compiles again only where the file of a function has
changed. Arrays are filled element by element: numba compiles an assignment of whole arrays with the texts of its
errors, which takes longer than all of the rest.
"""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numba.core import event
from numpy.typing import NDArray

from calib.base.arrays import BoolArray, FloatArray, IntArray
from calib.robots.mechanism import Mechanism, Reduced

_LOG = logging.getLogger("calib")
_Places = NDArray[np.uintp]  # without a sign, so that compiled code need not ask whether they count from the end
_compiled: Any = njit(cache=True, error_model="numpy", fastmath={"contract"})


class _FirstUse(event.Listener):
    """Says once that functions of this file are being compiled, and not read from where they are kept."""

    def __init__(self) -> None:
        self._told = False

    def on_start(self, event: Any) -> None:
        """Say it."""
        compiled = getattr(event.data.get("dispatcher"), "py_func", None)
        if not self._told and getattr(compiled, "__module__", "") == __name__:
            self._told = True
            _LOG.warning("numba compiles the kinematics; this takes about 10 s, once for each version")

    def on_end(self, event: Any) -> None:
        """Say nothing."""


event.register("numba:compile", _FirstUse())  # type: ignore[no-untyped-call]


class Tree(NamedTuple):
    """What counts of a model, as arrays.

    Attributes:
        parents: Frame before each origin, (n_joints,).
        origins: Placement of each in that frame, (n_joints, 12).
        axes: S of each joint, (n_joints, 6).
    """

    parents: IntArray
    origins: FloatArray
    axes: FloatArray


class Loops(NamedTuple):
    """Constrained rows of all loops, one after another.

    Attributes:
        a, b: Frames of the loop that each row belongs to, (n_rows,).
        axis: Which coordinate, in the axes of a, (n_rows,).
        signs: What each joint moves: +1 only b, -1 only a, else 0, (n_rows, n_joints).
    """

    a: IntArray
    b: IntArray
    axis: IntArray
    signs: FloatArray


class Plan(NamedTuple):
    """In which order a matrix (n, n) is eliminated of which most entries are zero, whatever the other numbers are.

    Attributes:
        columns: Column of each step, (n,).
        n_rows: How many rows may have entries there, (n,).
        rows: Which they are, that of the pivot first, (n, n).
        n_others: In how many further columns, (n,).
        others: Which these are, and the right sides, (n, n + m).
    """

    columns: _Places
    n_rows: IntArray
    rows: _Places
    n_others: IntArray
    others: _Places


def tree(mechanism: Mechanism, reduced: Reduced) -> Tree:
    """Return what is left of a mechanism as arrays."""
    return Tree(reduced.parents, mechanism.placements[reduced.joints], mechanism.axes[reduced.joints])


def loops(mechanism: Mechanism, reduced: Reduced) -> Loops:
    """Return the loops of a mechanism, none of which constrains directions, in what is left of it."""
    a, b, axis = mechanism.loop_rows.T
    return Loops(reduced.places[a], reduced.places[b], axis.copy(), mechanism.loop_signs[:, reduced.joints])


@_compiled
def _walk(tree: Tree, moved: BoolArray, q: FloatArray, T: FloatArray) -> None:
    """Fill in the poses T (n_joints + 1, 12) of the frames that have moved, in one configuration q (n_joints,)."""
    P, S = tree.origins, tree.axes
    for i in range(len(q)):
        if not moved[i]:
            continue
        m, f = tree.parents[i], i + 1
        x, y, z = S[i, 3], S[i, 4], S[i, 5]
        s, c = 0.0, 1.0
        if q[i] != 0.0 and (x != 0.0 or y != 0.0 or z != 0.0):
            s, c = np.sin(q[i]), np.cos(q[i])
        v = 1.0 - c
        for r in range(3):
            j, k, l = T[m, r], T[m, 3 + r], T[m, 6 + r]  # noqa: E741
            d = j * P[i, 0] + k * P[i, 1] + l * P[i, 2]
            e = j * P[i, 3] + k * P[i, 4] + l * P[i, 5]
            g = j * P[i, 6] + k * P[i, 7] + l * P[i, 8]
            T[f, r] = d * (c + v * x * x) + e * (v * x * y + s * z) + g * (v * x * z - s * y)  # Rodrigues' formula
            T[f, 3 + r] = d * (v * x * y - s * z) + e * (c + v * y * y) + g * (v * y * z + s * x)
            T[f, 6 + r] = d * (v * x * z + s * y) + e * (v * y * z - s * x) + g * (c + v * z * z)
            slid = q[i] * (d * S[i, 0] + e * S[i, 1] + g * S[i, 2])
            T[f, 9 + r] = T[m, 9 + r] + j * P[i, 9] + k * P[i, 10] + l * P[i, 11] + slid


@_compiled
def _stand(T: FloatArray) -> None:
    """Put the world's own pose into T[0]."""
    for r in range(12):
        T[0, r] = 1.0 if r in (0, 4, 8) else 0.0


@_compiled
def _twist(T: FloatArray, i: int, xi: FloatArray, e: int, out: FloatArray, j: int) -> None:
    """Put the world twist of xi[e] in frame i, [R v + p x R w; R w], into out[j]."""
    for r in range(3):
        out[j, r] = T[i, r] * xi[e, 0] + T[i, 3 + r] * xi[e, 1] + T[i, 6 + r] * xi[e, 2]
        out[j, 3 + r] = T[i, r] * xi[e, 3] + T[i, 3 + r] * xi[e, 4] + T[i, 6 + r] * xi[e, 5]
    out[j, 0] += T[i, 10] * out[j, 5] - T[i, 11] * out[j, 4]
    out[j, 1] += T[i, 11] * out[j, 3] - T[i, 9] * out[j, 5]
    out[j, 2] += T[i, 9] * out[j, 4] - T[i, 10] * out[j, 3]


@_compiled
def _row(T: FloatArray, a: int, axis: int, b: int, out: FloatArray, r: int) -> None:
    """Put what a world twist moves at p_b, along an axis x of frame a, into out[r]: [x, p x x]."""
    x, y, z = T[a, 3 * axis], T[a, 3 * axis + 1], T[a, 3 * axis + 2]
    out[r, 0], out[r, 1], out[r, 2] = x, y, z
    out[r, 3] = T[b, 10] * z - T[b, 11] * y
    out[r, 4] = T[b, 11] * x - T[b, 9] * z
    out[r, 5] = T[b, 9] * y - T[b, 10] * x


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
def _plan(pattern: BoolArray, m: int) -> Plan:
    """Return in which order to eliminate a matrix with this pattern (n, n), which is used up, beside m right sides.

    The column with the fewest rows is next. Which of these rows has the pivot depends on the numbers, so that all of
    them count as having entries wherever one has any.
    """
    n = len(pattern)
    columns, n_rows, n_others = np.empty(n, dtype=np.uintp), np.empty(n, dtype=np.intp), np.empty(n, dtype=np.intp)
    rows, others = np.empty((n, n), dtype=np.uintp), np.empty((n, n + m), dtype=np.uintp)
    row_left, column_left = np.ones(n, dtype=np.bool_), np.ones(n, dtype=np.bool_)
    for k in range(n):
        fewest, n_rows[k], n_others[k], rows[k, 0] = n + 1, 0, 0, 0
        for c in range(n):
            count = 0
            for r in range(n):
                count += row_left[r] and pattern[r, c]
            if column_left[c] and count < fewest:
                fewest, columns[k] = count, c
        column_left[columns[k]] = False
        for r in range(n):
            if row_left[r] and pattern[r, columns[k]]:
                rows[k, n_rows[k]] = r
                n_rows[k] += 1
        for c in range(n):
            used = False
            for e in range(n_rows[k]):
                used = used or pattern[rows[k, e], c]
            if used and column_left[c]:
                others[k, n_others[k]] = c
                n_others[k] += 1
                for e in range(n_rows[k]):
                    pattern[rows[k, e], c] = True
        for j in range(m):
            others[k, n_others[k] + j] = n + j
        if n_rows[k]:
            row_left[rows[k, 0]] = False
    return Plan(columns, n_rows, rows, n_others, others)


@_compiled
def _solve(plan: Plan, A: FloatArray, X: FloatArray) -> bool:
    """Solve for X (n, m) with pivots; A is [matrix, right], (n, n + m), and used up; False where it is singular."""
    n, m = X.shape
    for k in range(n):
        c, first, n_others = plan.columns[k], plan.rows[k, 0], plan.n_others[k] + m
        pivot = first
        for e in range(1, plan.n_rows[k]):
            if abs(A[plan.rows[k, e], c]) > abs(A[pivot, c]):
                pivot = plan.rows[k, e]
        if plan.n_rows[k] == 0 or not abs(A[pivot, c]) > 0.0:
            return False
        if pivot != first:
            A[first, c], A[pivot, c] = A[pivot, c], A[first, c]
            for o in range(n_others):
                j = plan.others[k, o]
                A[first, j], A[pivot, j] = A[pivot, j], A[first, j]
        for e in range(1, plan.n_rows[k]):
            i = plan.rows[k, e]
            factor = A[i, c] / A[first, c]
            if factor != 0.0:
                for o in range(n_others):
                    A[i, plan.others[k, o]] -= factor * A[first, plan.others[k, o]]
    for k in range(n - 1, -1, -1):
        c, first = plan.columns[k], plan.rows[k, 0]
        for j in range(m):
            left = A[first, n + j]
            for o in range(plan.n_others[k]):
                left -= A[first, plan.others[k, o]] * X[plan.others[k, o], j]
            X[c, j] = left / A[first, c]
    return True


@_compiled
def _leads(select: FloatArray, signs: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return which coordinate each joint follows, or -1 where no loop feels it, and by what factor, (n_joints,)."""
    leader, factor = np.empty(len(select), dtype=np.intp), np.zeros(len(select))
    for j in range(len(select)):
        leader[j], felt = -1, False
        for r in range(len(signs)):
            felt = felt or signs[r, j] != 0.0
        for c in range(select.shape[1]):
            if select[j, c] != 0.0 and felt:
                leader[j], factor[j] = c, select[j, c]  # one at most
    return leader, factor


@_compiled
def _felt(signs: FloatArray, follows: IntArray) -> tuple[int, IntArray, IntArray]:
    """Return in how many places a joint that follows a passive one moves a row of the loops; row and joint of each."""
    count, rows, joints = 0, np.empty(signs.size, dtype=np.intp), np.empty(signs.size, dtype=np.intp)
    for r in range(signs.shape[0]):
        for j in range(signs.shape[1]):
            if follows[j] >= 0 and signs[r, j] != 0.0:
                rows[count], joints[count] = r, j
                count += 1
    return count, rows, joints


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
    slope: FloatArray,
    by_motor: FloatArray,
    closed: BoolArray,
) -> None:
    """Newton on the passive joints, in place, as `calib.robots.continuation.newton` says.

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
        slope: Where to put C_p, NaN where not closed, (n, n_passive, n_passive).
        by_motor: The same for C_a, (n, n_passive, n_actuated).
        closed: The same for which poses closed, (n,).
    """
    n, n_passive = passive.shape
    n_joints, n_actuated = motors.shape
    T, twists = np.empty((n_joints + 1, 12)), np.empty((n_joints, 6))
    rows, q = np.empty((n_passive, 6)), np.empty(n_joints)
    C, step = np.empty((n_passive, n_passive + 1)), np.empty((n_passive, 1))
    follows, factor = _leads(select, loops.signs)
    driven, gear = _leads(motors, loops.signs)
    n_felt, at_row, at_joint = _felt(loops.signs, follows)
    pattern = np.zeros((n_passive, n_passive), dtype=np.bool_)
    for e in range(n_felt):
        pattern[at_row[e], follows[at_joint[e]]] = True
    plan = _plan(pattern, 1)
    all_joints, moved = np.ones(n_joints, dtype=np.bool_), np.zeros(n_joints, dtype=np.bool_)
    for j in range(n_joints):
        before = tree.parents[j]
        moved[j] = follows[j] >= 0 or (before > 0 and moved[before - 1])
    _stand(T)
    for k in range(n):
        last, closed[k] = np.inf, False
        for j in range(n_joints):
            q[j] = rest[k, j]
        for attempt in range(rounds):
            for j in range(n_joints):
                if follows[j] >= 0:
                    q[j] = rest[k, j] + factor[j] * passive[k, follows[j]]
            _walk(tree, moved if attempt else all_joints, q, T)
            for j in range(n_joints):
                if follows[j] >= 0:
                    _twist(T, j + 1, tree.axes, j, twists, j)
            worst = 0.0
            for r in range(n_passive):
                for c in range(n_passive + 1):
                    C[r, c] = 0.0
                a, b, axis = loops.a[r], loops.b[r], loops.axis[r]
                for i in range(3):
                    C[r, n_passive] += T[a, 3 * axis + i] * (T[b, 9 + i] - T[a, 9 + i])
                worst = max(worst, abs(C[r, n_passive]))
                _row(T, a, axis, b, rows, r)
            for e in range(n_felt):
                r, j = at_row[e], at_joint[e]
                C[r, follows[j]] += loops.signs[r, j] * factor[j] * _dot(rows, r, twists, j)
            if worst <= enough:
                closed[k] = True
                for r in range(n_passive):
                    for c in range(n_passive):
                        slope[k, r, c] = C[r, c]
                    for c in range(n_actuated):
                        by_motor[k, r, c] = 0.0
                for j in range(n_joints):
                    if driven[j] >= 0:
                        _twist(T, j + 1, tree.axes, j, twists, j)
                        for r in range(n_passive):
                            if loops.signs[r, j] != 0.0:
                                by_motor[k, r, driven[j]] += loops.signs[r, j] * gear[j] * _dot(rows, r, twists, j)
                break
            if not _solve(plan, C, step):
                break
            size, limit = 0.0, max(0.5 * min(last, 2 * largest), 1e-9)
            for c in range(n_passive):
                part = abs(step[c, 0] / scale[c])
                size = max(size, part) if part <= limit else np.inf  # also where it is no number
            if size > limit:
                break
            for c in range(n_passive):
                passive[k, c] -= step[c, 0]
            last = size
        if not closed[k]:
            for r in range(n_passive):
                for c in range(n_passive):
                    slope[k, r, c] = np.nan
                for c in range(n_actuated):
                    by_motor[k, r, c] = np.nan


@_compiled
def same_signs(
    slope: FloatArray, rows: IntArray, columns: IntArray, ends: IntArray, signs: FloatArray, same: BoolArray
) -> None:
    """Leave only those poses in `same` (n,) in which the determinant of each block of C_p has its sign.

    Args:
        slope: C_p, (n, n_passive, n_passive).
        rows, columns: Of all blocks, one after another, (n_passive,).
        ends: Where each block ends, (n_blocks,).
        signs: Sign of each, (n_blocks,).
        same: Which poses to look at; which are left.
    """
    A = np.empty((len(rows), len(rows)))
    for k in range(len(slope)):
        first = 0
        for b in range(len(ends)):
            size = ends[b] - first
            for r in range(size if same[k] else 0):
                for c in range(size):
                    A[r, c] = slope[k, rows[first + r], columns[first + c]]
            same[k] = same[k] and _sign(A, size) == signs[b]
            first = ends[b]


@_compiled
def _sign(A: FloatArray, n: int) -> float:
    """Return the sign of the determinant of the first n rows and columns of A, which are used up."""
    sign = 1.0
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if abs(A[i, k]) > abs(A[pivot, k]):
                pivot = i
        if A[pivot, k] == 0.0:
            return 0.0
        if pivot != k:
            sign = -sign
            for j in range(k, n):
                A[k, j], A[pivot, j] = A[pivot, j], A[k, j]
        sign = sign if A[k, k] > 0.0 else -sign
        for i in range(k + 1, n):
            if A[i, k] != 0.0:
                factor = A[i, k] / A[k, k]
                for j in range(k + 1, n):
                    A[i, j] -= factor * A[k, j]
    return sign


@_compiled
def poses(tree: Tree, q: FloatArray) -> FloatArray:
    """Return the poses of all frames in configurations q (n, n_joints), (n, n_joints + 1, 12)."""
    n, n_joints = q.shape
    T, all_joints = np.empty((n, n_joints + 1, 12)), np.ones(n_joints, dtype=np.bool_)
    for k in range(n):
        _stand(T[k])
        _walk(tree, all_joints, q[k], T[k])
    return T


@_compiled
def motion(
    tree: Tree,
    loops: Loops,
    joint_poses: FloatArray,
    mapping: FloatArray,
    signs: FloatArray,
    direct: FloatArray,
    select: FloatArray,
    slope: FloatArray,
    entries: tuple[IntArray, IntArray, FloatArray],
    width: int,
) -> FloatArray:
    """Derivative through the loops, as `calib.rows.jacobian` says.

    Args:
        tree: The model.
        loops: Its loops.
        joint_poses: Of `poses`.
        mapping: From V_b - V_a to what is differentiated, (n, n_rows, 6).
        signs: What each joint moves: +1 only b, -1 only a, else 0; of each row, then of each row of the loops,
            (n_rows + n_passive, n_joints).
        direct: The derivative of the rows by the passive joints beside that, (n_rows, n_passive).
        select: Of the passive joints, (n_joints, n_passive).
        slope: C_p, (n, n_passive, n_passive).
        entries: Twists of origins along which to differentiate: joint and column of each, (n_entries,), one joint's
            behind each other, and twist in the frame before the origin, (n_entries, 6).
        width: Number of columns.

    Returns:
        (n, n_rows, width).
    """
    n, n_rows = mapping.shape[:2]
    n_joints, n_passive = select.shape
    result = np.zeros((n, n_rows, width))
    twist, X = np.empty((1, 6)), np.empty((n_passive, n_rows))
    transposed = np.empty((n_passive, n_passive + n_rows))  # C_p, beside it the derivative by the passive joints
    rows, total = np.empty((n_passive, 6)), np.empty((n_joints, n_rows, 6))
    joints, columns, twists = entries
    alike = np.empty(n_joints, dtype=np.intp)  # the first joint that moves what this one moves
    for j in range(n_joints):
        alike[j] = j
        for i in range(j - 1, -1, -1):
            same = True
            for r in range(len(signs)):
                same = same and signs[r, i] == signs[r, j]
            if same:
                alike[j] = alike[i]
                break
    follows, factor = _leads(select, np.ones((1, n_joints)))
    n_felt, at_row, at_joint = _felt(loops.signs, follows)
    pattern = np.zeros((n_passive, n_passive), dtype=np.bool_)
    for e in range(n_felt):
        pattern[follows[at_joint[e]], at_row[e]] = True
    plan = _plan(pattern, n_rows)
    for k in range(n):
        T, map_k = joint_poses[k], mapping[k]
        for c in range(n_passive):
            for r in range(n_rows):
                transposed[c, n_passive + r] = direct[r, c]
            for r in range(n_passive):
                transposed[c, r] = slope[k, r, c]
        for j in range(n_joints):
            if follows[j] >= 0:
                _twist(T, j + 1, tree.axes, j, twist, 0)
                for r in range(n_rows):
                    if signs[r, j] != 0.0:
                        moved = signs[r, j] * factor[j] * _dot(map_k, r, twist, 0)
                        transposed[follows[j], n_passive + r] += moved
        if n_passive and not _solve(plan, transposed, X):
            for i in range(n_passive):
                for r in range(n_rows):
                    X[i, r] = np.nan
        for i in range(n_passive):
            _row(T, loops.a[i], loops.axis[i], loops.b[i], rows, i)
        for j in range(n_joints):
            if alike[j] != j:
                continue
            for r in range(n_rows):
                for c in range(6):
                    total[j, r, c] = signs[r, j] * map_k[r, c]
            for i in range(n_passive):
                if loops.signs[i, j] != 0.0:
                    for r in range(n_rows):
                        weight = loops.signs[i, j] * X[i, r]
                        for c in range(6):
                            total[j, r, c] -= weight * rows[i, c]
        for e in range(len(joints)):
            j, column = joints[e], columns[e]
            m, a = tree.parents[j], alike[j]
            if twists[e, 3] == 0.0 and twists[e, 4] == 0.0 and twists[e, 5] == 0.0:
                x, y, z = twists[e, 0], twists[e, 1], twists[e, 2]
                u = T[m, 0] * x + T[m, 3] * y + T[m, 6] * z
                v = T[m, 1] * x + T[m, 4] * y + T[m, 7] * z
                w = T[m, 2] * x + T[m, 5] * y + T[m, 8] * z
                for r in range(n_rows):
                    result[k, r, column] += total[a, r, 0] * u + total[a, r, 1] * v + total[a, r, 2] * w
                continue
            _twist(T, m, twists, e, twist, 0)
            for r in range(n_rows):
                result[k, r, column] += _dot(total[a], r, twist, 0)
    return result


def kept() -> bool:
    """Whether an earlier program has compiled this version of the file, or this one has."""
    folder, version = Path(motion.stats.cache_path), Path(__file__).stat().st_mtime
    return any(index.stat().st_mtime >= version for index in folder.glob("kernels.motion-*.nbi"))
