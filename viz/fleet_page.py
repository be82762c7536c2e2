"""Robots of one model as one page: who is unlike the others, and parameters of all robots side by side."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np

from calib.base.version import PROGRAM
from calib.reporting.fleet import Fleet
from viz.report_page import page_environment
from viz.svg import AXES, GREY, ORANGE, Plot, finished, new_figure, plain_ticks, shortened, styled
from viz.viewer_page import Page

_SHOWN = 60  # parameters in the figure
_MARKS = "os^v<>Dph*"


def fleet_page(found: Fleet, *, command: str = "", created: datetime | None = None) -> Page:
    """Return the page of a fleet.

    Args:
        found: The fleet.
        command: Command line that made it.
        created: Time to print; now if not given.
    """
    when = created if created is not None else datetime.now(UTC)
    scale = np.array([one.per_si for one in found.parameters])
    shown = {"values": found.values * scale, "stds": found.stds * scale}
    learned = {"offset": (found.mean - found.nominal) * scale, "mean_std": found.mean_std * scale}
    return Page(
        page_environment()
        .get_template("fleet.html")
        .render(
            found=found,
            plots=[side_by_side(found)],
            spread=found.spread * scale,
            program=PROGRAM,
            command=command,
            created=when.strftime("%Y-%m-%d %H:%M UTC"),
            **shown,
            **learned,
        )
    )


@styled
def side_by_side(found: Fleet) -> Plot:
    """Each parameter of each robot, from the mean of the fleet, in its spreads."""
    away = (found.values - found.mean) / found.spread
    reach = found.stds / found.spread
    order = np.argsort(-np.max(np.abs(away), axis=0))[:_SHOWN]
    figure, (axes,) = new_figure(1, 1, (8.9, 1.2 + 0.24 * len(order)))
    blue = AXES["z"][0]
    for k, one in enumerate(found.members):
        places = np.arange(len(order)) + 0.7 * ((k + 0.5) / len(found.members) - 0.5)
        axes.errorbar(
            away[k, order],
            places,
            xerr=reach[k, order],
            fmt=_MARKS[k % len(_MARKS)],
            color=ORANGE if one.odd else blue,
            markersize=4,
            linewidth=0.7,
            label=shortened(one.name, 40) + (" (unlike)" if one.odd else ""),
        )
    axes.axvspan(-2.0, 2.0, color=GREY, alpha=0.15, linewidth=0)
    axes.axvline(0.0, color="black", linewidth=0.8)
    axes.set_xscale("symlog", linthresh=4.0)
    plain_ticks(axes.xaxis)
    axes.set_yticks(range(len(order)), [shortened(found.parameters[k].name, 30) for k in order])
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
