"""Figures of measured points for notebooks and papers, readable without colours."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy

from calib.core.base.arrays import BoolArray
from calib.core.base.units import PER_SI
from viz.poses import IDENTIFICATION, VALIDATION, PoseTable
from viz.scene import ViewerJoint
from viz.svg import AXES, STATES, plain_ticks

_MM = PER_SI["length"]["mm"]
_GROUP_MARKS = {IDENTIFICATION: ("o", None), VALIDATION: ("D", "white")}  # as in the viewer; None: filled in colour
_STILL = 0.01  # a joint did not move if its range is less [deg, mm]


def draw_histogram(axes: Any, table: PoseTable) -> None:
    """Draw the histogram of errors, before and after."""
    from matplotlib.ticker import MaxNLocator

    lengths = {state: _MM * np.linalg.norm(table.error(state), axis=1) for state in STATES}
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
    axes.yaxis.set_major_locator(MaxNLocator(6, integer=True))


def draw_residuals(axes: Any, table: PoseTable, joint: ViewerJoint, number: int) -> None:
    """Draw residuals after calibration against the actuated joint with this index."""
    values = joint.per_si * table.joints[:, number]
    for order, (name, component) in enumerate(zip(AXES, (_MM * table.error("after")).T, strict=True)):
        colour, marker = AXES[name]
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
            zorder=2 + order,
        )
    axes.axhline(0.0, color="black", linewidth=0.8)
    if len(values) and np.ptp(values) < _STILL:
        axes.set_xlim(np.mean(values) - 0.5, np.mean(values) + 0.5)
    axes.set_xlabel(f"{joint.name} [{joint.unit}]")


def draw_course(axes: Any, table: PoseTable, rows: BoolArray) -> None:
    """Draw the errors of a series over its poses: a line for each state, a mark for each group.

    Args:
        axes: Axes to draw into.
        table: The poses.
        rows: Rows of the series, (n,).
    """
    from matplotlib.ticker import FuncFormatter, MaxNLocator

    places, first = np.unique(table.place[rows], return_index=True)
    chosen = np.flatnonzero(rows)
    names = {int(place): table.labels[chosen[k]] for place, k in zip(places, first, strict=True)}
    group = np.array([table.group[chosen[k]] for k in first])
    outlier = np.isin(places, table.place[rows & table.outlier])
    for state, (colour, line) in STATES.items():
        lengths = np.full(len(places), -np.inf)
        sizes = _MM * np.linalg.norm(table.error(state)[rows], axis=1)
        np.fmax.at(lengths, np.searchsorted(places, table.place[rows]), sizes)
        lengths = np.where(lengths > 0, lengths, np.nan)
        axes.plot(places, lengths, line, color=colour, linewidth=0.7, alpha=0.6, label=f"{state} calibration")
        for name, (mark, face) in _GROUP_MARKS.items():
            of_group = np.flatnonzero(group == name)
            if len(of_group):
                axes.plot(
                    places[of_group],
                    lengths[of_group],
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
    axes.xaxis.set_major_formatter(FuncFormatter(lambda place, _: names.get(round(place), "")[:10]))
    axes.margins(x=0.01)


def draw_normal(axes: Any, table: PoseTable) -> None:
    """Draw sorted residuals over sigma against normal quantiles."""
    chosen = np.array([group == IDENTIFICATION for group in table.group], dtype=bool)
    ratio = table.normalised_residuals()[chosen if np.any(chosen) else slice(None)]
    reach = 1.0
    for (name, (colour, marker)), values in zip(AXES.items(), ratio.T, strict=True):
        known = np.sort(values[np.isfinite(values)])
        if not len(known):
            continue
        quantiles = scipy.special.ndtri((np.arange(len(known)) + 0.5) / len(known))
        axes.plot(
            quantiles,
            known,
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
