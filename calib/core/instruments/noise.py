"""Covariances of an instrument's readings, from its stated noise.

The noise is stated as one standard deviation for each row. For positions by a tracker at the origin of the measurement
frame it may be stated as one standard deviation along the beam, and one for both angles across it:

    covariance = range^2 u u^T + (angle |p|)^2 (I - u u^T),        u = p / |p|

Where a file states the covariance of a reading, that one is used. Where nothing is stated, every row of a part has the
same unknown standard deviation: the covariance is that of 1 SI unit, and its scale is found from the residuals
(`calib.core.numerics.size_search`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from pydantic import Discriminator, Tag

from calib.core.base.arrays import FloatArray
from calib.core.base.sections import PositiveAngle, PositiveLength, Section


class Beam(Section):
    """Noise of a tracker: along its beam [m], and of the two angles across it [rad]."""

    range: PositiveLength
    angle: PositiveAngle


def _form(value: Any) -> str:
    if isinstance(value, (dict, Beam)):
        return "beam"
    return "axes" if isinstance(value, (list, tuple)) else "number"


PositionSigma = Annotated[
    Annotated[PositiveLength, Tag("number")]
    | Annotated[tuple[PositiveLength, PositiveLength, PositiveLength], Tag("axes")]
    | Annotated[Beam, Tag("beam")],
    Discriminator(_form),
]
"""Noise of a position: one number, one for each axis, or the `Beam` of a tracker."""
AngleSigma = Annotated[
    Annotated[PositiveAngle, Tag("number")]
    | Annotated[tuple[PositiveAngle, PositiveAngle, PositiveAngle], Tag("axes")],
    Discriminator(_form),
]
"""Noise of an orientation: one number, or one for each axis."""


@dataclass(frozen=True)
class PartNoise:
    """Noise of the rows of one part.

    Attributes:
        std: Standard deviation of each row [SI]; None if it is not stated.
        beam: Noise of a tracker, in place of `std`.
    """

    std: tuple[float, ...] | None = None
    beam: Beam | None = None

    @property
    def stated(self) -> bool:
        """Whether the description states the noise."""
        return self.std is not None or self.beam is not None

    @staticmethod
    def from_sigma(sigma: float | tuple[float, ...] | Beam | None, n_rows: int) -> PartNoise:
        """Return the noise that a description states in any of its forms."""
        if isinstance(sigma, Beam):
            return PartNoise(beam=sigma)
        if sigma is None:
            return PartNoise()
        return PartNoise(std=tuple(sigma) if isinstance(sigma, (tuple, list)) else (float(sigma),) * n_rows)

    def covariance(self, points: FloatArray | None, n: int, n_rows: int) -> FloatArray:
        """Return the covariance of n readings, (n, n_rows, n_rows) [SI^2].

        Only a `Beam` needs the positions of the target in the tracker's frame, (n, 3) [m].
        """
        if self.beam is not None and points is not None:
            distance = np.linalg.norm(points, axis=1)
            unit = points / np.where(distance > 0, distance, 1.0)[:, None]
            along = unit[:, :, None] * unit[:, None, :]
            across = np.maximum(self.beam.angle * distance, 1e-12)[:, None, None]
            return self.beam.range**2 * along + across**2 * (np.eye(3) - along)
        std = np.ones(n_rows) if self.std is None else np.array(self.std)
        return np.broadcast_to(np.diag(std**2), (n, n_rows, n_rows)).copy()


@dataclass(frozen=True)
class Noise:
    """Noise of an instrument, part by part."""

    parts: tuple[PartNoise, ...]

    def covariance(self, points: FloatArray | None, n: int, widths: Sequence[int]) -> FloatArray:
        """Return the covariance of n readings whose parts have these numbers of rows, (n, n_rows, n_rows) [SI^2]."""
        total = sum(widths)
        result = np.zeros((n, total, total))
        start = 0
        for part, width in zip(self.parts, widths, strict=True):
            rows = slice(start, start + width)
            result[:, rows, rows] = part.covariance(points, n, width)
            start += width
        return result
