"""What periodic terms share: after what they repeat, and their columns."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from calib.arrays import FloatArray
from calib.joint_terms.term import TermSection
from calib.units import Dimension

TURN = 2.0 * np.pi
AMPLITUDE: dict[Dimension, float] = {"angle": 3e-4, "length": 5e-5}
"""Expected size of an amplitude where nothing is stated [rad, m]."""


def period(dimension: Dimension, section: TermSection, key: str, length: float | None) -> float:
    """Return after what a term of a joint repeats: a turn [rad], or the stated length of a prismatic joint [m].

    Args:
        dimension: The joint's.
        section: The term's entry.
        key: The entry's key of that length.
        length: What the entry says there [m].

    Raises:
        ValueError: A prismatic joint without a length, or a length that is stated for one revolute joint.
    """
    if dimension == "length":
        if length is None:
            raise ValueError(f"a prismatic joint needs the length `{key}`")
        return length
    if length is not None and section.joint != "all":  # of all joints, the length is for the prismatic ones
        raise ValueError(f"`{key}` is for prismatic joints; this one repeats after a turn: leave it out")
    return TURN


def sines_and_cosines(q: FloatArray, orders: npt.ArrayLike, period: float) -> FloatArray:
    """Return sin and cos of each order in turn, (n, 2 n_orders), at joint values q (n,) [rad or m]."""
    phase = np.outer(q, np.asarray(orders)) * (TURN / period)
    return np.stack([np.sin(phase), np.cos(phase)], axis=2).reshape(len(q), -1)


def bound_of_curvature(values: FloatArray, orders: npt.ArrayLike, period: float) -> float:
    """Return sum of |a_k| (2 pi k / period)^2, from the coefficients of sines and cosines, (2 n_orders,)."""
    amplitude = np.hypot(values[0::2], values[1::2])
    return float(amplitude @ (np.asarray(orders) * TURN / period) ** 2)
