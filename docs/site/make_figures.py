"""Draw the figures of the pages: docs/figures/*.svg.

    python docs/site/make_figures.py [FOLDER]

Each function makes one figure from the program itself, with fixed seeds.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import architecture
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import calib
from calib.core.base.arrays import FloatArray
from calib.core.numerics.identifiability import numerical_rank
from calib.core.robots.jacobian import linearise
from calib.core.robots.kinematics import sweep
from calib.core.robots.mechanism import RelativeFrame
from viz.svg import BLUE, GREY, ORANGE, plain_ticks, svg_file, with_style

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "docs" / "examples"
FIGURES = ROOT / "docs" / "figures"


def five_bar_cut() -> Figure:
    """The tutorial's five-bar: the tree that the URDF holds, and the assembled robot."""
    robot = calib.load(EXAMPLES / "five_bar.yaml")
    home_a, home_p = robot.mode.actuated, robot.mode.passive
    figure = Figure(figsize=(8, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    _draw_five_bar(left, _joint_points(robot, home_a, home_p + np.radians([14.0, -6.0])))
    left.set_title("In the URDF: a tree, cut open at the tip")
    left.annotate("left_tip", (-0.18, 0.405), color=BLUE)
    left.annotate("right_tip", (0.045, 0.385), color=ORANGE)
    _draw_five_bar(right, _joint_points(robot, home_a, home_p))
    right.set_title("With closed_loop: assembled")
    right.annotate("left_tip = right_tip", (0.0, 0.368), (0.03, 0.385))
    for axes in (left, right):
        axes.annotate("left_motor", (-0.1, 0), (-0.15, -0.04))
        axes.annotate("right_motor", (0.1, 0), (0.06, -0.04))
        axes.set(aspect="equal", xlim=(-0.32, 0.32), ylim=(-0.06, 0.43), xlabel="x [m]")
    left.set_ylabel("y [m]")
    return figure


def singular_values() -> Figure:
    """Singular values of MedRUE's 36 parameters on its 420 poses."""
    robot = calib.load(ROOT / "urdf" / "medrue.yaml")
    poses = calib.read_poses(EXAMPLES / "medrue_simulated.csv", robot)
    jacobian = linearise(robot, robot.assemble(poses.joints)).jacobian
    sigma = np.array([parameter.sigma_si for parameter in robot.parameters])
    rank = numerical_rank((jacobian * sigma).reshape(-1, len(sigma)))
    values = np.maximum(rank.singular_values, 1e-20)
    number = np.arange(1, len(values) + 1)
    figure = Figure(figsize=(7, 3.2), layout="constrained")
    axes = figure.subplots()
    axes.semilogy(number[: rank.rank], values[: rank.rank], "o", color=BLUE, label=f"determined: {rank.rank}")
    axes.semilogy(
        number[rank.rank :], values[rank.rank :], "x", color=ORANGE, label=f"not: {rank.n_columns - rank.rank}"
    )
    axes.axhline(rank.threshold, color=GREY, linestyle="--", label="threshold")
    axes.set(xlabel="number", ylabel="singular value [m]", title="MedRUE, 36 parameters, 420 poses")
    plain_ticks(axes.yaxis)
    axes.legend(frameon=False)
    return figure


def errors_before_after() -> Figure:
    """Position errors of the first calibration on the start page, on poses that it has not seen."""
    robot = calib.load(ROOT / "urdf" / "medrue.yaml")
    data = calib.read_measurements(EXAMPLES / "medrue_simulated.csv", robot)
    used, others = data.split(validation=0.8)
    fit = calib.fit(robot, used, validation=others)
    assert fit.validation is not None
    figure = Figure(figsize=(8, 2.8), layout="constrained")
    for axes, errors, colour, title in zip(
        figure.subplots(1, 2),
        (fit.validation.errors("before"), fit.validation.errors("after")),
        (ORANGE, BLUE),
        ("before", "after"),
        strict=True,
    ):
        distance = 1e3 * np.linalg.norm(errors, axis=1)
        axes.hist(distance, bins=24, color=colour)
        axes.locator_params(axis="x", nbins=6)
        axes.axvline(float(distance.mean()), color="black", linestyle=":")
        axes.set(xlabel="position error [mm]", ylabel="poses", title=f"{title}: mean {distance.mean():.3g} mm")
    return figure


def frame_of_a_program() -> Figure:
    """A planar arm with large errors: where the nominal robot stands beside the real one."""
    q = np.vstack([[1.1, -1.3], np.random.default_rng(3).uniform([0.4, -1.9], [1.6, -0.6], (40, 2))])
    nominal, real = (_planar_arm(q, *links) for links in ((0.0, 0.5, 0.4), (0.12, 0.56, 0.36)))
    centres = [arm[:, -1].mean(axis=0) for arm in (nominal, real)]
    u, _, vt = np.linalg.svd((nominal[:, -1] - centres[0]).T @ (real[:, -1] - centres[1]))
    fitted = (nominal - centres[0]) @ (u @ vt) + centres[1]
    figure = Figure(figsize=(8, 3.4), layout="constrained")
    titles = ("base known: the measurement frame", "base unknown: the nominal base, fitted")
    for axes, placed, title in zip(figure.subplots(1, 2, sharey=True), (nominal, fitted), titles, strict=True):
        axes.plot(*real[:, -1].T, ".", color=BLUE, alpha=0.35, label="measured poses")
        for arm, colour, line, label in ((placed, GREY, "--", "nominal robot"), (real, BLUE, "-", "real robot")):
            axes.plot(*arm[0].T, line + "o", color=colour, linewidth=2.5, markerfacecolor="white", label=label)
            axes.plot(*arm[0, 0], "s", color=colour, markersize=9)
        axes.annotate("", real[0, -1], placed[0, -1], arrowprops={"arrowstyle": "<-", "color": ORANGE, "linewidth": 2})
        axes.annotate("what is corrected", placed[0, -1], (0.8, -1.2), textcoords="offset fontsize", color=ORANGE)
        axes.set(aspect="equal", title=title, xticks=[], yticks=[], xlim=(-0.15, 1.15), ylim=(-0.12, 0.95))
    figure.axes[0].legend(loc="upper right")
    return figure


def _planar_arm(q: FloatArray, zero: float, *lengths: float) -> FloatArray:
    """Base, elbow and tool of a planar arm whose first joint has another zero [rad], (n, 3, 2) [m]."""
    turned = np.cumsum(q, axis=1) + zero
    steps = np.array(lengths)[:, None] * np.stack([np.cos(turned), np.sin(turned)], axis=2)
    return np.concatenate([np.zeros((len(q), 1, 2)), np.cumsum(steps, axis=1)], axis=1)


def _joint_points(robot: calib.Robot, actuated: FloatArray, passive: FloatArray) -> dict[str, FloatArray]:
    """Positions of all joints in the root link's frame [m], loops closed or not."""
    mechanism = robot.mechanism
    names = [name for name in mechanism.origin_names if name in {joint.name for joint in robot.urdf.joints}]
    pairs = tuple(_from_root(mechanism.origin_names.index(name) + 1) for name in names)
    swept = sweep(mechanism, mechanism.all_joints(actuated[None], passive[None]), pairs)
    return {name: swept.translation[0, swept.index[pair.b]] for name, pair in zip(names, pairs, strict=True)}


def _from_root(joint: int) -> RelativeFrame:
    return RelativeFrame("", 0, joint, False, (0, 1, 2))


def _draw_five_bar(axes: Axes, at: dict[str, FloatArray]) -> None:
    axes.plot(*zip(at["left_motor"][:2], at["right_motor"][:2], strict=True), color=GREY, linewidth=6, alpha=0.4)
    for side, colour in (("left", BLUE), ("right", ORANGE)):
        chain = np.array([at[f"{side}_{joint}"] for joint in ("motor", "elbow", "end")])
        axes.plot(chain[:, 0], chain[:, 1], "-", color=colour, linewidth=3, solid_capstyle="round")
        axes.plot(chain[0, 0], chain[0, 1], "s", color="black", markersize=9)
        axes.plot(chain[1:, 0], chain[1:, 1], "o", color=colour, markerfacecolor="white", markersize=8)


FIGURE_MAKERS: dict[str, Callable[[], Figure]] = {
    "architecture": architecture.picture,
    "five_bar_cut": five_bar_cut,
    "singular_values": singular_values,
    "errors_before_after": errors_before_after,
    "frame_of_a_program": frame_of_a_program,
}


@with_style
def drawing(name: str) -> bytes:
    """Return a figure as an SVG file."""
    return svg_file(FIGURE_MAKERS[name]())


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", metavar="FOLDER", nargs="?", type=Path, default=FIGURES, help="where to write")
    folder = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    for name in FIGURE_MAKERS:
        (folder / f"{name}.svg").write_bytes(drawing(name))
        print(f"{folder / name}.svg written")


if __name__ == "__main__":
    main()
