"""How many evaluations a fit takes as the stated noise shrinks from 1 mm to 1 um, for every robot of the tests.

    python tests/benchmarks/evaluations.py [--data FOLDER] [--starts N]

FOLDER holds the measurements of others: motoman_right (docs/examples/motoman_right.yaml), and ur10_tracker
(docs/examples/ur10_tracker.yaml, 300 random rows). Without it, only robots that ship with the project are fitted. A
number is the evaluations of a fit, all its solves together; * says that it is not converged, or failed. With N starts
that are a random prior sigma away in every parameter that has one, it is the most that one of them takes.
"""

import argparse
import shutil
import tempfile
from collections import Counter
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from unittest import mock

import numpy as np
from motoman_choice import load as motoman

import calib
from calib.fitting.problem import Problem
from calib.fitting.settings import Settings
from calib.fitting.solving import place, solve_from
from calib.joint_terms.term import Context
from medrue import robot_file
from medrue.imperfections import from_direction
from medrue.workspace import target_workspace

EXAMPLES = Path(__file__).resolve().parents[2] / "docs" / "examples"
SIGMAS = np.array([1000, 300, 100, 42.6, 10, 7, 3, 1]) * 1e-6


@contextmanager
def counted():
    """Inside, the counter that this gives has how many evaluations all solves of a problem took."""
    counts, solve = Counter(), Problem.solve

    def counting(self, start, groups, unknowns=None, **options):
        robot, solution = solve(self, start, groups, unknowns, **options)
        counts[self] += solution.evaluations if unknowns is None else 0
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
    with tempfile.TemporaryDirectory() as together:
        shutil.copy(folder / "robot.urdf", together)
        shutil.copy(EXAMPLES / "ur10_tracker.yaml", together)
        robot = calib.load(Path(together) / "ur10_tracker.yaml")
    data = calib.read_measurements(folder / "grid.csv", robot)
    return robot, data[np.sort(np.random.default_rng(0).choice(len(data), rows, replace=False))]


def extended_medrue(off=0.3):
    """MedRUE with 130 parameters, each off by a random part of its prior sigma, and 84 simulated poses."""
    robot, q = calib.load(robot_file("medrue_extended")), np.array(target_workspace().q)[::5]
    rng = np.random.default_rng(1)
    sigma = np.array([parameter.sigma_si for parameter in robot.parameters])
    truth = robot.with_parameters(robot.values + off * sigma * rng.standard_normal(len(sigma)))
    directions = from_direction(rng.choice([-1.0, 1.0], len(q)))
    positions = truth.positions(q, Context.of(directions, {}))[:, 0] + 4e-5 * rng.standard_normal((len(q), 3))
    return robot, replace(calib.as_measurements(robot, q, positions), approach=directions)


def problems(folder=None):
    """Robots and measurements by name; those of others where there is a folder."""
    found = {"arm": example("arm"), "five-bar": example("five_bar"), "MedRUE": example("medrue", every=5)}
    found["MedRUE, extended"] = extended_medrue()
    if folder:
        found["Motoman"] = motoman(folder / "motoman_right")[:2]
        found["UR10"] = ur10(folder / "ur10_tracker")
    return found


def fitted(robot, data, sigma):
    """The most evaluations of a fit and of those that prove it, and whether it converged and did not fail."""
    with counted() as counts:
        fit = calib.fit(robot, data, sigma=sigma)
    return max(counts.values()), fit.converged and fit.verdict.grade != "FAIL"


def most_of(starts, robot, data, sigma):
    """The most evaluations of solves from random starts, and whether all of them converged."""
    problem = Problem(robot, data, sigma)
    placed, unknowns = place(problem), problem.unknowns
    groups = solve_from(problem, placed, Settings(sigma=sigma)).groups
    found = []
    for seed in range(starts):
        away = np.where(unknowns.has_prior, np.random.default_rng(seed).standard_normal(len(unknowns)), 0.0)
        start = problem.moved(placed, unknowns, unknowns.deviations(placed.values) + away)
        found.append(problem.apart().solve(start, groups)[1])
    return max(solution.evaluations for solution in found), all(solution.converged for solution in found)


def table(robots, starts=0):
    """Lines of the table."""
    yield "| stated [mm] |" + "".join(f" {1e3 * sigma:g} |" for sigma in SIGMAS)
    yield "|---|" + "---:|" * len(SIGMAS)
    for name, (robot, data) in robots.items():
        row = f"| {name} |"
        for sigma in SIGMAS:
            one = (robot, data, float(sigma))
            evaluations, converged = most_of(starts, *one) if starts else fitted(*one)
            row += f" {evaluations}{'' if converged else ' *'} |"
        yield row


def main():
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path)
    parser.add_argument("--starts", type=int, default=0)
    options = parser.parse_args()
    for line in table(problems(options.data), options.starts):
        print(line, flush=True)


if __name__ == "__main__":
    main()
