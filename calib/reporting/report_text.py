"""The result of a fit as text for a terminal: the answer on one screen, or all of it."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
from rich.table import Table

from calib.base.words import counted, plain_text, text_table
from calib.fitting.estimates import Estimate
from calib.fitting.fitted import Fit
from calib.judging.reasons import Verdict
from calib.judging.verdict import judge
from calib.reporting.accuracy import accuracy_text, change_text
from calib.reporting.files_held import worth_of_files
from calib.reporting.fit_notes import notes, outliers_left_out, terms_added
from calib.reporting.result_content import budget_table, parameter_rows

_MOST_REASONS = 3
_MOST_CHANGES = 5


def text_report(fit: Fit, width: int = 120, *, verbose: bool = False) -> str:
    """Return a fit as text.

    Args:
        fit: The fit.
        width: Of the text, in characters.
        verbose: All reasons, tables and remarks; otherwise the answer on at most 40 lines: the verdict, the errors
            before and after, and the parameters that changed most.
    """
    verdict = judge(fit)
    title = f"Calibration of {fit.nominal.name} ({fit.nominal.path})"
    parts: list[str | Table]
    if verbose:
        accuracy = [*accuracy_text(fit), *_files(fit), *_budget(fit)]
        parts = [title, *verdict_lines(verdict), *accuracy, _parameters(fit), *notes(fit)]
    else:
        told = [*terms_added(fit), *outliers_left_out(fit), *_worth(fit)]
        parts = [title, *verdict_lines(verdict, _MOST_REASONS), "", change_text(fit), *told, *_changed_most(fit)]
    return plain_text(parts, width, wrap=True)


def summary(fit: Fit, width: int = 120) -> str:
    """Return verdict and errors before and after: the beginning of `text_report`."""
    head = f"Calibration of {fit.nominal.name} ({fit.nominal.path})"
    return plain_text([head, *verdict_lines(judge(fit), _MOST_REASONS), "", change_text(fit)], width, wrap=True)


def verdict_lines(verdict: Verdict, most: int | None = None) -> list[str]:
    """Return the verdict, its claim, its reasons, and what it does not cover, one line each.

    Args:
        verdict: The verdict.
        most: How many reasons at most, and then how many others there are; all if not given.
    """
    claimed = [] if verdict.claim is None else [f"  {verdict.claim.words}"]
    names = {"PASS": "remark"}
    reasons = [f"  {names.get(reason.grade, reason.grade)}: {reason.text}" for reason in verdict.reasons]
    not_covered = [f"  not covered: {text}" for text in verdict.not_covered]
    if most is not None:
        hidden, errors = max(len(reasons) - most, 0), len(not_covered)
        more = [counted(hidden, "more reason")] if hidden else []
        more += [counted(errors, "possible error") + " that this verdict does not cover"] if errors else []
        reasons, not_covered = reasons[:most], [f"  --verbose prints {', and '.join(more)}"] if more else []
    return [f"Verdict: {verdict.grade}", *claimed, *reasons, *not_covered]


def _changed_most(fit: Fit) -> list[str | Table]:
    """The parameters that changed most against their standard deviation; places are no errors of the robot."""
    places = {parameter.name for parameter in fit.nominal.parameters if parameter.placement}
    free = [
        estimate
        for estimate in fit.parameters.values()
        if estimate.std > 0 and not estimate.family and estimate.name not in places
    ]
    most = sorted(
        (estimate for estimate in free if estimate.value != estimate.nominal), key=_significance, reverse=True
    )[:_MOST_CHANGES]
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
    return abs(estimate.value - estimate.nominal) / estimate.std


def _worth(fit: Fit) -> list[str]:
    """What files are worth, in a line, where some hold less than the whole model."""
    worth = worth_of_files(fit)
    if worth is None:
        return []
    withheld = {True: " (withheld)", False: ""}
    lines = [f"{line.holds} {line.rms:.4f}{withheld[line.formats.startswith('withheld')]}" for line in worth.lines]
    return [f"What files are worth, {worth.unit} RMS ({worth.part} error, {worth.where}): {'; '.join(lines)}"]


def _files(fit: Fit) -> list[Table]:
    """What each kind of file is worth, where some hold less than the whole model."""
    worth = worth_of_files(fit)
    if worth is None:
        return []
    title = f"What files are worth, {worth.unit} ({worth.part} error, {worth.where})"
    table = text_table(("file holds", "RMS", "95 % limit", "formats"), ("file holds", "formats"), title)
    for line in worth.lines:
        numbers = [f"{number:.4f}" if np.isfinite(number) else "-" for number in (line.rms, line.limit95)]
        table.add_row(line.holds, *numbers, line.formats)
    return [table]


def _budget(fit: Fit) -> list[Table]:
    budget = budget_table(fit)
    if budget is None:
        return []
    corrected = "poses used, corrected for the noise that the fit followed"
    of = corrected if budget["set"] == "identification" else "poses not used"
    title = f"Causes of the error before calibration ({of})"
    unit = budget["unit"]
    table = text_table(("", f"RMS {unit}", f"mean square {unit}^2", "std", "share"), title=title)
    for row in cast(list[dict[str, Any]], budget["causes"]):
        squares = [f"{row[key]:.3g}" if np.isfinite(row[key]) else "-" for key in ("mean_square", "std")]
        rms = f"{row['rms']:.4f}" if np.isfinite(row["rms"]) else "-"
        table.add_row(row["cause"], rms, *squares, row["remark"] or f"{100 * row['share']:.1f} %")
    before = cast(float, budget["rms_before"])
    table.add_row("together: before", f"{before:.4f}", f"{before**2:.3g}", "", "100.0 %")
    return [table]


def _parameters(fit: Fit) -> Table:
    headers = ("name", "unit", "nominal", "value", "std", "low 95 %", "high 95 %", "status")
    table = text_table(headers, ("name", "unit", "status"), "Parameters (value with 95 % interval)")
    for row in parameter_rows(fit):
        if row["family"]:  # hundreds of coefficients: one line for each family, among the notes
            continue
        numbers = [
            f"{row[key]:.4f}" if np.isfinite(row[key]) else "-"  # type: ignore[call-overload]
            for key in ("nominal", "value", "std", "low95", "high95")
        ]
        table.add_row(str(row["name"]), str(row["unit"]), *numbers, str(row["status"]))
    return table
