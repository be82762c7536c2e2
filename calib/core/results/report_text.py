"""The result of a fit as text for a terminal: a summary on one screen, or all of it."""

from __future__ import annotations

from rich.table import Table

from calib.core.base.threads import one_blas_thread
from calib.core.base.words import count_noun, plain_text
from calib.core.fitting.fitted import Fit
from calib.core.judging.reasons import Verdict
from calib.core.judging.verdict import judge
from calib.core.results.sections.accuracy import accuracy_grids, change_text
from calib.core.results.sections.budget import budget_grid
from calib.core.results.sections.details import details
from calib.core.results.sections.files_held import files_grid
from calib.core.results.sections.outliers import outliers_left_out
from calib.core.results.sections.parameters import most_changed_lines, parameter_grid
from calib.core.results.sections.terms import terms_added, terms_not_shown

_WIDTH = 120
_MOST_REASONS = 3


@one_blas_thread
def text_report(fit: Fit, width: int = _WIDTH, *, verbose: bool = False) -> str:
    """Return a fit as text, `width` characters wide.

    `verbose`: all reasons, tables and remarks; otherwise at most 40 lines: the verdict, the errors before and after,
    and the parameters that changed most.
    """
    verdict = judge(fit)
    if verbose:
        grids = (*accuracy_grids(fit), files_grid(fit), budget_grid(fit), parameter_grid(fit))
        tables = [grid.as_text() for grid in grids if grid is not None]
        return plain_text([_title(fit), *verdict_lines(verdict), *tables, *details(fit)], width, wrap=True)
    files, remarks = files_grid(fit), [*terms_added(fit), *terms_not_shown(fit), *outliers_left_out(fit)]
    worth: list[str | Table] = ["", files.as_text(plain=True)] if files is not None else []
    return plain_text([*_beginning(fit, verdict), *remarks, *worth, *most_changed_lines(fit)], width, wrap=True)


def summary(fit: Fit) -> str:
    """Return verdict and errors before and after: the beginning of `text_report`."""
    return plain_text(_beginning(fit, judge(fit)), _WIDTH, wrap=True)


def _beginning(fit: Fit, verdict: Verdict) -> list[str | Table]:
    return [_title(fit), *verdict_lines(verdict, _MOST_REASONS), "", change_text(fit, verdict.claim)]


def _title(fit: Fit) -> str:
    return f"Calibration of {fit.nominal.name} ({fit.nominal.path})"


def verdict_lines(verdict: Verdict, most: int | None = None) -> list[str]:
    """Return the verdict, its claim, its reasons, and errors that it does not cover, one line each.

    With `most`, only that many reasons are listed, and a line counts the others.
    """
    claimed = [] if verdict.claim is None else [f"  {verdict.claim.words}"]
    names = {"PASS": "remark"}
    reasons = [f"  {names.get(reason.grade, reason.grade)}: {reason.text}" for reason in verdict.reasons]
    not_covered = [f"  not covered: {text}" for text in verdict.not_covered]
    if most is not None:
        hidden = max(len(reasons) - most, 0)
        reasons, more = reasons[:most], [f"  --verbose prints {count_noun(hidden, 'more reason')}"] if hidden else []
        not_covered += more
    return [f"Verdict: {verdict.grade}", *claimed, *reasons, *not_covered]
