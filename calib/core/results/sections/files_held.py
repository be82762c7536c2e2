"""What a result stores of the robots that files get: their values, how sure these are, how good they are.

`result.json` has an entry for each under `files`. Values that are not those of the whole model stand in parameter files
of their own, with their covariance where a fit has one (`without_terms.csv`, `with_tables.csv`, `to_last_axis.csv`), so
that `calib export` needs no measurements. A result of an earlier version has none of it, and loads all the same.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from calib.core.base.errors import DataError
from calib.core.base.units import DISPLAY_UNIT, ERROR_UNIT, Dimension, display_scale, error_scale
from calib.core.data.parameter_files import read_parameters
from calib.core.fitting.fitted import Fit
from calib.core.judging.rules_model import why_no_origins
from calib.core.results.result_format import unchanged
from calib.core.results.sections.grid import Grid, GridColumn, GridNumber
from calib.core.robots.file_formats import formats_that_hold
from calib.core.robots.held import Accuracy, FileRobot, Holds, SeenAt
from calib.core.robots.robot import Robot
from calib.core.robots.robot_files import lost_by, without_terms

VALUES = {Holds.ORIGINS: "without_terms", Holds.TABLES: "with_tables", Holds.TO_LAST_AXIS: "to_last_axis"}
"""Names of files with values of their own, without their ending; a covariance has `_covariance` behind it."""
_WITHHELD = "withheld: "


def files_of(fit: Fit) -> dict[Holds, FileRobot]:
    """Return the robots that files of a fit get, as far as there are such files of this robot."""
    nowhere = () if formats_that_hold(Holds.TO_LAST_AXIS, fit.nominal) else (Holds.TO_LAST_AXIS,)
    known = {holds: fit.robot.files.get(holds) for holds in Holds if holds not in nowhere}
    return {holds: file_robot for holds, file_robot in known.items() if file_robot is not None}


Line = tuple[str, float, float, str]
"""What a file holds, its RMS, its 95 % limit in the unit of errors (NaN where not known), and who is such a file."""


def _worth(fit: Fit) -> tuple[Accuracy, list[Line]] | None:
    """What each kind of file is worth, the nominal robot first and the whole model last, and the latter's accuracy.

    None if files of joint origins hold it all and are written.
    """
    if fit.reduced is None or not (fit.reduced or lost_by(fit.robot, Holds.ORIGINS) or why_no_origins(fit)):
        return None
    files = files_of(fit)
    if Holds.EVERYTHING not in files:
        return None
    whole = files[Holds.EVERYTHING].accuracy
    scale, nominal = error_scale(whole.dimension), files.get(Holds.ORIGINS, files[Holds.EVERYTHING]).accuracy
    lines: list[Line] = [("nominal robot", scale * nominal.before, np.nan, "")]
    for holds in reversed(Holds):
        if holds in files:
            accuracy, formats = files[holds].accuracy, formats_that_hold(holds, fit.nominal)
            withheld = _WITHHELD if formats and files[holds].withheld else ""
            words = withheld + ", ".join(formats)
            if holds is Holds.EVERYTHING:
                words = "; ".join(part for part in ("predict, solve, compensate, view", words) if part)
            lines.append((holds.value, scale * accuracy.rms, scale * accuracy.limit95, words))
    return whole, lines


def files_grid(fit: Fit) -> Grid | None:
    """Return what each kind of file is worth, where some hold less than the whole model; None elsewhere."""
    worth = _worth(fit)
    if worth is None:
        return None
    whole, lines = worth
    unit = ERROR_UNIT[whole.dimension]
    columns = (GridColumn("file holds", "a file holds", words=True), GridColumn("RMS"), GridColumn("95 % limit"))
    return Grid(
        f"What files are worth, {unit} ({whole.part} error, {whole.where})",
        f"What files are worth: {whole.part} error [{unit}], {whole.where}; at one more such pose it stays below the"
        " 95 % limit with a chance of 95 %",
        (*columns, GridColumn("formats", words=True)),
        tuple((holds, GridNumber(rms), GridNumber(limit), formats) for holds, rms, limit, formats in lines),
        last_counts=True,
    )


def files_lines(fit: Fit) -> list[str]:
    """Return what files are worth, in a line, where some hold less than the whole model."""
    worth = _worth(fit)
    if worth is None:
        return []
    whole, lines = worth
    texts = [
        f"{holds} {rms:.4f}{' (withheld)' if formats.startswith(_WITHHELD) else ''}" for holds, rms, _, formats in lines
    ]
    unit = ERROR_UNIT[whole.dimension]
    return [f"What files are worth, {unit} RMS ({whole.part} error, {whole.where}): {'; '.join(texts)}"]


def name_of_values(files: Mapping[Holds, FileRobot], holds: Holds) -> str:
    """Return which of `VALUES` has the values of a file's robot; empty where they are those of the whole model."""
    values, whole = files[holds].values, files[Holds.EVERYTHING].values
    if holds not in VALUES or values == whole:
        return ""
    return VALUES[next(equal for equal in VALUES if equal in files and files[equal].values == values)]


def file_entries(fit: Fit) -> list[dict[str, object]]:
    """Return the entries of `result.json`: what each kind of file holds, which formats do, and how good they are."""
    files, reduced, entries = files_of(fit), fit.reduced or {}, list[dict[str, object]]()
    for holds, file_robot in files.items():
        accuracy, scale = file_robot.accuracy, error_scale(file_robot.accuracy.dimension)
        entries.append(
            {
                "holds": holds.name.lower(),
                "formats": formats_that_hold(holds, fit.nominal),
                "values": name_of_values(files, holds) or None,
                "interval_degrees_of_freedom": reduced[holds].statistics.interval_freedom if holds in reduced else None,
                "joint_error": reduced[holds].joint_error if holds in reduced else None,
                "poses": accuracy.poses.name.lower(),
                "n_poses": accuracy.n_poses,
                "part": accuracy.part,
                "dimension": accuracy.dimension,
                "unit": ERROR_UNIT[accuracy.dimension],
                "rms_nominal": scale * accuracy.before,
                "rms": scale * accuracy.rms,
                "limit95": scale * accuracy.limit95,
                "withheld": file_robot.withheld or None,
                "joint_zeros": _zeros(fit.nominal, file_robot),
            }
        )
    return entries


def _zeros(robot: Robot, file_robot: FileRobot) -> list[dict[str, object]] | None:
    if not len(file_robot.offsets):
        return None
    dimensions = [robot.mechanism.dimensions[name] for name in robot.joint_names]
    rows = zip(robot.joint_names, file_robot.signs, file_robot.offsets, dimensions, strict=True)
    return [
        {"joint": name, "sign": int(sign), "offset": float(offset) * display_scale(d), "unit": DISPLAY_UNIT[d]}
        for name, sign, offset, d in rows
    ]


def file_entry(content: Mapping[str, Any], holds: Holds) -> Mapping[str, Any]:
    """Return the entry of a `result.json` for files that hold so much; an empty one where it has none."""
    entries = content.get("files") or ()
    return next((entry for entry in entries if entry.get("holds") == holds.name.lower()), {})


def stored_files(folder: Path | str, content: Mapping[str, Any], robot: Robot) -> dict[Holds, FileRobot]:
    """Return the robots that files of a result get; none of a result that an earlier version wrote.

    Args:
        folder: Of the result.
        content: Its `result.json`.
        robot: Its robot, calibrated.

    Raises:
        DataError, ParameterError: They cannot be read.
    """
    try:
        entries = {Holds[entry["holds"].upper()]: entry for entry in content.get("files") or ()}
        files = {holds: _stored(Path(folder), entry, holds, robot, content) for holds, entry in entries.items()}
        if content["verdict"]["grade"] == "FAIL":  # who has its files has forced them already
            return {holds: replace(file_robot, withheld="") for holds, file_robot in files.items()}
        return files
    except (AttributeError, KeyError, TypeError, ValueError):
        raise DataError(f"{folder}: the entry `files` of its result.json cannot be read; run the fit again") from None


def _stored(
    folder: Path, entry: Mapping[str, Any], holds: Holds, robot: Robot, content: Mapping[str, Any]
) -> FileRobot:
    dimension: Dimension = entry["dimension"]
    scale = error_scale(dimension)

    def error(key: str) -> float:
        return np.nan if entry[key] is None else float(entry[key]) / scale

    accuracy = Accuracy(
        SeenAt[entry["poses"].upper()],
        int(entry["n_poses"]),
        str(entry["part"]),
        dimension,
        error("rms_nominal"),
        error("rms"),
        error("limit95"),
    )
    rows, zeros = entry["joint_zeros"] or (), np.zeros((2, 0))
    if rows:
        named = {row["joint"]: row for row in rows}
        scales = [display_scale(robot.mechanism.dimensions[name]) for name in robot.joint_names]
        numbers = [(named[name]["sign"], named[name]["offset"]) for name in robot.joint_names]
        zeros = np.array(numbers, dtype=float).T / np.array([np.ones(len(scales)), scales])
    values = {} if rows else _stored_values(folder, entry["values"], holds, robot, content)
    return FileRobot(values, accuracy, entry["withheld"] or "", zeros[0], zeros[1])


def _stored_values(
    folder: Path, name: str | None, holds: Holds, robot: Robot, content: Mapping[str, Any]
) -> dict[str, float]:
    if name is None:
        return dict(zip((p.name for p in robot.parameters), map(float, robot.values), strict=True))
    return read_parameters(unchanged(folder, f"{name}.csv", content), without_terms(robot, holds), complete=True)
