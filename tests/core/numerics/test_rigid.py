"""The rigid motion that lays points over others."""

import numpy as np
from scipy.spatial.transform import Rotation

from calib.core.numerics.rigid import best_transform


def test_it_is_that_of_scipy_and_a_rotation_for_flat_and_mirrored_points_too():
    rng = np.random.default_rng(3)
    points, flat = rng.uniform(-1, 1, (2, 12, 3)) * [[[1, 1, 1]], [[1, 1, 0]]]
    seen = points @ Rotation.from_rotvec([0.4, -1.2, 2.0]).as_matrix().T + rng.normal(0, 0.05, points.shape)
    expected = Rotation.align_vectors(seen - seen.mean(axis=0), points - points.mean(axis=0))[0].as_matrix()
    rotation, translation = best_transform(points, seen)
    assert np.abs(rotation - expected).max() < 1e-12
    assert np.abs((points @ rotation.T + translation - seen).mean(axis=0)).max() < 1e-12
    for p, q in ((flat, flat), (points, -points), (flat, flat * (1, -1, 1))):
        assert abs(np.linalg.det(best_transform(p, q)[0]) - 1) < 1e-12
