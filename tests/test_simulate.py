"""Simulated measurements: the truth plus normal noise, the same again from the same seed, and said so in the file."""

import numpy as np
import pytest
from small_robots import ARM_YAML, small_arm, write_arm

import calib
from calib.data.tables import read_table
from calib.errors import DataError, UnreachablePoseError
from calib.linearisation.jacobian import joint_jacobian


def some_poses(n):
    q = np.random.default_rng(1).uniform([-1, 0, -1], [1, 0.5, 1], (n, 3))
    names = tuple(str(k) for k in range(n))
    return calib.Poses(q, tuple(f"pose {name}" for name in names), names, "here", ())


def test_without_noise_the_positions_are_those_of_the_robot(tmp_path):
    arm = small_arm(tmp_path)
    truth = arm.with_parameters({"slide.x": 0.26})
    poses = some_poses(10)
    data = calib.simulate(truth, poses, 0.0, np.random.default_rng(1))
    assert np.array_equal(data.points(arm), truth.positions(poses.joints))
    assert np.array_equal(data.joints, poses.joints)
    assert data.names == poses.names
    assert data.n_readings == 10


def test_noise_is_normal_and_the_same_on_every_axis(tmp_path):
    arm = small_arm(tmp_path)
    poses = some_poses(4000)
    noise = calib.simulate(arm, poses, 2e-4, np.random.default_rng(2)).points(arm) - arm.positions(poses.joints)
    z = noise[:, 0] / 2e-4
    # four standard deviations: 4 / sqrt(4000) of means and correlations, 4 sqrt(2 / 4000) of variances
    assert np.abs(z.mean(axis=0)).max() < 0.064
    assert np.abs(z.var(axis=0) - 1).max() < 0.09
    assert np.abs(np.corrcoef(z.T) - np.eye(3)).max() < 0.064
    assert np.mean(np.abs(z) > 1.959964) == pytest.approx(0.05, abs=0.008)


def test_the_same_seed_gives_the_same_numbers(tmp_path):
    arm = small_arm(tmp_path)
    one, two, other = (
        calib.simulate(arm, some_poses(3), 1e-4, np.random.default_rng(s)).points(arm) for s in (5, 5, 6)
    )
    assert np.array_equal(one, two)
    assert not np.array_equal(one, other)


@pytest.mark.parametrize("sigma", [-1e-4, np.nan, np.inf])
def test_a_sigma_that_cannot_be_is_an_error(tmp_path, sigma):
    with pytest.raises(DataError, match="must be a number, zero or positive"):
        calib.simulate(small_arm(tmp_path), some_poses(3), sigma, np.random.default_rng(1))


def test_a_pose_that_cannot_be_assembled_is_an_error_with_its_label(medrue):
    q = np.array([medrue.home, medrue.home])
    q[1, 1:3] = 0.0, np.pi  # the cranks away from each other: the distal links do not meet
    poses = calib.Poses(q, ("file.csv, line 2", "file.csv, line 3"), ("a", "b"), "file.csv", ())
    with pytest.raises(UnreachablePoseError, match=r"^file\.csv, line 3: loop .* stays open by .* mm at best"):
        calib.simulate(medrue, poses, 0.0, np.random.default_rng(1))


def test_the_command_writes_the_truth_the_noise_and_the_seed_into_the_file(tmp_path, run_calib):
    arm = small_arm(tmp_path)
    (tmp_path / "q.csv").write_text("pose,turn,slide,wrist\nfirst,0.1,0.2,0.3\nfirst,0.1,0.2,0.3\nsecond,0.3,0.2,0.1\n")
    (tmp_path / "truth.csv").write_text("parameter,value,unit\nslide.x,260,mm\n")
    command = "simulate arm.yaml q.csv --parameters truth.csv --sigma-mm 0.05 --seed 7 --out m.csv"
    run = run_calib(*command.split(), cwd=tmp_path)
    assert (run.code, run.out, run.err) == (0, "3 simulated poses written to m.csv\n", "")
    table = read_table(tmp_path / "m.csv")
    assert table.comments == (
        "simulated measurements of small arm; truth: truth.csv",
        "normal noise, sigma 0.05 mm per axis, seed 7",
    )
    data = calib.read_measurements(tmp_path / "m.csv", arm)
    assert data.pose_numbers.tolist() == [0, 0, 1]  # repeats of a pose are measured each
    exact = arm.with_parameters({"slide.x": 0.26}).positions(data.joints)
    assert 0 < np.abs(data.points(arm) - exact).max() < 3e-4
    assert np.abs(np.diff(data.points(arm)[:2], axis=0)).min() > 0
    first = (tmp_path / "m.csv").read_bytes()
    run_calib(*command.split(), cwd=tmp_path)
    assert (tmp_path / "m.csv").read_bytes() == first


STATED = (
    ARM_YAML
    + """\
instruments:
  tracker: {kind: position, target: tip, sigma: {range: 0.5 mm, angle: 0.2 mrad}}
  scale: {kind: position, target: tip, sigma: [0.1 mm, 0.2 mm, 0.3 mm]}
  unstated: {kind: position, target: tip}
"""
)


def test_without_a_sigma_every_instrument_has_the_noise_that_is_stated_of_it(tmp_path):
    robot = calib.load(write_arm(tmp_path, STATED))
    poses = some_poses(4000)
    data = calib.simulate(robot, poses, None, np.random.default_rng(2))
    exact = robot.positions(poses.joints)[:, 0]
    off = {name: found.values - exact for name, found in data.readings.items()}
    # four standard errors of a standard deviation: 4 / sqrt(2 * 4000) = 4.5 %
    assert np.std(off["scale"], axis=0) == pytest.approx([1e-4, 2e-4, 3e-4], rel=0.045)
    assert not off["unstated"].any()  # noise that nobody states is none
    distance = np.linalg.norm(exact, axis=1)
    beam = exact / distance[:, None]
    along = np.sum(off["tracker"] * beam, axis=1)
    across = off["tracker"] - along[:, None] * beam
    assert np.std(along) == pytest.approx(5e-4, rel=0.045)
    # two components across, each angle times distance
    assert np.sqrt(np.mean(np.sum(across**2, axis=1) / 2 / distance**2)) == pytest.approx(2e-4, rel=0.045)


def test_joints_that_do_not_come_back_move_all_that_is_read_of_a_visit_alike(tmp_path):
    robot = calib.load(write_arm(tmp_path, STATED))
    poses = some_poses(2000)
    data = calib.simulate(robot, poses, 0.0, np.random.default_rng(2), joint_sigma=1e-4)
    assert np.array_equal(data.joints, poses.joints)
    np.testing.assert_array_equal(data.readings["tracker"].values, data.readings["scale"].values)
    off = data.readings["tracker"].values - robot.positions(poses.joints)[:, 0]
    slopes = joint_jacobian(robot, robot.assemble(poses.joints))[:, 0] * robot.mechanism.joint_scale
    expected = 1e-4 * np.sqrt(np.mean(np.sum(slopes**2, axis=2), axis=0))
    assert np.sqrt(np.mean(off**2, axis=0)) == pytest.approx(expected, rel=0.07)
