"""One system of whitened rows: what every question about measurements is asked of.

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
from functools import cached_property

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray, IntArray, ReadOnlyArrays
from calib.core.instruments.kind import Part
from calib.core.numerics.identifiability import reduced
from calib.core.numerics.observability import Information, information
from calib.core.numerics.prior import Prior
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
    """What is assumed of the noise beyond what is stated.

    Attributes:
        groups: s_g of the module docstring, (n_groups,).
        ratios: kappa_c over s_g, by which estimates are weighed, (n_offsets,); all 0 for none.
    """

    groups: FloatArray
    ratios: FloatArray


@dataclass(frozen=True, eq=False)
class Layout(ReadOnlyArrays):
    """Which row is what: instrument by instrument, reading by reading.

    Attributes:
        instruments: Names of the instruments that read anything.
        start: First reading of each instrument, and the number of all, (n_instruments + 1,).
        first_row: The same for rows, (n_instruments + 1,).
        reading: Reading of each row, (n_rows,).
        visit: Visit of each reading, (n_readings,).
        pose: Pose of each reading; visits that repeat a pose share it, (n_readings,).
        width: Components that each reading really has, (n_readings,).
        group: Group of each row; -1 for a component that was not read, (n_rows,).
        groups: The groups.
    """

    instruments: tuple[str, ...]
    start: IntArray
    first_row: IntArray
    reading: IntArray
    visit: IntArray
    pose: IntArray
    width: IntArray
    group: IntArray
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

    def rows_of_readings(self, instrument: str, chosen: IntArray) -> IntArray:
        """Return the rows of some of the readings of an instrument, (n,), one reading's after the other's."""
        rows, readings = self.rows_of(instrument), self.readings_of(instrument)
        width = (rows.stop - rows.start) // (readings.stop - readings.start)
        return (rows.start + chosen[:, None] * width + np.arange(width)).ravel()


@dataclass(frozen=True, eq=False)
class Rows:
    """Whitened rows.

    Attributes:
        residuals: (n_rows,).
        jacobian: By the scaled free parameters, (n_rows, n_free).
        prior: Of these.
        deviations: u = (p - p_expected) / s of these, (n_free,).
        layout: Which row is what.
    """

    residuals: FloatArray
    jacobian: FloatArray
    prior: Prior
    deviations: FloatArray
    layout: Layout

    @cached_property
    def factor(self) -> FloatArray:
        """The triangular factor of [J r], all that a linear model needs: (n_free + 1, n_free + 1) or fewer rows."""
        return reduced(self.jacobian, self.residuals)

    def remember(self, factor: FloatArray) -> None:
        """Take over `factor` (n_free + 1, n_free + 1), where it is known."""
        vars(self)["factor"] = factor

    @property
    def _triangle(self) -> FloatArray:
        """That of J, (n_free, n_free) or fewer rows."""
        return self.factor[: self.jacobian.shape[1], :-1]

    @cached_property
    def known(self) -> Information:
        """What these rows and the priors determine."""
        return information(self._triangle, self.prior.rows)

    @cached_property
    def span(self) -> Span:
        """U = J T of these rows, with T of what they and the priors determine, (n_rows, rank)."""
        return Span(self.jacobian, self.known.root)

    @cached_property
    def alone(self) -> Information:
        """What these rows determine without priors."""
        return information(self._triangle)

    @property
    def cost(self) -> float:
        """Sum of the squares of residuals and priors."""
        return float(self.residuals @ self.residuals) + self.prior.cost(self.deviations)

    def only(self, chosen: BoolArray) -> Rows:
        """Return the rows by some of the parameters, (n_free,)."""
        return replace(
            self,
            jacobian=self.jacobian[:, chosen],
            prior=self.prior.only(chosen),
            deviations=self.deviations[chosen],
        )

    def weighted(self, weights: FloatArray) -> Rows:
        """Return the rows with these weights of the readings, (n_readings,); themselves where all are 1."""
        if np.all(weights == 1.0):
            return self
        root = np.sqrt(weights)[self.layout.reading]
        return Rows(root * self.residuals, root[:, None] * self.jacobian, self.prior, self.deviations, self.layout)

    def whitened(self, shared: SharedError | None) -> Rows:
        """Return the rows whitened for errors that the rows of a pose share; as they are without any."""
        if shared is None:
            return self
        return replace(self, residuals=shared.whiten(self.residuals), jacobian=shared.whiten(self.jacobian))

    def distances(self) -> FloatArray:
        """Return the length of each reading's whitened residual, (n_readings,)."""
        squares = np.bincount(self.layout.reading, self.residuals**2, self.layout.n_readings)
        return np.sqrt(squares)
