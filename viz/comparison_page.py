"""Results side by side as one page: significant differences, parameters with intervals, errors on the same rows."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Any

import numpy as np

from calib.fleets.comparison_report import Difference, ResultComparison, p_text
from viz.charts import MANY, Chart, Charts, axis, layer, panel
from viz.page_parts import places
from viz.report_page import printed_page
from viz.result_charts import forest
from viz.viewer_page import ViewerPage

_SHOWN = 24  # parameters in the figure
_REAL = ": a real difference"


@dataclass(frozen=True)
class ComparisonLine:
    """A parameter of the table: name, unit, its value in each result, p-values, and significant differences."""

    name: str
    unit: str
    rows: tuple[dict[str, Any] | None, ...]
    p_values: str
    real: tuple[bool, ...]


def comparison_page(comparison: ResultComparison, *, command: str = "", created: datetime | None = None) -> ViewerPage:
    """Return the page of a comparison, made by a command line; `created` is printed (default: now)."""
    ranked = comparison.rank_differences()
    rest = [difference for difference in comparison.differences if difference not in ranked]
    same_rows = errors_on_same_rows(comparison) if comparison.sizes else None
    charts = Charts(places(same_rows=same_rows, intervals=intervals(comparison, ranked)))
    heads = (comparison.names, comparison.verdicts, comparison.n_poses, comparison.errors, comparison.errors_on)
    return printed_page(
        "comparison.html",
        charts,
        command,
        created,
        comparison=comparison,
        conclusion=comparison.conclusion(),
        notes=comparison.notes,
        heads=zip(*heads, strict=True),
        lines=[_line(difference) for difference in [*ranked, *rest]],
    )


def _line(difference: Difference) -> ComparisonLine:
    unit = next(str(row["unit"]) for row in difference.rows if row is not None)
    rows = tuple(None if row is None else {**row, **_half(row)} for row in difference.rows)
    return ComparisonLine(
        difference.name, unit, rows, ", ".join(map(p_text, difference.p_values)), (False, *difference.real)
    )


def _half(row: dict[str, Any]) -> dict[str, float]:
    """Value and half of its interval as numbers; NaN where unknown."""
    value, high, std = (np.nan if row[key] is None else float(row[key]) for key in ("value", "high95", "std"))
    return {"value": value, "half": high - value, "std": std}


def errors_on_same_rows(comparison: ResultComparison) -> Chart:
    """Share of readings whose error is below a size, for each result."""
    layers = []
    for k, (name, sizes) in enumerate(zip(comparison.names, comparison.sizes, strict=True)):
        part = 100 * (np.arange(len(sizes)) + 1) / len(sizes)
        texts = [
            f"{name}: {share:.3g} % are below {size:.3g} {comparison.unit}"
            for share, size in zip(part, np.sort(sizes), strict=True)
        ]
        layers.append(layer("points", name, MANY[k % len(MANY)], x=np.sort(sizes), y=part, texts=texts))
    x = axis(f"error after calibration [{comparison.unit}]", log=True)
    return Chart(
        "same-rows",
        "Errors on the same readings",
        f"{len(comparison.sizes[0])} readings that no result used: the further to the left, the better.",
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
