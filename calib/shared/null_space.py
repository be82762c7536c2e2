"""The smallest groups of parameters that move together without moving any measured position.

The null space of the scaled Jacobian contains the changes of parameters that no measurement sees. A basis from an SVD
mixes everything with everything. A reader understands vectors with few non-zero entries: "xb with dq1", "d5 with xt",
"d31 has no effect". Parameters that share no null vector are separated first, by the pattern of the projector onto the
null space; in each part the basis with the fewest non-zero entries is found.

A vector of the subspace whose support contains the support of no other is elementary; its support determines it up to
a factor. Taking elementary vectors in the order of their length, each that is independent of those before, gives a
basis that no other one beats (the greedy algorithm on a matroid).

Search. With Q an orthonormal basis of the complement, a support S carries a vector where the rows Q_S are dependent.
All supports of one entry are tried, then all of two, and so on, until the basis is complete: then it is proven to be
the shortest, and the same on every machine. Where there would be too many supports, linear programs find the rest:
elementary vectors are the vertices of {v in the subspace, |v|_1 <= 1}, so

    minimise  sum_i w_i |v_i|    subject to  v in the subspace,  v_j = 1

has an elementary vector as its solution for each entry j, often a short one. A second round with weights
w_i = 1 / (|v_i| + 0.1) finds shorter ones. Nothing proves then that no shorter basis exists.

Reference: rockafellar1969 (elementary vectors); edmonds1971 (greedy algorithm); candes2008 (reweighting).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, islice
from math import comb

import numpy as np
import scipy

from calib.core.base.arrays import BoolArray, FloatArray, IntArray, ReadOnlyArrays
from calib.core.base.parameter import Parameter
from calib.core.numerics import linalg
from calib.core.numerics.graphs import connected_parts
from calib.core.numerics.identifiability import rank_of, reduce_rows

_NAMES = 0.1  # a parameter can name a group if it moves at least this part of the largest movement, in sigmas
ZERO = 1e-6
"""Entries of a vector below this part of its largest are zero."""
_DEPENDENT = 1e-9  # rows of an orthonormal basis are dependent if their smallest singular value is less
_MOST_SUPPORTS = 60_000
_BATCH = 4096


@dataclass(frozen=True, eq=False)
class UnseenGroup(ReadOnlyArrays):
    """Parameters that move together unseen.

    Attributes:
        members: Column indices; the parameter that names the group comes first.
        coefficients: Motion of each when the first moves by one sigma, in sigmas, (n_members,); the first is 1.
    """

    members: tuple[int, ...]
    coefficients: FloatArray


def null_groups(
    scaled_jacobian: FloatArray, dropped: Sequence[int] = (), lengths: FloatArray | None = None
) -> tuple[UnseenGroup, ...]:
    """Return a basis of the null space of smallest groups, shortest first.

    Args:
        scaled_jacobian: (n_rows, n_columns).
        dropped: Columns that are held or dropped. A group names such a column first if it moves enough, and contains as
            few other columns of this kind as possible.
        lengths: Divisor of each column after it was scaled by its sigma, (n_columns,); 1 if not given.
    """
    factor = reduce_rows(scaled_jacobian)
    _, values, directions = linalg.svd(factor)
    null = directions[rank_of(values, factor.shape[1]).rank :].T
    projector = null @ null.T
    vectors: list[FloatArray] = []
    for columns in connected_parts(np.abs(projector) > ZERO):
        if np.max(np.abs(projector[np.ix_(columns, columns)])) > ZERO:
            vectors += _part(null, columns, set(dropped))
    if lengths is not None:
        vectors = [vector / lengths for vector in vectors]
    groups = [_group(vector, set(dropped)) for vector in vectors]
    return tuple(sorted(groups, key=lambda group: (len(group.members), group.members)))


def describe_group(group: UnseenGroup, parameters: Sequence[Parameter]) -> str:
    """Return the changes that look alike in words: `d41 + dq1 from d42 + xt`, or `1 deg of dq2 from 3 mm of yb`."""
    first = parameters[group.members[0]]
    if len(group.members) == 1:
        return f"{first.name} has no effect"
    members = natural_coefficients(group, parameters)
    equal = all(unit == first.unit and np.isclose(abs(amount), 1.0) for _, amount, unit in members)
    words = [name if equal else f"{abs(amount):.4g} {unit} of {name}" for name, amount, unit in members]
    up = [text for text, (_, amount, _) in zip(words, members, strict=True) if amount > 0]
    down = [text for text, (_, amount, _) in zip(words, members, strict=True) if amount <= 0]
    if not down:
        up, down = up[:1], [f"-{text}" for text in up[1:]]
    return f"{' + '.join(up)} from {' + '.join(down)}"


def natural_coefficients(group: UnseenGroup, parameters: Sequence[Parameter]) -> list[tuple[str, float, str]]:
    """Return (name, movement, unit) of each member when the first moves by one of its own unit (mm or deg)."""
    members = [parameters[k] for k in group.members]
    sizes = [c * p.sigma for c, p in zip(group.coefficients, members, strict=True)]
    return [(p.name, float(size / sizes[0]), p.unit) for p, size in zip(members, sizes, strict=True)]


def _part(null: FloatArray, columns: IntArray, dropped: set[int]) -> list[FloatArray]:
    """Shortest basis of the null vectors that are zero outside `columns`."""
    u, s, _ = linalg.svd(null[columns], full_matrices=False)
    basis = u[:, s > 0.5]  # the columns are a whole part, so s is 1 or 0
    vectors = shortest_basis(basis, np.isin(columns, list(dropped)))
    result = np.zeros((len(vectors), len(null)))
    result[:, columns] = vectors
    return list(result)


def _group(vector: FloatArray, dropped: set[int]) -> UnseenGroup:
    members = [int(k) for k in np.flatnonzero(vector)]
    size = np.abs(vector)
    # a parameter that hardly moves would have to move by metres or turns to show what the others do
    moving = [k for k in members if size[k] >= (1 - ZERO) * _NAMES * size.max()]
    first = next((k for k in moving if k in dropped), moving[0])
    members.remove(first)
    ordered = (first, *members)
    return UnseenGroup(ordered, vector[list(ordered)] / vector[first])


def shortest_basis(basis: FloatArray, avoided: BoolArray) -> FloatArray:
    """Return a basis of vectors with few entries: unit vectors, (k, n), shortest first, with exact zeros.

    Args:
        basis: Orthonormal basis of the subspace, (n, k); every entry takes part in some vector.
        avoided: Entries to leave out where lengths are equal, (n,).
    """
    n, k = basis.shape
    complement = linalg.svd(basis)[0][:, k:]
    chosen: list[FloatArray] = []
    tried = 0
    for size in range(1, n - k + 2):
        tried += comb(n, size)
        if tried > _MOST_SUPPORTS or len(chosen) == k:
            break
        _extend(chosen, list(_elementary_vectors(complement, size)), avoided, k)
    if len(chosen) < k:
        _extend(chosen, [v for j in range(n) for v in _vectors_by_programs(basis, j, avoided)], avoided, k)
    if len(chosen) < k:
        _extend(chosen, list(_echelon(basis)), avoided, k)
    return np.array(chosen)


def _extend(chosen: list[FloatArray], candidates: list[FloatArray], avoided: BoolArray, dimension: int) -> None:
    def length(vector: FloatArray) -> tuple[int, int, tuple[int, ...]]:
        support = np.flatnonzero(vector)
        return len(support), int(np.sum(avoided[support])), tuple(int(entry) for entry in support)

    for vector in sorted(candidates, key=length):
        if len(chosen) == dimension:
            return
        unit = vector / np.linalg.norm(vector)
        if linalg.singular_values(np.array([*chosen, unit]))[-1] > ZERO:
            chosen.append(unit)


def _elementary_vectors(complement: FloatArray, size: int) -> Iterator[FloatArray]:
    n, rank = complement.shape
    supports = combinations(range(n), size)
    while batch := list(islice(supports, _BATCH)):
        index = np.array(batch, dtype=np.intp)
        # zero columns make a narrow matrix square, so that its last left singular vector is the null vector
        rows = np.concatenate([complement[index], np.zeros((len(index), size, max(0, size - rank)))], axis=2)
        u, s, _ = linalg.svd(rows, full_matrices=False)
        unique = (s[:, -1] < _DEPENDENT) & (s[:, -2] > ZERO if size > 1 else True)
        full = np.min(np.abs(u[:, :, -1]), axis=1) > ZERO
        for j in np.flatnonzero(unique & full):
            vector = np.zeros(n)
            vector[index[j]] = u[j, :, -1]
            yield vector


def _vectors_by_programs(basis: FloatArray, pivot: int, avoided: BoolArray) -> Iterator[FloatArray]:
    """Elementary vectors with an entry at `pivot`, from the linear program and from its second round."""
    n, k = basis.shape
    weights = np.where(avoided, 1.05, 1.0) + 1e-4 * np.arange(n)
    weighed = weights
    for _ in range(2):
        solution = scipy.optimize.linprog(
            np.concatenate([np.zeros(k), weighed]),
            A_ub=np.block([[basis, -np.eye(n)], [-basis, -np.eye(n)]]),
            b_ub=np.zeros(2 * n),
            A_eq=np.concatenate([basis[pivot], np.zeros(n)])[None],
            b_eq=[1.0],
            bounds=[(None, None)] * k + [(0, None)] * n,
            method="highs",
        )
        if solution.status != 0:
            return
        vector = basis @ solution.x[:k]
        polished = _vector_on_support(basis, np.abs(vector) > ZERO * np.max(np.abs(vector)))
        if polished is not None:
            yield polished
        weighed = weights / (np.abs(vector) + 0.1)


def _echelon(basis: FloatArray) -> Iterator[FloatArray]:
    """Elementary vectors that span the subspace, each with an entry that the others lack."""
    work = basis.copy()
    for column in range(work.shape[1]):
        row = int(np.argmax(np.max(np.abs(work[:, column:]), axis=1)))
        swap = column + int(np.argmax(np.abs(work[row, column:])))
        work[:, [column, swap]] = work[:, [swap, column]]
        work[:, column] /= work[row, column]
        others = [k for k in range(work.shape[1]) if k != column]
        work[:, others] -= np.outer(work[:, column], work[row, others])
    for vector in work.T:
        kept = np.where(np.abs(vector) > ZERO * np.max(np.abs(vector)), vector, 0.0)
        polished = _vector_on_support(basis, kept != 0)
        yield kept if polished is None else polished


def _vector_on_support(basis: FloatArray, support: BoolArray) -> FloatArray | None:
    """The vector that is exactly zero outside `support`; None unless it is unique and full on it."""
    outside = basis[~support]
    _, s, vt = linalg.svd(outside) if len(outside) else (None, np.zeros(0), np.eye(basis.shape[1]))
    if basis.shape[1] - int(np.sum(s > ZERO)) != 1:
        return None
    vector: FloatArray = np.where(support, basis @ vt[-1], 0.0)
    return vector if np.all(np.abs(vector[support]) > ZERO * np.max(np.abs(vector))) else None
