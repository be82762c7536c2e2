"""`calib check` as a user runs it."""

import json
import math

import numpy as np
import pytest

import calib
from calib.core.data.table_writing import format_table
from medrue import robot_file
from medrue.workspace import target_workspace
from tests.planning.poses_written import answer, write_poses
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
    figures = sorted(path.name for path in (checked[2] / "plots").glob("[!.]*"))
    assert figures == ["accuracy.svg", "correlations.svg", "singular_values.svg"]


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


def test_without_data_poses_are_sampled_and_a_plain_urdf_is_enough(run_calib, tmp_path):
    given = ("--poses", 30, "--json", "-")
    content = answer(run_calib("check", write_arm(tmp_path), *given))
    assert content["n_poses"] == 30
    assert content["sigma_assumed"]
    assert content["rank_with_priors"] == content["rank_free"]["n_columns"] > content["rank_free"]["rank"]
    assert answer(run_calib("check", tmp_path / "arm.yaml", *given)) == content
    run = run_calib("check", tmp_path / "arm.urdf", "--poses", 30)
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
    run = run_calib(
        "check", write_arm(tmp_path, ARM_YAML + "priors: false\n"), "--verbose", "--json", tmp_path / "out.json"
    )
    assert run.code == 0, run.err
    assert "NOT determined." in run.out
    assert "unbounded" in run.out
    content = json.loads((tmp_path / "out.json").read_text())
    assert content["undetermined"]
    assert any(row["std"] is None for row in content["parameters"])


def test_repeats_count_as_readings_and_blank_cells_do_not(run_calib, tmp_path):
    def checked(readings, repeats, blank):
        """Of 30 poses, each given several times; None: without columns of readings."""
        names = [str(k // repeats) for k in range(30 * repeats)]
        cells = [""] * blank + [readings] * (30 * repeats - blank)
        more = [] if readings is None else [(f"tool_{axis} [mm]", cells) for axis in "xyz"]
        data = write_poses(tmp_path / "a.csv", np.repeat(Q[::14], repeats, axis=0), names, more)
        return answer(run_calib("check", ROBOT, data, "--json", "-"))

    once, thrice = checked(None, 1, 0), checked(0.0, 3, 0)
    assert once["n_poses"] == thrice["n_poses"] == 30
    assert thrice["accuracy_mm"]["rms"] == pytest.approx(once["accuracy_mm"]["rms"] / math.sqrt(3), rel=1e-6)
    assert checked(0.0, 2, 1)["n_rows"] == 3 * 59  # a repeat that was not read
    assert checked(0.0, 1, 30)["n_rows"] == once["n_rows"]  # a file that waits for its measurements is poses alone


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
        answer(run_calib("check", tmp_path / "arm.urdf", tmp_path / name, "--json", "-"))
        for name in ("poses.csv", "data.csv")
    )
    assert blind["rank_all"]["singular_values"] != seeing["rank_all"]["singular_values"]
    assert blind["accuracy_mm"]["rms"] != seeing["accuracy_mm"]["rms"]


def test_accuracy_is_told_for_the_task_poses(run_calib, tmp_path):
    data, task = write_poses(tmp_path / "a.csv", Q[:200:5]), write_poses(tmp_path / "b.csv", Q[300::10])
    here, there = (answer(run_calib("check", ROBOT, data, "--json", "-", *more)) for more in ((), ("--task", task)))
    assert there["accuracy_mm"]["rms"] > here["accuracy_mm"]["rms"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("few.csv",), "9 poses give 27 measured values for 28 free parameters"),
        (("open.csv",), "line 4"),
        (("poses.csv", "--task", "open.csv"), "line 4"),
        (("--poses", "0"), "--poses 0"),
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
    content = answer(run_calib("check", tmp_path / "arm.urdf", "--poses", 3, "--seed", seed, "--json", "-"))
    assert [row["count"] for row in content["by_count"]] == [
        3,
        6,
        12,
    ]  # with two of them, less is known than with three
