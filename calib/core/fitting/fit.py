"""Identification: the parameter values that explain the measurements best.

Minimise, over u = (p - p_nominal) / s,

    sum over visits  r^T V^-1 r   +   sum over parameters with a prior  u^2

with r the residuals of all readings of a visit and V the covariance of their noise (`calib.core.rows.rows`), by
`calib.core.numerics.least_squares`.

Order of work: (1) close every pose at nominal, or name those that cannot be; (2) place unknown measurement frames or
targets alone, near their expected places if a sigma says so: this is the honest state `before`; (3) fit all free
parameters together, with unstated noise, from several starts if requested (`calib.core.fitting.solving`); (4) with a
robust loss, fit again with weights (`calib.core.fitting.robust`); (5) compute rank, statistics and error tables at the
solution, and place what only validation poses show. `calib.core.calibrating.calibrate` describes the work around one
fit (choice of joint terms, outliers, cross-validation).

When it fails. Fewer coordinates than unknowns, or columns that the poses cannot distinguish and no prior holds, raise a
`NotIdentifiableError` that names the parameters. A fit that did not converge is returned, and says so.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import ComputationError, UnreachablePoseError
from calib.core.base.threads import one_blas_thread
from calib.core.base.workers import Steps
from calib.core.data.measurements import Measurements
from calib.core.fitting.error_sets import ErrorSet
from calib.core.fitting.fitted import Fit
from calib.core.fitting.pose_checks import check_measurements, require_identifiable
from calib.core.fitting.problem import Evaluation, Problem
from calib.core.fitting.robust import RobustSolution
from calib.core.fitting.settings import Settings
from calib.core.fitting.solving import convergence_at, place, reset_unseen, solve_from, uncertainty_at
from calib.core.robots.configurations import Configurations
from calib.core.robots.loops import are_within_limits
from calib.core.robots.robot import Robot
from calib.core.rows.determination import Determination
from calib.core.rows.observed import observe


@dataclass(frozen=True, eq=False)
class WarmStart:
    """Start values from a fit for other fits of its visits, or of a part of them.

    Attributes:
        joints: Visits, (n, n_actuated) [m or rad].
        passive: Passive joints that close them, (n, n_passive) [m or rad].
        free_alone: Whether ranks of held parameters are not used.
    """

    joints: FloatArray | None = None
    passive: FloatArray | None = None
    free_alone: bool = False

    @staticmethod
    def from_fit(fit: Fit) -> WarmStart:
        """Return the start values from this fit."""
        return WarmStart(fit.identification.data.joints, fit.configurations.passive)

    def passive_at(self, q: FloatArray) -> FloatArray | None:
        """Passive joints near those of visits q (n, n_actuated), (n, n_passive); NaN where unknown, None if all are."""
        if self.joints is None or self.passive is None or self.passive.shape[1] == 0:
            return None
        place = {row.tobytes(): k for k, row in enumerate(self.joints)}
        rows = np.array([place.get(row.tobytes(), -1) for row in q], dtype=np.intp)
        return np.where(rows[:, None] >= 0, self.passive[rows], np.nan)


@dataclass(frozen=True, eq=False)
class Minimum:
    """The end of the iteration of a fit, before its statistics.

    Attributes:
        validation_only: Free parameters of places that only validation shows.
        start: Evaluation with base and targets placed.
        determined: Determination by the measurements at the start.
    """

    robot: Robot
    validation_only: tuple[str, ...]
    start: Evaluation
    determined: Determination
    solved: RobustSolution


@one_blas_thread
def fit_data(
    robot: Robot,
    settings: Settings,
    data: Measurements,
    validation: Measurements | None = None,
    workers: Executor | None = None,
    steps: Steps | None = None,
    nearby: WarmStart | None = None,
) -> Fit:
    """Fit a robot to measurements, once.

    Args:
        settings: Options; the caller treats outliers, folds and the choice of terms.
        validation: Measurements to validate the result with, or None.
        workers: Workers for fits from other starts; this process if not given.
        nearby: Start values from another fit of these visits.

    Raises:
        UnreachablePoseError, DataError, NotIdentifiableError, NotConvergedError: See
            `calib.core.calibrating.calibrate.calibrate`.
    """
    minimum = minimum_of(robot, settings, data, validation, workers, steps, nearby)
    return fit_at(minimum, settings, validation, steps)


def minimum_of(
    robot: Robot,
    settings: Settings,
    data: Measurements,
    validation: Measurements | None = None,
    workers: Executor | None = None,
    steps: Steps | None = None,
    nearby: WarmStart | None = None,
) -> Minimum:
    """Return the minimum of a fit; arguments as in `fit_data`."""
    steps = steps or Steps()
    later = unseen(robot, data, validation)
    seen = robot.fix(*later) if later else robot
    check_measurements(seen, data)
    nearby = nearby or WarmStart()
    problem = Problem.from_data(seen, data, settings.sigma, nearby.passive_at(data.joints))
    problem = replace(problem, free_alone=nearby.free_alone)
    start = place(problem)
    steps.advance()
    begin = reset_unseen(problem, start)
    determined = require_identifiable(problem, begin, alone=nearby.free_alone)  # before the solver
    solved = solve_from(problem, begin, settings, workers, steps.advance)
    end = solved.evaluation
    if not np.all(are_within_limits(end.robot.mechanism, end.configurations.passive)):  # on its way it may exceed them
        solved = solve_from(replace(problem, limits=True), begin, settings, workers, steps.advance)
    steps.advance()
    require_identifiable(problem, solved.evaluation, alone=True)
    return Minimum(robot, later, start, determined, solved)


def fit_at(
    minimum: Minimum,
    settings: Settings,
    validation: Measurements | None = None,
    steps: Steps | None = None,
) -> Fit:
    """Return the fit that ends at a minimum; see `fit_data`."""
    robot, later, start, solved = minimum.robot, minimum.validation_only, minimum.start, minimum.solved
    problem, final = solved.problem, solved.evaluation
    rows, scales, uncertainty = uncertainty_at(solved)
    placed, calibrated = start.robot, final.robot
    if validation is not None and later:
        placed, calibrated = (place_from_data(validation, state.free(*later), later) for state in (placed, calibrated))
    fit = Fit(
        nominal=robot,
        placed=placed,
        robot=calibrated,
        identification=ErrorSet(
            problem.data,
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
        determination=minimum.determined,
        rows=rows,
        joint_derivative=final.joint_derivative,
        whitening=problem.whitening,
        scales=scales,
        seconds=float("nan"),
        convergence=convergence_at(solved, rows, uncertainty.std),
        loss=settings.loss,
        weights=np.ones(rows.layout.n_readings) if solved.weights is None else solved.weights,
        sigma_given=settings.sigma,
        starts=solved.starts,
        seed=settings.seed,
        placed_later=later,
    )
    (steps or Steps()).advance()
    return fit


def fit_of_a_part(fit: Fit, settings: Settings) -> Callable[[Measurements, Measurements | None], Fit]:
    """Return a function that fits a part of the measurements of a fit and predicts the rest, from one start."""
    return partial(fit_data, fit.nominal, replace(settings, starts=1), nearby=WarmStart.from_fit(fit))


def unseen(robot: Robot, data: Measurements, later: Measurements | None) -> tuple[str, ...]:
    """Return the free parameters of places that the readings of `later` depend on, and those of `data` do not.

    Such a place (a tool mounted anew) carries no information about the robot, so the later readings alone place it,
    before and after calibration. With few poses in a small part of joint space it can absorb errors of the robot.
    """
    if later is None:
        return ()
    known, new = (set[str]().union(*reading_origins(robot, part)) for part in (data, later))
    return free_places(robot, new - known)


def free_places(robot: Robot, origins: set[str]) -> tuple[str, ...]:
    """Return the free parameters of the places among some origins."""
    free = zip(robot.parameters, robot.is_free, strict=True)
    return tuple(p.name for p, is_free in free if p.placement and is_free and p.name.rpartition(".")[0] in origins)


def place_from_data(later: Measurements, robot: Robot, names: tuple[str, ...]) -> Robot:
    """Return a robot with some places determined by measurements alone; only free parameters of the places change.

    Raises:
        NotConvergedError: The places cannot be found.
        UnreachablePoseError: A pose cannot be assembled.
    """
    others = [p.name for p in robot.parameters if p.name not in names]
    alone = robot.fix(*others)
    return robot.with_parameters(place(Problem.from_data(alone, later)).robot.values)


def reading_origins(robot: Robot, data: Measurements) -> set[tuple[str, str]]:
    """Return the names of the origins at both ends of all readings: where they are read from, and what they show."""
    names, origins = ("", *robot.mechanism.origin_names), set[tuple[str, str]]()
    for name, readings in data.readings.items():
        pairs = robot.pairs[name]  # none for readings of joints
        origins |= {(names[pairs[k].a], names[pairs[k].b]) for k in set(readings.pairs.tolist()) if pairs}
    return origins


def errors_on(placed: Robot, calibrated: Robot, data: Measurements) -> ErrorSet:
    """Return errors on visits that were not used.

    Raises:
        UnreachablePoseError: The robot before calibration cannot be assembled at a visit.
        ComputationError: The robot after calibration cannot be assembled.
    """
    before, closed = _errors_of(placed, data)
    try:
        after, configurations = _errors_of(calibrated, data, closed.passive)
    except UnreachablePoseError as error:
        raise ComputationError(f"with the parameters found, the robot cannot be assembled: {error}") from None
    return ErrorSet(
        data, placed.instruments, before, after, calibrated.singular_values(configurations), configurations.passive
    )


def _errors_of(
    robot: Robot, data: Measurements, near: FloatArray | None = None
) -> tuple[dict[str, FloatArray], Configurations]:
    configurations = robot.assemble(data.joints, near, data.labels, data.conditions)
    observed = observe(robot, configurations, data.readings, derivatives=False)
    return {name: block.residuals for name, block in observed.items()}, configurations
