"""Distances of a target from a fixed point, by a ballbar, a draw wire, or an interferometer that follows it.

    r = |p_ab| + offset - d            dr = u^T dp,      u = p_ab / |p_ab|

The offset is a constant of the instrument: a dead path, or the zero of a wire. Several instruments of this kind at
different points make multilateration. The distances determine the fixed point (`calib.core.numerics.rigid`).

When it fails. A zero distance has no derivative: the target must not be at the instrument. A target that stays in one
plane does not show on which side of it the fixed point is; the side of the first value is kept.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import ComputationError, DataError
from calib.core.base.sections import KNOWN_ZERO, LengthOrUnknown, OwnLength, PositiveLength
from calib.core.base.units import quantity_text
from calib.core.instruments.kind import Comparison, Guess, InstrumentSection, Part, Readings, Scene, View
from calib.core.instruments.noise import Noise, PartNoise
from calib.core.instruments.relation import RelatedSection, Relation
from calib.core.numerics.rigid import centre, common_offset

DISTANCE = Part("distance", ("distance",), "length", is_distance=True)
_NOTHING = 1e-6  # distance that has no direction [m]


class DistanceSection(InstrumentSection):
    """An instrument that measures how far a target is from a fixed point.

    Attributes:
        target: Name of its target; the instrument's own name if left out.
        end: The fixed point; the origin of the measurement frame if left out.
        offset: Reading minus distance: a length; `{value, sigma}`; or `unknown`.
        sigma: Its noise [m].
    """

    target: str | None = None
    end: RelatedSection | None = None
    offset: LengthOrUnknown = KNOWN_ZERO
    sigma: PositiveLength | None = None


@dataclass(frozen=True)
class Distance(Relation):
    """Distances of one target from a fixed point, its own place if it has one: one row."""

    section = DistanceSection
    parts = (DISTANCE,)
    offset: OwnLength = KNOWN_ZERO

    @classmethod
    def from_section(cls, name: str, section: DistanceSection) -> Distance:
        """Return the instrument that an entry of a robot description means."""
        own = () if section.end is None else (section.end.place(f"{name}_end"),)
        unknowns = section.offset.parameters(f"{name}.offset")
        noise = Noise((PartNoise.from_sigma(section.sigma, 1),))
        return cls(name, section.target or name, own, section.offset, noise=noise, unknowns=unknowns)

    def values(self, columns: Mapping[str, FloatArray]) -> FloatArray:
        """Return distances, (n, 1) [m]."""
        (column,) = self.columns()
        read = columns[column.name]
        negative = np.flatnonzero(read < min(self.offset.value, 0.0))
        if len(negative) and not self.offset.unknown:
            k = int(negative[0])
            size = quantity_text(float(read[k]), "mm", "g")
            raise DataError(
                f"instrument '{self.name}', reading {k + 1}: {column.name} is {size}, which is not a distance; an"
                " instrument whose zero is elsewhere needs `offset` in the description"
            )
        return read[:, None]

    def predict(self, view: View, unknowns: FloatArray, details: FloatArray) -> FloatArray:
        """Return |p_ab| + offset, (n, 1) [m]."""
        return np.linalg.norm(view.translation, axis=1)[:, None] + self._offset(unknowns)

    def compare(self, view: View, unknowns: FloatArray, readings: Readings) -> Comparison:
        """Return predicted minus read; motion along the line of sight moves it."""
        length, unit = distances(view.translation, f"instrument '{self.name}': its target '{self.target}'")
        n = len(readings)
        by_twist = np.zeros((n, 1, 6))
        by_twist[:, 0, :3] = unit
        residuals = length[:, None] + self._offset(unknowns) - readings.values
        return Comparison(residuals, by_twist, np.ones((n, 1, len(self.unknowns))))

    def _offset(self, unknowns: FloatArray) -> float:
        return float(unknowns[0]) if len(unknowns) else self.offset.value

    def first_values(self, scene: Scene) -> tuple[Guess, ...]:
        """Return the fixed point by multilateration, in each setup that moved it."""
        if not self.own:
            return ()
        read, offset = np.isfinite(scene.readings.values[:, 0]), self._offset(scene.unknowns)
        places: dict[str, FloatArray] = {}
        for number, (a, b) in enumerate(scene.pairs):
            chosen = np.flatnonzero(read & (scene.readings.pairs == number))
            if not scene.unknown[a] or len(chosen) < 3 + len(self.unknowns):
                continue
            points, lengths = (scene.links[chosen] @ scene.places[b][:, 3])[:, :3], scene.readings.values[chosen, 0]
            near = scene.places[a][:3, 3]
            if self.unknowns and not self.unknowns[0].prior:
                offset = common_offset(points, lengths, near, offset)
            places[a] = scene.places[a].copy()
            places[a][:3, 3] = centre(points, lengths - offset, near)
        return (Guess(places, np.array([offset][: len(self.unknowns)])),) if places else ()


def distances(vectors: FloatArray, what: str) -> tuple[FloatArray, FloatArray]:
    """Return lengths (n,) and directions (n, 3) of vectors (n, 3) [m]; a zero one raises `ComputationError`."""
    length = np.linalg.norm(vectors, axis=1)
    if np.any(length < _NOTHING):
        raise ComputationError(
            f"{what} is within 1 um of the point that its distance is measured from, so that"
            " the distance has no direction; check both places in the description"
        )
    return length, vectors / length[:, None]
