"""The linear model of residuals at a point of an iteration, and steps to its minimum.

r(x + d) is taken as r + J d, with J = Q R and the known curvature K of r. Symbols and derivation are those of
`calib.core.numerics.least_squares`, which goes from point to point.

R comes from rotations, which lose no digits. For many columns it is the Cholesky factor of J^T J, in a third of the
time. That squares the condition of J: with 1e6 at most, a step is off by some ten-thousandths of itself at worst, which
the next one corrects. Beyond, rotations are used.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray
from calib.core.numerics import linalg
from calib.core.numerics.identifiability import MANY_COLUMNS, extend_reduced, factor_products
from calib.core.numerics.linear_model import LinearModel
from calib.core.numerics.prior import Prior

ON_RADIUS = 0.1
"""A step is on the edge of its ball if its relative distance from the edge is at most this."""
_BOLD = 4.0  # length of a step where the model has no minimum, in lengths of Newton's step
_DEPENDENT = 1e-4  # a remembered step adds nothing if its part outside of later ones is less
_SINGULAR = 1e-14  # a direction is not seen by the rows if its relative size in the triangle is less
_CLOSE = 1e-12  # relative difference of bounds between which a multiplier is found


class LinearPoint:
    """A point, and the linear model at it.

    Args:
        x: The unknowns, (n,).
        residuals: r(x), (m,), those of a prior last.
        jacobian: J(x), (m, n), or the linear model at x, with a prior.
    """

    def __init__(self, x: FloatArray, residuals: FloatArray, jacobian: FloatArray | LinearModel) -> None:
        self.x, self.residuals = x, residuals
        none = Prior(np.zeros(len(x), dtype=bool))
        self.model = jacobian if isinstance(jacobian, LinearModel) else LinearModel(residuals, jacobian, none, x)
        self.cost = float(residuals @ residuals)
        self.triangle, self.projected, self.unseen = _reduce(self.model, residuals)

    @cached_property
    def sees_all(self) -> bool:
        """Whether the rows see every direction."""
        diagonal = np.abs(np.diag(self.triangle))
        return len(self.triangle) == len(self.x) and bool(np.min(diagonal) > _SINGULAR * np.max(diagonal))

    @cached_property
    def newton(self) -> FloatArray:
        """Newton's step f; the shortest one where the rows do not see every direction, (n,)."""
        if self.sees_all:
            return -_solve_triangular(self.triangle, self.projected)
        return np.asarray(-linalg.lstsq(self.triangle, self.projected, rcond=_SINGULAR))

    @cached_property
    def decrease(self) -> float:
        """Decrease of the cost by the linear model, |R f|^2."""
        return float(np.sum((self.triangle @ self.newton) ** 2))

    def curvature(self, past: list[LinearPoint]) -> FloatArray | None:
        """Return K, (n, n), from the points before this one, oldest first; None if unknown."""
        if not past or not self.sees_all:
            return None
        points = [*past, self]
        left = self.residuals + self.model.times(self.newton)
        pulls = np.stack([point.model.transposed_product(left) for point in points], axis=1)
        steps = (self.triangle @ np.diff([point.x for point in points], axis=0).T)[:, ::-1]  # the last step first
        images = _solve_triangular(self.triangle, np.diff(pulls, axis=1), transposed=True)[:, ::-1]
        length = np.linalg.norm(steps, axis=0) + np.finfo(float).tiny
        along, factor = np.linalg.qr(steps / length)
        says_more = np.abs(np.diag(factor)) > _DEPENDENT
        count = len(says_more) if np.all(says_more) else int(np.argmin(says_more))
        along, factor = along[:, :count], factor[:count, :count]
        images = _solve_triangular(factor, (images / length)[:, :count].T, transposed=True).T  # K times `along`
        inside = along.T @ images
        outside = (images - along @ inside) @ along.T
        return np.asarray(outside + outside.T + along @ (inside + inside.T) @ along.T / 2)

    def step(self, curvature: FloatArray | None, limit: float, scale: FloatArray) -> tuple[FloatArray, float]:
        """Return the step d to the minimum of the model where |D d| <= limit, (n,), and the cost there."""
        step, second_derivative = self.newton, np.zeros((1, 1)) if curvature is None else curvature
        hessian = np.eye(len(self.triangle)) + second_derivative
        if curvature is not None:
            _, image, failed = scipy.linalg.lapack.dposv(hessian, self.triangle @ self.newton)
            if failed:  # there is no minimum
                step = np.full(len(step), np.inf)
                limit = min(limit, float(_BOLD * np.linalg.norm(scale * self.newton)))
            else:
                step = _solve_triangular(self.triangle, image)
        if not np.linalg.norm(scale * step) <= limit:
            step = self._minimum_within(hessian, self.projected, limit, scale)
        image = self.triangle @ step
        return step, self.unseen + float(np.sum((self.projected + image) ** 2) + image @ (hessian @ image - image))

    def correct_curvature(self, bend: FloatArray, limit: float, scale: FloatArray) -> FloatArray | None:
        """Return the step c that removes a bend of the residuals (m,), |D c| <= limit, (n,); None if unknown."""
        if not self.sees_all:
            return None
        right = _solve_triangular(self.triangle, self.model.transposed_product(bend), transposed=True)
        step = -_solve_triangular(self.triangle, right)
        if np.linalg.norm(scale * step) <= limit:
            return np.asarray(step)
        return self._minimum_within(np.eye(len(step)), right, limit, scale)

    def _minimum_within(self, hessian: FloatArray, right: FloatArray, limit: float, scale: FloatArray) -> FloatArray:
        """Return the minimum of a model in the ball |D d| <= limit, (n,): -(H + l D^2)^-1 g, with l >= 0 by bisection.

        The model has the Hessian R^T `hessian` R, `hessian` = 1 + K (n, n), and the gradient g = R^T `right`.
        """
        scaled = self.triangle / scale
        if np.array_equal(hessian, np.eye(len(hessian))):  # singular values are exact where their squares are not
            left, singular, rows = linalg.svd(scaled, full_matrices=False)
            values, vectors, pull = singular**2, rows.T, singular * (left.T @ right)
        else:
            values, vectors = linalg.eigh(scaled.T @ hessian @ scaled)
            pull = vectors.T @ (scaled.T @ right)
        low = max(0.0, -float(values.min()))
        high = low + float(np.linalg.norm(pull)) / limit  # the step at this multiplier is shorter than the limit
        low += float(np.finfo(float).eps) * (high - low)
        step = -pull / (values + high)
        while high > (1.0 + _CLOSE) * low:
            middle = float(np.sqrt(low * high))
            step = -pull / (values + middle)
            length = np.linalg.norm(step)
            if abs(length - limit) <= ON_RADIUS * limit:
                break
            if length > limit:
                low = middle
            else:
                high = middle
        return np.asarray((vectors @ step) / scale)


def _solve_triangular(triangle: FloatArray, right: FloatArray, *, transposed: bool = False) -> FloatArray:
    """Solve R x = b, or R^T x = b, for (n,) or (n, k); SciPy's own function takes ten times as long to call."""
    solution: FloatArray = scipy.linalg.lapack.dtrtrs(triangle, right, trans=transposed)[0]
    return solution


def _reduce(model: LinearModel, residuals: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Return R, Q^T r, and the square of the part of r that no step removes, to first order."""
    n = model.jacobian.shape[1]
    if n >= MANY_COLUMNS:
        triangle = factor_products(model.prior.add_to(model.jacobian.T @ model.jacobian))
        if triangle is not None:
            projected = _solve_triangular(triangle, model.transposed_product(residuals), transposed=True)
            return triangle, projected, max(float(residuals @ residuals - projected @ projected), 0.0)
    factor = extend_reduced(model.factor, model.prior.rows, residuals[len(model.residuals) :])
    return factor[:n, :n], factor[:n, n], float(np.sum(factor[n:, n] ** 2))
