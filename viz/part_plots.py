"""Figures of the components of errors, of positions and of every other part of readings, each in its unit of errors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from calib import Fit
from calib.core.base.arrays import FloatArray, ReadOnlyArrays
from calib.core.base.units import ERROR_UNIT, error_scale
from calib.core.fitting.error_sets import ErrorSet
from calib.core.instruments.kind import Part
from calib.core.instruments.position import POSITION
from viz.poses import PoseTable
from viz.scene import Joint
from viz.svg import AXES, STATES, Plot, finished, in_lines, new_figure, plain_ticks, styled, thinned

_BOX = 0.55  # height of a box, of the distance between two
_STANDS = 0.01  # range of a joint [deg, mm] below which it did not move


@dataclass(frozen=True, eq=False)
class PartErrors(ReadOnlyArrays):
    """Errors of one part of readings.

    Attributes:
        part: The part.
        joints: Actuated joints, (n, n_actuated) [m or rad].
        before, after: Predicted minus read, before and after calibration, (n, n_axes) [SI]; NaN where not known.
    """

    part: Part
    joints: FloatArray
    before: FloatArray
    after: FloatArray

    def shown(self, state: str) -> FloatArray:
        """Return the errors of a state in the part's unit of errors, (n, n_axes)."""
        errors: FloatArray = error_scale(self.part.dimension) * {"before": self.before, "after": self.after}[state]
        return errors

    @property
    def unit(self) -> str:
        """Unit of errors."""
        return ERROR_UNIT[self.part.dimension]

    def called(self, name: str, title: str) -> tuple[str, str]:
        """Return name and title of a figure: those of positions need not say of what they are."""
        if self.part.is_position:
            return name, title
        return f"{self.part.name}-{name}", f"{self.part.name.capitalize()}: {title[0].lower()}{title[1:]}"

    def lengths(self, state: str) -> FloatArray:
        """Return how large the errors of a state are, of those that are known, in the part's unit, (n_known,)."""
        errors = self.shown(state)
        return np.sqrt(np.nansum(errors[np.isfinite(errors).any(axis=1)] ** 2, axis=1))


def of_positions(table: PoseTable) -> PartErrors:
    """Return the errors of measured points."""
    return PartErrors(POSITION, table.joints, table.error("before"), table.error("after"))


def part_plots(fit: Fit, joints: tuple[Joint, ...]) -> tuple[Plot, ...]:
    """Return the figures of all parts that a fit was made from, but positions.

    Args:
        fit: The fit.
        joints: Its actuated joints.
    """
    sets = [fit.identification, *([] if fit.validation is None else [fit.validation])]
    parts = dict.fromkeys(part for error_set in sets for _, part, _ in error_set.parts() if not part.is_position)
    plots: list[Plot] = []
    for part in parts:
        errors = _of_part(sets, part)
        plots += [histogram(errors), error_by_axis(errors), residual_by_joint(errors, joints)]
    return tuple(plots)


def _of_part(sets: list[ErrorSet], part: Part) -> PartErrors:
    pieces = [
        (
            errors.data.joints[errors.data.readings[instrument.name].visits],
            errors.before[instrument.name][:, rows],
            errors.after[instrument.name][:, rows],
        )
        for errors in sets
        for instrument, its_part, rows in errors.parts()
        if its_part == part
    ]
    joints, before, after = (np.concatenate(piece) for piece in zip(*pieces, strict=True))
    return PartErrors(part, joints, before, after)


@styled
def histogram(errors: PartErrors) -> Plot:
    """How many errors have which size, before and after."""
    figure, (axes,) = new_figure(1, 1, (8.9, 2.6))
    draw_histogram(axes, errors)
    figure.legend(loc="upper center", ncols=2)
    return finished(
        *errors.called("histogram", "Error before and after"),
        "The scale is logarithmic: one step to the left is ten times better.",
        figure,
    )


def draw_histogram(axes: Any, errors: PartErrors) -> None:
    """Draw how many errors have which size, before and after."""
    from matplotlib.ticker import MaxNLocator

    lengths = {state: errors.lengths(state) for state in STATES}
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
    is_position = errors.part.is_position
    off = "distance between predicted and measured position" if is_position else f"size of the {errors.part.name} error"
    axes.set(
        xscale="log", xlabel=f"{off} [{errors.unit}]", ylabel=f"number of {'poses' if is_position else 'readings'}"
    )
    plain_ticks(axes.xaxis)
    axes.yaxis.set_major_locator(MaxNLocator(6, integer=True))


@styled
def error_by_axis(errors: PartErrors) -> Plot:
    """Signed error components, before and after."""
    names = errors.part.axes
    figure, panels = new_figure(1, 2, (8.9, 1.2 + 0.5 * len(names)))
    for axes, state in zip(panels, STATES, strict=True):
        columns = [column[np.isfinite(column)] for column in errors.shown(state).T]
        known = [k for k, column in enumerate(columns) if len(column)]
        if known:
            _draw_boxes(axes, [columns[k] for k in known], np.array(known) + 1.0, [_look(k)[0] for k in known])
        axes.set_yticks(range(1, len(names) + 1), names if state == "before" else [""] * len(names))
        axes.axvline(0.0, color="black", linewidth=0.8)
        axes.invert_yaxis()
        axes.set(title=f"{state} calibration", xlabel=f"predicted minus measured [{errors.unit}]")
    return finished(
        *errors.called("error-by-axis", "Error along each axis"),
        "Boxes hold the middle half of the poses; a box away from zero is a systematic error. Mind the two scales.",
        figure,
    )


def _draw_boxes(axes: Any, columns: list[FloatArray], places: FloatArray, colours: list[str]) -> None:
    """Draw boxes as matplotlib's `boxplot` does, which imports all of pyplot.

    Args:
        axes: Where to.
        columns: The values of each box.
        places: Where each is, along the vertical axis.
        colours: Of the boxes.
    """
    from matplotlib.cbook import boxplot_stats

    told = boxplot_stats(columns)
    keys = ("q1", "med", "q3", "whislo", "whishi")
    low, middle, high, least, most = (np.array([box[key] for box in told]) for key in keys)
    for start, width, place, colour in zip(low, high - low, places, colours, strict=True):
        axes.broken_barh(
            [(start, width)], (place - _BOX / 2, _BOX), facecolor=colour, edgecolor="black", alpha=0.45, zorder=2
        )
    line = {"colors": "black", "linewidth": 1.0, "capstyle": "projecting", "zorder": 2}
    axes.hlines(np.tile(places, 2), np.concatenate([least, high]), np.concatenate([low, most]), **line)
    for ends, half in ((middle, _BOX / 2), (least, _BOX / 4), (most, _BOX / 4)):
        axes.vlines(ends, places - half, places + half, **line)
    others, of_others = np.concatenate([box["fliers"] for box in told]), [len(box["fliers"]) for box in told]
    axes.plot(others, np.repeat(places, of_others), ".", color="black", markersize=2.5, markerfacecolor="none")
    axes.set_ylim(min(places) - 0.5, max(places) + 0.5)


@styled
def residual_by_joint(errors: PartErrors, joints: tuple[Joint, ...]) -> Plot:
    """Residuals after calibration against every actuated joint."""
    columns = min(4 if len(joints) in (4, 7, 8) else 3, max(1, len(joints)))
    rows = -(-len(joints) // columns)
    figure, panels = new_figure(rows, columns, (8.9, 1.8 * rows + 0.4), sharey=True)
    note = thinned(len(errors.after))[1]
    for number, (axes, joint) in enumerate(zip(panels, joints, strict=False)):
        draw_residuals(axes, errors, joint, number)
        axes.locator_params(axis="x", nbins=4 if columns > 3 else 6)
        if number % columns == 0:
            axes.set_ylabel(f"residual [{errors.unit}]")
    for axes in panels[len(joints) :]:
        axes.set_visible(False)
    if joints:
        figure.legend(*panels[0].get_legend_handles_labels(), loc="upper center", ncols=3, markerscale=2.5)
    return finished(
        *errors.called("residual-by-joint", "Residuals against each joint"),
        "A curve instead of a cloud points at an error of that joint that no parameter describes." + note,
        figure,
    )


def draw_residuals(axes: Any, errors: PartErrors, joint: Joint, number: int) -> None:
    """Draw residuals after calibration against an actuated joint, of which this is the number."""
    drawn = thinned(len(errors.after))[0]
    values = joint.per_si * errors.joints[drawn, number]
    for axis, (name, component) in enumerate(zip(errors.part.axes, errors.shown("after")[drawn].T, strict=True)):
        colour, marker = _look(axis)
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
    if len(values) and np.ptp(values) < _STANDS:
        axes.set_xlim(np.mean(values) - 0.5, np.mean(values) + 0.5)
    axes.set_xlabel(in_lines(f"{joint.name} [{joint.unit}]"))


def _look(axis: int) -> tuple[str, str]:
    """Colour and mark of an axis by its number."""
    looks = list(AXES.values())
    return looks[axis % len(looks)]
