"""The error budget: the causes of the error before calibration, as data and as a table, and advice in a line."""

from __future__ import annotations

import math
from typing import Any

from calib.core.base.units import ERROR_UNIT, in_unit
from calib.core.fitting.fitted import Fit
from calib.core.judging import findings
from calib.core.judging.error_budget import UNEXPLAINED
from calib.core.results.sections.grid import Grid, GridColumn, GridNumber

_FINEST = 1e-3  # a page shows digits down to this part of the whole mean square
_NOT_SEEN, _LESS = "none visible", "none: the rest is below the noise"
"""Remarks in place of a mean square that is negative, by chance, or because the stated noise is too large."""


def budget_table(fit: Fit) -> dict[str, Any] | None:
    """Return the error budget in the unit of errors and its square; see `calib.core.judging.error_budget`.

    A cause whose mean square is negative has no root mean square and no share, but a remark.
    """
    budget = findings.budget(fit)
    if budget is None:
        return None
    unit = ERROR_UNIT[budget.part.dimension]
    scale = in_unit(1.0, unit)

    def row(cause: str, mean_square: float, std: float) -> dict[str, object]:
        positive = mean_square >= 0.0
        surely = _LESS if cause == UNEXPLAINED else "makes the error larger"
        return {
            "cause": cause,
            "mean_square": scale**2 * mean_square,
            "std": scale**2 * std,
            "rms": scale * math.sqrt(mean_square) if positive else math.nan,
            "share": mean_square / budget.before if positive and budget.before > 0 else math.nan,
            "remark": "" if positive else surely if mean_square < -2.0 * std else _NOT_SEEN,
        }

    return {
        "set": "identification" if budget.used else "validation",
        "part": budget.part.name,
        "unit": unit,
        "n_readings": budget.n_readings,
        "n_poses": budget.n_poses,
        "rms_before": scale * math.sqrt(budget.before),
        "rms_left": scale * math.sqrt(max(budget.after, 0.0)),
        "causes": [row(share.cause, share.mean_square, share.std) for share in budget.shares],
        "noise_from": budget.noise_from or None,
        "advice": budget.advice,
    }


def budget_grid(fit: Fit) -> Grid | None:
    """Return a table of the causes and their sum; None where there is no budget."""
    found, budget = findings.budget(fit), budget_table(fit)
    if found is None or budget is None:
        return None
    unit, before, causes = budget["unit"], budget["rms_before"], budget["causes"]
    rms = "RMS, all axes" if len(found.part.axes) > 1 else "RMS"
    of, on_page = "poses not used", "that the fit has not used"
    if budget["set"] == "identification":
        of = "used poses, corrected for noise that the fit absorbed"
        on_page = "that the fit has used (corrected for noise that it absorbed)"
    columns = (
        GridColumn("", "cause", words=True),
        GridColumn(f"{rms} {unit}", f"{rms} [{unit}]"),
        GridColumn(f"mean square {unit}^2", f"mean square [{unit}²]"),
        GridColumn("std"),
        GridColumn("share"),
    )

    def square(value: float, std: float) -> GridNumber:
        return GridNumber(value, max(std, _FINEST * before**2) if std > 0 else std, ".3g")

    rows = [
        (
            row["cause"],
            GridNumber(row["rms"]),
            square(math.nan if row["remark"] in (_NOT_SEEN, _LESS) else row["mean_square"], row["std"]),
            square(row["std"], row["std"]),
            row["remark"] or f"{100 * row['share']:.1f} %",
        )
        for row in causes
    ]
    whole = ("together: before", GridNumber(before), square(before**2, causes[0]["std"]), "", "100.0 %")
    return Grid(
        f"Causes of the error before calibration ({of})",
        f"Causes of the error before calibration, over {budget['n_readings']} readings {on_page}. Mean squares add up",
        columns,
        (*rows, whole),
        (len(rows),),
    )


def budget_lines(fit: Fit) -> list[str]:
    """Return the advice of the budget in a line; none without a budget."""
    budget = findings.budget(fit)
    return [] if budget is None else [f"What is left: {budget.advice}"]
