"""The simulated calibrations behind docs/verdict.md."""

import numpy as np
import pytest
from snippets import DOCS
from verdict_rates import OUTCOMES, Outcome, Run, calibrate, markdown, rows
from verdict_scenarios import ROBOTS, SCENARIOS, Trial, open_lab

HEALTHY = [name for name, scenario in SCENARIOS.items() if scenario.kind == "healthy"]
GROSS = ["a joint counted the other way", "two joint columns swapped", "an axis of the tracker mirrored"]


@pytest.mark.quick(2)
@pytest.mark.parametrize("scenario", HEALTHY)
def test_a_healthy_calibration_never_fails(scenario):
    assert calibrate(Run(SCENARIOS[scenario].robots[0], scenario, 0)).grade in ("PASS", "CHECK")


@pytest.mark.quick(1)
@pytest.mark.parametrize("robot", ROBOTS)
def test_a_healthy_robot_of_any_sort_never_fails(robot):
    assert calibrate(Run(robot, HEALTHY[0], 0)).grade in ("PASS", "CHECK")


@pytest.mark.quick(1)
@pytest.mark.parametrize("scenario", GROSS)
def test_gross_mistakes_never_pass(scenario):
    assert calibrate(Run("arm", scenario, 0)).grade in ("FAIL", "refused")


def test_what_the_model_leaves_out_is_seen():
    assert calibrate(Run("arm", "the tracker is moved half-way", 0)).grade == "CHECK"


@pytest.mark.quick(0)
@pytest.mark.parametrize("measured", ["distances", "pixels"])
def test_a_joint_that_moved_too_little_is_told_where_nobody_measures_positions(measured):
    outcome = calibrate(Run("arm", f"a joint that moved too little, {measured} measured", 0))
    assert (outcome.grade, outcome.codes) == ("PASS", ("joint_moved_little",))


def test_there_are_sixty_scenarios_and_three_robots():
    assert len(SCENARIOS) >= 60
    assert set(ROBOTS) == {"arm", "MedRUE", "3-RRR"}


@pytest.mark.quick(15)
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_every_scenario_makes_measurements_and_the_same_from_the_same_seed(scenario):
    item = SCENARIOS[scenario]
    first, second = (data_of(item.make(open_lab(item.robots[0], 5, item.measured))) for _ in range(2))
    assert len(first) > 5
    np.testing.assert_array_equal(first.joints, second.joints)
    for name, readings in first.readings.items():
        np.testing.assert_array_equal(readings.values, second.readings[name].values)


def data_of(made):
    return made.data if isinstance(made, Trial) else made


def test_what_hides_a_fault_is_named():
    outcome = calibrate(Run("arm", "lengths read 300 ppm too long", 0))
    assert (outcome.grade, outcome.says_so) == ("PASS", True)


def test_rows_count_what_was_said():
    name, sick = HEALTHY[0], GROSS[0]
    said = [
        Outcome(Run("arm", name, 0), "PASS", ("nothing_to_correct",)),
        Outcome(Run("arm", name, 1), "CHECK", ("a",)),
    ]
    table = rows([*said, Outcome(Run("arm", sick, 0), "FAIL", ("b", "c"))])
    assert table[0] == ["healthy", name, "2", "1", "1", "0", "0", "a 1"]
    assert table[1][1:3] == ["all healthy", "2"]
    assert table[2] == ["faulty", sick, "1", "0", "0", "1", "0", "b 1, c 1"]
    assert f"| b | {sick} | 1 | 0 | 0 | 1 | 0 |" in markdown(table)


def test_the_page_has_every_scenario_and_keeps_its_promise():
    text = (DOCS / "verdict.md").read_text(encoding="utf-8")
    lines = [[cell.strip() for cell in line.strip("| ").split("|")] for line in text.splitlines()]
    by_name = {name: cells[2:] for cells in lines if len(cells) == 7 for name in cells[1].split("; ")}
    assert {name for name, scenario in SCENARIOS.items() if scenario.kind != "healthy"} <= set(by_name)
    runs, *counts = (int(cell) for cell in by_name["all healthy"][:5])
    grades = dict(zip(OUTCOMES, counts, strict=True))
    assert runs == sum(counts) >= 300
    assert grades["FAIL"] == grades["refused"] == 0
    assert grades["CHECK"] <= 0.05 * runs
    runs, passed = (int(cell) for cell in by_name["all faulty"][:2])
    assert runs >= 100
    assert passed <= 0.05 * runs
    counted = [int(cell) for cell in by_name["all counted"][:5]]
    assert counted[0] == sum(counted[1:]) >= 50
