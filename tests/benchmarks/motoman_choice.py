"""Does choosing poses help on a real arm? 53 of its 159 measured poses, by O1 and the task index, against random ones.

    python -m tests.benchmarks.motoman_choice FOLDER [--draws 200]

FOLDER holds robot.urdf, train.csv and test.csv of the arm in docs/examples/motoman_right.yaml. Each choice is fitted
and judged on the 53 held-out poses. Then the same poses are measured by simulation, where the calibrated arm is the
truth and the only error is normal noise of the size found in the real residuals.
"""

import argparse
from pathlib import Path

import numpy as np

import calib
from calib.core.base.threads import one_blas_thread
from calib.core.numerics.observability import information
from calib.core.rows.unknowns import Unknowns
from calib.planning.selection import select
from calib.shared.candidates import rows_of_poses
from tests.public_data import motoman

COUNT = 53


def rms(errors):
    """Root mean square length of errors (n, 3) [m], in mm."""
    return 1e3 * np.sqrt(np.mean(np.sum(errors**2, axis=1)))


def choices(fit, train, test, draws, seed=0):
    """Pose numbers by name, and `draws` random ones."""
    sigma = fit.sigma
    chosen = {
        "O1": select(fit.robot, train.joints, COUNT, "O1", sigma=sigma).chosen,
        "task": select(fit.robot, train.joints, COUNT, "task", task=test.joints, sigma=sigma).chosen,
    }
    rng = np.random.default_rng(seed)
    return chosen, [rng.choice(len(train), COUNT, replace=False) for _ in range(draws)]


def predicted(fit, train, test):
    """A function from pose numbers to the position error at the held-out poses that noise alone leaves [mm]."""
    robot, sigma = fit.robot, fit.sigma
    rows = rows_of_poses(robot, robot.assemble(train.joints), sigma).rows
    there = rows_of_poses(robot, robot.assemble(test.joints), sigma).position_rows
    priors = Unknowns.from_robot(robot).prior.rows

    @one_blas_thread
    def error(index):
        return 1e3 * np.sqrt(np.mean(information(rows[index], priors).position_errors(there) ** 2))

    return error


def report(title, chosen, random):
    """Print the chosen ones beside the random ones."""
    print(f"\n{title} [mm]")
    low, tenth, middle, high = np.quantile(random, [0, 0.1, 0.5, 1])
    print(f"  random: best {low:.4f}, best tenth up to {tenth:.4f}, median {middle:.4f}, worst {high:.4f}")
    for name, value in chosen.items():
        print(f"  {name}: {value:.4f}, better than {100 * np.mean(np.array(random) > value):.0f} % of the random ones")


def main():
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--draws", type=int, default=200)
    options = parser.parse_args()
    robot, train, test = motoman(options.folder)
    everything = calib.fit(robot, train, validation=test)
    chosen, random = choices(everything, train, test, options.draws)
    print(f"all {len(train)} poses: held-out rms {rms(everything.validation.errors('after')):.4f} mm,"
          f" noise found {1e6 * everything.sigma:.1f} um per axis")  # fmt: skip

    def real(index):
        return rms(calib.fit(robot, train.subset(np.sort(index)), validation=test).validation.errors("after"))

    report("held-out rms, real measurements", {k: real(v) for k, v in chosen.items()}, [real(i) for i in random])
    error = predicted(everything, train, test)
    report("predicted from noise alone", {k: error(v) for k, v in chosen.items()}, [error(i) for i in random])
    data = calib.simulate(everything.robot, train, everything.sigma, np.random.default_rng(1))
    truth = everything.robot.positions(test.joints)[:, 0]

    def simulated(index):
        fit = calib.fit(robot, data.subset(np.sort(index)), sigma=everything.sigma)
        return rms(fit.robot.positions(test.joints)[:, 0] - truth)

    few = random[: max(20, options.draws // 4)]
    report("error against the truth, simulated noise", {k: simulated(v) for k, v in chosen.items()},
           [simulated(i) for i in few])  # fmt: skip
    inside = np.isin(np.arange(len(train)), chosen["O1"])
    residual = everything.identification.errors("after")
    print(f"\nresiduals of the fit to all poses [mm]: {rms(residual[inside]):.4f} at the poses that O1 chooses,"
          f" {rms(residual[~inside]):.4f} at the others")  # fmt: skip


if __name__ == "__main__":
    main()
