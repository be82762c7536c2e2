"""Copies of rows are found, and repeats that are the same by chance are not taken for copies."""

import numpy as np
import pytest

import calib
from calib.core.judging.rules_data import copied_visits
from tests.six_axis_arm import joints, measurements, noisy

SIGMA = 4e-5


def with_copies(data, rows):
    return data.subset(np.concatenate([np.arange(len(data)), rows]))


def test_copies_are_named_whichever_of_them_are_held_out(arm):
    data = with_copies(noisy(arm, joints(63), SIGMA, 1), [7, 30])
    held_out = set()
    for seed in range(3):
        used, other = data.split(validation=0.25, seed=seed)
        held_out.add(len(other) - other.n_poses)
        verdict = calib.fit(arm, used, validation=other).verdict
        assert (verdict.grade, verdict.reasons[0].code) == ("CHECK", "copied")
        assert verdict.reasons[0].text.startswith("2 of 65 readings are copies")
    assert held_out > {0}  # of some, the fit has used fewer than three in a hundred


def test_one_copied_row_of_a_hundred_is_no_matter(arm):
    verdict = calib.fit(arm, with_copies(noisy(arm, joints(99), SIGMA, 1), [7])).verdict
    assert "copied" not in verdict.to_dict()["codes"]


@pytest.mark.parametrize(("step", "scatter"), [(1e-7, 2e-5), (1e-4, 2e-5), (1e-4, 1e-6)])
def test_honest_repeats_are_no_copies(arm, step, scatter):
    """Twenty poses, each read three times: in fine steps, in steps coarser than they scatter, and without scatter."""
    q = np.repeat(joints(20), 3, axis=0)
    points = arm.positions(q) + scatter * np.random.default_rng(2).standard_normal((60, 1, 3))
    data = measurements(arm, q, step * np.round(points / step))
    assert len(copied_visits(arm, data)) == 0


def test_copies_among_honest_repeats_are_found(arm):
    q = np.repeat(joints(20), 2, axis=0)
    points = arm.positions(q) + 2e-5 * np.random.default_rng(2).standard_normal((40, 1, 3))
    data = with_copies(measurements(arm, q, 1e-7 * np.round(points / 1e-7)), [3, 4, 5])
    np.testing.assert_array_equal(copied_visits(arm, data), [40, 41, 42])
