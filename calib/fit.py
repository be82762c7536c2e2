"""Identification: the parameter values that explain the measurements best.

Minimise, over u = (p - p_nominal) / s,

    sum over poses and axes  n_k (x_k(p) - measured_k)^2 / sigma^2   +   sum over parameters with a prior  u^2

with n_k the readings averaged at pose k. Signed components, never distances: a distance loses its sign and its zero
has no derivative. scipy's trust-region solver gets the exact Jacobian; a trial step that would open a loop is
answered with NaN, on which the solver shortens its step.

Order of work: (1) close every pose at nominal, or name those that cannot be; (2) where the measurement frame or the
target's place is not known, a closed-form rigid fit places them, refined alone: this is the honest state `before`;
(3) all free parameters together; (4) rank, statistics and error tables at the solution.

The noise sigma weighs measurements against priors. Where nobody states it, it is found by repeating step 3 with the
residuals' own sigma until that changes by less than one percent.

When it fails. Fewer coordinates than unknowns, or columns that the poses cannot tell apart and no prior holds, is a
`NotIdentifiableError` that names the parameters. No convergence, or a Gauss-Newton step left over that is not small
against the standard deviations, is a `NotConvergedError`.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from scipy.optimize import OptimizeResult

from calib.errors import DataError, NotConvergedError, NotIdentifiableError, UnreachablePoseError
from calib.identifiability import Rank, numerical_rank
from calib.jacobian import linearise
from calib.measurements import Measurements
from calib.mechanism import BoolArray, FloatArray
from calib.observability import observability
from calib.problem import TOLERANCE, Evaluation, Problem
from calib.registration import register
from calib.robot import Configurations, Robot, describe_open
from calib.statistics import Statistics, effective_parameters, statistics
from calib.threads import one_blas_thread
from calib.validation import error_table

_LOOSE = 1e-2  # the same, while the noise is still being found
_SIGMA_ROUNDS = 20


@dataclass(frozen=True, eq=False)
class ErrorSet:
    """Predicted minus measured positions of one set of poses.

    Attributes:
        data: The measurements.
        before, after: Errors before and after calibration, (n_poses, n_targets, 3) [m].
        singular_value: Each pose's distance to a singularity of the loops; infinite without loops, (n_poses,).
    """

    data: Measurements
    before: FloatArray
    after: FloatArray
    singular_value: FloatArray

    def table(self) -> dict[str, dict[str, object]]:
        """Return the error tables `before` and `after` [mm]."""
        return {"before": error_table(self.before.reshape(-1, 3)), "after": error_table(self.after.reshape(-1, 3))}


@dataclass(frozen=True, eq=False)
class Fit:
    """A finished identification.

    Attributes:
        nominal: The robot as described.
        placed: The robot `before`: nominal, with base and targets placed where these are not known.
        robot: The calibrated robot.
        identification: Errors on the poses that were used.
        validation: Errors on poses that were not used, if there were any.
        free: Which parameters were free, (n_parameters,).
        statistics: Uncertainty of the free ones.
        rank: Rank of the scaled Jacobian of the free parameters.
        rank_all: Rank of that of all parameters, held ones included.
        observability: O1 to O5 on scaled columns.
        jacobian: d(positions)/d(free parameters) at the solution, (n_poses, n_targets, 3, n_free).
        sigma_stated: Noise as stated [m], or None.
        message: What the solver said.
        seconds: Duration of the whole computation.
    """

    nominal: Robot
    placed: Robot
    robot: Robot
    identification: ErrorSet
    validation: ErrorSet | None
    free: BoolArray
    statistics: Statistics
    rank: Rank
    rank_all: Rank
    observability: dict[str, float]
    jacobian: FloatArray
    sigma_stated: float | None
    message: str
    seconds: float

    def report(self) -> str:
        """Return the result as text."""
        from calib.report_text import text_report

        return text_report(self)

    def save(self, folder: str) -> None:
        """Write the result to a folder; see `calib.results.save`."""
        from calib.results import save

        save(self, folder)


@one_blas_thread
def fit(robot: Robot, data: Measurements, *, validation: Measurements | None = None, sigma: float | None = None) -> Fit:
    """Calibrate a robot.

    Args:
        robot: The nominal robot.
        data: Measurements to identify with.
        validation: Measurements to judge the result with.
        sigma: Standard deviation of one reading per axis [m]; the description's if not given, found if that has none.

    Raises:
        UnreachablePoseError: A pose cannot be assembled.
        DataError: Too few measurements.
        NotIdentifiableError: The poses do not determine the free parameters.
        NotConvergedError: The solver did not converge.
    """
    started = time.perf_counter()
    stated = sigma if sigma is not None else robot.description.sigma
    if stated is not None and not (np.isfinite(stated) and stated > 0):
        raise DataError(f"sigma {stated:g} m: must be a positive number")
    free = robot.free
    _enough(robot, data, free)
    problem = Problem(robot, data, free)
    placed = _place(problem)
    calibrated, sigma_used, outcome = _solve_with_noise(problem, placed, stated)
    final = problem.evaluate(calibrated)
    scaled = problem.weighted(final.jacobian) * problem.scales
    rank = numerical_rank(scaled)
    _require_identifiable(problem, scaled)
    found = statistics(
        scaled, problem.weighted(final.errors[..., None])[:, 0], problem.scales, problem.has_prior, sigma_used
    )
    _require_converged(outcome, problem, final, scaled, calibrated, sigma_used, found)
    everything = numerical_rank(problem.weighted(final.all_columns) * np.array([p.sigma for p in robot.parameters]))
    before = problem.evaluate(placed)
    identification = ErrorSet(data, before.errors, final.errors, calibrated.singular_values(final.configurations))
    return Fit(
        robot,
        placed,
        calibrated,
        identification,
        _errors_on(placed, calibrated, validation),
        free,
        found,
        rank,
        everything,
        observability(rank.singular_values[: rank.rank], len(data)),
        final.jacobian,
        stated,
        str(outcome.message),
        time.perf_counter() - started,
    )


def _enough(robot: Robot, data: Measurements, free: BoolArray) -> None:
    unknown = int(sum(use and not p.prior for p, use in zip(robot.parameters, free, strict=True)))
    if not np.any(free):
        raise DataError(f"{robot.path}: every parameter is held; there is nothing to identify")
    rows = data.positions.size
    if rows <= unknown or len(data) < 3:
        needed = max(3, -(-(unknown + 1) // (rows // len(data))))
        raise DataError(
            f"{data.path}: {len(data)} poses give {rows} coordinates for {unknown} unknowns without a prior;"
            f" measure at least {needed} poses (several times that for a useful result)"
        )


def _place(problem: Problem) -> Robot:
    """Return the nominal robot with an unknown base and unknown targets placed by registration alone."""
    robot = problem.robot
    if not np.any(problem.moves):
        return robot
    placed, outcome = problem.solve(register(robot, problem.data), 1e-4, problem.moves, priors=False)  # any sigma does
    if outcome.status <= 0:
        raise NotConvergedError(
            "placing the base and the targets did not converge; check units and axes of the measurements"
        )
    return placed


def _solve_with_noise(problem: Problem, placed: Robot, stated: float | None) -> tuple[Robot, float, OptimizeResult]:
    """Solve with the stated noise; where none is stated, find it."""
    everything = np.ones(len(problem.scales), dtype=bool)
    first = problem.weighted(problem.evaluate(placed).errors[..., None])
    sigma, tolerance = stated or float(np.sqrt(np.mean(first**2))) + 1e-9, _LOOSE
    moves = problem.moves
    # registration alone may have put a loosely determined target far from where its prior says it is
    robot = problem.solve(placed, sigma, moves)[0] if np.any(moves & problem.has_prior) else placed
    if stated is not None:
        robot, outcome = problem.solve(robot, stated, everything)
        return robot, stated, outcome
    for _ in range(_SIGMA_ROUNDS):
        robot, outcome = problem.solve(robot, sigma, everything, tolerance=tolerance)
        evaluation = problem.evaluate(robot)
        scaled = problem.weighted(evaluation.jacobian) * problem.scales
        rows = problem.weighted(evaluation.errors[..., None])[:, 0]
        freedom = len(rows) - effective_parameters(scaled, problem.has_prior, sigma)
        found = float(np.sqrt(rows @ rows / max(freedom, 1.0)))
        settled = abs(found - sigma) <= 0.01 * sigma or found < 1e-9  # below a nanometre the data are exact
        if settled and tolerance == TOLERANCE:
            return robot, sigma, outcome
        if abs(found - sigma) <= 0.1 * sigma or found < 1e-9:
            tolerance = TOLERANCE
        sigma = sigma if found < 1e-9 else found
    raise NotConvergedError(
        "the noise of the measurements could not be found from the residuals; state it with --sigma-mm"
    )


def _require_identifiable(problem: Problem, scaled: FloatArray) -> None:
    """Raise unless data and priors together determine every free parameter."""
    stacked = np.vstack([scaled, np.eye(len(problem.has_prior))[problem.has_prior]])
    rank = numerical_rank(stacked)
    if rank.rank == rank.n_columns:
        return
    names = [parameter.name for parameter, use in zip(problem.robot.parameters, problem.free, strict=True) if use]
    null = np.linalg.svd(stacked)[2][rank.rank :]
    involved = [name for name, size in zip(names, np.max(np.abs(null), axis=0), strict=True) if size > 1e-3]
    raise NotIdentifiableError(
        f"the poses determine {rank.rank} of {rank.n_columns} free parameters; not separable:"
        f" {', '.join(involved[:12])}{', ...' if len(involved) > 12 else ''}; hold {rank.n_columns - rank.rank} of them"
        " (`held`), or measure other poses"
    )


def _require_converged(
    outcome: OptimizeResult,
    problem: Problem,
    final: Evaluation,
    scaled: FloatArray,
    calibrated: Robot,
    sigma: float,
    found: Statistics,
) -> None:
    """Raise unless the solver converged and the Gauss-Newton step left over is small against the uncertainty."""
    if outcome.status <= 0:
        raise NotConvergedError(
            f"the fit did not converge: {outcome.message} Largest residual left:"
            f" {1e3 * np.max(np.abs(final.errors)):.3g} mm; check units, joint order and signs"
        )
    weight = sigma**2 * problem.has_prior
    u = (calibrated.values[problem.free] - problem.nominal) / problem.scales
    gradient = scaled.T @ problem.weighted(final.errors[..., None])[:, 0] + weight * u
    step = problem.scales * np.linalg.solve(scaled.T @ scaled + np.diag(weight), gradient)
    left = np.abs(step) / (found.std + 1e-8)  # 10 nm and 10 nrad: below, rounding decides
    if not np.all(left < 0.05):
        name = [p.name for p, use in zip(problem.robot.parameters, problem.free, strict=True) if use][
            int(np.argmax(left))
        ]
        raise NotConvergedError(
            f"the fit stopped before its minimum: parameter '{name}' would still move by"
            f" {np.max(left):.2g} standard deviations; check units, joint order and signs"
        )


def _errors_on(placed: Robot, calibrated: Robot, data: Measurements | None) -> ErrorSet | None:
    if data is None:
        return None
    errors = []
    singular = np.full(len(data), np.inf)
    for robot in (placed, calibrated):
        closed = robot.close(data.joints)
        if not np.all(closed.ok):
            raise UnreachablePoseError(describe_open(robot, data.joints, closed, data.labels))
        configurations = Configurations(data.joints, closed.passive, closed.slope)
        singular = robot.singular_values(configurations)
        errors.append(linearise(robot, configurations).positions - data.positions)
    return ErrorSet(data, errors[0], errors[1], singular)
