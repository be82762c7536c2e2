"""How far parameters are off because readings are no linear function of what only priors hold.

Along a direction that readings do not see, an origin and the base turned against each other, say, the values that read
the same lie on a curve. The linear model follows its tangent. Readings know a parameter to micrometres at one place of
the curve; another place, a standard deviation of a prior away, has another value of it, off by the products of such
errors: 3 mrad of 1 mm are 3 um.

Let the error of the scaled parameters be d = sum of x_i t_i with x_i ~ N(0, 1) in the linear model, t_i the columns of
T V (`calib.core.numerics.statistics`), V the eigenvectors of the share S of the priors. Whitened readings then change
by J d + c, c = 1/2 sum of x_i x_j H t_i t_j with H their second derivative, and the parameters follow by a Gauss-Newton
step back onto what was read:

    e = -T T^T J^T c = 1/2 sum of x_i x_j b_ij,          E e^2 = 1/2 sum of b_ij^2 + 1/4 (sum of b_ii)^2

for each parameter. J^T H is exact where `calib.core.rows.second_derivative` has it; else J^T H t_i is the difference of
two products of Jacobians. Only pairs count of which priors hold at least one (a share above 0.1): what readings decide
is known so well that its square is nothing. Nor do coefficients of families count, whose size is found: of hundreds,
each is uncertain by some hundredths of a milliradian. As E e^2 depends on the distribution of d alone, the columns t_i
of the others are replaced by as few as have the same one: by the root of their covariance, once for those that priors
hold and once for the rest.

E e^2 widens the intervals of single parameters, on both sides. It is no part of the covariance: positions do not change
along the curve, and their covariance is that of the linear model around the solution.

When it fails. It is the second order. Where angles are open by a tenth of a radian the third counts, too; then the
verdict says so. Along directions in which a loop opens nothing is known, and nothing is added.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.fitting.problem import Evaluation, Problem
from calib.core.numerics.statistics import prior_directions
from calib.core.numerics.tall import in_parts
from calib.core.rows.rows import Rows
from calib.core.rows.second_derivative import bend_simply, bends
from calib.core.rows.unknowns import Unknowns

_HELD = 0.1  # share of the priors in a direction above which its square counts
_STEP = 0.1  # of a difference of Jacobians, in standard deviations
_AT_ONCE = 32  # parameters, whose b_ij stay in the processor's cache


def mean_square_beyond_linear(problem: Problem, final: Evaluation, rows: Rows, groups: FloatArray) -> FloatArray:
    """Return E e^2 of the module docstring, (n_free,) [m^2, rad^2].

    Args:
        problem: The problem.
        final: The evaluation at the minimum.
        rows: Whitened rows there.
        groups: Scale of the noise of each group, (n_groups,).
    """
    root, own = rows.known.root, problem.unknowns.family < 0
    shares, turned = prior_directions(rows.known, rows.prior)
    directions = np.zeros((len(root), turned.shape[1]))
    directions[own] = root[own] @ turned
    held, seen = (_fewest(directions[:, which]) for which in (shares > _HELD, shares <= _HELD))
    directions, n_held = np.hstack([held, seen]), held.shape[1]
    counts = np.where(np.arange(directions.shape[1]) < n_held, 0.5, 1.0)  # j, i is the same as i, j
    squares, mean = np.zeros(len(root)), np.zeros(len(root))
    if not n_held:
        return squares
    is_exact = problem.weighing is None and bend_simply(final.robot, problem.whitening)
    for some, i, bent in (_exact if is_exact else _differences)(problem, final, rows, groups, directions, n_held):
        squares[some] += np.sum(bent**2 @ counts, axis=1)
        mean[some] += np.trace(bent[:, :, i], axis1=1, axis2=2) / 2
    return np.asarray(problem.unknowns.scales**2 * (squares + mean**2))


def _exact(
    problem: Problem, final: Evaluation, rows: Rows, groups: FloatArray, directions: FloatArray, n_held: int
) -> Iterator[tuple[slice, slice, FloatArray]]:
    """Yield places of parameters, of all held i, and their b_ij, (n_some, n_held, n_directions)."""
    own, unknowns = problem.unknowns.family < 0, problem.unknowns
    covariance, moved = rows.known.root @ rows.known.root.T, (unknowns.scales[:, None] * directions)[own]
    at = (final.robot, final.configurations, final.readings)
    pulled = bends(*at, rows, problem.whitening, groups, unknowns.index[own])
    for some in in_parts(len(own), _AT_ONCE):
        yield some, slice(n_held), np.matmul(moved[:, :n_held].T, pulled.times(-covariance[some])) @ moved


def _differences(
    problem: Problem, final: Evaluation, rows: Rows, groups: FloatArray, directions: FloatArray, n_held: int
) -> Iterator[tuple[slice, slice, FloatArray]]:
    """Yield the same for all parameters, one i after the other, but those along which a loop opens."""
    own, jacobian = problem.unknowns.family < 0, rows.jacobian
    covariance, columns = rows.known.root @ rows.known.root.T, problem.unknowns.only(own)
    here = (jacobian.T @ jacobian)[own]
    for i in range(n_held):
        for step in (_STEP, -_STEP):
            moved = problem.unknowns.moved(final.robot, rows.deviations + step * directions[:, i])
            evaluation = problem.evaluate_if_closed(moved, final)
            if evaluation is not None:
                felt = (_products(problem, evaluation, groups, columns, jacobian) - here).T / step  # J^T H t_i
                yield slice(len(own)), slice(i, i + 1), (-(covariance @ felt) @ directions[own])[:, None]
                break


def _products(
    problem: Problem, evaluation: Evaluation, groups: FloatArray, columns: Unknowns, jacobian: FloatArray
) -> FloatArray:
    """Product of the transposed derivative by some unknowns elsewhere with a Jacobian here, (n_columns, n_free)."""
    if problem.weighing is not None:
        return np.asarray(problem.rows(evaluation, groups, columns).jacobian.T @ jacobian)
    parts = problem.derivative(evaluation, groups, columns).parts()
    return np.asarray(sum(there.T @ jacobian[places] for places, there in parts))


def _fewest(directions: FloatArray) -> FloatArray:
    """Columns W with W W^T = D D^T of directions D (n_free, n), at most as many as D has rows that are not 0."""
    moved = np.flatnonzero(np.any(directions != 0.0, axis=1))
    if directions.shape[1] <= len(moved):
        return directions
    few = np.zeros((len(directions), len(moved)))
    few[moved] = np.asarray(np.linalg.qr(directions[moved].T, mode="r")).T
    return few
