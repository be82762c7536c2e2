"""Figures of a fit for notebooks and papers, drawn into matplotlib axes in the present style."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy
from matplotlib.axes import Axes

from calib import Fit
from calib.core.base.arrays import FloatArray
from calib.core.base.errors import InputError, nearest
from calib.core.base.units import millimetres
from viz.pose_sources import from_fit
from viz.poses import IDENTIFICATION, VALIDATION, PoseTable
from viz.result_charts import relative_changes
from viz.scene import ViewerJoint, joints_of
from viz.svg import AXES, BLUE, GREY, STATES, plain_ticks

_GROUP_MARKS = {IDENTIFICATION: ("o", None), VALIDATION: ("D", "white")}  # as in the viewer; None: filled in colour
_STILL = 0.01  # a joint did not move if its range is less [deg, mm]


def draw_histogram(axes: Any, table: PoseTable) -> None:
    """Draw the histogram of errors, before and after."""
    from matplotlib.ticker import MaxNLocator

    lengths = {state: millimetres(np.linalg.norm(table.error(state), axis=1)) for state in STATES}
    everything = np.concatenate(list(lengths.values()))
    positive = everything[everything > 0]
    low, high = (float(positive.min()), float(positive.max())) if len(positive) else (1e-3, 1.0)
    bins = np.geomspace(low * 0.95, high * 1.05, 41).tolist()
    for state, (colour, line) in STATES.items():
        shown, label = np.maximum(lengths[state], low), f"{state} calibration"
        axes.hist(shown, bins=bins, histtype="stepfilled", alpha=0.25, color=colour)
        axes.hist(shown, bins=bins, histtype="step", color=colour, linestyle=line, linewidth=1.6, label=label)
    axes.set(xscale="log", xlabel="distance between predicted and measured position [mm]", ylabel="number of poses")
    plain_ticks(axes.xaxis)
    axes.yaxis.set_major_locator(MaxNLocator(6, integer=True))
    axes.legend()


def draw_residuals(axes: Any, table: PoseTable, joint: ViewerJoint, number: int) -> None:
    """Draw residuals after calibration against the actuated joint with this index."""
    values = joint.per_si * table.joints[:, number]
    for order, (name, component) in enumerate(zip(AXES, millimetres(table.error("after")).T, strict=True)):
        _draw_marks(axes, name, values, component, markersize=2.6, alpha=0.6, zorder=2 + order)
    axes.axhline(0.0, color="black", linewidth=0.8)
    if len(values) and np.ptp(values) < _STILL:
        axes.set_xlim(np.mean(values) - 0.5, np.mean(values) + 0.5)
    axes.set(xlabel=f"{joint.name} [{joint.unit}]", ylabel="residual [mm]")
    axes.legend()


def _draw_marks(axes: Any, name: str, x: FloatArray, y: FloatArray, **look: float) -> None:
    colour, marker = AXES[name]
    axes.plot(x, y, marker, color=colour, linestyle="none", markeredgewidth=0, label=name, **look)


def draw_course(axes: Any, table: PoseTable) -> None:
    """Draw the errors over the poses: a line for each state, a mark for each group."""
    from matplotlib.ticker import FuncFormatter, MaxNLocator

    places, first = np.unique(table.place, return_index=True)
    names = {int(place): table.labels[k] for place, k in zip(places, first, strict=True)}
    group = np.array([table.group[k] for k in first])
    outlier = np.isin(places, table.place[table.outlier])
    for state, (colour, line) in STATES.items():
        lengths = np.full(len(places), -np.inf)
        sizes = millimetres(np.linalg.norm(table.error(state), axis=1))
        np.fmax.at(lengths, np.searchsorted(places, table.place), sizes)
        lengths = np.where(lengths > 0, lengths, np.nan)
        axes.plot(places, lengths, line, color=colour, linewidth=0.7, alpha=0.6, label=f"{state} calibration")
        for name, (mark, face) in _GROUP_MARKS.items():
            own = group == name
            if np.any(own):
                label, face = name if state == "after" else None, face or colour
                look = {"color": colour, "markerfacecolor": face, "markersize": 3.6, "markeredgewidth": 0.8}
                axes.plot(places[own], lengths[own], mark, label=label, **look)
        if state == "after" and np.any(outlier):
            axes.plot(places[outlier], lengths[outlier], "kx", markersize=7, label="outlier")
    axes.set(yscale="log", xlabel="pose, in the order of measurement", ylabel="error [mm]")
    plain_ticks(axes.yaxis)
    axes.xaxis.set_major_locator(MaxNLocator(10, integer=True))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda place, _: names.get(round(place), "")[:10]))
    axes.margins(x=0.01)
    axes.legend()


def draw_normal(axes: Any, table: PoseTable) -> None:
    """Draw sorted residuals over sigma against normal quantiles."""
    chosen = np.array([group == IDENTIFICATION for group in table.group], dtype=bool)
    ratio = table.normalised_residuals()[chosen if np.any(chosen) else slice(None)]
    reach = 1.0
    for name, values in zip(AXES, ratio.T, strict=True):
        known = np.sort(values[np.isfinite(values)])
        if len(known):
            quantiles = scipy.special.ndtri((np.arange(len(known)) + 0.5) / len(known))
            _draw_marks(axes, name, quantiles, known, markersize=3.2, alpha=0.75)
            reach = max(reach, float(np.abs(quantiles).max()), float(np.abs(known).max()))
    axes.plot([-reach, reach], [-reach, reach], color="black", linewidth=0.9, label="normal")
    axes.set(xlabel="expected of normal noise [sigma]", ylabel="residual [sigma]")
    axes.legend(markerscale=1.6)


class FitPlots:
    """The figures of a fit; each method draws into `axes`, or into those of a new figure, and returns them.

    Raises:
        InputError: The fit has no errors of points, which these figures show.
    """

    def __init__(self, fit: Fit) -> None:
        self._fit = fit

    def __repr__(self) -> str:
        names = [name for name in vars(type(self)) if not name.startswith("_")]
        return f"<plots: {', '.join(names)}>"

    def __call__(self, axes: Axes | None = None) -> Axes:
        """Draw `errors`, the first figure to look at."""
        return self.errors(axes)

    def errors(self, axes: Axes | None = None) -> Axes:
        """Draw the distribution of the errors of points, before and after."""
        return self._draw(draw_histogram, axes)

    def by_pose(self, axes: Axes | None = None) -> Axes:
        """Draw the error of each pose in the order of measurement."""
        return self._draw(draw_course, axes)

    def residuals(self, joint: str | None = None, axes: Axes | None = None) -> Axes:
        """Draw the components of residuals against a joint; default: the first joint.

        Raises:
            InputError: There is no such joint.
        """
        names = self._fit.robot.joint_names
        joint = names[0] if joint is None else joint
        if joint not in names:
            raise InputError(f"no joint '{joint}'{nearest(joint, names)}")
        number = names.index(joint)
        return self._draw(draw_residuals, axes, joints_of(self._fit.robot)[number], number)

    def normal(self, axes: Axes | None = None) -> Axes:
        """Draw sorted residuals over sigma against normal quantiles."""
        return self._draw(draw_normal, axes)

    def parameters(self, axes: Axes | None = None) -> Axes:
        """Draw the change of every free parameter of the robot with its 95 % interval, in sigmas of its prior.

        Poses of base and targets are left out, since they are not the robot's.
        """
        estimates, change, half = relative_changes(self._fit)
        drawn = _axes(axes, height=1.0 + 0.15 * len(estimates))
        place = np.arange(len(estimates))
        drawn.axvline(0.0, color=GREY, linewidth=0.8)
        drawn.errorbar(change, place, xerr=half, fmt="o", color=BLUE, markersize=3, linewidth=1)
        drawn.set_yticks(place, [estimate.name for estimate in estimates], fontsize=6)
        drawn.invert_yaxis()
        drawn.set_xlabel("change [sigma of the prior], with 95 % interval")
        return drawn

    def _draw(self, draw: Callable[..., None], axes: Axes | None, *more: Any) -> Axes:
        """Draw all points whose errors are known."""
        drawn, table = _axes(axes), from_fit(self._fit)
        known = np.flatnonzero(np.isfinite(table.error("after")).all(axis=1))
        if not len(known):
            raise InputError("no instrument measured points, so there are no errors of points to draw")
        draw(drawn, table.subset(known), *more)
        return drawn


def _axes(axes: Any, height: float = 4.8) -> Axes:
    """Axes to draw into; a new figure comes from pyplot, so that a notebook shows it."""
    if axes is not None and not isinstance(axes, Axes):
        raise InputError(f"axes: expected matplotlib axes, not {type(axes).__name__}")
    if axes is None:
        from matplotlib import pyplot

        return pyplot.subplots(figsize=(6.4, max(height, 2.0)), layout="constrained")[1]
    return axes
