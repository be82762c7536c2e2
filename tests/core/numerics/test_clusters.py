"""Errors that rows of one block share, against dense algebra, refits and many draws."""

from functools import partial

import numpy as np
import pytest
from scipy.linalg import inv, sqrtm

from calib.core.numerics.clusters import scatter, shifts_without_block
from calib.core.numerics.observability import information
from calib.core.numerics.prior import Prior

N_FREE = 7


def problem(seed, lengths, priors=2):
    """A Jacobian whose rows are alike in each block, the root T of its information with priors, and the blocks."""
    rng = np.random.default_rng(seed)
    block = rng.permutation(np.repeat(np.arange(len(lengths)), lengths))
    jacobian = rng.standard_normal((len(lengths), N_FREE))[block] + 0.5 * rng.standard_normal((len(block), N_FREE))
    has_prior = np.arange(N_FREE) < priors
    return jacobian, information(jacobian, Prior(has_prior).rows).root, has_prior, block


def fitted(jacobian, root, has_prior, errors):
    """Residuals of the least-squares solution, priors drawn at zero, and that solution in the coordinates of T."""
    solution = root.T @ jacobian.T @ errors
    return errors - jacobian @ root @ solution, solution


def by_dense_algebra(jacobian, root, residuals, block):
    """Core, D and its mean, block by block with matrices of all rows."""
    span = jacobian @ root
    hat = span @ span.T
    core, square, mean = np.zeros((N_FREE, N_FREE)), 0.0, 0.0
    for b in np.unique(block):
        rows = np.flatnonzero(block == b)
        own = hat[np.ix_(rows, rows)]
        g = span[rows].T @ np.real(inv(sqrtm(np.eye(len(rows)) - own))) @ residuals[rows]
        core += np.outer(g, g)
        square += g @ g
        mean += np.trace(own)
    return core, square, mean


@pytest.mark.parametrize(
    ("lengths", "n_blocks"),
    [([3] * 20, 20), ([1, 2, 3, 4, 12, 15, 15, 20], 8), ([3] * 20, 15)],
    ids=["equal", "short and long", "rows of no block"],
)
def test_core_and_ratio_are_those_of_dense_algebra(lengths, n_blocks):
    jacobian, root, _, block = problem(1, lengths)
    residuals = np.random.default_rng(2).standard_normal(len(block))
    block[block >= n_blocks] = -1
    rows = block >= 0
    core, square, mean = by_dense_algebra(jacobian[rows], root, residuals[rows], block[rows])
    spread = scatter(jacobian @ root, residuals, np.full(len(block), 0.5), block, 50.0)
    np.testing.assert_allclose(spread.core, core, rtol=1e-9, atol=1e-12)
    assert spread.ratio == pytest.approx(np.sqrt(square / mean) / 0.5, rel=1e-9)


def test_rows_move_as_in_a_fit_without_their_block():
    jacobian, root, has_prior, block = problem(3, [1, 3, 3, 9, 12, 12])
    errors, weights = np.random.default_rng(4).standard_normal((2, len(block)))
    weighted = jacobian * np.exp(weights)[:, None]
    root = np.linalg.cholesky(np.linalg.inv(weighted.T @ weighted + np.diag(1.0 * has_prior)))
    residuals, solution = fitted(weighted, root, has_prior, errors)
    left_out = partial(shifts_without_block, weighted @ root, block, residuals)
    moved, largest = left_out(seen=jacobian @ root, alone=1.0 - 1e-6)
    for b in range(6):
        own = block == b
        normal = weighted[~own].T @ weighted[~own] + np.diag(1.0 * has_prior)
        without = np.linalg.solve(normal, weighted[~own].T @ errors[~own])
        np.testing.assert_allclose(moved[own], jacobian[own] @ (root @ solution - without), rtol=1e-8, atol=1e-8)
        hat = weighted[own] @ root @ root.T @ weighted[own].T
        assert largest[b] == pytest.approx(np.linalg.eigvalsh(hat)[-1], rel=1e-9)
    alike = left_out(seen=weighted @ root)
    for number, other in zip(left_out(), alike, strict=True):
        np.testing.assert_allclose(number, other, rtol=1e-9, atol=1e-9)


def draws(seed, lengths, shared, n=400):
    """Scatters of many fits whose rows share an error of a block, and the covariance of their solutions."""
    jacobian, root, has_prior, block = problem(seed, lengths)
    rng, results, solutions = np.random.default_rng(seed + 1), [], []
    for _ in range(n):
        errors = rng.standard_normal(len(block)) + shared * rng.standard_normal(len(lengths))[block]
        pulled = jacobian[:, has_prior] @ rng.standard_normal(int(has_prior.sum()))  # what priors say is true
        residuals, _ = fitted(jacobian, root, has_prior, errors + pulled)
        noise = np.full(len(block), np.sqrt(1.0 + shared**2))
        results.append(scatter(jacobian @ root, residuals, noise, block, 1e6))
        solutions.append(root.T @ jacobian.T @ errors)
    return results, np.cov(np.array(solutions).T, bias=True)


def test_by_independent_rows_the_chance_is_what_it_says():
    result, _ = draws(5, [4] * 40, 0.0)
    assert np.mean([item.ratio**2 for item in result]) == pytest.approx(1.0, abs=0.03)  # its standard error is 0.01
    assert 0.02 < np.mean([item.chance < 0.05 for item in result]) < 0.09  # of 400, 0.05 +- 0.011


@pytest.mark.parametrize("shared", [0.0, 2.0])
def test_the_core_is_how_solutions_scatter(shared):
    result, truth = draws(7, [4] * 40, shared)
    mean = np.mean([item.core for item in result], axis=0)
    assert np.trace(mean) == pytest.approx(np.trace(truth), rel=0.1)  # of 400 draws of 7 squares: +- 3 %
    if shared:
        assert np.mean([item.chance < 1e-3 for item in result]) > 0.9


def test_the_freedom_is_how_well_a_direction_of_the_core_is_known():
    """Of squares of normal numbers: twice the squared mean over the variance."""
    result, _ = draws(9, [4] * 40, 0.0)
    cores = np.array([np.diag(item.core) for item in result])
    known = 2.0 * np.mean(cores, axis=0) ** 2 / np.var(cores, axis=0)
    assert result[0].freedom == pytest.approx(np.mean(known), rel=0.25)


def test_a_block_that_decides_all_by_itself_says_nothing_and_keeps_its_noise():
    jacobian, root, _, block = problem(11, [60], priors=0)
    residuals = np.random.default_rng(12).standard_normal(60)
    spread = scatter(jacobian @ root, residuals, np.full(60, 0.5), block, 53.0)
    assert np.isnan(spread.ratio)
    assert spread.chance == 1.0
    np.testing.assert_allclose(spread.core, 0.25 * np.eye(N_FREE), atol=1e-9)


@pytest.mark.parametrize("length", [3, 30])
def test_a_direction_that_one_block_decides_alone_counts_nowhere_else(length):
    """As if its column and that direction of the rows were not there."""
    jacobian, _, _, block = problem(15, [length] * 8, priors=0)
    own, residuals = np.flatnonzero(block == 2)[0], np.random.default_rng(16).standard_normal(8 * length)
    jacobian[own] = residuals[own] = 0.0
    alone = np.zeros((len(block), 1))
    alone[own] = 1.0
    with_column = np.hstack([np.linalg.qr(jacobian)[0], alone])
    noise, moved = np.ones(len(block)), residuals + 7.0 * alone[:, 0]
    expected, found = (
        scatter(span, errors, noise, block, 50.0)
        for span, errors in ((with_column[:, :-1], residuals), (with_column, moved))
    )
    assert (found.ratio, found.chance) == pytest.approx((expected.ratio, expected.chance), rel=1e-9)


@pytest.mark.parametrize("length", [3, 30])
def test_a_reading_that_a_robust_loss_rejects_decides_no_more_than_all_of_a_direction(length):
    """Rows are those without weights, so that the part that a rejected reading decides of a direction exceeds 1."""
    jacobian, root, _, block = problem(17, [length] * 8)
    span, residuals = jacobian @ root, np.random.default_rng(18).standard_normal(8 * length)
    rejected = np.flatnonzero(block == 2)[0]
    whole, more = (np.hstack([span, np.zeros((len(span), 1))]) for _ in range(2))
    whole[block == 2] = more[block == 2] = 0.0
    whole[rejected, -1], more[rejected, -1] = 1.0, 1e3
    expected, found = (scatter(rows, residuals, np.ones(len(span)), block, 50.0) for rows in (whole, more))
    assert found.freedom == pytest.approx(expected.freedom, rel=1e-9)
    assert (found.ratio, found.chance) == pytest.approx((expected.ratio, expected.chance), rel=1e-9)


def test_larger_blocks_are_judged_beside_the_poses_within():
    """Readings of a pose share an error, and nothing more: then boxes of poses scatter no more than their poses."""
    jacobian, root, has_prior, pose = problem(15, [4] * 80)
    rng, chances = np.random.default_rng(16), []
    for _ in range(200):
        errors = rng.standard_normal(len(pose)) + 2.0 * rng.standard_normal(80)[pose]
        residuals, _ = fitted(jacobian, root, has_prior, errors)
        noise = np.full(len(pose), np.sqrt(5.0))
        poses, boxes = (scatter(jacobian @ root, residuals, noise, block, 1e6) for block in (pose, pose // 10))
        chances.append(boxes.ratio_to(poses)[1])
    assert np.mean(np.array(chances) < 0.05) < 0.12
