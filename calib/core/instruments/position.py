"""Positions of a point in the measurement frame, by a tracker, a measuring arm, or a photogrammetric system."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.instruments.kind import Comparison, FrameInstrument, InstrumentSection, Part, Readings, View
from calib.core.instruments.noise import Noise, PartNoise, PositionSigma

AXES = ("x", "y", "z")
POSITION = Part("position", AXES, "length", is_position=True)


class PositionSection(InstrumentSection):
    """An instrument that measures the position of a target.

    Attributes:
        target: Name of its target; the instrument's own name if left out.
        sigma: Its noise: one number, three, or a tracker's `{range, angle}`.
    """

    target: str | None = None
    sigma: PositionSigma | None = None


@dataclass(frozen=True)
class Position(FrameInstrument):
    """Positions of one target: three rows. Instruments of the same group, `together`, share their noise."""

    section = PositionSection
    parts = (POSITION,)
    together: str = ""

    @classmethod
    def from_section(cls, name: str, section: PositionSection) -> Position:
        """Return the instrument that an entry of a robot description means."""
        return cls(name, section.target or name, noise=Noise((PartNoise.from_sigma(section.sigma, 3),)))

    @property
    def group(self) -> str:
        """Its own name, or its shared group."""
        return self.together or self.name

    def predict(self, view: View, unknowns: FloatArray, details: FloatArray) -> FloatArray:
        """Return p_ab, (n, 3) [m]."""
        return view.translation

    def compare(self, view: View, unknowns: FloatArray, readings: Readings) -> Comparison:
        """Return p_ab minus the positions read, which only dp moves."""
        n = len(readings)
        by_twist = np.zeros((n, 3, 6))
        by_twist[:, :, :3] = np.eye(3)
        return Comparison(view.translation - readings.values, by_twist, np.zeros((n, 3, 0)))

    def points(self, values: FloatArray) -> FloatArray:
        """Return the positions themselves."""
        return values
