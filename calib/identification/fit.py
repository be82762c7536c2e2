"""Identification: the parameter values that explain the measurements best.

Minimise, over u = (p - p_nominal) / s,

    sum over visits  r^T V^-1 r   +   sum over parameters with a prior  u^2

with r the residuals of all readings of a visit and V the covariance of their noise (`calib.linearisation.rows`), by
`calib.numerics.least_squares`.

Order of work: (1) close every pose at nominal, or name those that cannot be; (2) where measurement frames or targets
are not known, they are placed alone, near where they are expected if a sigma says so: this is the honest state
`before`; (3) all free parameters together, from several starts if asked for; (4) with a robust loss, again with weights
(`calib.identification.robust`); (5) rank, statistics and error tables at the solution; (6) if asked for, outliers are
left out and all is done again, and poses are left out in turns for cross-validation.

Where nobody states the noise of an instrument, it is found from the residuals, and so is an error that the rows of a
pose share (`calib.numerics.variance_components`): step 3 is repeated until noise changes by less than one percent, and
offsets by less than one in twenty. With a robust loss no shared errors are looked for: a gross error is one, too.

When it fails. Fewer coordinates than unknowns, or columns that the poses cannot tell apart and no prior holds, is a
`NotIdentifiableError` that names the parameters. A fit that did not converge comes back with the verdict FAIL.
"""

from __future__ import annotations

import time
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from calib.arrays import FloatArray
from calib.data.measurements import Measurements
from calib.errors import ComputationError, DataError, InputError, NotConvergedError, UnreachablePoseError
from calib.identification.candidate_terms import TermChoice, missing_terms
from calib.identification.errors_found import ErrorSet
from calib.identification.fitted import Convergence, Fit
from calib.identification.pose_checks import check_measurements, likely_mistake, require_identifiable
from calib.identification.problem import Evaluation, Problem
from calib.identification.robust import solve_robust, without_outliers
from calib.identification.starts import Starts, explore
from calib.identification.term_choice import choose_terms
from calib.identification.validation import cross_validate
from calib.identification.verdict import judge
from calib.joint_terms.terms import listed_terms
from calib.linearisation.observed import observe
from calib.linearisation.registration import register
from calib.linearisation.rows import Rows, Scales
from calib.linearisation.unknowns import Unknowns
from calib.model.robot import Robot
from calib.numerics.least_squares import TOLERANCE, Solution
from calib.numerics.losses import Loss, checked_loss
from calib.numerics.observability import observability
from calib.numerics.prior_sizes import variance_by_sizes
from calib.numerics.statistics import Factors, Statistics, found_factors, statistics
from calib.numerics.variance_components import EXACT
from calib.threads import one_blas_thread
from calib.workers import Progress, Workers

_LOOSE = 1e-3  # tolerance of the solver where another solve follows
_PLACED = 1e-6  # the same for the state before: its errors then hold to a millionth
_NOISE_ROUNDS = 20
_NOISE_STANDS = 0.01  # relative change of scales below which they are found
_FAMILIES_STAND = 5.0  # how much less exactly the sizes of families need to be found
_RATIOS_STAND = 0.05  # the same of offsets over noise, from 1 on; they change weights and nothing else
_NO_NOISE = (
    "the noise of the measurements could not be found from the residuals; state it (`sigma` in the description, or"
    " --sigma-mm)"
)
_STEP_LEFT = 0.05  # standard deviations that a converged fit may be away from its minimum
_ROUNDING = 1e-8  # 10 nm and 10 nrad: below, rounding decides about a step


@dataclass(frozen=True)
class Settings:
    """How to fit.

    Attributes:
        sigma: Standard deviation of measured positions per axis [m], in place of what the description states; where
            neither does, it is found.
        loss: `none`, or a robust loss: `huber`, `cauchy`, `tukey` (see `calib.numerics.losses`).
        exclude_outliers: Leave outliers out and fit again; the result holds both fits.
        starts: Number of starting points, the nominal one and perturbed ones.
        folds: Number of folds for cross-validation by pose; 0 for none.
        seed: Seed of perturbed starts and folds.
        terms: Joint terms: those of the description if not given; `none`; a list such as `curve,elbow=backlash`, in
            addition to these; `auto`, in addition those that earn their place (`calib.identification.term_choice`).

    Raises:
        DataError: Sigma is not a positive number.
        InputError: Unknown loss, or a number of starts or a seed that makes no sense.
    """

    sigma: float | None = None
    loss: Loss = "none"
    exclude_outliers: bool = False
    starts: int = 1
    folds: int = 0
    seed: int = 0
    terms: str | None = None

    def __post_init__(self) -> None:
        if self.sigma is not None and not (np.isfinite(self.sigma) and self.sigma > 0):
            raise DataError(f"sigma {self.sigma:g} m: must be a positive number")
        checked_loss(self.loss)
        if self.starts < 1:
            raise InputError(f"starts {self.starts}: must be 1 or more")
        if self.seed < 0:
            raise InputError(f"seed {self.seed}: must be zero or more")


@dataclass(frozen=True, eq=False)
class Solved:
    """A minimum, and what weighed its rows.

    Attributes:
        robot: The parameters there.
        groups: Scale of the noise of each group, (n_groups,).
        solution: What the solver said.
        weights: Of each reading, (n_readings,); None without a robust loss.
        factors: What the residuals say about the noise, with a robust loss.
        settled: Whether the weights of a robust loss stand.
        starts: Ends of perturbed starts, if they were asked for.
    """

    robot: Robot
    groups: FloatArray
    solution: Solution
    weights: FloatArray | None = None
    factors: Factors | None = None
    settled: bool = True
    starts: Starts | None = None


@one_blas_thread
def identify(
    robot: Robot,
    data: Measurements,
    validation: Measurements | None,
    settings: Settings,
    executor: Executor | int | None = None,
    progress: Progress | None = None,
) -> Fit:
    """Calibrate a robot.

    Args:
        robot: The nominal robot.
        data: Measurements to identify with.
        validation: Measurements to judge the result with, or None.
        settings: How.
        executor: Who does the fits of other starts and of folds: any `concurrent.futures` executor, or a number of
            processes on this machine; this process if not given.
        progress: Told how many other starts are done, of how many; then how many folds.

    Raises:
        UnreachablePoseError: A pose cannot be assembled.
        DataError: Too few measurements, or measurements that are not finite.
        InputError: An unknown term, a number of folds that makes no sense, or data that are no measurements.
        NotIdentifiableError: The poses do not determine the free parameters.
        NotConvergedError: Base and targets cannot be placed, or the noise cannot be found.
    """
    started = time.perf_counter()
    _require_measurements(data, validation)
    with Workers(executor, max(settings.starts - 1, settings.folds)) as workers:
        fit = _identified(robot, data, validation, settings, workers, progress)
    return replace(fit, seconds=time.perf_counter() - started)


def _identified(
    robot: Robot,
    data: Measurements,
    validation: Measurements | None,
    settings: Settings,
    workers: Executor | None,
    progress: Progress | None,
) -> Fit:
    """Do all steps of the module docstring."""
    try:
        robot, choice = _with_terms(robot, data, settings)
        fit = _fit(robot, settings, data, validation, workers, progress)
    except UnreachablePoseError as error:
        mistake = likely_mistake(robot, data)
        raise UnreachablePoseError(f"{error}{'; ' if mistake else ''}{mistake}") from None
    plain = replace(settings, starts=1)
    if settings.exclude_outliers:
        fit = without_outliers(
            fit,
            robust=lambda: _fit(robot, replace(plain, loss="tukey"), data),
            again=lambda kept: _fit(robot, settings, kept, validation, workers, progress),
        )
    if settings.folds:
        used, fold = fit.identification.data, partial(_fit, robot, plain)
        fit = replace(fit, folds=cross_validate(used, settings.folds, settings.seed, fold, workers, progress))
    return replace(fit, terms=choice)


def _with_terms(robot: Robot, data: Measurements, settings: Settings) -> tuple[Robot, TermChoice | None]:
    """The robot with the joint terms that were asked for."""
    own, terms = robot.description.terms, settings.terms
    if terms is None:
        return robot, None
    if terms == "none":
        choice = TermChoice(terms, ())
    elif terms == "auto":
        choice = choose_terms(_fit(robot, replace(settings, starts=1), data))
    else:
        choice = TermChoice(terms, (*own, *missing_terms(robot, listed_terms(terms))))
    return robot.with_terms(choice.sections), choice


def _require_measurements(data: object, validation: object) -> None:
    """Say what was expected of a caller whose types nobody checked."""
    for what, given in (("data", data), ("validation", validation)):
        if not isinstance(given, Measurements) and not (given is None and what == "validation"):
            raise InputError(
                f"{what}: expected Measurements, not {type(given).__name__}; make them with calib.read_measurements"
                " or calib.as_measurements"
            )


def _fit(
    robot: Robot,
    settings: Settings,
    data: Measurements,
    validation: Measurements | None = None,
    workers: Executor | None = None,
    progress: Progress | None = None,
) -> Fit:
    """Do steps 1 to 5 of the module docstring."""
    check_measurements(robot, data)
    problem = Problem(robot, data, settings.sigma)
    placed = _place(problem)
    start = problem.evaluate(placed)
    determined = require_identifiable(problem, start)  # before the solver, where `calib check` looks too
    solved = solve_from(problem, placed, settings, workers, progress)
    final = problem.evaluate(solved.robot)
    require_identifiable(problem, final)
    rows, scales, uncertainty = uncertainty_at(problem, final, solved, settings)
    return Fit(
        nominal=robot,
        placed=placed,
        robot=solved.robot,
        identification=ErrorSet(
            data,
            robot.instruments,
            start.residuals,
            final.residuals,
            solved.robot.singular_values(final.configurations),
        ),
        validation=None if validation is None else errors_on(placed, solved.robot, validation),
        configurations=final.configurations,
        unknowns=problem.unknowns,
        statistics=uncertainty,
        determination=determined,
        observability=_observability(problem, final, determined.free.rank),
        rows=rows,
        whitening=problem.whitening,
        scales=scales,
        message=solved.solution.message,
        seconds=float("nan"),
        convergence=convergence_at(problem, solved, rows, uncertainty.std),
        loss=settings.loss,
        weights=np.ones(rows.layout.n_readings) if solved.weights is None else solved.weights,
        sigma_given=settings.sigma,
        judge=judge,
        starts=solved.starts,
        seed=settings.seed,
    )


def uncertainty_at(
    problem: Problem, final: Evaluation, solved: Solved, settings: Settings
) -> tuple[Rows, Scales, Statistics]:
    """Return the rows at a minimum, what is assumed of their noise, and the uncertainty of the parameters.

    Args:
        problem: The problem.
        final: The evaluation at the minimum.
        solved: The minimum.
        settings: How it was found.

    Raises:
        NotIdentifiableError: No degrees of freedom are left.
    """
    rows = problem.rows(final, solved.groups)
    scales = problem.found_shared(final, solved.groups) if settings.loss == "none" else Scales.of(solved.groups)
    layout, unknowns = problem.whitening.layout, problem.unknowns
    factors = solved.factors or found_factors(
        rows.residuals, rows.jacobian, layout.group, len(layout.groups), rows.known
    )
    slowed = rows if factors.slope == 1.0 else rows.weighted(np.full(layout.n_readings, factors.slope))
    uncertainty = statistics(
        rows.jacobian,
        layout.group,
        slowed.known,
        factors,
        unknowns.scales,
        unknowns.has_prior,
        problem.noise_of_rows(final, scales),
        variance_by_sizes(slowed.known.root @ slowed.known.root.T, unknowns.family, rows.deviations),
    )
    return rows, scales, uncertainty


def _observability(problem: Problem, final: Evaluation, rank: int) -> dict[str, float]:
    """O1 to O5 of the scaled Jacobian of readings in SI units, as measured: of metres, where only positions are."""
    units = 1.0 / np.array([group.typical if group.stated else 1.0 for group in problem.whitening.groups])
    own = problem.unknowns.only(problem.unknowns.family < 0)  # of families, priors decide what counts
    rows = problem.whitening.rows(final.observed, units, own, own.deviations(final.robot.values))
    factor = rows.factor[:, :-1]
    return observability(np.linalg.svd(factor, compute_uv=False)[:rank], len(problem.data))


def _place(problem: Problem) -> Robot:
    """Return the nominal robot with unknown frames and targets placed by registration alone.

    A target that is expected somewhere stays near, as far as the noise of these residuals lets it: the nominal robot's
    own errors are part of that noise, so that it is found, whatever is stated for the sensor.
    """
    robot = problem.robot
    places = problem.unknowns.only(problem.unknowns.placement)
    if not len(places):
        return robot
    registered = register(robot, problem.data)
    if not np.any(places.has_prior) and _is_best_placed(problem, registered, places):
        return registered
    first = problem.evaluate(registered)
    placed, solution = registered, None
    groups = _as_found(problem, first, problem.whitening.start(first.residuals))
    for _ in range(_NOISE_ROUNDS):
        placed, solution = problem.solve(placed, groups, places, tolerance=_PLACED)
        again = _as_found(problem, problem.evaluate(placed), groups)
        if not np.any(places.has_prior) or np.all(np.abs(again / groups - 1.0) <= _NOISE_STANDS):
            break
        groups = again
    if solution is None or not solution.converged:
        raise NotConvergedError(
            "placing the base and the targets did not converge; check units and axes of the measurements"
        )
    return placed


def _as_found(problem: Problem, evaluation: Evaluation, groups: FloatArray) -> FloatArray:
    """Scales of all groups, stated or not, as the residuals of placing are."""
    flat, group = problem.whitening.flatten(evaluation.residuals), problem.whitening.layout.group
    places = problem.unknowns.only(problem.unknowns.placement)
    result = groups.copy()
    for g in range(len(result)):
        rows = group == g
        left = max(int(np.sum(rows)) - len(places), 1)
        result[g] = np.sqrt(float(flat[rows] @ flat[rows]) / left) + EXACT
    return result


def _is_best_placed(problem: Problem, robot: Robot, places: Unknowns) -> bool:
    """Whether no other place of base and targets promises errors that are smaller by more than `_PLACED`."""
    evaluation = problem.evaluate(robot)
    rows = problem.rows(evaluation, problem.whitening.start(evaluation.residuals), places)
    explained = np.linalg.qr(rows.jacobian)[0].T @ rows.residuals
    return bool(explained @ explained <= _PLACED * (rows.residuals @ rows.residuals))


def solve_from(
    problem: Problem,
    placed: Robot,
    settings: Settings,
    workers: Executor | None = None,
    progress: Progress | None = None,
) -> Solved:
    """Solve with the stated noise or find it; from several starts and with a robust loss, if asked for.

    Args:
        problem: The problem.
        placed: Where to begin.
        settings: How.
        workers: Who does the other starts; this process if not given.
        progress: Told after each of them.

    Raises:
        NotConvergedError: The noise cannot be found.
    """
    exact = TOLERANCE if settings.loss == "none" else _LOOSE  # a robust loss goes on from there
    plain = settings.loss == "none"
    solved = _solve_with_offsets(problem, placed) if plain else _solve_with_noise(problem, placed, exact)
    if settings.starts > 1:
        first = (solved.robot, solved.solution)
        tried = explore(problem, placed, first, solved.groups, settings.starts, settings.seed, workers, progress)
        best = tried.minima[0]
        if best.solution is not solved.solution:  # the noise that was found belongs to the minimum left behind
            robot = best.robot
            solved = _solve_with_offsets(problem, robot) if plain else _solve_with_noise(problem, robot, exact)
        solved = replace(solved, starts=tried)
    if settings.loss == "none":
        return solved
    robust = solve_robust(problem, solved.robot, settings.loss, solved.groups)
    return Solved(
        robust.robot, robust.groups, robust.solution, robust.weights, robust.factors, robust.settled, solved.starts
    )


def _solve_with_offsets(problem: Problem, start: Robot) -> Solved:
    """Solve; where readings of an instrument share offsets, find these and weigh by them."""
    if not np.any(problem.whitening.tells_offsets):
        return _solve_with_noise(problem, start, TOLERANCE)
    solved = _solve_with_noise(problem, start, _LOOSE)
    for _ in range(_NOISE_ROUNDS):
        ratios = problem.found_ratios(problem.evaluate(solved.robot), solved.groups)
        stands = np.all(np.abs(ratios - problem.ratios) <= _RATIOS_STAND * (1.0 + problem.ratios))
        problem.weigh(ratios)
        solved = _solve_with_noise(problem, solved.robot, TOLERANCE if stands else _LOOSE)
        if stands:
            return solved
    raise NotConvergedError(_NO_NOISE)


def _solve_with_noise(problem: Problem, start: Robot, exact: float) -> Solved:
    """Solve with the stated noise; find what is not stated of it."""
    groups = problem.whitening.start(problem.evaluate(start).residuals)
    unstated = np.array([not group.stated for group in problem.whitening.groups])
    matters = np.any(problem.unknowns.has_prior) or len(unstated) > 1
    if (
        not (np.any(unstated) and matters) and not problem.unknowns.families
    ):  # without priors and with one instrument, the noise weighs nothing
        robot, solution = problem.solve(start, groups, tolerance=exact)
        return Solved(robot, groups, solution)
    robot, tolerance = start, _LOOSE
    for _ in range(_NOISE_ROUNDS):
        robot, solution = problem.solve(robot, groups, tolerance=tolerance)
        scales, sizes = problem.found_scales(problem.evaluate(robot), groups)
        counts = unstated & (scales > EXACT)
        change = float(np.max(np.abs(scales / groups - 1.0)[counts], initial=0.0))
        change = max(change, float(np.max(np.abs(sizes - 1.0), initial=0.0)) / _FAMILIES_STAND)
        if change <= _NOISE_STANDS and tolerance == exact:
            return Solved(robot, groups, solution)
        if change <= 10 * _NOISE_STANDS:
            tolerance = exact
        if change > _NOISE_STANDS:
            groups = scales
            problem.unknowns = problem.unknowns.rescaled(sizes)
    raise NotConvergedError(_NO_NOISE)


def convergence_at(problem: Problem, solved: Solved, rows: Rows, std: FloatArray) -> Convergence:
    """Judge the end of the iteration by its stopping rule and by the Gauss-Newton step that is left.

    Args:
        problem: The problem.
        solved: The minimum.
        rows: The rows there.
        std: Standard deviations of the free parameters, (n_free,) [m, rad].
    """
    weighted = rows if solved.weights is None else rows.weighted(solved.weights)
    pull = weighted.jacobian.T @ weighted.residuals + np.where(rows.has_prior, rows.deviations, 0.0)
    root = weighted.known.root
    left = np.abs(problem.unknowns.scales * (root @ (root.T @ pull))) / (std + _ROUNDING)
    largest = int(np.argmax(left))
    converged = solved.solution.converged and solved.settled and bool(left[largest] < _STEP_LEFT)
    return Convergence(
        converged, solved.solution.message, float(left[largest]), problem.unknowns.names[largest], solved.settled
    )


def errors_on(placed: Robot, calibrated: Robot, data: Measurements) -> ErrorSet:
    """Return errors on visits that were not used.

    Args:
        placed: The robot before calibration.
        calibrated: The robot after it.
        data: The visits.

    Raises:
        UnreachablePoseError: The robot before cannot be assembled at a visit.
        ComputationError: The robot after it cannot.
    """
    before, _ = _errors_of(placed, data)
    try:
        after, singular = _errors_of(calibrated, data)
    except UnreachablePoseError as error:
        raise ComputationError(f"with the parameters found, the robot cannot be assembled: {error}") from None
    return ErrorSet(data, placed.instruments, before, after, singular)


def _errors_of(robot: Robot, data: Measurements) -> tuple[dict[str, FloatArray], FloatArray]:
    configurations = robot.assemble(data.joints, labels=data.labels, context=data.conditions)
    observed = observe(robot, configurations, data.readings)
    return {name: one.residuals for name, one in observed.items()}, robot.singular_values(configurations)
