"""Determination by the measurements: ranks, undetermined parameters, and the uncertainty of predicted positions."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calib.core.base.words import count_noun, listing, sentence
from calib.core.fitting.error_sets import ErrorSet
from calib.core.fitting.fitted import Fit
from calib.core.rows.prediction import PositionUncertainty

CORRELATED = 0.95
"""Least correlation coefficient that is listed."""
_UNMOVED = 1e-9  # mm: positions that no parameter moves


def rank_content(fit: Fit) -> dict[str, object]:
    """Return the entry of `result.json` on the rank."""
    return {
        "n_parameters": int(np.sum(fit.free)),
        "rank": fit.rank.rank,
        "rank_all": fit.rank_all.rank,
        "n_parameters_all": len(fit.free),
        "smallest_singular_value_kept": fit.rank_all.smallest_kept,
        "largest_singular_value_dropped": fit.rank_all.largest_dropped,
        "rank_unclear": fit.rank.unclear or fit.rank_all.unclear,
        "redundant": list(fit.nominal.description.held),
    }


def correlated_pairs(fit: Fit) -> list[dict[str, object]]:
    """Return pairs of free parameters whose estimates are correlated, strongest first."""
    correlations = fit.correlation.values
    names = fit.free_names
    with np.errstate(invalid="ignore"):
        pairs = np.argwhere(np.triu(np.abs(correlations) >= CORRELATED, k=1))
    pairs = pairs[np.all(fit.unknowns.family[pairs] < 0, axis=1)]  # coefficients of one curve belong together anyway
    strongest = pairs[np.argsort(-np.abs(correlations[tuple(pairs.T)]), kind="stable")]
    return [{"a": names[i], "b": names[j], "correlation": float(correlations[i, j])} for i, j in strongest]


def determined_lines(fit: Fit) -> list[str]:
    """Return the numbers of combinations of parameters that the poses determine, one line each."""
    return [*fit.determination.lines(), sentence(fit.determination.words())]


def held_lines(fit: Fit) -> list[str]:
    """Return the held parameters in a line; no line without any."""
    held = fit.nominal.description.held
    return [f"Held at nominal: {', '.join(held)}"] if held else []


def observability_lines(fit: Fit) -> list[str]:
    """Return the indices, and pairs of correlated estimates, one line each."""
    lines = [
        "Observability (scaled columns): "
        + ", ".join(f"{name} {value:.3g}" for name, value in fit.observability.items()),
    ]
    pairs = [f"{row['a']} and {row['b']} ({row['correlation']:+.3f})" for row in correlated_pairs(fit)]
    if pairs:
        lines.append(f"Estimates that move together ({count_noun(len(pairs), 'pair')}): {listing(pairs)}")
    return lines


def unsure(fit: Fit) -> dict[str, list[str]]:
    """Return the names of parameters that the measurements do not decide, by status."""
    by_status: dict[str, list[str]] = {}
    for estimate in fit.parameters.values():
        if estimate.status not in ("identified", "placed") and not estimate.family:
            by_status.setdefault(estimate.status, []).append(estimate.name)
    return by_status


def position_uncertainty_table(fit: Fit) -> dict[str, object]:
    """Return the uncertainty of predicted positions, over the used and the validation poses [mm]."""
    return {
        name: uncertainty.table() | {"worst_pose": errors.data.names[uncertainty.worst]}
        for name, errors, uncertainty in _position_sets(fit)
    }


def position_lines(fit: Fit) -> list[str]:
    """Return the uncertainty of predicted positions, one line for each set of poses."""
    lines, words = [], {"identification": "poses used", "validation": "poses not used"}
    for name, errors, uncertainty in _position_sets(fit):
        summary = uncertainty.summary()
        lines.append(
            f"Predicted positions are known to {summary['mean']:.4f} mm on average, {summary['max']:.4f} mm at worst"
            f" (pose {errors.data.names[uncertainty.worst]}), over the {words[name]},"
            f" {fit.uncertainty.coverage_sentence}{uncertainty.remark()}"
        )
    return lines


def _position_sets(fit: Fit) -> Iterator[tuple[str, ErrorSet, PositionUncertainty]]:
    for name, errors, uncertainty in (
        ("identification", fit.identification, fit.identification_uncertainty),
        ("validation", fit.validation, fit.validation_uncertainty),
    ):
        if errors is not None and uncertainty is not None and uncertainty.summary()["max"] > _UNMOVED:
            yield name, errors, uncertainty
