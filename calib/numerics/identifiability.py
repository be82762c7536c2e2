"""What the measurements can tell: the rank of the identification Jacobian, with the gap that shows it.

Columns are scaled before anything is judged, so that metres and radians can be compared: by the parameters' sigma where
it matters how far the target moves for an error of the expected size; to unit length where it only matters whether the
target moves (`unit_columns`), because expected errors that are a million times apart would hide what is small. The
Jacobian is exact to about 1e-12 of its largest entry, so singular values below 1e-9 of the largest are zero; the gap
around that threshold is reported.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.arrays import FloatArray, ReadOnlyArrays

RANK_TOLERANCE = 1e-9
"""Singular values of the scaled Jacobian below this part of the largest count as zero."""
NO_EFFECT = 1e-7
"""Length of a column over that of the longest, in metres and radians, below which it is rounding."""


@dataclass(frozen=True, eq=False)
class Rank(ReadOnlyArrays):
    """Rank of a Jacobian and how clearly it stands out.

    Attributes:
        rank: Number of singular values above the threshold.
        n_columns: Number of columns.
        singular_values: Of the scaled Jacobian, largest first, (n_columns,); zeros where there are fewer rows.
        threshold: Largest singular value that counts as zero.
        smallest_kept: Smallest singular value above the threshold; NaN when the rank is 0.
        largest_dropped: Largest one below it; 0 at full rank.
    """

    rank: int
    n_columns: int
    singular_values: FloatArray
    threshold: float
    smallest_kept: float
    largest_dropped: float

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


def reduced(rows: FloatArray) -> FloatArray:
    """Return at most n_columns rows with the same singular values and null space: the R of a QR factorisation.

    Args:
        rows: (n_rows, n_columns).
    """
    if len(rows) <= rows.shape[1]:
        return rows
    return np.asarray(np.linalg.qr(rows, mode="r"))


def unit_columns(columns: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Divide columns by their length; those that are rounding beside the longest become zero.

    Args:
        columns: Derivatives by metres and radians, not scaled, (n_rows, n_columns).

    Returns:
        The columns, each of length 1 or 0, and what each was divided by (as the longest, where it became zero, so that
        rounding stays rounding), (n_columns,).
    """
    lengths = np.linalg.norm(columns, axis=0)
    longest = float(np.max(lengths, initial=0.0))
    seen = lengths > NO_EFFECT * longest
    lengths = np.where(seen, lengths, longest or 1.0)
    return np.where(seen, columns / lengths, 0.0), lengths


def numerical_rank(scaled_jacobian: FloatArray) -> Rank:
    """Return the rank of a Jacobian whose columns are scaled, (n_rows, n_columns)."""
    n_columns = scaled_jacobian.shape[1]
    values = np.zeros(n_columns)
    found = np.linalg.svd(scaled_jacobian, compute_uv=False)
    values[: len(found)] = found
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
