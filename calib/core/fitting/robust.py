"""Fitting with a robust loss: repeated least squares, with weights from the previous residuals.

Given weights, the problem is the one of `calib.core.fitting.problem`; given its solution, `calib.core.numerics.losses`
gives new weights. The alternation runs on the linear model around the present parameters, where a round costs next to
nothing, until the weights settle. Then the true problem is solved with these weights, and so on until they settle
there, too.

Unstated noise is that of the median reading: least squares finds the scales of the groups of rows; then the median
length of a group's readings sets its scale. The same holds for stated noise where the median reading contradicts it
(`calib.core.fitting.solving` says why); a few gross errors do not move the median.

Cauchy and Tukey have several minima. They start from Huber's solution, which is unique on a linear model, and keep its
scale (the MM principle), so that the scale cannot shrink without end.

Reference: maronna2019, chapter 5.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray
from calib.core.base.errors import NotIdentifiableError
from calib.core.fitting.problem import Evaluation, Problem
from calib.core.fitting.solved_fit import COMPUTED
from calib.core.fitting.starts import Starts
from calib.core.numerics.chances import EXACT
from calib.core.numerics.least_squares import LeastSquaresSolution
from calib.core.numerics.losses import Loss, median_length, robust_factors, scale_of, weights_of
from calib.core.numerics.observability import posterior_information
from calib.core.numerics.statistics import Factors, effective_parameters
from calib.core.rows.rows import Rows

_ROUNDS = 20
_LINEAR_ROUNDS = 200
_WEIGHTS_STAND = 1e-4
_MEDIAN = 0.37  # efficiency of the median of absolute values as a scale, for normal noise (maronna2019)
_SMALLEST_SCALE = 1e-8  # below ten nanometres a residual is rounding [SI]
_NO_NOISE = (
    "the readings agree with the fitted robot as exactly as computed ones: they have no noise by which --loss {loss}"
    " could tell good ones from bad ones; fit with --loss none, and without --exclude-outliers, which uses --loss tukey"
)
_TOO_FEW_LEFT = (
    "the robust loss has rejected so many readings that the rest does not determine the parameters: too many"
    " measurements disagree with each other; check them, or fit with --loss none"
)


@dataclass(frozen=True, eq=False)
class RobustSolution:
    """A minimum, and the weights of its rows.

    Attributes:
        problem: The solved problem, with the noise and the sizes of families that were found.
        groups: Scale of the noise of each group, (n_groups,).
        weights: Weight of each reading, (n_readings,); None without a robust loss.
        factors: Factors on the noise, by the residuals, with a robust loss.
        has_settled_weights: Whether the weights of a robust loss have settled.
        starts: Ends of perturbed starts, if requested.
    """

    problem: Problem
    evaluation: Evaluation
    groups: FloatArray
    solution: LeastSquaresSolution
    weights: FloatArray | None = None
    factors: Factors | None = None
    has_settled_weights: bool = True
    starts: Starts | None = None


def solve_robust(solved: RobustSolution, loss: Loss) -> RobustSolution:
    """Minimise with a robust loss, from a least-squares solution.

    Args:
        loss: The loss, not `none`.

    Raises:
        NotIdentifiableError: The loss rejects too many readings to determine the parameters, or readings have no noise.
    """
    try:
        return _solve_robust(solved, loss)
    except NotIdentifiableError:
        typical = [group.typical for group in solved.problem.whitening.groups]
        levels = _levels(solved.problem.rows(solved.evaluation, solved.groups)) * solved.groups * typical
        if np.max(levels) > COMPUTED:
            raise
        raise NotIdentifiableError(_NO_NOISE.format(loss=loss)) from None


def _solve_robust(solved: RobustSolution, loss: Loss) -> RobustSolution:
    problem, at, scale = solved.problem, solved.evaluation, float("nan")
    layout = problem.whitening.layout
    groups, noise_found = _initial_scales(problem, problem.rows(at, solved.groups), solved.groups)
    found_everywhere = bool(np.all(noise_found))
    stages: tuple[Loss, ...] = ("huber",) if loss == "huber" else ("huber", loss)
    for stage in stages:
        fixed = scale if stage != "huber" else None
        weights: FloatArray = np.ones(layout.n_readings)
        settled = False
        for _ in range(_ROUNDS):
            rows = problem.rows(at, groups)
            if stage == "huber":
                groups = _median_scales(rows, groups, noise_found)
                rows = problem.rows(at, groups)
            now, scale, _ = _linear_solution(rows, stage, fixed, found_everywhere)
            settled = bool(np.max(np.abs(now - weights)) < _WEIGHTS_STAND)
            weights = now
            if settled:
                break
            at = problem.solve(at, groups, weights=weights)[0]
    if found_everywhere:  # priors weigh against the noise of the median reading
        groups, scale = groups * scale, 1.0
    at, solution = problem.solve(at, groups, weights=weights)
    final = problem.rows(at, groups)
    known = posterior_information(np.sqrt(np.mean(weights)) * final.factor[:, :-1], final.prior)
    n_effective = effective_parameters(known, final.prior)
    pooled = robust_factors(loss, final.distances(), layout.width, scale, n_effective)
    n_rows = layout.counts
    ones = np.ones(len(n_rows))
    factors = Factors(
        pooled.values * ones, pooled.freedom * n_rows / n_rows.sum(), pooled.effective * ones, pooled.slope
    )
    return RobustSolution(problem, at, groups, solution, weights, factors, settled, solved.starts)


def _initial_scales(problem: Problem, rows: Rows, groups: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return scales (n_groups,): the stated ones 1, or found where the median reading contradicts them.

    The second result is a mask of the groups whose noise is found, (n_groups,).
    """
    unstated = problem.whitening.is_unstated
    if not problem.noise_weighs or np.all(unstated):
        return groups, unstated
    step = _linear_solution(rows, "huber", None, True)[2]
    scales = groups * _levels(replace(rows, residuals=rows.residuals + rows.jacobian @ step))
    noise_found = unstated | (scales > problem.largest_scales(_MEDIAN))
    return np.where(unstated, groups, np.where(noise_found, scales, 1.0)), noise_found


def _levels(rows: Rows) -> FloatArray:
    """Scale of each group over its assumed scale, by the median length of its readings, (n_groups,)."""
    layout = rows.layout
    levels = np.ones(len(layout.groups))
    for g in range(len(levels)):
        mine = layout.group == g
        width = np.bincount(layout.reading[mine], minlength=layout.n_readings)
        length = np.sqrt(np.bincount(layout.reading[mine], rows.residuals[mine] ** 2, layout.n_readings))
        has_rows = width > 0
        if np.any(has_rows):
            levels[g] = float(np.median(length[has_rows] / median_length(width[has_rows])))
    return levels


def _median_scales(rows: Rows, groups: FloatArray, noise_found: BoolArray) -> FloatArray:
    """Set the scale of each group whose noise is found, other than the first, by its median reading."""
    if len(groups) == 1 or not np.any(noise_found):
        return groups
    return groups * np.where(noise_found, np.maximum(_levels(rows), EXACT), 1.0)


def _linear_solution(
    rows: Rows, loss: Loss, fixed_scale: float | None, found_everywhere: bool
) -> tuple[FloatArray, float, FloatArray]:
    """Alternate on the linear model; return weights (n_readings,), scale, and the step to its solution (n_free,)."""
    layout = rows.layout
    weights: FloatArray = np.ones(layout.n_readings)
    step: FloatArray = np.zeros(rows.jacobian.shape[1])
    scale, smallest = fixed_scale or 0.0, _SMALLEST_SCALE / max(group.typical for group in layout.groups)
    for _ in range(_LINEAR_ROUNDS):
        residuals = rows.residuals + rows.jacobian @ step
        distances = np.sqrt(np.bincount(layout.reading, residuals**2, layout.n_readings))
        if fixed_scale is None:
            assumed = max(scale_of(distances, layout.width, 0.0), smallest) if found_everywhere else 1.0
            known = posterior_information(rows.factor[:, :-1] / assumed, rows.prior)
            n_effective = effective_parameters(known, rows.prior)
            scale = max(scale_of(distances, layout.width, n_effective), smallest)
        now = weights_of(loss, distances / scale, layout.width)
        settled = bool(np.max(np.abs(now - weights)) < _WEIGHTS_STAND / 10)
        weights = now
        step = _step(rows, weights, scale if found_everywhere else 1.0)
        if settled:
            break
    return weights, scale, step


def _step(rows: Rows, weights: FloatArray, sigma: float) -> FloatArray:
    """Solve the weighted linear problem, with priors weighted against this noise."""
    model = rows.with_weights(weights / sigma**2)
    if model.posterior_information.root.shape[1] < rows.jacobian.shape[1]:
        raise NotIdentifiableError(_TOO_FEW_LEFT)
    return model.step()
