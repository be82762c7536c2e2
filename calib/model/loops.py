"""Closing kinematic loops: passive joints from actuated ones, always in the assembly mode of the home configuration.

Problem. Find passive joints p with r(a, p) = 0 for given actuated joints a. Several solutions exist (a five-bar's elbow
up or down); only the one that can be reached from the home configuration without passing a singularity is the robot.

Method. Continuation along the straight line from an already solved configuration (a0, p0) to a: a predicted step along
the tangent dp = -C_p^-1 C_a da, then Newton steps on p. A step counts only if Newton contracts at once (each correction
at most half of the one before, the first below 0.5 rad) and stays in the assembly mode (`calib.model.assembly_mode`);
otherwise it is halved. A solution beyond the limits of a passive joint does not count as closed. Poses are solved
nearest to home first, each starting from the nearest solved pose, so that one step is usually enough; all poses advance
together in arrays. After a small change of parameters the old solution is the start (`seed`).

Why not minimise |r| from a guess: plain Newton from a crude guess ends in another assembly mode in a sixth of
five-bar poses, and a small residual does not show it.

When it fails. A pose without a solution, or one that the line reaches only through a singularity, is not closed;
`calib.model.open_loops` says why. Closures must be as many as passive joints and independent at home.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from calib.model.assembly_mode import AssemblyMode
from calib.model.closure import residual
from calib.model.mechanism import BoolArray, FloatArray, Mechanism
from calib.threads import one_blas_thread

TOLERANCE = 1e-12
"""Largest closure residual of a solved pose [m, rad]."""
_LARGEST_STEP = 0.5  # of any passive joint in one Newton correction [rad, or characteristic lengths]
_SMALLEST_PART = 1 / 256  # of the way from start to goal, before continuation gives up
_MAX_NEWTON = 12


@dataclass(frozen=True, eq=False)
class Closed:
    """Solved loops.

    Attributes:
        passive: Passive joints, NaN where a pose does not close, (n, n_passive) [m or rad].
        ok: Which poses closed, (n,).
        slope: C_p at the solution, NaN where open, (n, n_passive, n_passive).
    """

    passive: FloatArray
    ok: BoolArray
    slope: FloatArray


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
        passive[todo], slope[todo], ok[todo] = follow(mechanism, mode, actuated[todo])
    passive = wrapped(mechanism, mode, passive)
    margin = 1e-9
    ok &= np.all((passive >= mechanism.lower - margin) & (passive <= mechanism.upper + margin), axis=1)
    passive[~ok], slope[~ok] = np.nan, np.nan
    return Closed(passive, ok, slope)


def follow(mechanism: Mechanism, mode: AssemblyMode, actuated: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Solve poses in the assembly mode of home, nearest to home first, each from the nearest pose solved so far.

    Args:
        mechanism: The robot.
        mode: Home and its assembly mode.
        actuated: Actuated joints, (n, n_actuated) [m or rad].

    Returns:
        Passive joints (n, n_passive), C_p there (n, n_passive, n_passive), and which poses were solved (n,); limits of
        the passive joints play no part.
    """
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
        accepted[good] = mode.holds(slope[good])
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
