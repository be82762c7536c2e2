"""Matrices in parts: the same as whole ones."""

import pickle

import numpy as np
import pytest

from calib.core.numerics import tall as tall_matrices
from calib.core.numerics.identifiability import reduced
from calib.core.numerics.prior import Prior
from calib.core.numerics.tall import Span, Tall, in_parts, squares_of_rows


@pytest.fixture
def matrix():
    return np.random.default_rng(0).standard_normal((50, 4))


def cut(matrix):
    """A matrix in three parts, one of which is not in a row."""
    places = [slice(0, 7), np.array([9, 7, 8]), slice(10, 50)]
    return Tall(matrix.shape, lambda: ((part, matrix[part]) for part in places))


def test_products_and_lengths_are_those_of_the_whole(matrix):
    right = np.random.default_rng(1).standard_normal(50)
    for tall in (cut(matrix), Tall.of(matrix), Tall.of(cut(matrix))):
        np.testing.assert_allclose(tall.times(right[:4]), matrix @ right[:4], atol=1e-12)
        np.testing.assert_allclose(tall.pulled(right), matrix.T @ right, atol=1e-12)
        np.testing.assert_allclose(tall.lengths(), np.linalg.norm(matrix, axis=0), rtol=1e-12)
        np.testing.assert_array_equal(tall.whole(), matrix)


def test_the_triangular_factor_has_the_same_products(matrix):
    right = np.random.default_rng(1).standard_normal(50)
    factor, whole = cut(matrix).factor(right), np.column_stack([matrix, right])
    assert factor.shape == (5, 5)
    np.testing.assert_allclose(factor.T @ factor, whole.T @ whole, atol=1e-12)
    np.testing.assert_allclose(cut(matrix).products(right), whole.T @ whole, atol=1e-12)
    np.testing.assert_allclose(np.abs(cut(matrix).factor()), np.abs(reduced(matrix)), atol=1e-12)


def test_rows_above_a_prior_are_those_of_both(matrix):
    prior = Prior(np.array([True, False, True, True]), np.array([2, 3]), np.array([[1.0, 0.5], [0.5, 1.0]]))
    whole, right = np.vstack([matrix, prior.rows]), np.random.default_rng(1).standard_normal(53)
    both = np.column_stack([whole, right])
    products = cut(matrix).with_known(products=lambda: (matrix.T @ matrix, matrix.T @ right[:50]))
    factored = cut(matrix).with_known(lambda: reduced(matrix, right[:50]))
    for tall in (rows.above(prior) for rows in (cut(matrix), Tall.of(matrix), products, factored)):
        np.testing.assert_array_equal(tall.whole(), whole)
        np.testing.assert_allclose(tall.times(right[:4]), whole @ right[:4], atol=1e-12)
        np.testing.assert_allclose(tall.pulled(right), whole.T @ right, atol=1e-12)
        np.testing.assert_allclose(tall.products(right), both.T @ both, atol=1e-12)
        factor = tall.factor(right)
        np.testing.assert_allclose(factor.T @ factor, both.T @ both, atol=1e-12)


@pytest.mark.parametrize("rows_kept", [0, 50], ids=["multiplied where it is looked at", "kept"])
def test_a_span_is_the_product_of_its_factors_and_what_stands_beside_it(matrix, rows_kept, monkeypatch):
    monkeypatch.setattr(tall_matrices, "_KEPT", rows_kept)
    rng = np.random.default_rng(2)
    root, more = rng.standard_normal((4, 3)), rng.standard_normal((50, 2))
    whole = np.hstack([matrix @ root, more])
    for span, same in ((Span(matrix, root), whole[:, :3]), (Span(matrix, root).beside(more), whole)):
        assert span.shape == same.shape
        np.testing.assert_allclose(span[:], same, atol=1e-12)
        np.testing.assert_allclose(span[np.array([[3, 1], [4, 4]])], same[[[3, 1], [4, 4]]], atol=1e-12)
        for columns in (rng.standard_normal(same.shape[1]), rng.standard_normal((same.shape[1], 2))):
            np.testing.assert_allclose(span.times(columns), same @ columns, atol=1e-12)
        for columns in (rng.standard_normal(50), rng.standard_normal((50, 2))):
            np.testing.assert_allclose(span.pulled(columns), same.T @ columns, atol=1e-12)
        np.testing.assert_allclose(squares_of_rows(span), np.sum(same**2, axis=1), rtol=1e-12)
    np.testing.assert_allclose(Span(matrix, root).beside(more[:, :1]).beside(more[:, 1:])[:], whole, atol=1e-12)


def test_what_a_span_keeps_is_not_sent_with_it(matrix):
    span = Span(matrix, np.eye(4))
    size = len(pickle.dumps(span))
    np.testing.assert_array_equal(span[:], matrix)
    assert len(pickle.dumps(span)) == size
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(span))[:], matrix)


def test_parts_hold_every_row_once():
    assert [list(range(10))[part] for part in in_parts(10, 4)] == [[0, 1, 2, 3], [4, 5, 6, 7], [8, 9]]
    assert list(in_parts(0)) == []
