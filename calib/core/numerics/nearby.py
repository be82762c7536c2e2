"""Minima near a known one, of many draws at once: a model of second order leads there, exact rows say where it is.

Least squares of rows r(z) - e, e what a draw reads otherwise, and priors P (z - z_0), in coordinates z that are 0 at
the known minimum and in which a standard deviation of noise is about 1. With J and H the first and second derivative of
r there, and r_e the rows of a draw at 0, these are to second order

    r_e + J z + 1/2 H z z        so that its minimum is z = z1 + z2,

    z1 = -G^-1 (J^T r_e + P^T p)        z2 = -G^-1 (S z1 + 1/2 J^T H z1 z1)        S = sum of (r_e + J z1)_i H_i

with G = J^T J + P^T P and p the rows of the priors at 0. There z is off by the third order: a few thousandths of a
standard deviation for a robot arm. One exact evaluation, r and J at z, and one more step with the Hessian J^T J + S +
P^T P leave millionths. What rows are after that step d, which is so short, follows from the exact ones,

    J + H d        r + J d + 1/2 H d d

but for what H itself changes from 0 to z: with E = |J - (J_0 + H z)|, the third order as it is, J is off by about
2 E |d| / |z|. Where that could move the minimum by more than the stopping rule of every fit allows
(`calib.core.numerics.least_squares`), or where the rule is not met, the rows are evaluated there, and so on.

When it fails. Where evaluations do not lead to a minimum soon, or one is not possible, that is said: others have to
find it, who need no model.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
import scipy

from calib.core.base.arrays import BoolArray, FloatArray, IntArray, ReadOnlyArrays
from calib.core.numerics.least_squares import TOLERANCE

_ROUNDS = 3  # evaluations of one draw


@dataclass(frozen=True, eq=False)
class Minima:
    """Where the minima of draws are, of those that were found.

    Attributes:
        draws: Their numbers, (n_draws,).
        z: The coordinates, (n_draws, n).
        residuals: Of the rows there, (n_draws, n_rows).
        jacobian: Their derivative by z, (n_draws, n_rows, n).
        root: L of J^T J + P^T P = L L^T, (n_draws, n, n).
        step: L^-1 times half the gradient of the cost: the step left, in standard deviations, (n_draws, n).
        evaluations: Exact evaluations of all draws.
    """

    draws: IntArray
    z: FloatArray
    residuals: FloatArray
    jacobian: FloatArray
    root: FloatArray
    step: FloatArray
    evaluations: int


@dataclass(frozen=True, eq=False)
class Nearby(ReadOnlyArrays):
    """The model around the known minimum.

    Attributes:
        jacobian: J of the module docstring, (n_rows, n).
        bend: H, (n_rows, n, n); None where it is not known: then `first` is of first order.
        held: P, (n_priors, n).
        pulled: p, (n_priors,).
    """

    jacobian: FloatArray
    bend: FloatArray | None
    held: FloatArray
    pulled: FloatArray

    def first(self, residuals: FloatArray) -> FloatArray:
        """Return z of the model, (n_draws, n), from residuals at the known minimum, (n_draws, n_rows)."""
        gram = self.jacobian.T @ self.jacobian + self.held.T @ self.held
        z: FloatArray = -np.linalg.solve(gram, (residuals @ self.jacobian + self.pulled @ self.held).T).T
        if self.bend is None:
            return z
        curvature = self._curvature(residuals + z @ self.jacobian.T)
        pull = _times(curvature, z) + 0.5 * _times(self._bent(z), z) @ self.jacobian
        return np.asarray(z - np.linalg.solve(gram, pull.T).T)

    def minima(
        self,
        residuals: FloatArray,
        evaluate: Callable[[IntArray, FloatArray], Iterable[tuple[FloatArray, FloatArray] | None]],
    ) -> Minima:
        """Find the minima of draws.

        Args:
            residuals: Of each draw at the known minimum, (n_draws, n_rows).
            evaluate: Numbers of draws (m,), z (m, n) -> residuals (n_rows,) of each and their derivative (n_rows, n);
                None where there are none.
        """
        (n_draws, n_rows), n = residuals.shape, self.jacobian.shape[1]
        z, r, jacobian = self.first(residuals), np.empty_like(residuals), np.empty((n_draws, n_rows, n))
        root, left, count = np.zeros((n_draws, n, n)), np.zeros((n_draws, n)), 0
        found, active = np.zeros(n_draws, dtype=bool), np.arange(n_draws)
        for _ in range(_ROUNDS):
            if len(active) == 0:
                break
            possible = np.zeros(len(active), dtype=bool)
            for place, (k, rows) in enumerate(zip(active, evaluate(active, z[active]), strict=True)):
                if rows is not None:
                    r[k], jacobian[k], possible[place] = *rows, True
            count += len(active)
            active = active[possible]
            hessians = self._hessian(r[active], jacobian[active])
            valleys = _are_valleys(hessians)
            active, hessians = active[valleys], hessians[valleys]
            try:
                moved = self._stepped(z[active], r[active], jacobian[active], hessians)
            except np.linalg.LinAlgError:  # rows and priors of one draw at least do not see every direction
                break
            z[active], r[active], jacobian[active], root[active], left[active], found[active] = moved
            active = active[~found[active]]
        done = np.flatnonzero(found)
        return Minima(done, z[done], r[done], jacobian[done], root[done], left[done], count)

    def _stepped(
        self, z: FloatArray, r: FloatArray, jacobian: FloatArray, hessians: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, BoolArray]:
        """Take the step of the module docstring; return what `Minima` says of where it ends."""
        gram, n_rows = self.held.T @ self.held, r.shape[1]
        third = np.linalg.norm(jacobian - self.jacobian - self._bent(z), axis=(1, 2))
        step = -np.linalg.solve(hessians, self._pull(z, r, jacobian)[:, :, None])[:, :, 0]
        further = jacobian + self._bent(step)
        at, left = z + step, r + 0.5 * _times(jacobian + further, step)
        root = np.linalg.cholesky(further.transpose(0, 2, 1) @ further + gram)
        promised = np.linalg.solve(root, self._pull(at, left, further)[:, :, None])[:, :, 0]
        cost = np.sum(left**2, axis=1) + np.sum(self._priors(at) ** 2, axis=1)
        off = 2.0 * third * np.linalg.norm(step, axis=1)
        known = off <= np.sqrt(TOLERANCE * n_rows) * np.linalg.norm(z, axis=1)
        return at, left, further, root, promised, known & (np.sum(promised**2, axis=1) <= TOLERANCE * cost)

    def _hessian(self, r: FloatArray, jacobian: FloatArray) -> FloatArray:
        """Half the second derivative of the cost, (n_draws, n, n)."""
        gram = self.held.T @ self.held
        return np.asarray(jacobian.transpose(0, 2, 1) @ jacobian + gram + self._curvature(r))

    def _priors(self, z: FloatArray) -> FloatArray:
        """Rows of the priors, (n_draws, n_priors)."""
        return np.asarray(self.pulled + z @ self.held.T)

    def _pull(self, z: FloatArray, r: FloatArray, jacobian: FloatArray) -> FloatArray:
        """Half the gradient of the cost, (n_draws, n)."""
        return np.asarray(np.matmul(r[:, None, :], jacobian)[:, 0] + self._priors(z) @ self.held)

    def _bent(self, z: FloatArray) -> FloatArray:
        """H z, (n_draws, n_rows, n)."""
        assert self.bend is not None
        return (z @ self.bend.reshape(-1, self.bend.shape[2]).T).reshape(len(z), *self.bend.shape[:2])

    def _curvature(self, r: FloatArray) -> FloatArray:
        """Sum of r_i H_i, (n_draws, n, n)."""
        assert self.bend is not None
        return (r @ self.bend.reshape(len(self.bend), -1)).reshape(len(r), *self.bend.shape[1:])


def _are_valleys(hessians: FloatArray) -> BoolArray:
    """Whether a step leads to a minimum, not to a saddle, (n_draws,)."""
    return np.array([not scipy.linalg.lapack.dpotrf(hessian)[1] for hessian in hessians], dtype=bool)


def _times(matrices: FloatArray, vectors: FloatArray) -> FloatArray:
    """Return the product of each matrix with its vector, (n_draws, ...)."""
    return np.asarray(np.matmul(matrices, vectors[:, :, None])[:, :, 0])
