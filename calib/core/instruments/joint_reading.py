"""Readings of a joint: an encoder on a joint that loops determine, or a second one on a joint with a motor.

One row: the joint's value, plus the encoder's reading at the joint's zero,

    q_j + zero - reading

wrapped to half a turn either way for a joint that turns: an encoder does not count turns.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import model_validator

from calib.core.base.arrays import FloatArray
from calib.core.base.parameter import Parameter
from calib.core.base.sections import Quantity
from calib.core.base.units import DISPLAY_UNIT, Dimension, quantity
from calib.core.instruments.kind import Column, InstrumentSection, JointComparison, JointInstrument, Part, Readings
from calib.core.instruments.noise import Noise, PartNoise

_FACTORS = (2.0, 0.5, 4.0, 0.25)  # usual mistakes in counts a turn
_SCALE = 1e-2  # of an unknown zero without `sigma_zero` [rad or m]


class JointReadingSection(InstrumentSection):
    """An encoder on a joint.

    Attributes:
        joint: The joint.
        dimension: `angle` for a joint that turns, `length` for one that slides.
        sigma: Noise of a reading.
        offset: Its reading where the joint is at zero.
        zero: Whether `offset` is right, or must be found from the measurements.
        sigma_zero: Expected distance of an unknown zero from `offset`; without it, `offset` is only a start.
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
        """Return a key's quantity [m or rad], or None; another dimension raises `ValueError`."""
        value = getattr(self, key)
        return None if value is None else quantity(value, self.dimension, key, ValueError)


@dataclass(frozen=True)
class JointReading(JointInstrument):
    """Values of one joint: one row."""

    section = JointReadingSection
    dimension: Dimension = "angle"
    offset: float = 0.0

    @classmethod
    def from_section(cls, name: str, section: JointReadingSection) -> JointReading:
        """Return the instrument that an entry of a robot description means."""
        dimension, prior = section.dimension, section.number("sigma_zero")
        offset = section.number("offset") or 0.0
        size, is_prior = prior or _SCALE, prior is not None
        zero = Parameter(f"{name}.zero", dimension, offset, size, DISPLAY_UNIT[dimension], is_prior, placement=True)
        noise = Noise((PartNoise.from_sigma(section.number("sigma"), 1),))
        unknowns = (zero,) if section.zero == "unknown" else ()
        return cls(name, section.joint, dimension, offset, noise=noise, unknowns=unknowns)

    @property
    def parts(self) -> tuple[Part, ...]:
        """The joint."""
        name = "angle" if self.dimension == "angle" else "slide"  # two kinds of joints are two parts
        return (Part(name, (name,), self.dimension),)

    def columns(self) -> tuple[Column, ...]:
        """Return one column with the instrument's name."""
        return (Column(self.name, self.dimension),)

    def predict(self, joint: FloatArray, unknowns: FloatArray, details: FloatArray) -> FloatArray:
        """Return the joint's value plus the zero, (n, 1) [m or rad]."""
        return (joint + (unknowns[0] if len(unknowns) else self.offset))[:, None]

    def compare(self, joint: FloatArray, unknowns: FloatArray, readings: Readings) -> JointComparison:
        """Return errors of the joint, and their derivatives by the joint and the zero."""
        n = len(readings)
        residuals = self.predict(joint, unknowns, readings.details) - readings.values
        if self.dimension == "angle":  # a whole turn is no error
            residuals = np.mod(residuals + np.pi, 2 * np.pi) - np.pi
        return JointComparison(residuals, np.ones((n, 1)), np.ones((n, 1, len(unknowns))))

    def first_unknowns(self, joint: FloatArray, unknowns: FloatArray, readings: Readings) -> FloatArray:
        """Return the zero that fits the present joint values: the mean, or on a circle the direction of the mean."""
        seen = np.isfinite(readings.values[:, 0]) & np.isfinite(joint)
        if len(unknowns) == 0 or not np.any(seen):
            return unknowns
        off = (readings.values[:, 0] - joint)[seen]
        if self.dimension == "length":
            return np.array([np.mean(off)])
        mean = float(np.angle(np.mean(np.exp(1j * off))))
        turns = np.round((np.median(off) - mean) / (2 * np.pi))
        return np.array([mean + 2 * np.pi * turns])

    def other_meanings(self, values: FloatArray) -> Iterator[tuple[str, FloatArray]]:
        """Yield an encoder that counts the other way, or on another scale."""
        yield f"{self.name} counts the other way", -values
        for factor in _FACTORS:
            yield f"{self.name} was {1 / factor:g} times as far (counts a turn, or a gear)", factor * values
        if self.dimension == "angle":
            yield f"degrees of {self.name} were read as radians", np.radians(values)
            yield f"radians of {self.name} were read as degrees", np.degrees(values)
