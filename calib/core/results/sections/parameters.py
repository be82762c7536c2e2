"""The parameters: values, uncertainty, and the largest changes."""

from __future__ import annotations

from rich.table import Table

from calib.core.base.words import text_table
from calib.core.fitting.estimates import Estimate
from calib.core.fitting.fitted import Fit
from calib.core.results.sections.grid import Grid, GridColumn, GridNumber

_MOST_CHANGES = 5


def parameter_rows(fit: Fit) -> list[dict[str, object]]:
    """Return one row per parameter, in its display unit; uncertainties of held parameters are NaN."""
    estimates = fit.parameters
    return [row | {"family": each.family} for row, each in zip(estimates.rows(), estimates.values(), strict=True)]


def parameter_grid(fit: Fit) -> Grid:
    """Return the parameters, without the hundreds of coefficients of curves."""
    columns = (
        GridColumn("name", words=True),
        GridColumn("unit", words=True),
        GridColumn("nominal"),
        GridColumn("value"),
        GridColumn("change", only_page=True),
        GridColumn("std"),
        GridColumn("low 95 %"),
        GridColumn("high 95 %"),
        GridColumn("status", words=True),
    )
    caption = (
        "Values with their 95 % intervals, rounded to two digits of the standard deviation. All digits are in"
        " parameters.csv"
    )
    rows = tuple(_row(estimate) for estimate in fit.parameters.values() if not estimate.family)
    return Grid("Parameters (value with 95 % interval)", caption, columns, rows)


def _row(estimate: Estimate) -> tuple[str | GridNumber, ...]:
    change = estimate.value - estimate.nominal
    numbers = (estimate.nominal, estimate.value, change, estimate.std, estimate.low95, estimate.high95)
    cells = (GridNumber(number, estimate.std) for number in numbers)
    return (estimate.name, estimate.unit, *cells, estimate.status)


def most_changed_lines(fit: Fit) -> list[str | Table]:
    """Return the parameters that changed most against their standard deviation, without places."""
    places = {parameter.name for parameter in fit.nominal.parameters if parameter.placement}
    changed = [
        estimate
        for estimate in fit.parameters.values()
        if estimate.std_si > 0 and not estimate.family and estimate.name not in places
        if estimate.value_si != estimate.nominal_si
    ]
    most = sorted(changed, key=_significance, reverse=True)[:_MOST_CHANGES]
    if not most:
        return []
    table = text_table(("changed most", "unit", "nominal", "value", "change", "std", "change / std"),
                       ("changed most", "unit"), plain=True)  # fmt: skip
    for estimate in most:
        numbers = (estimate.nominal, estimate.value, estimate.value - estimate.nominal, estimate.std)
        table.add_row(
            estimate.name, estimate.unit, *(f"{number:.4f}" for number in numbers), f"{_significance(estimate):.1f}"
        )
    return ["", table]


def _significance(estimate: Estimate) -> float:
    return abs(estimate.value_si - estimate.nominal_si) / estimate.std_si
