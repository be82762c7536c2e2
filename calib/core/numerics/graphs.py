"""Graphs as matrices: connected parts. For the small ones of robots; SciPy's take longer to import."""

from __future__ import annotations

import numpy as np

from calib.core.base.arrays import BoolArray, IntArray


def connected_parts(links: BoolArray) -> tuple[IntArray, ...]:
    """Return the nodes of each part, which can all be reached from each other.

    Every multiplication of the matrix by itself doubles the length of the ways that count.

    Args:
        links: Whether a way leads from node i straight to node j, (n, n).
    """
    reached = links | np.eye(len(links), dtype=bool)
    while not np.array_equal(farther := reached.astype(float) @ reached > 0, reached):
        reached = farther
    together = reached & reached.T
    return tuple(np.flatnonzero(nodes) for k, nodes in enumerate(together) if not np.any(nodes[:k]))
