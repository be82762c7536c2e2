"""Products that are looked at in parts: the same as whole ones."""

import pickle

import numpy as np
import pytest

from calib.core.numerics import tall as tall_matrices
from calib.core.numerics.tall import Span, slices, squares_of_rows


@pytest.fixture
def matrix():
    return np.random.default_rng(0).standard_normal((50, 4))


@pytest.mark.parametrize("rows_kept", [0, 50], ids=["multiplied where it is looked at", "kept"])
def test_a_span_is_the_product_of_its_factors_and_what_stands_beside_it(matrix, rows_kept, monkeypatch):
    monkeypatch.setattr(tall_matrices, "KEPT", rows_kept)
    rng = np.random.default_rng(2)
    root, more = rng.standard_normal((4, 3)), rng.standard_normal((50, 2))
    whole = np.hstack([matrix @ root, more])
    for span, same in ((Span(matrix, root), whole[:, :3]), (Span(matrix, root).with_columns(more), whole)):
        assert span.shape == same.shape
        np.testing.assert_allclose(span[:], same, atol=1e-12)
        np.testing.assert_allclose(span[np.array([[3, 1], [4, 4]])], same[[[3, 1], [4, 4]]], atol=1e-12)
        for columns in (rng.standard_normal(same.shape[1]), rng.standard_normal((same.shape[1], 2))):
            np.testing.assert_allclose(span.times(columns), same @ columns, atol=1e-12)
        for columns in (rng.standard_normal(50), rng.standard_normal((50, 2))):
            np.testing.assert_allclose(span.transposed_product(columns), same.T @ columns, atol=1e-12)
        np.testing.assert_allclose(squares_of_rows(span), np.sum(same**2, axis=1), rtol=1e-12)
    np.testing.assert_allclose(
        Span(matrix, root).with_columns(more[:, :1]).with_columns(more[:, 1:])[:], whole, atol=1e-12
    )


def test_what_a_span_keeps_is_not_sent_with_it(matrix):
    span = Span(matrix, np.eye(4))
    size = len(pickle.dumps(span))
    np.testing.assert_array_equal(span[:], matrix)
    assert len(pickle.dumps(span)) == size
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(span))[:], matrix)


def test_parts_hold_every_row_once():
    assert [list(range(10))[part] for part in slices(10, 4)] == [[0, 1, 2, 3], [4, 5, 6, 7], [8, 9]]
    assert list(slices(0)) == []
