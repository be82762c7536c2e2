"""Leaving outliers out: found with a robust loss, so that they cannot hide behind each other, then fitted without.

A pose goes as a whole, even where only one of its targets is off. After each fit the rest is judged again, up to five
times: what a gross error hid may show then. Both results stay: that of all poses, and that without outliers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from calib.data.measurements import Measurements
from calib.identification.fitted import Fit
from calib.identification.judged import Outlier

_ROUNDS = 5


def without_outliers(first: Fit, robust: Callable[[], Fit], again: Callable[[Measurements], Fit]) -> Fit:
    """Return the fit without outliers; `first` itself if there are none.

    Args:
        first: The fit of all poses.
        robust: Fits all poses with a robust loss.
        again: Fits some of the poses as asked.
    """
    data = first.identification.data
    kept = np.arange(len(data))
    excluded: list[Outlier] = []
    current = first
    found = (first if first.loss == "tukey" else robust()).outliers
    for _ in range(_ROUNDS):
        if not found:
            break
        excluded += [replace(outlier, pose=int(kept[outlier.pose])) for outlier in found]
        kept = np.delete(kept, sorted({outlier.pose for outlier in found}))
        current = again(data.subset(kept))
        found = current.outliers
    if current is first:
        return first
    return replace(current, excluded=tuple(excluded), with_all=first)
