"""Which parameters move together without moving any measured position, in the smallest groups.

The null space of the scaled Jacobian says which changes of parameters no measurement sees. Any basis of it from an SVD
mixes everything with everything. What a reader wants are its vectors with the fewest non-zero entries: "xb with dq1",
"d5 with xt", "d31 has no effect". Parameters that share no null vector are separated first, by the pattern of the
projector onto the null space; in each part `calib.numerics.elementary_vectors` finds the shortest basis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from calib.arrays import FloatArray, IntArray, ReadOnlyArrays
from calib.numerics.elementary_vectors import ZERO, shortest_basis
from calib.numerics.identifiability import numerical_rank, reduced
from calib.parameter import Parameter
from calib.units import PER_SI

_SPEAKS = 0.1  # least part of the largest movement, in sigmas, of the parameter by which a group is told


@dataclass(frozen=True, eq=False)
class Group(ReadOnlyArrays):
    """Parameters that move together unseen.

    Attributes:
        members: Column indices; the one that speaks for the group comes first.
        coefficients: How much each moves when the first moves by one sigma, in sigmas, (n_members,); the first is 1.
    """

    members: tuple[int, ...]
    coefficients: FloatArray


def null_groups(
    scaled_jacobian: FloatArray, dropped: Sequence[int] = (), lengths: FloatArray | None = None
) -> tuple[Group, ...]:
    """Return a basis of the null space of smallest groups, shortest first.

    Args:
        scaled_jacobian: (n_rows, n_columns).
        dropped: Columns that are held or dropped. Groups are told with one of them first where one moves enough, and
            with as few others of them as possible.
        lengths: What each column was divided by after it was scaled by its sigma, (n_columns,); 1 if not given.
    """
    null = _null_space(scaled_jacobian)
    projector = null @ null.T
    count, label = scipy.sparse.csgraph.connected_components(
        scipy.sparse.csr_matrix(np.abs(projector) > ZERO), directed=False
    )
    vectors: list[FloatArray] = []
    for k in range(count):
        columns = np.flatnonzero(label == k)
        if np.max(np.abs(projector[np.ix_(columns, columns)])) > ZERO:
            vectors += _part(null, columns, set(dropped))
    if lengths is not None:
        vectors = [vector / lengths for vector in vectors]
    groups = [_group(vector, set(dropped)) for vector in vectors]
    return tuple(sorted(groups, key=lambda group: (len(group.members), group.members)))


def describe_group(group: Group, parameters: Sequence[Parameter]) -> str:
    """Return a group in words, such as `xb with dq1: xb +1 mm, dq1 -1 mm`.

    Args:
        group: Of `null_groups`.
        parameters: The parameters of the columns.
    """
    first = parameters[group.members[0]]
    if len(group.members) == 1:
        return f"{first.name} has no effect"
    names = [parameters[k].name for k in group.members]
    moves = []
    for name, amount, unit in natural_coefficients(group, parameters):
        moves.append(f"{name} {amount:+.4g} {unit}")
    return f"{first.name} with {', '.join(names[1:])}: " + ", ".join(moves)


def natural_coefficients(group: Group, parameters: Sequence[Parameter]) -> list[tuple[str, float, str]]:
    """Return (name, movement, unit) of each member when the first moves by one of its own unit (mm or deg)."""
    members = [parameters[k] for k in group.members]
    sizes = [c * p.sigma * PER_SI[p.dimension][p.unit] for c, p in zip(group.coefficients, members, strict=True)]
    return [(p.name, float(size / sizes[0]), p.unit) for p, size in zip(members, sizes, strict=True)]


def _null_space(scaled_jacobian: FloatArray) -> FloatArray:
    """Orthonormal basis, (n_columns, nullity)."""
    factor = reduced(scaled_jacobian)
    result: FloatArray = np.linalg.svd(factor)[2][numerical_rank(factor).rank :].T
    return result


def _part(null: FloatArray, columns: IntArray, dropped: set[int]) -> list[FloatArray]:
    """Shortest basis of the null vectors that live on `columns`."""
    u, s, _ = np.linalg.svd(null[columns], full_matrices=False)
    basis = u[:, s > 0.5]  # the columns are a whole part, so s is 1 or 0
    found = shortest_basis(basis, np.isin(columns, list(dropped)))
    result = np.zeros((len(found), len(null)))
    result[:, columns] = found
    return list(result)


def _group(vector: FloatArray, dropped: set[int]) -> Group:
    members = [int(k) for k in np.flatnonzero(vector)]
    size = np.abs(vector)
    # one that hardly moves would have to move by metres or turns to show what the others do
    moving = [k for k in members if size[k] >= (1 - ZERO) * _SPEAKS * size.max()]
    first = next((k for k in moving if k in dropped), moving[0])
    members.remove(first)
    ordered = (first, *members)
    return Group(ordered, vector[list(ordered)] / vector[first])
