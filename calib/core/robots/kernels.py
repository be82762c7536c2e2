"""Kinematics compiled with numba: closing loops, and derivatives through them, without Python.

The same formulas as in `calib.core.robots.continuation`, `calib.core.robots.kinematics` and `calib.core.rows.jacobian`,
which stay the reference and work without numba; tests hold both together to 1e-12 on every robot. A closed pose of
twenty joints takes about a microsecond. Loops whose directions are constrained (type 6d) are left to the reference.

A frame i has the pose T_i in the world, twelve numbers: its rotation column by column, then its position
(`calib.core.robots.mechanism.flat_poses`). Frame 0 is the world; joint i, behind an origin, moves frame i + 1; its axis
is S_i = [v; w] in its own frame. World twists are [v; w] with v at the world's origin.

Compiled code is kept beside this file, or where numba may write (`kept`), so that only the first program ever waits for
it, and says so. All of it is in this one file, because numba compiles again only where the file of a function has
changed. Arrays are filled element by element: numba compiles an assignment of whole arrays with the texts of its
errors, which takes longer than all of the rest.

Poses are computed `_LANES` at once, each number of theirs in a row of its own, (rows, _LANES) or (rows, n). So almost
all work is in short inner loops over lanes, in which the processor computes with eight numbers at a time; numba finds
that out only where few rows meet in a loop and only one of them changes. Lanes beyond the last pose are computed, too,
and not used. Each lane has pivots of its own.
"""

from __future__ import annotations

import logging
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numba.core import event

from calib.core.base.arrays import BoolArray, FloatArray, IntArray
from calib.core.robots.closure import AssemblyMode
from calib.core.robots.mechanism import Mechanism, Reduced

_LOG = logging.getLogger("calib")
_LANES = 64
"""Poses at once, a number of one behind that of the other in memory: the processor computes with eight at a time."""
_ALL, _NONE = np.uintp(_LANES), np.uintp(0)  # without signs: compiled code need not ask whether places are negative
_JIT: Any = partial(njit, error_model="numpy", fastmath={"contract"})
_compiled = _JIT(cache=True)
_part = _JIT(no_cpython_wrapper=True, no_cfunc_wrapper=True)  # of compiled functions, never called from Python


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


class Plan(NamedTuple):
    """In which order a matrix (n, n) is eliminated of which most entries are zero, whatever the other numbers are.

    Attributes:
        columns: Column of each step, (n,).
        n_rows: How many rows may have entries there, (n,).
        rows: Which they are, that of the pivot first, (n, n).
        n_others: In how many further columns, (n,).
        others: Which these are, (n, n).
        pattern: Where entries may be, (n, n).
        block: Which block each step belongs to, (n,).
        signs: Sign of each block's determinant where that of its pivots is positive, (n_blocks,).
    """

    columns: IntArray
    n_rows: IntArray
    rows: IntArray
    n_others: IntArray
    others: IntArray
    pattern: BoolArray
    block: IntArray
    signs: FloatArray


class Loops(NamedTuple):
    """Constrained rows of all loops, one after another, and the coordinates: passive joints, then actuated ones.

    Attributes:
        a, b: Frames of the loop that each row belongs to, (n_rows,).
        axis: Which coordinate, in the axes of a, (n_rows,).
        signs: What each joint moves: +1 only b, -1 only a, else 0, (n_rows, n_joints).
        leader: Which coordinate each joint follows, or -1, (n_joints,).
        factor: And by what factor, (n_joints,).
        plan: How to solve for the passive joints.
    """

    a: IntArray
    b: IntArray
    axis: IntArray
    signs: FloatArray
    leader: IntArray
    factor: FloatArray
    plan: Plan


def tree(mechanism: Mechanism, reduced: Reduced) -> Tree:
    """Return what is left of a mechanism as arrays."""
    return Tree(reduced.parents, mechanism.placements[reduced.joints], mechanism.axes[reduced.joints])


def loops(mechanism: Mechanism, reduced: Reduced) -> Loops:
    """Return the loops of a mechanism, none of which constrains directions, in what is left of it."""
    if "loops" not in reduced.compiled:
        (a, b, axis), n_passive = mechanism.loop_rows.T, len(mechanism.passive)
        signs, select = mechanism.loop_signs[:, reduced.joints], mechanism.select_moving[reduced.joints]
        leads = np.argmax(select != 0.0, axis=1), select.sum(axis=1)  # of one coordinate at most
        leader = np.where(leads[1] == 0.0, -1, leads[0])
        pattern, every = np.abs(signs) @ np.abs(select[:, :n_passive]) > 0.0, np.arange(n_passive)
        frames = reduced.places[a], reduced.places[b], axis.copy()
        plan = _plan(pattern, (every,), (every,))
        reduced.compiled["loops"] = Loops(*frames, np.ascontiguousarray(signs), leader, leads[1], plan)
    kept: Loops = reduced.compiled["loops"]
    return kept


def blocks(mode: AssemblyMode, reduced: Reduced, loops: Loops) -> Plan:
    """Return how to find the signs of the blocks of C_p by which the assembly mode is told."""
    if mode not in reduced.compiled:
        inside = np.zeros_like(loops.plan.pattern)
        for rows, columns in zip(mode.block_rows, mode.block_columns, strict=True):
            inside[np.ix_(rows, columns)] = True
        reduced.compiled[mode] = _plan(loops.plan.pattern & inside, mode.block_rows, mode.block_columns)
    kept: Plan = reduced.compiled[mode]
    return kept


def _plan(pattern: BoolArray, block_rows: tuple[IntArray, ...], block_columns: tuple[IntArray, ...]) -> Plan:
    """Return in which order to eliminate a matrix with this pattern (n, n), all entries of which are in blocks.

    The column with the fewest rows is next. Which of these rows has the pivot depends on the numbers, so that all of
    them count as having entries wherever one has any.
    """
    n, fill = len(pattern), pattern.copy()
    columns, n_rows, n_others, block = (np.zeros(n, dtype=np.intp) for _ in range(4))
    rows, others = np.zeros((n, max(n, 1)), dtype=np.intp), np.zeros((n, n), dtype=np.intp)
    row_left, column_left = np.ones(n, dtype=bool), np.ones(n, dtype=bool)
    for k in range(n):
        columns[k] = np.argmin(np.where(column_left, np.sum(fill & row_left[:, None], axis=0), n + 1))
        column_left[columns[k]] = False
        has = np.flatnonzero(row_left & fill[:, columns[k]])
        further = np.flatnonzero(column_left & np.any(fill[has], axis=0))
        fill[np.ix_(has, further)] = True
        n_rows[k], n_others[k] = len(has), len(further)
        rows[k, : len(has)], others[k, : len(further)] = has, further
        row_left[has[:1]] = False
    signs = np.ones(len(block_rows))
    for b, (of_rows, of_columns) in enumerate(zip(block_rows, block_columns, strict=True)):
        steps = np.flatnonzero(np.isin(columns, of_columns))
        block[steps] = b
        for order, own in ((rows[steps, 0], of_rows), (columns[steps], of_columns)):
            at = np.argsort(own)[np.searchsorted(np.sort(own), order)]
            signs[b] *= (-1.0) ** np.sum(np.triu(at[:, None] > at))
    return Plan(columns, n_rows, rows, n_others, others, pattern, block, signs)


@_part
def _sines(tree: Tree, q: FloatArray, s: FloatArray, c: FloatArray) -> None:
    """Fill in sines and cosines of joints q (n_joints, _LANES) that turn; 0 and 1 of those that slide.

    By the polynomials of Sun's fdlibm (k_sin.c, k_cos.c) for what is left of an angle beside quarters of a turn, which
    are taken off in three parts, so that eight angles are computed at once; both are correct to a rounding or two.
    """
    for j in range(len(q)):
        turns, far = tree.axes[j, 3] != 0.0 or tree.axes[j, 4] != 0.0 or tree.axes[j, 5] != 0.0, 0
        for lane in range(_ALL):
            far += abs(q[j, lane]) > 1e4
        if far or not turns:
            for lane in range(_ALL):
                s[j, lane], c[j, lane] = (np.sin(q[j, lane]), np.cos(q[j, lane])) if turns else (0.0, 1.0)
            continue
        for lane in range(_ALL):
            k = np.rint(q[j, lane] * 0.6366197723675814)
            x = ((q[j, lane] - k * 1.5707963267341256) - k * 6.077100506303966e-11) - k * 2.0222662487959506e-21
            z = x * x
            odd = 8.33333333332248946124e-03 + z * (
                -1.98412698298579493134e-04
                + z * (2.75573137070700676789e-06 + z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10))
            )
            even = -1.38888888888741095749e-03 + z * (
                2.48015872894767294178e-05
                + z * (-2.75573143513906633035e-07 + z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11))
            )
            sine = x + x * z * (-1.66666666666666324348e-01 + z * odd)
            cosine = 1.0 - 0.5 * z + z * z * (4.16666666666666019037e-02 + z * even)
            quarter = k - 4.0 * np.floor(k * 0.25)
            across = quarter == 1.0 or quarter == 3.0
            a, b = (cosine, sine) if across else (sine, cosine)
            s[j, lane] = -a if quarter >= 2.0 else a
            c[j, lane] = -b if quarter == 1.0 or quarter == 2.0 else b


@_part
def _walk(
    tree: Tree,
    moved: BoolArray,
    joints: tuple[FloatArray, FloatArray, FloatArray],
    T: FloatArray,
    at: int,
    D: FloatArray,
) -> None:
    """Fill in the poses of the frames that have moved, T (12 n_joints + 12, n), from `at` on.

    Args:
        tree: The model.
        moved: Which joints have moved, (n_joints,).
        joints: Their values, sines and cosines, (n_joints, _LANES) each.
        T: The poses.
        at: Of T, where to begin.
        D: Space, (5, _LANES).
    """
    P, S, (q, s, c) = tree.origins, tree.axes, joints
    for i in range(len(q)):
        if not moved[i]:
            continue
        m, f = 12 * tree.parents[i], 12 * (i + 1)
        for r in range(3):
            for k in range(4):
                x, y, z = P[i, 3 * k], P[i, 3 * k + 1], P[i, 3 * k + 2]
                for lane in range(_ALL):
                    D[k, lane] = T[m + r, at + lane] * x + T[m + 3 + r, at + lane] * y + T[m + 6 + r, at + lane] * z
            x, y, z = S[i, 3], S[i, 4], S[i, 5]
            for lane in range(_ALL):
                D[4, lane] = (1.0 - c[i, lane]) * (x * D[0, lane] + y * D[1, lane] + z * D[2, lane])
            for k in range(3):  # Rodrigues' formula
                d, e = (k + 1) % 3, (k + 2) % 3
                x, y, z = S[i, 3 + k], S[i, 3 + d], S[i, 3 + e]
                for lane in range(_ALL):
                    T[f + 3 * k + r, at + lane] = (
                        c[i, lane] * D[k, lane] + x * D[4, lane] + s[i, lane] * (z * D[d, lane] - y * D[e, lane])
                    )
            x, y, z = S[i, 0], S[i, 1], S[i, 2]
            for lane in range(_ALL):
                slid = q[i, lane] * (x * D[0, lane] + y * D[1, lane] + z * D[2, lane])
                T[f + 9 + r, at + lane] = T[m + 9 + r, at + lane] + D[3, lane] + slid


@_part
def _stand(T: FloatArray) -> None:
    """Put the world's own pose into the first twelve rows of T."""
    for r in range(12):
        for lane in range(T.shape[1]):
            T[r, lane] = 1.0 if r in (0, 4, 8) else 0.0


@_part
def _seen(T: FloatArray, i: int, at: int, xi: FloatArray, e: int, k: int, out: FloatArray) -> None:
    """Put the vector in columns k of xi[e], seen from the world instead of frame i, into rows k of out."""
    x, y, z = xi[e, k], xi[e, k + 1], xi[e, k + 2]
    for r in range(3):
        for lane in range(_ALL):
            out[k + r, lane] = (
                T[12 * i + r, at + lane] * x + T[12 * i + 3 + r, at + lane] * y + T[12 * i + 6 + r, at + lane] * z
            )


@_part
def _add_moment(T: FloatArray, i: int, at: int, a: FloatArray, j: int, o: int) -> None:
    """Add p x a to rows o of a, p being where frame i is, and a the vector in rows j."""
    for r in range(3):
        y, z = (r + 1) % 3, (r + 2) % 3
        p, w = 12 * i + 9 + y, 12 * i + 9 + z
        for lane in range(_ALL):
            a[o + r, lane] += T[p, at + lane] * a[j + z, lane] - T[w, at + lane] * a[j + y, lane]


@_part
def _twist(T: FloatArray, i: int, at: int, xi: FloatArray, e: int, count: int, out: FloatArray) -> None:
    """Put the world twist of xi[e] in frame i, [R v + p x R w; R w], into out; of 3 numbers if w is 0, else of 6."""
    for k in range(0, count, 3):
        _seen(T, i, at, xi, e, k, out)
    if count > 3:
        _add_moment(T, i, at, out, np.intp(3), np.intp(0))  # of one type, so that it is compiled once


@_part
def _rows(rows: Loops, T: FloatArray, at: int, out: FloatArray) -> None:
    """Put what a world twist moves in each row, at p_b along an axis x of frame a, into out: [x, p x x]."""
    for i in range(len(rows.a)):
        for r in range(3):
            x = 12 * rows.a[i] + 3 * rows.axis[i] + r
            for lane in range(_ALL):
                out[6 * i + r, lane] = T[x, at + lane]
                out[6 * i + 3 + r, lane] = 0.0
        _add_moment(T, rows.b[i], at, out, 6 * i, 6 * i + 3)


@_part
def _add_dot(g: float, a: FloatArray, i: int, b: FloatArray, count: int, out: FloatArray, o: int) -> None:
    """Add g times the product of the first `count` numbers, 3 or 6, in rows i of a and in b, to row o of out."""
    for k in range(0, count, 3):
        for lane in range(_ALL):
            out[o, lane] += g * (
                a[i + k, lane] * b[k, lane] + a[i + k + 1, lane] * b[k + 1, lane] + a[i + k + 2, lane] * b[k + 2, lane]
            )


@_part
def _swap(A: FloatArray, i: int, j: int, larger: FloatArray, s: int) -> None:
    """Exchange rows i and j of A in those lanes of which larger[s] is not 0."""
    for lane in range(_ALL):
        a, b = A[i, lane], A[j, lane]
        A[i, lane] = b if larger[s, lane] != 0.0 else a
        A[j, lane] = a if larger[s, lane] != 0.0 else b


@_part
def _factor(plan: Plan, A: FloatArray, width: int, larger: FloatArray, sign: FloatArray) -> None:
    """Eliminate matrices A, each lane with pivots of its own; what is left of them serves to solve.

    Args:
        plan: The order.
        A: Row by row, (n width, _LANES). Then what rows are multiplied with, and the pivots' inverses, which are not
            finite where a matrix is singular.
        width: How many columns there are, those behind the matrix (n, n) with them.
        larger: Where rows have changed places, one after the other, (at most n^2 / 2, _LANES).
        sign: Sign of each block's determinant, but for `Plan.signs`, (n_blocks, _LANES).
    """
    s = np.intp(0)
    for b in range(len(plan.signs)):
        for lane in range(_ALL):
            sign[b, lane] = 1.0
    for k in range(len(plan.columns)):
        c, first, b = plan.columns[k], width * plan.rows[k, 0], plan.block[k]
        for e in range(1, plan.n_rows[k]):
            i, count = width * plan.rows[k, e], 0
            for lane in range(_ALL):
                exchange = abs(A[i + c, lane]) > abs(A[first + c, lane])
                larger[s, lane] = 1.0 if exchange else 0.0
                count += exchange
            for o in range(-1, plan.n_others[k] if count else -1):
                j = plan.others[k, o] if o >= 0 else c
                _swap(A, first + j, i + j, larger, s)
            for lane in range(_ALL):
                sign[b, lane] *= 1.0 - 2.0 * larger[s, lane]
            s += 1
        for lane in range(_ALL):
            pivot = A[first + c, lane] if plan.n_rows[k] else 0.0
            sign[b, lane] *= 1.0 if pivot > 0.0 else (-1.0 if pivot < 0.0 else 0.0)
            A[first + c, lane] = 1.0 / pivot
        for e in range(1, plan.n_rows[k]):
            i = width * plan.rows[k, e]
            for lane in range(_ALL):
                A[i + c, lane] *= A[first + c, lane]
            for o in range(plan.n_others[k]):
                j = plan.others[k, o]
                for lane in range(_ALL):
                    A[i + j, lane] -= A[i + c, lane] * A[first + j, lane]


@_part
def _solve(plan: Plan, A: FloatArray, width: int, larger: FloatArray, b: FloatArray, x: FloatArray) -> None:
    """Solve A x = b (n, _LANES), with A, its width and `larger` of `_factor`; b is used up."""
    n, s = len(plan.columns), np.intp(0)
    for k in range(n):
        c, first = plan.columns[k], plan.rows[k, 0]
        for e in range(1, plan.n_rows[k]):
            _swap(b, first, plan.rows[k, e], larger, s)
            s += 1
        for e in range(1, plan.n_rows[k]):
            i = plan.rows[k, e]
            for lane in range(_ALL):
                b[i, lane] -= A[width * i + c, lane] * b[first, lane]
    for k in range(n - 1, -1, -1):
        c, first = plan.columns[k], plan.rows[k, 0]
        for o in range(plan.n_others[k]):
            j = plan.others[k, o]
            for lane in range(_ALL):
                b[first, lane] -= A[width * first + j, lane] * x[j, lane]
        for lane in range(_ALL):
            x[c, lane] = b[first, lane] * A[width * first + c, lane]


@_part
def _solve_left(plan: Plan, A: FloatArray, larger: FloatArray, b: FloatArray, x: FloatArray, m: int) -> None:
    """Solve X A = B for m rows of X, each (m n, _LANES) column by column; b is used up."""
    n, s = len(plan.columns), np.intp(0)
    for k in range(n):
        c, first = plan.columns[k], plan.rows[k, 0]
        s += max(plan.n_rows[k] - 1, 0)
        for r in range(m):
            for lane in range(_ALL):
                x[m * first + r, lane] = b[m * c + r, lane] * A[n * first + c, lane]
            for o in range(plan.n_others[k]):
                j = plan.others[k, o]
                for lane in range(_ALL):
                    b[m * j + r, lane] -= x[m * first + r, lane] * A[n * first + j, lane]
    for k in range(n - 1, -1, -1):
        c, first = plan.columns[k], plan.rows[k, 0]
        for e in range(plan.n_rows[k] - 1, 0, -1):
            i = plan.rows[k, e]
            for r in range(m):
                for lane in range(_ALL):
                    x[m * first + r, lane] -= A[n * i + c, lane] * x[m * i + r, lane]
        for e in range(plan.n_rows[k] - 1, 0, -1):
            s -= 1
            for r in range(m):
                _swap(x, m * first + r, m * plan.rows[k, e] + r, larger, s)


@_part
def _slopes(
    tree: Tree,
    loops: Loops,
    T: FloatArray,
    at: int,
    width: int,
    first: int,
    rows: FloatArray,
    twist: FloatArray,
    C: FloatArray,
) -> None:
    """Fill in the derivative of the loops by the first coordinates, row by row.

    Args:
        tree, loops, T: The model, its loops, and where its frames are.
        at: Of T, where to begin.
        width: How many coordinates there are.
        first: By how many of them to differentiate.
        rows: Space for what twists move, (6 n_rows, _LANES).
        twist: The same for a twist, (6, _LANES).
        C: The derivative, (n_rows width, _LANES).
    """
    _rows(loops, T, at, rows)
    for r in range(len(C)):
        for lane in range(_ALL):
            C[r, lane] = 0.0
    for j in range(len(loops.leader)):
        if loops.leader[j] < 0 or loops.leader[j] >= first:
            continue
        _twist(T, j + 1, at, tree.axes, j, len(twist), twist)
        for r in range(len(loops.a)):
            if loops.signs[r, j] != 0.0:
                g, o = loops.signs[r, j] * loops.factor[j], r * width + loops.leader[j]
                _add_dot(g, rows, 6 * r, twist, len(twist), C, o)


@_compiled
def close(
    tree: Tree,
    loops: Loops,
    blocks: Plan,
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
        tree: The model.
        loops: What must be zero.
        blocks, signs: By which signs the assembly mode is told, (n_blocks,), and how to find them.
        rest: Joint values without the passive ones, (n, n_joints).
        passive: Where to start; where it ends, (n, n_passive).
        scale: By what changes of passive joints are divided, (n_passive,).
        enough: Largest residual of a closed pose.
        sure: Largest residual that is not computed but known from two before it; 0: none.
        largest: Correction up to which a start is near.
        rounds: How many corrections.
        slope: Where to put C_p of closed poses, (n, n_passive, n_passive); empty: not wanted.
        by_motor: The same for C_a, (n, n_passive, n_actuated).
        closed: The same for which poses closed in the assembly mode, (n,).
    """
    (n, n_passive), n_joints, n_actuated = passive.shape, rest.shape[1], by_motor.shape[2]
    width = n_passive + n_actuated
    T, D, twist = np.empty((12 * n_joints + 12, _LANES)), np.empty((5, _LANES)), np.empty((6, _LANES))
    q, s, c = np.zeros((n_joints, _LANES)), np.empty((n_joints, _LANES)), np.empty((n_joints, _LANES))
    rows, C = np.empty((6 * n_passive, _LANES)), np.empty((n_passive * width, _LANES))
    found = np.zeros((n_passive * width, _LANES))
    larger, sign = np.empty((n_passive * n_passive, _LANES)), np.empty((n_passive, _LANES))
    gap, step = np.zeros((n_passive, _LANES)), np.zeros((n_passive, _LANES))
    worst, last, before = np.empty((1, _LANES)), np.empty((1, _LANES)), np.empty((1, _LANES))
    left, known = np.empty(_LANES, dtype=np.bool_), np.empty(_LANES, dtype=np.bool_)
    anyway = np.ones(n_joints, dtype=np.bool_)
    moved = np.zeros(n_joints, dtype=np.bool_)
    for j in range(n_joints):
        parent = tree.parents[j]
        moved[j] = 0 <= loops.leader[j] < n_passive or (parent > 0 and moved[parent - 1])
    _stand(T)
    for start in range(0, n, _LANES):
        at, lanes = np.uintp(start), np.uintp(min(_LANES, n - start))
        for lane in range(lanes):
            last[0, lane], before[0, lane], left[lane], closed[at + lane] = np.inf, 0.0, True, False
            for j in range(n_joints):
                q[j, lane] = rest[at + lane, j]
        for attempt in range(rounds):
            for j in range(n_joints):
                if 0 <= loops.leader[j] < n_passive:
                    for lane in range(lanes):
                        q[j, lane] = rest[at + lane, j] + loops.factor[j] * passive[at + lane, loops.leader[j]]
            _sines(tree, q, s, c)
            _walk(tree, moved if attempt else anyway, (q, s, c), T, _NONE, D)
            for lane in range(_ALL):
                worst[0, lane] = 0.0
            for r in range(n_passive):
                x, a, b = 12 * loops.a[r] + 3 * loops.axis[r], 12 * loops.a[r] + 9, 12 * loops.b[r] + 9
                for lane in range(_ALL):
                    gap[r, lane] = 0.0
                for k in range(3):
                    for lane in range(_ALL):
                        gap[r, lane] += T[x + k, lane] * (T[b + k, lane] - T[a + k, lane])
                for lane in range(_ALL):
                    worst[0, lane] = max(worst[0, lane], abs(gap[r, lane]))
            _slopes(tree, loops, T, _NONE, width, width if len(slope) else n_passive, rows, twist, C)
            some, more = False, False
            for lane in range(lanes):
                small = worst[0, lane] <= enough
                known[lane] = left[lane] and (small or worst[0, lane] ** 3 <= sure * before[0, lane] ** 2)
                closed[at + lane], left[lane] = closed[at + lane] or (left[lane] and small), left[lane] and not small
                before[0, lane], some, more = worst[0, lane], some or known[lane], more or left[lane]
            for r in range(len(C) if some else 0):
                for lane in range(_ALL):
                    found[r, lane] = C[r, lane] if known[lane] else found[r, lane]
            if not more:
                break
            _factor(loops.plan, C, width, larger, sign)
            _solve(loops.plan, C, width, larger, gap, step)
            more = False
            for lane in range(lanes):
                size, limit = 0.0, max(0.5 * min(last[0, lane], 2 * largest), 1e-9)
                for k in range(n_passive if left[lane] else 0):
                    part = abs(step[k, lane] / scale[k])
                    size = max(size, part) if part <= limit else np.inf  # also where it is no number
                left[lane] = left[lane] and size <= limit
                for k in range(n_passive if left[lane] else 0):
                    passive[at + lane, k] -= step[k, lane]
                closed[at + lane] = closed[at + lane] or (left[lane] and known[lane])
                left[lane] = left[lane] and not known[lane]
                last[0, lane], more = size, more or left[lane]
            if not more:
                break
        for lane in range(lanes if len(slope) else np.uintp(0)):
            for r in range(n_passive if closed[at + lane] else 0):
                for k in range(n_passive):
                    slope[at + lane, r, k] = found[r * width + k, lane]
                for k in range(n_actuated):
                    by_motor[at + lane, r, k] = found[r * width + n_passive + k, lane]
        _factor(blocks, found, width, larger, sign)
        for lane in range(lanes):
            for b in range(len(signs)):
                closed[at + lane] = closed[at + lane] and blocks.signs[b] * sign[b, lane] == signs[b]


@_compiled
def poses(tree: Tree, joints: FloatArray) -> FloatArray:
    """Return the poses of all frames in configurations (n, n_joints), (12 n_joints + 12, n or a few more)."""
    n, n_joints = joints.shape
    T = np.empty((12 * n_joints + 12, (n + _LANES - 1) // _LANES * _LANES))
    all_joints = np.ones(n_joints, dtype=np.bool_)
    D, q = np.empty((5, _LANES)), np.zeros((n_joints, _LANES))
    s, c = np.empty((n_joints, _LANES)), np.empty((n_joints, _LANES))
    _stand(T)
    for start in range(0, n, _LANES):
        at, lanes = np.uintp(start), np.uintp(min(_LANES, n - start))
        for j in range(n_joints):
            for lane in range(lanes):
                q[j, lane] = joints[at + lane, j]
        _sines(tree, q, s, c)
        _walk(tree, all_joints, (q, s, c), T, at, D)
    return T


@_compiled
def motion(
    tree: Tree,
    loops: Loops,
    T: FloatArray,
    places: IntArray,
    signs: FloatArray,
    direct: FloatArray,
    alike: IntArray,
    entries: tuple[IntArray, IntArray, FloatArray],
    result: FloatArray,
) -> None:
    """Derivative through the loops, as `calib.core.rows.jacobian` says.

    Args:
        tree: The model.
        loops: Its loops.
        T: Of `poses`.
        places: Frames a and b of each row, which coordinate, and whether it is a turn, not a position, (4, n_rows).
        signs: What each joint moves: +1 only b, -1 only a, else 0; of each row, then of each row of the loops,
            (n_rows + n_passive, n_joints).
        direct: The derivative of the rows by the passive joints beside that, (n_rows, n_passive).
        alike: The first joint that moves what each moves, (n_joints,).
        entries: Twists of origins along which to differentiate: joint and column of each, (n_entries,), and twist in
            the frame before the origin, (n_entries, 6).
        result: Where to put the derivative, (n, n_rows, width).
    """
    n, n_rows, width = result.shape
    n_passive, n_joints = loops.signs.shape
    maps, gaps = np.empty((6 * n_rows, _LANES)), np.empty((6 * n_passive, _LANES))
    C, larger = np.empty((n_passive * n_passive, _LANES)), np.empty((n_passive * n_passive, _LANES))
    B, X = np.empty((n_passive * n_rows, _LANES)), np.empty((n_passive * n_rows, _LANES))
    total, twist, out = np.empty((6 * n_rows, _LANES)), np.empty((6, _LANES)), np.empty((n_rows * width, _LANES))
    sign, active, feels = np.empty((1, _LANES)), np.empty(n_rows, dtype=np.bool_), np.empty(n_passive, dtype=np.intp)
    joints, columns, twists = entries
    rows = Loops(places[0], places[1], places[2], signs, loops.leader, loops.factor, loops.plan)
    wanted, whole = np.zeros(n_joints, dtype=np.bool_), np.zeros(n_joints, dtype=np.bool_)
    for e in range(len(joints)):
        a = alike[joints[e]]
        wanted[a] = True
        whole[a] = whole[a] or twists[e, 3] != 0.0 or twists[e, 4] != 0.0 or twists[e, 5] != 0.0
    plan = loops.plan
    for start in range(0, n, _LANES):
        at, lanes = np.uintp(start), np.uintp(min(_LANES, n - start))
        _rows(rows, T, at, maps)
        _slopes(tree, loops, T, at, n_passive, n_passive, gaps, twist, C)
        for r in range(n_rows):
            for k in range(3 if places[3, r] else 0):
                for lane in range(_ALL):
                    maps[6 * r + 3 + k, lane] = maps[6 * r + k, lane]
                    maps[6 * r + k, lane] = 0.0
            for c in range(n_passive):
                for lane in range(_ALL):
                    B[c * n_rows + r, lane] = direct[r, c]
        for j in range(n_joints):
            c = loops.leader[j]
            if c < 0 or c >= n_passive:
                continue
            _twist(T, j + 1, at, tree.axes, j, len(twist), twist)
            for r in range(n_rows):
                if signs[r, j] != 0.0:
                    _add_dot(signs[r, j] * loops.factor[j], maps, 6 * r, twist, len(twist), B, c * n_rows + r)
        if n_passive:
            _factor(plan, C, n_passive, larger, sign)
            _solve_left(plan, C, larger, B, X, n_rows)
        for r in range(n_rows * width):
            for lane in range(_ALL):
                out[r, lane] = 0.0
        for a in range(n_joints):
            if not wanted[a]:
                continue
            felt = 0
            for i in range(n_passive):
                if loops.signs[i, a] != 0.0:
                    feels[felt], felt = i, felt + 1
            parts = 6 if whole[a] else 3
            for r in range(n_rows):
                active[r] = felt > 0 or signs[r, a] != 0.0
                for k in range(6 * r, 6 * r + parts if active[r] else 0):
                    for lane in range(_ALL):
                        total[k, lane] = signs[r, a] * maps[k, lane]
                for e in range(0, felt, 2):
                    i, j = feels[e], feels[min(e + 1, felt - 1)]  # two at a time
                    x, y, g, h = i * n_rows + r, j * n_rows + r, loops.signs[i, a], loops.signs[j, a]
                    h = h if e + 1 < felt else 0.0
                    for k in range(parts):
                        for lane in range(_ALL):
                            total[6 * r + k, lane] -= (
                                g * X[x, lane] * gaps[6 * i + k, lane] + h * X[y, lane] * gaps[6 * j + k, lane]
                            )
            for e in range(len(joints)):
                if alike[joints[e]] == a:
                    _twist(T, tree.parents[joints[e]], at, twists, e, parts, twist)
                    for r in range(n_rows):
                        if active[r]:
                            _add_dot(1.0, total, 6 * r, twist, parts, out, r * width + columns[e])
        for lane in range(lanes):
            for r in range(n_rows):
                for k in range(width):
                    result[at + lane, r, k] = out[r * width + k, lane]


def kept() -> bool:
    """Whether an earlier program has compiled this version of the file, or this one has."""
    folder, version = Path(motion.stats.cache_path), Path(__file__).stat().st_mtime
    return any(index.stat().st_mtime >= version for index in folder.glob("kernels.motion-*.nbi"))
