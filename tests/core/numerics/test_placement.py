"""Unknown base and target: found from wrong guesses, left at the guess where nothing tells, and clear refusals."""

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from calib.core.base.errors import DataError
from calib.core.numerics.placement import MovingPoint, place

Array = NDArray[np.float64]
NESTS = np.array([[0.0, 0.0, 0.0], [0.9, 0.1, 0.0], [0.1, 0.7, 0.2]])


def some_pose(generator: np.random.Generator) -> pin.SE3:
    return pin.SE3(Rotation.random(random_state=generator).as_matrix(), generator.uniform(-2, 2, 3))


UNKNOWN, EXACT = np.full(3, np.inf), np.zeros(3)
ONES = np.ones(15)


def seen_from(truth: pin.SE3, poses: list[pin.SE3], point: Array) -> Array:
    return np.array([(truth.inverse() * pose).act(point) for pose in poses])


def drawn(generator: np.random.Generator, n: int) -> tuple[pin.SE3, Array, list[pin.SE3]]:
    """Where the base is, a point of the tool, and poses of the tool that turn by half a radian."""
    truth, point = some_pose(generator), generator.uniform(-0.3, 0.3, 3)
    turns = Rotation.from_rotvec(generator.uniform(-0.5, 0.5, (n, 3))).as_matrix()
    return truth, point, [pin.SE3(turn, generator.uniform(-1, 1, 3)) for turn in turns]


def matrices(poses: list[pin.SE3]) -> Array:
    return np.array([pose.homogeneous for pose in poses])


def test_base_and_target_are_found_from_a_guess_that_is_wrong_by_half_a_metre() -> None:
    generator = np.random.default_rng(10)
    for _ in range(20):
        truth, point, poses = drawn(generator, 15)
        seen, T = seen_from(truth, poses, point), matrices(poses)
        start, guess = some_pose(generator), point + generator.uniform(-0.5, 0.5, 3)
        placed = place([MovingPoint(T, seen, guess, UNKNOWN)], ONES, start)
        # conditioned by turns of half a radian
        assert np.abs(placed.T_base_measurement.homogeneous - truth.homogeneous).max() < 1e-10
        assert np.abs(placed.points[0] - point).max() < 1e-10
        assert placed.rms < 1e-10
        placed = place([MovingPoint(T, seen, point, EXACT)], ONES, start)
        assert np.abs(placed.T_base_measurement.homogeneous - truth.homogeneous).max() < 1e-12
        placed = place([MovingPoint(T, seen, guess, UNKNOWN)], ONES, truth, frame_known=True)
        assert np.abs(placed.points[0] - point).max() < 1e-12


def test_what_the_poses_cannot_tell_stays_at_the_guess() -> None:
    """A link that only turns about z shows nothing of its point's height: a shift of the frame does the same."""
    generator = np.random.default_rng(11)
    truth, point = some_pose(generator), np.array([0.1, -0.2, 0.3])
    poses = [
        pin.SE3(Rotation.from_euler("z", a).as_matrix(), generator.uniform(-1, 1, 3))
        for a in generator.uniform(-1, 1, 15)
    ]
    seen = seen_from(truth, poses, point)
    placed = place([MovingPoint(matrices(poses), seen, np.array([0.0, 0.0, 0.25]), UNKNOWN)], ONES, pin.SE3.Identity())
    assert np.abs(placed.points[0] - (0.1, -0.2, 0.25)).max() < 1e-9
    assert np.abs(seen_from(placed.T_base_measurement, poses, placed.points[0]) - seen).max() < 1e-9


def test_the_turn_about_a_line_of_points_stays_at_the_guess() -> None:
    poses = [pin.SE3(np.eye(3), np.array([s, 0.0, 0.0])) for s in np.linspace(0, 1, 15)]
    about, across = Rotation.from_euler("x", 0.7), Rotation.from_euler("z", 0.4)
    seen = seen_from(pin.SE3(across.as_matrix(), np.array([5.0, 6.0, 7.0])), poses, np.zeros(3))
    guess = pin.SE3((about * across).as_matrix(), np.zeros(3))  # right but for what the line does not tell
    placed = place([MovingPoint(matrices(poses), seen, np.zeros(3), UNKNOWN)], ONES, guess)
    assert np.abs(placed.T_base_measurement.rotation - guess.rotation).max() < 1e-9
    assert placed.rms < 1e-12
    assert np.array_equal(placed.points[0], np.zeros(3))


def test_points_that_never_moved_leave_the_rotation_at_the_guess() -> None:
    generator = np.random.default_rng(13)
    guess, place_of_it = some_pose(generator), np.array([1.0, 2.0, 3.0])
    T = np.tile(np.eye(4), (15, 1, 1))
    placed = place([MovingPoint(T, np.tile(place_of_it, (15, 1)), np.zeros(3), EXACT)], ONES, guess)
    assert np.abs(placed.T_base_measurement.rotation - guess.rotation).max() < 1e-9
    assert np.abs(placed.T_base_measurement.act(place_of_it)).max() < 1e-12


def test_a_stated_sigma_counts_with_the_noise_of_the_residuals() -> None:
    """Against a general solver of the same sum of squares, whose noise is iterated in the same way."""
    generator = np.random.default_rng(14)
    truth, point, sigma = some_pose(generator), np.array([0.05, -0.02, 0.1]), np.array([0.002, 0.01, np.inf])
    turns = Rotation.from_rotvec(generator.normal(0, 0.02, (15, 3))).as_matrix()  # tells the point to 3 cm
    poses = [pin.SE3(turn, generator.uniform(-1, 1, 3)) for turn in turns]
    counts = generator.integers(1, 5, 15)
    seen = seen_from(truth, poses, point) + generator.normal(0, 1e-3, (15, 3)) / np.sqrt(counts)[:, None]
    placed = place([MovingPoint(matrices(poses), seen, np.zeros(3), sigma)], counts, pin.SE3.Identity())

    def rows(x: Array) -> Array:
        frame = truth * pin.SE3(pin.exp3(x[:3]), x[3:6])
        errors = np.array([frame.act(m) - pose.act(x[6:]) for m, pose in zip(seen, poses, strict=True)])
        return (np.sqrt(counts)[:, None] * errors).ravel()

    noise, x = 1e-3, np.zeros(9)
    for _ in range(10):
        x = least_squares(lambda x, n=noise: np.concatenate([rows(x), n * x[6:8] / sigma[:2]]), x, x_scale="jac").x
        noise = np.sqrt(np.sum(rows(x) ** 2) / (45 - 9))
    assert abs(x[6]) < 0.9 * abs(point[0])  # the statement counts
    assert np.abs(placed.points[0] - x[6:]).max() < 2e-4  # the noise is found to 1 %


@pytest.mark.quick(0)
def test_where_nothing_fits_the_lowest_of_several_minima_is_found() -> None:
    """Readings with an axis mirrored, against a general solver from 12 starts."""
    generator = np.random.default_rng(15)
    for _ in range(3):
        truth, point, poses = drawn(generator, 6)
        seen = seen_from(truth, poses, point) * [1, 1, -1]
        T = matrices(poses)
        placed = place([MovingPoint(T, seen, point, UNKNOWN)], np.ones(6), truth)

        def rows(x: Array, T: Array = T, seen: Array = seen) -> Array:
            here = seen @ Rotation.from_rotvec(x[:3]).as_matrix().T + x[3:6]
            return (here - T[:, :3, :3] @ x[6:] - T[:, :3, 3]).ravel()

        starts = [
            np.concatenate([turn, truth.translation, point]) for turn in Rotation.random(12, generator).as_rotvec()
        ]
        least = min(float(np.sum(least_squares(rows, start).fun ** 2)) for start in starts)
        assert 6 * placed.rms**2 == pytest.approx(least, rel=1e-6)


@pytest.mark.parametrize("seed", [14, 50, 90])
def test_three_poses_along_a_line_are_fitted_exactly_although_there_are_other_minima(seed: int) -> None:
    """From the matrix that fits best, without a search, 5 to 35 mm are left."""
    generator = np.random.default_rng(seed)
    truth, point, poses = drawn(generator, 3)
    poses = [pin.SE3(pose.rotation, pose.translation * [1, 0, 0]) for pose in poses]
    points = [MovingPoint(matrices(poses), seen_from(truth, poses, point), point, UNKNOWN)]
    assert place(points, np.ones(3), some_pose(generator)).rms < 1e-10


def test_wrong_link_poses_are_refused() -> None:
    identity, frame = np.tile(np.eye(4), (3, 1, 1)), pin.SE3.Identity()
    with pytest.raises(DataError, match="do not belong together"):
        place([MovingPoint(identity, np.zeros((4, 3)), np.zeros(3), UNKNOWN)], np.ones(4), frame)
    with pytest.raises(DataError, match="row 1"):
        place([MovingPoint(identity, np.where(NESTS == 0.9, np.nan, NESTS), np.zeros(3), UNKNOWN)], np.ones(3), frame)
    with pytest.raises(DataError, match="guessed point"):
        place([MovingPoint(identity, NESTS, np.zeros(2), UNKNOWN)], np.ones(3), frame)


def test_a_rough_answer_is_a_lower_bound_of_the_error_and_stands_only_beyond_its_limit():
    rng = np.random.default_rng(3)
    turns = Rotation.random(8, rng).as_matrix()
    T = np.tile(np.eye(4), (8, 1, 1))
    T[:, :3, :3], T[:, :3, 3] = turns, rng.normal(size=(8, 3))
    point = MovingPoint(T, rng.normal(size=(8, 3)), np.zeros(3), np.full(3, 5e-3))
    whole = place([point], np.ones(8), pin.SE3.Identity())
    rough = place([point], np.ones(8), pin.SE3.Identity(), rough_beyond=1e-3)
    assert rough.rms < whole.rms
    assert np.linalg.norm(rough.points) > np.linalg.norm(whole.points)
    same = place([point], np.ones(8), pin.SE3.Identity(), rough_beyond=1.001 * rough.rms)
    assert same.rms == whole.rms
