"""Sightings: points on any link or in the world, seen by a sensor on any link in its own axes.

    p_ab = (x, y, z),      a: the sensor, which is the target; b: the point

Examples: a fixed ball seen by a scanner or a depth camera on the hand; a finger that touches a skin of the same robot:
the readings are the places, in the skin's axes, of the cells (taxels) that feel the finger.

When it fails. If the hand never turns about some axis, the components of sensor and point along it cannot be separated:
their heights, on a robot that turns about the vertical alone.
"""

from __future__ import annotations

from dataclasses import dataclass

from pydantic import Field

from calib.core.base.arrays import FloatArray
from calib.core.base.sections import PositiveLength
from calib.core.instruments.kind import InstrumentSection, Part, View
from calib.core.instruments.noise import Noise, PartNoise
from calib.core.instruments.relation import RelatedSection, Relation


class SightingSection(InstrumentSection):
    """A sensor that sees points in three dimensions.

    Attributes:
        target: The sensor; default: the instrument's own name.
        points: The observed points, by name.
        sigma: Noise of each coordinate [m]: one number, or three.
    """

    target: str | None = None
    points: dict[str, RelatedSection] = Field(min_length=1)
    sigma: PositiveLength | tuple[PositiveLength, PositiveLength, PositiveLength] | None = None


@dataclass(frozen=True)
class Sighting(Relation):
    """Coordinates of a point in the axes of the target: three rows."""

    section = SightingSection
    parts = (Part("sighting", ("x", "y", "z"), "length"),)
    from_target = True

    @classmethod
    def from_section(cls, name: str, section: SightingSection) -> Sighting:
        """Return the instrument of an entry in a robot description."""
        own = tuple(point.place(key) for key, point in section.points.items())
        return cls(name, section.target or name, own, noise=Noise((PartNoise.from_sigma(section.sigma, 3),)))

    def predict(self, view: View, unknowns: FloatArray, details: FloatArray) -> FloatArray:
        """Return p_ab, (n, 3) [m]."""
        return view.translation

    def seen_points(self, values: FloatArray) -> FloatArray:
        """Return the coordinates themselves."""
        return values
