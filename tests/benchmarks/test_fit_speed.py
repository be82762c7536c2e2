"""How long a whole fit takes: MedRUE, 84 poses from the nominal parameters, plain and with a robust loss; and 420 poses
with the extended model.
"""

from dataclasses import replace

import numpy as np
import pytest

import calib
from medrue import robot_file
from medrue.closed_form import forward
from medrue.imperfections import Imperfections, from_direction, imperfect_robot
from medrue.paper_tables import table1
from medrue.workspace import target_workspace


@pytest.fixture(scope="module")
def problem():
    robot, q = calib.load(robot_file()), np.array(target_workspace().q)[::5]
    positions = forward(q, table1().actual).p_world_tool[:, None]
    positions = positions + 4e-5 * np.random.default_rng(1).standard_normal(positions.shape)
    return robot, calib.as_measurements(robot, q, positions)


@pytest.mark.parametrize("loss", ["none", "huber", "tukey"])
def test_fit_of_84_poses(benchmark, problem, loss):
    fit = benchmark(calib.fit, *problem, loss=loss)
    assert fit.converged


def test_verdict_of_84_poses(benchmark, problem):
    fit = calib.fit(*problem)

    def verdict_of():
        for name in ("verdict", "patterns", "studentised", "outliers", "_root", "assembles"):
            fit.__dict__.pop(name, None)  # what is computed once on request
        return fit.verdict

    assert benchmark(verdict_of).grade in ("PASS", "CHECK")


def test_fit_of_the_extended_model(benchmark):
    robot, q = calib.load(robot_file("medrue_extended")), np.array(target_workspace().q)
    actual = calib.load(robot_file()).with_parameters(table1().actual)
    truth = imperfect_robot(robot, actual, Imperfections(), np.random.default_rng(1))
    approach = np.random.default_rng(2).choice([-1.0, 1.0], len(q))
    positions = truth.positions(q, approach)
    data = calib.as_measurements(robot, q, positions + 4e-5 * np.random.default_rng(3).standard_normal(positions.shape))
    fit = benchmark(calib.fit, robot, replace(data, approach=from_direction(approach)))
    assert fit.converged
