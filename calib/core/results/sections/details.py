"""Details of a fit that its tables do not show, one line each: for the terminal and for the report page.

Also, for `result.json`: other fits of the same measurements (from other starts, and with folds left out in turn), and
what the measures of uncertainty contain.
"""

from __future__ import annotations

import numpy as np

from calib.core.base.contributions import Contributions, Uncertainty, names_of
from calib.core.base.units import ERROR_UNIT, in_unit, quantity_text
from calib.core.base.words import count_noun, listing
from calib.core.fitting.fitted import Fit
from calib.core.judging.verdict import judge
from calib.core.results.sections.budget import budget_lines
from calib.core.results.sections.determination import determined_lines, held_lines, observability_lines, position_lines
from calib.core.results.sections.noise import noise_lines, repeat_lines, scatter_lines
from calib.core.results.sections.outliers import outliers_left_out
from calib.core.results.sections.terms import curve_lines, terms_lines, terms_not_shown


def details(fit: Fit, *, brief: bool = False) -> list[str]:
    """Return details that the tables do not show, one line each.

    `brief` leaves out what a page shows in sections of its own: found noise, residuals, determination, and the
    uncertainty of positions.
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


def _contents(fit: Fit) -> dict[Uncertainty, Contributions]:
    """Contributions to each measure of uncertainty of a fit (`calib.core.base.contributions`)."""
    numbers, claim = (Uncertainty.COVARIANCE, Uncertainty.INTERVAL), judge(fit).claim
    contents = {number: fit.contains(number) for number in numbers}
    contents[Uncertainty.POSITION] = fit.identification_uncertainty.contains
    if claim is not None:
        contents |= {Uncertainty.CLAIM: claim.contains, Uncertainty.GAIN: fit.contains(Uncertainty.GAIN)}
    return contents


def contents_table(fit: Fit) -> dict[str, list[str]]:
    """Return the names of the contributions to each number, for `result.json`."""
    return {number.name.lower(): names_of(contains) for number, contains in _contents(fit).items()}


def contents_lines(fit: Fit) -> list[str]:
    """Return the contributions to each number in words, one line each."""
    return [
        f"{number.value[0].upper()}{number.value[1:].replace('`', '')}: counts {', '.join(names_of(contains))}"
        for number, contains in _contents(fit).items()
    ]


def starts_table(fit: Fit) -> dict[str, object] | None:
    """Return the minima that were found from other starts; None without other starts."""
    if fit.starts is None:
        return None
    unit = ERROR_UNIT[fit.identification.main_part.dimension]
    minima = [{"rms": in_unit(m.rms, unit), "cost": m.cost, "count": m.count} for m in fit.starts.minima]
    return {"count": fit.starts.total, "failed": fit.starts.failed, "seed": fit.starts.seed, "minima": minima}


def folds_table(fit: Fit) -> dict[str, object] | None:
    """Return the errors of folds that were left out in turn; None without folds."""
    if fit.folds is None:
        return None
    names, unit = list(fit.nominal.description.setups), ERROR_UNIT[fit.identification.main_part.dimension]
    return {
        "folds": fit.folds.count,
        "seed": fit.folds.seed,
        "setups": [names[k] for k in fit.folds.setups],
        "rms": [in_unit(value, unit) for value in fit.folds.rms],
        "converged": fit.folds.converged,
    }


def start_lines(fit: Fit) -> list[str]:
    """Return a line with the minima that other starts found; no line without other starts."""
    if fit.starts is None:
        return []
    unit = ERROR_UNIT[fit.identification.main_part.dimension]
    minima = [f"RMS {quantity_text(m.rms, unit, '.4f')} from {m.count}" for m in fit.starts.minima]
    failed = f", {fit.starts.failed} failed" if fit.starts.failed else ""
    return [f"{count_noun(fit.starts.total, 'start')} (seed {fit.starts.seed}): {listing(minima, '; ')}{failed}"]


def fold_lines(fit: Fit) -> list[str]:
    """Return a line with the errors of folds, or setups, that were left out in turn; no line without them."""
    if fit.folds is None:
        return []
    unit = ERROR_UNIT[fit.identification.main_part.dimension]
    rms = [f"{in_unit(value, unit):.4f}" for value in fit.folds.rms]
    if fit.folds.setups:
        names = list(fit.nominal.description.setups)
        each = [f"{names[k]} {value}" for k, value in zip(fit.folds.setups, rms, strict=True)]
        return [f"Setups left out in turn, each placed anew: RMS of {', '.join(each)} {unit}"]
    folds = f"{fit.folds.count} folds (seed {fit.folds.seed})"
    return [f"Cross-validation in {folds}: RMS of each {', '.join(rms)} {unit}"]
