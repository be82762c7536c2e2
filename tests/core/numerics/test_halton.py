"""Evenly spread points against SciPy's, and against the digits by hand."""

import numpy as np
import pytest
import scipy

from calib.core.numerics.halton import halton


@pytest.mark.parametrize(("count", "dimensions"), [(1, 1), (64, 6), (1000, 13)])
def test_points_are_those_of_scipy(count, dimensions):
    expected = scipy.stats.qmc.Halton(dimensions, scramble=False).random(count)
    assert np.allclose(halton(count, dimensions), expected, rtol=1e-14, atol=0)


def test_digits_are_mirrored_at_the_point():
    by_hand = [[0, 0], [1 / 2, 1 / 3], [1 / 4, 2 / 3], [3 / 4, 1 / 9], [1 / 8, 4 / 9]]
    assert np.allclose(halton(5, 2), by_hand, rtol=1e-15)
