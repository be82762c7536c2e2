"""`calib select` as a user runs it."""

import json

import numpy as np
import pytest

import calib
from calib.core.base.files import write_file
from calib.core.data.table_writing import format_table
from calib.core.data.tables import read_table
from medrue import robot_file
from medrue.workspace import target_workspace
from tests.planning.poses_written import write_poses
from tests.small_robots import ARM_YAML, write_arm

ROBOT = robot_file()
Q = target_workspace().q


@pytest.fixture(scope="module")
def candidates(tmp_path_factory, medrue):
    q = Q[::2]
    points = 1e3 * medrue.positions(q)[:, 0]
    more = [(f"tool_{axis} [mm]", list(points[:, k])) for k, axis in enumerate("xyz")]
    path = tmp_path_factory.mktemp("select") / "candidates.csv"
    return write_poses(path, q, [f"p{k + 1}" for k in range(len(q))], [*more, ("remark", ["a b"] * len(q))])


@pytest.fixture(scope="module")
def selected(run_calib, candidates, tmp_path_factory):
    folder = tmp_path_factory.mktemp("selected")
    run = run_calib(
        "select", ROBOT, candidates, "--count", 42, "--index", "o1", "--out", folder / "poses.csv",
        "--json", folder / "select.json", "--plots", folder / "plots",
    )  # fmt: skip
    assert run.code == 0, run.err
    return run, json.loads((folder / "select.json").read_text()), folder


def test_the_result_has_index_before_and_after_history_efficiency_and_seconds(selected):
    content = selected[1]
    assert content["after"]["O1"] > content["before"]["O1"]
    assert content["efficiency_percent"] == pytest.approx(100 * content["efficiency"])
    assert content["efficiency"] > 0.997
    assert content["bound"] >= content["after"]["O1"]
    assert content["runs"][0]["history"][0] == pytest.approx(content["before"]["O1"])
    assert len(content["runs"][0]["exchanges"]) == len(content["runs"][0]["history"]) - 1
    assert content["seconds"] >= content["selecting_seconds"] > 0
    assert (content["count"], content["candidates"], content["index"]) == (42, 210, "O1")
    assert len(set(content["chosen"])) == 42


def test_the_poses_are_rows_of_the_candidates_in_the_order_of_measurement(selected, candidates):
    before, after = read_table(candidates), read_table(selected[2] / "poses.csv")
    assert (after.names, after.units) == (before.names, before.units)
    assert after.text("pose") == selected[1]["chosen"]
    rows = dict(zip(before.text("pose"), before.rows, strict=True))
    assert [rows[name] for name in after.text("pose")] == list(after.rows)
    assert "chosen by O1, in order of measurement" in after.comments[0]
    assert (selected[2] / "plots" / "index.svg").read_text().startswith("<?xml")


def test_fit_predict_and_simulate_read_the_poses(run_calib, selected, tmp_path):
    poses = selected[2] / "poses.csv"
    assert run_calib("predict", ROBOT, poses, "--out", tmp_path / "p.csv").code == 0
    simulated = tmp_path / "s.csv"
    assert run_calib("simulate", ROBOT, poses, "--sigma-mm", 0.04, "--seed", 1, "--out", simulated).code == 0
    robot = calib.load(ROBOT)
    result = calib.fit(robot, calib.read_measurements(simulated, robot))
    assert result.observability["O1"] == pytest.approx(selected[1]["after"]["O1"], rel=1e-3)
    assert calib.read_measurements(poses, robot).n_readings == 42


def test_without_a_pose_column_rows_are_numbered(run_calib, tmp_path):
    path, given = write_poses(tmp_path / "c.csv", Q[::10]), ("--count", 12, "--exclude", "3,17,20-25")
    assert run_calib("select", ROBOT, path, *given, "--out", tmp_path / "o.csv").code == 0
    chosen = set(read_table(tmp_path / "o.csv").text("pose"))
    assert len(chosen) == 12
    assert not chosen & {"3", "17", *map(str, range(20, 26))}


def test_measured_poses_are_complemented_and_counted_with_their_repeats(run_calib, candidates, tmp_path):
    names = [str(k // 2) for k in range(40)]
    positions = [(f"tool_{axis} [mm]", [0.0] * 40) for axis in "xyz"]
    measured = write_poses(tmp_path / "m.csv", np.repeat(Q[:80:4], 2, axis=0), names, positions)
    given = (
        "--measured",
        measured,
        "--min-distance-mm",
        20,
        "--out",
        tmp_path / "o.csv",
        "--json",
        tmp_path / "o.json",
    )
    run = run_calib("select", ROBOT, candidates, "--count", 20, *given)
    assert run.code == 0, run.err
    assert "measured alone" in run.out
    assert "20 candidates already measured and left out" in run.out
    content = json.loads((tmp_path / "o.json").read_text())
    assert content["measured_only"]["task"] > content["after"]["task"]


def test_measured_candidates_that_repeat_a_pose_are_one_and_all_their_rows_are_kept(run_calib, tmp_path):
    names = [f"p{k // 2}" for k in range(80)]
    positions = [(f"tool_{axis} [mm]", list(np.arange(80.0))) for axis in "xyz"]
    path = write_poses(tmp_path / "c.csv", np.repeat(Q[::10][:40], 2, axis=0), names, positions)
    # the made-up positions of a pose differ by 1 mm, which is a scatter, not an error
    assert run_calib("select", ROBOT, path, "--count", 15, "--out", tmp_path / "o.csv").code == 0
    table = read_table(tmp_path / "o.csv")
    assert len(table.rows) == 30
    assert len(set(table.text("pose"))) == 15


def broken(folder):
    """Files with one mistake each."""
    write_poses(folder / "good.csv", Q[::10])
    open_poses = Q[::10].copy()
    open_poses[4, 1:3] = 0.0, np.pi
    write_poses(folder / "open.csv", open_poses)
    write_poses(folder / "twice.csv", np.vstack([Q[::10], Q[:1]]))
    write_poses(folder / "names.csv", Q[:3], ["a", "b", "a"])


@pytest.mark.quick(2)
@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("good.csv", "--count", "43"), "count 43 is above the 42 candidates"),
        (("good.csv", "--count", "20", "--index", "O7"), "'O7' is not one of"),
        (("open.csv", "--count", "20"), "open.csv, line 6: cannot be assembled (loop"),
        (("twice.csv", "--count", "20"), "twice.csv, line 44: the same joint values as twice.csv, line 2"),
        (("names.csv", "--count", "20"), "line 4 (pose a): pose 'a' is given twice"),
        (("good.csv", "--count", "20", "--exclude", "7,99"), "has no pose '99'"),
        (("good.csv", "--count", "20", "--exclude", "40-50"), "has no pose '43'"),
        (("good.csv", "--count", "20", "--min-distance-mm", "-1"), "minimum distance"),
        (("good.csv", "--count", "20", "--starts", "0"), "0 starts"),
        (("good.csv",), "give one of --count and --goal-mm"),
        ((), "Missing argument 'CANDIDATES'; here: a file of joint values, such as calib sample"),
    ],
)
def test_bad_input_is_one_line_exit_code_2_and_nothing_is_written(run_calib, tmp_path, arguments, words):
    broken(tmp_path)
    write_file(tmp_path / "out.csv", "kept")
    kept = (tmp_path / "out.csv").read_bytes()
    run = run_calib("select", ROBOT, *arguments, "--out", "out.csv", cwd=tmp_path)
    assert words in run.refusal()
    assert (tmp_path / "out.csv").read_bytes() == kept


@pytest.mark.quick(0)
def test_unreachable_candidates_are_skipped_on_request_and_listed(run_calib, tmp_path):
    broken(tmp_path)
    run = run_calib("select", ROBOT, "open.csv", "--count", 20, "--skip-unreachable", "--out", "o.csv", cwd=tmp_path)
    assert run.code == 0, run.err
    assert "1 candidate skipped:" in run.out
    assert "open.csv, line 6: cannot be assembled" in run.out
    assert "5" not in read_table(tmp_path / "o.csv").text("pose")


def test_a_task_that_the_candidates_do_not_determine_is_exit_code_3(run_calib, tmp_path):
    arm = calib.load(write_arm(tmp_path, ARM_YAML + "priors: false\n"))
    rng = np.random.default_rng(0)
    for name, spread in (("c.csv", [0.0, 0.4, 1.0]), ("t.csv", [2.0, 0.4, 1.0])):  # candidates do not turn
        q = np.array([0.0, 0.5, 0.0]) + rng.uniform(-1, 1, (30, 3)) * spread
        (tmp_path / name).write_text(format_table([(n, list(q[:, k])) for k, n in enumerate(arm.joint_names)]))
    arguments = ("--count", 20, "--index", "task", "--task", "t.csv", "--out", "o.csv")
    run = run_calib("select", "arm.yaml", "c.csv", *arguments, cwd=tmp_path)
    assert run.code == 3
    assert "has no bound" in run.err


def test_poses_are_chosen_for_the_conditions_that_candidates_state(run_calib, tmp_path):
    """A zero and half of the play of one joint, seen from a distance r: the best two poses come from both sides.

    Rows [r s1, +-r s2] with sigmas s1 and s2, and the prior of the play: the information is diagonal,
    2 r^2 s1^2 and 2 r^2 s2^2 + noise^2.
    """
    more = "priors: false\nparametrisation:\n  - {origin: turn, components: [rz], sigma: 2 mrad}\n"
    more += "  - {joint: turn, term: backlash, sigma: 0.5 mrad}\n"
    arm = calib.load(write_arm(tmp_path, ARM_YAML.partition("parametrisation:")[0] + more))
    rng = np.random.default_rng(0)
    q = np.repeat(rng.uniform([-2, 0.1, -0.01], [2, 0.6, 0.01], (10, 3)), 2, axis=0)  # every pose from both sides
    columns = [(name, list(q[:, k])) for k, name in enumerate(["turn", "slide", "wrist"])]
    (tmp_path / "c.csv").write_text(format_table([*columns, ("approach_turn", [1.0, -1.0] * 10)]))
    arguments = ["--count", 2, "--out", "o.csv", "--json", "o.json", "--sigma-mm", 0.1]
    run = run_calib("select", "arm.yaml", "c.csv", *arguments, cwd=tmp_path)
    assert run.code == 0, run.err
    assert sorted(float(cell) for cell in read_table(tmp_path / "o.csv").text("approach_turn")) == [-1, 1]
    r = np.max(np.linalg.norm(arm.positions(q)[:, 0, :2], axis=1))
    content = json.loads((tmp_path / "o.json").read_text())["after"]["O1"]
    expected = (2 * (r * 2e-3) ** 2 * (2 * (r * 0.5e-3) ** 2 + 1e-4**2)) ** 0.25 / np.sqrt(2)
    assert expected * (1 - 1e-9) <= content <= expected * (1 + 1e-9)
