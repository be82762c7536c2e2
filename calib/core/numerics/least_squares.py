"""The solver of every fit: nonlinear least squares from residuals and their exact Jacobian.

Minimise |r(x)|^2. With J = dr/dx the gradient is 2 J^T r and the Hessian is

    2 (G + S)      G = J^T J      S = sum of r_i d^2 r_i / dx^2

Gauss and Newton's step f = -G^-1 J^T r leaves S out. Near a minimum each such step multiplies the error by -G^-1 S: it
converges fast only where S is small compared with G, that is where residuals are small or directions are well seen. In
directions that priors alone hold, G is 1 whatever the noise. Residuals that hold what the model leaves out, divided by
the small noise of a good instrument, bring S to 1 there; then plain steps converge slowly or not at all.

What S does along the path is known at no further cost, for any residuals r: a step s_j changes the whole Jacobian, and

    S s_j = (J_j+1 - J_j)^T r

The curvature is needed where the step leads, not where it starts: at the start r is mostly what this very step takes
away. So r is taken as the linear model leaves it, r + J f. With G = R^T R (`calib.core.numerics.linear_point`) and z =
R d, the cost is

    |r + J d|^2 + d^T S d = |r|^2 + 2 (R^-T J^T r)^T z + z^T (1 + K) z      K = R^-T S R^-1

K is known along the last steps R s_j. With an orthonormal basis P of these, the last first, and A = K P,

    K = B P^T + P B^T + P (P^T A) P^T       B = A - P P^T A

is the smallest symmetric matrix that agrees with them (Powell's update, of several steps at once). A few directions
suffice: S is large in few. The minimum of the model is the next step. On a saddle between two valleys, where negative
curvature outweighs rows and priors, the model has none; then the step goes to the lowest point within four lengths of
f. (A method that looks for a zero of the gradient, such as Anderson's acceleration of x + f(x), would go to the
saddle.) K is left out while the linear model still promises to remove more than half of the cost.

Steps are taken in full as long as the cost falls. The first that does not lower it is undone; from then on steps go to
the minimum of the model within a ball |D d| <= radius, which follows how well the last model predicted the cost. A
trial point without residuals (a loop that cannot close answers NaN) does not lower it.

Where priors are wide, the minimum lies at the end of a long, curved valley: directions that the rows hardly see move
far, and the square of that move matters for those that they see well. Steps along the bottom are then short, and there
are hundreds. But the slopes are steep and nearly straight, so that a step from high up leads to the bottom again,
further on. So where a step within a ball does not lower the cost, the iteration still goes on from its end, each step
up to twice as long as the last one, until the cost is lower than where it left the bottom. If that takes more than
eight further steps, or a trial point has no residuals, it goes back there and does not leave the bottom again. (Only
where unknowns are scaled, `unit`: others would run away.)

While the iteration stays on the bottom, it follows the bends. A trial point shows the bend, b = r(x + d) - r - J d.
Where the cost fell by less than three quarters of the promise, a second trial adds the step that removes the bend, the
minimum of |b + J c| with c at most half as long as d; the lower of the two points counts. Along a valley the bends are
alike: within a ball, the trial point itself is moved by the step that removes the bend predicted from the last step s,
with C = J - J_before and d = a s + rest:

    d^T H d / 2  =  a C (d - a s / 2)      up to second order in the rest,      a = s^T d / s^T s

D is one of

    `unit`       1: the unknowns are already scaled, so that a change of one is a reasonable change of each
    `jacobian`   the largest norm so far of each column of J, for unknowns of any size and unit; the first step is no
                 longer than the start is away from zero

Many unknowns that are hardly seen, a start far away and small noise are a trap: the linear model takes the residuals
that curvature left for information about directions in which the rows say little, and the first step is absurdly long.
With D = 1 that shows: n unknowns that are off by one each are sqrt(n) away. Where the first of Newton's steps is longer
than 3.5 sqrt(n), the first ball is half of sqrt(n), as if the noise were larger at first. The ball is given up as soon
as the residuals that curvature leaves after a step to its edge, which grow with the square of the length, would be
smaller than the residuals at full length: at once where only the scales are wrong.

The iteration ends as converged when the decrease that the linear model still promises, |R f|^2, is at most `tolerance`
of the cost. This is a rule in standard deviations: with noise s^2 = cost / N, from N rows more than unknowns, the
covariance is s^2 G^-1, and |R f|^2 / s^2 the sum of (step left / its standard deviation)^2 over independent directions,
at most N tolerance. Where a step promised less than ten times as much, no bend is looked for; if it did not lower the
cost, rounding decides, and the iteration ends too. It also ends where the step is below 1e-12 of the unknowns, and as
not converged after `max_evaluations` trial points.

The minimum may recede: if poses lie close together, a longer radius of an arc always explains the readings better, so
that no length is the best one. Then the remaining distance grows with every step. So the iteration ends as not
converged where, after 20 trial points, it has come farther than a = 3.5 sqrt(n), each of the last three steps has made
f longer, and f is longer than a and than at the start, promises at most half of the cost, and has a standard deviation,
s |f| / |R f|, above a. (Where unknowns are scaled, `unit`: others have no such length.)

When it fails. It finds the minimum in whose valley it starts; `calib.core.fitting.starts` looks for others. Along
directions that the residuals hardly see, convergence is measured by the cost: the caller must check the step left.

Tested against the certified answers of NIST's reference problems (tests/core/numerics/test_nist.py); evaluations from
loose to tight noise: tests/benchmarks/evaluations.py.
Reference: dennis1981 (curvature from differences of Jacobians); walker2011 (Anderson's acceleration); more1983 (the
step within a ball); transtrum2012 (steps that follow a valley's bend); nist_strd.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import ComputationError
from calib.core.numerics.linear_model import LinearModel
from calib.core.numerics.linear_point import ON_RADIUS, LinearPoint

MAX_EVALUATIONS = 200
TOLERANCE = 1e-12
"""Promised decrease, relative to the cost, that ends the iteration: 1e-4 standard deviations at ten thousand rows."""
_SMALL_STEP = 1e-12
_ROUNDING = 10.0  # a step that did not lower the cost ends the iteration if it promised at most so many tolerances
_KEPT = 8  # steps whose Jacobians are remembered, together with
_NUMBERS_KEPT = 1 << 25  # at most so many numbers
_SHORTER = 0.25  # factor of the radius after a step that failed
_GOOD, _POOR = 0.75, 0.25  # the radius changes if more, or less, than this part of the promised decrease came
_BEND = 0.5  # longest correction of a bend, as part of the length of its step
_ABSURD = 3.5  # root mean square of a first step in units of the unknowns
_REACH = 0.5  # first limit of the steps after that, in the same units
_LONGER = 2.0  # longest step away from the bottom of a valley, in lengths of the last step
_AWAY = 8  # further steps away from the bottom
_PATIENCE = 20  # trial points before which a receding minimum is not given up
_RECEDED = 3  # steps in a row after which the remaining step was longer
_LIMIT, _RECEDES, _COST_STANDS, _STEP_VANISHES = (
    "the limit of evaluations was reached",
    "the best values recede",
    "the sum of squares no longer changes",
    "the unknowns no longer change",
)


@dataclass(frozen=True, eq=False)
class LeastSquaresSolution:
    """The end of the iteration.

    Attributes:
        x: The unknowns, (n,).
        residuals: r(x), (m,).
        converged: Whether a stopping rule was met before the evaluations ran out.
        message: The rule that ended it.
        recedes: Whether the minimum was given up because it recedes.
    """

    x: FloatArray
    residuals: FloatArray
    cost: float
    converged: bool
    evaluations: int
    message: str
    recedes: bool = False


def minimise(
    residuals: Callable[[FloatArray], FloatArray],
    jacobian: Callable[[FloatArray], FloatArray | LinearModel],
    start: FloatArray,
    *,
    scaling: Literal["unit", "jacobian"] = "unit",
    tolerance: float = TOLERANCE,
    max_evaluations: int = MAX_EVALUATIONS,
) -> LeastSquaresSolution:
    """Minimise the sum of squared residuals.

    Args:
        residuals: x (n,) -> r (m,); NaN where r has no value.
        jacobian: x (n,) -> dr/dx (m, n), as an array or above a prior; computed only where r was finite, and where the
            iteration returns to.
        start: Start, (n,).
        scaling: D of the module docstring.
        tolerance: Promised decrease, relative to the cost, that ends the iteration.
        max_evaluations: Number of trial points after which it ends as not converged.

    Raises:
        ComputationError: There are no residuals at the start.
    """
    values = residuals(start)
    if not np.all(np.isfinite(values)):
        raise ComputationError("the fit cannot start: the residuals have no value at the starting point")
    path = _Iteration(LinearPoint(start, values, jacobian(start)), scaling, tolerance)
    evaluations, message, recedes = 1, path.stopping_rule(), False
    while not (message or recedes) and evaluations < max_evaluations:
        x = path.trial()
        values = residuals(x)
        evaluations += 1
        curved = path.curved_trial(values)
        if curved is not None and evaluations < max_evaluations:
            curved_values = residuals(curved)
            evaluations += 1
            if _cost(curved_values) < _cost(values):
                x, values = curved, curved_values
        evaluations += path.take_step(x, values, jacobian)
        message, recedes = path.stopping_rule(), evaluations >= _PATIENCE and path.recedes
    evaluations += path.go_back(jacobian)
    best, converged = path.current, bool(message)
    message = message or (_RECEDES if recedes else _LIMIT)
    return LeastSquaresSolution(best.x, best.residuals, best.cost, converged, evaluations, message, recedes)


def _cost(values: FloatArray) -> float:
    """|r|^2, infinite where r has no value."""
    return float(values @ values) if np.all(np.isfinite(values)) else np.inf


class _Iteration:
    """The state of the iteration, and its memory; `scaling` and `tolerance` as in `minimise`."""

    def __init__(self, start: LinearPoint, scaling: Literal["unit", "jacobian"], tolerance: float) -> None:
        self.current = start
        self._tolerance = tolerance
        self._by_columns = scaling == "jacobian"
        self._scale = np.zeros(len(start.x)) if self._by_columns else np.ones(len(start.x))
        self._rescale(start)
        typical = float(np.sqrt(len(start.x)))
        self._start, self._first, self._absurd = start.x, self._length(start.newton), _ABSURD * typical
        self._cautious = not self._by_columns and self._first > self._absurd
        self._radius = _REACH * typical if self._cautious else np.inf
        if self._by_columns:
            self._radius = self._length(start.x) or 1.0
        self._past: list[LinearPoint] = []
        self._undone = False  # whether the last step was undone
        self._left: tuple[LinearPoint, float] | None = None  # where it left a valley's bottom, and the step's length
        self._away = 0  # steps since then
        self._stays = self._by_columns  # whether the search stays on the bottom from now on
        self._receded = 0  # steps in a row after which the remaining step was longer
        self._step: FloatArray = np.zeros(len(start.x))
        self._taken: FloatArray = self._step
        self._promised = start.cost

    def _length(self, step: FloatArray) -> float:
        return float(np.linalg.norm(self._scale * step))

    def _rescale(self, point: LinearPoint) -> None:
        if self._by_columns:
            norms = np.linalg.norm(point.triangle, axis=0)
            self._scale = np.maximum(self._scale, np.where(norms > 0, norms, 1.0))

    @property
    def _may_leave(self) -> bool:
        """Whether a step that does not lower the cost may be taken."""
        within = np.isfinite(self._radius) and not self._promises_little
        return self._away <= _AWAY if self._left is not None else within and not self._stays

    @property
    def _promises_little(self) -> bool:
        """Whether the promised decrease is so small that rounding decides about the step."""
        return self.current.cost - self._promised <= _ROUNDING * self._tolerance * self.current.cost

    @property
    def recedes(self) -> bool:
        """Whether the remaining step promises little, is absurdly long and grows."""
        current = self.current
        if self._by_columns or self._left is not None or self._receded < _RECEDED:
            return False
        come, left = self._length(current.x - self._start), self._length(current.newton)
        noise = np.sqrt(current.cost / max(len(current.residuals) - len(current.x), 1))
        longer = left > max(self._absurd, self._first)
        little = 2.0 * current.decrease <= min(current.cost, 2.0 * (noise * left / self._absurd) ** 2)
        return come > self._absurd and longer and bool(little)

    @property
    def lowest(self) -> LinearPoint:
        """The point with the lowest cost."""
        return self.current if self._left is None else self._left[0]

    def stopping_rule(self) -> str:
        """Return the stopping rule that is met; empty if none is."""
        if self._left is not None:
            return ""
        allowed = (_ROUNDING if self._undone else 1.0) * self._tolerance
        if self.current.decrease <= allowed * self.current.cost:
            return _COST_STANDS
        size = self._length(self.current.x) + (0.0 if self._by_columns else 1.0)
        return _STEP_VANISHES if min(self._length(self.current.newton), self._radius) <= _SMALL_STEP * size else ""

    def trial(self) -> FloatArray:
        """Return the next trial point, (n,)."""
        current = self.current
        curvature = current.curvature(self._past) if 2.0 * current.decrease <= current.cost else None
        self._step, self._promised = current.step(curvature, self._radius, self._scale)
        back = self._back(self._extrapolated_curvature()) if np.isfinite(self._radius) and self._past else None
        self._taken = self._step if back is None else self._step + back
        return np.asarray(current.x + self._taken)

    def _extrapolated_curvature(self) -> FloatArray:
        """Return the curvature of the rows along the next step, taken as that along the last one, (m,)."""
        before = self._past[-1]
        last = self.current.x - before.x
        along = float(last @ self._step) / float(last @ last)
        way = along * (self._step - 0.5 * along * last)
        return self.current.model.times(way) - before.model.times(way)

    def _back(self, bend: FloatArray) -> FloatArray | None:
        """Return the step that removes a bend, (n,)."""
        return self.current.correct_curvature(bend, _BEND * self._length(self._step), self._scale)

    def curved_trial(self, values: FloatArray) -> FloatArray | None:
        """Return a second trial point, (n,), after the first gave these residuals (m,); None if there is none."""
        reached, promised = _cost(values), self.current.cost - self._promised
        if self._left is not None or (np.isfinite(self._radius) and not self._stays) or self._promises_little:
            return None
        if not np.isfinite(reached) or self.current.cost - reached >= _GOOD * promised:
            return None
        back = self._back(values - self.current.residuals - self.current.model.times(self._taken))
        return None if back is None else np.asarray(self.current.x + self._step + back)

    def take_step(
        self, x: FloatArray, values: FloatArray, jacobian: Callable[[FloatArray], FloatArray | LinearModel]
    ) -> int:
        """Take the step to x (n,) with these residuals (m,), or stay; return the number of further evaluations."""
        reached, length = _cost(values), min(self._length(self._step), self._radius)
        self._undone = not reached < self.lowest.cost
        if self._undone and np.isfinite(reached) and self._may_leave:
            self._left = self._left or (self.current, length)
            self._radius, self._past, self._away = _LONGER * length, [], self._away + 1
            self.current = LinearPoint(x, values, jacobian(x))
            return 0
        if self._undone:
            self._radius = _SHORTER * (length if self._left is None else self._left[1])
            self._cautious, self._past = False, []
            return self.go_back(jacobian)
        trial = LinearPoint(x, values, jacobian(x))
        longer = self._length(trial.newton) > self._length(self.lowest.newton)
        self._receded = self._receded + 1 if longer else 0
        if self._left is not None:
            self._radius, self._left, self._away = _LONGER * self._left[1], None, 0
        else:
            promised = self.current.cost - self._promised
            self._radius = self._next_radius(trial, (self.current.cost - reached) / promised if promised > 0 else 0.0)
            count = min(_KEPT, _NUMBERS_KEPT // max(self.current.model.jacobian.size, 1))
            self._past = [*self._past, self.current][-count:] if count else []
        self.current = trial
        self._rescale(trial)
        return 0

    def go_back(self, jacobian: Callable[[FloatArray], FloatArray | LinearModel]) -> int:
        """Go back to the bottom of the valley for good, if the path is away; return the number of evaluations."""
        if self._left is None:
            return 0
        self.current, self._left, self._stays = self._left[0], None, True
        jacobian(self.current.x)  # tells the caller where the path is
        return 1

    def _next_radius(self, trial: LinearPoint, part: float) -> float:
        """Return the radius after a step that lowered the cost by this part of the promise."""
        if np.isinf(self._radius):
            return self._radius
        length = self._length(self._step)
        if self._cautious and length >= (1.0 - ON_RADIUS) * self._radius:
            linear = self.current.residuals + self.current.model.times(self._step)
            left = float(np.linalg.norm(trial.residuals - linear))
            if left * (self._length(trial.newton) / length) ** 2 <= np.sqrt(trial.cost):
                return np.inf
        if part < _POOR:
            return _SHORTER * length
        return self._radius if part < _GOOD else max(self._radius, 2.0 * length)
