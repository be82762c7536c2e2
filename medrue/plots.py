"""Figures of the paper's studies, drawn from simulated numbers. Nothing here opens a window or keeps state."""

from __future__ import annotations

import io
from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calib.core.base.arrays import FloatArray
from calib.core.base.units import millimetres
from calib.planning.selection import Selection
from medrue.workspace import Workspace
from viz.svg import svg_file, with_style

BLUE, ORANGE, GREEN, PURPLE, GREY = "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#666666"
"""Colours that people with any colour vision tell apart (Okabe and Ito)."""
AXIS_COLOURS = (ORANGE, BLUE, GREEN)
_MARKERS = ("o", "s", "^")


@with_style
def figure_files(figure: Figure, name: str) -> dict[str, bytes]:
    """Return a figure as `name.png` and `name.svg`; the same figure gives the same bytes."""
    png, layout = io.BytesIO(), figure.get_layout_engine()
    if layout is not None:  # once for both files, and not again at every drawing
        layout.execute(figure)
        figure.set_layout_engine("none")
    figure.savefig(png, format="png", dpi=150, metadata={"Software": None, "Description": _labels(figure)})
    return {f"{name}.png": png.getvalue(), f"{name}.svg": svg_file(figure)}


def _labels(figure: Figure) -> str:
    """Texts of the legends, for those who cannot see the figure."""
    return "; ".join(str(label) for axes in figure.axes for label in axes.get_legend_handles_labels()[1])


@with_style
def workspace_figure(workspace: Workspace) -> Figure:
    """The 420 positions on their half cylinder, the leg's axis, and the direction of the probe at each (Figure 3)."""
    figure = Figure(figsize=(7.5, 4.7))
    # a square larger than the figure: such axes draw nothing outside their square, and leave much of it empty
    axes = figure.add_subplot(projection="3d", position=(-0.07, -0.39, 1.1, 1.1 * 7.5 / 4.7))
    p = millimetres(workspace.T_world_tool[:, :3, 3])
    z = 30 * workspace.T_world_tool[:, :3, 2]
    ends = millimetres(np.stack([workspace.p_axis, workspace.p_axis + workspace.length * workspace.axis]))
    axes.plot(*p.T, "o", color=BLUE, markersize=3, label=f"{len(p)} positions of the tool")
    axes.quiver(*p.T, *z.T, color=GREY, linewidth=0.6, arrow_length_ratio=0.2, label="direction of the probe")
    axes.plot(*ends.T, color=ORANGE, linewidth=2, label="axis of the leg")
    axes.set(xlabel="x [mm]", ylabel="y [mm]", zlabel="z [mm]", yticks=(200, 300, 400), zticks=(-100, 0, 100))
    axes.xaxis.labelpad = 18
    axes.set_aspect("equal")
    axes.set_box_aspect(np.ptp([axes.get_xlim(), axes.get_ylim(), axes.get_zlim()], axis=1), zoom=0.77)
    axes.view_init(elev=28, azim=-58)
    diameter, length = millimetres(2 * workspace.radius), millimetres(workspace.length)
    figure.suptitle(f"Target workspace: half cylinder, diameter {diameter:.0f} mm, length {length:.0f} mm")
    figure.legend(loc="upper right", bbox_to_anchor=(0.99, 0.92))
    return figure


@with_style
def exchange_figure(selection: Selection) -> Figure:
    """O1 while poses are exchanged (Figure 4)."""
    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.add_subplot()
    run = selection.runs[0]
    values = 1e3 * np.array(run.history)
    paper = np.arange(run.n_paper + 1)
    rest = np.arange(run.n_paper, len(values))
    axes.plot(
        paper, values[paper], "o-", color=BLUE, markersize=3, label="add the best, remove the worst (the paper's)"
    )
    if len(rest) > 1:
        axes.plot(rest, values[rest], "s-", color=ORANGE, markersize=3, label="then single swaps, until none helps")
    if selection.bound is not None:
        axes.axhline(1e3 * selection.bound, color=GREY, linestyle="--", label="no choice of 84 poses can be above this")
    axes.set(xlabel="exchange", ylabel="O1 [10⁻³, columns in units of 2 mm and 1.5 deg]")
    axes.set_title("Observability index O1 while 84 of 420 poses are chosen")
    axes.legend(loc="lower right")
    return figure


@with_style
def before_after_figure(before: FloatArray, after: FloatArray, title: str) -> Figure:
    """Position errors (n,) [m] at the validation poses before and after, on the same axes (Figures 5 and 7)."""
    figure = Figure(figsize=(10, 4.6), layout="constrained")
    left, right = figure.subplots(1, 2, sharex=True, sharey=True)
    for axes, values, name, colour in ((left, before, "before", ORANGE), (right, after, "after", BLUE)):
        shown = millimetres(values)
        axes.plot(np.arange(1, len(values) + 1), shown, "o", color=colour, markersize=2.5, label="one pose")
        axes.axhline(shown.mean(), color=GREY, label=f"mean {shown.mean():.3f} mm")
        axes.axhline(shown.max(), color=GREY, linestyle=":", label=f"largest {shown.max():.3f} mm")
        axes.set_title(f"{name} calibration")
        _error_axes(axes)
    left.set_ylabel("position error [mm]")
    figure.suptitle(title)
    return figure


@with_style
def axis_figure(before: FloatArray, after: FloatArray, title: str) -> Figure:
    """Components of position errors (n, 3) [m] before and after calibration, on the same axes (Figure 8)."""
    figure = Figure(figsize=(10, 4.6), layout="constrained")
    left, right = figure.subplots(1, 2, sharex=True, sharey=True)
    for axes, errors, name in ((left, before, "before"), (right, after, "after")):
        for k, axis in enumerate("xyz"):
            values = millimetres(np.abs(errors[:, k]))
            axes.plot(
                np.arange(1, len(values) + 1),
                np.maximum(values, 1e-4),
                _MARKERS[k],
                color=AXIS_COLOURS[k],
                markersize=2.5,
                alpha=0.7,
                label=f"{axis}: mean {values.mean():.3f}",
            )
        axes.set_title(f"{name} calibration")
        _error_axes(axes, f"{name} calibration, component along [mm]")
    left.set_ylabel("magnitude of the component [mm]")
    figure.suptitle(title)
    return figure


def _error_axes(axes: Axes, legend: str | None = None) -> None:
    axes.set_yscale("log")
    axes.set_xlabel("validation pose")
    axes.grid(alpha=0.2, which="minor")
    axes.yaxis.set_major_formatter("{x:g}")
    spacing = {"columnspacing": 1.2, "handlelength": 1.2, "handletextpad": 0.4}
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=3, title=legend, **spacing)


@with_style
def spread_figure(names: tuple[str, ...], errors: FloatArray, floors: FloatArray, title: str) -> Figure:
    """Scatter over the draws of the error of every choice of poses.

    Theory bounds the mean square over the draws, not the root of each draw's, whose mean is smaller. So the root of
    that mean square is drawn too, with the bound.

    Args:
        names: The choices.
        errors: Root-mean-square error of each draw, (n_draws, n_sets) [m].
        floors: Least root of the mean square over draws that theory allows, (n_sets,) [m].
        title: Title.
    """
    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.add_subplot()
    places = np.arange(len(names))
    errors, floors = millimetres(errors), millimetres(floors)
    boxes = axes.boxplot(errors, positions=places, widths=0.5, patch_artist=True, flierprops={"markersize": 3})
    for box in boxes["boxes"]:
        box.set(facecolor=BLUE, alpha=0.35)
    for median in boxes["medians"]:
        median.set(color=ORANGE)
    together = np.sqrt(np.mean(errors**2, axis=0))
    axes.plot(
        places + 0.36,
        together,
        "o",
        color=BLUE,
        markersize=5,
        label="root of the mean square of all draws",
    )
    axes.plot(
        places + 0.36,
        floors,
        "D",
        color=GREEN,
        markersize=5,
        fillstyle="none",
        label="least that theory allows for it",
    )
    axes.set_xticks(places, names)
    axes.set(xlabel="index that chose the 84 poses", ylabel="RMS error at the validation poses [mm]")
    axes.set_title(title)
    axes.grid(visible=False, axis="x")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=2)
    return figure


@with_style
def cause_figure(causes: Mapping[str, FloatArray]) -> Figure:
    """Error along each axis after calibration: root mean square along x, y and z by cause, (3,) [mm]."""
    figure = Figure(figsize=(8, 4), layout="constrained")
    axes = figure.add_subplot()
    places = np.arange(len(causes))
    for k, axis in enumerate("xyz"):
        values = [components[k] for components in causes.values()]
        axes.bar(places + 0.26 * (k - 1), values, 0.24, color=AXIS_COLOURS[k], label=axis)
    axes.set_xticks(places, [name.replace(" out of ", "\nout of ").replace(" of the ", "\nof the ") for name in causes])
    axes.set_ylabel("RMS component after calibration [mm]")
    axes.set_title("What the paper's model leaves (simulated)")
    axes.grid(visible=False, axis="x")
    axes.legend(title="axis")
    return figure


@with_style
def pose_count_figure(counts: tuple[int, ...], errors: Mapping[str, FloatArray], noise: float) -> Figure:
    """Mean error along x after calibration over the number of poses, for each way to calibrate.

    Args:
        counts: Numbers of poses.
        errors: Mean magnitude for each of them, (n_counts,) [m], by way; NaN where it cannot be.
        noise: Error by the instrument's noise alone [m].
    """
    figure = Figure(figsize=(7, 4.2), layout="constrained")
    axes = figure.add_subplot()
    for (name, values), colour, marker in zip(errors.items(), (ORANGE, BLUE, GREEN, PURPLE), "os^D", strict=True):
        axes.plot(counts, millimetres(values), f"{marker}-", color=colour, markersize=4, label=name)
    axes.axhline(millimetres(noise), color=GREY, linestyle="--", label="the tracker's noise alone")
    axes.set_yscale("log")
    axes.set_xscale("log")
    axes.set_xticks(counts, [str(count) for count in counts])
    heights = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5)
    axes.set_yticks(heights, [f"{height:g}" for height in heights])
    axes.minorticks_off()
    axes.set(xlabel="poses to identify with", ylabel="mean magnitude of the x error [mm]")
    axes.set_title("What remains along x after calibration (simulated)")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2)
    return figure
