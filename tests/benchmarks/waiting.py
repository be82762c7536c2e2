"""What a person waits for in a running program: few rows, a robot that is being watched, joint terms.

    python -m tests.benchmarks.waiting [--data FOLDER]

The unit is a fit with verdict and intervals of 84 poses of MedRUE. Measurements are simulated, but those of the UR10:
FOLDER holds those of others, as for evaluations.py; without it, these rows are left out.
"""

from collections import deque

import numpy as np

import calib
from medrue.workspace import target_workspace
from tests.benchmarks import evaluations
from tests.benchmarks.timing import least, print_table

SIGMA = 4e-5
FIRST = (42, 30, 20)
"""First rows of MedRUE's file: not spread over its workspace; the last do not determine the robot."""
WATCHED = (20, 84)
CHOSEN = (300, 1000, 10_000)


def fitted(robot, data, **options):
    """A fit with its verdict and intervals, or that the data do not determine it."""
    try:
        fit = calib.fit(robot, data, **options)
    except calib.NotIdentifiableError:
        return "refused"
    assert np.all(fit.statistics.half_width > 0.0)
    return fit.verdict.grade


def watched(robot, data, n):
    """One update of a robot that is watched, by its n-th pose."""
    watch = calib.Watch(robot, "0.01 mm", candidates=np.array(target_workspace().q)[::2])
    watch.update(data[: n - 1])
    return lambda: watch.update(data[:n])


def works(folder):
    """What is timed: name, and work that is done once."""
    robot, data = evaluations.example("medrue")
    spread = data[::5]
    arm, poses = evaluations.example("arm")
    yield "positions, arm, one pose", lambda: arm.positions(poses.joints[:1])
    yield "fit, MedRUE, 84 poses", lambda: fitted(robot, spread, sigma=SIGMA)
    for n in FIRST:
        ended = fitted(robot, data[:n], sigma=SIGMA)
        yield f"first {n} poses alone: {ended}", lambda n=n: fitted(robot, data[:n], sigma=SIGMA)
    order = np.random.default_rng(0).permutation(len(data))
    for n in WATCHED:
        updates = deque(watched(robot, data[order], n) for _ in range(3))  # a second update finds nothing new
        yield f"an update of `calib watch`, {n} poses", lambda updates=updates: updates.popleft()()
    for n in CHOSEN if folder else ():
        yield (
            f"fit with `--terms auto`, UR10, {n} poses",
            lambda n=n: fitted(*evaluations.ur10(folder, n), terms="auto"),
        )


def table(folder, rounds):
    """Lines of the table: ratio to the unit, and seconds of this machine."""
    quick, once = {}, {}
    for name, work in works(folder and folder / "ur10_tracker"):
        (once if "auto" in name or "watch" in name else quick)[name] = work
    taken = least(rounds, **quick) | least(1, **once)
    unit = taken["fit, MedRUE, 84 poses"]
    yield "| work | over a fit of 84 poses | processor time |"
    yield "|---|---:|---:|"
    for name, seconds in taken.items():
        yield f"| {name} | {float(f'{seconds / unit:.2g}'):g} | {seconds:.2g} s |"


if __name__ == "__main__":
    print_table(__doc__, table, 3)
