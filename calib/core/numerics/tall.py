"""Matrices of very many rows, of which no more is ever there than is looked at."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from copy import copy
from functools import cached_property

import numpy as np

from calib.core.base.arrays import FloatArray, IntArray
from calib.core.numerics.identifiability import reduced, reduced_with
from calib.core.numerics.prior import Prior

ROWS_AT_ONCE = 1 << 13
_KEPT = 1 << 15  # rows that a product of rows may have to be kept
Places = IntArray | slice
"""Which rows."""


class Tall:
    """A matrix whose rows are made where they are looked at, perhaps above those of a prior.

    Args:
        shape: Of the matrix, without a prior.
        parts: Makes its rows: yields their places, and the rows, (n_of_part, n_columns).
        is_cut: Whether there is more than one part.
    """

    def __init__(
        self, shape: tuple[int, int], parts: Callable[[], Iterable[tuple[Places, FloatArray]]], *, is_cut: bool = True
    ) -> None:
        self.shape, self._parts, self.is_cut = shape, parts, is_cut
        self._factor: Callable[[], FloatArray] | None = None
        self._products: Callable[[], tuple[FloatArray, FloatArray]] | None = None
        self._prior: Prior | None = None

    @staticmethod
    def of(matrix: FloatArray | Tall) -> Tall:
        """Return a matrix (n_rows, n_columns) that is there as a whole as such a one."""
        if isinstance(matrix, Tall):
            return matrix
        return Tall((len(matrix), matrix.shape[1]), lambda: [(slice(len(matrix)), matrix)], is_cut=False)

    def with_known(
        self,
        factor: Callable[[], FloatArray] | None = None,
        products: Callable[[], tuple[FloatArray, FloatArray]] | None = None,
    ) -> Tall:
        """Return it with what is known of it and the residuals r beside it, made where it is asked for.

        Args:
            factor: Returns the triangular factor of [J r], (n + 1, n + 1) or fewer rows.
            products: Returns J^T J (n, n) and J^T r (n,).
        """
        result = copy(self)
        result._factor, result._products = factor, products
        return result

    def above(self, prior: Prior) -> Tall:
        """Return it above the rows P of a prior of its columns, which are hardly more than ones."""
        result = copy(self)
        result._prior, result.shape = prior, (self.shape[0] + len(prior.rows), self.shape[1])
        return result

    def _below(self) -> Iterator[tuple[Places, FloatArray]]:
        if self._prior is not None:
            yield slice(self.shape[0] - len(self._prior.rows), None), self._prior.rows

    def parts(self) -> Iterator[tuple[Places, FloatArray]]:
        """Yield places of rows, and the rows, (n_of_part, n_columns)."""
        yield from self._parts()
        yield from self._below()

    def whole(self) -> FloatArray:
        """Return all rows, (n_rows, n_columns)."""
        if not self.is_cut:
            together = [rows for _, rows in self.parts()]
            return together[0] if len(together) == 1 else np.vstack(together)
        result: FloatArray = np.empty(self.shape)
        for places, rows in self.parts():
            result[places] = rows
        return result

    def factor(self, right: FloatArray | None = None) -> FloatArray:
        """Return the triangular factor of the matrix, with one more column (n_rows,) if given, (n, n)."""
        if not self.is_cut:
            return reduced(self.whole(), right)
        factor: FloatArray = np.zeros((0, self.shape[1] + (right is not None)))
        if self._factor is not None:
            factor = self._factor() if right is not None else self._factor()[: self.shape[1], :-1]
        for places, rows in self.parts() if self._factor is None else self._below():
            factor = reduced_with(factor, rows, None if right is None else right[places])
        return factor

    def products(self, right: FloatArray) -> FloatArray:
        """Return the products of its columns and one more (n_rows,) with each other, (n, n)."""
        n = self.shape[1]
        products = np.zeros((n + 1, n + 1))
        if self._products is not None:
            products[:n, :n], products[:n, n] = self._products()
        else:
            for places, rows in self._parts():
                products[:n, :n] += rows.T @ rows
                products[:n, n] += rows.T @ right[places]
        if self._prior is not None:
            self._prior.added_to(products[:n, :n])
            products[:n, n] += self._prior.rows.T @ right[len(right) - len(self._prior.rows) :]
        products[n, :n], products[n, n] = products[:n, n], right @ right
        return products

    def times(self, column: FloatArray) -> FloatArray:
        """Return the product with a column (n_columns,), (n_rows,)."""
        result = np.empty(self.shape[0])
        for places, rows in self.parts():
            result[places] = rows @ column
        return result

    def pulled(self, column: FloatArray) -> FloatArray:
        """Return the product of its transpose with a column (n_rows,), (n_columns,)."""
        return np.asarray(sum(rows.T @ column[places] for places, rows in self.parts()))

    def lengths(self) -> FloatArray:
        """Return the length of each column, (n_columns,)."""
        return np.sqrt(sum(np.einsum("ij,ij->j", rows, rows) for _, rows in self.parts()))


class Span:
    """U = J T of a tall J (n_rows, n) and a small T (n, k), looked at some rows at a time, and further columns.

    Args:
        jacobian: J.
        root: T.
        more: The further columns, (n_rows, n_more); none if not given.
    """

    def __init__(self, jacobian: FloatArray, root: FloatArray, more: FloatArray | None = None) -> None:
        self.jacobian, self.root, self.more = jacobian, root, more
        self.shape = len(jacobian), root.shape[1] + (0 if more is None else more.shape[1])

    @cached_property
    def _whole(self) -> FloatArray:
        return self.jacobian @ self.root

    def __getstate__(self) -> dict[str, object]:  # what is kept does not go to other processes
        return {name: value for name, value in vars(self).items() if name != "_whole"}

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, rows: Places) -> FloatArray:
        """Return some rows, (..., k)."""
        if len(self) <= _KEPT:
            known = self._whole[rows]
        else:  # as one matrix: T is read once, not for every block of rows
            some = self.jacobian[rows]
            known = (some.reshape(-1, some.shape[-1]) @ self.root).reshape(*some.shape[:-1], self.root.shape[1])
        return known if self.more is None else np.concatenate([known, self.more[rows]], axis=-1)

    def beside(self, more: FloatArray) -> Span:
        """Return it with further columns, (n_rows, n_more)."""
        return Span(self.jacobian, self.root, more if self.more is None else np.hstack([self.more, more]))

    def times(self, columns: FloatArray) -> FloatArray:
        """Return U times columns (k, ...), (n_rows, ...)."""
        n = self.root.shape[1]
        known = self.jacobian @ (self.root @ columns[:n])
        return np.asarray(known if self.more is None else known + self.more @ columns[n:])

    def pulled(self, columns: FloatArray) -> FloatArray:
        """Return U^T times columns (n_rows, ...), (k, ...)."""
        known = self.root.T @ (self.jacobian.T @ columns)
        return known if self.more is None else np.concatenate([known, self.more.T @ columns])


def in_parts(n_rows: int, at_once: int = ROWS_AT_ONCE) -> Iterator[slice]:
    """Yield which rows to look at together, one part after another; none of no rows."""
    return (slice(start, min(start + at_once, n_rows)) for start in range(0, n_rows, at_once))


def squares_of_rows(matrix: FloatArray | Span) -> FloatArray:
    """Return the sum of the squares of each row, (n_rows,)."""
    result = np.empty(len(matrix))
    for part in in_parts(len(matrix)):
        rows = matrix[part]
        result[part] = np.einsum("ij,ij->i", rows, rows)
    return result
