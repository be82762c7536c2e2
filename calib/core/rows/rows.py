"""One system of whitened rows: the source of every statement about measurements.

A reading of m components gives m rows. The covariance of its noise is s_g^2 C_k, with C_k the stated covariance and s_g
the scale of its group: 1 where the noise is stated and not contradicted, else found from the residuals. Residuals r and
scaled Jacobian J (columns times the parameters' sigma) are whitened reading by reading,

    [rw, Jw] = D^(-1/2) [r, J],        D = blocks s_g^2 C_k

Where an instrument reads several times at a pose (markers before a camera, repeats of a point), these readings share
the error of the model there. An error of any shape that readings of a pose share widens intervals, and does not change
weights (`calib.core.numerics.clusters`): weights by a guess of its shape made predictions of real robots worse (UR10,
full poses: 0.467 mm instead of 0.442 on unused rows; Motoman, tracker and cameras: 0.076 instead of 0.072). Weights by
an offset that all readings of an instrument at a pose share changed one fit of all real ones, whose pixels were wrong
(docs/uncertainty.md).

A component that was not read has a row of zeros, which has no effect and is not counted.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.core.base.arrays import FloatArray, IntArray
from calib.core.instruments.kind import Part
from calib.core.numerics.linear_model import LinearModel, RowGroups
from calib.core.numerics.losses import StudentisedErrors, studentised
from calib.core.numerics.tall import Span


@dataclass(frozen=True)
class Group:
    """Rows whose noise has one scale.

    Attributes:
        part: Part of the readings that has the rows.
        typical: Typical standard deviation as stated, or 1 SI unit [SI].
    """

    name: str
    part: Part
    stated: bool
    typical: float


@dataclass(frozen=True, eq=False)
class Layout(RowGroups):
    """Order of the rows: instrument by instrument, reading by reading.

    Attributes:
        instruments: Names of the instruments that have readings.
        start: Index of the first reading of each instrument, then the number of all, (n_instruments + 1,).
        first_row: Index of the first row of each instrument, then the number of all, (n_instruments + 1,).
        reading: Reading of each row, (n_rows,).
        visit: Visit of each reading, (n_readings,).
        pose: Pose of each reading; visits that repeat a pose share it, (n_readings,).
        width: Number of components of each reading that were read, (n_readings,).
    """

    instruments: tuple[str, ...]
    start: IntArray
    first_row: IntArray
    reading: IntArray
    visit: IntArray
    pose: IntArray
    width: IntArray
    groups: tuple[Group, ...]

    @property
    def n_rows(self) -> int:
        """Number of rows, including those that were not read."""
        return len(self.reading)

    @property
    def n_read(self) -> int:
        """Number of rows that were read."""
        return int(np.sum(self.width))

    @property
    def n_readings(self) -> int:
        """Number of readings."""
        return len(self.visit)

    @property
    def pose_of_row(self) -> IntArray:
        """Pose of each row, (n_rows,)."""
        return self.pose[self.reading]

    def rows_of(self, instrument: str) -> slice:
        """Return the rows of an instrument."""
        k = self.instruments.index(instrument)
        return slice(int(self.first_row[k]), int(self.first_row[k + 1]))

    def readings_of(self, instrument: str) -> slice:
        """Return the readings of an instrument."""
        k = self.instruments.index(instrument)
        return slice(int(self.start[k]), int(self.start[k + 1]))


@dataclass(frozen=True, eq=False)
class Rows(LinearModel):
    """Whitened rows of readings, in the order of `layout`."""

    layout: Layout

    def with_weights(self, weights: FloatArray) -> Rows:
        """Return the rows with weights of the readings, (n_readings,); the same object where all are 1."""
        if np.all(weights == 1.0):
            return self
        root = np.sqrt(weights)[self.layout.reading]
        return replace(self, residuals=root * self.residuals, jacobian=root[:, None] * self.jacobian)

    def studentise(
        self, span: Span, weights: FloatArray, freedom: float, scale: float | None = None
    ) -> StudentisedErrors:
        """Studentise the error of every reading.

        Args:
            span: J T of the rows, with T of `calib.core.numerics.observability`, (n_rows, rank).
            weights: Weight of each reading in the fit, (n_readings,); 0 for unused readings.
            scale: See `calib.core.numerics.losses`; found from these readings if not given.
        """
        layout = self.layout
        return studentised(self.residuals, span, layout.reading, layout.width, weights, freedom, scale)

    def distances(self) -> FloatArray:
        """Return the length of each reading's whitened residual, (n_readings,)."""
        squares = np.bincount(self.layout.reading, self.residuals**2, self.layout.n_readings)
        return np.sqrt(squares)
