"""Curve: any smooth error over the joint's value: gears, encoders, belts, screws, whatever their orders.

A periodic Gaussian process as a Fourier series. Over a turn (or, for a prismatic joint, over twice its stroke, so that
the two ends are free of each other),

    dq = sum over k = 1 .. K of a_k sin(k q) + b_k cos(k q),        a_k, b_k ~ N(0, (amplitude / k)^2)

Coefficients fall off with their order as those of a curve with bounded slope do. The amplitude is common to all orders
of a joint and found by marginal likelihood (`calib.numerics.variance_components`), so that the curve follows what the
data show and nothing else; where the joint did not move, it stays at zero with the prior's band.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from calib.arrays import FloatArray
from calib.joint_terms.periodic import AMPLITUDE, bound_of_curvature, period, sines_and_cosines
from calib.joint_terms.term import Context, Joint, JointTerm, TermSection, coefficient
from calib.parameter import Parameter
from calib.sections import Length


class CurveSection(TermSection):
    """A curve.

    Attributes:
        orders: K.
        stroke: Of a prismatic joint [m]; what its limits in the URDF allow if not given.
        found: Whether the amplitude is found from the data; else it is `sigma`.
    """

    orders: Annotated[int, Field(gt=0, le=500)] = 60
    stroke: Annotated[Length, Field(gt=0)] | None = None
    found: bool = True

    def within(self, stroke: float) -> CurveSection:
        """Return the entry with the stroke of a prismatic joint [m] where it states none."""
        return self if self.stroke is not None else self.model_copy(update={"stroke": stroke})


@dataclass(frozen=True)
class Curve(JointTerm):
    """A smooth curve over a turn, or over the stroke of a prismatic joint."""

    cause = "joint curves"
    section = CurveSection
    joint: str
    parameters: tuple[Parameter, ...]
    orders: int
    period: float

    @classmethod
    def of(cls, joint: Joint, section: CurveSection, sigma: float | None) -> Curve:
        """Return the term that an entry of a robot description means.

        Raises:
            ValueError: The entry does not fit the joint.
        """
        repeats = period(joint.dimension, section, "stroke", section.stroke)
        amplitude = AMPLITUDE[joint.dimension] if sigma is None else sigma
        family = f"{joint.name}.curve" if section.found else ""
        parameters = tuple(
            coefficient(f"{joint.name}.curve_{kind}{k}", joint.dimension, amplitude / k, family)
            for k in range(1, section.orders + 1)
            for kind in ("sin", "cos")
        )
        return cls(joint.name, parameters, section.orders, repeats if joint.dimension == "angle" else 2.0 * repeats)

    def columns(self, q: FloatArray, j: int, context: Context) -> FloatArray:
        """Return sines and cosines, (n, 2 K)."""
        return sines_and_cosines(q[:, j], range(1, self.orders + 1), self.period)

    def curvature(self, values: FloatArray) -> float:
        """Return a bound of |d^2(dq)/dq^2| [1/rad or 1/m], from the coefficients (2 n_orders,)."""
        return bound_of_curvature(values, range(1, self.orders + 1), self.period)
