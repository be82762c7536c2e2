"""Harmonics: an error that repeats with the joint's turn, as of an eccentric encoder, or with the teeth of a gear."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from calib.arrays import FloatArray
from calib.joint_terms.periodic import AMPLITUDE, bound_of_curvature, period, sines_and_cosines
from calib.joint_terms.term import Context, Joint, JointTerm, TermSection, coefficient
from calib.parameter import Parameter
from calib.sections import Length


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
    def of(cls, joint: Joint, section: HarmonicsSection, sigma: float | None) -> Harmonics:
        """Return the term that an entry of a robot description means.

        Raises:
            ValueError: The entry does not fit the joint.
        """
        repeats = period(joint.dimension, section, "period", section.period)
        size = AMPLITUDE[joint.dimension] if sigma is None else sigma
        names = [f"{joint.name}.{kind}{order}" for order in section.orders for kind in ("sin", "cos")]
        return cls(
            joint.name, tuple(coefficient(name, joint.dimension, size) for name in names), section.orders, repeats
        )

    def columns(self, q: FloatArray, j: int, context: Context) -> FloatArray:
        """Return sines and cosines, (n, 2 n_orders)."""
        return sines_and_cosines(q[:, j], self.orders, self.period)

    def curvature(self, values: FloatArray) -> float:
        """Return a bound of |d^2(dq)/dq^2| [1/rad or 1/m], from the coefficients (2 n_orders,)."""
        return bound_of_curvature(values, self.orders, self.period)
