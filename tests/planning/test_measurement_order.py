"""Short travel: against all orders of few poses, and never longer than it was."""

from itertools import permutations

import numpy as np
import pytest

from calib.planning.measurement_order import shortest_order, travel


def test_travel_by_hand():
    """Each joint counts in its own range; the joint with the longest way decides."""
    joints = np.array([[0.0, 0.0], [1.0, 5.0], [2.0, 10.0]])
    home = np.array([0.0, 0.0])
    assert travel(joints, home, np.array([0, 1, 2])) == pytest.approx(0 + 0.5 + 0.5)
    assert travel(joints, home, np.array([2, 0, 1])) == pytest.approx(1 + 1 + 0.5)


def test_seven_poses_come_close_to_the_shortest_of_all_orders():
    ratios = []
    for seed in range(15):
        rng = np.random.default_rng(seed)
        joints, home = rng.uniform(size=(6, 3)), rng.uniform(size=3)
        best = min(travel(joints, home, np.array(order)) for order in permutations(range(6)))
        ratios.append(travel(joints, home, shortest_order(joints, home)) / best)
    assert np.min(ratios) >= 1 - 1e-12
    assert np.max(ratios) < 1.1
    assert np.mean(ratios) < 1.02


def test_points_on_a_line_are_visited_along_it():
    joints = np.random.default_rng(0).permutation(np.linspace(0.1, 1, 30))[:, None]
    order = shortest_order(joints, np.zeros(1))
    np.testing.assert_array_equal(joints[order, 0], np.sort(joints[:, 0]))


def test_every_pose_is_visited_once():
    joints = np.random.default_rng(1).uniform(size=(80, 6))
    order = shortest_order(joints, np.zeros(6))
    assert sorted(order.tolist()) == list(range(80))
    assert travel(joints, np.zeros(6), order) < 0.7 * travel(joints, np.zeros(6), np.arange(80))


def test_very_many_poses_get_a_quick_order():
    joints = np.random.default_rng(1).uniform(size=(1500, 2))
    order = shortest_order(joints, np.zeros(2))
    assert sorted(order.tolist()) == list(range(1500))


@pytest.mark.parametrize("n", [1, 2])
def test_one_or_two_poses(n):
    joints = np.array([[1.0], [0.5]])[:n]
    assert sorted(shortest_order(joints, np.zeros(1)).tolist()) == list(range(n))
