"""Starts on a problem with two valleys, and on a robot with one."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

import calib
from calib.core.base.errors import ComputationError
from calib.core.fitting.problem import Problem
from calib.core.fitting.solving import place
from calib.core.fitting.starts import explore
from calib.core.instruments.kind import Part
from calib.core.numerics.least_squares import minimise
from calib.core.rows.rows import Group
from tests.six_axis_arm import YAML, joints, noisy, write_six_axis

SIGMA = 4e-5
ZEROS = (("j2", "ry"), ("j3", "ry"), ("j4", "rx"), ("j5", "ry"))


@dataclass(frozen=True)
class Point:
    u: float

    @property
    def values(self):
        return np.array([self.u])


class Rows:
    """Rows that are white already."""

    groups = (Group("rows", Part("position", ("x",), "length"), stated=True, typical=1.0),)

    def whiten(self, residuals, groups):
        return residuals["rows"].ravel() / groups[0]


@dataclass(frozen=True)
class One:
    """One unknown u with its scale."""

    scale: float

    def __len__(self):
        return 1

    def deviations(self, values):
        return values / self.scale

    def robot_at(self, robot, u):
        return Point(float(self.scale * u[0]))


class TwoValleys:
    """r = (u^2 - 1, 0.1 (u - 1)): minima near u = -1 and at u = 1, the second lower. Cannot start beyond |u| = 4."""

    whitening = Rows()

    def __init__(self, scale=1.0):
        self.unknowns = One(scale)

    def evaluate(self, robot):
        if abs(robot.u) > 4:
            raise ComputationError("open")
        return SimpleNamespace(robot=robot, residuals={"rows": np.array([[robot.u**2 - 1, 0.1 * (robot.u - 1)]])})

    def solve(self, start, groups):
        minimum = minimise(
            lambda u: np.array([u[0] ** 2 - 1, 0.1 * (u[0] - 1)]),
            lambda u: np.array([[2 * u[0]], [0.1]]),
            np.array([start.robot.u]),
        )
        return self.evaluate(Point(float(minimum.x[0]))), minimum


def explored(u, n, scale=1.0):
    placed, noise = Point(u), np.array([0.01])
    first = TwoValleys().solve(TwoValleys().evaluate(placed), noise)
    return explore(TwoValleys(scale), placed, first, noise, n, seed=3)


def test_starts_find_the_lower_of_two_minima():
    result = explored(-0.8, 20)
    assert [round(minimum.robot.u, 1) for minimum in result.minima] == [1.0, -1.0]
    assert result.minima[0].cost < result.minima[1].cost
    assert sum(minimum.count for minimum in result.minima) == result.total == 20


def test_a_step_that_cannot_be_assembled_is_halved():
    result = explored(0.5, 10, scale=40.0)  # most steps are out of reach at first
    assert result.failed < 10
    assert result.total == 10


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


def test_no_start_is_an_error(arm):
    with pytest.raises(calib.InputError, match="starts 0"):
        calib.fit(arm, noisy(arm, joints(40), 4e-5, seed=1), starts=0)


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
    assert fit.starts.minima[1].rms > 0.1
    assert fit.verdict.grade == "PASS"


def test_starts_do_not_turn_an_angle_of_the_same_robot_round_once_more(wrong_zeros):
    arm, _ = wrong_zeros
    fit = calib.fit(arm, noisy(arm, joints(40), SIGMA, seed=1), starts=12, seed=1)
    assert fit.starts.minima[0].count > 6
    assert np.max(np.abs(fit.robot.values - arm.values)) < np.radians(1)
