"""The shortest basis of a subspace: vectors with as few non-zero entries as possible.

A vector of the subspace whose support contains the support of no other is elementary; its support determines it up to
a factor. Taking elementary vectors in the order of their length, each that is independent of those before, gives a
basis that no other one beats (the greedy algorithm on a matroid).

Search. With Q an orthonormal basis of the complement, a support S carries a vector where the rows Q_S are dependent.
All supports of one entry are tried, then all of two, and so on, until the basis is complete: then it is proven to be
the shortest, and the same on every machine. Where there would be too many supports, the rest comes from linear
programs: elementary vectors are the vertices of {v in the subspace, |v|_1 <= 1}, so

    minimise  sum_i w_i |v_i|    subject to  v in the subspace,  v_j = 1

has one as its solution for each entry j, and favours short ones; a second round with w_i = 1 / (|v_i| + 0.1) more so.
Then every vector is still elementary, but that no shorter basis exists is not proven.

Reference: Rockafellar 1969 (elementary vectors); Edmonds 1971 (greedy algorithm); Candes, Wakin and Boyd 2008
(reweighting).
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations, islice
from math import comb

import numpy as np
import scipy

from calib.arrays import BoolArray, FloatArray

ZERO = 1e-6
"""Entries of a vector below this part of its largest are zero."""
_DEPENDENT = 1e-9  # smallest singular value of rows of an orthonormal basis that counts as none
_MOST_SUPPORTS = 60_000
_BATCH = 4096


def shortest_basis(basis: FloatArray, avoided: BoolArray) -> FloatArray:
    """Return a basis of vectors with few entries.

    Args:
        basis: Orthonormal basis of the subspace, (n, k); every entry takes part in some vector.
        avoided: Entries to leave out where lengths are equal, (n,).

    Returns:
        Unit vectors, (k, n), shortest first; zeros are exact.
    """
    n, k = basis.shape
    complement = np.linalg.svd(basis)[0][:, k:]
    chosen: list[FloatArray] = []
    tried = 0
    for size in range(1, n - k + 2):
        tried += comb(n, size)
        if tried > _MOST_SUPPORTS or len(chosen) == k:
            break
        _extend(chosen, list(_of_size(complement, size)), avoided, k)
    if len(chosen) < k:
        _extend(chosen, [v for j in range(n) for v in _programmed(basis, j, avoided)], avoided, k)
    if len(chosen) < k:
        _extend(chosen, list(_echelon(basis)), avoided, k)
    return np.array(chosen)


def _extend(chosen: list[FloatArray], found: list[FloatArray], avoided: BoolArray, wanted: int) -> None:
    """Take the shortest of the found vectors that are independent of the chosen ones."""

    def length(vector: FloatArray) -> tuple[int, int, tuple[int, ...]]:
        support = np.flatnonzero(vector)
        return len(support), int(np.sum(avoided[support])), tuple(int(entry) for entry in support)

    for vector in sorted(found, key=length):
        if len(chosen) == wanted:
            return
        unit = vector / np.linalg.norm(vector)
        if np.linalg.svd(np.array([*chosen, unit]), compute_uv=False)[-1] > ZERO:
            chosen.append(unit)


def _of_size(complement: FloatArray, size: int) -> Iterator[FloatArray]:
    """All elementary vectors with `size` entries."""
    n, rank = complement.shape
    supports = combinations(range(n), size)
    while batch := list(islice(supports, _BATCH)):
        index = np.array(batch, dtype=np.intp)
        # with as many zero columns appended as make it wide enough, the last left singular vector is the null vector
        rows = np.concatenate([complement[index], np.zeros((len(index), size, max(0, size - rank)))], axis=2)
        u, s, _ = np.linalg.svd(rows, full_matrices=False)
        unique = (s[:, -1] < _DEPENDENT) & (s[:, -2] > ZERO if size > 1 else True)
        full = np.min(np.abs(u[:, :, -1]), axis=1) > ZERO
        for j in np.flatnonzero(unique & full):
            vector = np.zeros(n)
            vector[index[j]] = u[j, :, -1]
            yield vector


def _programmed(basis: FloatArray, pivot: int, avoided: BoolArray) -> Iterator[FloatArray]:
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
        polished = _on_support(basis, np.abs(vector) > ZERO * np.max(np.abs(vector)))
        if polished is not None:
            yield polished
        weighed = weights / (np.abs(vector) + 0.1)


def _echelon(basis: FloatArray) -> Iterator[FloatArray]:
    """Elementary vectors that span the subspace: each has one entry that the others have not."""
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
        polished = _on_support(basis, kept != 0)
        yield kept if polished is None else polished


def _on_support(basis: FloatArray, support: BoolArray) -> FloatArray | None:
    """The vector that is exactly zero outside `support`; None unless it is the only one, and full there."""
    outside = basis[~support]
    _, s, vt = np.linalg.svd(outside) if len(outside) else (None, np.zeros(0), np.eye(basis.shape[1]))
    if basis.shape[1] - int(np.sum(s > ZERO)) != 1:
        return None
    vector: FloatArray = np.where(support, basis @ vt[-1], 0.0)
    return vector if np.all(np.abs(vector[support]) > ZERO * np.max(np.abs(vector))) else None
