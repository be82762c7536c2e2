"""Patterns of holes or pins with a known pitch: the target is in a hole, and only the joints are read.

With p = p_ab, the target in the frame of hole 0/0, whose x and y axes run along rows of holes, and pitch d,

    (p_x - i d, p_y - j d, p_z)         i / j: the hole as stated in the file, or the nearest hole for `?`

The nearest hole is found again at every estimate; the first estimate places the pattern by the stated holes.

When it fails. Errors of half a pitch: the nearest hole is the wrong one, which `check_holes` reports. Without three
stated holes the pattern must be known to half a pitch.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from pydantic import Field

from calib.core.base.arrays import FloatArray, IntArray
from calib.core.base.errors import DataError
from calib.core.base.sections import KNOWN_ZERO, OwnLength, PositiveLength, PositiveLengthOrUnknown
from calib.core.fitting.fitted import Fit
from calib.core.instruments.kind import Comparison, Guess, InstrumentSection, Part, Readings, Scene, View
from calib.core.instruments.noise import Noise, PartNoise
from calib.core.instruments.relation import RelatedSection, Relation
from calib.core.judging.reasons import Reason

_HOLE, _NEAREST = re.compile(r"(\d+)\s*[/;:, ]\s*(\d+)"), "?"


class HolePatternSection(InstrumentSection):
    """Place of hole 0/0, distance of holes [m], numbers of holes along x and y, noise of the target in a hole [m]."""

    target: str | None = None
    pattern: RelatedSection
    pitch: PositiveLengthOrUnknown
    holes: tuple[Annotated[int, Field(gt=0)], Annotated[int, Field(gt=0)]]
    sigma: PositiveLength | tuple[PositiveLength, PositiveLength, PositiveLength] | None = None


@dataclass(frozen=True)
class HolePattern(Relation):
    """Holes of a pattern; details of a reading are i, j, and 1 if these are stated, else 0."""

    section = HolePatternSection
    parts = (Part("hole", ("x", "y", "z"), "length", usual=2e-3, plural="positions in holes"),)
    touches = True
    pitch: OwnLength = KNOWN_ZERO
    holes: tuple[int, int] = (1, 1)

    @classmethod
    def from_section(cls, name: str, section: HolePatternSection) -> HolePattern:
        """Return the instrument of an entry in a robot description."""
        own, size = (section.pattern.place(f"{name}_pattern"),), section.pitch
        noise, unknowns = Noise((PartNoise.from_sigma(section.sigma, 3),)), size.parameters(f"{name}.pitch")
        return cls(name, section.target or name, own, size, section.holes, noise=noise, unknowns=unknowns)

    def parse_texts(
        self, texts: Mapping[str, Sequence[str]], where: Sequence[str]
    ) -> tuple[Sequence[bool], IntArray, FloatArray]:
        """Read the hole of each row, as `3/5`, or `?` for the nearest; an empty cell is no reading."""
        details = np.zeros((len(where), 3))
        for k, text in enumerate(texts[self.name]):
            hole = _HOLE.fullmatch(text)
            if hole and int(hole[1]) < self.holes[0] and int(hole[2]) < self.holes[1]:
                details[k] = int(hole[1]), int(hole[2]), 1
            elif text not in ("", _NEAREST):
                raise DataError(
                    f"{where[k]}, column '{self.name}': '{text:.60}' is none of the {self.holes[0]} x {self.holes[1]}"
                    " holes; write 3/5 for hole 3 along x and 5 along y, counted from 0, or ? for the nearest"
                )
        return [bool(text) for text in texts[self.name]], np.zeros(len(where), dtype=np.intp), details

    def texts(self, pairs: IntArray, details: FloatArray) -> dict[str, list[str]]:
        """Return the holes."""
        return {self.name: [f"{i:.0f}/{j:.0f}" if stated else _NEAREST for i, j, stated in details]}

    def looks(self) -> tuple[IntArray, FloatArray]:
        """Return every hole."""
        i, j = (numbers.ravel() for numbers in np.meshgrid(*map(np.arange, self.holes), indexing="ij"))
        return np.zeros(len(i), dtype=np.intp), np.column_stack([i, j, 1 + 0 * i]).astype(float)

    def predict(self, view: View, unknowns: FloatArray, details: FloatArray) -> FloatArray:
        """Return the position of the target relative to its hole, (n, 3) [m]."""
        hole = np.append(unknowns, self.pitch.value)[0] * self._holes(view, unknowns, details)
        return view.translation - np.column_stack([hole, np.zeros(len(hole))])

    def compare(self, view: View, unknowns: FloatArray, readings: Readings) -> Comparison:
        """Return the position of the target relative to its hole; derivatives are at a fixed hole."""
        details = np.column_stack([self._holes(view, unknowns, readings.details), np.ones(len(readings))])
        return super().compare(view, unknowns, replace(readings, details=details))

    def _holes(self, view: View, unknowns: FloatArray, details: FloatArray) -> FloatArray:
        """The stated or else the nearest hole, (n, 2)."""
        nearest = np.rint(view.translation[:, :2] / np.append(unknowns, self.pitch.value)[0])
        inside = np.clip(nearest, 0, np.array(self.holes) - 1)
        return np.where(details[:, 2:] > 0, details[:, :2], inside)

    def first_values(self, scene: Scene) -> tuple[Guess, ...]:
        """Return first values of the pattern's place, from the stated holes if three or more, else from all."""
        stated = np.flatnonzero(scene.readings.details[:, 2] > 0)
        chosen = stated if len(stated) > 2 else np.arange(len(scene.readings))
        return super().first_values(replace(scene, readings=scene.readings.subset(chosen), links=scene.links[chosen]))


def check_holes(fit: Fit) -> Iterator[Reason]:
    """Yield a reason against rows whose nearest hole is ambiguous."""
    for board in (board for board in fit.identification.instruments if isinstance(board, HolePattern)):
        readings, off = fit.identification.data.readings.get(board.name), fit.identification.after.get(board.name)
        if readings is not None and off is not None:
            unclear = (readings.details[:, 2] == 0) & (np.abs(off[:, :2]).max(axis=1) > board.pitch.value / 4)
            if count := int(np.sum(unclear)):
                sentence = (
                    f"{count} of the rows with {_NEAREST} are more than a quarter of a pitch from the nearest hole"
                )
                yield Reason("FAIL", "between_holes", f"{sentence} of {board.name}: state more holes, far apart")
