"""Positions: where a point is in the measurement frame, by a tracker, a measuring arm, or a photogrammetric system."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from calib.base.arrays import FloatArray
from calib.base.parameter import Parameter
from calib.instruments.kind import Column, Comparison, Instrument, InstrumentSection, Part, Readings, View
from calib.instruments.noise import Noise, PartNoise, PositionSigma

AXES = ("x", "y", "z")
POSITION = Part("position", AXES, "length")


class PositionSection(InstrumentSection):
    """An instrument that measures the position of a target.

    Attributes:
        target: Which one; the instrument's own name if left out.
        sigma: Its noise: one number, three, or a tracker's `{range, angle}`.
    """

    target: str | None = None
    sigma: PositionSigma | None = None


@dataclass(frozen=True)
class Position(Instrument):
    """Positions of one target in the measurement frame: three rows."""

    section: ClassVar[type[InstrumentSection]] = PositionSection
    parts: ClassVar[tuple[Part, ...]] = (POSITION,)  # type: ignore[misc]
    name: str
    target: str
    group: str
    noise: Noise = field(default_factory=lambda: Noise((PartNoise(),)))
    unknowns: tuple[Parameter, ...] = ()

    @classmethod
    def of(cls, name: str, section: PositionSection) -> Position:
        """Return the instrument that an entry of a robot description means."""
        return cls(name, section.target or name, name, Noise((PartNoise.of(section.sigma, 3),)))

    def columns(self) -> tuple[Column, ...]:
        """Return `<name>_x`, `_y`, `_z`."""
        return tuple(Column(f"{self.name}_{axis}", "length") for axis in AXES)

    def predict(self, view: View, unknowns: FloatArray, details: FloatArray) -> FloatArray:
        """Return p_ab, (n, 3) [m]."""
        return view.translation

    def compare(self, view: View, unknowns: FloatArray, readings: Readings) -> Comparison:
        """Return p_ab minus the positions read; only dp moves it."""
        n = len(readings)
        by_twist = np.zeros((n, 3, 6))
        by_twist[:, :, :3] = np.eye(3)
        return Comparison(view.translation - readings.values, by_twist, np.zeros((n, 3, 0)))

    def points(self, values: FloatArray) -> FloatArray:
        """Return the positions themselves."""
        return values
