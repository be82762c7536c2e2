"""The result folder: what a fit found, in files that people and programs read, and reading it back.

`result.json` holds everything in mm and degrees; unknown numbers are null, never zero. The calibrated robot is rebuilt
from `parameters.csv` and the nominal description, so it is the same to the last digits.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import numpy as np

from calib.errors import DataError
from calib.files import write_folder
from calib.fit import ErrorSet, Fit
from calib.parameter_files import format_parameters, read_parameters
from calib.robot import Robot
from calib.tables import format_table
from calib.units import DISPLAY_UNIT, PER_SI
from calib.version import PROGRAM

FORMAT_VERSION = 1
REPORTS = "calib.reports"
"""Entry point group of page writers: name -> callable(result) returning file name -> content."""


def to_dict(fit: Fit) -> dict[str, object]:
    """Return the content of `result.json`; see the contract in docs."""
    errors = {"identification": fit.identification.table()}
    if fit.validation is not None:
        errors["validation"] = fit.validation.table()
    data = fit.identification.data
    return _plain(
        {
            "version": FORMAT_VERSION,
            "program": PROGRAM,
            "robot": fit.nominal.path,
            "converged": True,
            "message": fit.message,
            "seconds": fit.seconds,
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
            "repeatability": data.repeatability(),
            "observability": fit.observability,
            "parameters": parameter_rows(fit),
            "errors": errors,
        }
    )


def parameter_rows(fit: Fit) -> list[dict[str, object]]:
    """Return one row per parameter, in its display unit; uncertainties of held parameters are NaN."""
    rows: list[dict[str, object]] = []
    status = iter(fit.statistics.status())
    uncertainty = iter(zip(fit.statistics.std, fit.statistics.half_width, strict=True))
    for parameter, value, free in zip(fit.nominal.parameters, fit.robot.values, fit.free, strict=True):
        scale = PER_SI[parameter.dimension][parameter.unit]
        std, half = next(uncertainty) if free else (math.nan, math.nan)
        rows.append(
            {
                "name": parameter.name,
                "unit": parameter.unit,
                "nominal": parameter.nominal * scale,
                "value": float(value) * scale,
                "std": float(std) * scale,
                "low95": float(value - half) * scale,
                "high95": float(value + half) * scale,
                "status": next(status) if free else "held",
            }
        )
    return rows


def save(fit: Fit, folder: Path | str) -> None:
    """Write result.json, calibrated.urdf, parameters.csv, residuals.csv, and the pages of installed report writers.

    Raises:
        InputError: The folder cannot be written; what was there is untouched.
    """
    files = {
        "result.json": (json.dumps(to_dict(fit), indent=1, allow_nan=False, ensure_ascii=False) + "\n").encode(),
        "calibrated.urdf": fit.robot.calibrated_urdf(),
        "parameters.csv": format_parameters(fit.robot).encode(),
        "residuals.csv": _residuals(fit).encode(),
    }
    for entry in entry_points(group=REPORTS):
        write: Callable[[Fit], dict[str, bytes]] = entry.load()
        files.update(write(fit))
    write_folder(folder, files)


def load_calibrated(folder: Path | str, robot: Robot) -> Robot:
    """Return `robot` with the parameters of a result folder.

    Raises:
        DataError: The folder holds no result, or one of another robot.
    """
    content = read_result(folder)
    names = [row["name"] for row in content["parameters"]]
    if names != [parameter.name for parameter in robot.parameters]:
        raise DataError(f"{folder}: is the result of another robot ({content['robot']}); its parameters differ")
    return robot.with_parameters(read_parameters(Path(folder) / "parameters.csv", robot))


def read_result(folder: Path | str) -> dict[str, Any]:
    """Return `result.json` of a result folder as a dictionary.

    Raises:
        DataError: Missing, broken, or of another version.
    """
    path = Path(folder) / "result.json"
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise DataError(
            f"{folder}: holds no result (no result.json); give the folder that `calib fit --out` wrote"
        ) from None
    except (OSError, ValueError) as error:
        raise DataError(f"{path}: cannot be read ({error})") from None
    if not isinstance(content, dict) or content.get("version") != FORMAT_VERSION:
        raise DataError(f"{path}: is not a result of format version {FORMAT_VERSION}; run the fit again")
    return content


def _residuals(fit: Fit) -> str:
    """One row per pose and target: joints, measured and predicted positions, errors before and after, [mm], [deg]."""
    sets = [("identification", fit.identification)]
    if fit.validation is not None:
        sets.append(("validation", fit.validation))
    robot = fit.robot
    columns: dict[str, list[object]] = {"set": [], "pose": [], "target": [], "readings": []}
    for label, found in sets:
        for k in range(len(found.data)):
            for t, target in enumerate(robot.target_names):
                _residual_row(columns, fit, label, found, k, t, target)
    return format_table(list(columns.items()))


def _residual_row(
    columns: dict[str, list[object]], fit: Fit, label: str, found: ErrorSet, k: int, t: int, target: str
) -> None:
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
    row["over_sigma"] = float(
        np.linalg.norm(found.after[k, t]) * np.sqrt(found.data.counts[k]) / fit.statistics.sigma
        if fit.statistics.sigma > 0
        else math.nan
    )
    row["loop_singular_value"] = float(found.singular_value[k])
    for header, value in row.items():
        columns.setdefault(header, []).append(value)


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
