"""Which parameters to hold so that the rest is determined: the paper's elimination, made repeatable.

While the Jacobian has more columns than rank, drop one: of all columns whose removal keeps the rank, the one that
leaves the smallest condition number. The condition number of a matrix that is short of rank is rounding noise, so here
it is taken over the non-zero singular values, largest over smallest.

Which columns of a dependent group go is free: any valid choice spans the same space, so it predicts the same
positions. The condition number only says which choice is stated with the least rounding, and it depends on how columns
are scaled. A difference of less than a factor `TIE` therefore counts as a tie, and the robot description's
`elimination_order` breaks it: the first name in it that ties goes. Where it names none of them, the smallest condition
number decides, and among equal ones (to six digits, so that every machine agrees) the later parameter.

Reference: Joubair, Zhao, Bigras and Bonev 2015, section Identification.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.arrays import FloatArray
from calib.numerics.identifiability import numerical_rank, reduced

TIE = 2.0
"""Condition numbers within this factor of the smallest are equally good."""
_DIGITS = 1e-6  # relative difference of condition numbers below which they are the same number


@dataclass(frozen=True)
class Elimination:
    """A set of parameters to hold.

    Attributes:
        dropped: Columns in the order in which they went.
        conditions: Condition number that each left behind.
        kept: The columns that stay, as many as the rank, ascending.
    """

    dropped: tuple[int, ...]
    conditions: tuple[float, ...]
    kept: tuple[int, ...]


def eliminate(scaled_jacobian: FloatArray, order: Sequence[int] = ()) -> Elimination:
    """Drop columns until the rest is independent.

    Args:
        scaled_jacobian: Columns that can be compared, such as unit columns, (n_rows, n_columns).
        order: Columns to prefer for dropping where condition numbers tie, first one first.
    """
    factor = reduced(scaled_jacobian)
    rank = numerical_rank(factor)
    columns = list(range(factor.shape[1]))
    dropped: list[int] = []
    conditions: list[float] = []
    while len(columns) > rank.rank:
        found = _conditions(factor, columns, rank.rank, rank.threshold)
        column = _choose(found, order)
        columns.remove(column)
        dropped.append(column)
        conditions.append(found[column])
    return Elimination(tuple(dropped), tuple(conditions), tuple(columns))


def _conditions(factor: FloatArray, columns: list[int], rank: int, threshold: float) -> dict[int, float]:
    """Condition number over the non-zero singular values after dropping each column that the rank can do without."""
    found = {}
    for column in columns:
        rest = [other for other in columns if other != column]
        values = np.linalg.svd(factor[:, rest], compute_uv=False)
        if rank == 0 or values[rank - 1] > threshold:
            found[column] = float(values[0] / values[rank - 1]) if rank else 1.0
    return found


def _choose(found: dict[int, float], order: Sequence[int]) -> int:
    smallest = min(found.values())
    ties = {column for column, condition in found.items() if condition <= TIE * (1 + _DIGITS) * smallest}
    for column in order:
        if column in ties:
            return column
    return max(column for column, condition in found.items() if condition <= (1 + _DIGITS) * smallest)
