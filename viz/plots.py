"""The report's figures: each answers one question about the errors, and can be read without colour vision."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import norm

from calib.model.mechanism import BoolArray, FloatArray
from viz.poses import IDENTIFICATION, VALIDATION, PoseTable
from viz.scene import Joint
from viz.svg import AXES, STATES, Plot, finished, new_figure, plain_ticks, styled

_GROUP_MARKS = {IDENTIFICATION: ("o", None), VALIDATION: ("D", "white")}  # as in the viewer; face, if not the colour
_WIDEST_LABEL = 34  # letters under one of three panels
_MOST_MARKS = 600  # poses drawn one by one; more would make the file large and the figure black


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


@styled
def histogram(table: PoseTable) -> Plot:
    """Number of poses over the size of their error, before and after."""
    figure, (axes,) = new_figure(1, 1, (8.9, 3.1))
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
    plain_ticks(axes.xaxis)
    axes.legend(loc="upper center")
    return finished(
        "histogram",
        "Error before and after",
        "The scale is logarithmic: one step to the left is ten times better.",
        figure,
    )


@styled
def error_by_pose(table: PoseTable) -> Plot:
    """Error of each pose in the order of measurement, one panel for each file; of several points the largest."""
    series = tuple(dict.fromkeys(table.series)) or ("",)
    figure, panels = new_figure(len(series), 1, (8.9, 0.8 + 2.3 * len(series)), sharey=True)
    for axes, name in zip(panels, series, strict=True):
        _draw_course(axes, table, np.array([entry == name for entry in table.series], dtype=bool))
        if len(series) > 1:
            axes.set_title(shortened(Path(name).name), loc="left")
    entries = [zip(*axes.get_legend_handles_labels(), strict=True) for axes in panels]
    marks = {label: mark for panel in entries for mark, label in panel}
    figure.legend(marks.values(), marks, loc="outside upper center", ncols=5)
    several = " Of several points, the largest error is drawn." if len(set(table.targets)) > 1 else ""
    return finished(
        "error-by-pose",
        "Error of each pose, in the order of measurement",
        "Steps or slopes show that something changed while measuring." + several,
        figure,
    )


def _draw_course(axes: Any, table: PoseTable, rows: BoolArray) -> None:
    """Draw the errors of one series over the places of its poses: a line for each state, a mark for each group."""
    from matplotlib.ticker import FuncFormatter, MaxNLocator

    places, first = np.unique(table.place[rows], return_index=True)
    chosen = np.flatnonzero(rows)
    names = {int(place): table.labels[chosen[k]] for place, k in zip(places, first, strict=True)}
    group = np.array([table.group[chosen[k]] for k in first])
    outlier = np.isin(places, table.place[rows & table.outlier])
    for state, (colour, line) in STATES.items():
        lengths = np.full(len(places), -np.inf)
        np.maximum.at(
            lengths, np.searchsorted(places, table.place[rows]), 1e3 * np.linalg.norm(table.error(state)[rows], axis=1)
        )
        lengths = np.where(lengths > 0, lengths, np.nan)
        axes.plot(places, lengths, line, color=colour, linewidth=0.7, alpha=0.6, label=f"{state} calibration")
        for name, (mark, face) in _GROUP_MARKS.items():
            here = np.flatnonzero(group == name)
            here = here[_thinned(len(here))[0]]
            if len(here):
                axes.plot(
                    places[here],
                    lengths[here],
                    mark,
                    color=colour,
                    markerfacecolor=face or colour,
                    markersize=3.6,
                    markeredgewidth=0.8,
                    label=name if state == "after" else None,
                )
        if state == "after" and np.any(outlier):
            axes.plot(places[outlier], lengths[outlier], "kx", markersize=7, label="outlier")
    axes.set(yscale="log", xlabel="pose, in the order of measurement", ylabel="error [mm]")
    plain_ticks(axes.yaxis)
    axes.xaxis.set_major_locator(MaxNLocator(10, integer=True))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda place, _: shortened(names.get(round(place), ""), 10)))
    axes.margins(x=0.01)


@styled
def error_by_axis(table: PoseTable) -> Plot:
    """Signed error components, before and after."""
    figure, panels = new_figure(1, 2, (8.9, 2.7))
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
    return finished(
        "error-by-axis",
        "Error along each axis",
        "Boxes hold the middle half of the poses; a box away from zero is a systematic error. Mind the two scales.",
        figure,
    )


@styled
def residual_by_joint(table: PoseTable, joints: tuple[Joint, ...]) -> Plot:
    """Residuals after calibration against every actuated joint."""
    columns = min(3, max(1, len(joints)))
    rows = -(-len(joints) // columns)
    figure, panels = new_figure(rows, columns, (8.9, 2.3 * rows + 0.4), sharey=True)
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
        axes.set_xlabel(_in_lines(f"{joint.name} [{joint.unit}]"))
        if number % columns == 0:
            axes.set_ylabel("residual [mm]")
    for axes in panels[len(joints) :]:
        axes.set_visible(False)
    if joints:
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=3, markerscale=2.5)
    return finished(
        "residual-by-joint",
        "Residuals against each joint",
        "A curve instead of a cloud points at an error of that joint that no parameter describes." + note,
        figure,
    )


@styled
def normal_plot(table: PoseTable) -> Plot:
    """Sorted residuals over sigma against normal quantiles, fitted poses only."""
    figure, (axes,) = new_figure(1, 1, (5.2, 4.0))
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
    return finished(
        "normal-plot",
        "Residuals against normal noise",
        "On the line they are noise; ends that bend away are outliers or something the model lacks." + note,
        figure,
    )


def shortened(name: str, longest: int = 60) -> str:
    """Return a name with its middle left out where it is too long for its place."""
    if len(name) <= longest:
        return name
    return f"{name[: longest // 2]}…{name[len(name) - (longest - longest // 2 - 1) :]}"


def _in_lines(label: str) -> str:
    """Return a label as one or two lines that fit under a panel."""
    if len(label) <= _WIDEST_LABEL:
        return label
    text = shortened(label, 2 * _WIDEST_LABEL - 8)
    cut = max(text.rfind(mark, 8, _WIDEST_LABEL) for mark in " _") + 1 or _WIDEST_LABEL
    return f"{text[:cut].rstrip()}\n{text[cut:]}"


def _lengths(table: PoseTable, state: str) -> FloatArray:
    lengths = 1e3 * np.linalg.norm(table.error(state), axis=1)
    known: FloatArray = lengths[np.isfinite(lengths)]
    return known


def _thinned(count: int) -> tuple[slice, str]:
    """Which of `count` marks to draw, and what the caption says about the others."""
    step = max(1, -(-count // _MOST_MARKS))
    return slice(None, None, step), "" if step == 1 else f" Of {count} marks, one in {step} is drawn."
