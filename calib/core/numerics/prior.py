"""The prior of scaled parameters: independent for most of them, correlated for some.

With u = (p - p_expected) / s, the prior is

    u_k ~ N(0, 1)            for every parameter that has a prior of its own
    u_J ~ N(0, R)            for parameters J whose priors are correlated, with correlations R

This is P u ~ N(0, I). P has a unit row for each independent prior, and rows L^-1 with R = L L^T for the parameters J.
So priors stack with whitened readings (`calib.core.numerics.observability`). Without correlations, as in nearly every
fit, a product with P only selects rows.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy

from calib.core.base.arrays import BoolArray, FloatArray, IntArray, ReadOnlyArrays


@dataclass(frozen=True, eq=False)
class Prior(ReadOnlyArrays):
    """Prior of scaled parameters.

    Attributes:
        has: Whether each parameter has a prior, of its own or correlated, (n,).
        together: Indices of parameters with correlated priors, ascending, (n_together,).
        correlations: R of the module docstring, (n_together, n_together).
    """

    has: BoolArray
    together: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    correlations: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))

    @cached_property
    def _own_prior_parameters(self) -> IntArray:
        return np.setdiff1d(np.flatnonzero(self.has), self.together)

    @cached_property
    def _whitening(self) -> FloatArray:
        lower = np.linalg.cholesky(self.correlations)
        return np.asarray(scipy.linalg.solve_triangular(lower, np.eye(len(lower)), lower=True))

    @property
    def root(self) -> FloatArray:
        """Matrix whose product with standard normal z is a draw of u, (n, n); rows without a prior are 0."""
        root = np.diag(1.0 * self.has)
        root[np.ix_(self.together, self.together)] = np.linalg.cholesky(self.correlations)
        return root

    def times(self, matrix: FloatArray) -> FloatArray:
        """Return P times a matrix or vector (n, ...), (n_priors, ...)."""
        if not len(self.together):
            return matrix[self.has]
        return np.concatenate([matrix[self._own_prior_parameters], self._whitening @ matrix[self.together]])

    def transposed_product(self, column: FloatArray) -> FloatArray:
        """Return P^T times a column (n_priors,), (n,)."""
        own, result = self._own_prior_parameters, np.zeros(len(self.has))
        result[own] = column[: len(own)]
        if len(self.together):
            result[self.together] = self._whitening.T @ column[len(own) :]
        return result

    @cached_property
    def rows(self) -> FloatArray:
        """P, (n_priors, n)."""
        return self.times(np.eye(len(self.has)))

    def gradient(self, u: FloatArray) -> FloatArray:
        """Return P^T P u, (n,)."""
        return self.transposed_product(self.times(u))

    def add_to(self, matrix: FloatArray) -> FloatArray:
        """Return matrix + P^T P, (n, n), written into the matrix."""
        matrix[self._own_prior_parameters, self._own_prior_parameters] += 1.0
        if len(self.together):
            matrix[np.ix_(self.together, self.together)] += self._whitening.T @ self._whitening
        return matrix

    def select(self, chosen: BoolArray | IntArray) -> Prior:
        """Return the marginal prior of the chosen parameters, by a mask (n,) or indices (k,)."""
        places = np.arange(len(self.has))[chosen]
        kept = np.flatnonzero(np.isin(places, self.together))
        number = np.searchsorted(self.together, places[kept])
        return Prior(self.has[places], kept, self.correlations[np.ix_(number, number)])

    def cost(self, u: FloatArray) -> float:
        """Return |P u|^2 for u (n,)."""
        return float(np.sum(self.times(u) ** 2))
