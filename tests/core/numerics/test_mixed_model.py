"""Sizes of families, noise and scatter: against dense matrices, closed forms, and simulated data."""

from dataclasses import replace

import numpy as np
import pytest
import scipy

from calib.core.numerics.mixed_model import MixedModel
from calib.core.numerics.mixed_rows import FLAT, KNOWN, MixedRows, whiten_scatter
from calib.core.numerics.size_search import (
    draw_sizes,
    information_by_size,
    least_sizes,
    likeliest_sizes,
    noise_given_scatter,
    scatter_given_noise,
)

GROUPS = np.tile([0, 0, 1], 20)
POSES = np.repeat(np.arange(20), 3)
FAMILY = np.array([0] * 5 + [1] * 4 + [KNOWN] * 2 + [FLAT] * 3)
LOGS = np.array([-0.3, 0.4, 0.1, -0.5])


@pytest.fixture
def small():
    """Sixty rows of two families, two groups of which one is stated, and scatter."""
    rng = np.random.default_rng(0)
    columns, levers, values = rng.normal(size=(60, len(FAMILY))), rng.normal(size=(60, 2)), rng.normal(size=60)
    return MixedRows(columns, values, FAMILY, GROUPS, np.array([False, True]), POSES, levers)


def of_one_group(columns, values, family, *, stated=False, pose=None, levers=None):
    """Rows of one group, each of a pose of its own without scatter if nothing else is said."""
    n = len(values)
    pose, levers = (np.arange(n), np.zeros((n, 0))) if pose is None else (pose, levers)
    return MixedRows(columns, values, np.array(family), np.zeros(n, dtype=int), np.array([stated]), pose, levers)


def marginal_covariance(model, logs):
    """W of the rows, term by term, the flat columns not among them."""
    rows = model.rows
    families, noise, scatter = model.sizes(logs)
    covariance = np.diag(noise[rows.group] ** 2)
    for block in {*zip(rows.pose, rows.group, strict=True)}:
        places = np.flatnonzero((rows.pose == block[0]) & (rows.group == block[1]))
        covariance[np.ix_(places, places)] += scatter**2 * rows.levers[places] @ rows.levers[places].T
    for number, size in [*enumerate(families), (KNOWN, 1.0)]:
        columns = rows.columns[:, rows.family == number]
        covariance += size**2 * columns @ columns.T
    return covariance


def contrasts(model, logs):
    """Rows that the flat columns do not touch, with their covariance and the matrix that makes them."""
    rows = model.rows
    away = scipy.linalg.null_space(rows.columns[:, rows.family == FLAT].T)
    return away.T @ rows.values, away.T @ marginal_covariance(model, logs) @ away, away


def dense_cost(model, logs):
    """-log of the likelihood of the contrasts."""
    values, covariance, _ = contrasts(model, logs)
    return 0.5 * (np.linalg.slogdet(covariance)[1] + values @ np.linalg.solve(covariance, values))


def test_the_cost_differs_from_that_of_contrasts_by_a_constant(small):
    model = MixedModel.from_rows(small)
    others = [LOGS, LOGS + 0.5, LOGS * -2.0]
    apart = [model.solve(logs).cost - dense_cost(model, logs) for logs in others]
    np.testing.assert_allclose(apart, apart[0], atol=1e-8)


def test_the_gradient_is_that_of_the_dense_likelihood(small):
    model, step = MixedModel.from_rows(small), 1e-5
    slopes = [(dense_cost(model, LOGS + step * e) - dense_cost(model, LOGS - step * e)) / (2 * step) for e in np.eye(4)]
    np.testing.assert_allclose(model.solve(LOGS).gradient, slopes, rtol=1e-6)


def test_the_information_is_half_the_trace_of_dense_products(small):
    model, step = MixedModel.from_rows(small), 1e-5
    _, covariance, away = contrasts(model, LOGS)
    inverse = away @ np.linalg.solve(covariance, away.T)
    moved = [
        (marginal_covariance(model, LOGS + step * e) - marginal_covariance(model, LOGS - step * e)) / (2 * step)
        for e in np.eye(4)
    ]
    dense = [[0.5 * np.trace(inverse @ one @ inverse @ two) for two in moved] for one in moved]
    np.testing.assert_allclose(model.solve(LOGS).information, dense, rtol=1e-5, atol=1e-8)


def by_components(model, derivative):
    """Derivatives by the components, from those by all columns."""
    return derivative @ model.components.coefficients(np.eye(model.x.shape[1]))


def test_coefficients_and_their_covariance_are_those_of_normal_numbers_given_the_rows(small):
    """By conditioning: prior covariance times columns, over W."""
    model = MixedModel.from_rows(small)
    solved = model.solve(LOGS)
    _, covariance, away = contrasts(model, LOGS)
    prior = np.exp(2 * LOGS[0]) * (FAMILY == 0) + np.exp(2 * LOGS[1]) * (FAMILY == 1) + 1.0 * (FAMILY == KNOWN)
    felt = prior[:, None] * (away.T @ small.columns).T
    expected = felt @ np.linalg.solve(covariance, away.T @ small.values)
    kept = FAMILY != FLAT
    np.testing.assert_allclose(solved.coefficients[kept], expected[kept], rtol=1e-7)
    derivative = np.random.default_rng(1).normal(size=(1, len(FAMILY))) * kept
    b = by_components(model, derivative)[0]
    spread = np.diag(prior) - felt @ np.linalg.solve(covariance, felt.T)
    assert b @ solved.covariance @ b == pytest.approx(float((derivative @ spread @ derivative.T)[0, 0]), rel=1e-7)


def test_blocks_that_are_left_out_are_predicted_by_a_solution_without_their_rows(small):
    solved, weight = MixedModel.from_rows(small).solve(LOGS), np.array([2.0, 0.5])
    block = np.arange(20) % 3
    squares = solved.left_out_squares(block[small.pose], weight)
    for k in range(3):
        there, others = np.flatnonzero(block[POSES] == k), np.flatnonzero(block[POSES] != k)
        parts = {name: getattr(small, name)[others] for name in ("columns", "values", "group", "pose", "levers")}
        kept = MixedModel.from_rows(replace(small, **parts)).solve(LOGS)
        errors = small.values[there] - small.columns[there] @ kept.coefficients
        assert squares[k] == pytest.approx(np.sum(weight[GROUPS[there]] * errors**2), rel=1e-6)


def test_what_a_block_alone_decides_is_no_error_of_it(small):
    """The place of a setup is a flat column of its rows: what they say together with it does not change their error."""
    columns, squares = np.column_stack([small.columns, np.where(POSES < 10, 1.0, 0.0)]), []
    for moved in (0.0, 7.0):
        values = small.values + np.where(POSES < 10, moved, 0.0)
        rows = of_one_group(columns, values, np.append(FAMILY, FLAT), pose=POSES, levers=np.zeros((60, 0)))
        solved = MixedModel.from_rows(rows).solve(LOGS[:3])
        squares.append(solved.left_out_squares((POSES >= 10).astype(int), np.ones(1)))
    np.testing.assert_allclose(squares[1], squares[0], rtol=1e-6)
    assert squares[0][0] > 1.0


def test_a_family_of_no_size_is_not_there(small):
    kept = FAMILY != 0
    without = MixedModel.from_rows(replace(small, columns=small.columns[:, kept], family=FAMILY[kept])).solve(LOGS)
    none = MixedModel.from_rows(small).solve(np.array([-np.inf, *LOGS[1:]]))
    assert none.cost == pytest.approx(without.cost, rel=1e-9)
    np.testing.assert_allclose(none.coefficients[kept], without.coefficients, atol=1e-9)
    assert not np.any(none.coefficients[~kept])


def test_a_family_that_is_not_there_gets_no_size():
    rng = np.random.default_rng(3)
    rows = of_one_group(rng.normal(size=(120, 8)), 0.1 * rng.standard_normal(120), [0] * 5 + [FLAT] * 3)
    found = likeliest_sizes(MixedModel.from_rows(rows))
    assert np.exp(found.logs[0]) < 0.02
    drawn = np.exp(draw_sizes(found, 200, np.random.default_rng(0)))
    assert np.quantile(drawn[:, 0], 0.95) < 0.06  # 5 coefficients of 0.01 each could hide, not of 0.1


def test_components_that_rows_do_not_see_are_put_aside():
    """Columns that are nearly alike: their difference. And all that are shorter than is asked for."""
    rng = np.random.default_rng(4)
    one = rng.normal(size=(40, 1))
    columns = np.concatenate([one, one * (1 + 1e-9)], axis=1)
    rows = of_one_group(columns, one[:, 0], [0, 0], stated=True)
    assert MixedModel.from_rows(rows).x.shape == (40, 1)
    length = np.sqrt(2.0) * np.linalg.norm(one)
    assert [MixedModel.from_rows(rows, factor * length).x.shape[1] for factor in (0.99, 1.01)] == [1, 0]


def test_of_more_columns_than_rows_as_many_components_are_kept_as_there_are_rows():
    columns = np.random.default_rng(7).normal(size=(6, 40))
    x = MixedModel.from_rows(of_one_group(columns, columns[:, 0], [0] * 40, stated=True)).x
    assert x.shape == (6, 6)
    np.testing.assert_allclose(x @ x.T, columns @ columns.T, atol=1e-12)


def test_an_absent_family_ends_at_its_bound_where_the_noise_is_a_small_part_of_the_values():
    """A search ends beside the likeliest noise, on either side: no noise at all is no alternative to it."""
    rng = np.random.default_rng([9, 6])
    columns = rng.normal(size=(120, 10)) * np.repeat([1.0, 0.01], 5)
    values = columns[:, :5] @ rng.normal(size=5) + 0.01 * rng.standard_normal(120)
    model = MixedModel.from_rows(of_one_group(columns, values, np.repeat([0, 1], 5)))
    assert likeliest_sizes(model).logs[1] == least_sizes(model)[1]


def of_one_family(seed, size, noise):
    """Rows that show one family of two."""
    rng = np.random.default_rng(seed)
    columns = rng.normal(size=(60, 13))
    values = columns[:, :8] @ rng.normal(size=8) * size + noise * rng.standard_normal(60)
    return MixedModel.from_rows(of_one_group(columns, values, [0] * 8 + [1] * 4 + [FLAT]))


def test_a_search_leaves_a_size_of_zero_where_the_rows_show_the_family():
    model = of_one_family(11, 1.0, 0.5)
    free, least = likeliest_sizes(model), least_sizes(model)
    begun = likeliest_sizes(model, np.append(least[:2], free.logs[2] + 1.0))
    assert free.logs[0] > -1.0
    np.testing.assert_allclose(begun.logs[[0, 2]], free.logs[[0, 2]], atol=0.03)


def test_a_search_ends_at_the_minimum_where_its_first_steps_are_too_long():
    model = of_one_family(12, 3.0, 0.05)
    logs = likeliest_sizes(model).logs
    best = scipy.optimize.minimize(
        lambda inner: dense_cost(model, np.array([inner[0], logs[1], inner[1]])) + np.log1p(np.exp(2.0 * inner[0])),
        np.array([0.0, -2.0]),
    )
    np.testing.assert_allclose(logs[[0, 2]], best.x, atol=0.03)


def test_a_small_size_at_its_minimum_keeps_no_other_from_zero():
    """The search begins near the minimum of the first family, above zero of the second, which is not there."""
    rng = np.random.default_rng(0)
    columns = np.linalg.qr(rng.normal(size=(200, 25)))[0] * np.repeat([400.0, 3.0, 10.0], [12, 12, 1])
    values = columns @ np.concatenate([0.02 * rng.standard_normal(12), np.zeros(12), [1.0]]) + rng.standard_normal(200)
    model = MixedModel.from_rows(of_one_group(columns, values, [0] * 12 + [1] * 12 + [FLAT]))
    best = likeliest_sizes(model).logs
    assert best[0] < np.log(0.03)
    rough = likeliest_sizes(model, best + np.array([0.05, 2.0, 0.0]), least_gain=0.05).logs
    np.testing.assert_allclose(rough, best + np.array([0.05, 0.0, 0.0]), atol=1e-9)
    assert rough[1] == least_sizes(model)[1]


def test_components_count_by_the_noise_of_the_step():
    """They are 40 times as long as one sigma, and the noise is a thousand times as large."""
    rng = np.random.default_rng(2)
    columns = np.linalg.qr(rng.normal(size=(30, 3)))[0] * [40.0, 40.0, 1.0]
    model = MixedModel.from_rows(of_one_group(columns, rng.normal(size=30), [0, 0, FLAT]))
    assert [len(model.solve(np.array([0.0, np.log(noise)])).seen) for noise in (1.0, 1000.0)] == [3, 1]


def test_drawn_sizes_count_components_that_the_size_found_hides():
    """A family that the rows exclude: sizes by which its columns would show are excluded, too."""
    columns = np.linalg.qr(np.random.default_rng(4).normal(size=(60, 6)))[0]
    model = MixedModel.from_rows(of_one_group(5.0 * columns[:, :5], 7.0 * columns[:, 5], [0] * 4 + [FLAT]))
    at = likeliest_sizes(model)
    assert at.logs[0] == least_sizes(model)[0]
    assert len(at.seen) == 1
    zero, slightly = (dense_cost(model, np.append(log, at.logs[1])) for log in (-20.0, 0.5 * np.log(1e-5)))
    expected = 2.0 * (slightly - zero) / 1e-5 + 2.0  # the slope by s^2 / 2, and that of the prior
    assert expected > 20.0
    assert information_by_size(at)[0, 0] == pytest.approx(expected, rel=0.02)


def test_noise_is_found_where_the_scatter_explains_all_that_flat_columns_leave():
    rng, pose = np.random.default_rng(48), np.repeat(np.arange(20), 3)
    columns, levers = rng.normal(size=(60, 6)), rng.normal(size=(60, 2))
    values = np.einsum("ij,ij->i", levers, rng.normal(size=(20, 2))[pose]) + 0.5 * rng.standard_normal(60)
    model = MixedModel.from_rows(of_one_group(columns, values, [0] * 4 + [FLAT] * 2, pose=pose, levers=levers))
    family, noise, most = likeliest_sizes(model).logs
    best = scipy.optimize.minimize_scalar(
        lambda log: dense_cost(model, np.array([family, log, most])), bounds=(-2.0, 1.0), method="bounded"
    )
    assert model.solve(np.array([family, noise, most])).gradient[2] < -1.0  # it would be larger still
    assert noise == pytest.approx(best.x, abs=0.01)


def test_a_family_is_found_that_no_row_sees_at_its_usual_size():
    """Its coefficients are 40 times the usual ones, and at the usual size they are a thirtieth of all that is left."""
    rng = np.random.default_rng(12)
    columns = rng.normal(size=(60, 9)) * np.append(np.full(8, 0.01), 1.0)
    values = columns[:, :8] @ (40.0 * rng.normal(size=8)) + 0.05 * rng.standard_normal(60)
    found = np.exp(likeliest_sizes(MixedModel.from_rows(of_one_group(columns, values, [0] * 8 + [FLAT]))).logs)
    assert found == pytest.approx([40.0, 0.05], rel=0.5)


def test_the_slope_at_zero_is_that_of_the_cost_by_the_square_of_a_size(small):
    model, zero, square = MixedModel.from_rows(small), LOGS.copy(), 1e-4
    zero[:2] = -np.inf
    slope, information = model.solve(zero).slope_at_zero(np.arange(2))
    for k in range(2):
        logs = zero.copy()
        logs[k] = 0.5 * np.log(square)
        seen = np.flatnonzero(np.isin(model.family, [k, FLAT, KNOWN]))
        rise = model.solve(logs, seen).cost - model.solve(zero).cost
        assert slope[k] == pytest.approx(rise / square, rel=0.02)
        of_log = model.solve(logs, seen).information[k, k]  # 2 s^2 is the derivative of s^2 by log s
        assert information[k] == pytest.approx(of_log / (2.0 * square) ** 2, rel=0.02)


def test_intervals_hold_over_sizes_that_are_drawn():
    """New rows of 24 simulated problems, within 95 % intervals of the draws; one standard deviation is 1 %."""
    held = []
    for seed in range(24):
        rng = np.random.default_rng([6, seed])
        columns = rng.normal(size=(70, 24))
        true = np.append(np.append(0.6 * rng.standard_normal(10), np.zeros(10)), rng.normal(size=4))
        values = columns @ true + 0.5 * rng.standard_normal(70)
        cut = 45
        rows = of_one_group(columns[:cut], values[:cut], [0] * 10 + [1] * 10 + [FLAT] * 4)
        found = likeliest_sizes(MixedModel.from_rows(rows))
        b, means, variances = by_components(found.model, columns[cut:]), [], []
        for logs in draw_sizes(found, 20, rng):
            solved = found.model.solve(logs)
            means.append(b @ solved.condensed_coefficients)
            variances.append(np.sum(b @ solved.covariance * b, axis=1) + solved.model.sizes(logs)[1][0] ** 2)
        std = np.sqrt(np.mean(variances, axis=0) + np.var(means, axis=0))
        held.append(np.abs(values[cut:] - np.mean(means, axis=0)) < 1.96 * std)
    assert 0.92 < np.mean(held) < 0.975


def test_noise_that_looks_like_scatter_is_drawn_no_larger_than_residuals():
    """Three joints that slide along the axes of the readings; columns with priors leave a fiftieth of the values."""
    rng = np.random.default_rng(13)
    columns = rng.normal(size=(90, 5))
    values = 50.0 * columns @ rng.normal(size=5) + rng.standard_normal(90)
    each = np.repeat(np.arange(30), 3)
    rows = of_one_group(100.0 * columns, values, [KNOWN] * 5, pose=each, levers=np.tile(np.eye(3), (30, 1)))
    drawn = np.exp(draw_sizes(likeliest_sizes(MixedModel.from_rows(rows)), 200, np.random.default_rng(0)))
    assert np.quantile(np.sqrt(np.sum(drawn**2, axis=1)), 0.9) < 2.5


def test_the_average_information_is_the_mean_of_fishers_and_the_second_derivative(small):
    """Of variances themselves, in which a covariance is linear."""
    model, step = MixedModel.from_rows(small), 1e-4
    solved = model.solve(LOGS)
    second = [(model.solve(LOGS + step * e).gradient - model.solve(LOGS - step * e).gradient) / (2 * step)
              for e in np.eye(4)]  # fmt: skip
    by_variances = np.array(second) - np.diag(2.0 * solved.gradient)  # d^2 / d(log s)^2 has the slope, too
    np.testing.assert_allclose(solved.average_information, (solved.information + by_variances) / 2.0, rtol=1e-5)


def test_a_scatter_is_no_larger_than_residuals_that_are_nothing_else():
    """Noise of another shape, large where the lever is short, makes the likeliest scatter many times too large."""
    rng, n = np.random.default_rng(8), 60
    levers = np.tile([[10.0, 0.0], [0.0, 0.1]], (n, 1))
    noise = rng.standard_normal(2 * n) * np.tile([100.0, 1000.0], n)
    known = 1e4 * rng.standard_normal(2 * n)  # its coefficient explains most of the values
    pose = np.repeat(np.arange(n), 2)
    rows = of_one_group(known[:, None], noise + known, [KNOWN], stated=True, pose=pose, levers=levers)
    found = likeliest_sizes(MixedModel.from_rows(rows))
    alone = np.sqrt(np.sum(noise**2) / np.sum(levers**2))
    assert scatter_given_noise(found) == pytest.approx(alone, rel=0.1)
    assert np.exp(found.logs[-1]) > 3.0 * alone


def test_the_scatter_depends_on_no_component_that_a_solution_omits(small):
    model, logs = MixedModel.from_rows(small), LOGS.copy()
    logs[:2] = least_sizes(model)[:2]
    few, every = model.solve(logs), model.solve(logs, np.arange(len(model.family)))
    assert len(few.seen) < len(every.seen)
    assert scatter_given_noise(few) == pytest.approx(scatter_given_noise(every), rel=1e-9)


def test_of_a_scatter_that_moves_no_row_any_size_is_drawn():
    rng = np.random.default_rng(0)
    columns, pose = rng.normal(size=(60, 4)), np.repeat(np.arange(20), 3)
    rows = of_one_group(columns, rng.normal(size=60), [0, 0, FLAT, FLAT], pose=pose, levers=np.zeros((60, 2)))
    assert np.all(np.isfinite(draw_sizes(likeliest_sizes(MixedModel.from_rows(rows)), 5, rng)))


@pytest.mark.parametrize("n_levers", [2, 7])
def test_rows_with_scatter_are_whitened_by_the_root_of_their_covariance(n_levers):
    levers = np.random.default_rng(2).standard_normal((8, n_levers))
    pose = np.array([0, 0, 0, 1, 1, 1, 1, 1])
    covariance = np.where(pose[:, None] == pose, levers @ levers.T, 0.0) + np.eye(8)
    root = whiten_scatter(levers, pose, np.eye(8))[0]
    np.testing.assert_allclose(root @ covariance @ root, np.eye(8), atol=1e-12)
    np.testing.assert_allclose(root, root.T, atol=1e-13)


def test_noise_beside_a_scatter_is_that_of_the_rows():
    """Of rows whose scatter is known; their whitened values have the variance 1, and are independent."""
    rng, n = np.random.default_rng(9), 3000
    levers, pose = rng.standard_normal((3 * n, 4)), np.repeat(np.arange(n), 3)
    changes = np.einsum("kij,kj->ki", levers.reshape(n, 3, 4), 0.5 * rng.standard_normal((n, 4))).ravel()
    values = changes + 0.2 * rng.standard_normal(3 * n)
    rows = of_one_group(np.ones((3 * n, 1)), values, [FLAT], pose=pose, levers=levers)
    found = likeliest_sizes(MixedModel.from_rows(rows))
    noise = noise_given_scatter(found, 0.5)[0]
    assert noise == pytest.approx(0.2, rel=0.1)
    white = whiten_scatter(0.5 / noise * levers, pose, values / noise)[0].reshape(n, 3)
    np.testing.assert_allclose(white.T @ white / n, np.eye(3), atol=0.1)
