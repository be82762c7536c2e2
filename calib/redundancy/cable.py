"""Cables on spools: the angle of a motor measures the distance of a moving target from the anchor of its cable.

    |p_ab| - L - (R + g phi / (4 pi)) phi / n = 0,        phi = gear * motor

with the length L of the cable at angle 0, the radius R of the spool at angle 0, the growth g of the radius with every
turn, and n lines from spool to target (2 if the target has a pulley). The robot is the target itself: its joints x, y,
z are its position, measured by a camera or a probe. A fit determines anchors, lengths and spools for the controller.

When it fails. Anchors in a common plane with all positions of the target are not determined, nor is an unknown length
together with an unknown anchor if the target hardly moves.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from calib.core.base.arrays import FloatArray
from calib.core.base.sections import KNOWN_ZERO, LengthOrUnknown, OwnLength, PositiveLength, PositiveLengthOrUnknown
from calib.core.fitting.fitted import Fit
from calib.core.instruments.kind import Column, InstrumentSection, Part, Readings, View
from calib.core.instruments.noise import Noise, PartNoise
from calib.core.instruments.relation import RelatedSection, Relation
from calib.core.judging.reasons import Reason


class CableSection(InstrumentSection):
    """A cable. Its lengths [m] are known, expected as `{value, sigma}`, or `unknown`.

    Attributes:
        target: Target at the end of the cable; default: the instrument's own name.
        anchor: Point at which the cable leaves for the target.
        length: Length from the anchor to the target at motor angle 0.
        spool: Radius of the spool at motor angle 0.
        growth: Growth of the radius with every turn of the spool.
        gear: Turns of the spool per turn of the motor.
        lines: Number of lines between anchor and target.
        sigma: Noise of the distance [m].
    """

    target: str | None = None
    anchor: RelatedSection
    length: LengthOrUnknown
    spool: PositiveLengthOrUnknown
    growth: LengthOrUnknown = KNOWN_ZERO
    gear: float = Field(default=1.0, gt=0, allow_inf_nan=False)
    lines: int = Field(default=1, ge=1)
    sigma: PositiveLength | None = None


@dataclass(frozen=True)
class Cable(Relation):
    """Motor angles of one cable, with one row for the distance. `lengths` are L, R and g."""

    section = CableSection
    parts = (Part("cable", ("cable",), "length", plural="lengths of cables"),)
    lengths: tuple[OwnLength, ...] = ()
    gear: float = 1.0
    lines: int = 1

    @classmethod
    def from_section(cls, name: str, section: CableSection) -> Cable:
        """Return the instrument of an entry in a robot description."""
        lengths = (section.length, section.spool, section.growth)
        away = float(np.linalg.norm(section.anchor.xyz))  # first value of an unknown length
        unknowns = section.length.parameters(f"{name}.length", away)
        unknowns += section.spool.parameters(f"{name}.spool") + section.growth.parameters(f"{name}.growth")
        own, noise = (section.anchor.place(f"{name}_anchor"),), Noise((PartNoise.from_sigma(section.sigma, 1),))
        target = section.target or name
        return cls(name, target, own, lengths, section.gear, section.lines, noise=noise, unknowns=unknowns)

    def columns(self) -> tuple[Column, ...]:
        """Return one column with the instrument's name."""
        return (Column(self.name, "angle"),)

    def predict(self, view: View, unknowns: FloatArray, details: FloatArray) -> FloatArray:
        """Return the angle of the motor, (n, 1) [rad]."""
        length, radius, growth = self._numbers(unknowns)
        out = self.lines * (np.linalg.norm(view.translation, axis=1) - length)
        per_turn = growth / (2 * np.pi)  # the root of out = R phi + per_turn phi^2 / 2 that exists for zero growth, too
        phi = 2 * out / (radius + np.sqrt(radius**2 + 2 * per_turn * out))
        return phi[:, None] / self.gear

    def misses(self, view: View, unknowns: FloatArray, readings: Readings) -> FloatArray:
        """Return the distance to the anchor minus the length of the cable, (n, 1) [m]."""
        length, radius, growth = self._numbers(unknowns)
        phi = self.gear * readings.values
        out = (radius + growth * phi / (4 * np.pi)) * phi / self.lines
        return np.linalg.norm(view.translation, axis=1)[:, None] - length - out

    def with_errors(self, values: FloatArray, change: FloatArray) -> FloatArray:
        """Return the angles at which the cable is longer by `change`, (n, 1) [rad]."""
        _, radius, growth = (own.value for own in self.lengths)
        return values + change * self.lines / (self.gear * (radius + growth * self.gear * values / (2 * np.pi)))

    def other_meanings(self, values: FloatArray) -> Iterator[tuple[str, FloatArray]]:
        """Yield what `values` (n, 1) [rad] are if the motor counts the other way, or in another unit."""
        yield f"{self.name} counts the other way: positive angles must let the cable out", -values
        yield f"degrees of {self.name} were read as radians", np.radians(values)
        yield f"radians of {self.name} were read as degrees", np.degrees(values)

    def _numbers(self, unknowns: FloatArray) -> list[float]:
        """L, R and g of the module docstring."""
        found = iter(unknowns)
        return [float(next(found)) if own.unknown else own.value for own in self.lengths]


def check_spools(fit: Fit) -> Iterator[Reason]:
    """Yield a reason against cables whose spool has a negative radius: the motor counts the other way."""
    values = fit.robot.values_by_name
    for cable in (cable for cable in fit.identification.instruments if isinstance(cable, Cable)):
        if values.get(f"{cable.name}.spool", 1.0) < 0:
            text = f"the radius of the spool of {cable.name} is negative: it counts the other way"
            yield Reason("FAIL", "negative_spool", f"{text}; positive angles must let the cable out")
