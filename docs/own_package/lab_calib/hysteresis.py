"""Hysteresis: a joint that lags behind its command, by an amount that changes over its turn.

dq = d (a sin q + b cos q), with the direction of approach d = +1 or -1: the play of a gear that is worn on one side.
"""

from dataclasses import dataclass

import numpy as np

from calib.extend import Condition, Context, Joint, JointTerm, Parameter, TermSection, coefficient


@dataclass(frozen=True)
class Hysteresis(JointTerm):
    """Half of the play over the joint's turn, to the side from which the joint comes."""

    cause = "hysteresis"
    depends_on = (Condition.APPROACH,)
    per = "to either side"
    joint: str
    parameters: tuple[Parameter, ...]

    @classmethod
    def from_section(cls, joint: Joint, section: TermSection, sigma: float | None) -> "Hysteresis":
        """Return the term that an entry of a robot description means."""
        if cls.needs_more(joint.dimension):
            raise ValueError(cls.needs_more(joint.dimension))
        names = [f"{joint.name}.hysteresis_{wave}" for wave in ("sin", "cos")]
        return cls(joint.name, tuple(coefficient(name, joint.dimension, sigma or 2e-4) for name in names))

    @classmethod
    def needs_more(cls, dimension: str) -> str:
        """Say that a joint that slides has no turn."""
        return "it repeats with the turn of a joint, and sliding joints have none" if dimension == "length" else ""

    def columns(self, q: np.ndarray, j: int, context: Context) -> np.ndarray:
        """Return d sin q and d cos q, (n, 2)."""
        return context.approach[:, [j]] * np.column_stack([np.sin(q[:, j]), np.cos(q[:, j])])
