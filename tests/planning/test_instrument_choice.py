"""Choosing poses and instruments: against all subsets, within what is asked for, and as a plan that is measured."""

import json
from itertools import combinations

import numpy as np
import pytest

import calib
from calib.core.data.plan_files import read_plan
from calib.core.data.tables import read_table
from calib.planning.selection import select
from tests.core.instruments.test_kind_pixel import FREE
from tests.kind_checks import brought
from tests.six_axis_arm import joints, write_six_axis

YAML = f"""\
urdf: arm.urdf
name_mot: [j1, j2, j3, j4, j5, j6]
priors: false
base: {{frame: l0}}
targets: {{ball: {{frame: l6, xyz: [50 mm, 20 mm, 100 mm]}}}}
instruments:
  tracker: {{kind: position, target: ball, sigma: TRACKER}}
  bar: {{kind: distance, target: ball, end: {{frame: l0, xyz: [0.3, 0.2, 0]}}, sigma: 0.02 mm}}
parametrisation:
{FREE}"""
TOUCH = (
    "  probe: {kind: touch, target: ball, sigma: 0.03 mm, places:"
    " {left: {frame: l0, xyz: [0.5, 0.2, 0.6]}, right: {frame: l0, xyz: [0.7, -0.3, 0.4]}}}\nparametrisation:"
)
SIGMA = {"tracker": 5e-5, "bar": 2e-5}
END = np.array([0.3, 0.2, 0.0])


def arm(folder, tracker="0.05 mm", edit=("", "")):
    return calib.load(write_six_axis(folder, YAML.replace("TRACKER", tracker).replace(*edit)))


def information(robot, q):
    """Of each instrument at each pose, in units of the parameters' sigma: by central differences of what it reads."""
    scales, step = np.array([p.sigma_si for p in robot.parameters]), 1e-3
    sides = []
    for sign in (1, -1):
        moved = [robot.with_parameters(robot.values + sign * step * each) for each in np.diag(scales)]
        points = np.stack([robot.positions(q)[:, 0] for robot in moved], axis=2)
        sides.append({"tracker": points, "bar": np.linalg.norm(points - END[:, None], axis=1)[:, None]})
    rows = {name: (sides[0][name] - sides[1][name]) / (2 * step * SIGMA[name]) for name in SIGMA}
    return {name: jacobian.transpose(0, 2, 1) @ jacobian for name, jacobian in rows.items()}


def o1(matrix, count, unit=5e-5):
    """Geometric mean of the singular values of the rows over the root of their number [m]."""
    return unit * max(np.linalg.det(matrix), 0.0) ** (0.5 / len(matrix)) / np.sqrt(count)


def chosen_pairs(result):
    return set(zip(result.chosen.tolist(), result.instruments, strict=True))


def best_of_all(parts, pairs, count, counts=None):
    """Best O1 over all subsets of pairs, with their information, and whether each has the wanted numbers."""
    subsets = [
        subset
        for subset in combinations(pairs, count)
        if all(sum(name == kind for _, name in subset) == n for kind, n in (counts or {}).items())
    ]
    values = [o1(sum(parts[name][k] for k, name in subset), count) for subset in subsets]
    return max(values), set(subsets[np.argmax(values)])


@pytest.mark.parametrize("counts", [None, {"tracker": 2, "bar": 3}], ids=["free", "counted"])
def test_the_choice_is_the_best_of_all_subsets_and_below_its_bound(tmp_path, counts):
    robot, equal = arm(tmp_path), 0
    for seed in range(3):
        q = joints(6, seed)
        parts = information(robot, q)
        pairs = [(k, name) for name in SIGMA for k in range(len(q))]
        best, which = best_of_all(parts, pairs, 5, counts)
        options = {"count": 5, "instruments": "each"} if counts is None else {"count": counts}
        selection = select(robot, q, **options, starts=4)
        assert selection.after["O1"] == pytest.approx(
            o1(sum(parts[name][k] for k, name in chosen_pairs(selection)), 5), rel=1e-6
        )
        assert best <= selection.bound * (1 + 1e-6)
        assert selection.after["O1"] >= selection.efficiency * best * (1 - 1e-6)
        assert selection.after["O1"] > 0.97 * best
        equal += chosen_pairs(selection) == which
    assert equal >= 2


def test_the_noise_of_an_instrument_decides_how_often_it_is_chosen(tmp_path):
    q = joints(40, 2)
    numbers = []
    for tracker in ("0.5 mm", "0.05 mm", "0.005 mm"):
        selection = select(arm(tmp_path, tracker), q, 20, instruments="each")
        numbers.append(selection.instruments.count("tracker"))
        assert len(chosen_pairs(selection)) == 20
        assert selection.efficiency > 0.97
    assert numbers[0] <= 12
    assert numbers[0] < numbers[1] <= numbers[2] == 20


def test_each_instrument_gets_the_number_that_is_asked_for_and_a_path_of_its_own(tmp_path):
    robot, q = arm(tmp_path), joints(40, 3)
    selection = select(robot, q, {"tracker": 4, "bar": 9}, "task", random_start=True, seed=1)
    assert selection.instruments == ("tracker",) * 4 + ("bar",) * 9
    assert selection.efficiency > 0.9
    assert selection.bound <= selection.after["task"]
    apart = select(robot, q, {"tracker": 4, "bar": 9}, "O3", minimum_distance=0.1)
    assert [apart.instruments.count(name) for name in SIGMA] == [4, 9]
    pose = apart.chosen
    gaps = np.linalg.norm(apart.positions[:, None, 0] - apart.positions[None, :, 0], axis=2)
    assert np.all(gaps[pose[:, None] != pose] >= 0.1)


def test_groups_read_together_and_all_of_them_is_the_choice_of_poses(tmp_path):
    robot, q = arm(tmp_path), joints(30, 4)
    together = select(robot, q, 8, instruments=["tracker+bar"])
    plain = select(robot, q, 8)
    assert set(together.chosen.tolist()) == set(plain.chosen.tolist())
    assert together.after["O1"] == pytest.approx(plain.after["O1"], rel=1e-12)
    assert set(together.instruments) == {"tracker+bar"}
    assert plain.instruments == plain.groups == ()
    alone = select(robot, q, 8, instruments="bar")
    assert set(alone.instruments) == {"bar"}


def test_excluded_poses_stay_out_and_a_measured_pose_may_be_read_by_another_instrument(tmp_path):
    robot, q = arm(tmp_path), joints(12, 5)
    assert set(select(robot, q, 12, instruments="each", exclude=range(6)).chosen.tolist()) == set(range(6, 12))
    read = calib.as_measurements(robot, q[:6], {"tracker": robot.positions(q[:6])[:, 0]})
    selection = select(robot, q, 18, instruments="each", measured=read)
    assert selection.already_measured == 6
    assert chosen_pairs(selection) == {(k, "bar") for k in range(12)} | {(k, "tracker") for k in range(6, 12)}


def test_a_touch_is_chosen_only_where_the_candidates_say_what_is_touched(tmp_path):
    robot, q = arm(tmp_path, edit=("parametrisation:", TOUCH)), joints(20, 6)
    words = ["left" if k % 4 == 0 else "right" if k % 4 == 1 else "" for k in range(20)]
    candidates = calib.as_measurements(robot, q, {"probe": words})
    selection = select(robot, candidates, 16, instruments=["probe", "tracker"])
    touched = {k for k, name in chosen_pairs(selection) if name == "probe"}
    assert touched
    assert all(words[k] for k in touched)
    with pytest.raises(calib.InputError, match="count 11 of probe is above the 10 candidates"):
        select(robot, candidates, {"probe": 11, "tracker": 3})
    with pytest.raises(calib.InputError, match="the poses do not say what it touches; add a column 'probe'"):
        select(robot, q, 8, instruments="each")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"instruments": "trakker"}, "no instrument 'trakker'; did you mean 'tracker'"),
        ({"instruments": ["bar", "bar"]}, "name each instrument, or each group of them, once"),
        ({"instruments": ["bar+bar"]}, "'bar\\+bar' names an instrument twice"),
        ({"instruments": []}, "name each instrument"),
        ({"count": {"tracker": 8}, "instruments": "each"}, "leave out `instruments`"),
        ({"count": {"tracker": -1, "bar": 9}}, "count -1 of tracker"),
        ({"count": {"tracker": 0, "bar": 0}}, "count 0: choose at least one pose"),
        ({"count": {"wire": 8}}, "no instrument 'wire'"),
        ({"count": {"bar": 5}}, "5 measured values cannot determine 6 parameters; choose at least 6 poses"),
    ],
)
def test_bad_choices_are_one_clear_line(tmp_path, arguments, words):
    with pytest.raises(calib.InputError, match=words):
        select(arm(tmp_path), joints(20, 7), **({"count": 8} | arguments))


@pytest.fixture(scope="module")
def planned(tmp_path_factory, run_calib):
    """A folder with candidates, two thirds of which touch something, a plan chosen from them, and what was printed."""
    folder = tmp_path_factory.mktemp("plan")
    robot = arm(folder, edit=("parametrisation:", TOUCH))
    sockets = {"left": [0.5, 0.2, 0.6], "right": [0.7, -0.3, 0.4]}
    words = np.array(["left", "right", ""] * 30)
    q = joints(90, 8)
    at_contact, ok = brought(robot, q, np.array([sockets.get(word, [0.6, 0, 0.5]) for word in words]))
    q = np.where((words == "")[:, None], q, at_contact)
    kept = np.flatnonzero((ok | (words == "")) & np.all(np.abs(q) < 2.9, axis=1))
    header = ",".join(["pose", *(f"j{k} [deg]" for k in range(1, 7)), "probe", "remark"])
    lines = [f"p{k},{','.join(map(repr, np.degrees(q[k]).tolist()))},{words[k]},as it was" for k in kept]
    (folder / "candidates.csv").write_text("\n".join([header, *lines]) + "\n")
    run = run_calib("select", folder / "arm.yaml", folder / "candidates.csv", "--count", "24", "--instruments",
                    "tracker,probe,bar", "--out", folder / "plan.csv", "--json", folder / "plan.json")  # fmt: skip
    assert run.code == 0, run.err
    return folder, robot, run.out


def test_the_plan_says_for_every_pose_what_reads_and_what_is_touched(planned):
    folder, robot, out = planned
    content, table = json.loads((folder / "plan.json").read_text()), read_table(folder / "plan.csv")
    assert table.names == ("instrument", *read_table(folder / "candidates.csv").names)
    assert list(table.text("instrument")) == content["instruments"]
    assert list(table.text("pose")) == content["chosen"]
    assert sorted(table.text("instrument"), key=["tracker", "probe", "bar"].index) == list(table.text("instrument"))
    for name, word in zip(table.text("instrument"), table.text("probe"), strict=True):
        assert bool(word) == (name == "probe")
    n = {name: content["instruments"].count(name) for name in ("tracker", "probe", "bar")}
    assert ", ".join(f"{n[name]} with {name}" for name in n) + f"; at {len(set(content['chosen']))} of " in out
    assert n["probe"] > 2
    assert set(table.text("remark")) == {"as it was"}
    plan = read_plan(folder / "plan.csv", robot)
    assert {name: len(item) for name, item in plan.planned.items()} == n


def test_a_plan_is_checked_simulated_and_fitted(planned, run_calib):
    folder, robot, _ = planned
    (folder / "truth.csv").write_text("parameter,value,unit\nj2.ry,5,mrad\nj3.z,602,mm\nj5.x,397,mm\n")
    check = run_calib("check", folder / "arm.yaml", folder / "plan.csv", "--json", folder / "check.json")
    assert check.code == 0, check.err
    checked = json.loads((folder / "check.json").read_text())
    chosen = json.loads((folder / "plan.json").read_text())
    # O1 divides by the number of visits; two instruments at one pose are two visits and one pose
    assert checked["observability"]["scaled"]["O1"] == pytest.approx(
        chosen["after"]["O1"] * np.sqrt(24 / len(set(chosen["chosen"]))), rel=1e-6
    )
    options = ("--parameters", folder / "truth.csv", "--seed", "1", "--out", folder / "measured.csv")
    run = run_calib("simulate", folder / "arm.yaml", folder / "plan.csv", *options)
    assert run.code == 0, run.err
    data = calib.read_measurements(folder / "measured.csv", robot)
    assert {name: len(readings) for name, readings in data.readings.items()} == {
        name: chosen["instruments"].count(name) for name in ("tracker", "bar", "probe")
    }
    fit = calib.fit(robot, data)
    truth = {"j2.ry": 0.005, "j3.z": 0.602, "j5.x": 0.397}
    for k, name in enumerate(fit.free_names):
        value = truth.get(name, robot.parameters[k].nominal_si)
        assert abs(fit.robot.values[k] - value) < 2 * fit.statistics.half_width[k]


@pytest.mark.parametrize(
    ("options", "edit", "words"),
    [
        (("--count", "tracker=3,bar"), None, "--count tracker=3,bar: must be a number, or one for each"),
        (("--count", "many"), None, "--count many: must be a number"),
        (("--count", "tracker=3,tracker=4"), None, "name each instrument, or each group of them, once"),
        (("--count", "9"), (",left,", ",lift,"), "column 'probe': 'probe' touches nothing called 'lift'"),
        (("--count", "9"), ("remark", "instrument"), "column 'instrument': no instrument 'as it was'"),
    ],
)
def test_bad_plans_are_one_line_and_exit_code_2(planned, run_calib, tmp_path, options, edit, words):
    folder, _, _ = planned
    (tmp_path / "c.csv").write_text((folder / "candidates.csv").read_text().replace(*(edit or ("", ""))))
    run = run_calib("select", folder / "arm.yaml", tmp_path / "c.csv", *options, "--out", tmp_path / "out.csv")
    assert words in run.refusal()
    assert not (tmp_path / "out.csv").exists()
