"""Evenly spread points against SciPy's."""

import numpy as np
import pytest
import scipy

from calib.core.numerics.halton import halton


@pytest.mark.parametrize(("count", "dimensions"), [(1, 1), (64, 6), (1000, 13)])
def test_points_are_those_of_scipy(count, dimensions):
    expected = scipy.stats.qmc.Halton(dimensions, scramble=False).random(count)
    assert np.allclose(halton(count, dimensions), expected, rtol=1e-14, atol=0)
