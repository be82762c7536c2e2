"""An error that the rows of a visit share, against dense matrices."""

import numpy as np
import pytest
from scipy.linalg import block_diag, inv, sqrtm

from calib.core.numerics.variance_components import SharedError

RNG = np.random.default_rng(2)
BLOCK = np.array([3, 1, 3, 3, 7, 1, 3, 9, 9])  # of unequal length, and not side by side
COLUMNS = RNG.standard_normal((9, 2))
ROWS = RNG.standard_normal((9, 4))


@pytest.fixture(scope="module")
def shared():
    return SharedError(COLUMNS, BLOCK)


@pytest.fixture(scope="module")
def dense():
    """I + C C^T, with C C^T only between rows of one block."""
    same = BLOCK[:, None] == BLOCK
    return np.eye(9) + np.where(same, COLUMNS @ COLUMNS.T, 0.0)


def test_rows_are_whitened_by_the_symmetric_root(shared, dense):
    root = np.real(inv(sqrtm(dense)))
    np.testing.assert_allclose(shared.whiten(ROWS), root @ ROWS, atol=1e-12)
    np.testing.assert_allclose(shared.whiten(ROWS[:, 0]), root @ ROWS[:, 0], atol=1e-12)
    np.testing.assert_allclose(shared.whiten(shared.whiten(dense)), np.eye(9), atol=1e-12)


def test_diagonal_traces_and_determinant_are_those_of_the_dense_matrix(shared, dense):
    inverse = inv(dense)
    np.testing.assert_allclose(shared.diagonal(), np.diag(inverse), atol=1e-12)
    assert shared.log_determinant() == pytest.approx(np.linalg.slogdet(dense)[1], rel=1e-12)
    by_block = [np.flatnonzero(b == BLOCK) for b in np.unique(BLOCK)]
    stacked = np.vstack([COLUMNS[rows] for rows in by_block])
    order = np.concatenate(by_block)
    spread = block_diag(*[np.ones((len(rows), len(rows))) for rows in by_block])
    for j in range(2):
        alone = np.where(spread > 0, np.outer(stacked[:, j], stacked[:, j]), 0.0)
        assert shared.traces()[j] == pytest.approx(np.trace(inverse[np.ix_(order, order)] @ alone), rel=1e-12)


def test_what_joints_feel_of_rows_adds_up_over_each_block(shared):
    felt = shared.joint_errors(ROWS)
    expected = [COLUMNS[b == BLOCK].T @ ROWS[b == BLOCK] for b in np.unique(BLOCK)]
    np.testing.assert_allclose(felt, expected, atol=1e-12)


def test_without_columns_nothing_changes():
    none = SharedError(np.zeros((9, 2)), BLOCK)
    np.testing.assert_array_equal(none.whiten(ROWS), ROWS)
    assert none.log_determinant() == 0.0
