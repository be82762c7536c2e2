"""Connected parts of small graphs, given as matrices; SciPy's functions take longer to import."""

from __future__ import annotations

import numpy as np

from calib.core.base.arrays import BoolArray, IntArray


def connected_parts(links: BoolArray) -> tuple[IntArray, ...]:
    """Return the nodes of each part, whose nodes all reach each other.

    Each product of the matrix with itself doubles the length of the paths that it counts.

    Args:
        links: Whether an edge leads from node i to node j, (n, n).
    """
    reached = links | np.eye(len(links), dtype=bool)
    while not np.array_equal(farther := reached.astype(float) @ reached > 0, reached):
        reached = farther
    together = reached & reached.T
    return tuple(np.flatnonzero(nodes) for k, nodes in enumerate(together) if not np.any(nodes[:k]))
