"""Draw docs/figures/watch_replay.svg: a real robot measured again, in the order that `calib watch` asks for.

    python docs/site/watch_replay.py FOLDER

FOLDER holds the measurements of a UR10 by a laser tracker of Landgraf and others (2021), which are not part of the
project: robot.urdf, and grid.csv with 11 911 rows. Poses to choose from are `POOL` rows drawn from those that are not
for testing; the rows for testing judge every fit and are used for nothing else. The next pose of every replay is read
from the file, so that noise, gears and temperature are those of the robot. Random order is drawn with several seeds;
so is the first pose.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import calib
from calib.core.base.arrays import FloatArray, IntArray
from calib.core.base.units import millimetres
from calib.core.data.tables import read_table
from viz.svg import BLUE, GREY, ORANGE, svg_file, with_style

FIGURE = Path(__file__).resolve().parents[1] / "figures" / "watch_replay.svg"
DESCRIPTION = FIGURE.parents[1] / "examples" / "ur10_tracker.yaml"
GOAL = 0.6e-3
POOL, SEEDS, MOST = 400, 8, 90


@dataclass(frozen=True)
class Replay:
    """One order of measurement.

    Attributes:
        errors: Root mean square error on the rows for testing, by number of poses; NaN before the first fit [m].
        stop: Poses when it said stop; 0 where it did not.
    """

    errors: FloatArray
    stop: int

    @property
    def needed(self) -> int:
        """Poses from which on the error on the rows for testing keeps the goal; 0 where it does not."""
        above = np.flatnonzero(~(self.errors <= GOAL))
        last = int(above[-1]) if len(above) else -1
        return last + 1 if last + 1 < len(self.errors) else 0


def read(folder: Path) -> tuple[calib.Robot, calib.Measurements, calib.Measurements]:
    """Return the robot, the poses to choose from, and the rows for testing."""
    with tempfile.TemporaryDirectory() as together:
        shutil.copy(folder / "robot.urdf", together)
        shutil.copy(DESCRIPTION, together)
        robot = calib.load(Path(together) / DESCRIPTION.name)
    table = read_table(folder / "grid.csv")
    test = np.array([row[table.names.index("use")] == "test" for row in table.rows])
    data = calib.read_measurements(folder / "grid.csv", robot)
    kept = np.random.default_rng(0).choice(int(np.sum(~test)), POOL, replace=False)
    return robot, data[np.flatnonzero(~test)[kept]], data[test]


def replay(
    robot: calib.Robot, pool: calib.Measurements, test: calib.Measurements, order: IntArray | None, first: int
) -> Replay:
    """Measure the poses of the pool in an order, or as the watch asks for, and judge every fit."""
    watch = calib.Watch(robot, GOAL, candidates=pool.joints)
    measured, errors, stop = [first], [np.nan], 0
    while len(measured) < MOST:
        told = watch.update(pool[measured])
        off = np.full((1, 3), np.nan)
        if told.fit is not None:
            off = told.fit.robot.positions(test.joints)[:, 0] - test.points(robot)[:, 0]
        errors.append(float(np.sqrt(np.mean(np.sum(off**2, axis=1)))))
        if told.stop and not stop:
            stop = len(measured)
        assert told.next_pose is not None
        measured.append(told.next_pose.candidate if order is None else int(order[len(measured)]))
    return Replay(np.array(errors), stop)


def replays(folder: Path) -> dict[str, list[Replay]]:
    """Return the replays of each order."""
    robot, pool, test = read(folder)
    result: dict[str, list[Replay]] = {"next best": [], "random": []}
    for seed in range(SEEDS):
        order = np.random.default_rng(seed).permutation(len(pool))
        result["next best"].append(replay(robot, pool, test, None, int(order[0])))
        result["random"].append(replay(robot, pool, test, order, int(order[0])))
    return result


@with_style
def figure(by_folder: dict[str, list[Replay]]) -> Figure:
    """Draw them."""
    drawn = Figure(figsize=(7, 3.6), layout="constrained")
    axes = drawn.subplots()
    for (name, runs), colour in zip(by_folder.items(), (BLUE, ORANGE), strict=True):
        errors = millimetres(np.array([run.errors for run in runs]))
        number = np.arange(errors.shape[1])
        low, middle, high = np.nanquantile(errors[:, 8:], [0, 0.5, 1], axis=0)
        axes.fill_between(number[8:], low, high, color=colour, alpha=0.2, linewidth=0)
        axes.plot(number[8:], middle, color=colour, label=f"{name}: median and range of {len(runs)}")
        stops = [run.stop for run in runs if run.stop]
        at = [millimetres(run.errors[run.stop]) for run in runs if run.stop]
        axes.plot(stops, at, "o", color=colour, markersize=4, label="said stop")
    axes.axhline(millimetres(GOAL), color=GREY, linestyle="--", label=f"goal {millimetres(GOAL):g} mm")
    axes.set(xlabel="poses measured", ylabel="error on 1000 others, RMS [mm]", ylim=(0.4, 1.6), xlim=(8, MOST))
    axes.legend(frameon=False)
    return drawn


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", metavar="FOLDER", type=Path, help="measurements of the UR10")
    by_folder = replays(parser.parse_args().folder)
    for name, runs in by_folder.items():
        for what in ("needed", "stop"):
            numbers = sorted(getattr(run, what) or np.inf for run in runs)  # infinite: not within `MOST`
            print(f"{name}, {what}: median {np.median(numbers):g}, {numbers}")
        print("  error at stop [mm]:", [f"{millimetres(run.errors[run.stop]):.3f}" for run in runs if run.stop])
    FIGURE.write_bytes(svg_file(figure(by_folder)))


if __name__ == "__main__":
    main()
