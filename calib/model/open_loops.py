"""Why a pose cannot be assembled: a loop stays open, a passive joint passes its limit, or the assembly mode differs."""

from __future__ import annotations

import numpy as np
import scipy

from calib.arrays import FloatArray
from calib.model.assembly_mode import AssemblyMode
from calib.model.closure import gap_text, open_by, residual
from calib.model.continuation import follow
from calib.model.loops import wrapped
from calib.model.mechanism import Mechanism

_CLOSED = 1e-6  # the search for the smallest gap ends a few nanometres from closed [m or rad]


def smallest_gap(mechanism: Mechanism, mode: AssemblyMode, actuated: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return how far each loop stays open at best in one pose: (n_loops,) [m] and (n_loops,) [rad].

    All are 0 where the loops do close, but in another assembly mode, or where no way leads from home.

    Args:
        mechanism: The robot.
        mode: The assembly mode of home.
        actuated: Actuated joints of a pose that could not be closed, (n_actuated,) [m or rad].
    """
    weight = np.where(mechanism.is_metre_row, 1 / mechanism.length, 1.0)

    def values(passive: FloatArray) -> FloatArray:
        return weight * residual(mechanism, actuated[None], passive[None])[0][0]

    def slope(passive: FloatArray) -> FloatArray:
        return weight[:, None] * residual(mechanism, actuated[None], passive[None])[1][0]

    scale = np.where(mechanism.is_metre_column, mechanism.length, 1.0)
    best = scipy.optimize.least_squares(values, mode.passive, jac=slope, x_scale=scale, max_nfev=200)
    lengths, angles = open_by(mechanism, best.fun[None] / weight)
    return lengths[0], angles[0]


def why_open(mechanism: Mechanism, mode: AssemblyMode, actuated: FloatArray) -> str:
    """Say in words why a pose could not be closed.

    Args:
        mechanism: The robot.
        mode: The assembly mode of home.
        actuated: Its actuated joints, (n_actuated,) [m or rad].
    """
    passive, _, closes = follow(mechanism, mode, actuated[None])
    if closes[0]:
        return "its loops close only with " + _beyond(mechanism, wrapped(mechanism, mode, passive)[0])
    lengths, angles = smallest_gap(mechanism, mode, actuated)
    loop = int(np.argmax(lengths / mechanism.length + angles))
    if max(lengths[loop], angles[loop]) > _CLOSED:
        return f"loop {mechanism.loops[loop].name} stays open by {gap_text(lengths[loop], angles[loop])} at best"
    return "its loops close there, but no way leads there from home in its assembly mode"


def _beyond(mechanism: Mechanism, passive: FloatArray) -> str:
    """Name the joint that is farthest beyond its limits."""
    excess = np.maximum(mechanism.lower - passive, passive - mechanism.upper)
    worst = int(np.argmax(excess))
    metres = bool(mechanism.is_metre_column[worst])
    factor, unit = (1e3, "mm") if metres else (180 / np.pi, "deg")
    value, low, high = (factor * float(x[worst]) for x in (passive, mechanism.lower, mechanism.upper))
    return (
        f"passive joint {mechanism.passive[worst]} at {value:.4g} {unit}, beyond its limits"
        f" ({low:.4g} to {high:.4g} {unit})"
    )
