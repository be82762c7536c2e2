"""The content of a result in mm and degrees: dictionaries for `result.json`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict

import numpy as np

from calib.base.arrays import IntArray
from calib.base.remembered import remembered
from calib.base.units import DISPLAY_UNIT, ERROR_UNIT, display_scale, error_scale
from calib.base.version import PROGRAM
from calib.base.words import as_data
from calib.fitting.error_sets import ErrorSet
from calib.fitting.fitted import Fit
from calib.fitting.outliers import Outlier
from calib.fitting.terms.joint_curves import joint_curves
from calib.judging import findings
from calib.judging.next_step import next_step
from calib.judging.repeatability import repeatability, repeats
from calib.judging.verdict import judge
from calib.reporting.accuracy import error_sets
from calib.reporting.files_held import file_entries
from calib.rows.prediction import PositionUncertainty
from calib.rows.rows import Rows

FORMAT_VERSION = 1
NOMINAL_YAML, NOMINAL_URDF = "nominal.yaml", "nominal.urdf"
"""Files of a result folder that hold the robot as it was before."""
UNDECIDED = "undecided_terms.csv"
"""File of a result folder: what joint terms leave uncertain that `--terms auto` did not decide on."""
LEFT_OUT = "left out"
"""Set in `residuals.csv` of the readings that were left out as outliers."""
CORRELATED = 0.95
"""Correlation coefficients from here on are listed."""


def to_dict(fit: Fit, *, forced: bool = False) -> dict[str, object]:
    """Return the content of `result.json`; see the contract in docs.

    Args:
        fit: The fit.
        forced: Whether a failed result is exported all the same.
    """
    data = fit.identification.data
    return as_data(
        {
            "version": FORMAT_VERSION,
            "program": PROGRAM,
            "robot": fit.nominal.path,
            "data": data.path,
            "comments": comments(fit),
            "verdict": judge(fit).to_dict(forced=forced),
            "next": str(next_step(fit)),
            "converged": fit.converged,
            "message": fit.message,
            "seconds": fit.seconds,
            "seed": fit.seed,
            "n_poses": data.n_poses,
            "n_rows": len(data),
            "n_readings": data.n_readings,
            "n_parameters": int(np.sum(fit.free)),
            "rank": fit.rank.rank,
            "rank_all": fit.rank_all.rank,
            "n_parameters_all": len(fit.free),
            "smallest_singular_value_kept": fit.rank_all.smallest_kept,
            "largest_singular_value_dropped": fit.rank_all.largest_dropped,
            "rank_unclear": fit.rank.unclear or fit.rank_all.unclear,
            "redundant": list(fit.nominal.description.held),
            "sigma": fit.sigma,
            "sigma_stated": fit.sigma_stated,
            "degrees_of_freedom": fit.statistics.freedom,
            "effective_parameters": fit.statistics.effective_parameters,
            "chi_square": None if fit.chi_square is None else asdict(fit.chi_square),
            "interval_degrees_of_freedom": fit.statistics.interval_freedom,
            "widened": fit.widened,
            "joint_error": fit.joint_error,
            "shared": None if fit.statistics.shared is None else fit.statistics.shared.ratio,
            "repeatability": repeatability(fit.identification)[0],
            "repeats": repeat_table(fit.identification),
            "repeats_validation": None if fit.validation is None else repeat_table(fit.validation),
            "observability": fit.observability,
            "parameters": parameter_rows(fit),
            "correlations": correlated(fit),
            "errors": fit.errors,
            "instruments": instrument_blocks(fit),
            "error_budget": budget_table(fit),
            "position_uncertainty": position_uncertainty_table(fit),
            "loss": fit.loss,
            "outliers": outlier_rows(fit),
            "excluded": excluded_rows(fit),
            "with_excluded": _with_excluded(fit),
            "patterns": [asdict(pattern) for pattern in findings.patterns(fit)],
            "starts": _starts(fit),
            "cross_validation": _folds(fit),
            "joint_terms": _terms(fit),
            "files": file_entries(fit),
        }
    )


def comments(fit: Fit) -> list[str]:
    """Return what the measurement files say about themselves, each line once."""
    files = [fit.identification.data] + ([] if fit.validation is None else [fit.validation.data])
    return list(dict.fromkeys(line for data in files for line in data.comments))


def parameter_rows(fit: Fit) -> list[dict[str, object]]:
    """Return one row per parameter, in its display unit; uncertainties of held parameters are NaN."""
    return [estimate.row() | {"family": estimate.family} for estimate in fit.parameters.values()]


def correlated(fit: Fit) -> list[dict[str, object]]:
    """Return pairs of free parameters whose estimates move together, strongest first."""
    correlations = fit.statistics.correlations()
    names = fit.free_names
    with np.errstate(invalid="ignore"):
        pairs = np.argwhere(np.triu(np.abs(correlations) >= CORRELATED, k=1))
    outside_curves = fit.unknowns.family < 0  # coefficients of one curve belong together anyway
    rows = [
        {"a": names[i], "b": names[j], "correlation": float(correlations[i, j])}
        for i, j in pairs
        if outside_curves[i] and outside_curves[j]
    ]
    return sorted(rows, key=lambda row: -abs(float(str(row["correlation"]))))


def repeat_table(errors: ErrorSet) -> dict[str, object] | None:
    """Return ISO 9283-style accuracy and repeatability [mm]; None without repeats."""
    figures = repeats(errors)
    return None if figures is None else figures.table()


def budget_table(fit: Fit) -> dict[str, object] | None:
    """Return the error budget in the unit of errors and its square; see `calib.judging.error_budget`.

    A cause whose mean square is negative has no root mean square and no share, but a remark.
    """
    budget = findings.budget(fit)
    if budget is None:
        return None
    scale = error_scale(budget.part.dimension)

    def row(cause: str, mean_square: float, std: float) -> dict[str, object]:
        positive = mean_square >= 0.0
        return {
            "cause": cause,
            "mean_square": scale**2 * mean_square,
            "std": scale**2 * std,
            "rms": scale * math.sqrt(mean_square) if positive else math.nan,
            "share": mean_square / budget.before if positive and budget.before > 0 else math.nan,
            "remark": "" if positive else "makes it larger" if mean_square < -2.0 * std else "none to be seen",
        }

    return {
        "set": "identification" if budget.used else "validation",
        "part": budget.part.name,
        "unit": ERROR_UNIT[budget.part.dimension],
        "n_readings": budget.n_readings,
        "n_poses": budget.n_poses,
        "rms_before": scale * math.sqrt(budget.before),
        "rms_left": scale * math.sqrt(max(budget.after, 0.0)),
        "causes": [row(share.cause, share.mean_square, share.std) for share in budget.shares],
        "noise_from": budget.noise_from or None,
        "advice": budget.advice,
    }


def position_uncertainty_table(fit: Fit) -> dict[str, object]:
    """Return how sure predicted positions are, over the poses that were used and those that were not [mm]."""
    sets: list[tuple[str, ErrorSet | None, PositionUncertainty | None]] = [
        ("identification", fit.identification, fit.identification_uncertainty),
        ("validation", fit.validation, fit.validation_uncertainty),
    ]
    return {
        name: uncertainty.table() | {"worst_pose": errors.data.names[uncertainty.worst]}
        for name, errors, uncertainty in sets
        if uncertainty is not None and errors is not None
    }


@remembered
def residual_sets(fit: Fit) -> dict[str, tuple[ErrorSet, Rows]]:
    """Return the sets of readings that `residuals.csv` holds, with their rows."""
    sets = {"identification": (fit.identification, fit.rows)}
    if fit.validation is not None and fit.validation_rows is not None:
        sets["validation"] = fit.validation, fit.validation_rows
    excluded = findings.excluded_errors(fit)
    if excluded is not None:
        sets[LEFT_OUT] = excluded, fit.whitened(excluded)[1]
    return sets


def residual_places(sets: Mapping[str, tuple[ErrorSet, Rows]]) -> dict[str, IntArray]:
    """Return the row of `residuals.csv` of each reading of each set, counted from 0, (n,): visit by visit."""
    places: dict[str, IntArray] = {}
    count = 0
    for label, (_, rows) in sets.items():
        place = np.empty(rows.layout.n_readings, dtype=np.intp)
        place[np.argsort(rows.layout.visit, kind="stable")] = count + np.arange(len(place))
        places[label], count = place, count + len(place)
    return places


def outlier_rows(fit: Fit) -> list[dict[str, object]]:
    """Return the outliers of both sets, worst first in each, with their rows of `residuals.csv`, counted from 1."""
    both = {"identification": findings.outliers(fit), "validation": findings.validation_outliers(fit)}
    places = residual_places(residual_sets(fit))
    return [
        _outlier(fit, label, outlier) | {"row": int(places[label][outlier.reading]) + 1}
        for label, outliers in both.items()
        for outlier in outliers
    ]


def excluded_rows(fit: Fit) -> list[dict[str, object]]:
    """Return the outliers that were left out of the fit."""
    return [_outlier(fit.with_all, "identification", outlier) for outlier in fit.excluded]


def _outlier(fit: Fit | None, label: str, outlier: Outlier) -> dict[str, object]:
    errors = None if fit is None else fit.identification if label == "identification" else fit.validation
    return {
        "set": label,
        "pose": None if errors is None else errors.data.names[outlier.pose],
        "where": outlier.label,
        "target": outlier.target,
        "looked_at": outlier.looked_at,
        "together": outlier.together,
        "distance": outlier.distance * _error_scale(errors, outlier),
        "size": outlier.size,
        "over_noise": outlier.studentised,
        "leverage": outlier.leverage,
        "p_value": outlier.p_value,
    }


def _with_excluded(fit: Fit) -> dict[str, object] | None:
    """The result of all poses, where outliers were left out of the main one."""
    if fit.with_all is None:
        return None
    return {
        "n_poses": fit.with_all.identification.data.n_poses,
        "verdict": judge(fit.with_all).to_dict(),
        "sigma": fit.with_all.sigma,
        "parameters": parameter_rows(fit.with_all),
        "errors": {name: errors.table() for name, errors in error_sets(fit.with_all)},
    }


def _starts(fit: Fit) -> dict[str, object] | None:
    if fit.starts is None:
        return None
    scale = error_scale(fit.identification.main_part.dimension)
    minima = [{"rms": scale * m.rms, "cost": m.cost, "count": m.count} for m in fit.starts.minima]
    return {"count": fit.starts.total, "failed": fit.starts.failed, "seed": fit.starts.seed, "minima": minima}


def _folds(fit: Fit) -> dict[str, object] | None:
    if fit.folds is None:
        return None
    rms = [error_scale(fit.identification.main_part.dimension) * value for value in fit.folds.rms]
    names = list(fit.nominal.description.setups)
    return {
        "folds": fit.folds.count,
        "seed": fit.folds.seed,
        "setups": [names[k] for k in fit.folds.setups],
        "rms": rms,
        "converged": fit.folds.converged,
    }


def _terms(fit: Fit) -> dict[str, object]:
    """Joint terms: what was asked for, the entries, what choosing them found, and where curves hold."""
    part = fit.identification.main_part
    scale, choice = error_scale(part.dimension), fit.terms
    tried = [] if choice is None else choice.tried
    return {
        "asked": None if choice is None else choice.requested,
        "entries": [section.model_dump(mode="json") for section in fit.robot.description.terms],
        "undecided": [section.model_dump(mode="json") for section in fit.undecided.terms] if fit.undecided else [],
        "unit": ERROR_UNIT[part.dimension],
        "tried": [
            {**asdict(trial), "before": scale * trial.before, "after": scale * trial.after, "proven": trial.proven}
            for trial in tried
        ],
        "curves": [
            {
                "joint": curve.joint,
                "unit": DISPLAY_UNIT[curve.dimension],
                "low": float(curve.command[0] * display_scale(curve.dimension)),
                "high": float(curve.command[-1] * display_scale(curve.dimension)),
                "error_unit": ERROR_UNIT[curve.dimension],
                "rms": curve.rms * error_scale(curve.dimension),
                "rms_std": curve.rms_std * error_scale(curve.dimension),
            }
            for curve in joint_curves(fit)
        ],
    }


def instrument_blocks(fit: Fit) -> list[dict[str, object]]:
    """Return one block for each instrument, with errors and noise in the units of its parts."""
    blocks: list[dict[str, object]] = []
    sections = fit.nominal.description.instruments
    for instrument in fit.nominal.instruments:
        parts = []
        offsets = fit.offsets.get(instrument.name, np.zeros(instrument.n_rows))
        for index, part in enumerate(instrument.parts):
            of_part = (n for n in fit.noise if (n.group.name, n.group.part.name) == (instrument.group, part.name))
            noise = next(of_part, None)
            scale = error_scale(part.dimension)
            parts.append(
                {
                    "name": part.name,
                    "unit": ERROR_UNIT[part.dimension],
                    "sigma": None if noise is None else scale * noise.sigma,
                    "sigma_weighed": [scale * float(size) for size in offsets[np.equal(instrument.part_of_row, index)]],
                    "sigma_stated": None if noise is None or noise.stated is None else scale * noise.stated,
                    "degrees_of_freedom": None if noise is None else noise.freedom,
                    "errors": {
                        label: errors.tables()[instrument.name][part.name]
                        for label, errors in error_sets(fit)
                        if instrument.name in errors.tables()
                    },
                }
            )
        n_readings = len(fit.identification.data.readings.get(instrument.name, ()))
        kind = sections[instrument.name].kind if sections else "position"  # none is listed: those of every target
        blocks.append({"name": instrument.name, "kind": kind, "n_readings": n_readings, "parts": parts})
    return blocks


def _error_scale(errors: ErrorSet | None, outlier: Outlier) -> float:
    if errors is None:
        return 1.0
    instrument = next(instrument for instrument in errors.instruments if instrument.name == outlier.target)
    return error_scale(instrument.parts[0].dimension)
