"""One system of whitened rows: the source of every statement about measurements.

A reading of m components gives m rows. With the covariance of its noise, s_g^2 C_k (C_k as stated, s_g the scale of its
group, 1 where it is stated and not contradicted, else found from the residuals), residuals r and scaled Jacobian J
(columns times the parameters' sigma) are whitened reading by reading,

    [rw, Jw] = D^(-1/2) [r, J],        D = blocks s_g^2 C_k

Where an instrument reads several times at a pose (markers before a camera, repeats of a point), these readings share
what the model leaves out there, so that they tell less than as many readings elsewhere. With e_c what an offset of
component c does to the instrument's rows,

    D = R (blocks s_g^2 C_k) R,        R = (I + sum of (kappa_c / s_g)^2 e_c e_c^T)^(1/2) in whitened rows, pose by pose

with kappa_c^2 the variance of that offset: n readings weigh like n / (1 + n kappa^2 / s^2), many like one or two.

Estimates are weighed by R only where it predicts poses that were left out better than R = 1 does
(`calib.core.fitting.solving`): what looks precise within a pose may be wrong in the same way at each, as a lens or a
board is, and would then get all the weight. Whatever readings of a pose share, and whatever its shape is, widens
intervals, not weights (`calib.core.numerics.clusters`): weighing by a guess at the shape of what the model leaves out
made real robots' predictions worse (UR10, full poses: 0.467 mm in place of 0.442 on rows not used; Motoman, tracker and
cameras: 0.076 in place of 0.072). Visits that repeat one pose share one error: what the model leaves out there is the
same each time.

A component that was not read has a row of zeros, which says nothing; it is not counted.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.core.base.arrays import FloatArray, IntArray, ReadOnlyArrays
from calib.core.instruments.kind import Part
from calib.core.numerics.linear_model import LinearModel, RowGroups
from calib.core.numerics.losses import StudentisedErrors, studentised
from calib.core.numerics.tall import Span
from calib.core.numerics.variance_components import SharedError


@dataclass(frozen=True)
class Group:
    """Rows whose noise has one scale.

    Attributes:
        name: Of the instruments' group.
        part: Which rows of their readings.
        stated: Whether their noise is stated.
        typical: Typical standard deviation as stated, or 1 SI unit [SI].
    """

    name: str
    part: Part
    stated: bool
    typical: float


@dataclass(frozen=True, eq=False)
class Scales(ReadOnlyArrays):
    """Scales of the noise relative to its statement.

    Attributes:
        groups: s_g of the module docstring, (n_groups,).
        ratios: kappa_c over s_g, by which estimates are weighed, (n_offsets,); all 0 for none.
    """

    groups: FloatArray
    ratios: FloatArray


@dataclass(frozen=True, eq=False)
class Layout(RowGroups):
    """Which row is what: instrument by instrument, reading by reading.

    Attributes:
        instruments: Names of the instruments that read anything.
        start: First reading of each instrument, and the number of all, (n_instruments + 1,).
        first_row: The same for rows, (n_instruments + 1,).
        reading: Reading of each row, (n_rows,).
        visit: Visit of each reading, (n_readings,).
        pose: Pose of each reading; visits that repeat a pose share it, (n_readings,).
        width: Components that each reading really has, (n_readings,).
        groups: The groups of rows.
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
        """Number of rows, those that were not read included."""
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

    @property
    def poses_of_groups(self) -> IntArray:
        """Number of poses that each group was read at, (n_groups,)."""
        pose = self.pose_of_row
        return np.array([len(np.unique(pose[self.group == g])) for g in range(len(self.groups))])

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
    """Whitened rows of readings.

    Attributes:
        layout: Which row is what.
    """

    layout: Layout

    def with_weights(self, weights: FloatArray) -> Rows:
        """Return the rows with these weights of the readings, (n_readings,); themselves where all are 1."""
        if np.all(weights == 1.0):
            return self
        root = np.sqrt(weights)[self.layout.reading]
        return replace(self, residuals=root * self.residuals, jacobian=root[:, None] * self.jacobian)

    def whiten_shared(self, shared: SharedError | None) -> Rows:
        """Return the rows whitened for errors that the rows of a pose share; as they are without any."""
        if shared is None:
            return self
        return replace(self, residuals=shared.whiten(self.residuals), jacobian=shared.whiten(self.jacobian))

    def studentise(
        self, root: FloatArray, weights: FloatArray, freedom: float, scale: float | None = None
    ) -> StudentisedErrors:
        """Judge every reading.

        Args:
            root: T of `calib.core.numerics.observability`, (n_free, rank).
            weights: Of each reading in the fit, (n_readings,); 0 for those that had no part in it.
            freedom: Degrees of freedom of the fit.
            scale: See `calib.core.numerics.losses`; from these readings if not given.
        """
        layout, span = self.layout, Span(self.jacobian, root)
        return studentised(self.residuals, span, layout.reading, layout.width, weights, freedom, scale)

    def distances(self) -> FloatArray:
        """Return the length of each reading's whitened residual, (n_readings,)."""
        squares = np.bincount(self.layout.reading, self.residuals**2, self.layout.n_readings)
        return np.sqrt(squares)
