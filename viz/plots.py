"""The report's figures as SVG text: readable in any size and print, text selectable, told apart without colour vision.

matplotlib is imported where a figure is drawn. Figures are objects of their own: nothing global is touched and no
window can open. Text is never read as mathematics, because names come from files.
"""

from __future__ import annotations

import functools
import io
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ParamSpec

import numpy as np
from scipy.stats import norm

from calib.mechanism import FloatArray
from viz.poses import IDENTIFICATION, PoseTable
from viz.scene import Joint

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_Arguments = ParamSpec("_Arguments")
AXES = {"x": ("#D55E00", "o"), "y": ("#009E73", "^"), "z": ("#0072B2", "s")}
STATES = {"before": ("#7F7F7F", "--"), "after": ("#0072B2", "-")}
_MOST_MARKS = 600  # poses drawn one by one; more would make the file large and the figure black
_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "calibration",
    "text.parse_math": False,
    "font.family": "sans-serif",
    "font.size": 9,
    "axes.grid": True,
    "grid.alpha": 0.35,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "axes.titlesize": 9.5,
    "axes.formatter.useoffset": False,
}


@dataclass(frozen=True)
class Plot:
    """A finished figure.

    Attributes:
        name: Short name, unique in the report.
        title: What it shows.
        text: How to read it.
        svg: The drawing.
    """

    name: str
    title: str
    text: str
    svg: str


def all_plots(table: PoseTable, joints: tuple[Joint, ...]) -> tuple[Plot, ...]:
    """Return the figures of a calibration.

    Args:
        table: Poses with errors before and after.
        joints: Actuated joints, in the order of the table's columns.
    """
    return (
        histogram(table),
        error_by_pose(table),
        error_by_axis(table),
        residual_by_joint(table, joints),
        normal_plot(table),
    )


def _styled(draw: Callable[_Arguments, Plot]) -> Callable[_Arguments, Plot]:
    """Draw with our style and put matplotlib's settings back afterwards."""

    @functools.wraps(draw)
    def drawn(*args: _Arguments.args, **options: _Arguments.kwargs) -> Plot:
        import matplotlib

        with matplotlib.rc_context(_STYLE):
            return draw(*args, **options)

    return drawn


@_styled
def histogram(table: PoseTable) -> Plot:
    """Number of poses over the size of their error, before and after."""
    figure, (axes,) = _figure(1, 1, (8.9, 3.1))
    lengths = {state: _lengths(table, state) for state in STATES}
    everything = np.concatenate(list(lengths.values()))
    positive = everything[everything > 0]
    low, high = (float(positive.min()), float(positive.max())) if len(positive) else (1e-3, 1.0)
    bins = np.geomspace(low * 0.95, high * 1.05, 41).tolist()
    for state, (colour, line) in STATES.items():
        axes.hist(np.maximum(lengths[state], low), bins=bins, histtype="stepfilled", alpha=0.25, color=colour)
        axes.hist(
            np.maximum(lengths[state], low),
            bins=bins,
            histtype="step",
            color=colour,
            linestyle=line,
            linewidth=1.6,
            label=f"{state} calibration",
        )
    axes.set(xscale="log", xlabel="distance between predicted and measured position [mm]", ylabel="number of poses")
    _plain_log(axes.xaxis)
    axes.legend(loc="upper center")
    return _plot(
        "histogram",
        "Error before and after",
        "The scale is logarithmic: one step to the left is ten times better.",
        figure,
    )


@_styled
def error_by_pose(table: PoseTable) -> Plot:
    """Error of each pose, in the order of the table."""
    figure, (axes,) = _figure(1, 1, (8.9, 3.1))
    number = np.arange(1, len(table) + 1)
    for state, (colour, line) in STATES.items():
        lengths = 1e3 * np.linalg.norm(table.error(state), axis=1)
        axes.plot(
            number,
            np.where(lengths > 0, lengths, np.nan),
            line,
            color=colour,
            linewidth=0.9,
            label=f"{state} calibration",
        )
    fitted = np.array([group == IDENTIFICATION for group in table.group])
    if np.any(fitted) and not np.all(fitted):
        border = int(np.sum(fitted)) + 0.5
        axes.axvline(border, color="black", linewidth=0.8, linestyle=":")
        for text, side, shift in (("identification", "right", -4), ("validation", "left", 4)):
            axes.annotate(
                text,
                (border, 1.02),
                (shift, 0),
                xycoords=axes.get_xaxis_transform(),
                textcoords="offset points",
                ha=side,
                fontsize=8,
            )
    marked = np.flatnonzero(table.outlier)
    if len(marked):
        axes.plot(
            number[marked],
            1e3 * np.linalg.norm(table.error("after"), axis=1)[marked],
            "kx",
            markersize=7,
            linestyle="none",
            label="suspected outlier",
        )
    axes.set(yscale="log", xlabel="pose, in the order of the files", ylabel="error [mm]")
    _plain_log(axes.yaxis)
    axes.margins(x=0.01)
    axes.legend(loc="center right")
    return _plot(
        "error-by-pose",
        "Error of each pose",
        "Steps or slopes would show that something changed while measuring.",
        figure,
    )


@_styled
def error_by_axis(table: PoseTable) -> Plot:
    """Signed error components, before and after."""
    figure, panels = _figure(1, 2, (8.9, 2.7))
    for axes, state in zip(panels, STATES, strict=True):
        errors = 1e3 * table.error(state)
        errors = errors[np.all(np.isfinite(errors), axis=1)]
        if len(errors):
            boxes = axes.boxplot(
                list(errors.T),
                orientation="horizontal",
                widths=0.55,
                patch_artist=True,
                flierprops={"marker": ".", "markersize": 2.5},
                medianprops={"color": "black"},
            )
            for patch, (colour, _) in zip(boxes["boxes"], AXES.values(), strict=True):
                patch.set(facecolor=colour, alpha=0.45)
        axes.set_yticks([1, 2, 3], list(AXES))
        axes.axvline(0.0, color="black", linewidth=0.8)
        axes.invert_yaxis()
        axes.set(title=f"{state} calibration", xlabel="predicted minus measured [mm]")
    return _plot(
        "error-by-axis",
        "Error along each axis",
        "Boxes hold the middle half of the poses; a box away from zero is a systematic error. Mind the two scales.",
        figure,
    )


@_styled
def residual_by_joint(table: PoseTable, joints: tuple[Joint, ...]) -> Plot:
    """Residuals after calibration against every actuated joint."""
    columns = min(3, max(1, len(joints)))
    rows = -(-len(joints) // columns)
    figure, panels = _figure(rows, columns, (8.9, 2.3 * rows + 0.4), sharey=True)
    shown, note = _thinned(len(table))
    errors = 1e3 * table.error("after")[shown]
    for number, (axes, joint) in enumerate(zip(panels, joints, strict=False)):
        values = joint.per_si * table.joints[shown, number]
        for axis, ((name, (colour, marker)), component) in enumerate(zip(AXES.items(), errors.T, strict=True)):
            axes.plot(
                values,
                component,
                marker,
                color=colour,
                markersize=2.6,
                alpha=0.6,
                linestyle="none",
                markeredgewidth=0,
                label=name,
                zorder=2 + axis,
            )
        axes.axhline(0.0, color="black", linewidth=0.8)
        axes.set_xlabel(f"{joint.name} [{joint.unit}]")
        if number % columns == 0:
            axes.set_ylabel("residual [mm]")
    for axes in panels[len(joints) :]:
        axes.set_visible(False)
    if joints:
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=3, markerscale=2.5)
    return _plot(
        "residual-by-joint",
        "Residuals against each joint",
        "A curve instead of a cloud points at an error of that joint that no parameter describes." + note,
        figure,
    )


@_styled
def normal_plot(table: PoseTable) -> Plot:
    """Sorted residuals over sigma against normal quantiles, fitted poses only."""
    figure, (axes,) = _figure(1, 1, (5.2, 4.0))
    chosen = np.array([group == IDENTIFICATION for group in table.group], dtype=bool)
    ratio = table.over_sigma()[chosen if np.any(chosen) else slice(None)]
    reach = 1.0
    note = ""
    for (name, (colour, marker)), values in zip(AXES.items(), ratio.T, strict=True):
        known = np.sort(values[np.isfinite(values)])
        if not len(known):
            continue
        quantiles = norm.ppf((np.arange(len(known)) + 0.5) / len(known))
        shown, note = _thinned(len(known))
        axes.plot(
            quantiles[shown],
            known[shown],
            marker,
            color=colour,
            markersize=3.2,
            linestyle="none",
            alpha=0.75,
            markeredgewidth=0,
            label=name,
        )
        reach = max(reach, float(np.abs(quantiles).max()), float(np.abs(known).max()))
    axes.plot([-reach, reach], [-reach, reach], color="black", linewidth=0.9, label="normal")
    axes.set(xlabel="expected of normal noise [sigma]", ylabel="residual [sigma]")
    axes.legend(markerscale=1.6)
    return _plot(
        "normal-plot",
        "Residuals against normal noise",
        "On the line they are noise; ends that bend away are outliers or something the model lacks." + note,
        figure,
    )


def _figure(rows: int, columns: int, size: tuple[float, float], **shared: Any) -> tuple[Figure, list[Axes]]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False, **shared)
    return figure, list(panels.ravel())


def _plain_log(axis: Any) -> None:
    """Ticks such as 0.01 instead of powers, which need mathematics to print."""
    from matplotlib.ticker import FuncFormatter, NullFormatter

    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _lengths(table: PoseTable, state: str) -> FloatArray:
    lengths = 1e3 * np.linalg.norm(table.error(state), axis=1)
    known: FloatArray = lengths[np.isfinite(lengths)]
    return known


def _thinned(count: int) -> tuple[slice, str]:
    """Which of `count` marks to draw, and what the caption says about the others."""
    step = max(1, -(-count // _MOST_MARKS))
    return slice(None, None, step), "" if step == 1 else f" Of {count} marks, one in {step} is drawn."


def _plot(name: str, title: str, text: str, figure: Figure) -> Plot:
    return Plot(name, title, text, svg_text(figure, name, title))


def svg_text(figure: Figure, name: str, title: str) -> str:
    """Return a figure as an SVG element to put into a page; its identifiers begin with `name`, so that none clash."""
    stream = io.StringIO()
    figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    svg = stream.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r'\bid="([^"]+)"', rf'id="{name}-\1"', svg)
    svg = re.sub(r'(xlink:href="#|url\(#)', rf"\g<1>{name}-", svg)
    return svg.replace("<svg ", f'<svg role="img" aria-label="{title}" ', 1)
