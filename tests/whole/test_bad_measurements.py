"""Measurements that cannot give a calibration end in the right words and exit code, never in a wrong number."""

import json
from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.core.robots.file_formats import formats
from calib.exporting.formats import JOINT_TABLES
from calib.printers import COMMENTS as FIRMWARES
from tests.project import write_table
from tests.six_axis_arm import FREE, YAML, joints, measurements, write_six_axis
from tests.small_robots import ARM_YAML, write_arm

SIGMA = 4e-5
NOT_FOR_ARMS = ("ur-kinematics", "rotary-axes", JOINT_TABLES, *FIRMWARES)
ARM_HEADER = ",".join([*(f"j{k} [rad]" for k in range(1, 7)), *(f"ball_{axis} [m]" for axis in "xyz")])
UNKNOWN_BASE = YAML.replace("frame: l0", "frame: l0, pose: unknown")
RNG = np.random.default_rng(3)


@pytest.fixture
def folder(tmp_path):
    write_six_axis(tmp_path)
    (tmp_path / "priors.yaml").write_text(YAML + FREE)
    (tmp_path / "unknown_base.yaml").write_text(UNKNOWN_BASE + FREE)
    return tmp_path


@pytest.fixture
def fit_file(folder, run_calib):
    """Write joints and positions to a file, fit it, and return the run and the result (None if none was written)."""

    def fit(q, positions, robot="arm.yaml", *options, header=ARM_HEADER):
        write_table(folder / "data.csv", header, q, positions)
        run = run_calib("fit", folder / robot, folder / "data.csv", "--out", folder / "out", *options)
        result = folder / "out" / "result.json"
        return run, json.loads(result.read_text()) if result.exists() else None

    return fit


def arm_positions(folder, q, sigma=SIGMA):
    positions = calib.load(folder / "arm.yaml").positions(q)[:, 0]
    return positions + sigma * RNG.standard_normal(positions.shape)


def one_line(run):
    assert len(run.err.strip().splitlines()) == 1
    assert "Traceback" not in run.err
    return run.err


@pytest.mark.quick(1)
@pytest.mark.parametrize("command", ["fit", "check", "verify"])
def test_a_file_given_twice_is_refused(folder, fit_file, run_calib, command):
    q = joints(40)
    fit_file(q, arm_positions(folder, q))
    again = folder / ".." / folder.name / "data.csv"
    options = ("--result", folder / "out") if command == "verify" else ()
    options += ("--out", folder / "twice") if command == "fit" else ()
    run = run_calib(command, folder / "arm.yaml", folder / "data.csv", again, *options)
    assert run.code == 2
    assert "data.csv: is given twice, so that every reading would count as two" in " ".join(one_line(run).split())
    assert not (folder / "twice").exists()


@pytest.mark.parametrize("n", [1, 2, 8])
def test_too_few_rows_are_a_wrong_input(folder, fit_file, n):
    run, result = fit_file(joints(n), arm_positions(folder, joints(n)))
    assert run.code == 2
    assert f"{n} pose" in one_line(run)
    assert f"{3 * n} measured values for 26 unknowns without a prior; measure at least 9 poses" in run.err
    assert result is None


TARGET_TOO = YAML.replace("mm]}", "mm], position: unknown, sigma: 5 mm}")
"""The ball adds its distance from axis 6 to what poses determine; along and about that axis priors hold it."""


@pytest.mark.quick(0)
@pytest.mark.parametrize(
    ("yaml", "words"),
    [
        (YAML, "26 combinations of the 36 free parameters can be found from these poses; 10 are NOT determined"),
        (TARGET_TOO, "27 combinations of the 39 free parameters can be found from these poses, 2 more stay near"),
    ],
)
def test_check_and_fit_count_in_the_same_words_what_cannot_be_separated(folder, fit_file, run_calib, yaml, words):
    (folder / "all.yaml").write_text("priors: false\n" + yaml + FREE)
    run, result = fit_file(joints(60), arm_positions(folder, joints(60)), "all.yaml")
    assert (run.code, result) == (3, None)
    assert words in one_line(run)
    assert "; not separable: " in run.err
    assert "hold 10 of them" in run.err
    assert words in run_calib("check", folder / "all.yaml", folder / "data.csv").out


def still(n):
    return np.tile(joints(1), (n, 1))


def without_joint_3(n):
    return joints(n) * [1, 1, 0, 1, 1, 1] + [0, 0, 0.4, 0, 0, 0]


@pytest.mark.parametrize(
    ("poses", "n", "said"),
    [(still, 20, "(all poses are the same)"), (without_joint_3, 60, "(joint j3 never moved)")],
)
def test_poses_that_determine_too_little_without_priors_are_named(folder, fit_file, poses, n, said):
    run, result = fit_file(poses(n), arm_positions(folder, poses(n)))
    assert run.code == 3
    assert said in one_line(run)
    assert result is None


def on_a_line(folder, q):
    return (
        np.array([2.0, 0, 0]) + np.outer(np.linspace(0, 1, len(q)), [1.0, 2.0, 0.5]) + SIGMA * RNG.normal(size=(12, 3))
    )


@pytest.mark.parametrize(
    ("poses", "positions", "said"),
    [(joints, on_a_line, "all measured positions lie on one line"), (still, arm_positions, "all poses are the same")],
)
def test_what_fixes_no_measurement_frame_is_a_wrong_input(folder, fit_file, poses, positions, said):
    run, result = fit_file(poses(12), positions(folder, poses(12)), "unknown_base.yaml")
    assert run.code == 2
    assert f"data.csv: {said}. They do not" in one_line(run)
    assert result is None


@pytest.mark.quick(0)
def test_noise_of_metres_fails_and_a_forced_export_says_so_in_every_format(folder, fit_file, run_calib):
    q, noisy = joints(30), arm_positions(folder, joints(30), sigma=2.0)
    run, result = fit_file(q, noisy)
    assert run.code == 3
    assert one_line(run).startswith("calib: verdict FAIL: ")
    assert "calibrated.urdf was not written" in run.err
    assert "(--force writes it)" in run.err
    assert "Verdict: FAIL" in run.out
    assert "noise_as_large_as_robot" in result["verdict"]["codes"]
    assert not (folder / "out" / "calibrated.urdf").exists()
    run, result = fit_file(q, noisy, "arm.yaml", "--force")
    assert run.code == 0
    assert result["verdict"]["forced"] is True
    assert (folder / "out" / "calibrated.urdf").exists()
    assert "verdict: FAIL, not to be used" in (folder / "out" / "parameters.csv").read_text()
    for file_format in (item for item in formats() if item not in NOT_FOR_ARMS):
        target = folder / f"exported.{'yaml' if file_format == 'toolbox' else file_format}"
        run = run_calib(
            "export", folder / "arm.yaml", "--result", folder / "out", "--format", file_format, "--out", target
        )
        assert run.code == 0, run.err
        assert "failed" in one_line(run)
        assert "verdict: FAIL, exported by force" in target.read_text()
        assert "no fit: residuals" in target.read_text()
    for command, given in (("predict", "data.csv"), ("solve", "predict.csv")):
        target = folder / f"{command}.csv"
        run = run_calib(command, folder / "arm.yaml", folder / given, "--result", folder / "out", "--out", target)
        assert run.code == 0, run.err
        assert "failed" in one_line(run)
        assert "# verdict: FAIL, exported by force" in target.read_text()


def test_joint_values_from_python_that_are_not_finite_are_named(folder):
    robot, q = calib.load(folder / "arm.yaml"), joints(40)
    q[6, 2] = np.inf
    with pytest.raises(calib.DataError, match="row 6: joint values are not finite"):
        calib.fit(robot, replace(measurements(robot, joints(40), robot.positions(joints(40))), joints=q))


@pytest.mark.amount(3000, 100_000)
def test_a_hundred_thousand_rows_are_one_fit_like_any_other(tmp_path, amount):
    free = "  - {origin: turn, components: [x, y, z], sigma: 2 mm}\n"
    free += "  - {origin: slide, components: [rx, rz], sigma: 5 mrad}\npriors: false\n"
    robot = calib.load(write_arm(tmp_path, ARM_YAML.partition("  - ")[0] + free))
    n = amount
    q = np.random.default_rng(0).uniform([-2, 0, -2], [2, 1, 2], (n, 3))
    truth = robot.with_parameters({"turn.x": 1e-3, "slide.rz": 2e-3})
    positions = truth.positions(q) + SIGMA * np.random.default_rng(1).standard_normal((n, 1, 3))
    fit = calib.fit(robot, measurements(robot, q, positions), sigma=SIGMA)
    assert fit.verdict.grade == "PASS"
    assert fit.sigma == pytest.approx(SIGMA, rel=1.6 / np.sqrt(n))  # four standard errors
    assert fit.statistics.freedom == pytest.approx(3 * n - 5)
    assert np.all(np.abs(fit.robot.values - truth.values) < 5 * fit.statistics.std)
    assert np.max(fit.statistics.std) < 1e-3 / np.sqrt(n)  # readings of 0.04 mm, arm of 0.5 m
