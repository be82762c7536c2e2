"""Gain: an error in proportion to the joint's value, as of a gear ratio, a belt, or the pitch of a lead screw."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.arrays import FloatArray
from calib.joint_terms.term import Context, JointTerm, TermSection, coefficient
from calib.parameter import Parameter
from calib.units import Dimension

DEFAULT = 1e-3  # a thousandth of the motion


@dataclass(frozen=True)
class Gain(JointTerm):
    """dq = c q, with q in radians or metres."""

    joint: str
    parameters: tuple[Parameter, ...]

    @classmethod
    def of(cls, joint: str, dimension: Dimension, section: TermSection, sigma: float | None) -> Gain:
        """Return the term that an entry of a robot description means."""
        return cls(joint, (coefficient(f"{joint}.gain", dimension, DEFAULT if sigma is None else sigma),))

    def columns(self, q: FloatArray, j: int, context: Context) -> FloatArray:
        """Return q, (n, 1)."""
        return np.asarray(q[:, j : j + 1])
