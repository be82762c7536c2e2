"""How much of the image points cover."""

from __future__ import annotations

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray

_CELLS = 8  # fields of an image, across and down; the board should be seen in each
LITTLE_COVERAGE = 0.4
"""Part of the image that points must cover; with less, the lens is extrapolated."""


def image_coverage(pixels: FloatArray, size: tuple[int, int]) -> float:
    """Return the covered part of the image: fields of 8 x 8 with points (n, 2) [px], or between such fields."""
    if len(pixels) < 3:
        return 0.0
    x, y = (np.clip((pixels[:, k] / size[k] * _CELLS).astype(int), 0, _CELLS - 1) for k in (0, 1))
    seen = np.zeros((_CELLS, _CELLS), dtype=bool)
    seen[y, x] = True
    return float(np.mean(_fill_gaps(seen)))


def _fill_gaps(seen: BoolArray) -> BoolArray:
    """Fields that were seen, or lie between two seen ones along a row or a column."""

    def between_true(rows: BoolArray) -> BoolArray:
        before = np.maximum.accumulate(rows, axis=1)
        after = np.maximum.accumulate(rows[:, ::-1], axis=1)[:, ::-1]
        return before & after

    return seen | (between_true(seen) & between_true(seen.T).T)
