"""The simulated experiment: a truth that the paper's model cannot describe, a tracker, and what calibration leaves."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from click.testing import CliRunner

from calib import read_measurements
from medrue.both_sides import QUICK_COUNTS, ExperimentTask
from medrue.cli import group
from medrue.closed_form import forward
from medrue.draws import Work
from medrue.experiment import QUICK_DRAWS, experiment_draw, run_experiment
from medrue.experiment_tables import cause_rms, experiment_findings, experiment_tables
from medrue.imperfections import TILTED_JOINTS, Imperfections, approach_in_order, imperfect_robot
from medrue.paper_tables import error_table, table3
from medrue.tracker import NESTS, PLACE, find_world, measure
from medrue.workspace import target_workspace
from tests.medrue.medrue_folders import check_folder, check_tables

pytestmark = pytest.mark.quick(0)

NONE = Imperfections(0.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def actual(robot):
    return robot.with_parameters(table3().identified)


def truth_of(extended, actual, imperfections, seed=1):
    return imperfect_robot(extended, actual, imperfections, np.random.default_rng(seed))


@pytest.fixture(scope="module")
def experiment(robot, extended):
    """Two draws, poses of O1 and uniform ones, and 28 poses from both sides."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("medrue.study.INDICES", ("O1",))
        return run_experiment(robot, extended, 2, 3, Work(), Imperfections(), (28,))


def test_without_imperfections_the_truth_is_the_closed_form_with_table_3(extended, actual):
    joints = np.array(target_workspace().q[::7])
    truth = truth_of(extended, actual, NONE)
    exact = forward(joints, table3().identified).p_world_tool
    for side in (1.0, -1.0):
        assert np.abs(truth.positions(joints, np.full(len(joints), side)) - exact).max() < 1e-12


def test_the_approach_follows_from_the_order_of_the_visits():
    order = np.array([2, 0, 1])  # from home at 0.343: down to 0.1, up to 0.2, up to 0.3
    assert approach_in_order(np.array([0.2, 0.3, 0.1]), order, 0.343).tolist() == [1, 1, -1]


def test_backlash_moves_the_tool_along_the_rail_by_half_of_it_against_the_approach(extended, actual):
    joints, approach = np.array(target_workspace().q[:3]), np.array([1.0, 1.0, -1.0])
    exact = truth_of(extended, actual, NONE).positions(joints, approach)
    late = truth_of(extended, actual, Imperfections(1e-3, 0.0, 0.0)).positions(joints, approach)
    along = pin.rpy.rpyToMatrix(*table3().identified[-6:-3])[:, 0]  # x_B in the world
    assert np.abs((late - exact) - np.outer([-0.5e-3, -0.5e-3, 0.5e-3], along)).max() < 1e-12


def test_lead_error_grows_with_the_travel(extended, actual):
    joints, approach = np.tile(target_workspace().q[0], (2, 1)), np.ones(2)
    joints[:, 0] = (0.1, 0.4)
    exact = truth_of(extended, actual, NONE).positions(joints, approach)
    wrong = truth_of(extended, actual, Imperfections(0.0, 50e-6 / 0.3, 0.0)).positions(joints, approach)
    assert np.linalg.norm(np.diff(wrong - exact, axis=0)) == pytest.approx(50e-6, rel=1e-6)


def test_tilts_turn_the_eight_axes_and_move_the_tool_mostly_along_the_rail(extended, actual):
    joints, approach = np.array(target_workspace().q), np.ones(420)
    exact = truth_of(extended, actual, NONE).positions(joints, approach)
    truth = truth_of(extended, actual, Imperfections(0.0, 0.0, 1e-3))
    for name in TILTED_JOINTS:
        turn = actual.mechanism.placement(name).rotation.T @ truth.robot.mechanism.placement(name).rotation
        assert 0 < np.arccos(turn[0, 0]) < 5e-3
    moved = np.sqrt(np.mean((truth.positions(joints, approach) - exact) ** 2, axis=0))
    assert moved[0] > 2 * max(moved[1:])


def test_tracker_finds_the_world_and_its_repeatability(monkeypatch):
    points = np.random.default_rng(2).uniform(-0.5, 0.5, (200, 3))
    seen = measure(points, np.random.default_rng(1))
    monkeypatch.setattr("medrue.tracker.SIGMA", 1e-15)
    assert np.abs(measure(points, np.random.default_rng(1)).positions - points).max() < 1e-12
    assert abs(seen.repeatability / 4e-5 - 1) < 4 / np.sqrt(2 * 200 * 4 * 3)
    assert seen.nest_outliers == ()
    assert 4e-5 / np.sqrt(15) < seen.frame_sigma < 1e-4


def test_the_frame_s_uncertainty_is_the_scatter_of_the_frame():
    """One far point, 400 trackers: the part of its error that all readings of one tracker share."""
    far = np.array([[0.6, 0.5, 0.1]])
    errors = [measure(far, np.random.default_rng(k)).positions[0] - far[0] for k in range(400)]
    own = 4e-5 / np.sqrt(5)
    scatter = np.sqrt(np.var(errors, axis=0, ddof=1) - own**2)
    stated = measure(far, np.random.default_rng(0)).frame_sigma
    assert abs(scatter.max() / stated - 1) < 0.2  # 400 draws of a sum of two variances: about 5 percent


def test_a_nest_that_was_moved_is_named_and_seldom_another():
    places, rng = np.array(list(NESTS.values())), np.random.default_rng(8)
    seen = (places - PLACE.translation) @ PLACE.rotation
    for k, name in enumerate(NESTS):
        moved = seen.copy()
        moved[k] += 2e-3 * (places[k] - places.mean(axis=0)) @ PLACE.rotation
        assert find_world(moved).outliers == (name,)
    called = [find_world(seen + rng.normal(0, 4e-5 / np.sqrt(5), (3, 3))).outliers != () for _ in range(500)]
    assert np.mean(called) < 0.025  # 0.01 at most; binomial spread 0.0045


def test_calibration_leaves_an_error_that_is_dominated_by_x(experiment):
    for draw in experiment.draws:
        before, after = experiment.validation(draw, "O1")
        squares = np.mean(after**2, axis=0)
        assert squares[0] > 0.7 * squares.sum()
        assert np.linalg.norm(after, axis=1).mean() < 0.05 * np.linalg.norm(before, axis=1).mean()


def test_the_remaining_error_is_about_the_papers(experiment):
    """Sizes of the imperfections are chosen for that; the test keeps text and numbers together."""
    for draw in experiment.draws:
        after = 1e3 * experiment.validation(draw, "O1")[1]
        assert 0.6 < np.linalg.norm(after, axis=1).mean() / error_table(4)["O1"]["mean"] < 1.6
        assert 0.6 < np.abs(after[:, 0]).mean() / error_table(5)["after_x"]["mean"] < 1.6


def test_without_imperfections_only_noise_remains(experiment):
    """Five averaged readings of 40 um, and the fit's own share: well below 0.05 mm in distance."""
    rms = cause_rms(experiment)
    noise = 0.04 / np.sqrt(5)
    assert noise * 0.9 < rms["tracker noise alone"][:3].min()
    assert rms["tracker noise alone"][:3].max() < noise * 1.4
    assert rms["backlash of the rail"][0] > 10 * noise
    assert rms["links out of perpendicular"][3] > rms["tracker noise alone"][3]


def test_all_causes_together_leave_more_than_the_largest_of_them(experiment):
    """On the same draws; squares of independent causes add up, if only on average."""
    rms = cause_rms(experiment)
    together = rms.pop("all together")
    assert len(rms) == 4
    assert all(len(draws) == len(experiment.draws) for draws in experiment.causes.values())
    assert together[3] > max(values[3] for values in rms.values())


def test_tables_stand_beside_the_papers_and_are_called_simulated(experiment):
    tables = {table.name: table for table in experiment_tables(experiment)}
    assert set(tables) == {"table3", "table4", "ranking", "table5", "causes", "pose_count", "extended"}
    fifth = {column.header: column.values for column in tables["table5"].columns}
    assert fifth["after x"][fifth["error [mm]"].index("mean, paper")] == 0.340
    third = {column.header: column.values for column in tables["table3"].columns}
    assert third["actual (paper: identified)"][0] == pytest.approx(-224.895)
    check_tables(tables.values())
    assert "chosen so that the error that remains" in tables["causes"].csv()
    text = " ".join(experiment_findings(experiment))
    assert "mostly along x" in text
    assert "all our poses are above the paper's mean" in text
    assert "nan" not in text


def test_sentences_follow_the_numbers(experiment):
    """Without imperfections nothing is mostly along x, and no size was chosen for anything."""
    noise = experiment.causes["tracker noise alone"][:1]
    single = tuple(replace(draw, after=np.tile(draw.after, (2, 1, 1))) for draw in noise)
    nothing = replace(experiment, imperfections=NONE, draws=single, causes={"tracker noise alone": single})
    text = " ".join(experiment_findings(nothing))
    assert "mostly" not in text
    assert "The error after calibration: x 3" in text
    assert "over 1 draw," in text
    assert "1 draws" not in text
    table = {table.name: table for table in experiment_tables(nothing)}["causes"].csv()
    assert "chosen" not in table
    assert "1 draw in every row" in table
    assert str(NONE) == "nothing more"
    assert str(Imperfections(1e-3, 0.0, 0.0)) == "backlash of the rail of 1 mm"


def test_the_same_seed_gives_the_same_experiment(experiment):
    seed, usual = np.random.SeedSequence(3).spawn(2)[0], experiment.imperfections
    given = experiment.robot, experiment.both_sides.extended, experiment.joints
    again = experiment_draw(ExperimentTask(*given, experiment.sets, usual, seed))
    assert np.array_equal(again.after, experiment.draws[0].after)
    other = ExperimentTask(*given, experiment.sets[:1], replace(usual, backlash=0.0), seed)
    assert not np.array_equal(experiment_draw(other).after[0], again.after[0])


def test_the_command_writes_every_table_and_figure_and_one_page(experiment, extended, monkeypatch, tmp_path):
    requests = []

    def known(_robot, _extended, draws, seed, _work, imperfections, counts):
        requests.append((draws, seed, imperfections.backlash, counts))
        return experiment

    monkeypatch.setattr("medrue.experiment.run_experiment", known)
    out = tmp_path / "experiment"
    arguments = ("experiment", "--quick", "--jobs", "1", "--out", str(out), "--seed", "5", "--backlash-mm", "0.8")
    run = CliRunner().invoke(group, arguments)
    assert run.exit_code == 0, run.output
    assert requests == [(QUICK_DRAWS, 5, pytest.approx(0.8e-3), QUICK_COUNTS)]
    assert "Table IV" in run.output
    assert "mostly along x" in run.output
    tables = {"table3", "table4", "ranking", "table5", "causes", "pose_count", "extended"}
    check_folder(out, tables, {"figure3", "figure7", "figure8", "causes", "pose_count"}, ("both_sides.csv",))
    page = (out / "index.html").read_text()
    assert "backlash of the rail of 0.8 mm" in page
    assert "@media print" in page
    data = read_measurements(out / "both_sides.csv", extended)
    assert len(data) == len(set(data.names)) == 840
    assert np.abs(data.approach_directions.sum(axis=0)).tolist() == [0.0] * 6  # each pose from both sides
    assert np.all(np.abs(data.approach_directions[:, 0]) == 1.0)
