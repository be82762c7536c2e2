"""`calib check` as a user runs it."""

import json
import math

import numpy as np
import pytest

import calib
from calib.core.data.table_writing import format_table
from medrue import robot_file
from medrue.workspace import target_workspace
from tests.planning.poses_written import write_poses
from tests.small_robots import ARM_YAML, write_arm

ROBOT = robot_file()
Q = target_workspace().q


@pytest.fixture(scope="module")
def checked(run_calib, tmp_path_factory):
    folder = tmp_path_factory.mktemp("check")
    data = write_poses(folder / "poses.csv", Q[::4])
    run = run_calib("check", ROBOT, data, "--json", folder / "check.json", "--plots", folder / "plots")
    assert run.code == 0, run.err
    return run, json.loads((folder / "check.json").read_text()), folder


def test_it_says_what_the_poses_determine(checked):
    out = checked[0].out
    assert "105 poses" in out
    assert "rank 28 of 36 (gap: singular value 28 is" in out
    assert "All 28 free parameters can be found from these poses." in out
    assert "  d31, d32 have no effect" in out
    assert "  d5 from xt" in out
    assert "hold A2y, A2z, d31, d32, d41, d5, xb, zb" in out
    assert "these are held" in out
    assert "Predicted position error against number of poses" in out


def test_the_same_as_json(checked):
    content = checked[1]
    assert content["rank_all"]["rank"] == content["rank_free"]["rank"] == 28
    assert content["rank_all"]["n_columns"] == 36
    assert len(content["rank_all"]["singular_values"]) == 36
    assert [group["text"] for group in content["groups"]][:2] == ["d31 has no effect", "d32 has no effect"]
    assert {item["name"] for item in content["elimination"]} == set(content["held"])
    assert set(content["observability"]) == {"scaled", "raw"}
    assert len(content["parameters"]) == 28
    assert 0 < content["accuracy_mm"]["rms"] < content["accuracy_mm"]["max"] < 0.1
    assert content["by_count"][-1]["count"] == 4 * 105
    assert content["sigma_mm"] == pytest.approx(0.04)


def test_figures_are_files(checked):
    folder = checked[2] / "plots"
    figures = sorted(folder.glob("[!.]*"))
    assert [path.name for path in figures] == ["accuracy.svg", "correlations.svg", "singular_values.svg"]
    assert all(path.read_text().startswith("<?xml") for path in figures)


def test_without_data_poses_are_sampled(run_calib, tmp_path):
    run = run_calib("check", write_arm(tmp_path), "--poses", 30, "--json", "-")
    assert run.code == 0, run.err
    content = json.loads(run.out)
    assert content["n_poses"] == 30
    assert content["sigma_assumed"]
    assert content["rank_with_priors"] == content["rank_free"]["n_columns"] > content["rank_free"]["rank"]
    again = run_calib("check", tmp_path / "arm.yaml", "--poses", 30, "--json", "-")
    assert again.out == run.out


def test_a_plain_urdf_is_enough(run_calib, tmp_path):
    write_arm(tmp_path)
    run = run_calib("check", tmp_path / "arm.urdf", "--poses", 30)
    assert run.code == 0, run.err
    assert " stay near nominal" in run.out
    assert "(assumed: state it with --sigma-mm or in the description)" in " ".join(run.out.split())


def test_instruments_without_lengths_have_no_noise_in_mm_and_samples_one_setup(run_calib, tmp_path):
    yaml = (
        ARM_YAML.replace("{frame: ground}", "{frame: ground, pose: unknown}") + "setups: {first: [], later: [base]}\n"
    )
    yaml += "instruments: {turned: {kind: orientation, target: tip, sigma: 0.1 mrad}}\n"
    run = run_calib("check", write_arm(tmp_path, yaml), "--poses", 20, "--json", tmp_path / "out.json")
    assert run.code == 0, run.err
    assert run.out.startswith("20 poses (sampled over the joint limits, seed 0), 60 measured values\n")
    assert json.loads((tmp_path / "out.json").read_text())["sigma_mm"] is None
    assert "all sampled poses are in the first setup" in run.err


def test_what_is_not_determined_is_said(run_calib, tmp_path):
    write_arm(tmp_path, ARM_YAML + "priors: false\n")
    run = run_calib("check", tmp_path / "arm.yaml", "--verbose", "--json", tmp_path / "out.json")
    assert run.code == 0, run.err
    assert "NOT determined." in run.out
    assert "unbounded" in run.out
    content = json.loads((tmp_path / "out.json").read_text())
    assert content["undetermined"]
    assert any(row["std"] is None for row in content["parameters"])


def test_repeats_of_a_measured_pose_count_as_readings(run_calib, tmp_path):
    names = [str(k // 3) for k in range(90)]
    q = np.repeat(Q[::14], 3, axis=0)
    zeros = [(f"tool_{axis} [mm]", [0.0] * 90) for axis in "xyz"]
    thrice = run_calib("check", ROBOT, write_poses(tmp_path / "a.csv", q, names, zeros), "--json", "-")
    once = run_calib("check", ROBOT, write_poses(tmp_path / "b.csv", Q[::14]), "--json", "-")
    few, many = json.loads(once.out), json.loads(thrice.out)
    assert few["n_poses"] == many["n_poses"] == 30
    assert many["accuracy_mm"]["rms"] == pytest.approx(few["accuracy_mm"]["rms"] / math.sqrt(3), rel=1e-6)


def test_a_repeat_that_was_not_read_leaves_the_file_measurements(run_calib, tmp_path):
    names = [str(k // 2) for k in range(60)]
    cells = [(f"tool_{axis} [mm]", [""] + [0.0] * 59) for axis in "xyz"]
    data = write_poses(tmp_path / "a.csv", np.repeat(Q[::14], 2, axis=0), names, cells)
    run = run_calib("check", ROBOT, data, "--json", "-")
    assert run.code == 0, run.err
    assert json.loads(run.out)["n_rows"] == 3 * 59


def test_a_file_that_waits_for_its_measurements_is_poses_only(run_calib, tmp_path):
    blank = [(f"tool_{axis} [mm]", [""] * 21) for axis in "xyz"]
    run = run_calib("check", ROBOT, write_poses(tmp_path / "poses.csv", Q[::20], more=blank), "--json", "-")
    assert run.code == 0, run.err
    assert json.loads(run.out)["n_poses"] == 21


def test_measured_positions_place_an_unknown_target(run_calib, tmp_path):
    """The tip of a plain URDF is found before its leverage is judged."""
    write_arm(tmp_path)
    arm = calib.load(tmp_path / "arm.yaml")
    q = np.random.default_rng(0).uniform([-2, 0.1, -2], [2, 0.9, 2], (30, 3))
    joints = [(name, list(q[:, k])) for k, name in enumerate(arm.joint_names)]
    points = arm.positions(q)[:, 0]
    measured = [(f"tool_{axis}", list(points[:, k])) for k, axis in enumerate("xyz")]
    (tmp_path / "poses.csv").write_text(format_table(joints))
    (tmp_path / "data.csv").write_text(format_table([*joints, *measured]))
    blind, seeing = (
        json.loads(run_calib("check", tmp_path / "arm.urdf", tmp_path / name, "--json", "-").out)
        for name in ("poses.csv", "data.csv")
    )
    assert blind["rank_all"]["singular_values"] != seeing["rank_all"]["singular_values"]
    assert blind["accuracy_mm"]["rms"] != seeing["accuracy_mm"]["rms"]


def test_accuracy_is_told_for_the_task_poses(run_calib, tmp_path):
    data, task = write_poses(tmp_path / "a.csv", Q[:200:5]), write_poses(tmp_path / "b.csv", Q[300::10])
    here, there = (
        json.loads(run_calib("check", ROBOT, data, "--json", "-", *more).out) for more in ((), ("--task", task))
    )
    assert there["accuracy_mm"]["rms"] > here["accuracy_mm"]["rms"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("few.csv",), "9 poses give 27 measured values for 28 free parameters"),
        (("open.csv",), "line 4"),
        (("poses.csv", "--sigma-mm", "0"), "--sigma-mm 0"),
        (("poses.csv", "--task", "open.csv"), "line 4"),
        (("--poses", "0"), "--poses 0"),
        (("poses.csv", "--json", "nowhere/out.json"), "cannot be written"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(run_calib, tmp_path, arguments, words):
    write_poses(tmp_path / "few.csv", Q[:9])
    write_poses(tmp_path / "poses.csv", Q[::20])
    wrong = Q[::20].copy()
    wrong[2, 1:3] = 0.0, np.pi
    write_poses(tmp_path / "open.csv", wrong)
    run = run_calib("check", ROBOT, *arguments, cwd=tmp_path)
    assert words in run.refusal()
    assert run.out == ""


@pytest.mark.quick(0)
@pytest.mark.parametrize("seed", [0, 2])
def test_so_few_poses_that_none_can_be_spared_are_judged_all_the_same(tmp_path, run_calib, seed):
    write_arm(tmp_path)
    run = run_calib("check", "arm.urdf", "--poses", 3, "--seed", seed, "--json", "check.json", cwd=tmp_path)
    assert run.code == 0, run.err
    counts = [row["count"] for row in json.loads((tmp_path / "check.json").read_text())["by_count"]]
    assert counts == [3, 6, 12]  # with two of them, less is known than with three
