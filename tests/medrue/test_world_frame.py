"""The world from nests: exact recovery, honest uncertainty, and outliers."""

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

from medrue.world_frame import rigid_fit
from tests.core.numerics.test_placement import NESTS, carried, some_pose

ROUNDING = 1e-14


def some_points(generator, n):
    return generator.uniform(-1, 1, (n, 3))


def test_exact_points_give_back_the_transform():
    generator = np.random.default_rng(1)
    for n in (3, 4, 30):
        truth, points = some_pose(generator), some_points(generator, n)
        fit = rigid_fit(points, carried(truth, points))
        assert np.abs(fit.rotation - truth.rotation).max() < 10 * ROUNDING
        assert np.abs(fit.translation - truth.translation).max() < 10 * ROUNDING
        assert fit.outliers == ()
        assert np.abs(fit.apply(points) - carried(truth, points)).max() < 10 * ROUNDING


def test_noisy_points_give_the_same_rotation_as_scipy():
    generator = np.random.default_rng(2)
    points = some_points(generator, 12)
    seen = carried(some_pose(generator), points) + generator.normal(0, 0.05, points.shape)
    expected = Rotation.align_vectors(seen - seen.mean(axis=0), points - points.mean(axis=0))[0].as_matrix()
    assert np.abs(rigid_fit(points, seen).rotation - expected).max() < 1e-12


def test_flat_and_mirrored_points_still_give_a_proper_rotation():
    generator = np.random.default_rng(3)
    points = some_points(generator, 8)
    flat = points * (1, 1, 0)
    for p, q in ((flat, flat), (points, -points), (flat, flat * (1, -1, 1))):
        assert abs(np.linalg.det(rigid_fit(p, q).rotation) - 1) < 1e-12


@pytest.mark.quick(0)
def test_covariance_agrees_with_the_scatter_over_draws():
    generator = np.random.default_rng(4)
    truth, sigma = some_pose(generator), 1e-4
    predicted = rigid_fit(NESTS, carried(truth, NESTS), sigma).covariance
    results = []
    for _ in range(500):
        fit = rigid_fit(NESTS, carried(truth, NESTS) + generator.normal(0, sigma, NESTS.shape), sigma)
        results.append(np.concatenate([fit.translation - truth.translation, pin.log3(truth.rotation.T @ fit.rotation)]))
    ratio = np.linalg.solve(predicted, np.cov(np.array(results).T))
    # eigenvalues of a Wishart matrix with 500 draws in 6 dimensions stay within 1 +- 2 sqrt(6 / 500) = 1 +- 0.22
    assert np.abs(np.linalg.eigvals(ratio) - 1).max() < 0.26


@pytest.mark.quick(0)
def test_noise_is_estimated_with_the_right_degrees_of_freedom():
    generator = np.random.default_rng(5)
    squares = [rigid_fit(NESTS, NESTS + generator.normal(0, 1e-4, NESTS.shape)).sigma ** 2 for _ in range(500)]
    assert abs(np.mean(squares) / 1e-8 - 1) < 4 * np.sqrt(2 / 3 / 500)  # chi-square with 3 degrees of freedom


@pytest.mark.quick(0)
def test_point_covariance_is_the_scatter_of_the_carried_point():
    generator = np.random.default_rng(6)
    far, sigma = np.array([2.0, -1.0, 0.5]), 1e-4
    predicted = rigid_fit(NESTS, NESTS, sigma).point_covariance(far[None])[0]
    results = [rigid_fit(NESTS, NESTS + generator.normal(0, sigma, NESTS.shape)).apply(far) for _ in range(500)]
    ratios = np.linalg.eigvals(np.linalg.solve(predicted, np.cov(np.array(results).T)))
    assert np.abs(ratios - 1).max() < 0.26  # four standard deviations


@pytest.mark.parametrize("sigma", [1e-4, None])
def test_outliers_are_found_without_their_neighbours(sigma):
    generator = np.random.default_rng(7)
    points = some_points(generator, 9)
    seen = carried(some_pose(generator), points) + generator.normal(0, 1e-4, points.shape)
    assert rigid_fit(points, seen, sigma).outliers == ()
    seen[4] += (0.004, 0.0, 0.003)
    seen[7] += (0.0, -0.02, 0.0)
    assert rigid_fit(points, seen, sigma).outliers == (7, 4)


@pytest.mark.quick(0)
def test_clean_points_are_seldom_called_outliers():
    generator = np.random.default_rng(8)
    points = some_points(generator, 5)
    calls = [len(rigid_fit(points, points + generator.normal(0, 1e-4, points.shape)).outliers) > 0 for _ in range(500)]
    assert np.mean(calls) < 0.025  # nominal 0.01 at most; binomial spread 0.0045
