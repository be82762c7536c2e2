"""Ways to closed configurations: Newton steps, and following the loops from home while joints or origins move.

Newton. Solve r(a, p) = 0 for the passive joints p of given actuated joints a from a start nearby: p <- p - C_p^-1 r,
with C_p = dr/dp. A start is near enough if each correction is at most half of the one before, the first below 0.5 rad.
Corrections that follow each other are about |d_3| = |d_2|^3 / |d_1|^2 at most, and residuals alike. If this says that
the next correction closes the loops, no residual is computed after it.

Why not minimise |r| from a guess: plain Newton from a crude guess ends in another assembly mode in about a
fifth of a five-bar's poses (docs/theory/loops.md prints the figure), and a small residual does not show it.

Continuation along the straight line from an already solved configuration (a0, p0) to a: a predicted step along
the tangent dp = -C_p^-1 C_a da, then Newton steps on p. A step counts only if Newton contracts at once (each correction
at most half of the one before, the first below 0.5 rad) and stays in the assembly mode (`calib.core.robots.closure`);
otherwise it is halved. Limits of the passive joints play no part here.

Ways. Home is a configuration of the nominal robot. A robot with other parameters is reached by moving the origins from
nominal to its own while the loops follow (`carry`). From its home, each pose is solved along the straight line: the
signs of an assembly mode may leave several solutions (as of a 3-RPR), and this way the other poses do not decide which.
Poses that this does not reach are solved nearest first, each from the nearest solved pose; or at the nominal robot and
carried over from there; or by way of stepping stones spread around them. All poses advance together in arrays. After a
small change of parameters the old solution is the start (`seed`).

When it fails. A pose stays unsolved if every way to it passes a singularity, or if its loops cannot be closed.
"""

from __future__ import annotations

import numpy as np
import scipy

from calib.core.base.arrays import BoolArray, FloatArray, IntArray
from calib.core.base.threads import one_blas_thread
from calib.core.robots import kinematics
from calib.core.robots.acceleration import kernels
from calib.core.robots.closure import AssemblyMode, LoopSolution, sweep_loops
from calib.core.robots.joint_sampling import joint_samples
from calib.core.robots.mechanism import Mechanism

TOLERANCE = 1e-12
"""Largest closure residual of a solved pose [m, rad]; for links of more than 28 m see `closing_tolerance`."""
_EPS = float(np.finfo(float).eps)
_ROUNDINGS = 16  # roundings of a coordinate on the way around a loop, at most about
LARGEST_STEP = 0.5
"""Largest motion of a passive joint in one correction [rad, or characteristic lengths]."""
_MAX_NEWTON = 12
_SURE = 0.1  # largest predicted residual, as part of the tolerance, that need not be computed
_SMALLEST_PART = 1 / 256  # smallest step, as part of the way from start to goal, before continuation gives up
_SMALLEST_AT_ONCE = 1 / 16  # the same for a pose that may be left out
_SMALLEST_CHANGE = 1 / 64  # smallest step, as part of the change of the origins
_TOGETHER = 64  # steps that are tried at once while few poses are left
_NEIGHBOURS = 3  # solved poses to start from
_MOST_KNOWN = 10_000  # poses solved together that serve as starts: more are hardly nearer, and take longer to search
_STONES, _FROM_STONES = 64, 6


def closing_tolerance(mechanism: Mechanism) -> float:
    """Return the closure residual that can be reached [m, rad]: `TOLERANCE`, or for long links the rounding errors.

    Coordinates of the size L of the links are multiples of eps L, and some are added on the way around a loop. The
    position of the robot does not count: `Mechanism.reduced_to`.
    """
    return max(TOLERANCE, 10 * _ROUNDINGS * _EPS * mechanism.length)


@one_blas_thread
def newton(
    mechanism: Mechanism, mode: AssemblyMode, actuated: FloatArray, passive: FloatArray, *, slopes: bool = True
) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
    """Newton on the passive joints; accepted only where it contracts at once and stays in the assembly mode.

    Args:
        actuated: Actuated joints, (n, n_actuated) [m or rad].
        passive: Where to start, (n, n_passive) [m or rad].
        slopes: Whether C_p and C_a are wanted at the solution.

    Returns:
        Passive joints (n, n_passive), C_p (n, n_passive, n_passive) and C_a (n, n_passive, n_actuated) there, or empty
        arrays where they are not wanted, and which poses were accepted (n,).
    """
    (n, n_passive), passive, enough = passive.shape, passive.copy(), closing_tolerance(mechanism) / 10
    sure, accepted, fast = 0.0 if slopes else _SURE * enough, np.zeros(n, dtype=bool), kernels(mechanism, n)
    slope = np.full((n if slopes else 0, n_passive, n_passive), np.nan)
    slope_actuated = np.full((n if slopes else 0, n_passive, actuated.shape[1]), np.nan)
    found = slope, slope_actuated, accepted
    if fast is None:
        _correct(mechanism, mode, actuated, passive, (enough, sure), *found)
    else:
        reduced = mechanism.reduced_to(mechanism.loops)
        rest = actuated @ mechanism.select_actuated[reduced.joints].T + mechanism.constant[reduced.joints]
        model = fast.tree(mechanism, reduced), fast.loops(mechanism, reduced), mode.places, mode.signs
        fast.close(*model, rest, passive, mechanism.passive_scale, enough, sure, LARGEST_STEP, _MAX_NEWTON, *found)
    return passive, *found


def _correct(
    mechanism: Mechanism,
    mode: AssemblyMode,
    actuated: FloatArray,
    passive: FloatArray,
    limits: tuple[float, float],
    slope: FloatArray,
    slope_actuated: FloatArray,
    accepted: BoolArray,
) -> None:
    """Fill in the results of `newton`: passive joints in place, `slope`, `slope_actuated`, `accepted`.

    `limits` of residuals: of a closed pose, if computed, and if predicted from the two before it.
    """
    (enough, sure), (n, n_passive) = limits, passive.shape
    shared = kinematics.SweepCache(mechanism, mechanism.loops)
    coordinates = shared.moving if len(slope) else shared.passive
    for part in shared.chunks(n):
        index = np.arange(part.start, part.stop)
        last, before = np.full(len(index), np.inf), np.zeros(len(index))
        for _ in range(_MAX_NEWTON):
            values, slopes = sweep_loops(shared, actuated[index], passive[index], coordinates)
            worst = np.max(np.abs(values), axis=1)
            done = worst <= enough
            on = ~done
            if np.any(on):
                correction = solve_each(slopes[:, :, :n_passive], values)
                last, longest = (
                    np.max(np.abs(correction / mechanism.passive_scale), axis=1),
                    np.minimum(last, 2 * LARGEST_STEP),
                )
                # below 1e-9 rounding decides the ratio of two corrections, so it says nothing about the branch
                contracts = (worst > enough) & (last <= np.maximum(0.5 * longest, 1e-9))
                passive[index] -= np.where(contracts[:, None], correction, 0.0)
                known = worst**3 <= sure * before**2
                done, on = done | (contracts & known), contracts & ~known
            if np.any(done):
                there = slopes if np.all(done) else slopes[done]
                at, by_passive = index[done], there[:, :, :n_passive]
                accepted[at] = mode.holds(by_passive)
                if len(slope):
                    slope[at], slope_actuated[at] = by_passive, there[:, :, n_passive:]
            if not np.any(on):
                break
            index, last, before = index[on], last[on], worst[on]


def solve_each(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solve each pose's linear system, (n, k, k) and (n, k) -> (n, k); infinite where its matrix is singular."""
    try:
        solution: FloatArray = np.linalg.solve(matrix, right[:, :, None])[:, :, 0]
    except np.linalg.LinAlgError:
        solution = np.full(right.shape, np.inf)
        regular = np.linalg.det(matrix) != 0
        solution[regular] = np.linalg.solve(matrix[regular], right[regular][:, :, None])[:, :, 0]
    return solution


@one_blas_thread
def follow(mechanism: Mechanism, mode: AssemblyMode, actuated: FloatArray, *, thorough: bool = True) -> LoopSolution:
    """Solve poses (n, n_actuated) [m or rad] in the assembly mode of home, by the ways of the module docstring.

    Limits of the passive joints play no part. If not `thorough`, only the straight way from home is tried, so that
    every solved pose is solved alike without the others.
    """
    at_home = mode.actuated[None], mode.passive[None]
    home = carry(mechanism, mode, *at_home)
    known = at_home[0], home.passive
    if home.ok[0] and not thorough:
        return _solve_straight(mechanism, mode, known, actuated, _SMALLEST_AT_ONCE)
    solution = LoopSolution.empty(len(actuated), len(mechanism.passive))
    if home.ok[0]:
        solution = _solve_outwards(mechanism, mode, known, actuated)
    todo = np.flatnonzero(~solution.ok)
    if len(todo) and mechanism is not mode.mechanism:
        nominal = _solve_outwards(mode.mechanism, mode, at_home, actuated[todo])
        todo = todo[nominal.ok]
        solution.take(carry(mechanism, mode, actuated[todo], nominal.passive[nominal.ok]), todo)
        todo = np.flatnonzero(~solution.ok)
    if len(todo) and home.ok[0]:
        stones = _stepping_stones(mechanism, mode, actuated[todo])
        there = _solve_outwards(mechanism, mode, known, stones)
        known = stones[there.ok], there.passive[there.ok]
        solution.take(_solve_from_nearest(mechanism, mode, known, actuated[todo], _FROM_STONES), todo)
    return solution


def carry(
    mechanism: Mechanism, mode: AssemblyMode, actuated: FloatArray, passive: FloatArray, *, slopes: bool = True
) -> LoopSolution:
    """Follow configurations that close the nominal mechanism while its origins move to those of `mechanism`.

    Args:
        mode: Nominal mechanism and assembly mode.
        actuated, passive: The configurations, (n, n_actuated), (n, n_passive) [m or rad]; actuated joints stay.
        slopes: Whether C_p is wanted.
    """
    solution = LoopSolution.empty(*passive.shape)

    def go(index: IntArray, at: FloatArray, low: float, high: float) -> tuple[IntArray, FloatArray]:
        """Go from the part `low` of the change to `high`; return which poses arrived, and their passive joints."""
        partway = mechanism if high == 1 else mode.mechanism.interpolated(mechanism, high)
        solved, slope, _, ok = newton(partway, mode, actuated[index], at, slopes=slopes)
        ok &= np.max(np.abs((solved - at) / partway.passive_scale), axis=1, initial=0.0) < 4 * LARGEST_STEP
        if high == 1:
            solution.take(LoopSolution(solved, ok, slope if slopes else None), index)
        left = np.flatnonzero(~ok)
        if len(left) == 0 or high - low < _SMALLEST_CHANGE:
            return index[ok], solved[ok]
        middle = (low + high) / 2
        halfway, at_half = go(index[left], at[left], low, middle)
        late, at_late = go(halfway, at_half, middle, high) if len(halfway) else (halfway, at_half)
        return np.concatenate([index[ok], late]), np.concatenate([solved[ok], at_late])

    if len(actuated):
        go(np.arange(len(actuated)), passive, 0.0, 1.0)
    return solution


def _solve_straight(
    mechanism: Mechanism,
    mode: AssemblyMode,
    home: tuple[FloatArray, FloatArray],
    actuated: FloatArray,
    smallest: float,
) -> LoopSolution:
    """Solve poses along the straight lines from home, (1, n_actuated) and (1, n_passive) [m or rad]."""
    solution = LoopSolution.empty(len(actuated), len(mechanism.passive))
    for first in range(0, len(actuated), _MOST_KNOWN):
        part = np.arange(first, min(first + _MOST_KNOWN, len(actuated)))
        start = np.repeat(home[0], len(part), axis=0), np.repeat(home[1], len(part), axis=0)
        solution.take(_continue(mechanism, mode, start, actuated[part], smallest), part)
    return solution


def _solve_outwards(
    mechanism: Mechanism, mode: AssemblyMode, home: tuple[FloatArray, FloatArray], actuated: FloatArray
) -> LoopSolution:
    """Solve poses straight from home; others nearest to home first, each from the nearest pose solved so far.

    What is left is tried again at the end.
    """
    solution = _solve_straight(mechanism, mode, home, actuated, _SMALLEST_PART)
    solved, left = np.flatnonzero(solution.ok), np.flatnonzero(~solution.ok)
    solved = solved[:: 1 + len(solved) // _MOST_KNOWN]
    known = np.vstack([home[0], actuated[solved]]), np.vstack([home[1], solution.passive[solved]])
    ways = (actuated[left] - home[0]) / mechanism.driven_scale
    order = left[np.argsort(np.linalg.norm(ways, axis=1), kind="stable")]
    start, size = 0, 8
    while start < len(order):
        batch = order[start : start + size]
        solution.take(_solve_from_nearest(mechanism, mode, known, actuated[batch], _NEIGHBOURS), batch)
        solved = batch[solution.ok[batch]][:: 1 + len(batch) // _MOST_KNOWN]
        known = np.vstack([known[0], actuated[solved]]), np.vstack([known[1], solution.passive[solved]])
        start, size = start + size, size * 2
    left = np.flatnonzero(~solution.ok)
    if len(left) and len(known[0]) > _NEIGHBOURS:
        solution.take(_solve_from_nearest(mechanism, mode, known, actuated[left], _NEIGHBOURS), left)
    return solution


def _solve_from_nearest(
    mechanism: Mechanism,
    mode: AssemblyMode,
    known: tuple[FloatArray, FloatArray],
    actuated: FloatArray,
    neighbours: int,
) -> LoopSolution:
    """Solve poses from known ones, the nearest first; another way round where the straight line is blocked."""
    solution, scale = LoopSolution.empty(len(actuated), len(mechanism.passive)), mechanism.driven_scale
    count = min(neighbours, len(known[0]))
    if count == 0 or len(actuated) == 0:
        return solution
    places = scipy.spatial.cKDTree(known[0] / scale)
    for ranks in (range(1, 2), range(2, count + 1)):  # all others at once: each way that fails takes many steps
        todo = np.flatnonzero(~solution.ok)
        if len(todo) == 0 or len(ranks) == 0:
            break
        starts = places.query(actuated[todo] / scale, k=ranks)[1].ravel()
        goals = np.repeat(todo, len(ranks))
        there = _continue(mechanism, mode, (known[0][starts], known[1][starts]), actuated[goals], _SMALLEST_PART)
        arrived, first = np.unique(goals[there.ok], return_index=True)
        solution.take(there.select(np.flatnonzero(there.ok)[first]), arrived)
    return solution


def _stepping_stones(mechanism: Mechanism, mode: AssemblyMode, actuated: FloatArray) -> FloatArray:
    """Joint values spread over the box of home and these poses and a bit beyond, (n, n_actuated) [m or rad]."""
    corners = np.vstack([mode.actuated[None], actuated])
    low, high = corners.min(axis=0), corners.max(axis=0)
    beyond = 0.1 * mechanism.driven_scale
    sample = joint_samples(mode, _STONES)
    return low - beyond + sample * (high - low + 2 * beyond)


def _continue(
    mechanism: Mechanism, mode: AssemblyMode, start: tuple[FloatArray, FloatArray], goal: FloatArray, smallest: float
) -> LoopSolution:
    """Follow the solution from actuated and passive joints to the actuated joints `goal` with adaptive steps.

    If the last step failed and few poses are left, several shorter steps are tried together. The longest accepted one
    counts, as if they had been tried one after the other.
    """
    start_a, at_p = start[0], start[1].copy()
    way = goal - start_a
    _, slope, slope_a, _ = newton(mechanism, mode, start_a, at_p)  # slopes of solved poses
    tangent = solve_each(slope, np.matmul(slope_a, way[:, :, None])[:, :, 0])  # motion of passive joints along the way
    done, part = np.zeros(len(goal)), np.ones(len(goal))
    active, lengths = np.arange(len(goal)), 1
    while len(active):
        halved = part[active, None] / 2 ** np.arange(lengths)
        row, length = np.nonzero(halved >= smallest)
        who = active[row]
        step = np.minimum(halved[row, length], 1 - done[who])
        come = (done[who] + step)[:, None]
        next_a = np.where(come < 1, start_a[who] + come * way[who], goal[who])
        predicted = at_p[who] - step[:, None] * tangent[who]
        solved, new_slope, new_slope_a, accepted = newton(mechanism, mode, next_a, predicted)
        accepted &= np.max(np.abs((solved - at_p[who]) / mechanism.passive_scale), axis=1) < 4 * LARGEST_STEP
        part[active] = halved[:, -1] / 2
        good, first = np.unique(who[accepted], return_index=True)
        took = np.flatnonzero(accepted)[first]
        at_p[good], slope[good] = solved[took], new_slope[took]
        done[good] += step[took]
        part[good] = 2 * halved[row[took], length[took]]
        lengths = 1 if len(good) == len(active) else max(1, _TOGETHER // len(active))
        further = done[good] < 1
        on, took = good[further], took[further]
        tangent[on] = solve_each(new_slope[took], np.matmul(new_slope_a[took], way[on, :, None])[:, :, 0])
        active = active[(done[active] < 1) & (part[active] >= smallest)]
    return LoopSolution(at_p, done >= 1, slope)
