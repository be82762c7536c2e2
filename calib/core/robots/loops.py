"""Closing kinematic loops: passive joints from actuated ones, always in the assembly mode of the home configuration.

Problem. Find passive joints p with r(a, p) = 0 for given actuated joints a. Several solutions exist (a five-bar's elbow
up or down); only the one that can be reached from the home configuration without passing a singularity is the robot.

Method. Newton from a solution under similar parameters where one is known; else the loops are followed from home
(`calib.core.robots.continuation`). A solution beyond the limits of a passive joint does not count, except while a fit
moves to its minimum: there, a limit would be a wall in front of the minimum.

The home configuration itself must close and be regular; it decides the assembly mode (`check_home`).

When it fails. A pose is not closed if it has no solution, or if every way to it passes a singularity. The error says
why: a loop stays open, a passive joint passes its limit, or the assembly mode differs. There must be as many closures
as passive joints, and they must be independent at home.
"""

from __future__ import annotations

import numpy as np
import scipy

from calib.core.base.arrays import BoolArray, FloatArray, hold
from calib.core.base.errors import DescriptionError
from calib.core.base.units import DISPLAY_UNIT, Dimension, in_unit, quantity_text
from calib.core.base.words import joints_named
from calib.core.numerics import linalg
from calib.core.robots import closure
from calib.core.robots.closure import AssemblyMode, LoopSolution
from calib.core.robots.continuation import carry, closing_tolerance, follow, newton
from calib.core.robots.mechanism import Mechanism

LIMIT_MARGIN = 1e-9
"""How far beyond its limit a passive joint may be [m, rad]."""
_OPEN_HOME = 0.05  # characteristic lengths, or rad: as much as a calibrated URDF differs from the nominal one
_CLOSED = 1e-6  # the search for the smallest gap ends a few nanometres from closed [m or rad]


def close(
    mechanism: Mechanism,
    mode: AssemblyMode,
    actuated: FloatArray,
    seed: FloatArray | None = None,
    *,
    thorough: bool = True,
    limits: bool = True,
) -> LoopSolution:
    """Solve the loops of each pose in the assembly mode of home.

    Args:
        actuated: Actuated joints, (n, n_actuated) [m or rad].
        seed: Passive joints of the same poses solved with slightly different parameters, (n, n_passive); poses that do
            not follow from it at once are solved afresh.
        thorough: See `calib.core.robots.continuation.follow`; False may leave poses open that close.
        limits: Whether solutions beyond the limits of a passive joint are refused.
    """
    n, n_passive = len(actuated), len(mechanism.passive)
    if not mechanism.loops:
        return LoopSolution(np.zeros((n, 0)), np.ones(n, dtype=bool), np.zeros((n, 0, 0)))
    if seed is None:
        found = follow(mechanism, mode, actuated, thorough=thorough)
        passive, ok, slope = wrap_turns(mechanism, mode, found.passive), found.ok, found.slope
    else:
        slope, seeded = None, np.all(np.isfinite(seed), axis=1)
        passive, ok = np.full((n, n_passive), np.nan), np.zeros(n, dtype=bool)
        part = slice(None) if np.all(seeded) else seeded
        passive[part], _, _, ok[part] = newton(mechanism, mode, actuated[part], seed[part], slopes=False)
        passive = wrap_turns(mechanism, mode, passive)
        ok &= are_within_limits(mechanism, passive) | (not limits)
        todo = np.flatnonzero(~ok)
        if len(todo):
            found = follow(mechanism, mode, actuated[todo], thorough=thorough)
            passive[todo], ok[todo] = wrap_turns(mechanism, mode, found.passive), found.ok
    ok &= are_within_limits(mechanism, passive) | (not limits)
    passive[~ok] = np.nan
    hold(passive)
    if slope is not None:
        slope[~ok] = np.nan
        hold(slope)
    return LoopSolution(passive, ok, slope)


def carries_home(mechanism: Mechanism, mode: AssemblyMode) -> bool:
    """Return whether home can be carried over to the origins of `mechanism`, and closes there in its assembly mode."""
    at_home = mode.actuated[None], mode.passive[None]
    return not mechanism.loops or bool(carry(mechanism, mode, *at_home, slopes=False).ok[0])


def wrap_turns(mechanism: Mechanism, mode: AssemblyMode, passive: FloatArray) -> FloatArray:
    """Bring turning joints of (n, n_passive) [m or rad] within half a turn of home, or within their limits.

    A full turn is the same pose, unless a joint follows in another proportion.
    """
    turn = 2 * np.pi
    turns = np.round((passive - mode.passive) / turn)
    if not turns.any() and np.all(are_within_limits(mechanism, passive)):
        return passive
    near_home = passive - turn * turns
    low, high = mechanism.lower - LIMIT_MARGIN, mechanism.upper + LIMIT_MARGIN
    raised = near_home + turn * np.ceil((low - near_home) / turn)
    lowered = near_home - turn * np.ceil((near_home - high) / turn)
    inside = np.where((near_home < low) & (raised <= high), raised, near_home)
    inside = np.where((near_home > high) & (lowered >= low), lowered, inside)
    return np.where(mechanism.passive_repeats, inside, passive)


def are_within_limits(mechanism: Mechanism, passive: FloatArray) -> BoolArray:
    """Return where passive joints (n, n_passive) [m or rad] keep their limits, (n,)."""
    low, high = mechanism.lower - LIMIT_MARGIN, mechanism.upper + LIMIT_MARGIN
    inside: BoolArray = (passive >= low) & (passive <= high)
    return np.all(inside, axis=1)


def _smallest_gap(mechanism: Mechanism, mode: AssemblyMode, actuated: FloatArray) -> tuple[FloatArray, FloatArray]:
    """How far each loop stays open at best in a pose (n_actuated,) that does not close: (n_loops,) [m] and [rad].

    All are 0 where the loops do close, but in another assembly mode, or where no way leads from home.
    """
    weight = np.where(mechanism.is_metre_row, 1 / mechanism.length, 1.0)

    def values(passive: FloatArray) -> FloatArray:
        return weight * closure.residual(mechanism, actuated[None], passive[None])[0][0]

    def slope(passive: FloatArray) -> FloatArray:
        return weight[:, None] * closure.residual(mechanism, actuated[None], passive[None])[1][0]

    best = scipy.optimize.least_squares(values, mode.passive, jac=slope, x_scale=mechanism.passive_scale, max_nfev=200)
    return _loop_openings(mechanism, best.fun / weight)


def _loop_openings(mechanism: Mechanism, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """How far each loop is open by r (n_rows,): lengths [m] and angles [rad], (n_loops,) each."""
    ends = np.cumsum([len(loop.rows) for loop in mechanism.loops])[:-1]
    lengths = np.where(mechanism.is_metre_row, values, 0.0)
    norms = [[np.linalg.norm(part) for part in np.split(each, ends)] for each in (lengths, values - lengths)]
    return np.array(norms[0]), np.array(norms[1])


def _gap_text(length: float, angle: float, form: str = "") -> str:
    """A gap in mm, and in degrees where a loop's directions do not agree, in a form if it is given."""
    turned = f" and {quantity_text(angle, 'deg', form or '.3g')}" if angle > 0 else ""
    return quantity_text(length, "mm", form or ".3f") + turned


def why_open(mechanism: Mechanism, mode: AssemblyMode, actuated: FloatArray) -> str:
    """Return the reason why a pose, its actuated joints (n_actuated,) [m or rad], could not be closed, in words."""
    alone = follow(mechanism, mode, actuated[None])
    if alone.ok[0]:
        passive = wrap_turns(mechanism, mode, alone.passive)
        if are_within_limits(mechanism, passive)[0]:
            return "it closes if solved alone, but the path from the other poses ends beyond the limits of a joint"
        return "its loops close only with " + _joint_beyond_limits(mechanism, passive[0])
    lengths, angles = _smallest_gap(mechanism, mode, actuated)
    loop = int(np.argmax(lengths / mechanism.length + angles))
    if max(lengths[loop], angles[loop]) > _CLOSED:
        return f"loop {mechanism.loops[loop].name} stays open by {_gap_text(lengths[loop], angles[loop])} at best"
    return "its loops close there, but no path from home was found in the assembly mode of home"


def _joint_beyond_limits(mechanism: Mechanism, passive: FloatArray) -> str:
    """Name the joint that is farthest beyond its limits."""
    excess = np.maximum(mechanism.lower - passive, passive - mechanism.upper)
    worst = int(np.argmax(excess))
    dimension: Dimension = "length" if mechanism.is_metre_column[worst] else "angle"
    unit = DISPLAY_UNIT[dimension]
    value, far, low, high = (
        in_unit(float(x[worst]), unit) for x in (passive, excess, mechanism.lower, mechanism.upper)
    )
    return (
        f"passive {joints_named(mechanism.passive[worst])} at {value:.4g} {unit}, {far:.3g} {unit} beyond its limits"
        f" ({low:.4g} to {high:.4g} {unit})"
    )


def check_home(mechanism: Mechanism, home: dict[str, float], singularity_limit: float, where: str) -> AssemblyMode:
    """Check that the home configuration (by joint name [m or rad]) closes, polish it, and record its assembly mode.

    Without loops, missing names count as 0. `DescriptionError` if home does not close, or is singular: the smallest
    singular value of the scaled C_p is below the limit.
    """
    actuated = np.array([[home.get(name, 0.0) for name in mechanism.driven]])
    passive = np.array([[home.get(name, 0.0) for name in mechanism.passive]])
    if not mechanism.loops:
        return AssemblyMode(mechanism, actuated[0], passive[0], (), (), np.ones(0))
    missing = [name for name in mechanism.actuated + mechanism.passive if name not in home]
    if missing:
        raise DescriptionError(
            f"{where}: home: gives no value for joint '{missing[0]}'; a robot with loops needs an"
            " assembled configuration of every joint"
        )
    values, slope, _ = closure.residual(mechanism, actuated, passive)
    _check_closed(mechanism, values, where)
    _check_regular(mechanism, slope, singularity_limit, where)
    rows, columns = closure.blocks(np.abs(closure.scale_closure(mechanism, slope)[0]) > 1e-9)
    mode = AssemblyMode(mechanism, actuated[0], passive[0], rows, columns, closure.block_signs(slope, rows, columns)[0])
    polished, _, _, ok = newton(mechanism, mode, actuated, passive)
    if not ok[0]:
        raise DescriptionError(
            f"{where}: home: cannot be closed to {closing_tolerance(mechanism):.2g} m from the values given"
        )
    return AssemblyMode(mechanism, actuated[0], polished[0], rows, columns, mode.signs)


def _check_closed(mechanism: Mechanism, values: FloatArray, where: str) -> None:
    lengths, angles = _loop_openings(mechanism, values[0])
    limit = _OPEN_HOME * mechanism.length
    excess = np.maximum(lengths / limit, angles / _OPEN_HOME)
    loop = int(np.argmax(excess))
    if excess[loop] > 1:
        nearer = _gap_text(limit, _OPEN_HOME if angles[loop] > 0 else 0.0, ".0f")
        raise DescriptionError(
            f"{where}: home: loop {mechanism.loops[loop].name} is open by {_gap_text(lengths[loop], angles[loop])};"
            f" give joint values at which the robot is assembled (to {nearer} or better)"
        )


def _check_regular(mechanism: Mechanism, slope: FloatArray, limit: float, where: str) -> None:
    smallest = float(closure.singular_values(mechanism, slope)[0])
    if smallest < limit:
        scaled = closure.scale_closure(mechanism, slope)[0]
        left = linalg.svd(scaled)[0][:, -1]  # the direction in which closures hold nothing
        open_by = np.hypot(*_loop_openings(mechanism, left))
        loose = [loop.name for loop, size in zip(mechanism.loops, open_by, strict=True) if size > 0.3]
        raise DescriptionError(
            f"{where}: home: the closures do not determine the passive joints (smallest singular value {smallest:.2g}"
            f" of the scaled passive Jacobian, limit {limit:g}; look at {', '.join(loose)}): home is singular, or"
            " closed_loop_axes names a direction that the mechanism does not constrain"
        )
