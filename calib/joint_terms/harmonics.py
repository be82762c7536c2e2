"""Harmonics: an error that repeats with the joint's turn, as of an eccentric encoder, or with the teeth of a gear."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from calib.arrays import FloatArray
from calib.joint_terms.term import Context, JointTerm, TermSection, coefficient
from calib.parameter import Parameter
from calib.sections import Length
from calib.units import Dimension

DEFAULT: dict[Dimension, float] = {"angle": 3e-4, "length": 5e-5}
"""Expected size of a coefficient where nothing is stated [rad, m]."""
TURN = 2.0 * np.pi


class HarmonicsSection(TermSection):
    """Harmonics of a joint.

    Attributes:
        orders: Cycles per turn, or per `period` of a prismatic joint.
        period: Length after which the error of a prismatic joint repeats, such as the lead of its screw [m].
    """

    orders: tuple[Annotated[int, Field(gt=0)], ...] = (1, 2)
    period: Annotated[Length, Field(gt=0)] | None = None


@dataclass(frozen=True)
class Harmonics(JointTerm):
    """dq = sum over orders k of a_k sin(k q) + b_k cos(k q), with q in turns of 2 pi or periods."""

    section = HarmonicsSection
    joint: str
    parameters: tuple[Parameter, ...]
    orders: tuple[int, ...]
    period: float

    @classmethod
    def of(cls, joint: str, dimension: Dimension, section: HarmonicsSection, sigma: float | None) -> Harmonics:
        """Return the term that an entry of a robot description means.

        Raises:
            ValueError: The entry does not fit the joint.
        """
        if dimension == "length" and section.period is None:
            raise ValueError(f"harmonics of the prismatic joint '{joint}' need a `period`, such as the screw's lead")
        size = DEFAULT[dimension] if sigma is None else sigma
        names = [f"{joint}.{kind}{order}" for order in section.orders for kind in ("sin", "cos")]
        period = TURN if section.period is None else section.period
        return cls(joint, tuple(coefficient(name, dimension, size) for name in names), section.orders, period)

    def columns(self, q: FloatArray, j: int, context: Context) -> FloatArray:
        """Return sines and cosines, (n, 2 n_orders)."""
        phase = np.outer(q[:, j], np.array(self.orders)) * (TURN / self.period)
        return np.stack([np.sin(phase), np.cos(phase)], axis=2).reshape(len(q), -1)
