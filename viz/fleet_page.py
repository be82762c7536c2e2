"""Robots of one model as one page: robots unlike the others, and the parameters of all robots side by side."""

from __future__ import annotations

import numpy as np

from calib.fleets.fleet import Fleet
from viz.charts import MANY, Chart, Charts
from viz.page_parts import places
from viz.report_page import printed_page
from viz.result_charts import forest
from viz.viewer_page import ViewerPage

_SHOWN = 60  # parameters in the figure


def fleet_page(fleet: Fleet, *, command: str = "") -> ViewerPage:
    """Return the page of a fleet, made by a command line."""
    scale = np.array([parameter.per_si for parameter in fleet.parameters])
    return printed_page(
        "fleet.html",
        Charts(places(robots=side_by_side(fleet))),
        command,
        fleet=fleet,
        conclusion=fleet.conclusion(),
        notes=fleet.notes,
        values=fleet.values * scale,
        stds=fleet.stds * scale,
        offset=(fleet.mean - fleet.nominal) * scale,
        mean_std=fleet.mean_std * scale,
        spread=fleet.spread * scale,
    )


def side_by_side(fleet: Fleet) -> Chart:
    """Distance of each parameter of each robot from the fleet's mean, in spreads of the fleet."""
    away, reach = (fleet.values - fleet.mean) / fleet.spread, 1.96 * fleet.stds / fleet.spread
    order = np.argsort(-np.max(np.abs(away), axis=0))[:_SHOWN]
    names = [fleet.parameters[k].name for k in order]
    groups = []
    for k, member in enumerate(fleet.members):
        called = member.name + (" (unlike)" if member.is_unlike else "")
        texts = [f"{called}, {name}: {value:+.2f} spreads" for name, value in zip(names, away[k, order], strict=True)]
        groups.append((called, MANY[k % len(MANY)], away[k, order], reach[k, order], texts))
    drawn = forest(names, groups, "difference to the mean [spreads of the robots]", ("", 2.0))
    return Chart(
        "side-by-side",
        "Robots side by side",
        "One mark for each robot, with its 95 % interval; parameters in which some robot is furthest off come first."
        " The grey band is where 95 % of robots like these are expected. A click in the legend hides a robot.",
        drawn,
        440,
    )
