"""Short travel: against all orders of few poses, and never longer than it was."""

from itertools import permutations

import numpy as np
import pytest

from calib.planning.measurement_order import shortest_order, travel


def test_travel_by_hand():
    """Each joint counts in its own range; the joint with the longest way decides."""
    joints = np.array([[0.0, 0.0], [1.0, 5.0], [2.0, 10.0]])
    home = np.array([0.0, 0.0])
    assert travel(joints, home) == pytest.approx(0 + 0.5 + 0.5)
    assert travel(joints[[2, 0, 1]], home) == pytest.approx(1 + 1 + 0.5)


def test_seven_poses_come_close_to_the_shortest_of_all_orders():
    ratios = []
    for seed in range(15):
        rng = np.random.default_rng(seed)
        joints, home = rng.uniform(size=(6, 3)), rng.uniform(size=3)
        best = min(travel(joints[list(order)], home) for order in permutations(range(6)))
        ratios.append(travel(joints[shortest_order(joints, home)], home) / best)
    assert np.min(ratios) >= 1 - 1e-12
    assert np.max(ratios) < 1.1
    assert np.mean(ratios) < 1.02


def test_points_on_a_line_are_visited_along_it():
    joints = np.random.default_rng(0).permutation(np.linspace(0.1, 1, 30))[:, None]
    order = shortest_order(joints, np.zeros(1))
    np.testing.assert_array_equal(joints[order, 0], np.sort(joints[:, 0]))


@pytest.mark.parametrize(("n", "width"), [(1, 1), (2, 1), (80, 6), (1500, 2)])  # 1500: a quick order
def test_every_pose_is_visited_once(n, width):
    joints, home = np.random.default_rng(1).uniform(size=(n, width)), np.zeros(width)
    order = shortest_order(joints, home)
    assert sorted(order.tolist()) == list(range(n))
    assert n < 80 or travel(joints[order], home) < 0.7 * travel(joints, home)
