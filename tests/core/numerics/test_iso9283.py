"""The figures of ISO 9283 against a calculation by hand, and their intervals against draws."""

import numpy as np
import pytest

from calib.core.numerics import iso9283

RNG = np.random.default_rng
FOUR = np.array([[1.0, 0.0, 0.0], [3.0, 0.0, 0.0], [2.0, 1.0, 0.0], [2.0, -1.0, 0.0]])
"""Four cycles, errors in mm; their mean is (2, 0, 0), each is 1 away from it."""


def test_pose_accuracy_and_repeatability_by_hand():
    assert iso9283.pose_accuracy(FOUR).value == pytest.approx(2.0)
    assert iso9283.repeatability(FOUR) == pytest.approx(1.0)  # all at one distance: no deviation
    uneven = np.array([[0.0, 0, 0], [0, 0, 0], [3, 0, 0]])
    # mean (1, 0, 0); distances 1, 1, 2: mean 4/3, deviation root of (2 (1/3)^2 + (2/3)^2) / 2 = root of 1/3
    assert iso9283.repeatability(uneven) == pytest.approx(4 / 3 + 3 * np.sqrt(1 / 3))
    assert iso9283.pose_repeatability(uneven, RNG(0)).value == pytest.approx(4 / 3 + 3 * np.sqrt(1 / 3))


def test_means_and_deviations_of_angles_and_distances_by_hand():
    first, second = np.zeros((2, 3)), np.array([[3.0, 0.0, 0.0], [-1.0, 3.0, 0.0]])
    commanded = np.array([5.0, 0.0, 0.0])  # attained: 8; (4, 3, 0) is 5
    off = iso9283.distances(first, second, commanded)
    assert off == pytest.approx([3.0, 0.0])
    assert iso9283.mean_of(off).value == pytest.approx(1.5)
    assert iso9283.three_deviations(off).value == pytest.approx(3 * np.sqrt(2 * 1.5**2))


def test_directions_and_drift_by_hand():
    groups = [FOUR, FOUR + np.array([0, 3, 0]), FOUR + np.array([4, 0, 0])]
    assert iso9283.direction_variation(groups).value == pytest.approx(5.0)  # (0, 3, 0) to (4, 0, 0)
    accuracy, scatter = iso9283.drift([FOUR, FOUR * 2, FOUR + np.array([1, 0, 0])], RNG(0))
    assert accuracy.value == pytest.approx(2.0)  # 2, then 4, then 3
    assert scatter.value == pytest.approx(1.0)  # 1, then 2, then 1


def test_no_scatter_is_exact():
    still = np.tile([3.0, 4.0, 0.0], (5, 1))
    for figure in (iso9283.pose_accuracy(still), iso9283.pose_repeatability(still, RNG(0))):
        assert figure.low95 == figure.value == figure.high95


def covered(draw, figure, truth, n=1000):
    results = [figure(draw()) for _ in range(n)]
    return np.mean([item.low95 <= truth <= item.high95 for item in results])


@pytest.mark.quick(1)
@pytest.mark.parametrize("offset", [0.0, 0.3, 2.0])
@pytest.mark.parametrize("axes", [(1.0, 1.0, 1.0), (1.0, 0.3, 0.3)])
def test_intervals_of_accuracy_cover_the_true_length(offset, axes):
    rng = RNG(int(10 * offset) + 1)
    mean = offset * np.array([1.0, 2.0, 2.0]) / 3.0
    share = covered(lambda: mean + axes * rng.standard_normal((30, 3)), iso9283.pose_accuracy, offset)
    assert share > 0.93  # 1000 draws: +- 0.014; small offsets are covered more often


@pytest.mark.quick(0)
@pytest.mark.parametrize("axes", [(1.0, 1.0, 1.0), (1.0, 0.2, 0.1)])
def test_intervals_of_repeatability_cover_the_true_one(axes):
    rng, other = RNG(5), RNG(6)
    many = np.linalg.norm(axes * rng.standard_normal((10**6, 3)), axis=1)
    truth = many.mean() + 3 * many.std()
    share = covered(
        lambda: axes * rng.standard_normal((30, 3)), lambda e: iso9283.pose_repeatability(e, other), truth, 100
    )
    assert share > 0.88  # 100 draws: +- 0.04; the shape of the scatter is found from the same cycles


def test_intervals_of_distances_between_two_poses_cover():
    """Both ends scatter and are off; what infinitely many cycles would give is drawn from a million."""
    rng = RNG(9)
    commanded, off = np.array([50.0, 30.0, 10.0]), np.array([1.0, 0.2, 0.1])
    many = np.linalg.norm(commanded + off + np.sqrt(2) * rng.standard_normal((10**6, 3)), axis=1)

    def draw():
        return iso9283.distances(rng.standard_normal((30, 3)), off + rng.standard_normal((30, 3)), commanded)

    accuracy = many.mean() - np.linalg.norm(commanded)
    assert covered(draw, iso9283.mean_of, accuracy) == pytest.approx(0.95, abs=0.02)
    assert covered(draw, iso9283.three_deviations, 3 * many.std()) == pytest.approx(0.95, abs=0.02)


@pytest.mark.quick(0)
def test_intervals_of_drift_cover():
    rng, other = RNG(10), RNG(11)
    means = np.array([[1.0, 0, 0], [1.5, 0, 0], [3.0, 0, 0]])
    results = [iso9283.drift([mean + rng.standard_normal((10, 3)) for mean in means], other) for _ in range(100)]
    assert np.mean([a.low95 <= 2.0 <= a.high95 for a, _ in results]) > 0.93  # wide: limits of both ends
    assert np.mean([r.low95 <= 0.0 <= r.high95 for _, r in results]) > 0.93


def test_intervals_of_several_directions_cover():
    rng = RNG(8)
    offsets = np.array([[0.0, 0, 0], [1.0, 0, 0], [0, 0.5, 0]])
    truth = np.hypot(1.0, 0.5)
    share = covered(
        lambda: [offset + rng.standard_normal((30, 3)) for offset in offsets], iso9283.direction_variation, truth, 200
    )
    assert share > 0.93
