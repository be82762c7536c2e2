"""Readings of a joint: an encoder on a joint that loops decide, or a second one on a joint that has a motor.

One row: the joint's value, plus what the encoder reads where the joint is at zero,

    q_j + zero - reading

taken within half a turn where the joint turns: an encoder does not count turns.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar, Literal

import numpy as np
from pydantic import model_validator

from calib.base.arrays import FloatArray
from calib.base.errors import InputError
from calib.base.parameter import Parameter
from calib.base.sections import Quantity
from calib.base.units import DISPLAY_UNIT, Dimension, quantity
from calib.instruments.kind import Column, Comparison, Guess, Instrument, InstrumentSection, Part, Readings, Scene, View
from calib.instruments.noise import Noise, PartNoise

_SCALE: dict[str, float] = {"angle": 1e-2, "length": 1e-2}  # of an unknown zero that nothing is known of [rad, m]


class JointReadingSection(InstrumentSection):
    """An encoder on a joint.

    Attributes:
        joint: The joint.
        dimension: `angle` for a joint that turns, `length` for one that slides.
        sigma: Noise of a reading.
        offset: What it reads where the joint is at zero.
        zero: Whether that is right, or found from the measurements.
        sigma_zero: How far an unknown zero may be from `offset`; left out, `offset` says nothing.
    """

    joint: str
    dimension: Literal["angle", "length"] = "angle"
    sigma: Quantity | None = None
    offset: Quantity = 0.0
    zero: Literal["known", "unknown"] = "known"
    sigma_zero: Quantity | None = None

    @model_validator(mode="after")
    def _numbers(self) -> JointReadingSection:
        for key in ("sigma", "sigma_zero"):
            number = self.number(key)
            if number is not None and number <= 0:
                raise ValueError(f"{key} must be positive")
        self.number("offset")
        if self.sigma_zero is not None and self.zero == "known":
            raise ValueError("sigma_zero is for an encoder whose zero is unknown")
        return self

    def number(self, key: str) -> float | None:
        """Return a key's quantity [m or rad]; None where it is left out.

        Raises:
            ValueError: It has another dimension.
        """
        value = getattr(self, key)
        try:
            return None if value is None else quantity(value, self.dimension, key)
        except InputError as error:
            raise ValueError(str(error)) from None


@dataclass(frozen=True)
class JointReading(Instrument):
    """Values of one joint: one row."""

    section: ClassVar[type[InstrumentSection]] = JointReadingSection
    name: str
    joint: str
    dimension: Dimension = "angle"
    offset: float = 0.0
    noise: Noise = field(default_factory=lambda: Noise((PartNoise(),)))
    unknowns: tuple[Parameter, ...] = ()
    target: str = ""

    @classmethod
    def of(cls, name: str, section: JointReadingSection) -> JointReading:
        """Return the instrument that an entry of a robot description means."""
        dimension, prior = section.dimension, section.number("sigma_zero")
        offset = section.number("offset") or 0.0
        zero = Parameter(
            f"{name}.zero",
            dimension,
            offset,
            prior or _SCALE[dimension],
            DISPLAY_UNIT[dimension],
            prior=prior is not None,
            placement=True,
        )
        noise = Noise((PartNoise.of(section.number("sigma"), 1),))
        return cls(name, section.joint, dimension, offset, noise, (zero,) if section.zero == "unknown" else ())

    @property
    def group(self) -> str:  # type: ignore[override]
        """Its own."""
        return self.name

    @property
    def parts(self) -> tuple[Part, ...]:  # type: ignore[override]
        """The joint."""
        name = "angle" if self.dimension == "angle" else "slide"  # two kinds of joints are two parts
        return (Part(name, (name,), self.dimension),)

    def pairs(self, base: str) -> tuple[tuple[str, str], ...]:
        """Return none: it looks at no frames."""
        return ()

    def columns(self) -> tuple[Column, ...]:
        """Return one column with the instrument's name."""
        return (Column(self.name, self.dimension),)

    def predict(self, view: View, unknowns: FloatArray, details: FloatArray) -> FloatArray:
        """Return the joint's value and zero, (n, 1) [m or rad]."""
        return (view.joint + (unknowns[0] if len(unknowns) else self.offset))[:, None]

    def compare(self, view: View, unknowns: FloatArray, readings: Readings) -> Comparison:
        """Return errors of the joint, and how it and the zero move them."""
        n = len(readings)
        residuals = self._nearest(self.predict(view, unknowns, readings.details) - readings.values)
        return Comparison(residuals, np.zeros((n, 1, 6)), np.ones((n, 1, len(unknowns))), np.ones((n, 1)))

    def first_values(self, scene: Scene) -> tuple[Guess, ...]:
        """Return the zero that fits the joint as it is: the mean, or on a circle the direction of the mean."""
        seen = np.isfinite(scene.readings.values[:, 0]) & np.isfinite(scene.joint)
        if len(scene.unknowns) == 0 or not np.any(seen):
            return ()
        off = (scene.readings.values[:, 0] - scene.joint)[seen]
        if self.dimension == "length":
            return (Guess({}, np.array([np.mean(off)])),)
        mean = float(np.angle(np.mean(np.exp(1j * off))))
        turns = np.round((np.median(off) - mean) / (2 * np.pi))
        return (Guess({}, np.array([mean + 2 * np.pi * turns])),)

    def _nearest(self, off: FloatArray) -> FloatArray:
        if self.dimension == "length":
            return off
        return np.mod(off + np.pi, 2 * np.pi) - np.pi
