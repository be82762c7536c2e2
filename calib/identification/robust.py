"""Fitting with a robust loss: least squares again and again, with weights from the residuals before.

Given weights, the problem is the one of `calib.identification.problem`; given its solution, `calib.numerics.losses`
gives new weights. The alternation runs on the linear model around the present parameters, where a round costs next to
nothing, until the weights stand; then the parameters go where the linear model says, and so on until the weights stand
there too. Last, the true problem is solved with these weights.

Cauchy and Tukey have several minima. They start from Huber's solution, which on a linear model has one, and keep its
scale (the MM principle), so that the alternation cannot run away with a shrinking scale.

Reference: maronna2019, chapter 5.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from calib.errors import ComputationError, NotIdentifiableError
from calib.identification.problem import Evaluation, Problem
from calib.model.mechanism import FloatArray
from calib.model.robot import Robot
from calib.numerics.least_squares import Solution
from calib.numerics.losses import COORDINATES, Loss, noise, scale_of, weights
from calib.numerics.statistics import Noise, effective_parameters

_ROUNDS = 20
_LINEAR_ROUNDS = 200
_WEIGHTS_STAND = 1e-4
_SMALLEST_SCALE = 1e-8  # below ten nanometres a residual is rounding [m]
_TOO_FEW_LEFT = (
    "the poses that the robust loss still believes do not determine the parameters: too many measurements disagree with"
    " each other; check them, or fit with --loss none"
)


@dataclass(frozen=True, eq=False)
class RobustFit:
    """The end of the alternation.

    Attributes:
        robot: The solution.
        solution: What the solver said last.
        weights: Weight of each point, (n_poses, n_targets).
        scale: Scale of the residuals [m].
        noise: What they say about the noise.
        sigma: Noise that weighed data against priors [m].
        settled: Whether the weights stand.
    """

    robot: Robot
    solution: Solution
    weights: FloatArray
    scale: float
    noise: Noise
    sigma: float
    settled: bool


@dataclass(frozen=True, eq=False)
class _Linear:
    """The problem around some parameters: rows J u + r, and the priors' u."""

    jacobian: FloatArray
    residuals: FloatArray
    values: FloatArray
    prior: FloatArray


def solve_robust(problem: Problem, start: Robot, loss: Loss, stated: float | None) -> RobustFit:
    """Minimise with a robust loss.

    Args:
        problem: The problem; identifiable from its data and priors.
        start: The least-squares solution.
        loss: Not `none`.
        stated: Noise of one reading per axis [m] if it is stated; else the scale takes its place against priors.

    Raises:
        NotIdentifiableError: What the loss leaves of the data does not determine the parameters.
    """
    robot, scale = start, float("nan")
    everything = np.ones(len(problem.scales), dtype=bool)
    stages: tuple[Loss, ...] = ("huber",) if loss == "huber" else ("huber", loss)
    for stage in stages:
        fixed = scale if stage != "huber" else None
        found: FloatArray = np.ones((len(problem.data), len(problem.robot.target_names)))
        settled = False
        for _ in range(_ROUNDS):
            linear = _linear(problem, robot, problem.evaluate(robot))
            weights_now, scale, step = _linear_solution(linear, stage, stated, fixed)
            settled = bool(np.max(np.abs(weights_now - found.ravel())) < _WEIGHTS_STAND)
            found = weights_now.reshape(found.shape)
            if settled:
                break
            stepped = _stepped(problem, robot, linear, step, found, stated or scale)
            robot = stepped or problem.solve(robot, stated or scale, everything, weights=found)[0]
    sigma = stated or scale
    robot, solution = problem.solve(robot, sigma, everything, weights=found)
    final = _linear(problem, robot, problem.evaluate(robot))
    n_effective = effective_parameters(np.sqrt(np.mean(found)) * final.jacobian, problem.has_prior, sigma)
    residual_noise = noise(loss, _distances(final.residuals), scale, n_effective)
    return RobustFit(robot, solution, found, scale, residual_noise, sigma, settled)


def _stepped(
    problem: Problem, robot: Robot, linear: _Linear, step: FloatArray, found: FloatArray, sigma: float
) -> Robot | None:
    """Return the robot one Gauss-Newton step on; None if that lowers nothing."""
    everything = np.ones(len(step), dtype=bool)
    further = problem.with_values(robot, linear.values + step, everything)
    try:
        reached = _linear(problem, further, problem.evaluate(further))
    except ComputationError:
        return None
    root = np.repeat(np.sqrt(found.ravel()), COORDINATES)

    def cost(at: _Linear) -> float:
        return float(np.sum((root * at.residuals) ** 2) + np.sum((sigma * (at.prior @ at.values)) ** 2))

    return further if cost(reached) < cost(linear) else None


def _linear(problem: Problem, robot: Robot, evaluation: Evaluation) -> _Linear:
    return _Linear(
        problem.weighted(evaluation.jacobian) * problem.scales,
        problem.weighted(evaluation.errors[..., None])[:, 0],
        problem.scaled_values(robot),
        np.eye(len(problem.scales))[problem.has_prior],
    )


def _distances(residuals: FloatArray) -> FloatArray:
    result: FloatArray = np.linalg.norm(residuals.reshape(-1, COORDINATES), axis=1)
    return result


def _linear_solution(
    linear: _Linear, loss: Loss, stated: float | None, fixed_scale: float | None
) -> tuple[FloatArray, float, FloatArray]:
    """Alternate on the linear model; return weights (n_points,), scale [m] and the step to its solution (n_free,)."""
    has_prior = np.any(linear.prior != 0, axis=0)
    found: FloatArray = np.ones(len(linear.residuals) // COORDINATES)
    step: FloatArray = np.zeros(linear.jacobian.shape[1])
    scale = fixed_scale or 0.0
    for _ in range(_LINEAR_ROUNDS):
        distances = _distances(linear.residuals + linear.jacobian @ step)
        if fixed_scale is None:
            assumed = stated or max(scale_of(distances, 0.0), _SMALLEST_SCALE)
            n_effective = effective_parameters(linear.jacobian, has_prior, assumed)
            scale = max(scale_of(distances, n_effective), _SMALLEST_SCALE)
        weights_now = weights(loss, distances / scale)
        settled = bool(np.max(np.abs(weights_now - found)) < _WEIGHTS_STAND / 10)
        found = weights_now
        step = _step(linear, found, stated or scale)
        if settled:
            break
    return found, scale, step


def _step(linear: _Linear, found: FloatArray, sigma: float) -> FloatArray:
    """Solve the weighted linear problem."""
    root = np.repeat(np.sqrt(found), COORDINATES)
    rows = np.vstack([root[:, None] * linear.jacobian, sigma * linear.prior])
    right = np.concatenate([root * linear.residuals, sigma * (linear.prior @ linear.values)])
    if len(rows) < rows.shape[1]:
        raise NotIdentifiableError(_TOO_FEW_LEFT)
    q, triangle = np.linalg.qr(rows)
    diagonal = np.abs(np.diag(triangle))
    if np.min(diagonal) <= 1e-12 * np.max(diagonal):
        raise NotIdentifiableError(_TOO_FEW_LEFT)
    step: FloatArray = -solve_triangular(triangle, q.T @ right)
    return step
