"""Outliers found in a fit or left out of it, and the fit without leaving any out; also the rows of `residuals.csv`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from calib.core.base.arrays import IntArray
from calib.core.base.memoize import memoize
from calib.core.base.units import ERROR_UNIT, in_unit, quantity_text
from calib.core.base.words import listing
from calib.core.fitting.error_sets import ErrorSet
from calib.core.fitting.fitted import Fit
from calib.core.fitting.outliers import Outlier, outliers_in_words
from calib.core.judging import findings
from calib.core.judging.verdict import judge
from calib.core.results.sections.parameters import parameter_rows
from calib.core.rows.rows import Rows

LEFT_OUT = "left out"
"""Text in column `set` of `residuals.csv` for readings that were left out as outliers."""


@memoize
def residual_sets(fit: Fit) -> dict[str, tuple[ErrorSet, Rows]]:
    """Return the sets of readings that `residuals.csv` holds, with their rows."""
    sets = {"identification": (fit.identification, fit.rows)}
    if fit.validation is not None and fit.validation_rows is not None:
        sets["validation"] = fit.validation, fit.validation_rows
    excluded = findings.excluded_errors(fit)
    if excluded is not None:
        sets[LEFT_OUT] = excluded, fit.whitened_residuals_and_rows(excluded)[1]
    return sets


def residual_places(sets: Mapping[str, tuple[ErrorSet, Rows]]) -> dict[str, IntArray]:
    """Return each reading's row of `residuals.csv`, counted from 0, (n,) by set; rows of a set go visit by visit."""
    places: dict[str, IntArray] = {}
    count = 0
    for label, (_, rows) in sets.items():
        place = np.empty(rows.layout.n_readings, dtype=np.intp)
        place[np.argsort(rows.layout.visit, kind="stable")] = count + np.arange(len(place))
        places[label], count = place, count + len(place)
    return places


def outlier_rows(fit: Fit) -> list[dict[str, Any]]:
    """Return the outliers of both sets, worst first in each, with their rows of `residuals.csv`, counted from 1."""
    both = {"identification": findings.outliers(fit), "validation": findings.validation_outliers(fit)}
    places = residual_places(residual_sets(fit))
    return [
        _outlier(fit, label, outlier) | {"row": int(places[label][outlier.reading]) + 1}
        for label, outliers in both.items()
        for outlier in outliers
    ]


def excluded_rows(fit: Fit) -> list[dict[str, Any]]:
    """Return the outliers that were left out of the fit."""
    return [_outlier(fit.with_all, "identification", outlier) for outlier in fit.excluded]


def _outlier(fit: Fit | None, label: str, outlier: Outlier) -> dict[str, Any]:
    errors = None if fit is None else fit.identification if label == "identification" else fit.validation
    return {
        "set": label,
        "pose": None if errors is None else errors.data.names[outlier.pose],
        "where": outlier.label,
        "target": outlier.target,
        "looked_at": outlier.detail,
        "together": outlier.n_together,
        "distance": outlier.distance * _error_scale(errors, outlier),
        "size": outlier.size,
        "over_noise": outlier.studentised,
        "leverage": outlier.leverage,
        "p_value": outlier.p_value,
    }


def _error_scale(errors: ErrorSet | None, outlier: Outlier) -> float:
    if errors is None:
        return 1.0
    instrument = next(instrument for instrument in errors.instruments if instrument.name == outlier.target)
    return in_unit(1.0, ERROR_UNIT[instrument.parts[0].dimension])


def with_excluded(fit: Fit) -> dict[str, object] | None:
    """Return the result of all poses, if the main result leaves outliers out."""
    if fit.with_all is None:
        return None
    return {
        "n_poses": fit.with_all.identification.data.n_poses,
        "verdict": judge(fit.with_all).to_dict(),
        "sigma": fit.with_all.sigma,
        "parameters": parameter_rows(fit.with_all),
        "errors": fit.with_all.errors,
    }


def outliers_left_out(fit: Fit) -> list[str]:
    """Return the outliers that were left out, and the fit with them; no line without any."""
    if fit.with_all is None:
        return []
    before, after = (either.identification.table()["after"]["rms"] for either in (fit.with_all, fit))
    dimension = fit.identification.main_part.dimension
    unit, noise = ERROR_UNIT[dimension], quantity_text(fit.with_all.sigma, ERROR_UNIT[dimension], ".4g")
    layout, left = fit.with_all.rows.layout, fit.rows.layout.n_readings
    several = layout.n_readings > len(np.unique(layout.visit))
    count = f" ({layout.n_readings - left} of {layout.n_readings} readings)" if several else ""
    return [
        f"Outliers left out{count}: {listing(outliers_in_words(fit.excluded), '; ', 2)}. With them: RMS"
        f" {before:.4f} {unit}, noise {noise}; without: RMS {after:.4f} {unit}"
    ]
