"""Drift: an error that grows with time (`drift`) or with temperature (`temperature`)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.arrays import FloatArray
from calib.joint_terms.term import Context, JointTerm, TermSection, coefficient
from calib.parameter import Parameter
from calib.units import Dimension

HOUR = 3600.0
DEFAULT: dict[Dimension, float] = {"angle": 1e-4, "length": 2e-5}
"""Expected error per hour, or per kelvin, where nothing is stated [rad, m]."""


@dataclass(frozen=True)
class Drift(JointTerm):
    """dq = c times the hours since the first visit."""

    cause = "drift"
    depends_on = "time"
    joint: str
    parameters: tuple[Parameter, ...]

    @classmethod
    def of(cls, joint: str, dimension: Dimension, section: TermSection, sigma: float | None) -> Drift:
        """Return the term that an entry of a robot description means."""
        size = DEFAULT[dimension] if sigma is None else sigma
        return cls(joint, (coefficient(f"{joint}.drift", dimension, size),))

    def columns(self, q: FloatArray, j: int, context: Context) -> FloatArray:
        """Return hours, (n, 1)."""
        return np.asarray(context.time[:, None] / HOUR)


@dataclass(frozen=True)
class Temperature(JointTerm):
    """dq = c times the kelvins above the mean."""

    cause = "drift"
    depends_on = "temperature"
    joint: str
    parameters: tuple[Parameter, ...]

    @classmethod
    def of(cls, joint: str, dimension: Dimension, section: TermSection, sigma: float | None) -> Temperature:
        """Return the term that an entry of a robot description means."""
        size = DEFAULT[dimension] if sigma is None else sigma
        return cls(joint, (coefficient(f"{joint}.temperature", dimension, size),))

    def columns(self, q: FloatArray, j: int, context: Context) -> FloatArray:
        """Return kelvins, (n, 1)."""
        return np.asarray(context.temperature[:, None])
