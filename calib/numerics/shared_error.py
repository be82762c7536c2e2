"""Errors that the rows of a visit share: covariance I + C C^T of whitened rows, visit by visit.

C are the derivatives of the rows by the joints, each column times the standard deviation tau_j of that joint's error.
By the singular value decomposition C = U S V^T of each visit, a function f of the covariance is I + U (f(1 + S^2) - 1)
U^T.
"""

from __future__ import annotations

import numpy as np

from calib.arrays import FloatArray, IntArray


class SharedError:
    """Errors shared by the rows of each block (a visit, or the visits that repeat a pose).

    Args:
        columns: C, (n_rows, n_joints).
        block: Of each row, (n_rows,).
    """

    def __init__(self, columns: FloatArray, block: IntArray) -> None:
        self._order = np.argsort(block, kind="stable")
        _, self._block, counts = np.unique(block[self._order], return_inverse=True, return_counts=True)
        self._place = np.arange(len(block)) - np.repeat(np.cumsum(counts) - counts, counts)
        self._shape = len(counts), int(counts.max())
        self._columns = self._packed(columns)
        self._left, self._values, self._right = np.linalg.svd(self._columns, full_matrices=False)

    def _packed(self, rows: FloatArray) -> FloatArray:
        """Rows block by block, filled up with zeros, (n_blocks, most rows, k)."""
        packed = np.zeros((*self._shape, rows.shape[1]))
        packed[self._block, self._place] = rows[self._order]
        return packed

    def _unpacked(self, packed: FloatArray) -> FloatArray:
        result = np.empty((len(self._order), packed.shape[2]))
        result[self._order] = packed[self._block, self._place]
        return result

    def whiten(self, rows: FloatArray) -> FloatArray:
        """Return (I + C C^T)^(-1/2) rows, (n_rows,) or (n_rows, k)."""
        gain = 1.0 / np.sqrt(1.0 + self._values**2) - 1.0
        packed = self._packed(rows[:, None] if rows.ndim == 1 else rows)
        packed += np.matmul(self._left, gain[:, :, None] * np.matmul(self._left.transpose(0, 2, 1), packed))
        result = self._unpacked(packed)
        return result[:, 0] if rows.ndim == 1 else result

    def diagonal(self) -> FloatArray:
        """Return the diagonal of (I + C C^T)^-1, (n_rows,)."""
        loss = self._values**2 / (1.0 + self._values**2)
        kept = 1.0 - np.sum(self._left**2 * loss[:, None, :], axis=2)
        return self._unpacked(kept[:, :, None])[:, 0]

    def felt(self, rows: FloatArray) -> FloatArray:
        """Return C^T rows, block by block, (n_blocks, n_joints, k), from (n_rows, k)."""
        return np.matmul(self._columns.transpose(0, 2, 1), self._packed(rows))

    def traces(self) -> FloatArray:
        """Return the diagonal of the sum over blocks of C^T (I + C C^T)^-1 C, (n_joints,)."""
        kept = self._values**2 / (1.0 + self._values**2)
        result: FloatArray = np.sum(self._right**2 * kept[:, :, None], axis=(0, 1))
        return result

    def log_determinant(self) -> float:
        """Return log det (I + C C^T)."""
        return float(np.sum(np.log1p(self._values**2)))
