"""`calib sample`: poses that the robot can take, in the ranges that are asked for."""

import numpy as np
import pytest

import calib
from tests.project import EXAMPLES
from tests.urdf_trees import urdf_of

ARM = EXAMPLES / "arm.yaml"


@pytest.fixture(scope="module")
def arm():
    return calib.load(ARM)


def test_poses_stay_in_ranges_of_joints_and_of_targets(arm):
    sampled = calib.sample(arm, 40, seed=1, within={"joint_2": (0.3, 0.9), "reflector_z": (0.5, 0.8)})
    points = arm.positions(sampled.joints)[:, 0]
    assert np.all((sampled.joints[:, 1] >= 0.3) & (sampled.joints[:, 1] <= 0.9))
    assert np.all((points[:, 2] >= 0.5) & (points[:, 2] <= 0.8))
    spanning = np.array([[0.0, 0.1, 0.2, 0.3, 0.4, 0.5], [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]])
    inside = calib.sample(arm, 40, seed=1, within=spanning).joints
    assert np.all((inside >= spanning[0]) & (inside <= spanning[1]))


def test_limits_that_do_not_contain_home_are_kept(tmp_path, run_calib):
    table = EXAMPLES / "panda_dh.csv"  # its fourth joint cannot be straight
    assert run_calib("init", "--dh", table, "--out", tmp_path / "panda.yaml").code == 0
    robot = calib.load(tmp_path / "panda.yaml")
    lower, upper = np.radians([-166, -101, -166, -176, -166, -1, -166]), np.radians([166, 101, 166, -4, 166, 215, 166])
    result = calib.sample(robot, 400, seed=3).joints
    assert np.all((result >= lower) & (result <= upper))
    assert np.all(result.max(axis=0) - result.min(axis=0) > 0.9 * (upper - lower))


def test_what_is_written_is_read_by_the_other_commands(run_calib, tmp_path):
    run = run_calib(
        "sample", ARM, "--count", 60, "--seed", 2, "--within", "reflector_z=200..900mm", "--within", "joint_1=-1..1",
        "--out", tmp_path / "poses.csv",
    )  # fmt: skip
    assert run.code == 0
    robot = calib.load(ARM)
    poses = calib.read_poses(tmp_path / "poses.csv", robot)
    heights = robot.positions(poses.joints)[:, 0, 2]
    assert len(poses) == 60
    assert np.all((heights >= 0.2) & (heights <= 0.9))
    for command, more in (
        ("check", ()),
        ("select", ("--count", 30, "--out", tmp_path / "chosen.csv")),
        ("predict", ("--out", tmp_path / "predicted.csv")),
        ("simulate", ("--seed", 1, "--sigma-mm", 0.03, "--out", tmp_path / "simulated.csv")),
    ):
        assert run_calib(command, ARM, tmp_path / "poses.csv", *more).code == 0
    again = ("sample", ARM, "--count", 20, "--seed", 2, "--within", tmp_path / "poses.csv", "--out", tmp_path / "b.csv")
    assert run_calib(*again).code == 0
    assert np.all(np.abs(calib.read_poses(tmp_path / "b.csv", robot).joints[:, 0]) <= 1)


def test_a_seed_is_optional_and_told(arm, run_calib, tmp_path):
    for name, seed in (("a.csv", ()), ("b.csv", ("--seed", 0)), ("c.csv", ("--seed", 3))):
        run = run_calib("sample", ARM, "--count", 5, *seed, "--out", name, cwd=tmp_path)
        assert run.out == f"5 poses written to {name}, seed {seed[1] if seed else 0}\n"
    same, again, other = (calib.read_poses(tmp_path / f"{name}.csv", arm).joints for name in "abc")
    np.testing.assert_array_equal(same, again)
    assert np.any(same != other)
    assert "sampled with seed 3" in (tmp_path / "c.csv").read_text()


def test_many_poses_are_tried_part_by_part_with_the_same_numbers(arm, monkeypatch):
    whole = calib.sample(arm, 30, seed=4, within={"reflector_z": (0.5, 0.8)}).joints
    monkeypatch.setattr("calib.core.robots.joint_sampling._AT_ONCE", 7)
    np.testing.assert_array_equal(calib.sample(arm, 30, seed=4, within={"reflector_z": (0.5, 0.8)}).joints, whole)


def test_loops_close_at_sampled_poses_away_from_singular_ones():
    robot = calib.load(EXAMPLES / "five_bar.yaml")
    q = calib.sample(robot, 30, seed=3).joints
    assert robot.singular_values(robot.assemble(q)).min() >= robot.description.singularity_limit
    assert np.all((q >= robot.joint_limits[:, 0]) & (q <= robot.joint_limits[:, 1]))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--count", 0), "count 0: at least one pose is needed"),
        (("--within", "joint_2=30..-20deg"), "joint_2 from 0.523599 to -0.349066 is not a range"),
        (("--within", "joint_9=1..2deg"), "no joint or coordinate 'joint_9'"),
        (("--within", "joint_2=1-2"), "is not a range; write it as"),
        (("--within", "joint_2=a..b"), "is not a finite number"),
        (("--within", "joint_2=3000..4000deg"), "lies outside its joint limits"),
        (("--within", "reflector_z=50..51m"), "only 0 of 5 random poses are within these ranges; widen them"),
        (("--count", 99999999999, "--within", "joint_1=-10..10deg"), "sampling 99999999999 poses needs about"),
    ],
)
def test_bad_input_is_one_line_and_writes_nothing(run_calib, tmp_path, options, words):
    run = run_calib("sample", ARM, "--count", 5, "--seed", 1, "--out", "poses.csv", *options, cwd=tmp_path)
    assert words in run.refusal()
    assert not list(tmp_path.iterdir())


NO_LIMITS = '<limit effort="1" velocity="1"/>'


def limited(first, second):
    """A robot whose two joints have these limits, as text."""
    text = urdf_of(("turn", "revolute", "w", "a"), ("slide", "prismatic", "a", "b"))
    usual = '<limit lower="-9" upper="9" effort="1" velocity="1"/>'
    return text.replace(usual, first, 1).replace(usual, second, 1)


def test_joints_without_a_range_are_named_and_stay_in_a_given_one(tmp_path):
    (tmp_path / "r.urdf").write_text(limited(NO_LIMITS, NO_LIMITS))
    (tmp_path / "r.yaml").write_text(
        "urdf: r.urdf\nname_mot: [turn, slide]\nbase: {frame: w}\ntargets: {b: {frame: b}}\n"
        "parametrisation: [{origin: all, components: [x, y, z], sigma: 1 mm}]\n"
    )
    robot = calib.load(tmp_path / "r.yaml")
    with pytest.raises(calib.DataError, match=r"no range to spread poses over for turn, slide: a <limit> without"):
        calib.sample(robot, 3)
    q = calib.sample(robot, 30, within={"turn": (-0.1, 0.2), "slide": (0.0, 0.3)}).joints
    assert np.all((q >= (-0.1, 0.0)) & (q <= (0.2, 0.3)))
    assert np.all(np.ptp(q, axis=0) > 0.1)


def test_limits_that_are_none_are_named(tmp_path, caplog):
    wide = '<limit lower="-1e6" upper="1e6" effort="1" velocity="1"/>'
    short = '<limit lower="0" upper="0.5" effort="1" velocity="1"/>'
    (tmp_path / "sliding.urdf").write_text(limited(short, wide))
    with pytest.raises(calib.DataError, match=r"'slide' has limits as wide as -1e\+06 to 1e\+06 m; give"):
        calib.sample(calib.load(tmp_path / "sliding.urdf"), 3)
    (tmp_path / "turning.urdf").write_text(limited(wide, short))
    q = calib.sample(calib.load(tmp_path / "turning.urdf"), 50).joints
    assert np.all(np.abs(q[:, 0]) <= np.pi)
    assert "limits of 'turn' span 318310 turns; poses are spread over one, around home" in caplog.text
