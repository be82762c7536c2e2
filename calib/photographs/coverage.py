"""How much of the image the board has been seen in, and whether that is enough to trust what is found of the lens."""

from __future__ import annotations

import numpy as np

from calib.base.arrays import BoolArray, FloatArray

_CELLS = 8  # across and down
LITTLE = 0.4
"""Part of the image below which the lens is told by what was not seen."""


def image_coverage(pixels: FloatArray, size: tuple[int, int]) -> float:
    """Return in which part of the image points (n, 2) [px] were seen: of 8 x 8 fields, or those within their hull."""
    if len(pixels) < 3:
        return 0.0
    x, y = (np.clip((pixels[:, k] / size[k] * _CELLS).astype(int), 0, _CELLS - 1) for k in (0, 1))
    seen = np.zeros((_CELLS, _CELLS), dtype=bool)
    seen[y, x] = True
    return float(np.mean(_filled(seen)))


def _filled(seen: BoolArray) -> BoolArray:
    """Fields between two that were seen, along a row and along a column."""

    def between(rows: BoolArray) -> BoolArray:
        before = np.maximum.accumulate(rows, axis=1)
        after = np.maximum.accumulate(rows[:, ::-1], axis=1)[:, ::-1]
        return before & after

    return seen | (between(seen) & between(seen.T).T)
