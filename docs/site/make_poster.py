"""Draw the picture of the front page: a real robot before and after, from the measurements of others.

    python docs/site/make_poster.py FOLDER

FOLDER holds robot.urdf and grid.csv of the UR10 of docs/benchmarks.md, which says where they come from; they are not
part of the project. Prints the errors that README.md states, at poses that the fit has not seen, and writes
docs/figures/ur10.svg and docs/figures/ur10_dark.svg.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

import calib
from calib.core.base.arrays import FloatArray
from calib.core.data.measurements import Measurements
from calib.core.data.tables import read_table
from viz.svg import BLUE, GREY, ORANGE, svg_file, with_style

ROOT = Path(__file__).resolve().parents[2]
DESCRIPTION = ROOT / "docs" / "examples" / "ur10_tracker.yaml"
FIGURES = ROOT / "docs" / "figures"
MAGNIFIED = 130
"""How many times as long as it is an error is drawn."""
_DRAWN = 300  # poses: more would make the picture black
_SEEN_FROM = np.radians([-60.0, 18.0])  # azimuth, elevation
_LINKS = ("base_link", "shoulder_link", "upper_arm_link", "forearm_link", "wrist_1_link", "wrist_2_link", "flange")
_MARGIN = 0.08  # around what is drawn [m]
_LARGEST = 1.2  # error at the end of the colours [mm]
_INK = {"light": "#1f2933", "dark": "#e6e9ec"}
_COLOURS = LinearSegmentedColormap.from_list("error", [BLUE, "#8fb8c9", "#f0b15c", ORANGE])


def poses_of(folder: Path) -> tuple[calib.Robot, Measurements, Measurements]:
    """Return the nominal robot, the 300 poses to fit, and the 1000 others."""
    with tempfile.TemporaryDirectory() as scratch:
        for file in (folder / "robot.urdf", DESCRIPTION):
            shutil.copy(file, scratch)
        robot = calib.load(Path(scratch) / DESCRIPTION.name)
    table = read_table(folder / "grid.csv")
    use = np.array([row[table.names.index("use")] for row in table.rows])
    data = calib.read_measurements(folder / "grid.csv", robot)
    train, test = (data.subset(np.flatnonzero(use == name)) for name in ("train", "test"))
    return robot, train, test


def fitted(folder: Path) -> calib.Calibration:
    """Return the fit of 300 poses, joint terms chosen by it, and judged by 1000 others."""
    robot, train, test = poses_of(folder)
    return calib.fit(robot, train, validation=test, terms="auto")


@dataclass(frozen=True)
class Shown:
    """What is drawn, in the frame of the robot's base.

    Attributes:
        places: Where the tool was, (n, 3) [m].
        errors: Errors there, before and after, (n, 3) [m].
        arm: Joints of the arm in one of these poses, (k, 3) [m].
    """

    places: FloatArray
    errors: dict[str, FloatArray]
    arm: FloatArray


def shown(fit: calib.Calibration) -> Shown:
    """Return what a fit has to draw."""
    assert fit.validation is not None
    robot, joints = fit.robot, fit.validation.data.joints
    to_base = np.linalg.inv(robot.forward(joints[0], "base_link"))
    places = robot.positions(joints)[:, 0] @ to_base[:3, :3].T + to_base[:3, 3]
    errors = {state: fit.validation.errors(state) @ to_base[:3, :3].T for state in ("before", "after")}
    pose = joints[np.argmax(np.linalg.norm(places, axis=1))]
    return Shown(places, errors, np.array([(to_base @ robot.forward(pose, link))[:3, 3] for link in _LINKS]))


@with_style
def drawing(robot: Shown, scheme: str) -> bytes:
    """Return the picture for a light or a dark page."""
    ink = _INK[scheme]
    lines = dict.fromkeys(
        ("text.color", "axes.labelcolor", "axes.edgecolor", "xtick.color", "ytick.color", "legend.labelcolor"), ink
    )
    with mpl.rc_context({**lines, "grid.color": GREY, "axes.facecolor": "none"}):
        figure = Figure(figsize=(10, 3.5), layout="constrained", facecolor="none")
        before, after, counts = figure.subplots(1, 3, width_ratios=(1, 1, 0.8))
        for axes, state in ((before, "before"), (after, "after")):
            _draw_robot(axes, robot, state, ink)
            axes.set_title(f"{state.capitalize()}: {_rms(robot.errors[state]):.2f} mm RMS", fontsize=14)
        _draw_counts(counts, robot.errors)
        return svg_file(figure)


def _rms(errors: FloatArray) -> float:
    return float(1e3 * np.sqrt(np.mean(np.sum(errors**2, axis=1))))


def _draw_robot(axes: Axes, robot: Shown, state: str, ink: str) -> None:
    """The arm, and an arrow at each pose: the error, magnified."""
    chosen = np.random.default_rng(1).permutation(len(robot.places))[:_DRAWN]
    errors, points, arm = robot.errors[state][chosen], _seen(robot.places[chosen]), _seen(robot.arm)
    axes.plot(*arm.T, "-", color=GREY, linewidth=13, alpha=0.4, solid_capstyle="round", solid_joinstyle="round")
    axes.plot(*arm.T, "o", color=ink, markersize=5)
    lengths = 1e3 * np.linalg.norm(errors, axis=1)
    axes.quiver(*points.T, *(MAGNIFIED * _seen(errors).T), lengths, cmap=_COLOURS, clim=(0, _LARGEST), angles="xy",
                scale_units="xy", scale=1, width=0.005)  # fmt: skip
    low, high = np.min([*points, *arm], axis=0) - _MARGIN, np.max([*points, *arm], axis=0) + _MARGIN
    axes.set(aspect="equal", xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    axes.set_axis_off()


def _seen(points: FloatArray) -> FloatArray:
    """Points or vectors (n, 3) as they are seen from the side, (n, 2)."""
    azimuth, elevation = _SEEN_FROM
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    away = np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])
    return np.stack([points @ right, points @ np.cross(away, right)], axis=1)


def _draw_counts(axes: Axes, errors: dict[str, FloatArray]) -> None:
    """How many poses are how far off."""
    edges = np.linspace(0, 2.0, 41)
    for state, colour in (("before", ORANGE), ("after", BLUE)):
        axes.hist(1e3 * np.linalg.norm(errors[state], axis=1), edges, color=colour, alpha=0.85, label=state)
    axes.set(xlabel="position error [mm]", ylabel="poses that the fit has not seen")
    axes.legend(frameon=False)


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", metavar="FOLDER", type=Path, help="where robot.urdf and grid.csv are")
    fit = fitted(parser.parse_args().folder)
    print(fit.report())
    robot = shown(fit)
    for scheme, name in (("light", "ur10.svg"), ("dark", "ur10_dark.svg")):
        (FIGURES / name).write_bytes(drawing(robot, scheme))
        print(f"{FIGURES / name} written")


if __name__ == "__main__":
    main()
