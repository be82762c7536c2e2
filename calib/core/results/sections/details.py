"""Details of a fit that its tables do not show, one line each: for the terminal and for the report page."""

from __future__ import annotations

import numpy as np

from calib.core.base.words import count_noun, listing
from calib.core.fitting.fitted import Fit
from calib.core.results.sections.attempts import fold_lines, start_lines
from calib.core.results.sections.budget import budget_lines
from calib.core.results.sections.contents import contents_lines
from calib.core.results.sections.determination import determined_lines, held_lines, observability_lines, position_lines
from calib.core.results.sections.noise import noise_lines, repeat_lines, scatter_lines
from calib.core.results.sections.outliers import outliers_left_out
from calib.core.results.sections.terms import curve_lines, terms_lines, terms_not_shown


def details(fit: Fit, *, brief: bool = False) -> list[str]:
    """Return details that the tables do not show, one line each.

    Args:
        brief: Whether to leave out what a page shows in sections of its own: found noise, residuals, determination,
            and the uncertainty of positions.
    """
    elsewhere = (noise_lines, budget_lines, determined_lines, held_lines, position_lines)
    order = (
        *(_size, noise_lines, scatter_lines, terms_lines, terms_not_shown, budget_lines, curve_lines),
        *(determined_lines, observability_lines, held_lines, position_lines, contents_lines, repeat_lines),
        *(_loss, outliers_left_out, start_lines, fold_lines, _places, _columns),
    )
    return [line for lines_of in order if not (brief and lines_of in elsewhere) for line in lines_of(fit)]


def _size(fit: Fit) -> list[str]:
    data, statistics = fit.identification.data, fit.statistics
    return [
        f"{count_noun(data.n_poses, 'pose')}, {count_noun(data.n_readings, 'reading')}, {statistics.freedom:.0f}"
        f" degrees of freedom, {fit.seconds:.3f} s"
    ]


def _loss(fit: Fit) -> list[str]:
    low = int(np.sum(fit.weights < 0.5))
    line = (
        f"Robust loss {fit.loss}: {low} of {fit.weights.size} points {'has' if low == 1 else 'have'} less than half the"
        " weight"
    )
    return [] if fit.loss == "none" else [line]


def _places(fit: Fit) -> list[str]:
    lines = []
    if fit.placed_later:
        places = dict.fromkeys(name.rpartition(".")[0] for name in fit.placed_later)
        lines.append(f"Places found by unused poses, because only these show them: {listing(list(places))}")
    if any(p.placement for p in fit.nominal.parameters):
        lines.append("'before' is the nominal robot, with only its base and targets placed")
    return lines


def _columns(fit: Fit) -> list[str]:
    ignored = fit.identification.data.ignored
    return [f"Columns that were not used: {', '.join(ignored)}"] if ignored else []
