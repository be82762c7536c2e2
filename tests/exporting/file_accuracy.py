"""How far off the robots in exported files are, read back by other code: the figures of docs/benchmarks.md.

    python -m tests.exporting.file_accuracy [FOLDER] [--page docs/benchmarks.md]

Simulated robots with joint terms, made by the few lines here; and with FOLDER, which has motoman_right,
ur10_tracker and ur10 (see tests/public_data.py), real ones. Every robot is fitted with `--terms auto`, its result
saved, loaded, and written in every format. Errors are of poses that the fit never saw; base and target are placed by
the training poses, for the nominal robot and for every file alike. It takes about two minutes.
"""

import argparse
import shutil
import sys
import tempfile
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import calib
from calib.core.robots.accuracy_of_files import Holds
from calib.core.robots.file_formats import formats
from calib.core.robots.robot_files import urdf_of_origins, without_terms
from tests.exporting.read_back import held_out, in_file, tip_of, urdf_links
from tests.project import EXAMPLES
from tests.public_data import added, markdown, motoman, ur10_tracker, written
from tests.starting.test_denavit_hartenberg import flange_poses

ENDINGS = {
    "urdf": ".urdf",
    "mjcf": ".xml",
    "drake": ".drake",
    "toolbox": ".yaml",
    "xacro": ".xacro",
    "joint-tables": "",
}


def ur10(folder):
    """The UR10 of the public data: its 300 poses to train, and 1000 to test."""
    robot, data, use = ur10_tracker(folder / "ur10_tracker")
    return robot, data[use == "train"], data[use == "test"]


def simulated_arm(_=None):
    """The arm of the tutorial, zeroed in the middle of where it works: gears that turn by 1 % too much from there."""
    robot = calib.load(EXAMPLES / "arm.yaml")
    truth = robot.with_parameters(calib.read_parameters(EXAMPLES / "arm_truth.csv", robot))
    rng, middle = np.random.default_rng(3), np.array([0.0, 0.9, -0.8, 0.0, 0.8, 0.0])
    q = middle + rng.uniform(-0.7, 0.7, (360, 6))
    gears = q + 0.01 * (q - middle) + 5e-4 * np.sin(q * [17, 11, 23, 13, 17, 11])
    target = truth.mechanism.targets[0]
    point = np.append(truth.mechanism.model.jointPlacements[target.b].translation, 1.0)
    read = _seen((flange_poses(truth, gears) @ point)[:, :3], rng)
    return _measured(robot, q, read, 160)


def simulated_five_bar(_=None):
    """The five-bar of the tutorial, by the circles of its links: lengths off, motors with gain and gears."""
    robot = calib.load(EXAMPLES / "five_bar.yaml")
    rng, q = np.random.default_rng(5), np.zeros((0, 2))
    while len(q) < 240:
        some = rng.uniform(np.radians([90, -20]), np.radians([200, 90]), (100, 2))
        good = robot.close(some).ok
        closed = robot.assemble(some[good])
        q = np.vstack([q, some[good][robot.singular_values(closed) > 0.25]])
    actual = 1.01 * q + 1e-3 * np.sin(13 * q + [0.3, 1.1]) + np.radians([-0.12, 0.05])
    left, right = np.array([-0.1, 0.0]), np.array([0.1002, 0.0])
    (l1, r1), (l2, r2) = (0.1997, 0.2004), (0.2996, 0.3008)
    a = left + l1 * np.stack([np.cos(actual[:, 0]), np.sin(actual[:, 0])], axis=1)
    b = right + r1 * np.stack([np.cos(actual[:, 1]), np.sin(actual[:, 1])], axis=1)
    apart = np.linalg.norm(b - a, axis=1)
    along = (apart**2 + l2**2 - r2**2) / (2 * apart)
    unit = (b - a) / apart[:, None]
    tips = a + along[:, None] * unit + np.sqrt(l2**2 - along**2)[:, None] * np.stack([-unit[:, 1], unit[:, 0]], axis=1)
    return _measured(robot, q, _seen(np.column_stack([tips, np.full(len(tips), 0.02)]), rng), 120)


def _seen(points, rng):
    """Points as a tracker with 20 um of noise sees them from somewhere."""
    turned = Rotation.from_rotvec([0.02, 0.03, -1.2]).apply(points)
    return turned + np.array([0.4, 1.1, -0.3]) + 2e-5 * rng.standard_normal(points.shape)


def _measured(robot, q, read, n_train):
    return robot, *(
        calib.as_measurements(robot, q[part], read[part]) for part in (slice(n_train), slice(n_train, None))
    )


def files_of(robot, train, test, folder):
    """Errors of all files of a robot, fitted with `--terms auto`, by what they are called [m], and what was fitted."""
    fit = calib.fit(robot, train, validation=test, terms="auto")
    fit.save(folder / "result", pages=False)
    loaded, points = calib.load(folder / "result"), [(data.joints, data.points(robot)[:, 0]) for data in (train, test)]
    errors = {
        "poses used, not used": f"{train.n_poses}, {test.n_poses}",
        "terms that `auto` added": added(fit),
        "nominal robot": held_out(tip_of(urdf_links(robot.urdf.source), robot), robot, *points),
    }
    alone = calib.fit(robot, train, validation=test, terms="none")
    errors |= {"fit of origins alone": alone.validation.rms("after"), "whole model": fit.validation.rms("after")}
    whole = urdf_of_origins(without_terms(fit.robot, Holds.ORIGINS))
    errors["its origins, terms dropped"] = held_out(tip_of(urdf_links(whole), robot), robot, *points)
    for name in (name for name, each in formats().items() if each.holds is not Holds.EVERYTHING):
        path = folder / f"{name}{ENDINGS.get(name, '.csv')}"
        try:
            calib.export(loaded, path, name)
            errors[f"`{name}`"] = held_out(in_file(robot, name, path), robot, *points)
        except calib.CalibrationError as error:
            print(f"{name}: {str(error).replace(str(folder), '...')}", file=sys.stderr)
    return errors


def ur_description(folder):
    """The UR10 again, with the URDF that ur_description makes, which names the flange otherwise."""
    with tempfile.TemporaryDirectory() as name:
        shutil.copy(folder / "ur10_tracker" / "grid.csv", name)
        shutil.copy(folder / "ur10" / "robot.urdf", name)
        robot, data, use = ur10_tracker(Path(name), flange="tool0")
    return robot, data[use == "train"], data[use == "test"]


def table(results):
    """A column for each robot: errors [mm] by what they are called; formats with the same errors share a row."""
    rows: dict[tuple[str, ...], list[str]] = {}
    for name in dict.fromkeys(name for errors in results.values() for name in errors):
        rows.setdefault(tuple(_cell(errors.get(name, "")) for errors in results.values()), []).append(name)
    return markdown(["", *results], [[", ".join(names), *cells] for cells, names in rows.items()])


def _cell(value):
    return value if isinstance(value, str) else f"{1e3 * value:.4f}"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", metavar="FOLDER", type=Path, nargs="?", help="public data; simulated robots if none")
    parser.add_argument("--page", metavar="FILE", type=Path, help="the page to write the table into")
    options = parser.parse_args()
    robots = {"simulated arm": simulated_arm, "simulated five-bar": simulated_five_bar}
    if options.folder:
        robots = {
            "Motoman": lambda folder: motoman(folder / "motoman_right"),
            "UR10": ur10,
            "UR10, `ur_description`": ur_description,
        } | robots
    results = {}
    for name, made in robots.items():
        with tempfile.TemporaryDirectory() as scratch:
            results[name] = files_of(*made(options.folder), Path(scratch))
    print(table(results))
    if options.page is not None:
        written(options.page, "files", table(results))
