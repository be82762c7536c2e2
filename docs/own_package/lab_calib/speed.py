"""Lag: a joint that stands behind its command by a time times its speed, which the column `speed` of a file says."""

from dataclasses import dataclass

import numpy as np

from calib.extend import Condition, Context, Joint, JointTerm, Parameter, TermSection, coefficient

SPEED = Condition("the speed", "speed")


@dataclass(frozen=True)
class Lag(JointTerm):
    """An error in proportion to the speed, in part of the largest one, in which the joint was read."""

    cause, per = "lag", "at full speed"
    depends_on = (SPEED,)
    follows_command = False
    joint: str
    parameters: tuple[Parameter, ...]

    @classmethod
    def from_section(cls, joint: Joint, section: TermSection, sigma: float | None) -> "Lag":
        """Return the term that an entry of a robot description means."""
        return cls(joint.name, (coefficient(f"{joint.name}.lag", joint.dimension, sigma or 1e-3),))

    def columns(self, q: np.ndarray, j: int, context: Context) -> np.ndarray:
        """Return the speed, (n, 1)."""
        return context.column(SPEED.column)[:, None]
