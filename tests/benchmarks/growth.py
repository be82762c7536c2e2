"""How processor time grows with rows, targets, unknowns, joints, candidates and draws.

    python -m tests.benchmarks.growth [--data FOLDER]

Each piece of work is done for two sizes, in turns. A slope is log(time ratio) / log(size ratio): 1 where twice as much
takes twice as long, 2 where it takes four times as long. With FOLDER, which holds the measurements of others as for
evaluations.py, the choice of joint terms is among the rows.
"""

import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import calib
from calib.core.robots.acceleration import compile_kinematics
from medrue import robot_file
from medrue.workspace import target_workspace
from tests.benchmarks import evaluations, many_joints
from tests.benchmarks.timing import least, print_table

SIGMA = 4e-5


@dataclass(frozen=True)
class Growth:
    """Work of two sizes.

    Attributes:
        work: What is done.
        of: What there is more of.
        sizes: How much of it.
        each: The work for each size.
    """

    work: str
    of: str
    sizes: tuple
    each: tuple


def rows():
    """A fit of the arm, with more poses."""
    robot = calib.load(evaluations.EXAMPLES / "arm.yaml")
    q = robot.sample(4000, seed=1)

    def fit(n):
        data = calib.simulate(robot, q[:n], SIGMA, 1)
        return lambda: calib.fit(robot, data, sigma=SIGMA).verdict

    return Growth("fit and verdict, arm", "poses", (1000, 4000), (fit(1000), fit(4000)))


def targets():
    """A fit of the arm with many targets that are all read at each of 60 poses."""

    description = (evaluations.EXAMPLES / "arm.yaml").read_text()
    own = next(line for line in description.splitlines() if line.startswith("  reflector:"))

    def fit(n):
        points = np.random.default_rng(0).uniform(0, 200, (n, 3)).round(1)
        lines = [f"  t{k}: {{frame: flange, xyz: [{x} mm, {y} mm, {z} mm]}}" for k, (x, y, z) in enumerate(points)]
        with tempfile.TemporaryDirectory() as folder:
            shutil.copy(evaluations.EXAMPLES / "arm.urdf", folder)
            path = Path(folder) / "arm.yaml"
            path.write_text(description.replace(own, "\n".join(lines)))
            robot = calib.load(path)
        data = calib.simulate(robot, robot.sample(60, seed=1), SIGMA, 1)
        return lambda: calib.fit(robot, data, sigma=SIGMA).verdict

    return Growth("fit and verdict, arm, 60 poses", "targets at a pose", (10, 40), (fit(10), fit(40)))


def unknowns():
    """A fit of MedRUE, and one of all its joint origins."""
    robot, data = evaluations.extended_medrue()
    plain = calib.load(robot_file())
    few = calib.simulate(plain, data.joints, SIGMA, 1)
    each = (lambda: calib.fit(plain, few, sigma=SIGMA).verdict, lambda: calib.fit(robot, data, sigma=SIGMA).verdict)
    return Growth("fit and verdict, MedRUE, 84 poses", "unknowns", (len(plain.values), len(robot.values)), each)


def joints():
    """A fit of a simulated chain with joint terms chosen, with more joints."""

    def fit(n):
        robot = many_joints.chain(n, np.random.default_rng(7))
        data = many_joints.measured(robot, 400, np.random.default_rng(3))
        return lambda: calib.fit(robot, data, terms="auto").verdict

    return Growth("fit and verdict with `--terms auto`, chain, 400 poses", "joints", (6, 18), (fit(6), fit(18)))


def candidates():
    """A selection among more poses."""
    robot, q = calib.load(robot_file()), np.array(target_workspace().q)
    rng = np.random.default_rng(0)
    more = np.vstack([q + rng.uniform(-0.01, 0.01, q.shape) for _ in range(20)])
    each = tuple(lambda n=n: calib.select(robot, more[:n], count=84, index="O1") for n in (2000, 8000))
    return Growth("84 poses chosen by O1, MedRUE", "candidates", (2000, 8000), each)


def draws():
    """A study with more draws."""
    robot, q = calib.load(robot_file()), np.array(target_workspace().q)[::5]
    each = tuple(lambda n=n: calib.study(robot, q, draws=n, truth=robot, sigma=SIGMA) for n in (50, 200))
    return Growth("study, MedRUE, 84 poses", "draws", (50, 200), each)


def terms(folder):
    """A fit of the UR10 with joint terms chosen, with more poses."""
    robot, data = evaluations.ur10(folder / "ur10_tracker", 1200)
    each = tuple(lambda n=n: calib.fit(robot, data[np.arange(n)], terms="auto").verdict for n in (300, 1200))
    return Growth("fit and verdict with `--terms auto`, UR10", "poses", (300, 1200), each)


def table(folder, rounds):
    """Lines of the table."""
    yield "| work | growing | from | to | times as long | slope |"
    yield "|---|---|---:|---:|---:|---:|"
    for growth in (
        rows(),
        targets(),
        unknowns(),
        joints(),
        candidates(),
        draws(),
        *([terms(folder)] if folder else []),
    ):
        with compile_kinematics(use=False):
            taken = least(rounds, few=growth.each[0], many=growth.each[1])
        (few, many), ratio = growth.sizes, taken["many"] / taken["few"]
        slope = np.log(ratio) / np.log(many / few)
        yield f"| {growth.work} | {growth.of} | {few} | {many} | {ratio:.1f} | {slope:.2f} |"


if __name__ == "__main__":
    print_table(__doc__, table, 1)
