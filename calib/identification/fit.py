"""Identification: the parameter values that explain the measurements best.

Minimise, over u = (p - p_nominal) / s,

    sum over poses and axes  n_k (x_k(p) - measured_k)^2 / sigma^2   +   sum over parameters with a prior  u^2

with n_k the readings averaged at pose k (`calib.identification.problem`), by `calib.numerics.least_squares`.

Order of work: (1) close every pose at nominal, or name those that cannot be; (2) where the measurement frame or the
target's place is not known, a closed-form rigid fit places them, refined alone: this is the honest state `before`;
(3) all free parameters together, from several starts if asked for; (4) with a robust loss, again with weights
(`calib.identification.robust`); (5) rank, statistics and error tables at the solution; (6) if asked for, outliers are
left out and all is done again, and poses are left out in turns for cross-validation.

The noise sigma weighs measurements against priors. Where nobody states it, it is found by repeating step 3 with the
residuals' own sigma until that changes by less than one percent.

When it fails. Fewer coordinates than unknowns, or columns that the poses cannot tell apart and no prior holds, is a
`NotIdentifiableError` that names the parameters. A fit that did not converge comes back with the verdict FAIL.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from calib.data.measurements import Measurements
from calib.errors import ComputationError, DataError, InputError, NotConvergedError, UnreachablePoseError
from calib.identification.exclusion import without_outliers
from calib.identification.fitted import Convergence, ErrorSet, Fit
from calib.identification.folds import cross_validate
from calib.identification.pose_checks import check_measurements, require_identifiable
from calib.identification.problem import Problem
from calib.identification.robust import solve_robust
from calib.identification.starts import Starts, explore
from calib.identification.suspects import likely_mistake
from calib.identification.systematic import joint_jacobian
from calib.linearisation.jacobian import linearise
from calib.linearisation.registration import register
from calib.model.mechanism import FloatArray
from calib.model.robot import Configurations, Robot, describe_open
from calib.numerics.least_squares import TOLERANCE, Solution
from calib.numerics.losses import Loss, checked_loss
from calib.numerics.observability import observability
from calib.numerics.statistics import EXACT, Noise, effective_parameters, found_noise, statistics
from calib.threads import one_blas_thread

__all__ = ["ErrorSet", "Fit", "fit"]

_LOOSE = 1e-2  # tolerance of the solver where another solve follows
_PLACED = 1e-6  # the same for the state before: its errors then hold to a millionth
_SIGMA_ROUNDS = 20
_STEP_LEFT = 0.05  # standard deviations that a converged fit may be away from its minimum
_ROUNDING = 1e-8  # 10 nm and 10 nrad: below, rounding decides about a step


@dataclass(frozen=True)
class _Settings:
    """How to fit.

    Attributes:
        stated: Noise of one reading per axis [m], or None.
        loss: Robust loss.
        starts: Number of starts.
        seed: Seed of the random steps.
    """

    stated: float | None
    loss: Loss
    starts: int
    seed: int


@dataclass(frozen=True, eq=False)
class _Solved:
    """A minimum, and what weighed its rows."""

    robot: Robot
    sigma: float
    solution: Solution
    weights: FloatArray | None = None
    noise: Noise | None = None
    settled: bool = True
    starts: Starts | None = None


@one_blas_thread
def fit(
    robot: Robot,
    data: Measurements,
    *,
    validation: Measurements | None = None,
    sigma: float | None = None,
    loss: str = "none",
    exclude_outliers: bool = False,
    starts: int = 1,
    folds: int = 0,
    seed: int = 0,
) -> Fit:
    """Calibrate a robot.

    Args:
        robot: The nominal robot.
        data: Measurements to identify with.
        validation: Measurements to judge the result with.
        sigma: Standard deviation of one reading per axis [m]; the description's if not given, found if that has none.
        loss: `none`, or a robust loss: `huber`, `cauchy`, `tukey` (see `calib.numerics.losses`).
        exclude_outliers: Leave outliers out and fit again; the result holds both fits.
        starts: Number of starting points, the nominal one and perturbed ones.
        folds: Number of folds for cross-validation by pose; 0 for none.
        seed: Seed of perturbed starts and folds.

    Raises:
        UnreachablePoseError: A pose cannot be assembled.
        DataError: Too few measurements, or measurements that are not finite.
        InputError: Unknown loss, numbers of starts or folds that make no sense, or data that are no measurements.
        NotIdentifiableError: The poses do not determine the free parameters.
        NotConvergedError: Base and targets cannot be placed, or the noise cannot be found.
    """
    started = time.perf_counter()
    _require_measurements(data, validation)
    stated = sigma if sigma is not None else robot.description.sigma
    if stated is not None and not (np.isfinite(stated) and stated > 0):
        raise DataError(f"sigma {stated:g} m: must be a positive number")
    if starts < 1:
        raise InputError(f"starts {starts}: must be 1 or more")
    if seed < 0:
        raise InputError(f"seed {seed}: must be zero or more")
    settings = _Settings(stated, checked_loss(loss), starts, seed)
    try:
        found = _fit(robot, data, validation, settings)
    except UnreachablePoseError as error:
        mistake = likely_mistake(robot, data)
        raise UnreachablePoseError(f"{error}{'; ' if mistake else ''}{mistake}") from None
    plain = replace(settings, starts=1)
    if exclude_outliers:
        tukey = replace(plain, loss="tukey")
        found = without_outliers(
            found,
            robust=lambda: _fit(robot, data, None, tukey),
            again=lambda kept: _fit(robot, kept, validation, settings),
        )
    if folds:
        used = found.identification.data
        found = replace(
            found, folds=cross_validate(used, folds, seed, lambda kept, held: _fit(robot, kept, held, plain))
        )
    return replace(found, seconds=time.perf_counter() - started)


def _require_measurements(data: object, validation: object) -> None:
    """Say what was expected of a caller whose types nobody checked."""
    for what, given in (("data", data), ("validation", validation)):
        if not isinstance(given, Measurements) and not (given is None and what == "validation"):
            raise InputError(
                f"{what}: expected Measurements, not {type(given).__name__}; make them with calib.read_measurements"
                " or calib.as_measurements"
            )


def _fit(robot: Robot, data: Measurements, validation: Measurements | None, settings: _Settings) -> Fit:
    """Do steps 1 to 5 of the module docstring."""
    free = robot.free
    check_measurements(robot, data, free)
    problem = Problem(robot, data, free)
    placed = _place(problem)
    start = problem.evaluate(placed)
    determined = require_identifiable(problem, start)  # before the solver, where `calib check` looks too
    solved = _solve(problem, placed, settings)
    final = problem.evaluate(solved.robot)
    rows = problem.weighted(final.errors[..., None])[:, 0]
    # everything below needs J^T J alone, which the small triangular factor of J has too
    factor = _factor(problem.weighted(final.jacobian) * problem.scales)
    require_identifiable(problem, final)
    singular_values = np.linalg.svd(factor, compute_uv=False)[: determined.free.rank]
    noise = solved.noise or found_noise(rows, effective_parameters(factor, problem.has_prior, solved.sigma))
    found = statistics(factor, noise, problem.scales, problem.has_prior, solved.sigma)
    return Fit(
        nominal=robot,
        placed=placed,
        robot=solved.robot,
        identification=ErrorSet(
            _told_from_motion(solved.robot, data, final.configurations),
            start.errors,
            final.errors,
            solved.robot.singular_values(final.configurations),
        ),
        validation=None if validation is None else _errors_on(placed, solved.robot, validation),
        configurations=final.configurations,
        free=free,
        statistics=found,
        determination=determined,
        observability=observability(singular_values, len(data)),
        jacobian=final.jacobian,
        sigma_stated=settings.stated,
        message=solved.solution.message,
        seconds=float("nan"),
        convergence=_convergence(problem, solved, final.jacobian, final.errors, found.std),
        sigma_used=solved.sigma,
        loss=settings.loss,
        weights=np.ones(final.errors.shape[:2]) if solved.weights is None else solved.weights,
        starts=solved.starts,
        seed=settings.seed,
    )


def _factor(rows: FloatArray) -> FloatArray:
    """Return the triangular factor of a tall matrix."""
    if len(rows) <= rows.shape[1]:
        return rows
    return np.asarray(np.linalg.qr(rows, mode="r"))


def _place(problem: Problem) -> Robot:
    """Return the nominal robot with an unknown base and unknown targets placed by registration alone."""
    robot = problem.robot
    if not np.any(problem.moves):
        return robot
    registered, any_sigma = register(robot, problem.data), 1e-4
    if _is_best_placed(problem, registered):
        return registered
    placed, solution = problem.solve(registered, any_sigma, problem.moves, priors=False, tolerance=_PLACED)
    if not solution.converged:
        raise NotConvergedError(
            "placing the base and the targets did not converge; check units and axes of the measurements"
        )
    return placed


def _is_best_placed(problem: Problem, robot: Robot) -> bool:
    """Whether no other place of base and targets promises errors that are smaller by more than `_PLACED`."""
    evaluation = problem.evaluate(robot)
    rows = problem.weighted(evaluation.errors[..., None])[:, 0]
    columns = problem.weighted(evaluation.jacobian[..., problem.moves]) * problem.scales[problem.moves]
    explained = np.linalg.qr(columns)[0].T @ rows
    return bool(explained @ explained <= _PLACED * (rows @ rows))


def _solve(problem: Problem, placed: Robot, settings: _Settings) -> _Solved:
    """Solve with the stated noise or find it; from several starts and with a robust loss, if asked for."""
    exact = TOLERANCE if settings.loss == "none" else _LOOSE  # a robust loss goes on from there
    solved = _solve_with_noise(problem, placed, settings.stated, exact)
    if settings.starts > 1:
        first = (solved.robot, solved.solution)
        tried = explore(problem, placed, first, solved.sigma, settings.starts, settings.seed)
        best = tried.minima[0]
        if best.solution is not solved.solution:  # the noise that was found belongs to the minimum left behind
            solved = _solve_with_noise(problem, best.robot, settings.stated, exact)
        solved = replace(solved, starts=tried)
    if settings.loss == "none":
        return solved
    robust = solve_robust(problem, solved.robot, settings.loss, settings.stated)
    return _Solved(
        robust.robot, robust.sigma, robust.solution, robust.weights, robust.noise, robust.settled, solved.starts
    )


def _solve_with_noise(problem: Problem, placed: Robot, stated: float | None, exact: float) -> _Solved:
    """Solve with the stated noise; where none is stated, find it."""
    everything = np.ones(len(problem.scales), dtype=bool)
    first = problem.weighted(problem.evaluate(placed).errors[..., None])
    sigma, tolerance = stated or float(np.sqrt(np.mean(first**2))) + 1e-9, _LOOSE
    moves = problem.moves
    # registration alone may have put a loosely determined target far from where its prior says it is
    robot = problem.solve(placed, sigma, moves, tolerance=_LOOSE)[0] if np.any(moves & problem.has_prior) else placed
    if stated is not None or not np.any(problem.has_prior):  # without priors, sigma weighs nothing
        robot, solution = problem.solve(robot, sigma, everything, tolerance=exact)
        return _Solved(robot, sigma, solution)
    for _ in range(_SIGMA_ROUNDS):
        robot, solution = problem.solve(robot, sigma, everything, tolerance=tolerance)
        evaluation = problem.evaluate(robot)
        factor = _factor(problem.weighted(evaluation.jacobian) * problem.scales)
        rows = problem.weighted(evaluation.errors[..., None])[:, 0]
        freedom = len(rows) - effective_parameters(factor, problem.has_prior, sigma)
        found = float(np.sqrt(rows @ rows / max(freedom, 1.0)))
        settled = abs(found - sigma) <= 0.01 * sigma or found < EXACT
        if settled and tolerance == exact:
            return _Solved(robot, sigma, solution)
        if abs(found - sigma) <= 0.1 * sigma or found < EXACT:
            tolerance = exact
        sigma = sigma if found < EXACT else found
    raise NotConvergedError(
        "the noise of the measurements could not be found from the residuals; state it with --sigma-mm"
    )


def _convergence(
    problem: Problem, solved: _Solved, jacobian: FloatArray, errors: FloatArray, std: FloatArray
) -> Convergence:
    """Judge the end of the iteration by its stopping rule and by the Gauss-Newton step that is left."""
    rows = problem.weighted(errors[..., None], solved.weights)[:, 0]
    scaled = problem.weighted(jacobian, solved.weights) * problem.scales
    prior = np.eye(len(problem.scales))[problem.has_prior]
    stacked = np.vstack([scaled, solved.sigma * prior])
    right = np.concatenate([rows, solved.sigma * (prior @ problem.scaled_values(solved.robot))])
    q, r = np.linalg.qr(stacked)
    left = np.abs(problem.scales * np.linalg.solve(r, q.T @ right)) / (std + _ROUNDING)
    largest = int(np.argmax(left))
    name = [p.name for p, use in zip(problem.robot.parameters, problem.free, strict=True) if use][largest]
    converged = solved.solution.converged and solved.settled and bool(left[largest] < _STEP_LEFT)
    return Convergence(converged, solved.solution.message, float(left[largest]), name, solved.settled)


def _errors_on(placed: Robot, calibrated: Robot, data: Measurements) -> ErrorSet:
    before, _, _ = _errors_of(placed, data)
    try:
        after, singular, configurations = _errors_of(calibrated, data)
    except UnreachablePoseError as error:
        raise ComputationError(f"with the parameters found, the robot cannot be assembled: {error}") from None
    return ErrorSet(_told_from_motion(calibrated, data, configurations), before, after, singular)


def _told_from_motion(robot: Robot, data: Measurements, configurations: Configurations) -> Measurements:
    """Return the measurements, the scatter of repeats told from what the robot moved between them."""
    return data.at_mean_joints(joint_jacobian(robot, configurations)) if data.reading_joints else data


def _errors_of(robot: Robot, data: Measurements) -> tuple[FloatArray, FloatArray, Configurations]:
    closed = robot.close(data.joints)
    if not np.all(closed.ok):
        raise UnreachablePoseError(describe_open(robot, data.joints, closed, data.labels))
    configurations = Configurations(data.joints, closed.passive, closed.slope)
    errors = linearise(robot, configurations).positions - data.positions
    return errors, robot.singular_values(configurations), configurations
