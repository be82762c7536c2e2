"""Results side by side as one page, and robots of one model: significant differences, parameters, errors."""

from __future__ import annotations

from datetime import datetime
from typing import Any

import numpy as np

from calib.fleets.comparison_report import Difference, ResultComparison, p_text
from calib.fleets.fleet import Fleet
from viz.charts import MANY, Chart, Charts, axis, layer, panel
from viz.page_parts import places
from viz.report_page import printed_page
from viz.result_charts import forest
from viz.viewer_page import ViewerPage

_SHOWN, _SHOWN_OF_FLEET = 24, 60  # parameters in a figure
_REAL = ": a real difference"


def comparison_page(comparison: ResultComparison, *, command: str = "", created: datetime | None = None) -> ViewerPage:
    """Return the page of a comparison, made by a command line; `created` is printed (default: now)."""
    ranked = comparison.rank_differences()
    rest = [difference for difference in comparison.differences if difference not in ranked]
    same_rows = errors_on_same_rows(comparison) if len(comparison.results[0].sizes) else None
    charts = Charts(places(same_rows=same_rows, intervals=intervals(comparison, ranked)))
    return printed_page(
        "comparison.html",
        charts,
        command,
        created,
        comparison=comparison,
        conclusion=comparison.conclusion(),
        notes=comparison.notes,
        lines=[_line(difference) for difference in [*ranked, *rest]],
    )


def _line(difference: Difference) -> dict[str, object]:
    return {
        "name": difference.name,
        "unit": next(str(row["unit"]) for row in difference.rows if row is not None),
        "rows": tuple(None if row is None else {**row, **_half(row)} for row in difference.rows),
        "p_values": ", ".join(map(p_text, difference.p_values)),
        "real": (False, *difference.real),
    }


def _half(row: dict[str, Any]) -> dict[str, float]:
    """Value and half of its interval as numbers; NaN where unknown."""
    value, high, std = (np.nan if row[key] is None else float(row[key]) for key in ("value", "high95", "std"))
    return {"value": value, "half": high - value, "std": std}


def errors_on_same_rows(comparison: ResultComparison) -> Chart:
    """Share of readings whose error is below a size, for each result."""
    layers = []
    for k, result in enumerate(comparison.results):
        name, sizes = result.name, np.sort(result.sizes)
        part = 100 * (np.arange(len(sizes)) + 1) / len(sizes)
        texts = [
            f"{name}: {share:.3g} % are below {size:.3g} {result.unit}" for share, size in zip(part, sizes, strict=True)
        ]
        layers.append(layer("points", name, MANY[k % len(MANY)], x=sizes, y=part, texts=texts))
    x = axis(f"error after calibration [{result.unit}]", log=True)
    return Chart(
        "same-rows",
        "Errors on the same readings",
        f"{len(result.sizes)} readings that no result used: the further to the left, the better.",
        (panel(x, axis("smaller in [% of readings]"), layers),),
        500,
    )


def intervals(comparison: ResultComparison, ranked: list[Difference]) -> Chart | None:
    """Differences from the first result in half widths of its 95 % intervals; None without intervals."""
    known = [d for d in ranked if all(row is not None and row["high95"] is not None for row in d.rows)]
    known = ([d for d in known if not d.is_place] or known)[:_SHOWN]  # a base put elsewhere would hide all others
    if not known:
        return None
    halves = np.array(
        [[_half(row)[key] for key in ("value", "half")] for d in known for row in d.rows if row is not None]
    )
    values, half = halves.reshape(len(known), -1, 2).transpose(2, 1, 0)  # (n_results, n_shown)
    width = np.maximum(half[0], 1e-300)
    groups = []
    for k, name in enumerate(comparison.names):
        real = [k > 0 and d.real[k - 1] for d in known]
        texts = [
            f"{d.name}, {name}: {value:.6g} ± {reach:.2g} {(d.rows[k] or {})['unit']}{_REAL * is_real}"
            for d, value, reach, is_real in zip(known, values[k], half[k], real, strict=True)
        ]
        groups.append((name, MANY[k % len(MANY)], (values[k] - values[0]) / width, half[k] / width, texts))
    marked = f"* marks a real difference to {comparison.names[0]}. " if comparison.tested_pairs() else ""
    names = [f"{d.name}{' *' if any(d.real) else ''}" for d in known]
    return Chart(
        "intervals",
        "Differences of parameters",
        f"{marked}Overlapping intervals alone decide nothing.",
        forest(names, groups, "difference to the first result [half widths of its 95 % interval]"),
        500,
    )


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
    order = np.argsort(-np.max(np.abs(away), axis=0))[:_SHOWN_OF_FLEET]
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
