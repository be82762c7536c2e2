"""Pointing: directions of a target's x axis, measured by stars or a plate solver.

Let d be the unit vector of the measured azimuth and altitude, turned from the measurement frame into the axes of the
target (x forward, y to the left, z up). Residuals are angles on the sky, so that the zenith is not singular:

    left = atan2(d_y, d_x)      up = atan2(d_z, hypot(d_x, d_y))

When it fails. Directions do not determine lengths.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.sections import PositiveAngle
from calib.core.instruments.kind import Column, InstrumentSection, Part, Readings, View
from calib.core.instruments.noise import Noise, PartNoise
from calib.core.instruments.relation import Relation


class PointingSection(InstrumentSection):
    """Its target points along x; azimuths count from x of the measurement frame, towards -y for a `compass`."""

    target: str | None = None
    azimuth: Literal["compass", "counterclockwise"] = "compass"
    sigma: PositiveAngle | None = None


@dataclass(frozen=True)
class Pointing(Relation):
    """Directions of a target: two rows, across and up."""

    section = PointingSection
    parts = (Part("pointing", ("left", "up"), "angle", plural="directions"),)
    from_target = True
    sense: float = -1.0

    @classmethod
    def from_section(cls, name: str, section: PointingSection) -> Pointing:
        """Return the instrument of an entry in a robot description."""
        sense = -1.0 if section.azimuth == "compass" else 1.0
        return cls(name, section.target or name, noise=Noise((PartNoise.from_sigma(section.sigma, 2),)), sense=sense)

    def columns(self) -> tuple[Column, ...]:
        """Return `<name>_az` and `_alt`."""
        return tuple(Column(f"{self.name}_{axis}", "angle") for axis in ("az", "alt"))

    def predict(self, view: View, unknowns: FloatArray, details: FloatArray) -> FloatArray:
        """Return azimuth and altitude of the target's x axis, (n, 2) [rad]."""
        x, y, z = view.rotation[:, 0].T  # seen from the measurement frame
        return np.column_stack([np.mod(self.sense * np.arctan2(y, x), 2 * np.pi), np.arctan2(z, np.hypot(x, y))])

    def misses(self, view: View, unknowns: FloatArray, readings: Readings) -> FloatArray:
        """Return the angles to the left and up from the x axis to the measured direction, (n, 2) [rad]."""
        azimuth, altitude = self.sense * readings.values[:, 0], readings.values[:, 1]
        level = np.cos(altitude)
        there = np.column_stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(altitude)])
        x, y, z = np.einsum("nij,nj->ni", view.rotation, there).T
        return np.column_stack([np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))])

    def with_errors(self, values: FloatArray, change: FloatArray) -> FloatArray:
        """Return directions moved to the right and down by `change`, (n, 2) [rad]."""
        off = -change / np.column_stack([self.sense * np.cos(values[:, 1]), np.ones(len(values))])
        return values + off

    def other_meanings(self, values: FloatArray) -> Iterator[tuple[str, FloatArray]]:
        """Yield what `values` (n, 2) [rad] mean by other conventions of directions."""
        azimuth, altitude = values.T
        for words, directions in (
            ("azimuths count the other way (`azimuth` in the description)", (-azimuth, altitude)),
            ("azimuths count from the opposite direction", (azimuth + np.pi, altitude)),
            ("zenith distances were read as altitudes", (azimuth, np.pi / 2 - altitude)),
            ("azimuths in hours were read as degrees", (15 * azimuth, altitude)),
            ("azimuth and altitude were swapped", (altitude, azimuth)),
        ):
            yield words, np.column_stack(directions)
