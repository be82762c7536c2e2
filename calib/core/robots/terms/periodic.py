"""Periodic terms: harmonics of a joint's turn, and a curve of any shape.

Harmonics: an error that repeats with each turn of the joint, such as of an eccentric encoder, or with gear teeth.

Curve: any smooth error over the joint's value, such as of gears, encoders, belts or screws. It is a periodic Gaussian
process, written as a Fourier series. The period is a turn, or twice the stroke of a prismatic joint, so that the errors
at its two ends are independent:

    dq = sum over k = 1 .. K of a_k sin(k q) + b_k cos(k q),        a_k, b_k ~ N(0, (amplitude / k)^2)

Coefficients decrease with their order as those of a curve with bounded slope. The amplitude is common to all orders of
a joint, and is found by marginal likelihood (`calib.core.numerics.size_search`), so that the curve is as large
as the data show. Where the joint did not move, the curve stays at zero, with the standard deviation of the prior.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from calib.core.base.arrays import FloatArray
from calib.core.base.parameter import Parameter
from calib.core.base.sections import Length
from calib.core.base.units import Dimension
from calib.core.robots.terms.formula import Formula, WaveFormula
from calib.core.robots.terms.term import Joint, JointTerm, TermSection, coefficient

TURN = 2.0 * np.pi
AMPLITUDE: dict[Dimension, float] = {"angle": 3e-4, "length": 5e-5}
"""Sigma of an amplitude where none is stated [rad, m]."""


def period(dimension: Dimension, section: TermSection, key: str, length: float | None) -> float:
    """Return the period of a joint's term: a turn [rad], or of a prismatic joint the `length` that `key` states [m].

    `ValueError` if a prismatic joint has none, or an entry for one revolute joint states it.
    """
    if dimension == "length":
        if length is None:
            raise ValueError(f"a prismatic joint needs the length `{key}`")
        return length
    if length is not None and section.joint != "all":  # an entry for all joints has it for the prismatic ones
        raise ValueError(f"`{key}` is for prismatic joints; this one repeats after a turn: leave it out")
    return TURN


@dataclass(frozen=True)
class _Periodic(JointTerm):
    """dq = sum over orders k of a_k sin(k q) + b_k cos(k q), where one `period` counts as 2 pi.

    Attributes:
        orders: All orders k.
        period: Period of the first order [rad or m].
    """

    joint: str
    parameters: tuple[Parameter, ...]
    orders: tuple[int, ...]
    period: float

    def formula(self, j: int) -> Formula:
        """Return sines and cosines of every order."""
        return WaveFormula(j, TURN / self.period, self.orders)

    def curvature(self, values: FloatArray) -> float:
        """Return sum of |a_k| (2 pi k / period)^2 [1/rad or 1/m], from the coefficients (2 n_orders,)."""
        amplitude = np.hypot(values[0::2], values[1::2])
        return float(amplitude @ (np.asarray(self.orders) * TURN / self.period) ** 2)


class HarmonicsSection(TermSection):
    """Harmonics of a joint.

    Attributes:
        orders: Cycles per turn, or per `period` of a prismatic joint.
        period: Length after which the error of a prismatic joint repeats, such as the lead of its screw [m].
    """

    orders: tuple[Annotated[int, Field(gt=0)], ...] = (1, 2)
    period: Annotated[Length, Field(gt=0)] | None = None


class Harmonics(_Periodic):
    """Harmonics of the joint's turn, or of a period."""

    cause = "gain and harmonics"
    section = HarmonicsSection

    @classmethod
    def from_section(cls, joint: Joint, section: HarmonicsSection, sigma: float | None) -> Harmonics:
        """Return the term of an entry of a robot description; one that does not fit the joint is a `ValueError`."""
        repeats = period(joint.dimension, section, "period", section.period)
        size = AMPLITUDE[joint.dimension] if sigma is None else sigma
        names = [f"{joint.name}.{kind}{order}" for order in section.orders for kind in ("sin", "cos")]
        return cls(
            joint.name, tuple(coefficient(name, joint.dimension, size) for name in names), section.orders, repeats
        )

    @classmethod
    def needs_more(cls, dimension: Dimension) -> str:
        """Return why a prismatic joint needs an entry of its own: the lead of its screw is not known."""
        return "prismatic joints need a period, which only a description can state" if dimension == "length" else ""


class CurveSection(TermSection):
    """A curve.

    Attributes:
        orders: Number of orders K.
        stroke: Stroke of a prismatic joint [m]; from its limits in the URDF if not given.
        found: Whether the amplitude is found from the data; else it is `sigma`.
    """

    orders: Annotated[int, Field(gt=0, le=500)] = 60
    stroke: Annotated[Length, Field(gt=0)] | None = None
    found: bool = True

    def with_stroke(self, stroke: float) -> CurveSection:
        """Return the entry with the stroke of a prismatic joint [m] where it states none."""
        return self if self.stroke is not None else self.model_copy(update={"stroke": stroke})


class Curve(_Periodic):
    """A smooth curve over a turn, or over the stroke of a prismatic joint."""

    cause = "joint curves"
    differs = True
    section = CurveSection

    @classmethod
    def from_section(cls, joint: Joint, section: CurveSection, sigma: float | None) -> Curve:
        """Return the term of an entry of a robot description; one that does not fit the joint is a `ValueError`."""
        repeats = period(joint.dimension, section, "stroke", section.stroke)
        amplitude = AMPLITUDE[joint.dimension] if sigma is None else sigma
        family = f"{joint.name}.curve" if section.found else ""
        orders = tuple(range(1, section.orders + 1))
        parameters = tuple(
            coefficient(f"{joint.name}.curve_{kind}{k}", joint.dimension, amplitude / k, family)
            for k in orders
            for kind in ("sin", "cos")
        )
        return cls(joint.name, parameters, orders, repeats if joint.dimension == "angle" else 2.0 * repeats)
