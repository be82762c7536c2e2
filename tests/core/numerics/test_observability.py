"""O1 to O5 by hand on small matrices, and the information of rows and priors."""

import numpy as np
import pytest

from calib.core.numerics.observability import INDICES, information, observability


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


@pytest.mark.parametrize("smallest", [1.0, 1e-7])
def test_many_columns_with_priors_give_the_same_covariance(smallest):
    rng = np.random.default_rng(4)
    rows = rng.standard_normal((300, 150)) * np.where(np.arange(150) < 149, 1.0, smallest)
    priors = np.eye(150)[:140]
    known = information(rows, priors)
    scale = np.append(np.ones(149), smallest)
    inverse = np.linalg.inv((rows.T @ rows + priors.T @ priors) / np.outer(scale, scale)) / np.outer(scale, scale)
    np.testing.assert_allclose(known.covariance * np.outer(scale, scale), inverse * np.outer(scale, scale), atol=1e-7)
    np.testing.assert_allclose(known.root @ known.root.T, known.covariance, rtol=1e-7, atol=1e-12)
