"""O1 to O5 by hand on small matrices, and the information of rows and priors."""

import numpy as np
import pytest

from calib.core.numerics.observability import INDICES, information, observability, posterior_information
from calib.core.numerics.prior import Prior


def indices_of(matrix, n_poses):
    return observability(np.linalg.svd(matrix, compute_uv=False), n_poses)


def test_by_hand():
    """Singular values 4, 2, 1 and four poses."""
    result = indices_of(np.vstack([np.diag([4.0, 1.0, 2.0]), np.zeros((9, 3))]), 4)
    assert result["O1"] == pytest.approx((4 * 2 * 1) ** (1 / 3) / np.sqrt(4))  # = 1
    assert result["O2"] == pytest.approx(1 / 4)
    assert result["O3"] == pytest.approx(1)
    assert result["O4"] == pytest.approx(1**2 / 4)
    assert result["O5"] == pytest.approx(1 / (1 / 4 + 1 / 2 + 1 / 1))


def test_a_matrix_that_loses_rank_exactly_has_zeros():
    assert indices_of(np.diag([1.0, 0.0]), 1) == dict.fromkeys(INDICES, 0.0)


@pytest.mark.parametrize("smallest", [1.0, 1e-3, 1e-7, 0.0])
@pytest.mark.parametrize("with_priors", [False, True])
def test_the_root_squares_to_the_covariance_however_clear_the_rank_is(smallest, with_priors):
    rng = np.random.default_rng(3)
    sizes, turned = np.array([3.0, 2.0, 1.0, smallest]), np.linalg.qr(rng.standard_normal((4, 4)))[0]
    rows = np.linalg.qr(rng.standard_normal((4 if with_priors else 20, 4)))[0] @ (sizes[:, None] * turned)
    priors = np.sqrt(2.0) * turned[:3] if with_priors else np.zeros((0, 4))
    squares = sizes**2 + 2.0 * (with_priors * np.array([1, 1, 1, 0]))
    known, seen = information(rows, priors), squares > 0
    covariance = (turned[seen].T / squares[seen]) @ turned[seen]
    np.testing.assert_allclose(
        known.root @ known.root.T * min(squares[seen]), covariance * min(squares[seen]), atol=1e-8
    )
    assert known.root.shape[1] == known.rank.rank == int(np.sum(seen))


@pytest.mark.parametrize("apart", [1.0, 1e-6], ids=["products keep the digits", "products lose them"])
def test_many_columns_with_correlated_priors_have_the_information_of_all_rows(apart):
    rng, n, together, without = np.random.default_rng(4), 150, [3, 70, 71], [8, 9]
    rows, core = rng.standard_normal((60, n)), rng.standard_normal((n, n))
    correlations = np.corrcoef(rng.standard_normal((3, 5)))
    precision = np.eye(n)
    precision[np.ix_(together, together)] = np.linalg.inv(correlations)
    inverse = np.linalg.pinv(np.vstack([rows, np.delete(np.linalg.cholesky(precision).T, without, axis=0)]))
    back = np.eye(n)
    back[8, 9], back[9, 9] = 1.0, apart  # the same rows of other unknowns, whose columns 8 and 9 are nearly equal
    known = posterior_information(rows @ back, Prior(~np.isin(np.arange(n), without), np.array(together), correlations))
    root, scale = back @ known.root, np.linalg.norm(known.root, axis=1)
    np.testing.assert_allclose(root @ root.T, inverse @ inverse.T, atol=1e-6)
    root = known.root / scale[:, None]
    np.testing.assert_allclose(known.covariance / np.outer(scale, scale), root @ root.T, atol=1e-9)
    np.testing.assert_allclose(known.covariance_from(core) / np.outer(scale, scale), root @ core @ root.T, atol=1e-9)
