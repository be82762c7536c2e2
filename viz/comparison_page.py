"""Results side by side as one page: which differences are real, parameters with intervals, errors on the same rows."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np

from calib.core.base.version import PROGRAM
from calib.core.results.comparison_report import Difference, ResultComparison, p_text
from viz.report_page import page_environment
from viz.svg import AXES, GREY, LONGEST_ENTRY, ORANGE, Plot, finished, new_figure, plain_ticks, shortened, styled
from viz.viewer_page import Page

_SHOWN = 24  # parameters in the figure
_WIDTH = 4.0  # of figures [inch]: a phone's
_LINES = ("-", "--", ":", "-.")


@dataclass(frozen=True)
class Line:
    """One parameter of the table: name, unit, what each result says of it, p-values, and which differences are real."""

    name: str
    unit: str
    rows: tuple[dict[str, Any] | None, ...]
    p_values: str
    real: tuple[bool, ...]


def comparison_page(comparison: ResultComparison, *, command: str = "", created: datetime | None = None) -> Page:
    """Return the page of a comparison.

    Args:
        comparison: The comparison.
        command: Command line that made it.
        created: Time to print; now if not given.
    """
    ranked = comparison.ranked()
    rest = [difference for difference in comparison.differences if difference not in ranked]
    plots = [*([errors_on_same_rows(comparison)] if comparison.sizes else []), intervals(comparison, ranked)]
    when = created if created is not None else datetime.now(UTC)
    return Page(
        page_environment()
        .get_template("comparison.html")
        .render(
            comparison=comparison,
            conclusion=comparison.conclusion(),
            notes=comparison.notes,
            heads=zip(
                comparison.names,
                comparison.verdicts,
                comparison.n_poses,
                comparison.errors,
                comparison.errors_on,
                strict=True,
            ),
            lines=[_line(difference) for difference in [*ranked, *rest]],
            plots=[plot for plot in plots if plot is not None],
            program=PROGRAM,
            command=command,
            created=when.strftime("%Y-%m-%d %H:%M UTC"),
        )
    )


def _line(difference: Difference) -> Line:
    unit = next(str(row["unit"]) for row in difference.rows if row is not None)
    rows = tuple(None if row is None else {**row, **_half(row)} for row in difference.rows)
    return Line(difference.name, unit, rows, ", ".join(map(p_text, difference.p_values)), (False, *difference.real))


def _half(row: dict[str, Any]) -> dict[str, float]:
    """Value and half of its interval as numbers; NaN where not known."""
    value, high, std = (np.nan if row[key] is None else float(row[key]) for key in ("value", "high95", "std"))
    return {"value": value, "half": high - value, "std": std}


@styled
def errors_on_same_rows(comparison: ResultComparison) -> Plot:
    """Part of the readings whose error is smaller than a size, for each result."""
    figure, (axes,) = new_figure(1, 1, (_WIDTH, 2.5 + 0.2 * len(comparison.names)))
    looks = list(AXES.values())
    for k, (name, sizes) in enumerate(zip(comparison.names, comparison.sizes, strict=True)):
        part = 100 * (np.arange(len(sizes)) + 1) / len(sizes)
        line, colour = _LINES[k % len(_LINES)], looks[k % len(looks)][0]
        axes.plot(
            np.sort(sizes), part, line, color=colour, label=shortened(name, LONGEST_ENTRY), drawstyle="steps-post"
        )
    axes.set(xscale="log", xlabel=f"error after calibration [{comparison.unit}]", ylabel="smaller in [% of readings]")
    plain_ticks(axes.xaxis)
    figure.legend(loc="upper center")
    return finished(
        "same-rows",
        "Errors on the same readings",
        f"{len(comparison.sizes[0])} readings that no result used: the further to the left, the better.",
        figure,
    )


@styled
def intervals(comparison: ResultComparison, ranked: list[Difference]) -> Plot | None:
    """Differences to the first result in half widths of its 95 % intervals; None where there are no intervals."""
    shown = [
        difference
        for difference in ranked
        if all(row is not None and row["high95"] is not None for row in difference.rows)
    ][:_SHOWN]
    if not shown:
        return None
    figure, (axes,) = new_figure(1, 1, (_WIDTH, 1.0 + 0.2 * len(shown) * len(comparison.names)))
    looks = list(AXES.values())
    for place, difference in enumerate(shown):
        halves = [_half(row) for row in difference.rows if row is not None]
        first, width = halves[0]["value"], max(halves[0]["half"], 1e-300)
        for k, (half, real) in enumerate(zip(halves, (False, *difference.real), strict=True)):
            at = place + 0.8 * ((k + 0.5) / len(halves) - 0.5)
            colour, mark = (ORANGE, "D") if real else (GREY if k == 0 else looks[-1][0], "o")
            x, reach = (half["value"] - first) / width, half["half"] / width
            axes.errorbar(x, at, xerr=reach, color=colour, marker=mark, markersize=4, capsize=2, linewidth=1)
    axes.axvline(0.0, color="black", linewidth=0.8)
    axes.set_xscale("symlog", linthresh=2.0)
    plain_ticks(axes.xaxis)
    axes.set_yticks(range(len(shown)), [shortened(difference.name, LONGEST_ENTRY) for difference in shown])
    axes.set_ylim(len(shown) - 0.4, -0.6)
    axes.set_xlabel("difference to the first result,\nin half widths of its 95 % interval")
    return finished(
        "intervals",
        "Which differences are real",
        f"Grey: {shortened(comparison.names[0], 40)}; below it the others with their 95 % intervals, orange diamonds"
        " where a difference is real. Overlapping intervals alone decide nothing. The scale is linear to 2 and"
        " logarithmic beyond.",
        figure,
    )
