"""Whether residuals contradict stated noise is settled at the largest scale that chance explains, as by a search."""

from dataclasses import replace

import numpy as np
import pytest

from calib.core.fitting.problem import Problem
from calib.core.fitting.solving import place, release_contradicted_noise, scales_found


@pytest.mark.parametrize("stated", [1e-5, 2.3e-5, 2.5e-5, 2.7e-5, 2.9e-5, 3e-5, 3.3e-5, 1e-3])
@pytest.mark.parametrize("poses", [slice(None), slice(0, 16)], ids=["80 poses", "16 poses"])
def test_noise_is_contradicted_where_its_likeliest_scale_is_beyond_chance(robot, data, stated, poses):
    problem = Problem.from_data(robot, data.subset(np.arange(len(data))[poses]), stated)
    start, groups = place(problem), np.ones(1)
    released, scales = release_contradicted_noise(problem, start, groups)
    likeliest, _ = scales_found(replace(problem, noise_found=np.ones(1, dtype=bool)), start, groups)
    expected = likeliest > problem.largest_scales()
    np.testing.assert_array_equal(released.noise_found, expected)
    np.testing.assert_allclose(scales, np.where(expected, likeliest, 1.0), rtol=0.01)
