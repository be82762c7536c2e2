"""Fitting with a robust loss: least squares again and again, with weights from the residuals before.

Given weights, the problem is the one of `calib.problem`; given its solution, `calib.losses` gives new weights. The
alternation runs on the linear model around the present parameters, where a round costs next to nothing, until the
weights stand; then the true problem is solved with them, and so on until they stand there too.

Cauchy and Tukey have several minima. They start from Huber's solution, which on a linear model has one, and keep its
scale (the MM principle), so that the alternation cannot run away with a shrinking scale.

Reference: maronna2019, chapter 5.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from calib.errors import NotIdentifiableError
from calib.least_squares import Solution
from calib.losses import COORDINATES, Loss, noise, scale_of, weights
from calib.mechanism import FloatArray
from calib.problem import Evaluation, Problem
from calib.robot import Robot
from calib.statistics import Noise, effective_parameters

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
    stages: tuple[Loss, ...] = ("huber",) if loss == "huber" else ("huber", loss)
    for stage in stages:
        fixed = scale if stage != "huber" else None
        found: FloatArray = np.ones((len(problem.data), len(problem.robot.target_names)))
        settled = False
        for _ in range(_ROUNDS):
            evaluation = problem.evaluate(robot)
            new, scale = _linear_weights(_linear(problem, robot, evaluation), stage, stated, fixed)
            new = new.reshape(found.shape)
            settled = bool(np.max(np.abs(new - found)) < _WEIGHTS_STAND)
            found = new
            robot, solution = problem.solve(
                robot, stated or scale, np.ones(len(problem.scales), dtype=bool), weights=found
            )
            if settled:
                break
    final = _linear(problem, robot, problem.evaluate(robot))
    distances = _distances(final.residuals)
    sigma = stated or scale
    n_effective = effective_parameters(np.sqrt(np.mean(found)) * final.jacobian, problem.has_prior, sigma)
    return RobustFit(robot, solution, found, scale, noise(loss, distances, scale, n_effective), sigma, settled)


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


def _linear_weights(
    linear: _Linear, loss: Loss, stated: float | None, fixed_scale: float | None
) -> tuple[FloatArray, float]:
    """Alternate on the linear model; return weights (n_points,) and scale [m]."""
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
        new = weights(loss, distances / scale)
        settled = bool(np.max(np.abs(new - found)) < _WEIGHTS_STAND / 10)
        found = new
        step = _step(linear, found, stated or scale)
        if settled:
            break
    return found, scale


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
