"""Robots of one model as one page: who is unlike the others, and parameters of all robots side by side."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np

from calib.core.base.version import PROGRAM
from calib.fleets.fleet import Fleet
from viz.report_page import page_environment
from viz.svg import AXES, GREY, LONGEST_ENTRY, ORANGE, Plot, finished, new_figure, plain_ticks, shortened, styled
from viz.viewer_page import Page

_SHOWN = 60  # parameters in the figure
_MARKS = "os^v<>Dph*"


def fleet_page(fleet: Fleet, *, command: str = "") -> Page:
    """Return the page of a fleet.

    Args:
        fleet: The fleet.
        command: Command line that made it.
    """
    scale = np.array([parameter.per_si for parameter in fleet.parameters])
    shown = {"values": fleet.values * scale, "stds": fleet.stds * scale}
    learned = {"offset": (fleet.mean - fleet.nominal) * scale, "mean_std": fleet.mean_std * scale}
    return Page(
        page_environment()
        .get_template("fleet.html")
        .render(
            fleet=fleet,
            conclusion=fleet.conclusion(),
            notes=fleet.notes,
            plots=[side_by_side(fleet)],
            spread=fleet.spread * scale,
            program=PROGRAM,
            command=command,
            created=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
            **shown,
            **learned,
        )
    )


@styled
def side_by_side(fleet: Fleet) -> Plot:
    """Each parameter of each robot, from the mean of the fleet, in its spreads."""
    away = (fleet.values - fleet.mean) / fleet.spread
    reach = fleet.stds / fleet.spread
    order = np.argsort(-np.max(np.abs(away), axis=0))[:_SHOWN]
    figure, (axes,) = new_figure(1, 1, (8.9, 1.2 + 0.24 * len(order)))
    blue = AXES["z"][0]
    for k, member in enumerate(fleet.members):
        places = np.arange(len(order)) + 0.7 * ((k + 0.5) / len(fleet.members) - 0.5)
        axes.errorbar(
            away[k, order],
            places,
            xerr=reach[k, order],
            fmt=_MARKS[k % len(_MARKS)],
            color=ORANGE if member.odd else blue,
            markersize=4,
            linewidth=0.7,
            label=shortened(member.name, LONGEST_ENTRY) + (" (unlike)" if member.odd else ""),
        )
    axes.axvspan(-2.0, 2.0, color=GREY, alpha=0.15, linewidth=0)
    axes.axvline(0.0, color="black", linewidth=0.8)
    axes.set_xscale("symlog", linthresh=4.0)
    plain_ticks(axes.xaxis)
    axes.set_yticks(range(len(order)), [shortened(fleet.parameters[k].name, 30) for k in order])
    axes.set_ylim(len(order) - 0.4, -0.6)
    axes.set_xlabel("difference to the mean of the fleet, in spreads from robot to robot")
    figure.legend(loc="upper center", ncols=3)
    return finished(
        "side-by-side",
        "Robots side by side",
        "One mark for each robot, with its standard deviation; parameters in which some robot is furthest off come"
        " first. The grey band is where 95 % of robots like these are expected. Orange: unlike the others."
        " The scale is linear to 4 and logarithmic beyond.",
        figure,
    )
