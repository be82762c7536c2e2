"""The rank of the identification Jacobian, with the gap of singular values that shows it.

Columns are scaled first, so that metres and radians can be compared. The scale is the parameters' sigma where it
matters how far the target moves by an error of the expected size. It is the column's length where it only matters
whether the target moves (`unit_columns`): sigmas that differ by a factor of a million would hide small columns.
The Jacobian is exact to about 1e-12 of its largest entry, so singular values below 1e-9 of the largest count as zero.
The gap around this threshold is reported.

The parameters to hold, so that the rest is determined, are found by the paper's elimination, made repeatable.
While the Jacobian has more columns than rank, one column is dropped: among those whose removal keeps the rank, the one
that leaves the smallest condition number. Without full rank that number is rounding noise, so here it is the ratio of
the largest to the smallest non-zero singular value.

Any column of a dependent group may be dropped: every valid choice predicts the same positions. The choices differ only
in rounding, and the condition number depends on the scales of columns. So condition numbers within a factor `TIE`
count as equal, and the first tied name in the robot description's `elimination_order` is dropped. If it names none of
them, the smallest condition number decides. If these are equal too (to six digits, so that every machine agrees), the
last parameter is dropped.

Reference: joubair2015, section Identification.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray, ReadOnlyArrays, hold
from calib.core.numerics import linalg

_AT_ONCE = 1 << 14  # rows of one factorisation
_BLOCK = 32  # columns of a block in a factorisation
_EXACT = 1e-6  # least 1 / condition of a factor of J^T J that is exact enough
MANY_COLUMNS = 128
"""From this number of columns, J^T J is factorised (Cholesky) and not J (QR), if that is exact enough."""
RANK_TOLERANCE = 1e-9
"""Singular values of the scaled Jacobian below this part of the largest count as zero."""
CLEAR_GAP = 30.0
"""The rank depends on the threshold if the singular values around it differ by a smaller factor."""
NO_EFFECT = 1e-7
"""A column shorter than this part of the longest is only rounding (lengths in metres and radians)."""
TIE = 2.0
"""Condition numbers within this factor of the smallest are equally good."""
_DIGITS = 1e-6  # condition numbers with a smaller relative difference are the same
_is_above = cache(lambda n_rows, n_columns: np.tri(n_columns, n_rows, dtype=bool).T)  # mask of the upper triangle


@dataclass(frozen=True, eq=False)
class Rank(ReadOnlyArrays):
    """Rank of a Jacobian and how clearly it stands out.

    Attributes:
        rank: Number of singular values above the threshold.
        singular_values: Singular values of the scaled Jacobian, largest first, (n_columns,); 0 where rows are fewer.
        threshold: Largest singular value that counts as zero.
        smallest_kept: Smallest singular value above the threshold; NaN when the rank is 0.
        largest_dropped: Largest singular value below the threshold; 0 at full rank.
    """

    rank: int
    n_columns: int
    singular_values: FloatArray
    threshold: float
    smallest_kept: float
    largest_dropped: float

    @property
    def unclear(self) -> bool:
        """Whether no clear gap lies at the threshold, so that the rank is uncertain."""
        below = self.largest_dropped if self.rank < self.n_columns else self.threshold
        return self.rank > 0 and self.smallest_kept < CLEAR_GAP * below

    @property
    def doubt(self) -> str:
        """Message that the rank is unclear, and why; empty where it is clear."""
        if not self.unclear:
            return ""
        above = f"singular value {self.rank} ({self.smallest_kept:.2e})"
        if self.rank == self.n_columns:
            return f"no clear gap: {above} is hardly above the threshold ({self.threshold:.1e}), and may count as zero"
        return (
            f"no clear gap: {above} and the next ({self.largest_dropped:.2e}) lie within a factor {CLEAR_GAP:g} about"
            f" the threshold ({self.threshold:.1e}), so that more or fewer combinations may be determined"
        )

    def __str__(self) -> str:
        text = f"rank {self.rank} of {self.n_columns}"
        if self.rank and self.rank < self.n_columns:
            text += (
                f" (gap: singular value {self.rank} is {self.smallest_kept:.2e}, the next {self.largest_dropped:.2e},"
                f" threshold {self.threshold:.1e})"
            )
        elif self.rank:
            text += f" (smallest singular value {self.smallest_kept:.2e}, threshold {self.threshold:.1e})"
        return text


def reduce_rows(rows: FloatArray, right: FloatArray | None = None) -> FloatArray:
    """Return at most n_columns rows with the same singular values and null space: the R of a QR factorisation.

    Rows are (n_rows, n_columns); `right` is one more column, (n_rows,). Very many are reduced part by part, so that no
    copy of all is made. On tall matrices LAPACK's `geqrt` takes half to three quarters of the time of `geqrf`, which
    NumPy calls.
    """
    return extend_reduced(np.zeros((0, rows.shape[1] + (right is not None))), rows, right)


def extend_reduced(factor: FloatArray, rows: FloatArray, right: FloatArray | None = None) -> FloatArray:
    """Return the factor after adding further rows.

    Args:
        factor: Result of `reduce_rows` for the rows so far, (n, n_columns), or with `right` (n, n_columns + 1).
        rows: Further rows, (n_rows, n_columns).
        right: One more column of the further rows, (n_rows,).
    """
    for start in range(0, len(rows), _AT_ONCE):
        part = slice(start, start + _AT_ONCE)
        above = len(factor)
        more = np.empty((above + len(rows[part]), factor.shape[1]), order="F")  # LAPACK's order: not copied again
        more[:above], more[above:, : rows.shape[1]] = factor, rows[part]
        if right is not None:
            more[above:, -1] = right[part]
        n = min(more.shape)
        block = min(n, _BLOCK)
        if n:
            more = scipy.linalg.lapack.dgeqrt(block, more, overwrite_a=1)[0]
        factor = np.where(_is_above(n, more.shape[1]), more[:n], 0.0)
    return factor


def factor_products(products: FloatArray) -> FloatArray | None:
    """Return the triangular factor R with R^T R = products, (n, n), written over them.

    It is None where it would lose too many digits.
    """
    upper, failed = scipy.linalg.lapack.dpotrf(products.T, overwrite_a=1)  # LAPACK's order: not copied
    hold(products, upper)  # of which `upper` is a view
    return None if failed or scipy.linalg.lapack.dtrcon(upper)[0] < _EXACT else np.asarray(upper)


def inverse_of_triangle(upper: FloatArray) -> FloatArray:
    """Return the inverse of an upper triangular matrix, (n, n)."""
    return np.asarray(scipy.linalg.lapack.dtrtri(upper)[0])


def square_of_triangle(upper: FloatArray) -> FloatArray:
    """Return T T^T of an upper triangular T, (n, n): a third of the work of any other product."""
    half = np.triu(scipy.linalg.lapack.dlauum(upper)[0])
    return np.asarray(half + np.triu(half, 1).T)


def unit_columns(columns: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return columns over their length, and the divisors (n_columns,); rounding errors of the longest one become zero.

    Columns are derivatives by metres and radians, not scaled, (n_rows, n_columns). The divisor of those that become
    zero is the length of the longest one.
    """
    lengths = np.sqrt(np.einsum("ij,ij->j", columns, columns))  # numpy's norm would copy them twice
    longest = float(np.max(lengths, initial=0.0))
    has_effect = lengths > NO_EFFECT * longest
    lengths = np.where(has_effect, lengths, longest or 1.0)
    return columns / np.where(has_effect, lengths, np.inf), lengths


def numerical_rank(scaled_jacobian: FloatArray) -> Rank:
    """Return the rank of a Jacobian whose columns are scaled, (n_rows, n_columns)."""
    return rank_of(linalg.singular_values(scaled_jacobian), scaled_jacobian.shape[1])


def rank_of(singular_values: FloatArray, n_columns: int) -> Rank:
    """Return the rank of a matrix with these singular values, (n,), largest first, and `n_columns` columns."""
    values = np.zeros(n_columns)
    values[: len(singular_values)] = singular_values
    threshold = RANK_TOLERANCE * float(values[0]) if n_columns else 0.0
    rank = int(np.sum(values > threshold))
    return Rank(
        rank,
        n_columns,
        values,
        threshold,
        float(values[rank - 1]) if rank else float("nan"),
        float(values[rank]) if rank < n_columns else 0.0,
    )


@dataclass(frozen=True)
class Elimination:
    """A set of columns to hold.

    Attributes:
        dropped: Columns in the order in which they were dropped.
        conditions: Condition number after each was dropped.
    """

    dropped: tuple[int, ...]
    conditions: tuple[float, ...]


def eliminate(scaled_jacobian: FloatArray, order: Sequence[int] = ()) -> Elimination:
    """Drop columns until the rest is independent.

    Args:
        scaled_jacobian: Columns that can be compared, such as unit columns, (n_rows, n_columns).
        order: Columns to drop first where condition numbers tie.
    """
    factor = reduce_rows(scaled_jacobian)
    rank = numerical_rank(factor)
    columns = list(range(factor.shape[1]))
    dropped: list[int] = []
    conditions: list[float] = []
    while len(columns) > rank.rank:
        condition_of = _conditions(factor, columns, rank.rank, rank.threshold)
        column = _choose(condition_of, order)
        columns.remove(column)
        dropped.append(column)
        conditions.append(condition_of[column])
    return Elimination(tuple(dropped), tuple(conditions))


def _conditions(factor: FloatArray, columns: list[int], rank: int, threshold: float) -> dict[int, float]:
    """Condition number, over non-zero singular values, after dropping each column that the rank does not need."""
    condition_of = {}
    for column in columns:
        rest = [other for other in columns if other != column]
        values = linalg.singular_values(factor[:, rest])
        if rank == 0 or values[rank - 1] > threshold:
            condition_of[column] = float(values[0] / values[rank - 1]) if rank else 1.0
    return condition_of


def _choose(condition_of: dict[int, float], order: Sequence[int]) -> int:
    smallest = min(condition_of.values())
    ties = {column for column, condition in condition_of.items() if condition <= TIE * (1 + _DIGITS) * smallest}
    for column in order:
        if column in ties:
            return column
    return max(column for column, condition in condition_of.items() if condition <= (1 + _DIGITS) * smallest)
