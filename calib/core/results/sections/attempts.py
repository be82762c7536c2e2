"""Other fits of the same measurements: from other starts, and with folds left out in turn."""

from __future__ import annotations

from calib.core.base.units import ERROR_UNIT, error_scale, quantity_text
from calib.core.base.words import count_noun, listing
from calib.core.fitting.fitted import Fit


def starts_table(fit: Fit) -> dict[str, object] | None:
    """Return the minima that were found from other starts; None without other starts."""
    if fit.starts is None:
        return None
    scale = error_scale(fit.identification.main_part.dimension)
    minima = [{"rms": scale * m.rms, "cost": m.cost, "count": m.count} for m in fit.starts.minima]
    return {"count": fit.starts.total, "failed": fit.starts.failed, "seed": fit.starts.seed, "minima": minima}


def folds_table(fit: Fit) -> dict[str, object] | None:
    """Return the errors of folds that were left out in turn; None without folds."""
    if fit.folds is None:
        return None
    names = list(fit.nominal.description.setups)
    return {
        "folds": fit.folds.count,
        "seed": fit.folds.seed,
        "setups": [names[k] for k in fit.folds.setups],
        "rms": [error_scale(fit.identification.main_part.dimension) * value for value in fit.folds.rms],
        "converged": fit.folds.converged,
    }


def start_lines(fit: Fit) -> list[str]:
    """Return a line with the minima that other starts found; no line without other starts."""
    if fit.starts is None:
        return []
    dimension = fit.identification.main_part.dimension
    minima = [f"RMS {quantity_text(m.rms, dimension, '.4f')} from {m.count}" for m in fit.starts.minima]
    failed = f", {fit.starts.failed} failed" if fit.starts.failed else ""
    return [f"{count_noun(fit.starts.total, 'start')} (seed {fit.starts.seed}): {listing(minima, '; ')}{failed}"]


def fold_lines(fit: Fit) -> list[str]:
    """Return a line with the errors of folds, or setups, that were left out in turn; no line without them."""
    if fit.folds is None:
        return []
    dimension = fit.identification.main_part.dimension
    unit, rms = ERROR_UNIT[dimension], [f"{error_scale(dimension) * value:.4f}" for value in fit.folds.rms]
    if fit.folds.setups:
        names = list(fit.nominal.description.setups)
        each = [f"{names[k]} {value}" for k, value in zip(fit.folds.setups, rms, strict=True)]
        return [f"Setups left out in turn, each placed anew: RMS of {', '.join(each)} {unit}"]
    folds = f"{fit.folds.count} folds (seed {fit.folds.seed})"
    return [f"Cross-validation in {folds}: RMS of each {', '.join(rms)} {unit}"]
