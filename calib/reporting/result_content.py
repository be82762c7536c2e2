"""The content of a result in mm and degrees: dictionaries for `result.json`, tables for the files beside it."""

from __future__ import annotations

import math
from dataclasses import asdict

import numpy as np

from calib.data.repeats import repeats
from calib.data.tables import format_table
from calib.identification.fitted import ErrorSet, Fit
from calib.linearisation.prediction import PositionUncertainty
from calib.numerics.outliers import Outlier
from calib.numerics.statistics import status
from calib.units import DISPLAY_UNIT, PER_SI
from calib.version import PROGRAM

FORMAT_VERSION = 1
CORRELATED = 0.95
"""Correlation coefficients from here on are listed."""


def to_dict(fit: Fit, *, forced: bool = False) -> dict[str, object]:
    """Return the content of `result.json`; see the contract in docs.

    Args:
        fit: The fit.
        forced: Whether a failed result is exported all the same.
    """
    data = fit.identification.data
    return _plain(
        {
            "version": FORMAT_VERSION,
            "program": PROGRAM,
            "robot": fit.nominal.path,
            "data": data.path,
            "comments": comments(fit),
            "verdict": fit.verdict.to_dict(forced=forced),
            "converged": fit.converged,
            "message": fit.message,
            "seconds": fit.seconds,
            "seed": fit.seed,
            "n_poses": len(data),
            "n_rows": data.n_rows,
            "n_parameters": int(np.sum(fit.free)),
            "rank": fit.rank.rank,
            "rank_all": fit.rank_all.rank,
            "n_parameters_all": len(fit.free),
            "smallest_singular_value_kept": fit.rank_all.smallest_kept,
            "largest_singular_value_dropped": fit.rank_all.largest_dropped,
            "redundant": list(fit.nominal.description.held),
            "sigma": fit.statistics.sigma,
            "sigma_stated": fit.sigma_stated,
            "degrees_of_freedom": fit.statistics.freedom,
            "effective_parameters": fit.statistics.effective_parameters,
            "chi_square": None if fit.chi_square is None else asdict(fit.chi_square),
            "repeatability": data.repeatability(),
            "repeats": repeat_table(fit.identification),
            "repeats_validation": None if fit.validation is None else repeat_table(fit.validation),
            "observability": fit.observability,
            "parameters": parameter_rows(fit),
            "correlations": correlated(fit),
            "errors": {name: found.table() for name, found in error_sets(fit)},
            "position_uncertainty": position_uncertainty_table(fit),
            "loss": fit.loss,
            "outliers": outlier_rows(fit),
            "excluded": [_outlier(fit.with_all, "identification", found) for found in fit.excluded],
            "with_excluded": _with_excluded(fit),
            "patterns": [asdict(pattern) for pattern in fit.patterns],
            "starts": _starts(fit),
            "cross_validation": _folds(fit),
        }
    )


def comments(fit: Fit) -> list[str]:
    """Return what the measurement files say about themselves, each line once."""
    files = [fit.identification.data] + ([] if fit.validation is None else [fit.validation.data])
    return list(dict.fromkeys(line for data in files for line in data.comments))


def error_sets(fit: Fit) -> list[tuple[str, ErrorSet]]:
    """Return every set of poses with errors, by name."""
    sets = [("identification", fit.identification)]
    if fit.validation is not None:
        sets.append(("validation", fit.validation))
    if fit.folds is not None:
        sets.append(("cross_validation", fit.folds.errors))
    return sets


def parameter_rows(fit: Fit) -> list[dict[str, object]]:
    """Return one row per parameter, in its display unit; uncertainties of held parameters are NaN."""
    rows: list[dict[str, object]] = []
    found = fit.statistics
    uncertainty = iter(zip(found.std, found.half_width, found.data_share, strict=True))
    for parameter, value, free in zip(fit.nominal.parameters, fit.robot.values, fit.free, strict=True):
        scale = PER_SI[parameter.dimension][parameter.unit]
        std, half, share = next(uncertainty) if free else (math.nan, math.nan, math.nan)
        kind = status(share, std / parameter.sigma, prior=parameter.prior, placement=parameter.placement)
        rows.append(
            {
                "name": parameter.name,
                "unit": parameter.unit,
                "nominal": parameter.nominal * scale,
                "value": float(value) * scale,
                "std": float(std) * scale,
                "low95": float(value - half) * scale,
                "high95": float(value + half) * scale,
                "status": kind if free else "held",
            }
        )
    return rows


def correlated(fit: Fit) -> list[dict[str, object]]:
    """Return pairs of free parameters whose estimates move together, strongest first."""
    found = fit.statistics.correlations()
    names = fit.free_names
    with np.errstate(invalid="ignore"):
        pairs = np.argwhere(np.triu(np.abs(found) >= CORRELATED, k=1))
    rows = [{"a": names[i], "b": names[j], "correlation": float(found[i, j])} for i, j in pairs]
    return sorted(rows, key=lambda row: -abs(float(str(row["correlation"]))))


def repeat_table(errors: ErrorSet) -> dict[str, object] | None:
    """Return ISO 9283-style accuracy and repeatability [mm]; None without repeats."""
    found = repeats(errors.data, errors.before, errors.after)
    return None if found is None else found.table()


def position_uncertainty_table(fit: Fit) -> dict[str, object]:
    """Return how sure predicted positions are, over the poses that were used and those that were not [mm]."""
    sets: list[tuple[str, ErrorSet | None, PositionUncertainty | None]] = [
        ("identification", fit.identification, fit.identification_uncertainty),
        ("validation", fit.validation, fit.validation_uncertainty),
    ]
    return {
        name: {**found.summary(), "worst_pose": errors.data.names[found.worst]}
        for name, errors, found in sets
        if found is not None and errors is not None
    }


def outlier_rows(fit: Fit) -> list[dict[str, object]]:
    """Return the outliers of both sets, worst first in each."""
    rows = [_outlier(fit, "identification", outlier) for outlier in fit.outliers]
    return rows + [_outlier(fit, "validation", outlier) for outlier in fit.validation_outliers]


def _outlier(fit: Fit | None, label: str, outlier: Outlier) -> dict[str, object]:
    found = None if fit is None else fit.identification if label == "identification" else fit.validation
    return {
        "set": label,
        "pose": None if found is None else found.data.names[outlier.pose],
        "where": outlier.label,
        "target": outlier.target,
        "distance": 1e3 * outlier.distance,
        "over_noise": outlier.studentised,
        "leverage": outlier.leverage,
        "p_value": outlier.p_value,
    }


def _with_excluded(fit: Fit) -> dict[str, object] | None:
    """The result of all poses, where outliers were left out of the main one."""
    if fit.with_all is None:
        return None
    return {
        "n_poses": len(fit.with_all.identification.data),
        "verdict": fit.with_all.verdict.to_dict(),
        "sigma": fit.with_all.statistics.sigma,
        "parameters": parameter_rows(fit.with_all),
        "errors": {name: found.table() for name, found in error_sets(fit.with_all)},
    }


def _starts(fit: Fit) -> dict[str, object] | None:
    if fit.starts is None:
        return None
    minima = [{"rms": 1e3 * m.rms, "cost": m.cost, "count": m.count} for m in fit.starts.minima]
    return {"count": fit.starts.total, "failed": fit.starts.failed, "seed": fit.starts.seed, "minima": minima}


def _folds(fit: Fit) -> dict[str, object] | None:
    if fit.folds is None:
        return None
    rms = [1e3 * value for value in fit.folds.rms]
    return {"folds": fit.folds.count, "seed": fit.folds.seed, "rms": rms, "converged": fit.folds.converged}


def residual_table(fit: Fit) -> str:
    """Return CSV: one row per pose and target: joints, measured positions, errors before and after [mm], [deg]."""
    sets = [entry for entry in error_sets(fit) if entry[0] != "cross_validation"]
    columns: dict[str, list[object]] = {"set": [], "pose": [], "target": [], "readings": []}
    for label, found in sets:
        for k in range(len(found.data)):
            for t, target in enumerate(fit.robot.target_names):
                for header, value in _residual_row(fit, label, found, k, t, target).items():
                    columns.setdefault(header, []).append(value)
    return format_table(list(columns.items()))


def _residual_row(fit: Fit, label: str, found: ErrorSet, k: int, t: int, target: str) -> dict[str, object]:
    row: dict[str, object] = {
        "set": label,
        "pose": found.data.names[k],
        "target": target,
        "readings": int(found.data.counts[k]),
    }
    for j, joint in enumerate(fit.robot.joint_names):
        dimension = fit.robot.mechanism.dimensions[joint]
        unit = DISPLAY_UNIT[dimension]
        row[f"{joint} [{unit}]"] = float(found.data.joints[k, j] * PER_SI[dimension][unit])
    measured = 1e3 * found.data.positions[k, t]
    for name, errors in (("before", found.before), ("after", found.after)):
        for axis, value in zip("xyz", 1e3 * errors[k, t], strict=True):
            row[f"error_{name}_{axis} [mm]"] = float(value)
    for axis, value in zip("xyz", measured, strict=True):
        row[f"measured_{axis} [mm]"] = float(value)
    sigma = fit.statistics.sigma
    length = np.linalg.norm(found.after[k, t]) * np.sqrt(found.data.counts[k])
    row["over_sigma"] = float(length / sigma) if sigma > 0 else math.nan
    used = label == "identification"
    row["studentised"] = float(fit.studentised.ratio[k, t]) if used else math.nan
    row["leverage"] = float(fit.studentised.leverage[k, t]) if used else math.nan
    row["weight"] = float(fit.weights[k, t]) if used else math.nan
    row["loop_singular_value"] = float(found.singular_value[k])
    return row


def covariance_table(fit: Fit) -> str:
    """Return CSV: the covariance of the free parameters in SI, one row and one column for each."""
    names = fit.free_names
    columns: list[tuple[str, list[object]]] = [("parameter", list(names))]
    columns += [(name, list(column)) for name, column in zip(names, fit.statistics.covariance.T, strict=True)]
    return format_table(columns, ("covariance of the free parameters in SI units (m, rad, and their products)",))


def _plain(value: object) -> dict[str, object]:
    """Replace numbers that JSON cannot hold by null, and numpy numbers by Python's."""

    def walk(item: object) -> object:
        if isinstance(item, dict):
            return {str(key): walk(entry) for key, entry in item.items()}
        if isinstance(item, (list, tuple)):
            return [walk(entry) for entry in item]
        if isinstance(item, (bool, str, int)) or item is None:
            return item
        number = float(item)  # type: ignore[arg-type]
        return number if math.isfinite(number) else None

    result = walk(value)
    assert isinstance(result, dict)
    return result
