"""The product of a matrix of very many rows with a small one, computed in parts."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

import numpy as np

from calib.core.base.arrays import FloatArray, IntArray

ROWS_AT_ONCE = 1 << 13
KEPT = 1 << 15
"""A product is kept if it has at most this many rows."""


class Span:
    """U = J T of a tall J (n_rows, n) and a small T (n, k), computed for some rows at a time, and further columns.

    Args:
        jacobian: J.
        root: T.
        more: Further columns, (n_rows, n_more); none if not given.
    """

    def __init__(self, jacobian: FloatArray, root: FloatArray, more: FloatArray | None = None) -> None:
        self.jacobian, self.root, self.more = jacobian, root, more
        self.shape = len(jacobian), root.shape[1] + (0 if more is None else more.shape[1])

    @cached_property
    def _whole(self) -> FloatArray:
        return self.jacobian @ self.root

    def __getstate__(self) -> dict[str, object]:  # cached values do not go to other processes
        return {name: value for name, value in vars(self).items() if name != "_whole"}

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, rows: IntArray | slice) -> FloatArray:
        """Return some rows, (..., k)."""
        if len(self) <= KEPT:
            known = self._whole[rows]
        else:  # as one matrix: T is read once, not for every block of rows
            some = self.jacobian[rows]
            known = (some.reshape(-1, some.shape[-1]) @ self.root).reshape(*some.shape[:-1], self.root.shape[1])
        return known if self.more is None else np.concatenate([known, self.more[rows]], axis=-1)

    def with_columns(self, more: FloatArray) -> Span:
        """Return U with further columns, (n_rows, n_more)."""
        wider = Span(self.jacobian, self.root, more if self.more is None else np.hstack([self.more, more]))
        if "_whole" in vars(self):  # computed once for both
            wider._whole = self._whole
        return wider

    def times(self, columns: FloatArray) -> FloatArray:
        """Return U times columns (k, ...), (n_rows, ...)."""
        n = self.root.shape[1]
        known = self.jacobian @ (self.root @ columns[:n])
        return np.asarray(known if self.more is None else known + self.more @ columns[n:])

    def transposed_product(self, columns: FloatArray) -> FloatArray:
        """Return U^T times columns (n_rows, ...), (k, ...)."""
        known = self.root.T @ (self.jacobian.T @ columns)
        return known if self.more is None else np.concatenate([known, self.more.T @ columns])


def slices(n_rows: int, at_once: int = ROWS_AT_ONCE) -> Iterator[slice]:
    """Yield slices of rows to be computed together; none without rows."""
    return (slice(start, min(start + at_once, n_rows)) for start in range(0, n_rows, at_once))


def squares_of_rows(matrix: FloatArray | Span) -> FloatArray:
    """Return the sum of the squares of each row, (n_rows,)."""
    result = np.empty(len(matrix))
    for part in slices(len(matrix)):
        rows = matrix[part]
        result[part] = np.einsum("ij,ij->i", rows, rows)
    return result
