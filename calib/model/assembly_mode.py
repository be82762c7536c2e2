"""Assembly modes: which of several closed configurations a robot is in, told by the signs of determinants.

Two solutions of the loops that are joined without passing a singularity have the same sign of det C_p, C_p = dr/dp. The
sign is taken of each strongly connected part of C_p's pattern, one for each five-bar, so that two flips cannot cancel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from calib.arrays import BoolArray, FloatArray, IntArray, ReadOnlyArrays
from calib.model.mechanism import Mechanism


@dataclass(frozen=True, eq=False)
class AssemblyMode(ReadOnlyArrays):
    """A closed configuration and the signs that tell its assembly mode.

    Attributes:
        mechanism: The mechanism that it is a configuration of: the nominal one.
        actuated, passive: The configuration, (n_actuated,), (n_passive,) [m or rad].
        block_rows, block_columns: Indices of each strongly connected block of C_p, n_blocks arrays each.
        signs: Sign of each block's determinant, (n_blocks,).
    """

    mechanism: Mechanism
    actuated: FloatArray
    passive: FloatArray
    block_rows: tuple[IntArray, ...]
    block_columns: tuple[IntArray, ...]
    signs: FloatArray

    def holds(self, slope: FloatArray) -> BoolArray:
        """Return which configurations are in this mode, from their C_p (n, n_passive, n_passive): (n,)."""
        result: BoolArray = (block_signs(slope, self.block_rows, self.block_columns) == self.signs).all(axis=1)
        return result


def blocks(pattern: BoolArray) -> tuple[tuple[IntArray, ...], tuple[IntArray, ...]]:
    """Split a square, structurally regular pattern (n, n) into its strongly connected diagonal blocks.

    Returns:
        Row indices and column indices of each block.
    """
    column_of_row = scipy.sparse.csgraph.maximum_bipartite_matching(
        scipy.sparse.csr_matrix(pattern), perm_type="column"
    )
    matched = pattern[:, column_of_row]
    count, label = scipy.sparse.csgraph.connected_components(
        scipy.sparse.csr_matrix(matched), directed=True, connection="strong"
    )
    rows = tuple(np.flatnonzero(label == k) for k in range(count))
    columns = tuple(np.sort(column_of_row[label == k]) for k in range(count))
    return rows, columns


def block_signs(slope: FloatArray, rows: tuple[IntArray, ...], columns: tuple[IntArray, ...]) -> FloatArray:
    """Return the sign of the determinant of each block of C_p (n, n_passive, n_passive): (n, n_blocks)."""
    signs = [np.sign(np.linalg.det(slope[:, row[:, None], column])) for row, column in zip(rows, columns, strict=True)]
    return np.stack(signs, axis=1)
