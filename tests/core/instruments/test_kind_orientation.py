"""Orientations and tilts: a known truth found again, intervals that hold it, and input that cannot be."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import calib
from calib.core.data.measurement_files import format_measurements
from calib.core.instruments.hand_eye import solve_poses, solve_rotations
from calib.core.instruments.kind import View
from tests.kind_checks import assert_found
from tests.six_axis_arm import HEAD, free, joints, write_six_axis

ANGLES = ("j2.rx", "j3.rx", "j3.rz", "j4.ry", "j4.rz", "j5.rx", "j5.rz", "j6.ry", "j6.rz")
"""What orientations determine of the arm, where both of its ends are unknown."""
YAML = f"""\
{HEAD}priors: false
base: {{frame: l0, pose: unknown}}
targets: {{cell: {{frame: l6, orientation: unknown}}}}
instruments:
  sensor: {{kind: orientation, target: cell}}
held: [base.x, base.y, base.z]
parametrisation:
{free(*ANGLES)}"""
TILTED = YAML.replace("target: cell}", "target: cell, axes: gravity}").replace("base.z]", "base.z, base.rz]")
TRUTH = dict(zip(ANGLES, [0.01, -0.02, 0.015, 0.008, -0.012, 0.02, -0.007, 0.011, 0.016], strict=True))
MOUNTED = Rotation.from_rotvec([1.1, -2.0, 0.7])
TURNED = Rotation.from_rotvec([-0.4, 1.9, 2.2])
LEVEL = Rotation.from_rotvec([0.03, -0.05, 0.0])


def arm(folder, yaml=YAML):
    return calib.load(write_six_axis(folder, yaml))


def seen(robot, q, base):
    """Orientation of the sensor in the measurement frame, by scipy alone."""
    link = Rotation.from_matrix(robot.with_parameters(TRUTH).forward(q, "l6")[:, :3, :3])
    return base * link * MOUNTED


def tilts(rotation):
    """How far the z axis of a sensor leans, seen in its own planes."""
    up = rotation.inv().apply([0.0, 0.0, 1.0])
    return np.stack([np.arctan2(up[:, 1], up[:, 2]), np.arctan2(-up[:, 0], up[:, 2])], axis=1)


def upright(robot, n, seed):
    """Joint values with the sensor less than 75 degrees from level, as inclinometers are used."""
    q = joints(20 * n, seed)
    result = tilts(seen(robot, q, LEVEL))
    return q[np.all(np.abs(result) < np.radians(75), axis=1)][:n]


def test_tilts_grow_as_the_sensor_turns_about_its_own_axes(tmp_path):
    instrument = arm(tmp_path, TILTED).instrument("sensor")
    turned = Rotation.from_rotvec([[0.3, 0, 0], [0, 0.2, 0], [0, 0, 1.0], [0, 0, 0]]).as_matrix()
    view = View(turned, np.zeros((4, 3)))
    expected = [[0.3, 0], [0, 0.2], [0, 0], [0, 0]]
    np.testing.assert_allclose(instrument.predict(view, np.zeros(0), np.zeros((4, 0))), expected, atol=1e-15)


def test_both_ends_are_found_in_closed_form():
    rng = np.random.default_rng(3)
    poses = np.tile(np.eye(4), (14, 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = Rotation.random(14, rng).as_matrix(), rng.normal(size=(14, 3))
    first, second, links = poses[0], poses[1], poses[2:]
    looked = np.linalg.inv(first) @ links @ second
    for known in ((False, False), (True, False), (False, True)):
        now = (first if known[0] else np.eye(4), second if known[1] else np.eye(4))
        result = solve_poses(links, looked, now, known)
        np.testing.assert_allclose(result[0], first, atol=1e-12)
        np.testing.assert_allclose(result[1], second, atol=1e-12)


def hand_eye(seed, n, lean, spin, noise=1e-5):
    """C, M, L_i and A_i with noise [m and rad]; L_i lean by `lean` and turn about one axis by up to `spin` [rad]."""
    rng = np.random.default_rng(seed)
    first, second, frame = np.tile(np.eye(4), (3, 1, 1))
    links, error = np.tile(np.eye(4), (2, n, 1, 1))
    for pose, turn in zip((first, second, frame), Rotation.random(3, rng), strict=True):
        pose[:3, :3], pose[:3, 3] = turn.as_matrix(), rng.normal(size=3)
    turns = np.column_stack([lean * rng.normal(size=(n, 2)), rng.uniform(-spin, spin, n)])
    links[:, :3, :3], links[:, :3, 3] = Rotation.from_rotvec(turns).as_matrix(), rng.uniform(-1, 1, (n, 3))
    error[:, :3, :3] = Rotation.from_rotvec(noise * rng.normal(size=(n, 3))).as_matrix()
    error[:, :3, 3] = noise * rng.normal(size=(n, 3))
    links = frame @ links
    return first, second, links, np.linalg.inv(first) @ links @ second @ error


def rms_miss(first, second, links, seen):
    """Root mean square miss, angles by a lever of 0.3 m [m]."""
    off = np.linalg.inv(seen) @ np.linalg.inv(first) @ links @ second
    turned = 0.3 * Rotation.from_matrix(off[:, :3, :3]).as_rotvec()
    return np.sqrt(np.mean(np.sum(off[:, :3, 3] ** 2 + turned**2, axis=1)))


@pytest.mark.parametrize("n", [3, 4, 30])
@pytest.mark.parametrize(
    ("lean", "spin"), [(0, 3), (1e-6, 3), (1e-3, 3), (0.02, 3), (0, 0.01), (0, 0), (1e-6, 0)], ids=str
)
def test_of_parallel_axes_positions_determine_the_turn_about_them(n, lean, spin):
    now = np.eye(4), np.eye(4)
    for seed in range(4):
        first, second, links, seen = hand_eye(seed, n, lean, spin)
        places = solve_poses(links, seen, now, (False, False))
        assert rms_miss(*places, links, seen) < 1.01 * rms_miss(first, second, links, seen)
        _, _, links, seen = hand_eye(seed, n, lean, spin, noise=0.0)
        assert rms_miss(*solve_poses(links, seen, now, (False, False)), links, seen) < 1e-5


def test_rotations_of_an_arm_do_not_depend_on_positions():
    _, _, links, seen = hand_eye(0, 14, 0.5, 3.0, noise=1e-3)
    places = solve_poses(links, seen, (np.eye(4), np.eye(4)), (False, False))
    rotations = solve_rotations(links[:, :3, :3], seen[:, :3, :3])
    np.testing.assert_allclose([place[:3, :3] for place in places], rotations, rtol=0, atol=1e-9)


def test_a_turn_that_no_reading_shows_stays_as_small_as_possible():
    turned = np.tile(np.eye(4), (10, 1, 1))
    turned[:, :3, :3] = Rotation.from_rotvec(np.linspace(-2, 2, 10)[:, None] * [0, 0, 1]).as_matrix()
    first, second, _, _ = hand_eye(1, 3, 0, 0)
    now = first.copy()
    first[:3, :3] = Rotation.from_rotvec([0, 0, 1.5]).as_matrix() @ first[:3, :3]  # about the axis of all turns
    seen = np.linalg.inv(first) @ turned @ second
    for order in (slice(None), slice(None, None, -1)):  # rounds in another way
        places = solve_poses(turned[order], seen[order], (now, np.eye(4)), (False, False))
        np.testing.assert_allclose(places[0][:3, :3], now[:3, :3], rtol=0, atol=1e-3)
        assert rms_miss(*places, turned[order], seen[order]) < 1e-9


def test_the_truth_is_found_from_orientations_with_both_ends_unknown(tmp_path):
    robot = arm(tmp_path)
    q = joints(60, 5)
    fit = calib.fit(robot, calib.as_measurements(robot, q, {"sensor": seen(robot, q, TURNED).as_rotvec()}))
    assert_found(fit.robot, TRUTH, 1e-8)


def test_the_truth_is_found_from_tilts_with_an_unknown_mounting_and_level(tmp_path):
    robot = arm(tmp_path, TILTED)
    q = upright(robot, 80, 6)
    fit = calib.fit(robot, calib.as_measurements(robot, q, {"sensor": tilts(seen(robot, q, LEVEL))}))
    assert_found(fit.robot, TRUTH, 1e-7)
    assert (Rotation.from_matrix(fit.robot.mechanism.placement("cell").rotation).inv() * MOUNTED).magnitude() < 1e-6
    assert_found(fit.robot, {"base.rx": 0.03, "base.ry": -0.05}, 5e-7)


def test_a_turn_about_gravity_is_said_not_to_be_determined(tmp_path, run_calib):
    robot = arm(tmp_path, TILTED.replace("base.z, base.rz]", "base.z]"))
    q = upright(robot, 60, 7)
    data = calib.as_measurements(robot, q, {"sensor": tilts(seen(robot, q, LEVEL))})
    with pytest.raises(calib.CalibrationError, match=r"base\.rz"):
        calib.fit(robot, data)
    (tmp_path / "data.csv").write_text(format_measurements(robot, data))
    run = run_calib("check", tmp_path / "arm.yaml", tmp_path / "data.csv")
    assert run.code == 0
    assert "base.rz" in run.out
