"""Newton steps that close the loops, accepted only where they contract at once and keep the assembly mode.

Solve r(a, p) = 0 for the passive joints p of given actuated joints a from a start nearby: p <- p - C_p^-1 r, with
C_p = dr/dp. A start is near enough if each correction is at most half of the one before, the first below 0.5 rad.

Why not minimise |r| from a guess: plain Newton from a crude guess ends in another assembly mode in about a
fifth of a five-bar's poses (docs/theory/loops.md prints the figure), and a small residual does not show it.
"""

from __future__ import annotations

import numpy as np

from calib.arrays import BoolArray, FloatArray
from calib.model.assembly_mode import AssemblyMode
from calib.model.closure import residual
from calib.model.mechanism import Mechanism

TOLERANCE = 1e-12
"""Largest closure residual of a solved pose [m, rad]; for links of more than 28 m see `closing_tolerance`."""
_ROUNDINGS = 16  # roundings of a coordinate on the way around a loop, at most about
LARGEST_STEP = 0.5
"""Of any passive joint in one correction [rad, or characteristic lengths]."""
_MAX_NEWTON = 12


def closing_tolerance(mechanism: Mechanism) -> float:
    """Return the closure residual that can be reached [m, rad]: `TOLERANCE`, but what rounding leaves of long links.

    Coordinates of the size L of the links are multiples of eps L, and some are added on the way around a loop. Where
    the robot stands plays no part: `Mechanism.around`.
    """
    return max(TOLERANCE, 10 * _ROUNDINGS * float(np.finfo(float).eps) * mechanism.length)


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
    enough = closing_tolerance(mechanism) / 10
    for _ in range(_MAX_NEWTON):
        values, slope_p, _ = residual(mechanism, actuated[active], passive[active])
        small = np.max(np.abs(values), axis=1) <= enough
        slope[active[small]] = slope_p[small]
        accepted[active[small]] = True
        rest = ~small & np.all(np.isfinite(slope_p), axis=(1, 2))
        correction = solved_for(slope_p[rest], values[rest])
        size = np.max(np.abs(in_radians(mechanism, correction)), axis=1)
        still = active[rest]
        # below 1e-9 rounding decides the ratio of two corrections, so it says nothing about the branch
        contracts = size <= np.maximum(0.5 * np.minimum(last[still], 2 * LARGEST_STEP), 1e-9)
        passive[still[contracts]] -= correction[contracts]
        last[still] = size
        active = still[contracts]
        if len(active) == 0:
            break
    if np.any(accepted):
        good = np.flatnonzero(accepted)
        accepted[good] = mode.holds(slope[good])
    return passive, slope, accepted


def solved_for(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solve each pose's linear system, (n, k, k) and (n, k) -> (n, k); infinite where its matrix is singular."""
    try:
        solution: FloatArray = np.linalg.solve(matrix, right[:, :, None])[:, :, 0]
    except np.linalg.LinAlgError:
        solution = np.full(right.shape, np.inf)
        regular = np.linalg.det(matrix) != 0
        solution[regular] = np.linalg.solve(matrix[regular], right[regular][:, :, None])[:, :, 0]
    return solution


def in_radians(mechanism: Mechanism, passive: FloatArray) -> FloatArray:
    """Return changes of passive joints (n, n_passive) [m or rad] with lengths over the characteristic length."""
    result: FloatArray = np.where(mechanism.is_metre_column, passive / mechanism.length, passive)
    return result
