"""The solver of every fit: nonlinear least squares from residuals and their exact Jacobian.

Minimise |r(x)|^2. With J = dr/dx the gradient is 2 J^T r and the Hessian is

    2 (G + S)      G = J^T J      S = sum of r_i d^2 r_i / dx^2

Gauss and Newton's step f = -G^-1 J^T r leaves S out. Near a minimum each such step multiplies the error by -G^-1 S: it
converges fast only where S is small beside G, that is where residuals are small or directions are well seen. In
directions that priors alone hold, G is 1 whatever the noise. Residuals that hold what the model leaves out, divided by
the small noise of a good instrument, bring S to 1 there; then plain steps converge slowly or not at all.

What S does along the path is known at no further cost, for any residuals r: a step s_j changes the whole Jacobian, and

    S s_j = (J_j+1 - J_j)^T r

It is wanted where the step leads, not where it starts from: there r is mostly what this very step takes away. So r is
taken as the linear model leaves it, r + J f. With the last steps s_j as columns of P and S s_j of Y, Newton's equation
G d = G f - S d is solved for d as near to -P c as can be, so that S d is -Y c:

    d = f + G^-1 Y c      c = argmin |R f + (R P + R^-T Y) c|      G = R^T R, from a QR factorisation of J

This is Anderson's acceleration of the fixed-point iteration x + f(x), except that differences of f between points,
which residuals since left behind would spoil, are those of the linear models. A few directions do: S is large in few.

Steps are taken in full as long as the cost falls. Where the minimum lies along a bent valley, whose walls are as steep
as the noise is small, a full step climbs a wall and the next comes down again. So a cost above the best is accepted, up
to eight times in a row, where the linear model promises to go below the best. What does not come back is undone;
from then on steps go from the best point to the minimum of the linear model within a ball |D d| <= radius, which
follows how well that model predicts the cost. The same holds where a trial point has no residuals (a loop that cannot
close answers NaN). D is one of

    `unit`       1: the unknowns are already scaled, so that a change of one is a reasonable change of each
    `jacobian`   the largest norm so far of each column of J, for unknowns of any size and unit; the first step is no
                 longer than the start is away from zero

Many unknowns that are hardly seen, a start far away and small noise are a trap: the linear model takes what the
curvature left for a message from directions in which the rows say little, and the first step is absurdly long. With D
= 1 that shows: n unknowns that are off by one each are sqrt(n) away. Where the first of Newton's steps is longer than
3.5 sqrt(n), steps start from half of sqrt(n), as if the noise were larger at first. After each that is cut there and
lowers the cost, they may be twice as long; or as long as they are, once what curvature left of that step, and grows
with its square, would be less than the residuals at full length, as it is at once where only the scales are wrong.

The iteration ends as converged when the decrease that the linear model still promises, |R f|^2, is at most `tolerance`
of the cost. That is a rule in standard deviations: with noise s^2 = cost / N, from N rows more than unknowns, the
covariance is s^2 G^-1, and |R f|^2 / s^2 the sum of (step left / its standard deviation)^2 over independent directions,
at most N tolerance. It also ends where the step is below 1e-12 of the unknowns; and as not converged after
`max_evaluations` trial points.

When it fails. It finds the minimum in whose valley it starts; `calib.identification.starts` looks for others. Along
directions that the residuals hardly see, convergence is judged by the cost: the caller must check what step is left.

Tested against the certified answers of NIST's reference problems (tests/test_nist.py); evaluations from loose to tight
noise: docs/theory/priors.md.
Reference: walker2011 (Anderson's acceleration); chamberlain1982 (a higher cost for a while); more1983 (the step within
a ball); nist_strd.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
import scipy

from calib.arrays import FloatArray
from calib.errors import ComputationError
from calib.numerics.identifiability import reduced

MAX_EVALUATIONS = 200
TOLERANCE = 1e-12
"""Promised decrease, relative to the cost, that ends the iteration: 1e-4 standard deviations at ten thousand rows."""
_SMALL_STEP = 1e-12
_KEPT = 5  # steps whose Jacobians are remembered
_PATIENCE = 8  # trial points in a row above the best cost
_DEPENDENT = 1e-8  # relative singular value below which remembered steps say the same
_SINGULAR = 1e-14  # the same for directions that the rows do not see
_SHORTER = 0.25  # how much of the radius is left after a step that failed
_GOOD, _POOR = 0.75, 0.25  # part of the promised decrease that came, beyond which the radius changes
_ON_RADIUS = 0.1  # relative length within which a step counts as being on the ball
_ABSURD = (
    3.5  # root mean square of a first step in units of the unknowns; real arms with noise stated far too small: 3.4
)
_REACH, _FARTHER = 0.5, 2.0  # how far the steps may then go instead, in the same units, and by what factor that grows
_LIMIT, _COST_STANDS, _STEP_VANISHES = (
    "the limit of evaluations was reached",
    "the sum of squares no longer changes",
    "the unknowns no longer change",
)


@dataclass(frozen=True, eq=False)
class Solution:
    """Where the iteration ended.

    Attributes:
        x: The unknowns, (n,).
        residuals: r(x), (m,).
        jacobian: J(x), (m, n).
        cost: |r|^2.
        converged: Whether a stopping rule was met before the evaluations ran out.
        evaluations: How many trial points were evaluated.
        message: Which rule ended it.
    """

    x: FloatArray
    residuals: FloatArray
    jacobian: FloatArray
    cost: float
    converged: bool
    evaluations: int
    message: str


def minimise(
    residuals: Callable[[FloatArray], FloatArray],
    jacobian: Callable[[FloatArray], FloatArray],
    start: FloatArray,
    *,
    scaling: Literal["unit", "jacobian"] = "unit",
    tolerance: float = TOLERANCE,
    max_evaluations: int = MAX_EVALUATIONS,
) -> Solution:
    """Minimise the sum of squared residuals.

    Args:
        residuals: x (n,) -> r (m,); NaN where r has no value.
        jacobian: x (n,) -> dr/dx (m, n); asked for only where r was finite.
        start: Where to begin, (n,).
        scaling: D of the module docstring.
        tolerance: Promised decrease, relative to the cost, that ends the iteration.
        max_evaluations: Number of trial points after which it ends as not converged.

    Raises:
        ComputationError: There are no residuals at the start.
    """
    values = residuals(start)
    if not np.all(np.isfinite(values)):
        raise ComputationError("the fit cannot start: the residuals have no value at the starting point")
    path = _Path(_Point(start, values, jacobian(start)), scaling)
    evaluations, message = 1, path.ended(tolerance)
    while not message and evaluations < max_evaluations:
        step = path.step()
        values = residuals(path.here.x + step)
        evaluations += 1
        path.go_on(step, values, jacobian)
        message = path.ended(tolerance)
    best = path.best
    return Solution(best.x, best.residuals, best.jacobian, best.cost, bool(message), evaluations, message or _LIMIT)


class _Point:
    """A point, and the linear model there.

    Args:
        x: The unknowns, (n,).
        residuals: r(x), (m,).
        jacobian: J(x), (m, n).
    """

    def __init__(self, x: FloatArray, residuals: FloatArray, jacobian: FloatArray) -> None:
        self.x, self.residuals, self.jacobian = x, residuals, jacobian
        self.cost = float(residuals @ residuals)
        n = len(x)
        factor = reduced(jacobian, residuals)
        self.triangle, self.projected = factor[:n, :n], factor[:n, n]  # R, and Q^T r

    @cached_property
    def sees_all(self) -> bool:
        """Whether the rows see every direction."""
        diagonal = np.abs(np.diag(self.triangle))
        return len(self.triangle) == len(self.x) and bool(np.min(diagonal) > _SINGULAR * np.max(diagonal))

    @cached_property
    def newton(self) -> FloatArray:
        """Step f of the module docstring; the shortest one where the rows do not see every direction, (n,)."""
        if self.sees_all:
            return np.asarray(-scipy.linalg.solve_triangular(self.triangle, self.projected))
        return np.asarray(-np.linalg.lstsq(self.triangle, self.projected, rcond=_SINGULAR)[0])

    @cached_property
    def decrease(self) -> float:
        """What the linear model promises of the cost, |R f|^2."""
        return float(np.sum((self.triangle @ self.newton) ** 2))

    def accelerated(self, past: list[_Point]) -> FloatArray:
        """Return d of the module docstring, from the points before this one, oldest first."""
        if not past or not self.sees_all:
            return self.newton
        points = [*past, self]
        left = self.residuals + self.jacobian @ self.newton
        pulls = np.stack([point.jacobian.T @ left for point in points], axis=1)
        curved = scipy.linalg.solve_triangular(self.triangle, np.diff(pulls, axis=1), trans=1)
        differences = self.triangle @ np.diff([point.x for point in points], axis=0).T + curved
        length = np.linalg.norm(differences, axis=0) + np.finfo(float).tiny
        right = -self.triangle @ self.newton
        coefficients = np.linalg.lstsq(differences / length, right, rcond=_DEPENDENT)[0] / length
        return np.asarray(self.newton + scipy.linalg.solve_triangular(self.triangle, curved @ coefficients))

    def within(self, radius: float, scale: FloatArray) -> FloatArray:
        """Return the minimum of the linear model within |D d| <= radius, (n,), where Newton's step is longer.

        d = -(J^T J + l D^2)^-1 J^T r with the l >= 0 that makes it as long as the radius, found by bisection.
        """
        left, singular, right = np.linalg.svd(self.triangle / scale, full_matrices=False)
        pull = singular * (left.T @ self.projected)
        high = float(np.linalg.norm(pull)) / radius  # d is shorter than |J^T r| / l
        low = float(np.finfo(float).eps) * high
        scaled = -pull / (singular**2 + high)
        while high > (1.0 + _SMALL_STEP) * low:
            middle = float(np.sqrt(low * high))
            scaled = -pull / (singular**2 + middle)
            length = np.linalg.norm(scaled)
            if abs(length - radius) <= _ON_RADIUS * radius:
                break
            if length > radius:
                low = middle
            else:
                high = middle
        return np.asarray((right.T @ scaled) / scale)


class _Path:
    """Where the iteration is, and what it remembers.

    Args:
        start: Where it begins.
        scaling: D of the module docstring.
    """

    def __init__(self, start: _Point, scaling: Literal["unit", "jacobian"]) -> None:
        self.here = self.best = start
        self._by_columns = scaling == "jacobian"
        self._scale = np.zeros(len(start.x)) if self._by_columns else np.ones(len(start.x))
        self._rescale(start)
        self._radius = (self._length(start.x) or 1.0) if self._by_columns else np.inf
        typical = np.inf if self._by_columns else float(np.sqrt(len(start.x)))
        self._reach = _REACH * typical if self._length(start.newton) > _ABSURD * typical else np.inf
        self._past: list[_Point] = []
        self._patience = _PATIENCE

    def _length(self, step: FloatArray) -> float:
        return float(np.linalg.norm(self._scale * step))

    def _rescale(self, point: _Point) -> None:
        if self._by_columns:
            norms = np.linalg.norm(point.triangle, axis=0)
            self._scale = np.maximum(self._scale, np.where(norms > 0, norms, 1.0))

    def ended(self, tolerance: float) -> str:
        """Return which stopping rule is met; nothing if none is."""
        if self.here is not self.best:
            return ""
        if self.here.decrease <= tolerance * self.here.cost:
            return _COST_STANDS
        size = self._length(self.here.x) + (0.0 if self._by_columns else 1.0)
        return _STEP_VANISHES if min(self._length(self.here.newton), self._radius) <= _SMALL_STEP * size else ""

    def step(self) -> FloatArray:
        """Return the next step, (n,): accelerated, plain, or cut, the first that is short enough."""
        limit = min(self._radius, self._reach)
        for step in (self.here.accelerated(self._past), self.here.newton):
            if self._length(step) <= limit:
                return step
        return self.here.within(limit, self._scale)

    def go_on(self, step: FloatArray, values: FloatArray, jacobian: Callable[[FloatArray], FloatArray]) -> None:
        """Take a step that led to these residuals (m,), or go back to the best point with a smaller radius."""
        reached = float(values @ values) if np.all(np.isfinite(values)) else np.inf
        may_climb = self._patience > 0 and np.isinf(self._radius) and np.isfinite(reached)
        if reached < self.best.cost or may_climb:
            x = self.here.x + step
            trial = _Point(x, values, jacobian(x))
            if reached < self.best.cost:
                self._radius, self._reach = self._adapted(step, trial), self._grown(step, trial)
                self._move(trial)
                self.best, self._patience = trial, _PATIENCE
                return
            if reached - trial.decrease < self.best.cost:
                self._move(trial)
                self._patience -= 1
                return
        length = self._length(step if self.here is self.best else self.best.newton)
        self._radius = _SHORTER * min(length, self._radius)
        self.here, self._past = self.best, []

    def _move(self, trial: _Point) -> None:
        self._past = [*self._past, self.here][-_KEPT:]
        self.here = trial
        self._rescale(trial)

    def _grown(self, step: FloatArray, trial: _Point) -> float:
        """Return how far steps may go after one that lowered the cost; what curvature leaves grows with the square."""
        length = self._length(step)
        if length < (1.0 - _ON_RADIUS) * self._reach:
            return self._reach
        left = float(np.linalg.norm(trial.residuals - self.here.residuals - self.here.jacobian @ step))
        harmless = left * (self._length(trial.newton) / length) ** 2 <= np.sqrt(trial.cost)
        return np.inf if harmless else _FARTHER * self._reach

    def _adapted(self, step: FloatArray, trial: _Point) -> float:
        """Return the radius after a step that lowered the cost, from how well the linear model predicted that."""
        if np.isinf(self._radius):
            return self._radius
        promised = self.here.cost - float(np.sum((self.here.residuals + self.here.jacobian @ step) ** 2))
        part = (self.here.cost - trial.cost) / promised if promised > 0 else 0.0
        if part < _POOR:
            return _SHORTER * self._length(step)
        if part < _GOOD:
            return self._radius
        return max(self._radius, 2.0 * self._length(step))
