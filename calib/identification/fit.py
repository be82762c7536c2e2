"""Identification: the parameter values that explain the measurements best.

Minimise, over u = (p - p_nominal) / s,

    sum over visits  r^T V^-1 r   +   sum over parameters with a prior  u^2

with r the residuals of all readings of a visit and V the covariance of their noise (`calib.linearisation.rows`), by
`calib.numerics.least_squares`.

Order of work: (1) close every pose at nominal, or name those that cannot be; (2) where measurement frames or targets
are not known, they are placed alone, near where they are expected if a sigma says so: this is the honest state
`before`; (3) all free parameters together, with the noise that nobody states, from several starts if asked for
(`calib.identification.solving`); (4) with a robust loss, again with weights (`calib.identification.robust`); (5)
rank, statistics and error tables at the solution, places that only validation poses show placed by these; (6) if
asked for, outliers are left out and all is done again, and poses are left out in turns for cross-validation; also
where noise is so far above its statement that nothing else can prove the result.

When it fails. Fewer coordinates than unknowns, or columns that the poses cannot tell apart and no prior holds, is a
`NotIdentifiableError` that names the parameters. A fit that did not converge comes back with the verdict FAIL.
"""

from __future__ import annotations

import time
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import replace
from functools import partial

import numpy as np

from calib.arrays import FloatArray
from calib.data.measurements import Measurements
from calib.errors import CalibrationError, ComputationError, InputError, UnreachablePoseError
from calib.identification.candidate_terms import TermChoice, missing_terms
from calib.identification.errors_found import ErrorSet
from calib.identification.fitted import Fit
from calib.identification.pose_checks import check_measurements, likely_mistake, require_identifiable
from calib.identification.problem import Evaluation, Problem
from calib.identification.robust import without_outliers
from calib.identification.rules_noise import unproven
from calib.identification.settings import Settings
from calib.identification.solving import convergence_at, place, seen_from, solve_from, uncertainty_at
from calib.identification.term_choice import choose_terms
from calib.identification.unseen_places import placed_by, unseen
from calib.identification.validation import cross_validate, n_folds
from calib.identification.verdict import judge
from calib.joint_terms.terms import listed_terms
from calib.linearisation.observed import observe
from calib.model.robot import Configurations, Robot
from calib.numerics.observability import observability
from calib.threads import one_blas_thread
from calib.workers import Progress, Steps, Workers

PROVING = 5
"""Folds where nobody asked for any, and only poses left out can prove the result."""
_OF_ONE_FIT = 3  # steps that are told: base and targets placed, the minimum found, the result judged


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
        progress: Told after each step how many are done, and of how many that are known by then. Steps are: base and
            targets placed, the minimum found, its uncertainty and errors known; the choice of terms, with a fit of its
            own; each further start; each fold; each fit without outliers.

    Raises:
        UnreachablePoseError: A pose cannot be assembled.
        DataError: Too few measurements, or measurements that are not finite.
        InputError: An unknown term, a number of folds that makes no sense, or data that are no measurements.
        NotIdentifiableError: The poses do not determine the free parameters.
        NotConvergedError: Base and targets cannot be placed, or the noise cannot be found.
    """
    started = time.perf_counter()
    _require_measurements(data, validation)
    with Workers(executor, max(settings.starts - 1, n_folds(data, settings.folds))) as workers:
        fit = _identified(robot, data, validation, settings, workers, Steps(progress))
    return replace(fit, seconds=time.perf_counter() - started)


def _identified(
    robot: Robot,
    data: Measurements,
    validation: Measurements | None,
    settings: Settings,
    workers: Executor | None,
    steps: Steps,
) -> Fit:
    """Do all steps of the module docstring."""
    of_each = _OF_ONE_FIT + settings.starts - 1
    steps.expect(of_each + n_folds(data, settings.folds) + (_OF_ONE_FIT + 1) * (settings.terms == "auto"))
    try:
        robot, choice = _with_terms(robot, data, settings, steps)
        fit = fit_data(robot, settings, data, validation, workers, steps)
    except (UnreachablePoseError, ComputationError) as error:
        mistake = likely_mistake(robot, data)
        raise type(error)(f"{error}{'; ' if mistake else ''}{mistake}") from None
    plain = replace(settings, starts=1)
    if settings.exclude_outliers:

        def fit_again(kept: Measurements, how: Settings) -> Fit:
            steps.expect(_OF_ONE_FIT + how.starts - 1)
            return fit_data(robot, how, kept, validation, workers, steps)

        fit = without_outliers(
            fit,
            robust=lambda: fit_again(data, replace(plain, loss="tukey")),
            again=lambda kept: fit_again(kept, settings),
        )
    fold = partial(fit_data, robot, plain)
    leave_out = partial(cross_validate, fit.identification.data, seed=settings.seed, fit=fold, executor=workers)
    if settings.folds:
        fit = replace(fit, folds=leave_out(settings.folds, progress=steps.done))
    elif unproven(fit):
        steps.expect(PROVING)
        with suppress(CalibrationError):  # too few poses to leave some out: then nothing is proven
            fit = replace(fit, folds=leave_out(PROVING, progress=steps.done))
    return replace(fit, terms=choice)


def _with_terms(robot: Robot, data: Measurements, settings: Settings, steps: Steps) -> tuple[Robot, TermChoice | None]:
    """The robot with the joint terms that were asked for."""
    own, terms = robot.description.terms, settings.terms
    if terms is None:
        return robot, None
    if terms == "none":
        choice = TermChoice(terms, ())
    elif terms == "auto":
        choice = choose_terms(fit_data(robot, replace(settings, starts=1), data, steps=steps))
        steps.done()
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


def fit_data(
    robot: Robot,
    settings: Settings,
    data: Measurements,
    validation: Measurements | None = None,
    workers: Executor | None = None,
    steps: Steps | None = None,
) -> Fit:
    """Do steps 1 to 5 of the module docstring.

    Args:
        robot: The nominal robot, with the joint terms that it shall have.
        settings: How; outliers, folds and the choice of terms are the caller's.
        data: Measurements to identify with.
        validation: Measurements to judge the result with, or None.
        workers: Who does the fits of other starts; this process if not given.
        steps: Told of each step that is done; of nobody if not given.

    Raises:
        UnreachablePoseError, DataError, NotIdentifiableError, NotConvergedError: See `identify`.
    """
    steps = steps or Steps()
    later = () if validation is None else unseen(robot, data, validation)
    seen = robot.hold(*later) if later else robot
    check_measurements(seen, data)
    problem = Problem(seen, data, settings.sigma)
    placed = place(problem)
    start = problem.evaluate(placed)
    steps.done()
    begin = seen_from(problem, placed)
    determined = require_identifiable(problem, problem.evaluate(begin))  # before the solver, as `calib check` does
    solved = solve_from(problem, begin, settings, workers, steps.done)
    steps.done()
    final = problem.evaluate(solved.robot)
    require_identifiable(problem, final)
    rows, scales, uncertainty = uncertainty_at(problem, final, solved, settings)
    calibrated = solved.robot
    if validation is not None and later:
        placed, calibrated = (placed_by(validation, one.free(*later), later) for one in (placed, calibrated))
    fit = Fit(
        nominal=robot,
        placed=placed,
        robot=calibrated,
        identification=ErrorSet(
            data,
            robot.instruments,
            start.residuals,
            final.residuals,
            calibrated.singular_values(final.configurations),
            final.configurations.passive,
        ),
        validation=None if validation is None else errors_on(placed, calibrated, validation),
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
        placed_later=later,
    )
    steps.done()
    return fit


def _observability(problem: Problem, final: Evaluation, rank: int) -> dict[str, float]:
    """O1 to O5 of the scaled Jacobian of readings in SI units, as measured: of metres, where only positions are."""
    units = 1.0 / np.array([group.typical if group.stated else 1.0 for group in problem.whitening.groups])
    own = problem.unknowns.only(problem.unknowns.family < 0)  # of families, priors decide what counts
    rows = problem.whitening.rows(final.observed, units, own, own.deviations(final.robot.values))
    factor = rows.factor[:, :-1]
    return observability(np.linalg.svd(factor, compute_uv=False)[:rank], len(problem.data))


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
        after, found = _errors_of(calibrated, data)
    except UnreachablePoseError as error:
        raise ComputationError(f"with the parameters found, the robot cannot be assembled: {error}") from None
    return ErrorSet(data, placed.instruments, before, after, calibrated.singular_values(found), found.passive)


def _errors_of(robot: Robot, data: Measurements) -> tuple[dict[str, FloatArray], Configurations]:
    configurations = robot.assemble(data.joints, labels=data.labels, context=data.conditions)
    observed = observe(robot, configurations, data.readings)
    return {name: one.residuals for name, one in observed.items()}, configurations
