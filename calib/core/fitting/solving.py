"""From placed base and targets to the minimum, with unstated noise found on the way.

Where the noise of an instrument is not stated, it is found from the residuals
(`calib.core.numerics.size_search`): the solve is repeated until noise changes by less than one percent.
Where priors are weighed against stated noise, the errors that the model leaves out count too: for a robot with gear
errors, the noise of a good tracker is the least part. With a statement that residuals contradict, priors would pull
parameters hundreds of sigmas away from their expected values, and slowly, along bent valleys. So the noise of such a
group is found as well, where chance explains the residuals in less than one case of a thousand. The linear model around
the start decides. If its residuals come from curvature, so that the minimum contradicts nothing, the statement is used.
At the likeliest scales, the squares of whitened residuals of each group are as many as its degrees of freedom, and at
larger ones fewer. So where they are fewer at the largest scales that chance explains, no search follows.
(`calib.core.judging.rules_noise` gives the verdict on the statement itself.)
"""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import replace
from functools import partial

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray
from calib.core.base.errors import NotConvergedError, NotIdentifiableError
from calib.core.base.workers import Progress
from calib.core.fitting.curvature import mean_square_beyond_linear
from calib.core.fitting.problem import Evaluation, Problem
from calib.core.fitting.robust import RobustSolution, solve_robust
from calib.core.fitting.settings import Settings
from calib.core.fitting.solved_fit import Convergence
from calib.core.fitting.starts import explore
from calib.core.numerics.chances import EXACT, HARDLY, UNLIKELY
from calib.core.numerics.clusters import Scatter, scatter
from calib.core.numerics.least_squares import TOLERANCE
from calib.core.numerics.linear_model import LinearModel
from calib.core.numerics.mixed_rows import UNSEEN, SeenColumns
from calib.core.numerics.size_search import find_sizes, unseen_variances, variance_by_sizes
from calib.core.numerics.statistics import BeyondLinear, Factors, Statistics, find_factors, statistics
from calib.core.numerics.tall import Span, squares_of_rows
from calib.core.rows.registration import register
from calib.core.rows.rows import Rows

_LOOSE = 1e-3  # tolerance of the solver where another solve follows
_PLACED = 1e-6  # tolerance for the state `before`: its errors then hold to a millionth
_NOISE_ROUNDS = 20
_NOISE_CONVERGED = 0.01  # scales are found once they change by less than this part
_FAMILIES_CONVERGED = 5.0  # factor on this part for sizes of families
_NO_NOISE = (
    "the noise of the measurements could not be found from the residuals; state it (`sigma` in the description, or"
    " --sigma-mm)"
)
STEP_LEFT = 0.05
"""A fit has converged if its distance from the minimum is at most this many standard deviations."""
_FAR = 0.5  # receding parameters are named if they still move by this part of the largest step
_BLIND = 1e-6  # no reading sees a place whose column is below this part of the longest, in expected units
ROUNDING = 1e-8
"""Rounding decides about a step that is smaller than 10 nm or 10 nrad."""


def place(problem: Problem) -> Evaluation:
    """Return the nominal robot, evaluated, with unknown frames and targets placed by registration alone.

    A target with a prior stays near its expected place as far as the noise of these residuals allows: the nominal
    robot's own errors are part of that noise, so that it is found, whatever the description states for the sensor.

    Raises:
        NotConvergedError: The places cannot be found.
    """
    robot = problem.robot
    places = problem.unknowns.select(problem.unknowns.placement)
    if not len(places):
        return problem.evaluate(robot)
    placed, solution = problem.evaluate(register(robot, problem.data)), None
    groups = _as_found(problem, placed, problem.whitening.start(placed.residuals))
    for _ in range(_NOISE_ROUNDS):
        placed, solution = problem.solve(placed, groups, places, tolerance=_PLACED)
        again = _as_found(problem, placed, groups)
        if not np.any(places.prior.has) or np.all(np.abs(again / groups - 1.0) <= _NOISE_CONVERGED):
            break
        groups = again
    if solution is None or not solution.converged:
        raise NotConvergedError(
            "placing the base and the targets did not converge; check units and axes of the measurements"
        )
    return placed


def reset_unseen(problem: Problem, placed: Evaluation) -> Evaluation:
    """Return a placed robot with places that no reading sees reset to the description.

    The nominal robot's own errors may place a point where its instrument is blind, such as the end of a draw wire in
    the very plane in which a planar robot moves. A solver would not leave it, and the rank there is not that of the
    solution.
    """
    unknowns, groups = problem.unknowns, problem.whitening.start()
    columns = problem.derivative(placed, groups, unknowns)
    lengths = np.sqrt(np.einsum("ij,ij->j", columns, columns))
    blind = unknowns.placement & ~unknowns.prior.has & (lengths < _BLIND * np.max(lengths, initial=0.0))
    if not np.any(blind):
        return placed
    values = placed.robot.values.copy()
    values[unknowns.index[blind]] = unknowns.expected[blind]
    return problem.evaluate(placed.robot.with_parameters(values), placed)


def _as_found(problem: Problem, evaluation: Evaluation, groups: FloatArray) -> FloatArray:
    """Scales of all groups, stated or not, from the residuals of placing."""
    flat, group = problem.whitening.flatten(evaluation.residuals), problem.whitening.layout.group
    n_places, result = int(np.sum(problem.unknowns.placement)), groups.copy()
    for g in range(len(result)):
        rows = group == g
        left = max(int(np.sum(rows)) - n_places, 1)
        result[g] = np.sqrt(float(flat[rows] @ flat[rows]) / left) + EXACT
    return result


def solve_from(
    problem: Problem,
    placed: Evaluation,
    settings: Settings,
    workers: Executor | None = None,
    progress: Progress | None = None,
) -> RobustSolution:
    """Solve with the stated noise or find it; from several starts and with a robust loss, if requested.

    Args:
        placed: Evaluation at the start.
        workers: Workers for the other starts; this process if not given.

    Raises:
        NotConvergedError: The noise cannot be found.
    """
    solve = partial(_solve_with_noise, exact=TOLERANCE if settings.loss == "none" else _LOOSE)  # a robust loss goes on
    solved = solve(problem, placed)
    if settings.starts > 1:
        first, begin = (solved.evaluation, solved.solution), placed.robot
        tried = explore(solved.problem, begin, first, solved.groups, settings.starts, settings.seed, workers, progress)
        best = tried.minima[0]
        if best.solution is not solved.solution:  # the found noise belongs to the other minimum
            solved = solve(problem, problem.evaluate(best.robot))
        solved = replace(solved, starts=tried)
    return solved if settings.loss == "none" else solve_robust(solved, settings.loss)


def _solve_with_noise(problem: Problem, start: Evaluation, exact: float) -> RobustSolution:
    """Solve with the stated noise; find unstated noise, and noise that residuals contradict.

    Too few readings to find any noise do not contradict noise that other robots have confirmed.
    """
    try:
        return _solve_finding_noise(problem, start, exact)
    except NotIdentifiableError:
        problem = replace(problem, noise_found=problem.whitening.is_unstated)
        if not np.any(problem.confirmed_freedom):
            raise
    groups = problem.whitening.start(start.residuals)
    at, solution = problem.solve(start, groups, tolerance=exact)
    return RobustSolution(problem, at, groups, solution)


def _solve_finding_noise(problem: Problem, start: Evaluation, exact: float) -> RobustSolution:
    groups, unstated = problem.whitening.start(start.residuals), problem.whitening.is_unstated
    problem = replace(problem, noise_found=unstated)
    if problem.noise_weighs and not np.all(unstated):
        problem, groups = release_contradicted_noise(problem, start, groups)
    at, tolerance = start, _LOOSE
    for _ in range(_NOISE_ROUNDS):
        finds = (np.any(problem.noise_found) and problem.noise_weighs) or problem.unknowns.families
        at, solution = problem.solve(at, groups, tolerance=tolerance if finds else exact)
        if not finds:
            return RobustSolution(problem, at, groups, solution)
        scales, sizes = scales_found(problem, at, groups)
        consistent = problem.noise_found & ~unstated & (scales <= problem.largest_scales())
        if np.any(consistent):
            problem = replace(problem, noise_found=problem.noise_found & ~consistent)
            groups = np.where(consistent, 1.0, scales)
            continue
        counts = problem.noise_found & (scales > EXACT)
        change = float(np.max(np.abs(scales / groups - 1.0)[counts], initial=0.0))
        change = max(change, float(np.max(np.abs(sizes - 1.0), initial=0.0)) / _FAMILIES_CONVERGED)
        if change <= _NOISE_CONVERGED and tolerance == exact:
            return RobustSolution(problem, at, groups, solution)
        if change <= 10 * _NOISE_CONVERGED:
            tolerance = exact
        if change > _NOISE_CONVERGED:
            groups = scales
            problem = replace(problem, unknowns=problem.unknowns.rescale_families(sizes))
    raise NotConvergedError(_NO_NOISE)


def scales_found(
    problem: Problem, evaluation: Evaluation, groups: FloatArray, *, rough: bool = False
) -> tuple[FloatArray, FloatArray]:
    """Find scales of groups (n_groups,), 1 unless `noise_found`, and factors on sigmas of families (n_families,).

    Args:
        evaluation: An evaluation near the minimum, whose linear model counts.
        groups: Scales to start from, (n_groups,).
        rough: As in `find_sizes`.
    """
    unknowns = problem.unknowns
    first = [int(np.argmax(unknowns.family == k)) for k in range(len(unknowns.families))]
    sizes = unknowns.scales[first] / problem.robot.parameters.sigma_si[unknowns.index[first]]
    stated = np.ones(len(groups))
    if not len(sizes):
        model: LinearModel = problem.compressed(evaluation, stated, unknowns)
        return find_sizes(model, groups, problem.noise_found, unknowns.family, sizes, rough=rough)
    model = problem.rows(evaluation, groups, unknowns.rescale_families(1.0 / sizes))  # noise decides what rows see
    scales, found = find_sizes(model, stated, problem.noise_found, unknowns.family, sizes)
    return np.maximum(groups * scales, EXACT / 10), found / sizes


def release_contradicted_noise(
    problem: Problem, evaluation: Evaluation, groups: FloatArray
) -> tuple[Problem, FloatArray]:
    """Let the noise be found for groups whose statement the linear model contradicts; also return starting scales.

    Args:
        evaluation: The point of the linear model.
        groups: Scales to keep where nothing is contradicted, (n_groups,).
    """
    unknowns, n_rows, largest = problem.unknowns, int(np.sum(problem.whitening.layout.counts)), problem.largest_scales()
    if len(groups) == 1 and not len(unknowns.families) and n_rows > len(unknowns):  # the scale is the only size
        model = problem.compressed(evaluation, np.where(problem.whitening.is_unstated, groups, largest), unknowns)
        left = model.residuals + model.jacobian @ model.step()
        if np.sum(left**2 + squares_of_rows(model.span)) <= n_rows:
            return problem, groups
    all_found = replace(problem, noise_found=np.ones(len(groups), dtype=bool))
    scales, _ = scales_found(all_found, evaluation, groups, rough=True)
    contradicted = scales > largest
    return replace(problem, noise_found=problem.whitening.is_unstated | contradicted), np.where(
        contradicted, scales, groups
    )


def uncertainty_at(
    solved: RobustSolution, beyond_linear: BeyondLinear | None = None
) -> tuple[Rows, FloatArray, Statistics]:
    """Return the rows at a minimum, the scales of their noise (n_groups,), and the uncertainty of the parameters.

    Args:
        beyond_linear: `Statistics.beyond_linear` of a minimum nearby, if it is known.

    Raises:
        NotIdentifiableError: No degrees of freedom are left.
    """
    problem, robust, unknowns = solved.problem, solved.factors, solved.problem.unknowns
    rows = problem.rows(solved.evaluation, solved.groups)
    seen = SeenColumns.from_rows(rows.jacobian, rows.prior, unknowns.family, UNSEEN) if unknowns.families else None
    model: LinearModel = rows if seen is None else seen.model(rows)
    slowed = model if robust is None else replace(model, jacobian=np.sqrt(robust.slope) * model.jacobian)
    known, layout = slowed.posterior_information, rows.layout
    span = model.span if slowed is model else Span(model.jacobian, known.root)
    factors = robust or find_factors(rows.residuals, span, layout.group, len(layout.groups), problem.confirmed_freedom)
    if beyond_linear is None:
        beyond_linear = BeyondLinear(
            partial(mean_square_beyond_linear, problem, replace(solved.evaluation), rows, solved.groups)
        )
    poses = scatter_of_poses(rows, span, factors, solved.weights)
    arguments = span, layout.group, known, factors, unknowns.scales, model.prior, poses, beyond_linear
    if seen is None:
        return rows, solved.groups, statistics(*arguments)
    rows.remember_span(model.span)
    by_sizes = variance_by_sizes(known.covariance, seen.family, model.deviations)
    unseen = unseen_variances(known.covariance, seen.family)

    def expand(of_components: FloatArray) -> tuple[FloatArray, BoolArray]:
        return seen.covariance(of_components + by_sizes, unseen), rows.prior.has

    return rows, solved.groups, statistics(*arguments, expand)


def scatter_of_poses(
    rows: Rows, span: FloatArray | Span, factors: Factors, weights: FloatArray | None
) -> Scatter | None:
    """Return the scatter of the readings of each pose (`calib.core.numerics.clusters`), where they share errors.

    Args:
        rows: Rows at the minimum, without the weights of a robust loss.
        span: U = J T of the rows, with T of the rows, times the slope of a robust loss, and the priors, (n_rows, rank).
        factors: Factors on the noise, by the residuals.
        weights: Weight of each reading, (n_readings,); None without a robust loss.
    """
    layout = rows.layout
    noise = factors.slope * np.where(layout.group >= 0, factors.effective[layout.group], 1.0)
    pulling = rows.residuals if weights is None else weights[layout.reading] * rows.residuals
    several = layout.n_readings >= 2 * len(np.unique(layout.pose))  # these probably share an error
    level = HARDLY if several else UNLIKELY
    found = scatter(span, pulling, noise, layout.pose_of_row, factors.total_freedom)
    return found if found.ratio > 1.0 and found.chance < level else None


def convergence_at(solved: RobustSolution, rows: Rows, std: FloatArray) -> Convergence:
    """Return the state of convergence by the Gauss-Newton step that is left, in standard deviations.

    Only this step counts, whether a stopping rule ended the iteration or its limit of evaluations.

    Args:
        std: Standard deviations of the free parameters, (n_free,) [m, rad].
    """
    weighted = rows if solved.weights is None else rows.with_weights(solved.weights)
    away, unknowns = np.abs(weighted.step()), solved.problem.unknowns
    left = unknowns.scales * away / (std + ROUNDING)
    largest = int(np.argmax(left))
    name, step, message = unknowns.names[largest], float(left[largest]), solved.solution.message
    close = step < STEP_LEFT
    if close and not solved.solution.converged:
        message = f"no parameter would still move by more than {step:.2g} standard deviations ({name})"
    elif solved.solution.converged and not close:
        message += f", but {name} would still move by {step:.2g} standard deviations"
    recedes = solved.solution.recedes and not close
    far = np.flatnonzero(away >= _FAR * np.max(away)) if recedes else np.zeros(0, dtype=np.intp)
    receding = tuple(unknowns.names[k] for k in far[np.argsort(-away[far])])
    return Convergence(solved.has_settled_weights and close, message, step, name, solved.has_settled_weights, receding)
