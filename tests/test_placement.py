"""Rigid fits: exact recovery, honest uncertainty, outliers, unknown base and target, and clear refusals."""

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from calib.errors import DataError
from calib.numerics.nests import world_from_nests
from calib.numerics.placement import MovingPoint, place
from calib.numerics.rigid import rigid_fit

Array = NDArray[np.float64]
NESTS = np.array([[0.0, 0.0, 0.0], [0.9, 0.1, 0.0], [0.1, 0.7, 0.2]])
ROUNDING = 1e-14


def some_pose(generator: np.random.Generator) -> pin.SE3:
    return pin.SE3(Rotation.random(random_state=generator).as_matrix(), generator.uniform(-2, 2, 3))


def some_points(generator: np.random.Generator, n: int) -> Array:
    return generator.uniform(-1, 1, (n, 3))


def carried(pose: pin.SE3, points: Array) -> Array:
    return np.array([pose.act(point) for point in points])


def test_exact_points_give_back_the_transform() -> None:
    generator = np.random.default_rng(1)
    for n in (3, 4, 30):
        truth, points = some_pose(generator), some_points(generator, n)
        fit = rigid_fit(points, carried(truth, points))
        assert np.abs(fit.transform - truth.homogeneous).max() < 10 * ROUNDING
        assert fit.rms < 10 * ROUNDING
        assert fit.outliers == ()
        assert np.abs(fit.apply(points) - carried(truth, points)).max() < 10 * ROUNDING


def test_noisy_points_give_the_same_rotation_as_scipy() -> None:
    generator = np.random.default_rng(2)
    points = some_points(generator, 12)
    seen = carried(some_pose(generator), points) + generator.normal(0, 0.05, points.shape)
    expected = Rotation.align_vectors(seen - seen.mean(axis=0), points - points.mean(axis=0))[0].as_matrix()
    assert np.abs(rigid_fit(points, seen).rotation - expected).max() < 1e-12


def test_flat_and_mirrored_points_still_give_a_proper_rotation() -> None:
    generator = np.random.default_rng(3)
    points = some_points(generator, 8)
    flat = points * (1, 1, 0)
    for p, q in ((flat, flat), (points, -points), (flat, flat * (1, -1, 1))):
        assert abs(np.linalg.det(rigid_fit(p, q).rotation) - 1) < 1e-12


def test_covariance_agrees_with_the_scatter_over_draws() -> None:
    generator = np.random.default_rng(4)
    truth, sigma = some_pose(generator), 1e-4
    predicted = rigid_fit(NESTS, carried(truth, NESTS), sigma).covariance
    found = []
    for _ in range(2000):
        fit = rigid_fit(NESTS, carried(truth, NESTS) + generator.normal(0, sigma, NESTS.shape), sigma)
        found.append(np.concatenate([fit.translation - truth.translation, pin.log3(truth.rotation.T @ fit.rotation)]))
    ratio = np.linalg.solve(predicted, np.cov(np.array(found).T))
    # eigenvalues of a Wishart matrix with 2000 draws in 6 dimensions stay within 1 +- 2 sqrt(6 / 2000) = 1 +- 0.11
    assert np.abs(np.linalg.eigvals(ratio) - 1).max() < 0.13


def test_noise_is_estimated_with_the_right_degrees_of_freedom() -> None:
    generator = np.random.default_rng(5)
    squares = [rigid_fit(NESTS, NESTS + generator.normal(0, 1e-4, NESTS.shape)).sigma ** 2 for _ in range(3000)]
    assert abs(np.mean(squares) / 1e-8 - 1) < 4 * np.sqrt(2 / 3 / 3000)  # chi-square with 3 degrees of freedom


def test_point_covariance_is_the_scatter_of_the_carried_point() -> None:
    generator = np.random.default_rng(6)
    far, sigma = np.array([2.0, -1.0, 0.5]), 1e-4
    predicted = rigid_fit(NESTS, NESTS, sigma).point_covariance(far)[0]
    found = [rigid_fit(NESTS, NESTS + generator.normal(0, sigma, NESTS.shape)).apply(far) for _ in range(2000)]
    assert np.abs(np.linalg.eigvals(np.linalg.solve(predicted, np.cov(np.array(found).T))) - 1).max() < 0.13


@pytest.mark.parametrize("sigma", [1e-4, None])
def test_outliers_are_found_without_their_neighbours(sigma: float | None) -> None:
    generator = np.random.default_rng(7)
    points = some_points(generator, 9)
    seen = carried(some_pose(generator), points) + generator.normal(0, 1e-4, points.shape)
    assert rigid_fit(points, seen, sigma).outliers == ()
    seen[4] += (0.004, 0.0, 0.003)
    seen[7] += (0.0, -0.02, 0.0)
    assert rigid_fit(points, seen, sigma).outliers == (7, 4)


def test_clean_points_are_seldom_called_outliers() -> None:
    generator = np.random.default_rng(8)
    points = some_points(generator, 5)
    calls = [len(rigid_fit(points, points + generator.normal(0, 1e-4, points.shape)).outliers) > 0 for _ in range(500)]
    assert np.mean(calls) < 0.025  # nominal 0.01 at most; binomial spread 0.0045


def test_nests_give_the_world_frame_and_report_the_bad_one() -> None:
    generator = np.random.default_rng(9)
    nominal = np.vstack([NESTS, [[0.5, 0.5, 0.6]], [[-0.3, 0.2, 0.5]]])
    T_world_tracker = some_pose(generator)
    seen = carried(T_world_tracker.inverse(), nominal)
    seen[3] += (0.0, 0.003, 0.0)
    names = ("left", "right", "back", "top", "low")
    readings = seen[:, None, :] + generator.normal(0, 4e-5, (5, 20, 3))
    world = world_from_nests(nominal, readings, 4e-5 / np.sqrt(20), names=names)
    assert world.outliers == ("top",)
    assert abs(world.repeatability / 4e-5 - 1) < 4 / np.sqrt(2 * 5 * 19 * 3)
    better = world_from_nests(nominal, readings, 4e-5 / np.sqrt(20), names=names, exclude=("top",))
    assert (better.outliers, better.excluded) == ((), ("top",))
    assert np.linalg.norm(better.fit.apply(seen[0]) - nominal[0]) < 4e-5


def test_single_readings_have_no_repeatability() -> None:
    assert np.isnan(world_from_nests(NESTS, NESTS).repeatability)


UNKNOWN, EXACT = np.full(3, np.inf), np.zeros(3)
ONES = np.ones(15)


def seen_from(truth: pin.SE3, poses: list[pin.SE3], point: Array) -> Array:
    return np.array([(truth.inverse() * pose).act(point) for pose in poses])


def matrices(poses: list[pin.SE3]) -> Array:
    return np.array([pose.homogeneous for pose in poses])


def test_base_and_target_are_found_from_a_guess_that_is_wrong_by_half_a_metre() -> None:
    generator = np.random.default_rng(10)
    for _ in range(20):
        truth, point = some_pose(generator), generator.uniform(-0.3, 0.3, 3)
        turns = Rotation.from_rotvec(generator.uniform(-0.5, 0.5, (15, 3))).as_matrix()
        poses = [pin.SE3(turn, generator.uniform(-1, 1, 3)) for turn in turns]
        seen, T = seen_from(truth, poses, point), matrices(poses)
        start, guess = some_pose(generator), point + generator.uniform(-0.5, 0.5, 3)
        found = place([MovingPoint(T, seen, guess, UNKNOWN)], ONES, start)
        # conditioned by turns of half a radian
        assert np.abs(found.T_base_measurement.homogeneous - truth.homogeneous).max() < 1e-10
        assert np.abs(found.points[0] - point).max() < 1e-10
        assert found.rms < 1e-10
        found = place([MovingPoint(T, seen, point, EXACT)], ONES, start)
        assert np.abs(found.T_base_measurement.homogeneous - truth.homogeneous).max() < 1e-12
        found = place([MovingPoint(T, seen, guess, UNKNOWN)], ONES, truth, frame_known=True)
        assert np.abs(found.points[0] - point).max() < 1e-12


def test_what_the_poses_cannot_tell_stays_at_the_guess() -> None:
    """A link that only turns about z shows nothing of its point's height: a shift of the frame does the same."""
    generator = np.random.default_rng(11)
    truth, point = some_pose(generator), np.array([0.1, -0.2, 0.3])
    poses = [
        pin.SE3(Rotation.from_euler("z", a).as_matrix(), generator.uniform(-1, 1, 3))
        for a in generator.uniform(-1, 1, 15)
    ]
    seen = seen_from(truth, poses, point)
    found = place([MovingPoint(matrices(poses), seen, np.array([0.0, 0.0, 0.25]), UNKNOWN)], ONES, pin.SE3.Identity())
    assert np.abs(found.points[0] - (0.1, -0.2, 0.25)).max() < 1e-9
    assert np.abs(seen_from(found.T_base_measurement, poses, found.points[0]) - seen).max() < 1e-9


def test_the_turn_about_a_line_of_points_stays_at_the_guess() -> None:
    poses = [pin.SE3(np.eye(3), np.array([s, 0.0, 0.0])) for s in np.linspace(0, 1, 15)]
    about, across = Rotation.from_euler("x", 0.7), Rotation.from_euler("z", 0.4)
    seen = seen_from(pin.SE3(across.as_matrix(), np.array([5.0, 6.0, 7.0])), poses, np.zeros(3))
    guess = pin.SE3((about * across).as_matrix(), np.zeros(3))  # right but for what the line does not tell
    found = place([MovingPoint(matrices(poses), seen, np.zeros(3), UNKNOWN)], ONES, guess)
    assert np.abs(found.T_base_measurement.rotation - guess.rotation).max() < 1e-9
    assert found.rms < 1e-12
    assert np.array_equal(found.points[0], np.zeros(3))


def test_points_that_never_moved_leave_the_rotation_at_the_guess() -> None:
    generator = np.random.default_rng(13)
    guess, place_of_it = some_pose(generator), np.array([1.0, 2.0, 3.0])
    T = np.tile(np.eye(4), (15, 1, 1))
    found = place([MovingPoint(T, np.tile(place_of_it, (15, 1)), np.zeros(3), EXACT)], ONES, guess)
    assert np.abs(found.T_base_measurement.rotation - guess.rotation).max() < 1e-9
    assert np.abs(found.T_base_measurement.act(place_of_it)).max() < 1e-12


def test_a_stated_sigma_counts_with_the_noise_of_the_residuals() -> None:
    """Against a general solver of the same sum of squares, whose noise is iterated in the same way."""
    generator = np.random.default_rng(14)
    truth, point, sigma = some_pose(generator), np.array([0.05, -0.02, 0.1]), np.array([0.002, 0.01, np.inf])
    turns = Rotation.from_rotvec(generator.normal(0, 0.02, (15, 3))).as_matrix()  # tells the point to 3 cm
    poses = [pin.SE3(turn, generator.uniform(-1, 1, 3)) for turn in turns]
    counts = generator.integers(1, 5, 15)
    seen = seen_from(truth, poses, point) + generator.normal(0, 1e-3, (15, 3)) / np.sqrt(counts)[:, None]
    found = place([MovingPoint(matrices(poses), seen, np.zeros(3), sigma)], counts, pin.SE3.Identity())

    def rows(x: Array) -> Array:
        frame = truth * pin.SE3(pin.exp3(x[:3]), x[3:6])
        errors = np.array([frame.act(m) - pose.act(x[6:]) for m, pose in zip(seen, poses, strict=True)])
        return (np.sqrt(counts)[:, None] * errors).ravel()

    noise, x = 1e-3, np.zeros(9)
    for _ in range(10):
        x = least_squares(lambda x, n=noise: np.concatenate([rows(x), n * x[6:8] / sigma[:2]]), x, x_scale="jac").x
        noise = np.sqrt(np.sum(rows(x) ** 2) / (45 - 9))
    assert abs(x[6]) < 0.9 * abs(point[0])  # the statement counts
    assert np.abs(found.points[0] - x[6:]).max() < 2e-4  # the noise is found to 1 %


@pytest.mark.parametrize(
    ("p_from", "p_to", "sigma", "message"),
    [
        (NESTS[:2], NESTS[:2], None, "at least three"),
        (NESTS, NESTS[:2], None, "shapes"),
        (NESTS[:, :2], NESTS[:, :2], None, "shapes"),
        (
            np.outer([0.0, 1.0, 2.0], [1.0, 2.0, 3.0]),
            NESTS,
            None,
            "point 0, point 1, point 2 .as given. lie on one line",
        ),
        (NESTS, np.outer([0.0, 1.0, 2.0], [1.0, 2.0, 3.0]), None, "as measured. lie on one line"),
        (NESTS * (1, 1e-4, 1e-4), NESTS, 1e-4, "lie on one line"),
        (np.zeros((3, 3)), NESTS, None, "all one point"),
        (NESTS, np.where(NESTS == 0.9, np.nan, NESTS), None, "point 1"),
        (NESTS, NESTS, -1.0, "sigma"),
    ],
)
def test_points_that_fix_no_frame_are_refused(p_from: Array, p_to: Array, sigma: float | None, message: str) -> None:
    with pytest.raises(DataError, match=message):
        rigid_fit(p_from, p_to, sigma)


def test_wrong_nests_are_refused_by_name() -> None:
    names = ["left", "right", "back", "top"]
    nominal = np.vstack([NESTS, [[0.5, 0.5, 0.6]]])
    with pytest.raises(DataError, match="did you mean 'back'"):
        world_from_nests(nominal, nominal, names=names, exclude=["bakc"])
    with pytest.raises(DataError, match="right"):
        world_from_nests(nominal, np.where(nominal == 0.9, np.inf, nominal), names=names)
    with pytest.raises(DataError, match="mirror"):
        world_from_nests(nominal, nominal * (1, -1, 1))
    with pytest.raises(DataError, match="3 measured"):
        world_from_nests(nominal, NESTS)
    with pytest.raises(DataError, match="name"):
        world_from_nests(nominal, nominal, names=["a", "a", "b", "c"])


def test_wrong_link_poses_are_refused() -> None:
    identity, frame = np.tile(np.eye(4), (3, 1, 1)), pin.SE3.Identity()
    with pytest.raises(DataError, match="do not belong together"):
        place([MovingPoint(identity, np.zeros((4, 3)), np.zeros(3), UNKNOWN)], np.ones(4), frame)
    with pytest.raises(DataError, match="row 1"):
        place([MovingPoint(identity, np.where(NESTS == 0.9, np.nan, NESTS), np.zeros(3), UNKNOWN)], np.ones(3), frame)
    with pytest.raises(DataError, match="guessed point"):
        place([MovingPoint(identity, NESTS, np.zeros(2), UNKNOWN)], np.ones(3), frame)
