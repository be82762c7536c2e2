"""Closing kinematic loops: passive joints from actuated ones, always in the assembly mode of the home configuration.

Problem. Find passive joints p with r(a, p) = 0 for given actuated joints a. Several solutions exist (a five-bar's elbow
up or down); only the one that can be reached from the home configuration without passing a singularity is the robot.

Method. Continuation along the straight line from an already solved configuration (a0, p0) to a: a predicted step along
the tangent dp = -C_p^-1 C_a da, then Newton steps on p. A step counts only if Newton contracts at once (each correction
at most half of the one before, the first below 0.5 rad) and every diagonal block of C_p = dr/dp keeps the sign of its
determinant; otherwise it is halved. A solution beyond the limits of a passive joint does not count as closed. The
blocks are the strongly connected parts of C_p's pattern: one for each five-bar, so that two flips cannot cancel in one
determinant. Poses are solved nearest to home first, each starting from the nearest solved pose, so that one step is
usually enough; all poses advance together in arrays. After a small change of parameters the old solution is the start
(`seed`).

Why not minimise |r| from a guess: plain Newton from a crude guess ends in another assembly mode in a sixth of
five-bar poses, and a small residual does not show it.

When it fails. A pose without a solution, or one that the line reaches only through a singularity, is not closed; the
miss reported is the smallest |r| found. Closures must be as many as passive joints and independent at home.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components, maximum_bipartite_matching
from scipy.spatial import cKDTree

from calib.errors import DescriptionError
from calib.model import kinematics
from calib.model.mechanism import BoolArray, FloatArray, IntArray, Mechanism
from calib.threads import one_blas_thread

TOLERANCE = 1e-12
"""Largest closure residual of a solved pose [m, rad]."""
_LARGEST_STEP = 0.5  # of any passive joint in one Newton correction [rad, or characteristic lengths]
_OPEN_HOME = 0.05  # characteristic lengths that home may be open: as much as a calibrated URDF differs from its drawing
_SMALLEST_PART = 1 / 256  # of the way from start to goal, before continuation gives up
_MAX_NEWTON = 12


@dataclass(frozen=True, eq=False)
class Closed:
    """Solved loops.

    Attributes:
        passive: Passive joints, NaN where a pose does not close, (n, n_passive) [m or rad].
        ok: Which poses closed, (n,).
        slope: C_p at the solution, NaN where open, (n, n_passive, n_passive); `singular_values` judges it.
    """

    passive: FloatArray
    ok: BoolArray
    slope: FloatArray


@dataclass(frozen=True, eq=False)
class AssemblyMode:
    """A closed configuration and the signs that tell its assembly mode.

    Attributes:
        actuated, passive: The configuration, (n_actuated,), (n_passive,).
        blocks: Row and column indices of each strongly connected block of C_p.
        signs: Sign of each block's determinant, (n_blocks,).
    """

    actuated: FloatArray
    passive: FloatArray
    blocks: tuple[tuple[IntArray, IntArray], ...]
    signs: FloatArray


def residual(
    mechanism: Mechanism, actuated: FloatArray, passive: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return r (n, n_rows), C_p = dr/dp (n, n_rows, n_passive) and C_a = dr/da (n, n_rows, n_actuated)."""
    swept = kinematics.sweep(mechanism, mechanism.all_joints(actuated, passive), mechanism.loops)
    select = np.hstack([mechanism.select_passive, mechanism.select_actuated])
    values, slopes = [], []
    for loop in mechanism.loops:
        values.append(kinematics.value(swept, loop))
        columns = mechanism.between(loop)[:, None] * select
        slopes.append(kinematics.joint_derivative(swept, kinematics.twist_map(swept, loop), columns))
    slope = np.concatenate(slopes, axis=1)
    n_passive = len(mechanism.passive)
    return np.concatenate(values, axis=1), slope[:, :, :n_passive], slope[:, :, n_passive:]


def scaled(mechanism: Mechanism, slope_passive: FloatArray) -> FloatArray:
    """Return C_p with metres divided by the characteristic length, so that its entries are pure numbers."""
    rows = np.where(mechanism.is_metre_row, 1 / mechanism.length, 1.0)
    columns = np.where(mechanism.is_metre_column, mechanism.length, 1.0)
    result: FloatArray = slope_passive * rows[:, None] * columns
    return result


def singular_values(mechanism: Mechanism, slope_passive: FloatArray) -> FloatArray:
    """Return the smallest singular value of the scaled C_p, (n,): 0 at a singular pose, of order 1 far from one."""
    if not mechanism.passive:
        return np.full(len(slope_passive), np.inf)
    values: FloatArray = np.linalg.svd(scaled(mechanism, slope_passive), compute_uv=False)
    return values[:, -1]


def assembly_mode(mechanism: Mechanism, home: dict[str, float], singularity_limit: float, where: str) -> AssemblyMode:
    """Check that the home configuration closes, polish it, and record its assembly mode.

    Args:
        home: Joint values by name [m or rad]; names that are missing count as 0.
        singularity_limit: Smallest acceptable singular value of the scaled C_p at home.
        where: The description, for messages.

    Raises:
        DescriptionError: Home does not close, or is singular.
    """
    actuated = np.array([[home.get(name, 0.0) for name in mechanism.actuated]])
    passive = np.array([[home.get(name, 0.0) for name in mechanism.passive]])
    if not mechanism.loops:
        return AssemblyMode(actuated[0], passive[0], (), np.ones(0))
    missing = [name for name in mechanism.actuated + mechanism.passive if name not in home]
    if missing:
        raise DescriptionError(
            f"{where}: home: gives no value for joint '{missing[0]}'; a robot with loops needs an"
            " assembled configuration of every joint"
        )
    values, slope, _ = residual(mechanism, actuated, passive)
    worst = _per_loop(mechanism, values)[0]
    limit = _OPEN_HOME * mechanism.length
    if np.max(worst) > limit:
        loop = int(np.argmax(worst))
        raise DescriptionError(
            f"{where}: home: loop {mechanism.loops[loop].name} is open by {1e3 * worst[loop]:.3f} mm;"
            f" give joint values at which the robot is assembled (to {1e3 * limit:.0f} mm or better)"
        )
    smallest = float(singular_values(mechanism, slope)[0])
    if smallest < singularity_limit:
        loose = [mechanism.loops[i].name for i in _loose_loops(mechanism, slope[0])]
        raise DescriptionError(
            f"{where}: home: the closures do not hold the passive joints (smallest singular value {smallest:.2g} of the"
            f" scaled passive Jacobian, limit {singularity_limit:g}; look at {', '.join(loose)}): home is singular, or"
            " closed_loop_axes names a direction that the mechanism does not constrain"
        )
    blocks = _blocks(np.abs(scaled(mechanism, slope)[0]) > 1e-9)
    mode = AssemblyMode(actuated[0], passive[0], blocks, _signs(slope, blocks)[0])
    polished, _, ok = newton(mechanism, mode, actuated, passive)
    if not ok[0]:
        raise DescriptionError(f"{where}: home: cannot be closed to {TOLERANCE:g} m from the values given")
    return AssemblyMode(actuated[0], polished[0], blocks, mode.signs)


@one_blas_thread
def close(mechanism: Mechanism, mode: AssemblyMode, actuated: FloatArray, seed: FloatArray | None = None) -> Closed:
    """Solve the loops of each pose in the assembly mode of home.

    Args:
        actuated: Actuated joints, (n, n_actuated) [m or rad].
        seed: Passive joints of the same poses solved with slightly different parameters, (n, n_passive); poses that do
            not follow from it at once are solved afresh.
    """
    n, n_passive = len(actuated), len(mechanism.passive)
    if not mechanism.loops:
        return Closed(np.zeros((n, 0)), np.ones(n, dtype=bool), np.zeros((n, 0, 0)))
    passive, slope = np.full((n, n_passive), np.nan), np.full((n, n_passive, n_passive), np.nan)
    ok = np.zeros(n, dtype=bool)
    if seed is not None:
        tried = np.flatnonzero(np.all(np.isfinite(seed), axis=1))
        passive[tried], slope[tried], ok[tried] = newton(mechanism, mode, actuated[tried], seed[tried])
    if not np.all(ok):
        todo = np.flatnonzero(~ok)
        passive[todo], slope[todo], ok[todo] = _from_home(mechanism, mode, actuated[todo])
    passive = wrapped(mechanism, mode, passive)
    margin = 1e-9
    ok &= np.all((passive >= mechanism.lower - margin) & (passive <= mechanism.upper + margin), axis=1)
    passive[~ok], slope[~ok] = np.nan, np.nan
    return Closed(passive, ok, slope)


def _from_home(
    mechanism: Mechanism, mode: AssemblyMode, actuated: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Solve poses nearest to home first, each from the nearest pose solved so far."""
    n, n_passive = len(actuated), len(mechanism.passive)
    passive, slope = np.full((n, n_passive), np.nan), np.full((n, n_passive, n_passive), np.nan)
    ok = np.zeros(n, dtype=bool)
    scale = np.array(
        [mechanism.length if mechanism.dimensions[name] == "length" else 1.0 for name in mechanism.actuated]
    )
    points = actuated / scale
    order = np.argsort(np.linalg.norm(points - mode.actuated / scale, axis=1), kind="stable")
    known_a, known_p = mode.actuated[None], mode.passive[None]
    start, size = 0, 8
    while start < n:
        batch = order[start : start + size]
        for neighbour in range(3):  # another way round where the straight line is blocked
            todo = batch[~ok[batch]]
            if len(todo) == 0 or neighbour >= len(known_a):
                break
            nearest = cKDTree(known_a / scale).query(points[todo], k=[neighbour + 1])[1][:, 0]
            passive[todo], slope[todo], ok[todo] = _continue(
                mechanism, mode, known_a[nearest], known_p[nearest], actuated[todo]
            )
        solved = batch[ok[batch]]
        known_a, known_p = np.vstack([known_a, actuated[solved]]), np.vstack([known_p, passive[solved]])
        start, size = start + size, size * 2
    return passive, slope, ok


def _continue(
    mechanism: Mechanism, mode: AssemblyMode, start_a: FloatArray, start_p: FloatArray, goal: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Follow the solution from (start_a, start_p) to the actuated joints `goal` with adaptive steps."""
    n, n_passive = len(goal), len(mechanism.passive)
    at_a, at_p = start_a.copy(), start_p.copy()
    slope = np.full((n, n_passive, n_passive), np.nan)
    done, part = np.zeros(n), np.ones(n)
    active = np.arange(n)
    while len(active):
        _, slope_p, slope_a = residual(mechanism, at_a[active], at_p[active])
        step = np.minimum(part[active], 1 - done[active])[:, None]
        next_a = np.where(done[active, None] + step >= 1, goal[active], at_a[active] + step * (goal - start_a)[active])
        change = np.matmul(slope_a, (next_a - at_a[active])[:, :, None])
        predicted = at_p[active] - _solve(slope_p, change[:, :, 0])
        solved, new_slope, accepted = newton(mechanism, mode, next_a, predicted)
        moved = np.max(np.abs(_in_radians(mechanism, solved - at_p[active])), axis=1)
        accepted &= moved < 4 * _LARGEST_STEP
        good, bad = active[accepted], active[~accepted]
        at_a[good], at_p[good], slope[good] = next_a[accepted], solved[accepted], new_slope[accepted]
        done[good] += step[accepted, 0]
        done[good[np.all(at_a[good] == goal[good], axis=1)]] = 1.0
        part[good], part[bad] = 2 * part[good], part[bad] / 2
        active = active[(done[active] < 1) & (part[active] >= _SMALLEST_PART)]
    return at_p, slope, done >= 1


def newton(
    mechanism: Mechanism, mode: AssemblyMode, actuated: FloatArray, passive: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Newton on the passive joints; accepted only where it contracts at once and stays in the assembly mode.

    Returns:
        Passive joints (n, n_passive), C_p there (n, n_passive, n_passive), and which poses were accepted (n,).
    """
    n = len(actuated)
    passive = passive.copy()
    slope = np.full((n, passive.shape[1], passive.shape[1]), np.nan)
    accepted, last = np.zeros(n, dtype=bool), np.full(n, np.inf)
    active = np.arange(n)
    for _ in range(_MAX_NEWTON):
        values, slope_p, _ = residual(mechanism, actuated[active], passive[active])
        small = np.max(np.abs(values), axis=1) <= TOLERANCE / 10
        slope[active[small]] = slope_p[small]
        accepted[active[small]] = True
        rest = ~small & np.all(np.isfinite(slope_p), axis=(1, 2))
        correction = _solve(slope_p[rest], values[rest])
        size = np.max(np.abs(_in_radians(mechanism, correction)), axis=1)
        still = active[rest]
        # below 1e-9 rounding decides the ratio of two corrections, so it says nothing about the branch
        contracts = size <= np.maximum(0.5 * np.minimum(last[still], 2 * _LARGEST_STEP), 1e-9)
        passive[still[contracts]] -= correction[contracts]
        last[still] = size
        active = still[contracts]
        if len(active) == 0:
            break
    if np.any(accepted):
        good = np.flatnonzero(accepted)
        accepted[good] = (_signs(slope[good], mode.blocks) == mode.signs).all(axis=1)
    return passive, slope, accepted


def _solve(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solve each pose's linear system, (n, k); infinite where its matrix is exactly singular."""
    try:
        solution: FloatArray = np.linalg.solve(matrix, right[:, :, None])[:, :, 0]
    except np.linalg.LinAlgError:
        solution = np.full(right.shape, np.inf)
        regular = np.linalg.det(matrix) != 0
        solution[regular] = np.linalg.solve(matrix[regular], right[regular][:, :, None])[:, :, 0]
    return solution


def wrapped(mechanism: Mechanism, mode: AssemblyMode, passive: FloatArray) -> FloatArray:
    """Bring turning joints within half a turn of home; a full turn is the same pose."""
    turns = np.round((passive - mode.passive) / (2 * np.pi))
    result: FloatArray = np.where(mechanism.is_metre_column, passive, passive - 2 * np.pi * turns)
    return result


def _in_radians(mechanism: Mechanism, passive: FloatArray) -> FloatArray:
    result: FloatArray = np.where(mechanism.is_metre_column, passive / mechanism.length, passive)
    return result


def _signs(slope: FloatArray, blocks: tuple[tuple[IntArray, IntArray], ...]) -> FloatArray:
    """Sign of the determinant of each block of C_p, (n, n_blocks)."""
    return np.stack([np.sign(np.linalg.det(slope[:, rows[:, None], columns])) for rows, columns in blocks], axis=1)


def _blocks(pattern: BoolArray) -> tuple[tuple[IntArray, IntArray], ...]:
    """Split a square, structurally regular pattern into its strongly connected diagonal blocks."""
    column_of_row = maximum_bipartite_matching(csr_matrix(pattern), perm_type="column")
    matched = pattern[:, column_of_row]
    count, label = connected_components(csr_matrix(matched), directed=True, connection="strong")
    return tuple((np.flatnonzero(label == k), np.sort(column_of_row[label == k])) for k in range(count))


def _per_loop(mechanism: Mechanism, values: FloatArray) -> FloatArray:
    """Norm of the residual of each loop, (n, n_loops)."""
    ends = np.cumsum([len(loop.rows) for loop in mechanism.loops])
    return np.stack([np.linalg.norm(part, axis=1) for part in np.split(values, ends[:-1], axis=1)], axis=1)


def _loose_loops(mechanism: Mechanism, slope: FloatArray) -> list[int]:
    """Loops whose rows make up the direction in which the closures hold nothing."""
    left = np.linalg.svd(scaled(mechanism, slope[None])[0])[0][:, -1]
    share = _per_loop(mechanism, left[None])[0]
    return [int(i) for i in np.flatnonzero(share > 0.3)]


def smallest_miss(mechanism: Mechanism, mode: AssemblyMode, actuated: FloatArray) -> FloatArray:
    """Return how far each loop stays open at best in one pose, (n_loops,) [m or rad].

    All are 0 where the loops do close, but only in another assembly mode or beyond a passive joint's limit.

    Args:
        actuated: Actuated joints of a pose that `close` could not close, (n_actuated,) [m or rad].
    """

    def values(passive: FloatArray) -> FloatArray:
        return residual(mechanism, actuated[None], passive[None])[0][0]

    def slope(passive: FloatArray) -> FloatArray:
        return residual(mechanism, actuated[None], passive[None])[1][0]

    scale = np.where(mechanism.is_metre_column, mechanism.length, 1.0)
    best = least_squares(values, mode.passive, jac=slope, x_scale=scale, max_nfev=200)
    return _per_loop(mechanism, best.fun[None])[0]
