"""A finished fit as a linear model for tests of further columns: r = J du + Z c."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.numerics import linalg
from calib.core.numerics.tall import Span
from calib.core.rows.rows import Rows

ABSORBED = 1e-6
"""An effect is visible if at least this part of its square remains after the fit."""
_SURELY = 5.0  # an effect of so many standard deviations is found nine times of ten, although many are tested
_ROUNDING = 1e-10  # part of a square below which nothing remains


@dataclass(frozen=True, eq=False)
class LinearFit:
    """A finished fit as a linear model.

    Attributes:
        rows: Its whitened rows, with the weights of a robust loss.
        span: J T, the directions that the fit absorbs, (n_rows, rank), with T of `calib.core.numerics.observability`.
        factor: Found over assumed noise.
        pose_freedom: Degrees of freedom of the scatter of poses, where they scatter more than independent readings;
            else infinite.
        confirmed: Degrees of freedom among `freedom` that confirmed the noise before, as `Factors` has them.
    """

    rows: Rows
    span: Span
    freedom: float
    factor: float
    pose_freedom: float
    confirmed: float

    def after_fit(self, effect: FloatArray) -> FloatArray:
        """Return M Z, the remainder of effects Z (n_rows, n_effects) in the residuals, (n_rows, n_effects)."""
        return effect - self.span.times(self.span.transposed_product(effect))

    def with_parameters(self, effects: FloatArray) -> LinearFit:
        """Return the fit with effects Z (n_rows, k) as further parameters, as far as they are visible."""
        columns, left, values, vectors = self._unit_effects(effects[:, np.any(effects != 0.0, axis=0)])
        seen = values > ABSORBED
        root = vectors[:, seen] / np.sqrt(values[seen])
        absorbed, fewer = left @ root, int(np.sum(seen))
        residuals = self.rows.residuals - absorbed @ (root.T @ (columns.T @ self.rows.residuals))
        return replace(
            self,
            rows=replace(self.rows, residuals=residuals),
            span=self.span.with_columns(absorbed),
            freedom=self.freedom - fewer,
            pose_freedom=self.pose_freedom - fewer,
        )

    def sizes(self, effects: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the sizes (k,) of effects Z (n_rows, k) if all of them were parameters, and their standard deviations.

        Deviations are infinite for zero columns, and where all effects together leave no degree of freedom. An absorbed
        effect is uncertain and gets the size 0, since the residuals along it are only rounding of the solver.
        """
        made = np.flatnonzero(np.any(effects != 0.0, axis=0))
        columns, left, values, vectors = self._unit_effects(effects[:, made])
        inverse, seen = vectors / (values + ABSORBED) @ vectors.T, vectors[:, values > ABSORBED]
        found = -inverse @ (seen @ (seen.T @ (columns.T @ self.rows.residuals)))
        freedom, size = self.freedom - len(made), np.linalg.norm(effects[:, made], axis=0)
        rest = np.sum((self.rows.residuals + left @ found) ** 2) + self.confirmed
        scatter = np.sqrt(rest / freedom) if freedom > 0 else np.inf
        sizes, deviations = np.zeros(effects.shape[1]), np.full(effects.shape[1], np.inf)
        sizes[made], deviations[made] = found / size, scatter * np.sqrt(np.diag(inverse)) / size
        return sizes, deviations

    def _unit_effects(self, effects: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Effects of length 1, what the fit leaves of them, and the eigenvalues and eigenvectors of their product."""
        columns = effects / np.linalg.norm(effects, axis=0)
        left = self.after_fit(columns)
        return columns, left, *linalg.eigh(columns.T @ left)

    @cached_property
    def square(self) -> float:
        """Sum of squares of the residuals, and of those that confirmed the noise."""
        return float(np.sum(self.rows.residuals**2)) + self.confirmed

    def visible(self, column: FloatArray) -> float:
        """Return the least effect of a column (n_rows, 1) that the residuals show; infinite if they never do."""
        size = float(np.linalg.norm(column))
        if size == 0.0:
            return float("inf")
        unit = column / size
        left = float(np.sum(unit * self.after_fit(unit)))
        return _SURELY * self.factor / (size * float(np.sqrt(left))) if left > _ROUNDING else float("inf")
