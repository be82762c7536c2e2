"""Starts on a robot with two valleys, and on one with one."""

import numpy as np
import pytest

import calib
from calib.core.fitting.problem import Problem
from calib.core.fitting.solving import place
from tests.project import EXAMPLES, copied
from tests.six_axis_arm import YAML, joints, noisy, write_six_axis

SIGMA = 4e-5
ZEROS = (("j2", "ry"), ("j3", "ry"), ("j4", "rx"), ("j5", "ry"))


def test_a_robot_with_one_minimum_comes_back_to_it_from_everywhere(arm):
    fit = calib.fit(arm, noisy(arm, joints(40), 4e-5, seed=1), starts=6, seed=2)
    assert len(fit.starts.minima) == 1
    assert fit.starts.minima[0].count == 6
    assert "6 starts (seed 2)" in fit.report(verbose=True)


def test_a_solve_does_not_hang_on_what_was_solved_before(arm):
    problem = Problem.from_data(arm, noisy(arm, joints(40), 4e-5, seed=1))
    placed, noise = place(problem), np.array([4e-5])
    away = problem.unknowns.robot_at(placed.robot, np.linspace(-1.0, 1.0, len(problem.unknowns)))
    first, _ = problem.solve(placed, noise)
    problem.solve(problem.evaluate(away), noise)
    again, _ = problem.solve(placed, noise)
    assert np.array_equal(first.robot.values, again.robot.values)
    assert np.array_equal(first.configurations.passive, again.configurations.passive)


def test_a_step_that_cannot_be_assembled_is_halved(tmp_path, monkeypatch):
    """Links that may be off by 200 mm: several steps are out of reach at first, and those starts failed."""
    robot = calib.load(copied(tmp_path, EXAMPLES / "five_bar.yaml", ("sigma: 1 mm", "sigma: 200 mm")))
    q = robot.home + np.random.default_rng(1).uniform(-0.3, 0.3, (20, 2))
    data, failed = calib.simulate(robot, q, SIGMA, 2), []
    for halvings in (0, 5):
        monkeypatch.setattr("calib.core.fitting.starts._HALVINGS", halvings)
        starts = calib.fit(robot, data, starts=12, seed=3).starts
        failed.append(starts.failed)
        assert starts.total == 12
    assert failed[1] < failed[0] - 2


@pytest.fixture(scope="module")
def wrong_zeros(tmp_path_factory):
    """An arm with four unknown zeros, and measurements of one whose zeros lie in another valley than nominal."""
    free = "".join(f"  - {{origin: {name}, components: [{axis}], sigma: 100 deg}}\n" for name, axis in ZEROS)
    arm = calib.load(write_six_axis(tmp_path_factory.mktemp("arm"), f"priors: false\n{YAML}{free}"))
    off = dict(zip((f"{name}.{axis}" for name, axis in ZEROS), np.radians([-113, 36, -213, 85]), strict=True))
    return arm, noisy(arm.with_parameters(off), joints(40), SIGMA, seed=1)


@pytest.mark.quick(0)
def test_starts_find_the_robot_where_a_fit_from_nominal_ends_in_a_worse_minimum_and_says_so(wrong_zeros):
    from_nominal = calib.fit(*wrong_zeros)
    assert from_nominal.sigma > 0.1
    assert from_nominal.verdict.grade == "FAIL"
    fit = calib.fit(*wrong_zeros, starts=12, seed=1)
    assert fit.sigma == pytest.approx(SIGMA, rel=0.2)  # standard error 7 %
    assert len(fit.starts.minima) == 2
    assert fit.starts.minima[0].cost < fit.starts.minima[1].cost
    assert fit.starts.minima[1].rms > 0.1
    assert sum(minimum.count for minimum in fit.starts.minima) + fit.starts.failed == fit.starts.total == 12
    assert fit.verdict.grade == "PASS"


def test_starts_do_not_turn_an_angle_of_the_same_robot_round_once_more(wrong_zeros):
    arm, _ = wrong_zeros
    fit = calib.fit(arm, noisy(arm, joints(40), SIGMA, seed=1), starts=12, seed=1)
    assert fit.starts.minima[0].count > 6
    assert np.max(np.abs(fit.robot.values - arm.values)) < np.radians(1)
