"""Cables on spools: how far a motor has turned tells how far a moving target is from where its cable is anchored.

    |p_ab| - L - (R + g phi / (4 pi)) phi / n = 0,        phi = gear * motor

with the length L at angle 0, the radius R of the spool there, its growth g with every turn, and n lines from spool to
target (2 for a pulley on it). The robot is the target itself: joints x, y, z are where it is, by a camera or a probe.
What comes out is what its controller needs to go anywhere: anchors, lengths, spools.

When it fails. Anchors in one plane with all targets; a length that is not known with an anchor that is not known, of a
target that hardly moves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydantic import Field

from calib.core.base.arrays import FloatArray
from calib.core.base.sections import KNOWN_ZERO, LengthOrUnknown, OwnLength, PositiveLength, PositiveLengthOrUnknown
from calib.core.instruments.kind import Column, InstrumentSection, Part, Readings, View
from calib.core.instruments.noise import Noise, PartNoise
from calib.core.instruments.relation import RelatedSection, Relation


class CableSection(InstrumentSection):
    """A cable, of lengths that are known, expected as `{value, sigma}`, or `unknown` [m].

    Attributes:
        target: Where it ends; the instrument's own name if left out.
        anchor: Where it leaves for the target.
        length: From there to the target where the motor is at 0.
        spool: Its radius there.
        growth: How much the radius grows with every turn of the spool.
        gear: Turns of the spool per turn of the motor.
        lines: How many lines run from the spool to the target and back.
        sigma: Noise, in the distance [m].
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
    """Angles of the motor of one cable: one row, in the distance. Lengths are L, R and g."""

    section = CableSection
    parts = (Part("cable", ("cable",), "length"),)
    lengths: tuple[OwnLength, ...] = ()
    gear: float = 1.0
    lines: int = 1

    @classmethod
    def from_section(cls, name: str, section: CableSection) -> Cable:
        """Return the instrument that an entry of a robot description means."""
        lengths = (section.length, section.spool, section.growth)
        away = float(np.linalg.norm(section.anchor.xyz))  # where an unknown length starts
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
        per_turn = growth / (2 * np.pi)  # out = R phi + per_turn phi^2 / 2, the root next to 0 without growth
        phi = 2 * out / (radius + np.sqrt(radius**2 + 2 * per_turn * out))
        return phi[:, None] / self.gear

    def misses(self, view: View, unknowns: FloatArray, readings: Readings) -> FloatArray:
        """Return the distance to the anchor minus the length of the cable, (n, 1) [m]."""
        length, radius, growth = self._numbers(unknowns)
        phi = self.gear * readings.values
        out = (radius + growth * phi / (4 * np.pi)) * phi / self.lines
        return np.linalg.norm(view.translation, axis=1)[:, None] - length - out

    def with_errors(self, values: FloatArray, change: FloatArray) -> FloatArray:
        """Return angles that let out so much more, (n, 1) [rad]."""
        _, radius, growth = (own.value for own in self.lengths)
        return values + change * self.lines / (self.gear * (radius + growth * self.gear * values / (2 * np.pi)))

    def _numbers(self, unknowns: FloatArray) -> list[float]:
        """L, R and g."""
        found = iter(unknowns)
        return [float(next(found)) if own.unknown else own.value for own in self.lengths]
