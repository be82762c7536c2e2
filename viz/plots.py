"""The report's figures: each answers one question about the errors, and can be read without colour vision."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import scipy

from calib import Robot
from calib.core.base.arrays import BoolArray
from calib.core.base.units import ERROR_UNIT, PER_SI, error_scale
from calib.core.base.words import counted
from calib.core.fitting.error_sets import ErrorSet
from viz.part_plots import error_by_axis, histogram, of_positions, residual_by_joint
from viz.poses import IDENTIFICATION, VALIDATION, PoseTable
from viz.scene import Joint
from viz.svg import AXES, STATES, Plot, finished, new_figure, plain_ticks, shortened, styled, thinned

_MM = PER_SI["length"]["mm"]
_GROUP_MARKS = {IDENTIFICATION: ("o", None), VALIDATION: ("D", "white")}  # as in the viewer; face, if not the colour


def all_plots(table: PoseTable, joints: tuple[Joint, ...]) -> tuple[Plot, ...]:
    """Return the figures of measured points; none where no errors of points are known.

    Args:
        table: Poses with errors before and after.
        joints: Actuated joints, in the order of the table's columns.
    """
    known = [np.isfinite(table.error(state)).all(axis=1) for state in STATES]
    table = table.subset(np.any(known, axis=0))
    if not len(table):
        return ()
    errors = of_positions(table)
    return (
        histogram(errors),
        error_by_pose(table),
        error_by_axis(errors),
        residual_by_joint(errors, joints),
        normal_plot(table),
    )


@styled
def budget_bars(budget: dict[str, Any]) -> Plot:
    """How much of the error before each cause made, of `calib.core.results.sections.budget.budget_table`."""
    rows, unit = budget["causes"], budget["unit"]
    largest = max(budget["rms_before"], 1e-12)
    figure, (axes,) = new_figure(1, 1, (8.9, 0.9 + 0.32 * len(rows)))
    shown = np.nan_to_num([row["rms"] for row in rows])
    high = np.sqrt(np.maximum([row["mean_square"] + np.nan_to_num(row["std"]) for row in rows], 0.0))
    axes.barh(range(len(rows)), shown, color=STATES["after"][0], alpha=0.6)
    axes.errorbar(shown, range(len(rows)), xerr=[0 * shown, np.maximum(high - shown, 0.0)], fmt="none", ecolor="black")
    floor = max(min((size for size in shown if size > 0), default=largest) / 3, largest / 1e5)
    axes.set(xscale="log", xlim=(floor, 1.5 * largest), xlabel=f"root mean square [{unit}]")
    axes.set_yticks(range(len(rows)), [row["cause"] for row in rows])
    axes.invert_yaxis()
    plain_ticks(axes.xaxis)
    return finished(
        "error-budget",
        "Causes of the error before calibration",
        f"The squares of all bars add up to the square of {budget['rms_before']:.3g} {unit}. The scale is logarithmic."
        " A line ends one standard deviation beyond its bar. A cause without a bar contributed nothing.",
        figure,
    )


@styled
def error_by_pose(table: PoseTable) -> Plot:
    """Error of each pose in the order of measurement, one panel for each file; of several points the largest."""
    series = tuple(dict.fromkeys(table.series)) or ("",)
    figure, panels = new_figure(len(series), 1, (8.9, 0.8 + 1.8 * len(series)), sharey=True)
    for axes, name in zip(panels, series, strict=True):
        draw_course(axes, table, np.array([entry == name for entry in table.series], dtype=bool))
        if len(series) > 1:
            axes.set_title(shortened(Path(name).name), loc="left")
    entries = [zip(*axes.get_legend_handles_labels(), strict=True) for axes in panels]
    marks = {label: mark for panel in entries for mark, label in panel}
    figure.legend(marks.values(), marks, loc="upper center", ncols=5)
    several = " Of several points, the largest error is drawn." if len(set(table.targets)) > 1 else ""
    return finished(
        "error-by-pose",
        "Error of each pose, in the order of measurement",
        "Steps or slopes show that something changed while measuring." + several,
        figure,
    )


def draw_course(axes: Any, table: PoseTable, rows: BoolArray) -> None:
    """Draw the errors of one series over the places of its poses: a line for each state, a mark for each group.

    Args:
        axes: Where to.
        table: The poses.
        rows: Those of the series, (n,).
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
            of_group = of_group[thinned(len(of_group))[0]]
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
    axes.xaxis.set_major_formatter(FuncFormatter(lambda place, _: shortened(names.get(round(place), ""), 10)))
    axes.margins(x=0.01)


@styled
def error_map(errors: ErrorSet, robot: Robot) -> Plot:
    """Errors after calibration where the robot was, from above and from the side, in the unit of what was read.

    Args:
        errors: Errors of a set of visits.
        robot: The calibrated robot; its first target says where it was.
    """
    data, part = errors.data, errors.main_part
    squares = np.full(len(data), -np.inf)
    for instrument, its_part, rows in errors.parts():
        if its_part.name == part.name:  # of several readings of a visit the largest
            own_squares = np.square(errors.after[instrument.name][:, rows])
            was_read = np.isfinite(own_squares).any(axis=1)
            np.maximum.at(
                squares, data.readings[instrument.name].visits[was_read], np.nansum(own_squares[was_read], axis=1)
            )
    visits = np.flatnonzero(np.isfinite(squares))  # where the part was read
    count = len(np.unique(data.pose_numbers[visits]))
    shown, note = thinned(len(visits))
    visits = visits[shown]
    visits = visits[np.argsort(squares[visits], kind="stable")]  # the largest on top of what is at the same place
    size = error_scale(part.dimension) * np.sqrt(squares[visits])
    places = _MM * robot.positions(data.joints, data.conditions)[visits, 0]
    figure, panels = new_figure(1, 2, (8.9, 3.1))
    figure.subplots_adjust(left=0.08, right=0.87, bottom=0.17, top=0.91, wspace=0.25)
    for axes, (across, up), view in zip(panels, (("x", "y"), ("x", "z")), ("from above", "from the side"), strict=True):
        points = axes.scatter(
            places[:, "xyz".index(across)],
            places[:, "xyz".index(up)],
            c=size,
            cmap="viridis",
            vmin=0.0,
            vmax=max(float(size.max()), 1e-9),
            s=30,
            linewidths=0.4,
            edgecolors="black",
        )
        axes.set(xlabel=f"{across} [mm]", ylabel=f"{up} [mm]", title=view)
        axes.set_aspect("equal", adjustable="datalim")
        axes.locator_params(nbins=6)
    bar = figure.colorbar(points, cax=figure.add_axes((0.885, 0.17, 0.015, 0.74)))
    bar.set_label(f"{part.name} error after [{ERROR_UNIT[part.dimension]}]")
    return finished(
        "error-map",
        "Errors over the workspace",
        f"Error after calibration at {counted(count, 'pose')}; a point is where {robot.target_names[0]} was." + note,
        figure,
    )


@styled
def normal_plot(table: PoseTable) -> Plot:
    """Sorted residuals over sigma against normal quantiles, fitted poses only."""
    figure, (axes,) = new_figure(1, 1, (4.6, 2.9))
    note = draw_normal(axes, table)
    return finished(
        "normal-plot",
        "Residuals against normal noise",
        "On the line they are noise; ends that bend away are outliers or something the model lacks." + note,
        figure,
    )


def draw_normal(axes: Any, table: PoseTable) -> str:
    """Draw sorted residuals over sigma against normal quantiles; return what the caption says about left-out marks."""
    chosen = np.array([group == IDENTIFICATION for group in table.group], dtype=bool)
    ratio = table.over_sigma()[chosen if np.any(chosen) else slice(None)]
    reach = 1.0
    note = ""
    for (name, (colour, marker)), values in zip(AXES.items(), ratio.T, strict=True):
        known = np.sort(values[np.isfinite(values)])
        if not len(known):
            continue
        quantiles = scipy.special.ndtri((np.arange(len(known)) + 0.5) / len(known))
        shown, note = thinned(len(known))
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
    return note
