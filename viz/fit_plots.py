"""Figures of a fit for notebooks and papers, drawn into matplotlib axes in the present style."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from calib import Fit
from calib.core.base.errors import InputError, nearest
from viz.plots import draw_course, draw_histogram, draw_normal, draw_residuals
from viz.pose_sources import from_fit
from viz.poses import PoseTable
from viz.scene import joints_of
from viz.svg import BLUE, GREY


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
        drawn = _axes(axes)
        draw_histogram(drawn, self._table())
        drawn.legend()
        return drawn

    def by_pose(self, axes: Axes | None = None) -> Axes:
        """Draw the error of each pose in the order of measurement."""
        drawn, table = _axes(axes), self._table()
        draw_course(drawn, table, np.ones(len(table), dtype=bool))
        drawn.legend()
        return drawn

    def residuals(self, joint: str | None = None, axes: Axes | None = None) -> Axes:
        """Draw the components of residuals against a joint; default: the first joint.

        Raises:
            InputError: There is no such joint.
        """
        names = self._fit.robot.joint_names
        joint = names[0] if joint is None else joint
        if joint not in names:
            raise InputError(f"no joint '{joint}'{nearest(joint, names)}")
        drawn, number, table = _axes(axes), names.index(joint), self._table()
        draw_residuals(drawn, table, joints_of(self._fit.robot)[number], number)
        drawn.set_ylabel("residual [mm]")
        drawn.legend()
        return drawn

    def normal(self, axes: Axes | None = None) -> Axes:
        """Draw sorted residuals over sigma against normal quantiles."""
        drawn = _axes(axes)
        draw_normal(drawn, self._table())
        return drawn

    def parameters(self, axes: Axes | None = None) -> Axes:
        """Draw the change of every free parameter of the robot with its 95 % interval, in sigmas of its prior.

        Poses of base and targets are left out, since they are not the robot's.
        """
        fit = self._fit
        shown = [p for p in fit.nominal.parameters if p.name in fit.free_names and not p.placement]
        estimates, sigma = [fit.parameters[p.name] for p in shown], np.array([p.sigma for p in shown])
        drawn = _axes(axes, height=1.0 + 0.15 * len(shown))
        change = np.array([estimate.value - estimate.nominal for estimate in estimates]) / sigma
        half = np.array([estimate.high95 - estimate.value for estimate in estimates]) / sigma
        place = np.arange(len(estimates))
        drawn.axvline(0.0, color=GREY, linewidth=0.8)
        drawn.errorbar(change, place, xerr=half, fmt="o", color=BLUE, markersize=3, linewidth=1)
        drawn.set_yticks(place, [estimate.name for estimate in estimates], fontsize=6)
        drawn.invert_yaxis()
        drawn.set_xlabel("change [sigma of the prior], with 95 % interval")
        return drawn

    def _table(self) -> PoseTable:
        table = from_fit(self._fit)
        known = np.flatnonzero(np.isfinite(table.error("after")).all(axis=1))
        if not len(known):
            raise InputError("no instrument measured points, so there are no errors of points to draw")
        return table.subset(known)


def _axes(axes: Any, height: float = 4.8) -> Axes:
    """Axes to draw into; a new figure comes from pyplot, so that a notebook shows it."""
    if axes is not None and not isinstance(axes, Axes):
        raise InputError(f"axes: expected matplotlib axes, not {type(axes).__name__}")
    if axes is None:
        from matplotlib import pyplot

        return pyplot.subplots(figsize=(6.4, max(height, 2.0)), layout="constrained")[1]
    return axes
