"""The simulation study: exact recovery, errors as theory predicts them, and a ranking that is more than luck."""

import numpy as np
import pytest
from scipy.stats import ttest_rel

from calib import fit
from calib.core.base.workers import Workers
from calib.core.robots.jacobian import linearise
from medrue.draws import Calibrator, DrawTask, Work, measurements, run
from medrue.paper_tables import PARAMETERS, error_table, table1
from medrue.ranking import agreement, rank, ranking_table, standard_error
from medrue.result_tables import ResultTable, TableColumn
from medrue.study import SIGMA, StudySize, choose_sets, error_floors, run_study, summary, true_positions
from medrue.study_tables import study_findings, study_tables
from tests.medrue.medrue_folders import check_tables

pytestmark = pytest.mark.quick(0)

DRAWS = 40


@pytest.fixture(scope="module")
def study(robot):
    """A study of 84 poses chosen by O1 and of 84 uniform ones."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("medrue.study.INDICES", ("O1",))
        return run_study(robot, StudySize(DRAWS, 2, 2), 7, Work())


@pytest.fixture(scope="module")
def task(study):
    """Its draws of the noise on the robot of Table I."""
    seeds = np.random.SeedSequence(7).spawn(2)[0].spawn(DRAWS)
    return DrawTask(study.robot, study.joints, study.truth, study.sets, SIGMA, tuple(seeds))


@pytest.fixture(scope="module")
def outcome(study):
    return study.outcome


def test_a_draw_ends_in_the_minimum_that_fit_finds(task):
    noisy = task.noisy(task.seeds[0])
    start = task.robot.with_parameters(table1().actual)
    calibrator = Calibrator(task, task.sets[0], start, start.assemble(task.joints).passive)
    fitted = fit(task.robot, measurements(task.robot, task.joints, noisy, task.sets[0].chosen), sigma=SIGMA)
    difference = (calibrator.calibrate(noisy).values - fitted.robot.values)[task.robot.is_free]
    assert np.abs(difference / fitted.statistics.std).max() < 1e-3  # of a standard deviation


def test_predicted_covariance_agrees_with_the_scatter_over_draws(task, outcome):
    """The Mahalanobis distances of all draws add up to a chi-square of 28 degrees of freedom each."""
    actual = task.robot.with_parameters(table1().actual)
    free = task.robot.is_free
    for s, pose_set in enumerate(task.sets):
        jacobian = linearise(actual, actual.assemble(task.joints[pose_set.chosen])).jacobian[:, 0][..., free]
        deviations = (outcome.values[:, s] - table1().actual)[:, free]
        total = np.sum((deviations @ jacobian.reshape(-1, 28).T) ** 2) / SIGMA**2
        n = 28 * DRAWS
        assert abs(total - n) < 4 * np.sqrt(2 * n)


def test_identification_reaches_the_floor_of_theory_and_does_not_fall_below(task, outcome):
    actual = task.robot.with_parameters(table1().actual)
    floors = error_floors(actual, task.joints, task.sets, SIGMA)
    for s, pose_set in enumerate(task.sets):
        squares = np.mean(outcome.distances[:, s, pose_set.validation_indices(420)] ** 2, axis=1)
        assert abs(squares.mean() / floors[s] ** 2 - 1) < 4 * standard_error(squares) / floors[s] ** 2


@pytest.mark.amount(0, 1)
def test_the_same_seed_gives_the_same_numbers_whatever_the_number_of_processes(task, outcome, monkeypatch):
    monkeypatch.setattr("medrue.draws.CHUNK", 2)
    monkeypatch.setattr("medrue.study.INDICES", ("O1",))
    few = DrawTask(task.robot, task.joints, task.truth, task.sets, task.sigma, task.seeds[:4])
    with Workers(2) as executor:
        _, sets = choose_sets(task.robot, task.joints, Work(executor))
        shared = run([few], Work(executor))[0]
    assert [error_set.name for error_set in sets] == ["O1", "uniform"]
    assert all(np.array_equal(error_set.chosen, other.chosen) for error_set, other in zip(sets, task.sets, strict=True))
    assert np.array_equal(shared.values, outcome.values[:4])
    assert np.array_equal(shared.distances, outcome.distances[:4])


def test_tables_stand_beside_the_papers_and_are_called_simulated(study):
    tables = {table.name: table for table in study_tables(study)}
    assert set(tables) == {"table1", "table2", "ranking", "floor", "observability"}
    first = {column.header: column.values for column in tables["table1"].columns}
    assert first["parameter"] == PARAMETERS
    assert first["paper: with noise"][0] == pytest.approx(-231.815)
    assert first["identified without noise"][0] == pytest.approx(-232.034, abs=1e-9)
    assert first["predicted std"][PARAMETERS.index("d31")] is None
    second = {column.header: column.values for column in tables["table2"].columns}
    row = second["error [mm]"].index("mean, paper")
    assert second["O1"][row] == error_table(2)["O1"]["mean"]
    relative = {column.header: column.values for column in tables["observability"].columns}
    reached = [study.selections[name].after["O1"] for name in study.selections]
    parts = [value for value in relative["O1 [% of the best]"] if value is not None]
    assert max(parts) == 100.0
    assert min(reached) / max(reached) == pytest.approx(parts[reached.index(min(reached))] / 100)
    check_tables(tables.values())
    assert "before: the nominal robot at the validation poses of O1" in tables["table2"].csv()


def test_findings_say_what_the_numbers_say(study):
    text = " ".join(study_findings(study))
    assert "Without noise, 28 parameters come back" in text
    assert "better by more than chance: O1 than uniform" in text
    assert "over 40 draws of the noise" in text
    assert "over 2 actual robots" in text
    assert "nan" not in text


def test_errors_before_are_those_of_the_nominal_robot(study):
    others = study.sets[0].validation_indices(420)
    nominal = true_positions(study.joints, table1().nominal)[others]
    errors = np.linalg.norm(nominal - study.truth[others], axis=1)
    expected = (errors.mean(), errors.max(), errors.std(ddof=1), np.sqrt(np.mean(errors**2)))
    assert study.nominal_errors() == pytest.approx(expected, rel=1e-9)


def test_rankings_tell_luck_from_difference():
    generator = np.random.default_rng(3)
    common = generator.normal(1.0, 0.5, 50)
    errors = np.stack([common + 0.3, common, common + 1e-6 * generator.normal(size=50)], axis=1)
    ranking = rank(("worse", "good", "alike"), errors)
    assert ranking.names[2] == "worse"
    assert ranking.sure_differences() in (
        "better by more than chance: good and alike than worse; every other difference may be chance",
        "better by more than chance: alike and good than worse; every other difference may be chance",
    )
    two = rank(("b", "a"), np.array([[2.0, 1.0], [2.01, 1.0]]))
    assert two.steps[0, 1] > 100
    assert str(two) == "a, b; no set is better by more than chance"  # two draws prove nothing
    single = rank(("b", "a"), np.array([[2.0, 1.0]]))
    assert str(single) == "a, b; no set is better by more than chance"
    assert np.isnan(single.steps).all()


def test_every_pair_is_tested_with_holms_correction():
    """Against scipy's paired test and the correction written out."""
    errors = np.random.default_rng(11).normal(size=(30, 5)) * 0.5 + np.array([0.0, 0.2, 0.35, 0.5, 0.6])
    names = tuple("abcde")
    ranking = rank(names, errors)
    column = {name: errors[:, k] for k, name in enumerate(names)}
    pairs = [(p, q) for k, p in enumerate(ranking.names) for q in ranking.names[k + 1 :]]
    luck = {pair: float(ttest_rel(column[pair[0]], column[pair[1]]).pvalue) for pair in pairs}
    expected = set()
    for k, pair in enumerate(sorted(pairs, key=luck.__getitem__)):
        if luck[pair] > 1e-3 / (10 - k):
            break
        expected.add(pair)
    result = {(p, q) for i, p in enumerate(ranking.names) for j, q in enumerate(ranking.names) if ranking.better[i, j]}
    assert result == expected
    assert 0 < len(result) < len(pairs)


def test_a_long_list_of_worse_sets_is_named_by_its_first():
    noise = np.random.default_rng(2).normal(size=(40, 5)) * 1e-3
    ranking = rank(tuple("abcde"), noise + np.array([0.0, 0.0, 1.0, 2.0, 3.0]))
    assert "than c and all after it" in ranking.sure_differences()
    table = ranking_table({"mean error": ranking})
    rows = {str(row[0]): row for row in zip(*(column.values for column in table.columns), strict=True)}
    assert rows["mean error: c"][2:] == ("worse", "worse", "", "better", "better")


def test_agreement_is_one_for_the_same_order_and_minus_one_for_the_reverse():
    assert agreement({"a": 1, "b": 2, "c": 3}, {"a": 10, "b": 20, "c": 30, "d": 0}) == pytest.approx(1.0)
    assert agreement({"a": 1, "b": 2, "c": 3}, {"a": 3, "b": 2, "c": 1}) == pytest.approx(-1.0)


def test_summary_is_mean_max_std_and_rms():
    assert summary(np.array([1.0, 2.0, 6.0])) == pytest.approx((3.0, 6.0, np.sqrt(7.0), np.sqrt(41 / 3)))


def test_tables_keep_all_digits_in_files_and_leave_unknown_cells_empty():
    table = ResultTable(
        "t", "title", (TableColumn("name", ("a", "b")), TableColumn("x [mm]", (1 / 3, None), 2)), ("note",)
    )
    assert table.csv() == "# title\n# note\nname,x [mm]\na,0.3333333333333333\nb,\n"
    assert table.text() == "name  x [mm]\na       0.33\nb"
    assert table.to_dict()["rows"] == [{"name": "a", "x [mm]": 1 / 3}, {"name": "b", "x [mm]": None}]
