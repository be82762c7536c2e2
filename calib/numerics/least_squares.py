"""The solver of every fit: nonlinear least squares from residuals and their exact Jacobian.

Minimise |r(x)|^2. scipy's trust-region method is used: each step minimises |r + J dx| within a ball |D dx| <= radius,
solved through the SVD of J, and the radius follows how well that linear model predicted the change. Where a trial point
has no residuals (a loop that cannot close answers NaN) the step is shortened. D is one of

    `unit`       1: the unknowns are already scaled, so that a change of one is a reasonable change of each
    `jacobian`   the largest norm so far of each column of J: for unknowns of any size and unit

The iteration ends as converged when the cost changes by less than `tolerance` of itself (and the model agreed), when
the step is below 1e-12 of the unknowns, or when the largest gradient component is below 1e-12; it ends as not converged
after `max_evaluations` trial points.

With more than 200 unknowns (joint curves), where priors keep J^T J well conditioned, steps are those of Levenberg and
Marquardt, (J^T J + d diag(J^T J)) dx = -J^T r with d = 0 as long as the cost falls.

When it fails. It finds the minimum in whose valley it starts; `calib.identification.starts` looks for others. Along
directions that the residuals hardly see, convergence is judged by the cost: the caller must check what step is left.

Tested against the certified answers of NIST's reference problems (tests/test_nist.py).
Reference: more1983 (trust regions); nist_strd.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import least_squares

from calib.arrays import FloatArray
from calib.errors import ComputationError

MAX_EVALUATIONS = 200
TOLERANCE = 1e-9
"""Relative change of the cost that ends the iteration: less than a thousandth of a standard deviation."""
MANY = 200
"""Unknowns from which steps are solved through the products J^T J, which cost a tenth of an SVD."""
_SMALL_STEP = 1e-12
_DAMPING = 1e-3
_MESSAGES = {
    0: "the limit of evaluations was reached",
    1: "the gradient vanishes",
    2: "the sum of squares no longer changes",
    3: "the unknowns no longer change",
    4: "neither the sum of squares nor the unknowns change any more",
}
"""Words for the stopping rules of scipy's solver."""


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
        tolerance: Relative change of the cost that ends the iteration.
        max_evaluations: Number of trial points after which it ends as not converged.

    Raises:
        ComputationError: There are no residuals at the start.
    """
    if not np.all(np.isfinite(residuals(start))):
        raise ComputationError("the fit cannot start: the residuals have no value at the starting point")
    if len(start) > MANY:
        return _many(residuals, jacobian, start, tolerance, max_evaluations)
    outcome = least_squares(
        residuals,
        start,
        jac=jacobian,
        method="trf",
        x_scale="jac" if scaling == "jacobian" else 1.0,
        ftol=tolerance,
        xtol=min(_SMALL_STEP, tolerance),
        gtol=min(_SMALL_STEP, tolerance),
        max_nfev=max_evaluations,
    )
    return Solution(
        x=outcome.x,
        residuals=outcome.fun,
        jacobian=outcome.jac,
        cost=2.0 * float(outcome.cost),
        converged=bool(outcome.status > 0),
        evaluations=int(outcome.nfev),
        message=_MESSAGES.get(int(outcome.status), str(outcome.message)),
    )


def _many(
    residuals: Callable[[FloatArray], FloatArray],
    jacobian: Callable[[FloatArray], FloatArray],
    start: FloatArray,
    tolerance: float,
    max_evaluations: int,
) -> Solution:
    """Levenberg and Marquardt's steps, for many unknowns."""
    x, damping, evaluations = start.copy(), 0.0, 1
    values, slope = residuals(x), jacobian(x)
    cost, message = float(values @ values), 0
    while evaluations < max_evaluations and not message:
        matrix, pull = slope.T @ slope, slope.T @ values
        while evaluations < max_evaluations:
            damped = matrix + np.diag(damping * np.diag(matrix))
            step = -cho_solve(cho_factor(damped), pull)
            trial = residuals(x + step)
            evaluations += 1
            promised = -float(step @ (2.0 * pull + matrix @ step))
            reached = float(trial @ trial) if np.all(np.isfinite(trial)) else np.inf
            if reached <= cost or promised <= tolerance * cost:
                break
            damping = max(10.0 * damping, _DAMPING)
        if not reached <= cost * (1.0 + tolerance):
            break
        small = float(np.linalg.norm(step)) <= _SMALL_STEP * (1.0 + float(np.linalg.norm(x)))
        message = 2 if cost - reached <= tolerance * cost else 3 if small else 0
        x, values, cost, damping = x + step, trial, reached, damping / 10.0 if damping > _DAMPING else 0.0
        slope = jacobian(x)
    return Solution(x, values, slope, cost, bool(message), evaluations, _MESSAGES[message])
