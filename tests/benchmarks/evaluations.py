"""Robots and measurements that benchmarks fit, and how many evaluations a fit takes.

FOLDER of the benchmarks holds the measurements of others: motoman_right (docs/examples/motoman_right.yaml), and
ur10_tracker (docs/examples/ur10_tracker.yaml, 300 random rows). Without it, only robots that ship with the project are
fitted.
"""

from collections import Counter
from contextlib import contextmanager
from dataclasses import replace
from unittest import mock

import numpy as np

import calib
from calib.core.fitting.problem import Problem
from calib.core.robots.terms.term import Context
from medrue import robot_file
from medrue.imperfections import from_direction
from medrue.workspace import target_workspace
from tests.project import EXAMPLES
from tests.public_data import motoman, ur10_tracker


@contextmanager
def counted():
    """Inside, the counter that this gives has how many evaluations all solves of a problem took."""
    counts, solve = Counter(), Problem.solve

    def counting(self, start, groups, unknowns=None, **options):
        robot, solution = solve(self, start, groups, unknowns, **options)
        counts[self.whitening] += solution.evaluations if unknowns is None else 0
        return robot, solution

    with mock.patch.object(Problem, "solve", counting):
        yield counts


def example(name, every=1):
    """A robot of the documentation and its simulated measurements."""
    robot = calib.load(robot_file() if name == "medrue" else EXAMPLES / f"{name}.yaml")
    data = calib.read_measurements(EXAMPLES / f"{name}_simulated.csv", robot)
    return robot, data.subset(np.arange(0, len(data), every))


def ur10(folder, rows=300):
    """The UR10 and some rows of its file, positions alone."""
    robot, data, _ = ur10_tracker(folder)
    return robot, data[np.sort(np.random.default_rng(0).choice(len(data), rows, replace=False))]


def extended_medrue(off=0.3):
    """MedRUE with 130 parameters, each off by a random part of its prior sigma, and 84 simulated poses."""
    robot, q = calib.load(robot_file("medrue_extended")), np.array(target_workspace().q)[::5]
    rng = np.random.default_rng(1)
    sigma = np.array([parameter.sigma_si for parameter in robot.parameters])
    truth = robot.with_parameters(robot.values + off * sigma * rng.standard_normal(len(sigma)))
    directions = from_direction(rng.choice([-1.0, 1.0], len(q)))
    positions = truth.positions(q, Context.from_conditions(directions, {}))[:, 0] + 4e-5 * rng.standard_normal(
        (len(q), 3)
    )
    return robot, replace(calib.as_measurements(robot, q, positions), approach=directions)


def problems(folder=None):
    """Robots and measurements by name; those of others where there is a folder."""
    problems = {"arm": example("arm"), "five-bar": example("five_bar"), "MedRUE": example("medrue", every=5)}
    problems["MedRUE, extended"] = extended_medrue()
    if folder:
        problems["Motoman"] = motoman(folder / "motoman_right")[:2]
        problems["UR10"] = ur10(folder / "ur10_tracker")
    return problems
