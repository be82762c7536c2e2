"""Singular values and eigenvalues of every finite matrix: by numpy, or where it fails, by slower LAPACK drivers.

numpy uses LAPACK's divide and conquer (`syevd`, `gesdd`, `gelsd`), the fastest method. It cuts a matrix of more than 25
rows into halves and joins their eigenvalues by roots of a secular equation

    1 + rho sum_i z_i^2 / (d_i - x) = 0        d: eigenvalues of both halves; z: their coupling

Many eigenvalues may be equal up to rounding: readings of x, y and z with a noise each leave three values, some 60 times
each. Then poles d_i of both halves nearly meet, couplings z_i are as small as rounding, and the search for a root
between two poles may fail: `Eigenvalues did not converge`, for a finite symmetric matrix. Whether it fails depends on
the last digits, and so on the processor: OpenBLAS adds in another order on each family. QR iterations (`syev`, `gesvd`)
have no such equation, but take some times longer. So each function here calls numpy first, and returns its result
unchanged. QR iterations are used for those matrices of a stack for which numpy fails. One rotation gives eigenvalues of
2 x 2 matrices.

Matrices up to 25 x 25 have QR iterations in numpy, too. LAPACK's QR and Cholesky factors, solutions and inverses take a
fixed number of steps and cannot fail in this way: they are called directly. Eigenvalues of matrices that are not
symmetric are needed nowhere.

When it fails. A matrix that is not finite raises `numpy.linalg.LinAlgError` or gives NaN, as in numpy.

Reference: lapack1999.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray, IntArray

_EPSILON = float(np.finfo(float).eps)
_QR_ITERATIONS = {"driver": "ev"}


def eigh(matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return eigenvalues, ascending, (..., n) and eigenvectors in columns, from the lower triangles of (..., n, n)."""
    if matrix.shape[-2:] == (2, 2):  # one rotation; LAPACK takes ten times as long
        (first, _), (beside, last) = np.moveaxis(matrix, (-2, -1), (0, 1))
        middle, half = first / 2 + last / 2, first / 2 - last / 2
        radius, turn = np.hypot(half, beside), np.arctan2(beside, half) / 2
        outer = middle + np.copysign(radius, middle)
        divisor = np.where(outer == 0.0, 1.0, outer)
        inner = np.where(np.abs(first) > np.abs(last), first / divisor * last, last / divisor * first)
        inner = inner - beside / divisor * beside  # the determinant over the outer value, without loss of small ones
        c, s = np.cos(turn), np.sin(turn)
        vectors = np.moveaxis(np.array([[-s, c], [c, s]]), (0, 1), (-2, -1))
        values = np.where(middle < 0.0, [outer, inner], [inner, outer])
        return np.moveaxis(values, 0, -1), vectors
    return _first_or_second(np.linalg.eigh, lambda part: scipy.linalg.eigh(part, **_QR_ITERATIONS), matrix)


def eigvalsh(matrix: FloatArray) -> FloatArray:
    """Return the eigenvalues of symmetric matrices (..., n, n), ascending, (..., n)."""
    (values,) = _first_or_second(
        lambda part: (np.linalg.eigvalsh(part),), lambda part: scipy.linalg.eigh(part, **_QR_ITERATIONS)[:1], matrix
    )
    return values


def svd(matrix: FloatArray, full_matrices: bool = True) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return left vectors, singular values, descending, and right vectors in rows, of matrices (..., m, n).

    With `full_matrices` all vectors are returned, (..., m, m) and (..., n, n), else min(m, n) of each.
    """
    return _first_or_second(
        lambda part: np.linalg.svd(part, full_matrices),
        lambda part: scipy.linalg.svd(part, full_matrices, lapack_driver="gesvd"),
        matrix,
    )


def singular_values(matrix: FloatArray) -> FloatArray:
    """Return the singular values of matrices (..., m, n), descending, (..., min(m, n))."""
    (values,) = _first_or_second(
        lambda part: (np.linalg.svd(part, compute_uv=False),),
        lambda part: scipy.linalg.svd(part, full_matrices=False, lapack_driver="gesvd")[1:2],
        matrix,
    )
    return values


def lstsq(matrix: FloatArray, right: FloatArray, rcond: float | None = None) -> FloatArray:
    """Return the shortest x of all that make |A x - b| least.

    Args:
        matrix: A, (m, n).
        right: b, (m,) or (m, k).
        rcond: Part of the largest singular value below which others count as 0; rounding errors if not given.
    """
    return solution_and_rank(matrix, right, rcond)[0]


def solution_and_rank(matrix: FloatArray, right: FloatArray, rcond: float | None = None) -> tuple[FloatArray, int]:
    """Return x of `lstsq`, (n,) or (n, k), and the rank of its matrix (m, n)."""
    try:
        solution, _, rank, _ = np.linalg.lstsq(matrix, right, rcond)
    except np.linalg.LinAlgError:
        if not (np.all(np.isfinite(matrix)) and np.all(np.isfinite(right))):
            raise
        cut = max(np.shape(matrix)) * _EPSILON if rcond is None else rcond
        solution, _, rank, _ = scipy.linalg.lstsq(matrix, right, cut, lapack_driver="gelss")
    return solution, int(rank)


def pinv(matrix: FloatArray, rcond: float = 1e-15, *, hermitian: bool = False) -> FloatArray:
    """Return the pseudo-inverses (..., n, m) of matrices (..., m, n).

    Args:
        rcond: Part of the largest singular value below which others count as 0.
        hermitian: Whether they are symmetric, which is faster.
    """

    def from_svd(part: FloatArray) -> tuple[FloatArray]:
        left, values, right = scipy.linalg.svd(part, full_matrices=False, lapack_driver="gesvd")
        kept = values > rcond * np.max(values)
        return ((right[kept].T / values[kept]) @ left[:, kept].T,)

    (inverse,) = _first_or_second(lambda part: (np.linalg.pinv(part, rcond, hermitian),), from_svd, matrix)
    return inverse


def matrix_rank(matrix: FloatArray, *, hermitian: bool = False) -> IntArray:
    """Return the number of singular values of matrices (..., m, n) that are larger than rounding errors, (...).

    Symmetric matrices, `hermitian`, are faster.
    """
    values = np.abs(eigvalsh(matrix)) if hermitian else singular_values(matrix)
    least = np.max(values, axis=-1, keepdims=True, initial=0.0) * max(np.shape(matrix)[-2:]) * _EPSILON
    return np.asarray(np.count_nonzero(values > least, axis=-1))


def orth(matrix: FloatArray, rcond: float | None = None) -> FloatArray:
    """Return an orthonormal basis of the space that the columns of a matrix (m, n) span, (m, rank).

    Singular values below `rcond` of the largest count as 0.
    """
    left, values, _ = svd(matrix, full_matrices=False)
    cut = max(matrix.shape) * _EPSILON if rcond is None else rcond
    return left[:, values > cut * np.max(values, initial=0.0)]


def _first_or_second(first: Callable[..., Any], second: Callable[..., Any], matrix: FloatArray) -> Any:
    """Return the result of the first method; if it fails, treat each matrix alone, by the second method if needed."""
    try:
        return first(matrix)
    except np.linalg.LinAlgError:
        if not np.all(np.isfinite(matrix)):
            raise
    if np.ndim(matrix) == 2:
        return second(matrix)
    stack = np.asarray(matrix)
    each = [_first_or_second(first, second, part) for part in stack.reshape(-1, *stack.shape[-2:])]
    return tuple(np.stack(parts).reshape(*stack.shape[:-2], *parts[0].shape) for parts in zip(*each, strict=True))
