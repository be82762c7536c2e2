"""Backlash: an error of half the play, by the direction from which the joint came."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.arrays import FloatArray
from calib.joint_terms.term import Context, JointTerm, TermSection, coefficient
from calib.parameter import Parameter
from calib.units import Dimension

DEFAULT: dict[Dimension, float] = {"angle": 2e-4, "length": 5e-5}
"""Expected half of the play where nothing is stated [rad, m]."""


@dataclass(frozen=True)
class Backlash(JointTerm):
    """dq = c times the direction of approach, +1 or -1; 0 where it is not known."""

    cause = "backlash"
    depends_on = "the direction of approach"
    joint: str
    parameters: tuple[Parameter, ...]

    @classmethod
    def of(cls, joint: str, dimension: Dimension, section: TermSection, sigma: float | None) -> Backlash:
        """Return the term that an entry of a robot description means."""
        size = DEFAULT[dimension] if sigma is None else sigma
        return cls(joint, (coefficient(f"{joint}.backlash", dimension, size),))

    def columns(self, q: FloatArray, j: int, context: Context) -> FloatArray:
        """Return the direction of approach, (n, 1)."""
        return np.asarray(context.approach[:, j : j + 1])
