"""How fast everything is, as ratios within one run: the tables of docs/performance.md.

    python -m tests.benchmarks.performance [--data FOLDER] [--write FILE] [--quick]

Times of shared machines mean little on their own: what is compared is run in turns, and the least processor time of
each is taken. FOLDER holds the measurements of others, as for evaluations.py; without it, those rows are left out.
"""

import argparse
import subprocess
import sys
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pinocchio as pin
import scipy

import calib
from calib.core.robots.jacobian import linearise
from medrue import robot_file
from medrue.paper_tables import table1
from medrue.workspace import target_workspace
from tests.benchmarks import evaluations, growth, shares, waiting, whole_commands
from tests.benchmarks.hand_written import Arm, fit
from tests.benchmarks.timing import fast, least
from tests.public_data import markdown, written

ARMS = {  # priors of hand-written fits: origins' lengths and angles, place of the point; the point; noise to state
    "arm": ((1e-3, 3e-3, 5e-3), (0.02, 0.0, 0.05), 3e-5),
    "Motoman": ((2e-3, 5e-3, 1e-2), (0.045, 0.0, 0.245), 4.26e-5),
}
SAME_COST = 1e-6
"""Relative difference of costs up to which two fits reached the same minimum."""
NUMBA = find_spec("numba") is not None


def ratio(seconds, unit):
    """Text of a ratio; a dash for work that could not be done."""
    return "-" if seconds is None else f"{seconds / unit:.1f}" if seconds < 20 * unit else f"{seconds / unit:.0f}"


def urdf_loop(robot, n):
    """Pinocchio's own loop: one `computeJointJacobians` for each of n poses, of the URDF as users load it."""
    model = pin.buildModelFromUrdf(str(robot.urdf.path))
    data, q = model.createData(), pin.neutral(model)

    def loop():
        for _ in range(n):
            pin.computeJointJacobians(model, data, q)

    return loop


def with_loops(rounds):
    """Rows of the table of robots with loops: closing, positions and columns over Pinocchio's loop."""
    for name in ("MedRUE", "five-bar", "Stewart"):
        robot, some = evaluations.example(name.lower().replace("-", "_"))
        q = np.tile(some.joints, (420 // len(some) + 1, 1))[:420]
        rng = np.random.default_rng(0)
        moved = robot.with_parameters(robot.values + 1e-5 * rng.standard_normal(len(robot.values)))
        seed = robot.assemble(q).passive

        def step(moved=moved, q=q, seed=seed):
            return linearise(moved, moved.assemble(q, seed=seed))

        taken = least(rounds, loop=urdf_loop(robot, len(q)), step=step, **({"fast": fast(step)} if NUMBA else {}))
        yield name, len(robot.values), *(ratio(taken.get(key), taken["loop"]) for key in ("step", "fast"))


def kinematics(rounds):
    """Rows of the table of kinematics, MedRUE's 420 poses after a step of the parameters."""
    robot, q = calib.load(robot_file()), np.array(target_workspace().q)
    moved = robot.with_parameters(robot.values + 0.1 * (table1().actual - robot.values))
    seed, solved = robot.assemble(q).passive, moved.assemble(q)
    loop = urdf_loop(robot, len(q))

    def differences():
        def positions(values):
            return moved.with_parameters(values).positions(q, seed=solved.passive).ravel()

        return scipy.optimize.approx_fprime(moved.values, positions, 1e-7)

    def ours():
        return linearise(moved, moved.assemble(q, seed=seed)).jacobian

    every = calib.simulate(robot.with_parameters(table1().actual), q, 4e-5, 1)
    some = every.subset(np.arange(0, len(q), 5))
    error = np.max(np.abs(differences().reshape(ours()[:, 0].shape) - ours()[:, 0]))
    assert error < 1e-4, error  # of forward differences
    columns = {
        "loops closed from the last solution": lambda: moved.assemble(q, seed=seed),
        "positions and their derivative by 36 parameters": lambda: linearise(moved, solved),
        "both: what every step of a fit needs": ours,
        "the same by scipy's differences (`approx_fprime`)": differences,
        "`calib.fit`, 84 poses": lambda: calib.fit(robot, some, sigma=4e-5),
        "`calib.fit`, 420 poses": lambda: calib.fit(robot, every, sigma=4e-5),
    }
    quick = {f"{name} compiled": fast(function) for name, function in columns.items() if NUMBA}
    taken = least(rounds, loop=loop, **columns, **quick)
    units = {name: taken["loop"] * (len(some) / len(q) if " 84 " in name else 1.0) for name in columns}
    return [[name, *(ratio(taken.get(key), units[name]) for key in (name, f"{name} compiled"))] for name in columns]


def fits(problems, rounds):
    """Rows of the table of fits: name, ours over the hand-written one, evaluations of both."""
    rows = []
    for name, (robot, data) in problems.items():
        if name not in ARMS:
            continue
        prior, point, sigma = ARMS[name]
        arm = Arm.read(robot.urdf.source.decode(), "flange", list(robot.joint_names), point, prior)
        (measured,) = (readings.values for readings in data.readings.values())
        cost, hand = fit(arm, data.joints, measured, sigma)
        with evaluations.counted() as counts:
            result = calib.fit(robot, data, sigma=sigma)
        assert abs(result.rows.cost / cost - 1) < SAME_COST, (result.rows.cost, cost)
        ours = partial(calib.fit, robot, data, sigma=sigma)
        taken = least(
            rounds,
            hand=partial(fit, arm, data.joints, measured, sigma),
            ours=ours,
            compiled=fast(ours),
            judged=lambda ours=ours: ours().verdict,
            told=lambda ours=ours: ours().report(),
        )
        parts = ("ours", "compiled", "judged", "told")
        ours, quick, judged, told = (ratio(taken[key], taken["hand"]) for key in parts)
        quick = quick if NUMBA else "-"
        rows.append((name, len(data), len(result.unknowns), ours, quick, judged, told, sum(counts.values()), hand))
    return rows


def studies(draws, rounds):
    """Seconds of a fit by itself, of a draw of a study, and of a draw by compiled kinematics: MedRUE, 84 poses."""
    robot, q = calib.load(robot_file()), np.array(target_workspace().q)[::5]
    truth = robot.with_parameters(table1().actual)
    data = calib.simulate(truth, q, 4e-5, 1)

    def study():
        calib.study(robot, q, draws=draws, truth=truth, sigma=4e-5)

    taken = least(rounds, study=study, compiled=fast(study), fit=lambda: calib.fit(robot, data, sigma=4e-5))
    return taken["fit"], taken["study"] / draws, taken["compiled"] / draws if NUMBA else None


def tables(folder, rounds, draws):
    """Yield the tables of the page by the names of their places."""
    over = "over Pinocchio's loop", "with `fast`"
    yield "kinematics", markdown(["work for each pose", *over], kinematics(rounds))
    yield "loops", markdown(["robot", "parameters", *over], with_loops(rounds))
    head = ["arm", "poses", "unknowns", "fit over hand-written", "with `fast`", "with verdict", "and report"]
    yield "fits", markdown([*head, "evaluations", "its own"], fits(evaluations.problems(folder), rounds))
    yield "shares", "\n".join(shares.table(folder, 2 * rounds))
    alone, *drawn = studies(draws, max(rounds // 10, 1))
    rows = [
        [name, f"{alone / each:.1f} draws", f"{1e3 * each:.1f} ms", f"{1e4 * each / 120:.1f} min"]
        for name, each in zip(("draws", "draws, with `fast`"), drawn, strict=True)
        if each is not None
    ]
    head = ["", "a single fit takes as long as", "processor time of a draw", "of 10 000 draws, on two cores"]
    yield "draws", markdown(head, rows)
    few = max(rounds // 5, 1)
    yield "commands", "\n".join(whole_commands.table(folder, few))
    yield "waiting", "\n".join(waiting.table(folder, few))
    many = [sys.executable, "-m", "tests.benchmarks.many_joints"]  # a process of its own: memory counts
    yield "joints", subprocess.run(many, capture_output=True, text=True, check=True).stdout.rstrip()
    yield "growth", "\n".join(growth.table(folder, few))


def main():
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, help="folder with measurements of others")
    parser.add_argument("--write", type=Path, help="page to write the tables into")
    parser.add_argument("--quick", action="store_true", help="few rounds")
    options = parser.parse_args()
    for name, table in tables(options.data, *((3, 20) if options.quick else (15, 200))):
        print(f"{name}\n\n{table}\n", flush=True)
        if options.write:
            written(options.write, name, table)


if __name__ == "__main__":
    main()
