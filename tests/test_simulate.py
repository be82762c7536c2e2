"""Simulated measurements: the truth plus normal noise, the same again from the same seed, and said so in the file."""

import numpy as np
import pytest
from small_robots import small_arm

import calib
from calib.data.tables import read_table
from calib.errors import DataError, UnreachablePoseError


def some_poses(n):
    q = np.random.default_rng(1).uniform([-1, 0, -1], [1, 0.5, 1], (n, 3))
    names = tuple(str(k) for k in range(n))
    return calib.Poses(q, tuple(f"pose {name}" for name in names), names, "here", ())


def test_without_noise_the_positions_are_those_of_the_robot(tmp_path):
    arm = small_arm(tmp_path)
    truth = arm.with_parameters({"slide.x": 0.26})
    poses = some_poses(10)
    data = calib.simulate(truth, poses, 0.0, np.random.default_rng(1))
    assert np.array_equal(data.positions, truth.positions(poses.joints))
    assert np.array_equal(data.joints, poses.joints)
    assert data.names == poses.names
    assert data.counts.tolist() == [1] * 10


def test_noise_is_normal_and_the_same_on_every_axis(tmp_path):
    arm = small_arm(tmp_path)
    poses = some_poses(4000)
    noise = calib.simulate(arm, poses, 2e-4, np.random.default_rng(2)).positions - arm.positions(poses.joints)
    z = noise[:, 0] / 2e-4
    # four standard deviations: 4 / sqrt(4000) of means and correlations, 4 sqrt(2 / 4000) of variances
    assert np.abs(z.mean(axis=0)).max() < 0.064
    assert np.abs(z.var(axis=0) - 1).max() < 0.09
    assert np.abs(np.corrcoef(z.T) - np.eye(3)).max() < 0.064
    assert np.mean(np.abs(z) > 1.959964) == pytest.approx(0.05, abs=0.008)


def test_the_same_seed_gives_the_same_numbers(tmp_path):
    arm = small_arm(tmp_path)
    one, two, other = (calib.simulate(arm, some_poses(3), 1e-4, np.random.default_rng(s)).positions for s in (5, 5, 6))
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
    assert data.counts.tolist() == [2, 1]  # repeats of a pose are measured each
    exact = arm.with_parameters({"slide.x": 0.26}).positions(data.joints)
    assert 0 < np.abs(data.positions - exact).max() < 3e-4
    assert data.scatter[0].min() > 0
    first = (tmp_path / "m.csv").read_bytes()
    run_calib(*command.split(), cwd=tmp_path)
    assert (tmp_path / "m.csv").read_bytes() == first
