"""Other minima: the same fit again from perturbed starting points.

Least squares finds the minimum in whose valley it starts. The first start has base and targets placed, and all other
parameters nominal. Each further start moves every free parameter from there by a normal random step of one sigma. Where
the loops cannot close, the step is halved, up to five times. Two fits have found the same minimum if their predictions
differ by less than a tenth of their residuals. The first of them is kept, because a later one may describe the same
robot with an angle that is a turn larger.

When it fails. Not finding another minimum is no proof that there is none.
"""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import ComputationError
from calib.core.base.threads import one_blas_thread
from calib.core.base.workers import Progress, results_in_order
from calib.core.fitting.problem import Evaluation, Problem
from calib.core.numerics.least_squares import LeastSquaresSolution
from calib.core.robots.robot import Robot

_HALVINGS = 5
_SAME = 0.1  # one minimum: predictions differ by less than this part of the smaller residuals (root mean square)
_ROUNDING = 1e-7  # residuals below this are rounding [m]


@dataclass(frozen=True, eq=False)
class StartMinimum:
    """A minimum that starts led to.

    Attributes:
        cost: Sum of squares of the whitened residuals and of the priors' rows.
        rms: Root mean square length of the readings' residuals [SI].
        count: Number of starts that led there.
    """

    robot: Robot
    solution: LeastSquaresSolution
    cost: float
    rms: float
    count: int


@dataclass(frozen=True, eq=False)
class Starts:
    """Minima found from several starts.

    Attributes:
        minima: The minima, lowest cost first.
        failed: Starts that did not converge or could not be assembled.
        groups: Scale of the noise of each group, the same for all starts, (n_groups,).
    """

    minima: tuple[StartMinimum, ...]
    failed: int
    seed: int
    groups: FloatArray

    @property
    def total(self) -> int:
        """Number of starts, the unperturbed one included."""
        return self.failed + sum(minimum.count for minimum in self.minima)


def explore(
    problem: Problem,
    placed: Robot,
    first: tuple[Evaluation, LeastSquaresSolution],
    groups: FloatArray,
    n: int,
    seed: int,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Starts:
    """Fit again from n - 1 perturbed starts.

    Args:
        placed: Robot at the first start.
        first: End of the first start.
        groups: Scale of the noise of each group, (n_groups,).
        n: Number of starts, the first included.
        executor: Executor of the fits; this process if not given.
    """
    rng = np.random.default_rng(seed)
    distinct: list[tuple[StartMinimum, FloatArray]] = []
    failed = 0
    _add(distinct, problem, groups, first)
    steps = [rng.standard_normal(len(problem.unknowns)) for _ in range(n - 1)]
    begin = partial(_solve_from, problem, placed, groups)
    for end in results_in_order(begin, steps, executor, progress):
        if end is None:
            failed += 1
        else:  # only the robot is sent between processes
            _add(distinct, problem, groups, (problem.evaluate(end[0]), end[1]))
    minima = tuple(minimum for minimum, _ in sorted(distinct, key=lambda entry: entry[0].cost))
    return Starts(minima, failed, seed, groups)


@one_blas_thread
def _solve_from(
    problem: Problem, placed: Robot, groups: FloatArray, step: FloatArray
) -> tuple[Robot, LeastSquaresSolution] | None:
    """The end of one start; None if it does not converge."""
    base = problem.unknowns.deviations(placed.values)
    for halving in range(_HALVINGS + 1):
        start = problem.unknowns.robot_at(placed, base + step / 2**halving)
        try:
            end, solution = problem.solve(problem.evaluate(start), groups)
        except ComputationError:
            continue
        return (end.robot, solution) if solution.converged else None
    return None


def _add(
    distinct: list[tuple[StartMinimum, FloatArray]],
    problem: Problem,
    groups: FloatArray,
    end: tuple[Evaluation, LeastSquaresSolution],
) -> None:
    reached, solution = end
    whitened = problem.whitening.whiten(reached.residuals, groups)
    smallest = _ROUNDING / float(np.min(groups * [group.typical for group in problem.whitening.groups]))
    size = _size(whitened)
    for k, (minimum, known) in enumerate(distinct):
        if _size(whitened - known) <= _SAME * max(min(size, _size(known)), smallest):
            distinct[k] = replace(minimum, count=minimum.count + 1), known
            return
    lengths = [np.sqrt(np.nansum(errors**2, axis=1)) for errors in reached.residuals.values()]
    rms = float(np.sqrt(np.mean(np.concatenate(lengths) ** 2)))
    distinct.append((StartMinimum(reached.robot, solution, solution.cost, rms, 1), whitened))


def _size(whitened: FloatArray) -> float:
    return float(np.sqrt(np.mean(whitened**2)))
