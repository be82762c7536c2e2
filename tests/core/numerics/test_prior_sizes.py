"""What found sizes of priors add to uncertainty: against dense algebra by finite differences, and coverage."""

import numpy as np
import pytest

from calib.core.numerics.mixed_rows import SeenColumns
from calib.core.numerics.prior import Prior
from calib.core.numerics.size_search import find_sizes, unseen_variances, variance_by_sizes
from tests.core.numerics.test_variance_components import of_one_group

FAMILY = np.array([-1, -1, 0, 0, 0, 0, 1, 1, 1, 1, 1])
STEP = 1e-4


@pytest.fixture
def rows():
    """Rows by two parameters without a prior and two families, one well seen and one hardly."""
    rng = np.random.default_rng(0)
    jacobian = rng.standard_normal((30, len(FAMILY))) * np.where(FAMILY == 1, 0.15, 1.0)
    return jacobian, rng.standard_normal(30)


def posterior(rows, logs):
    """Estimate and covariance for families whose sizes have these logarithms, in units of size 1."""
    jacobian, measured = rows
    prior = np.where(FAMILY < 0, 0.0, np.exp(-2.0 * np.append(logs, 0.0)[FAMILY]))
    covariance = np.linalg.inv(jacobian.T @ jacobian + np.diag(prior))
    return covariance @ jacobian.T @ measured, covariance


def test_it_is_the_law_of_total_covariance(rows):
    jacobian, _ = rows
    u, covariance = posterior(rows, np.zeros(2))
    slopes, bends, information = [], [], np.eye(2)
    free = jacobian[:, FAMILY < 0]
    kept = np.linalg.svd(free)[0][:, 2:]  # what the rows say beside the parameters without a prior
    seen = [kept.T @ jacobian[:, f == FAMILY] for f in (0, 1)]
    inverse = np.linalg.inv(np.eye(28) + sum(part @ part.T for part in seen))
    for f, step in enumerate(STEP * np.eye(2)):
        (more, wide), (less, narrow) = posterior(rows, step), posterior(rows, -step)
        slopes.append((more - less) / (2 * STEP))
        bends.append((wide - 2 * covariance + narrow) / STEP**2)
        for g in (0, 1):  # of a normal distribution: half the trace of S^-1 dS S^-1 dS
            both = inverse @ (2 * seen[f] @ seen[f].T) @ inverse @ (2 * seen[g] @ seen[g].T)
            information[f, g] += 0.5 * np.trace(both)
    spread = np.linalg.inv(information)
    expected = np.array(slopes).T @ spread @ np.array(slopes)
    expected += sum(0.5 * spread[f, f] * bend for f, bend in enumerate(bends))
    # second differences of numbers near 1 by 1e-4 are good to 1e-7
    assert np.allclose(variance_by_sizes(covariance, FAMILY, u), expected, rtol=0, atol=1e-6)


def test_without_families_nothing_is_added():
    assert not np.any(variance_by_sizes(np.eye(3), np.full(3, -1), np.ones(3)))


@pytest.mark.quick(0)
def test_intervals_of_families_that_are_hardly_seen_hold():
    rng = np.random.default_rng(1)
    family = np.repeat([0, 1, 2], 12)
    seen = np.array([2.0, 0.5, 0.25])[family] / (1 + np.arange(36) % 12)
    inside, plainly = [], []
    for _ in range(300):
        jacobian = rng.standard_normal((60, 36)) * seen
        truth = rng.standard_normal(36)
        model = of_one_group(-jacobian @ truth + rng.standard_normal(60), jacobian, family)
        sizes = find_sizes(model, np.ones(1), np.array([False]), family, np.ones(3))[1][family]
        covariance = np.linalg.inv((jacobian * sizes).T @ (jacobian * sizes) + np.eye(36))
        u = -covariance @ (jacobian * sizes).T @ model.residuals
        total = covariance + variance_by_sizes(covariance, family, u)
        for variance, hits in ((total, inside), (covariance, plainly)):
            hits.append(np.abs(sizes * u - truth) < 1.96 * sizes * np.sqrt(np.diag(variance)))
    assert 0.93 < np.mean(inside) < 0.97
    assert np.mean(plainly) < np.mean(inside) - 0.01


def test_what_rows_do_not_see_of_a_family_says_nothing_about_its_size():
    rng = np.random.default_rng(5)
    seen = rng.standard_normal((40, 6))
    residuals = 2.0 * seen @ rng.standard_normal(6) + rng.standard_normal(40)
    turn = np.linalg.qr(rng.standard_normal((10, 10)))[0]
    unseen = np.hstack([seen, np.zeros((40, 4))]) @ turn  # six directions of ten coefficients
    found = []
    for jacobian in (seen, unseen):
        family = np.zeros(jacobian.shape[1], dtype=int)
        sizes = find_sizes(of_one_group(residuals, jacobian, family), np.ones(1), np.array([True]), family, np.ones(1))
        found.append(np.concatenate(sizes))
    np.testing.assert_allclose(*found, rtol=1e-9)


def test_components_that_rows_see_have_all_effect_and_covariance_of_the_coefficients():
    rng = np.random.default_rng(4)
    family = np.array([0, -1, 0, 1, 0, 1, -1])
    rows, u = rng.standard_normal((30, 7)), rng.standard_normal(7)
    rows[:, 4], u[4] = rows[:, 0] - 2.0 * rows[:, 2], u[0] - 2.0 * u[2]  # priors keep the unseen component at zero
    rows[:, 5] = 0.0
    u[5] = 0.0

    def total(rows, family, u):
        covariance = np.linalg.inv(rows.T @ rows + np.diag(1.0 * (family >= 0)))
        return covariance, covariance + variance_by_sizes(covariance, family, u)

    seen = SeenColumns.from_rows(rows, Prior(family >= 0), family)
    assert list(seen.family) == [-1, -1, 0, 0, 1]  # two components of three, and one of two
    assert list(seen.prior.has) == [False, False, True, True, True]
    w = rng.standard_normal(5)
    np.testing.assert_allclose(seen.combine(rows) @ w, rows @ seen.coefficients(w), atol=1e-12)
    np.testing.assert_allclose(seen.combine(seen.coefficients(w)), w, atol=1e-12)
    known, of_seen = total(seen.combine(rows), seen.family, seen.combine(u))
    unseen = unseen_variances(known, seen.family)
    np.testing.assert_allclose(seen.covariance(of_seen, unseen), total(rows, family, u)[1], atol=1e-10)


@pytest.mark.parametrize("family", [[0, 0, -1, 1, 1], [1, 1, -1, 0, 0]])
@pytest.mark.parametrize("least", [None, 1e-3])
def test_a_family_of_which_rows_see_nothing_keeps_the_variance_of_its_prior_and_of_its_size(family, least):
    family = np.array(family)
    rows = np.random.default_rng(5).standard_normal((30, 5))
    rows[:, 3:] = 0.0
    residuals, prior, unseen_family = rows[:, 0] + 0.5, Prior(family >= 0), family[3]
    seen = SeenColumns.from_rows(rows, prior, family, least)
    known = np.linalg.inv(seen.combine(rows).T @ seen.combine(rows) + np.diag(1.0 * seen.prior.has))
    unseen = unseen_variances(known, seen.family)
    of_seen = known + variance_by_sizes(known, seen.family, np.zeros(len(seen.family)))
    assert unseen[unseen_family] == pytest.approx(3.0)  # 1 + 2 t^2 with t = 1, the deviation that the prior leaves
    np.testing.assert_allclose(seen.covariance(of_seen, unseen)[3:, 3:], 3.0 * np.eye(2), atol=1e-12)
    scales, sizes = find_sizes(of_one_group(residuals, rows, family), np.ones(1), np.array([True]), family, np.ones(2))
    assert len(sizes) == 2
    assert np.all(np.isfinite([*scales, *sizes]))
