"""The linear model of a fit: residuals r + J d of whitened rows around a point, and the prior of d.

Unknowns are scaled, u = (p - p_expected) / s; d is their change from the point. The rows are those of all readings
(`calib.core.rows.rows`), or a few rows with the same J^T J, J^T r and r^T r. Its use:

    factor                       the triangular factor of [J r], from which all sums over rows follow
    posterior_information        the information of rows and priors, with T T^T = (J^T J + P^T P)^-1
    span                         U = J T; leverages are sums of its squares. By it, blocks of rows are left out in turn
                                 (`calib.core.numerics.clusters`)
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray, IntArray, ReadOnlyArrays
from calib.core.numerics.identifiability import MANY_COLUMNS, reduce_rows
from calib.core.numerics.observability import Information, posterior_information
from calib.core.numerics.prior import Prior
from calib.core.numerics.tall import Span


@dataclass(frozen=True, eq=False)
class RowGroups(ReadOnlyArrays):
    """The groups of rows whose noise has one scale.

    Attributes:
        group: Group of each row; -1 for one that was not read, (n_rows,).
        counts: Number of rows of each group that were read, (n_groups,); the model may hold fewer (module docstring).
    """

    group: IntArray
    counts: IntArray

    @staticmethod
    def from_groups(group: IntArray, n_groups: int) -> RowGroups:
        """Return the groups of rows (n_rows,), of a model that holds all rows that were read."""
        return RowGroups(group, np.bincount(group[group >= 0], minlength=n_groups))


@dataclass(frozen=True, eq=False)
class LinearModel:
    """Whitened rows around a point, with a prior.

    Attributes:
        residuals: r, (n_rows,).
        jacobian: J, by the scaled free parameters, (n_rows, n_free).
        deviations: u at this point, (n_free,).
        layout: Groups of the rows, where noise is to be found.
    """

    residuals: FloatArray
    jacobian: FloatArray
    prior: Prior
    deviations: FloatArray
    layout: RowGroups = field(default_factory=lambda: RowGroups.from_groups(np.zeros(0, dtype=np.intp), 0))

    @cached_property
    def factor(self) -> FloatArray:
        """The triangular factor of [J r], (n_free + 1, n_free + 1) or fewer rows."""
        return reduce_rows(self.jacobian, self.residuals)

    def remember(self, factor: FloatArray) -> None:
        """Store `factor` (n_free + 1, n_free + 1), where it is known already."""
        vars(self)["factor"] = factor

    def remember_span(self, span: Span) -> None:
        """Store a `span` with the same products U U^T, of fewer columns."""
        vars(self)["span"] = span

    @cached_property
    def posterior_information(self) -> Information:
        """Information of these rows and the priors."""
        return posterior_information(self.few_rows, self.prior)

    @property
    def few_rows(self) -> FloatArray:
        """Rows with the products J^T J, (n, n_free): those of `factor`, or J where many columns make them quicker."""
        n = self.jacobian.shape[1]
        return self.factor[:n, :-1] if n < MANY_COLUMNS or "factor" in vars(self) else self.jacobian

    @cached_property
    def span(self) -> Span:
        """U = J T of these rows, with T of `posterior_information`, (n_rows, rank)."""
        return Span(self.jacobian, self.posterior_information.root)

    def times(self, column: FloatArray) -> FloatArray:
        """Return J above the rows P of the prior, times a column (n_free,), (n_rows + n_priors,)."""
        return np.concatenate([self.jacobian @ column, self.prior.times(column)])

    def transposed_product(self, column: FloatArray) -> FloatArray:
        """Return the transpose of J above P, times a column (n_rows + n_priors,), (n_free,)."""
        n_rows = len(self.jacobian)
        return self.jacobian.T @ column[:n_rows] + self.prior.transposed_product(column[n_rows:])

    def step(self, residuals: FloatArray | None = None) -> FloatArray:
        """Return the step d to the minimum, (n_free,), with other residuals (n_rows,) if given."""
        right = self.residuals if residuals is None else residuals
        return -self.posterior_information.solve(self.jacobian.T @ right + self.prior.gradient(self.deviations))

    @property
    def cost(self) -> float:
        """Sum of the squares of residuals and priors."""
        return float(self.residuals @ self.residuals) + self.prior.cost(self.deviations)

    def select_parameters(self, chosen: BoolArray) -> Self:
        """Return the model of the parameters that a mask (n_free,) chooses."""
        jacobian, deviations = self.jacobian[:, chosen], self.deviations[chosen]
        return replace(self, jacobian=jacobian, prior=self.prior.select(chosen), deviations=deviations)

    def take_rows(self, places: IntArray | BoolArray) -> LinearModel:
        """Return the model of some rows: their places (k,), or a mask (n_rows,)."""
        groups = RowGroups.from_groups(self.layout.group[places], len(self.layout.counts))
        return LinearModel(self.residuals[places], self.jacobian[places], self.prior, self.deviations, groups)
