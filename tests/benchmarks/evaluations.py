"""How many evaluations a fit takes as the stated noise shrinks from 1 mm to 1 um, for every robot of the tests.

    python -m tests.benchmarks.evaluations [--data FOLDER] [--starts N] [--subsets N]

FOLDER holds the measurements of others: motoman_right (docs/examples/motoman_right.yaml), and ur10_tracker
(docs/examples/ur10_tracker.yaml, 300 random rows). Without it, only robots that ship with the project are fitted. A
number is the evaluations of a fit, all its solves together; * says that it is not converged, or failed. With N starts
that are a random prior sigma away in every parameter that has one, it is the most that one of them takes.

With N subsets, the fit is compared with MINPACK's `lm` in SciPy (tolerances as it has them), on the same residuals and
the same Jacobian: subsets of 20 to 200 rows, at random, one behind the other, and nearest in joint space. Where the fit
takes more than 20 evaluations, or more than MINPACK, all solvers of SciPy's least squares are compared.
"""

import argparse
from collections import Counter
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from unittest import mock

import numpy as np
import scipy

import calib
from calib.core.base.threads import one_blas_thread
from calib.core.fitting.fit import fit_data
from calib.core.fitting.problem import Problem
from calib.core.fitting.settings import Settings
from calib.core.fitting.solving import place, solve_from
from calib.core.numerics.least_squares import TOLERANCE, minimise
from calib.core.robots.terms.term import Context
from medrue import robot_file
from medrue.imperfections import from_direction
from medrue.workspace import target_workspace
from tests.project import EXAMPLES
from tests.public_data import motoman, ur10_tracker

SIGMAS = np.array([1000, 300, 100, 42.6, 10, 7, 3, 1]) * 1e-6


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


def fitted(robot, data, sigma):
    """The most evaluations of a fit and of those that prove it, and whether it converged and did not fail."""
    with counted() as counts:
        fit = calib.fit(robot, data, sigma=sigma)
    return max(counts.values()), fit.converged and fit.verdict.grade != "FAIL"


def most_of(starts, robot, data, sigma):
    """The most evaluations of solves from random starts, and whether all of them converged."""
    problem = Problem.from_data(robot, data, sigma)
    placed, unknowns = place(problem), problem.unknowns
    groups = solve_from(problem, placed, Settings(sigma=sigma)).groups
    solutions = []
    for seed in range(starts):
        away = np.where(unknowns.prior.has, np.random.default_rng(seed).standard_normal(len(unknowns)), 0.0)
        start = unknowns.robot_at(placed.robot, unknowns.deviations(placed.robot.values) + away)
        solutions.append(problem.solve(problem.evaluate(start), groups)[1])
    return max(solution.evaluations for solution in solutions), all(solution.converged for solution in solutions)


def table(robots, starts=0):
    """Lines of the table."""
    yield "| stated [mm] |" + "".join(f" {1e3 * sigma:g} |" for sigma in SIGMAS)
    yield "|---|" + "---:|" * len(SIGMAS)
    for name, (robot, data) in robots.items():
        row = f"| {name} |"
        for sigma in SIGMAS:
            problem = (robot, data, float(sigma))
            evaluations, converged = most_of(starts, *problem) if starts else fitted(*problem)
            row += f" {evaluations}{'' if converged else ' *'} |"
        yield row


def subsets(joints, count):
    """How rows were chosen, and which: `count` of each sort, of joint values (n, n_actuated)."""
    rng, n = np.random.default_rng(5), len(joints)
    scaled = (joints - joints.mean(axis=0)) / joints.std(axis=0)
    for _ in range(count):
        size = int(np.exp(rng.uniform(np.log(20), np.log(min(200, n)))))
        first, centre = rng.integers(0, n - size + 1), rng.integers(n)
        yield "at random", np.sort(rng.choice(n, size, replace=False))
        yield "one behind the other", np.arange(first, first + size)
        yield "nearest in joint space", np.sort(np.argsort(np.linalg.norm(scaled - scaled[centre], axis=1))[:size])


def matrix_of(model):
    """Rows of a linear model, above those of its prior."""
    return np.vstack([model.jacobian, model.prior.rows])


@one_blas_thread
def against_minpack(robot, data):
    """Evaluations of the last solve of a fit and of MINPACK's from the same start, and both costs; none of no fit."""
    last = []

    def both(residuals, jacobian, start, **options):
        ours = minimise(residuals, jacobian, start, **options)
        if options.get("tolerance", TOLERANCE) <= TOLERANCE:
            theirs = scipy.optimize.least_squares(
                lambda u: np.nan_to_num(residuals(u), nan=1e6),
                start,
                lambda u: matrix_of(jacobian(u)),
                method="lm",
                max_nfev=300,
            )
            last[:] = [ours.evaluations, theirs.nfev, ours.cost, 2.0 * theirs.cost, ours.converged]
        return ours

    with mock.patch("calib.core.fitting.problem.minimise", both):
        try:
            fit_data(robot, Settings(), data)
        except calib.NotIdentifiableError:  # said before anything is fitted
            return []
    return last


@one_blas_thread
def lowest_costs(robot, data):
    """Lowest cost so far at each evaluation of the last solve of a fit, by the fit and by each solver of SciPy."""
    paths = {}

    def all_of_them(residuals, jacobian, start, **options):
        def path_of(name, solve):
            costs = []

            def seen(u):
                values = residuals(u)
                costs.append(np.inf if np.any(np.isnan(values)) else values @ values)
                return values

            solution = solve(seen)
            paths[name] = np.minimum.accumulate(costs)
            return solution

        for name in ("lm", "trf", "dogbox"):
            path_of(
                name,
                lambda seen, name=name: scipy.optimize.least_squares(
                    lambda u: np.nan_to_num(seen(u), nan=1e6),
                    start,
                    lambda u: matrix_of(jacobian(u)),
                    method=name,
                    **dict.fromkeys(("ftol", "xtol", "gtol"), 1e-15),
                    max_nfev=300,
                ),
            )
        return path_of("fit", lambda seen: minimise(seen, jacobian, start, **options))

    with mock.patch("calib.core.fitting.problem.minimise", all_of_them):
        fit_data(robot, Settings(), data)
    return paths


def reached(paths):
    """Evaluations by which each came within 1e-8, and within 1e-12, of the lowest cost of all; a dash for never."""
    lowest = min(path[-1] for path in paths.values())
    for path in (paths[name] for name in ("fit", "lm", "trf", "dogbox")):
        within = [np.flatnonzero(path <= (1 + part) * lowest) for part in (1e-8, 1e-12)]
        yield ", ".join(str(first[0] + 1) if len(first) else "-" for first in within)


def clustered(folder=None):
    """Robots and measurements of which subsets are fitted; those of others where there is a folder."""
    robots = {"MedRUE": example("medrue"), "arm": example("arm"), "Stewart": example("stewart")}
    return robots | ({"UR10": ur10(folder / "ur10_tracker", 2000)} if folder else {})


def subset_table(robots, count):
    """Lines of the table of subsets, and of one of those that take many evaluations."""
    yield (
        "| rows | fits | evaluations: median | most | more than 20 | MINPACK: median | most | more than MINPACK's |"
        " higher cost |"
    )
    yield "|---|---:|---:|---:|---:|---:|---:|---:|---:|"
    long = []
    for name, (robot, data) in robots.items():
        by_sort = {}
        for sort, rows in subsets(data.joints, count):
            counts = against_minpack(robot, data.subset(rows))
            by_sort.setdefault(sort, []).append(counts)
            if counts and (counts[0] > 20 or counts[0] > counts[1]):
                long.append((f"{name}, {len(rows)} rows {sort}", counts[0], robot, data.subset(rows)))
        for sort, each in by_sort.items():
            ours, theirs, cost, other, converged = np.array([counts for counts in each if counts]).T
            failed = "" if np.all(converged) else f", {int(np.sum(converged == 0))} not converged"
            numbers = np.median(ours), np.max(ours), np.sum(ours > 20), np.median(theirs), np.max(theirs)
            numbers = *numbers, np.sum(ours > theirs)
            shown = " | ".join(f"{number:.0f}" for number in (*numbers, np.sum(cost > (1 + 1e-6) * other)))
            yield f"| {name}, {sort} | {len(ours)}{failed} | {shown} |"
    yield ""
    yield "| more than 20, or than MINPACK's | evaluations | fit: 1e-8, 1e-12 | `lm` | `trf` | `dogbox` |"
    yield "|---|---:|---:|---:|---:|---:|"
    for name, evaluations, robot, data in long:
        yield f"| {name} | {evaluations} | {' | '.join(reached(lowest_costs(robot, data)))} |"


def main():
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path)
    parser.add_argument("--starts", type=int, default=0)
    parser.add_argument("--subsets", type=int, default=0)
    options = parser.parse_args()
    if options.subsets:
        for line in subset_table(clustered(options.data), options.subsets):
            print(line, flush=True)
        return
    for line in table(problems(options.data), options.starts):
        print(line, flush=True)


if __name__ == "__main__":
    main()
