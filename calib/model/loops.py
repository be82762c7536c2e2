"""Closing kinematic loops: passive joints from actuated ones, always in the assembly mode of the home configuration.

Problem. Find passive joints p with r(a, p) = 0 for given actuated joints a. Several solutions exist (a five-bar's elbow
up or down); only the one that can be reached from the home configuration without passing a singularity is the robot.

Method. Newton from a solution under similar parameters where one is known (`calib.model.newton`); else the loops are
followed from home (`calib.model.continuation`). A solution beyond the limits of a passive joint does not count.

When it fails. A pose without a solution, or one that no way reaches without passing a singularity, is not closed;
`calib.model.open_loops` says why. Closures must be as many as passive joints and independent at home.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.arrays import BoolArray, FloatArray, IntArray
from calib.model.assembly_mode import AssemblyMode
from calib.model.continuation import follow
from calib.model.mechanism import Mechanism
from calib.model.newton import newton
from calib.threads import one_blas_thread

LIMIT_MARGIN = 1e-9
"""How far beyond its limit a passive joint may be [m, rad]."""


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

    def at(self, index: IntArray) -> Closed:
        """Return the poses with these indices, (n,)."""
        return Closed(self.passive[index], self.ok[index], self.slope[index])


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
    ok &= within_limits(mechanism, passive)
    passive[~ok], slope[~ok] = np.nan, np.nan
    return Closed(passive, ok, slope)


def wrapped(mechanism: Mechanism, mode: AssemblyMode, passive: FloatArray) -> FloatArray:
    """Bring turning joints within half a turn of home, or within their limits: a full turn is the same pose.

    Args:
        mechanism: The robot.
        mode: Home and its assembly mode.
        passive: Passive joints, (n, n_passive) [m or rad].
    """
    turn = 2 * np.pi
    near_home = passive - turn * np.round((passive - mode.passive) / turn)
    low, high = mechanism.lower - LIMIT_MARGIN, mechanism.upper + LIMIT_MARGIN
    raised = near_home + turn * np.ceil((low - near_home) / turn)
    lowered = near_home - turn * np.ceil((near_home - high) / turn)
    inside = np.where((near_home < low) & (raised <= high), raised, near_home)
    inside = np.where((near_home > high) & (lowered >= low), lowered, inside)
    result: FloatArray = np.where(mechanism.is_metre_column, passive, inside)
    return result


def within_limits(mechanism: Mechanism, passive: FloatArray) -> BoolArray:
    """Return where passive joints (n, n_passive) [m or rad] keep their limits, (n,)."""
    low, high = mechanism.lower - LIMIT_MARGIN, mechanism.upper + LIMIT_MARGIN
    result: BoolArray = np.all((passive >= low) & (passive <= high), axis=1)
    return result
