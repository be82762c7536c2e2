"""Errors of parameters by the curvature of readings along directions that only priors hold.

Along a direction that readings do not see (an origin and the base turned against each other, say), the values with the
same readings lie on a curve. The linear model follows its tangent. Readings determine a parameter to micrometres at one
place of the curve. At another place, a standard deviation of a prior away, its value differs by the products of such
errors: 3 mrad of 1 mm are 3 um.

Let the error of the scaled parameters be d = sum of x_i t_i with x_i ~ N(0, 1) in the linear model, t_i the columns of
T V (`calib.core.numerics.statistics`), V the eigenvectors of the share S of the priors. Whitened readings then change
by J d + c, c = 1/2 sum of x_i x_j H t_i t_j with H their second derivative, and the parameters follow by a Gauss-Newton
step back to the readings:

    e = -T T^T J^T c = 1/2 sum of x_i x_j b_ij,          E e^2 = 1/2 sum of b_ij^2 + 1/4 (sum of b_ii)^2

for each parameter. J^T H t_i is the difference of two products of Jacobians. Only pairs count in which priors hold at
least one direction (a share above 0.1): the square of a direction that readings decide is negligible. Coefficients of
families, whose size is found, do not count either: each of hundreds is uncertain by some hundredths of a milliradian,
and e would widen their own intervals by 2e-7 (300 poses of a UR10).
As E e^2 depends only on the distribution of d, the other columns t_i are replaced by the fewest with the same
distribution, the root of their covariance, once for those that priors hold and once for the rest.

If there are very many poses, some of them determine e: values on the curve read the same at each pose, so that the step
back is the same, too. T and the span t_i are those of all N poses. The step back is computed from n of them, spread
over all pairs of frames of each instrument, with their squares multiplied by N / n. With 1000 and 5000 poses of a
six-axis arm, 250 give the same half widths to 2e-7.

E e^2 widens the intervals of single parameters, on both sides. It is no part of the covariance: positions do not change
along the curve, and their covariance is that of the linear model around the solution.

When it fails. It is the second order. Where angles are undetermined by a tenth of a radian, the third order counts,
too; then the verdict says so. Along directions in which a loop opens nothing is known, and nothing is added.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.core.base.arrays import FloatArray, IntArray
from calib.core.fitting.problem import Evaluation, Problem
from calib.core.instruments.kind import Readings
from calib.core.numerics import linalg
from calib.core.numerics.mixed_rows import UNSEEN, SeenColumns
from calib.core.numerics.observability import posterior_information
from calib.core.numerics.statistics import prior_shares
from calib.core.rows.rows import Rows

_HELD = 0.1  # priors hold a direction if they have more than this share in it
_STEP = 0.1  # step of a difference of Jacobians, in standard deviations
_POSES = 250  # poses of each pair of frames that determine the step back


def mean_square_beyond_linear(problem: Problem, final: Evaluation, rows: Rows, groups: FloatArray) -> FloatArray:
    """Return E e^2 of the module docstring, (n_free,) [m^2, rad^2].

    Args:
        groups: Scale of the noise of each group, (n_groups,).
    """
    own = problem.unknowns.family < 0
    seen = SeenColumns.from_rows(rows.few_rows, rows.prior, problem.unknowns.family, UNSEEN)
    known = posterior_information(seen.combine(rows.few_rows), seen.prior)
    shares, turned = linalg.eigh(prior_shares(known, seen.prior))
    turned = known.root[: np.count_nonzero(own)] @ turned
    held, decided = (_fewest(turned[:, which]) for which in (shares > _HELD, shares <= _HELD))
    directions, n_held = np.hstack([held, decided]), held.shape[1]
    counts = np.where(np.arange(directions.shape[1]) < n_held, 0.5, 1.0)  # j, i is the same as i, j
    result = np.zeros(len(own))
    if not n_held:
        return result
    squares, mean = np.zeros_like(result[own]), np.zeros_like(result[own])
    problem, final, times = _problem_at_some_poses(problem, final)
    jacobian = rows.jacobian if times == 1.0 else np.sqrt(times) * problem.rows(final, groups).jacobian
    combined, columns = seen.combine(jacobian), problem.unknowns.select(own)
    back = posterior_information(combined, seen.prior).covariance[: len(squares)] @ combined.T
    for i in range(n_held):
        for step in (_STEP, -_STEP):
            deviations = rows.deviations.copy()
            deviations[own] += step * directions[:, i]
            evaluation = problem.evaluate_if_closed(problem.unknowns.robot_at(final.robot, deviations), final)
            if evaluation is not None:
                there = np.sqrt(times) * problem.derivative(evaluation, groups, columns)
                curvature = -(back @ (there - jacobian[:, own])) @ (directions / step)  # by T T^T J^T H t_i
                squares += curvature**2 @ counts
                mean += curvature[:, i] / 2
                break
    result[own] = columns.scales**2 * (squares + mean**2)
    return result


def _problem_at_some_poses(problem: Problem, final: Evaluation) -> tuple[Problem, Evaluation, float]:
    """Return the problem at some of very many poses, its evaluation, and the ratio of all poses to these."""
    data = problem.data
    visits = np.unique(np.concatenate([_evenly_spread(readings) for readings in data.readings.values()]))
    if len(visits) == len(data):
        return problem, final, 1.0
    part = Problem.from_data(problem.robot, data.subset(visits), problem.sigma, final.configurations.passive[visits])
    part = replace(part, unknowns=problem.unknowns)
    return part, part.evaluate(final.robot), len(data) / len(visits)


def _evenly_spread(readings: Readings) -> IntArray:
    """Return visits (n,) of readings: for each pair of frames at most `_POSES`, evenly spread."""
    of_pairs = [np.unique(readings.visits[readings.pairs == pair]) for pair in np.unique(readings.pairs)]
    return np.concatenate([visits[:: -(-len(visits) // _POSES)] for visits in of_pairs])


def _fewest(directions: FloatArray) -> FloatArray:
    """Columns W with W W^T = D D^T of directions D (n_free, n), at most as many as D has rows that are not 0."""
    moved = np.flatnonzero(np.any(directions != 0.0, axis=1))
    if directions.shape[1] <= len(moved):
        return directions
    few = np.zeros((len(directions), len(moved)))
    few[moved] = np.asarray(np.linalg.qr(directions[moved].T, mode="r")).T
    return few
