"""Compliance: joints give way under gravity, in proportion to the torque that they hold.

The torque is that of the URDF's masses (Pinocchio's generalized gravity at the nominal configuration), through closed
loops by virtual work, and what its load adds is left to the gain of the same column (a payload of known mass belongs
into the URDF).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from calib.arrays import FloatArray
from calib.joint_terms.term import Context, JointTerm, TermSection, coefficient
from calib.parameter import Parameter
from calib.units import Dimension

DEFAULT: dict[Dimension, float] = {"angle": 2e-5, "length": 1e-7}
"""Expected compliance where nothing is stated [rad / (N m), m / N]."""


@dataclass(frozen=True)
class Compliance(JointTerm):
    """dq = c times the torque of gravity that the joint holds."""

    cause = "load (compliance)"
    depends_on = "the load"
    needs_torque: ClassVar[bool] = True
    joint: str
    parameters: tuple[Parameter, ...]

    @classmethod
    def of(cls, joint: str, dimension: Dimension, section: TermSection, sigma: float | None) -> Compliance:
        """Return the term that an entry of a robot description means."""
        size = DEFAULT[dimension] if sigma is None else sigma
        return cls(joint, (coefficient(f"{joint}.compliance", dimension, size),))

    def columns(self, q: FloatArray, j: int, context: Context) -> FloatArray:
        """Return the torque, (n, 1)."""
        return np.asarray(context.torque[:, j : j + 1])
