"""Heights of a target above a plane, read by a probe, a dial gauge or a distance sensor along the normal.

    h = z of p_ab,      a: the plane z = 0 of its frame; b: the target

When it fails. Heights alone determine neither the place of the target in the plane, nor its rotation about the normal.
"""

from __future__ import annotations

from dataclasses import dataclass

from calib.core.base.arrays import FloatArray
from calib.core.base.sections import PositiveLength
from calib.core.instruments.kind import InstrumentSection, Part, View
from calib.core.instruments.noise import Noise, PartNoise
from calib.core.instruments.relation import RelatedSection, Relation


class HeightSection(InstrumentSection):
    """A probe over a plane.

    Attributes:
        target: The target; default: the instrument's own name.
        plane: Frame of the plane z = 0; default: the measurement frame.
        sigma: Its noise [m].
    """

    target: str | None = None
    plane: RelatedSection | None = None
    sigma: PositiveLength | None = None


@dataclass(frozen=True)
class Height(Relation):
    """Heights of a target over a plane: one row."""

    section = HeightSection
    parts = (Part("height", ("height",), "length", plural="heights"),)

    @classmethod
    def from_section(cls, name: str, section: HeightSection) -> Height:
        """Return the instrument of an entry in a robot description."""
        own = () if section.plane is None else (section.plane.place(f"{name}_plane"),)
        return cls(name, section.target or name, own, noise=Noise((PartNoise.from_sigma(section.sigma, 1),)))

    def predict(self, view: View, unknowns: FloatArray, details: FloatArray) -> FloatArray:
        """Return z of p_ab, (n, 1) [m]."""
        return view.translation[:, 2:]
