"""Pointing: directions in which a target's x axis really looked, as stars or a plate solver tell.

With d the unit vector of the azimuth and altitude that were read, turned by R_ab of the measurement frame seen from the
target into its axes (x forward, y to the left, z up),

    left = atan2(d_y, d_x)      up = atan2(d_z, hypot(d_x, d_y))        both 0

Azimuth counts from x of the measurement frame, as compasses do from north (clockwise seen from above), or against the
clock. Errors are angles on the sky, so that nothing happens at the zenith.

When it fails. Directions show no length.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.sections import PositiveAngle
from calib.core.instruments.kind import Column, InstrumentSection, Part, Readings, View
from calib.core.instruments.noise import Noise, PartNoise
from calib.core.instruments.relation import Relation


class PointingSection(InstrumentSection):
    """A mount that points.

    Attributes:
        target: What points, along its x axis; the instrument's own name if left out.
        azimuth: How these count: `compass`, from x by way of -y; or `counterclockwise`, from x by way of y.
        sigma: Noise of each of both angles [rad].
    """

    target: str | None = None
    azimuth: Literal["compass", "counterclockwise"] = "compass"
    sigma: PositiveAngle | None = None


@dataclass(frozen=True)
class Pointing(Relation):
    """Directions that a target looked in: two rows, across and up."""

    section = PointingSection
    parts = (Part("pointing", ("left", "up"), "angle", plural="directions"),)
    from_target = True
    sense: float = -1.0

    @classmethod
    def from_section(cls, name: str, section: PointingSection) -> Pointing:
        """Return the instrument that an entry of a robot description means."""
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
        """Return how far left and up of the x axis the direction is that was read, (n, 2) [rad]."""
        azimuth, altitude = self.sense * readings.values[:, 0], readings.values[:, 1]
        level = np.cos(altitude)
        there = np.column_stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(altitude)])
        x, y, z = np.einsum("nij,nj->ni", view.rotation, there).T
        return np.column_stack([np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))])

    def with_errors(self, values: FloatArray, change: FloatArray) -> FloatArray:
        """Return directions that lie so much less to the left and up, (n, 2) [rad]."""
        off = -change / np.column_stack([self.sense * np.cos(values[:, 1]), np.ones(len(values))])
        return values + off
