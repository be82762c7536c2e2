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
    """A matrix whose rows are made where they are looked at.

    Args:
        shape: Of the matrix.
        parts: Makes its rows: yields their places, and the rows, (n_of_part, n_columns).
        is_cut: Whether there is more than one part.
    """

    def __init__(
        self, shape: tuple[int, int], parts: Callable[[], Iterable[tuple[Places, FloatArray]]], *, is_cut: bool = True
    ) -> None:
        self.shape, self.parts, self.is_cut = shape, parts, is_cut

    @staticmethod
    def of(matrix: FloatArray | Tall) -> Tall:
        """Return a matrix (n_rows, n_columns) that is there as a whole as such a one."""
        if isinstance(matrix, Tall):
            return matrix
        return Tall((len(matrix), matrix.shape[1]), lambda: [(slice(None), matrix)], is_cut=False)

    def whole(self) -> FloatArray:
        """Return all rows, (n_rows, n_columns)."""
        result: FloatArray = np.empty(self.shape if self.is_cut else (0, 0))
        for places, rows in self.parts():
            if not self.is_cut:
                return rows
            result[places] = rows
        return result

    def factor(self, right: FloatArray | None = None) -> FloatArray:
        """Return the triangular factor of the matrix, with one more column (n_rows,) if given, (n, n)."""
        factor: FloatArray = np.zeros((0, self.shape[1] + (right is not None)))
        for places, rows in self.parts():
            factor = reduced_with(factor, rows, None if right is None else right[places])
        return factor

    def products(self, right: FloatArray) -> FloatArray:
        """Return the products of its columns and one more (n_rows,) with each other, (n, n)."""
        n = self.shape[1]
        products = np.zeros((n + 1, n + 1))
        for places, rows in self.parts():
            products[:n, :n] += rows.T @ rows
            products[:n, n] += rows.T @ right[places]
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


class Multiplied(Tall):
    """Rows whose products with each other, and with the residuals beside them, are known where they are asked for.

    Args:
        rows: The rows, J.
        known: Returns J^T J (n, n) and J^T r (n,).
    """

    def __init__(self, rows: Tall, known: Callable[[], tuple[FloatArray, FloatArray]]) -> None:
        super().__init__(rows.shape, rows.parts, is_cut=rows.is_cut)
        self._known = known

    def products(self, right: FloatArray) -> FloatArray:
        """Return the products of its columns and the residuals (n_rows,); see `Tall.products`."""
        gram, pull = self._known()
        return np.block([[gram, pull[:, None]], [pull, right @ right]])


class Factored(Tall):
    """Very many rows whose triangular factor, with the residuals beside them, is known where it is asked for.

    Args:
        rows: The rows, J.
        known: Returns the triangular factor of [J r], (n + 1, n + 1) or fewer rows.
    """

    def __init__(self, rows: Tall, known: Callable[[], FloatArray]) -> None:
        super().__init__(rows.shape, rows.parts, is_cut=rows.is_cut)
        self._known = known

    def factor(self, right: FloatArray | None = None) -> FloatArray:
        """Return the triangular factor, of the rows and the residuals (n_rows,) if given; see `Tall.factor`."""
        return self._known() if right is not None else self._known()[: self.shape[1], :-1]


class AbovePrior(Tall):
    """Rows above those of a prior, P, which are hardly more than ones.

    Args:
        rows: The rows.
        prior: Of their columns.
    """

    def __init__(self, rows: Tall, prior: Prior) -> None:
        self._rows, self._prior, n = rows, prior, rows.shape[0]

        def parts() -> Iterator[tuple[Places, FloatArray]]:
            for places, part in rows.parts():
                yield places if rows.is_cut else slice(n), part
            yield slice(n, None), prior.rows

        super().__init__((n + len(prior.rows), rows.shape[1]), parts)

    def factor(self, right: FloatArray | None = None) -> FloatArray:
        """Return the triangular factor; see `Tall.factor`. Of few rows, it is found at once."""
        if self._rows.is_cut:
            n = self._rows.shape[0]
            factor = self._rows.factor(None if right is None else right[:n])
            return reduced_with(factor, self._prior.rows, None if right is None else right[n:])
        return reduced(np.vstack([self._rows.whole(), self._prior.rows]), right)

    def products(self, right: FloatArray) -> FloatArray:
        """Return the products of its columns and one more; see `Tall.products`."""
        n_rows, n = self._rows.shape
        products = self._rows.products(right[:n_rows])
        self._prior.added_to(products[:n, :n])
        products[:n, n] += self._prior.rows.T @ right[n_rows:]
        products[n, :n], products[n, n] = products[:n, n], right @ right
        return products


class _Product:
    """J T, kept where that is no larger than `_KEPT` rows, else multiplied where rows of it are looked at."""

    def __init__(self, jacobian: FloatArray, root: FloatArray) -> None:
        self.jacobian, self.root = jacobian, root

    @cached_property
    def _whole(self) -> FloatArray:
        return self.jacobian @ self.root

    def __getitem__(self, rows: Places) -> FloatArray:
        if len(self.jacobian) <= _KEPT:
            return self._whole[rows]
        some = self.jacobian[rows]  # as one matrix: T is read once, not for every block of rows
        return (some.reshape(-1, some.shape[-1]) @ self.root).reshape(*some.shape[:-1], self.root.shape[1])

    def __reduce__(self) -> tuple[type, tuple[FloatArray, FloatArray]]:
        return _Product, (self.jacobian, self.root)  # what is kept does not go to other processes


class Span:
    """U = J T of a tall J (n_rows, n) and a small T (n, k), looked at some rows at a time.

    Args:
        jacobian: J.
        root: T.
    """

    def __init__(self, jacobian: FloatArray, root: FloatArray) -> None:
        self.jacobian, self.root = jacobian, root
        self.shape = len(jacobian), root.shape[1]
        self.more: FloatArray | None = None
        self._product = _Product(jacobian, root)

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, rows: Places) -> FloatArray:
        """Return some rows, (..., k)."""
        known = self._product[rows]
        return known if self.more is None else np.concatenate([known, self.more[rows]], axis=-1)

    def beside(self, more: FloatArray) -> Span:
        """Return it with further columns, (n_rows, n_more)."""
        wider = copy(self)
        wider.more = more if self.more is None else np.hstack([self.more, more])
        wider.shape = len(self), self.root.shape[1] + wider.more.shape[1]
        return wider

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
