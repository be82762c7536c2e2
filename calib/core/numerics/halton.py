"""Points spread evenly over a box, always the same ones (Halton's sequence).

Coordinate k of point i is i written in base b_k (the k-th prime), its digits mirrored at the point: 0.d_0 d_1 d_2 ... .
Any first n points leave no large gap (halton1960). With many coordinates the largest bases need many points: the first
few then lie along lines.
"""

from __future__ import annotations

import itertools

import numpy as np

from calib.core.base.arrays import FloatArray


def halton(count: int, dimensions: int) -> FloatArray:
    """Return the first points of the sequence, (count, dimensions), in [0, 1); the first one is 0.

    Equal to `scipy.stats.qmc.Halton` without scrambling, whose import takes longer than most uses of these points.
    """
    points = np.zeros((count, dimensions))
    primes = (n for n in itertools.count(2) if all(n % k for k in range(2, n)))
    for k, base in enumerate(itertools.islice(primes, dimensions)):
        left, weight = np.arange(count), 1.0
        while np.any(left):
            weight /= base
            points[:, k] += weight * (left % base)
            left //= base
    return points
