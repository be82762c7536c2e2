"""Pointing: directions in which a target's x axis really looked, by stars, or by marks that it was brought onto.

With d the unit vector to what was pointed at, in the axes of the target (x forward, y to the left, z up),

    left = atan2(d_y, d_x)      up = atan2(d_z, hypot(d_x, d_y))        both 0

d is that of azimuth and altitude, which are the reading, turned by R_ab of the measurement frame seen from the target;
or of p_ab, a mark of known or unknown place. Azimuth counts from x of the measurement frame, as compasses do from north
(clockwise seen from above), or against the clock.

When it fails. A mark that is where the target is has no direction. Directions show no length.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field

from calib.core.base.arrays import FloatArray
from calib.core.base.sections import PositiveAngle
from calib.core.instruments.kind import Column, InstrumentSection, Part, Readings, View
from calib.core.instruments.noise import Noise, PartNoise
from calib.core.instruments.relation import RelatedSection, Relation


class PointingSection(InstrumentSection):
    """A mount that points.

    Attributes:
        target: What points, along its x axis; the instrument's own name if left out.
        marks: What it was pointed at, by name; left out: directions, which the file has.
        azimuth: How these count: `compass`, from x by way of -y; or `counterclockwise`, from x by way of y.
        sigma: Noise of each of both angles [rad].
    """

    target: str | None = None
    marks: dict[str, RelatedSection] = Field(default={})
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
    def of(cls, name: str, section: PointingSection) -> Pointing:
        """Return the instrument that an entry of a robot description means."""
        own = tuple(mark.place(key) for key, mark in section.marks.items())
        kind = PointingAtMarks if own else Pointing
        sense = -1.0 if section.azimuth == "compass" else 1.0
        noise = Noise((PartNoise.of(section.sigma, 2),))
        return kind(name, section.target or name, own, noise=noise, sense=sense)

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
        return _off(np.einsum("nij,nj->ni", view.rotation, there))

    def moved(self, values: FloatArray, change: FloatArray) -> FloatArray:
        """Return directions that lie so much less to the left and up."""
        off = -change / np.column_stack([self.sense * np.cos(values[:, 1]), np.ones(len(values))])
        return values + off


@dataclass(frozen=True)
class PointingAtMarks(Pointing):
    """Marks that a target looked at; nothing is read but the joints."""

    touches = True

    def columns(self) -> tuple[Column, ...]:
        """Return nothing."""
        return ()

    def predict(self, view: View, unknowns: FloatArray, details: FloatArray) -> FloatArray:
        """Return how far left and up of the x axis the mark is, (n, 2) [rad]."""
        return _off(view.translation)

    def misses(self, view: View, unknowns: FloatArray, readings: Readings) -> FloatArray:
        """Return the prediction minus what the touch misses by, (n, 2) [rad]."""
        return self.predict(view, unknowns, readings.details) - readings.values

    def moved(self, values: FloatArray, change: FloatArray) -> FloatArray:
        """Return values with errors."""
        return values + change


def _off(there: FloatArray) -> FloatArray:
    """How far left and up of the x axis directions (n, 3) are, (n, 2) [rad]."""
    x, y, z = there.T
    return np.column_stack([np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))])
