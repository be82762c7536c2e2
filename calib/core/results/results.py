"""The result folder: the results of a fit, in files for people and programs.

`result.json` holds everything in mm and degrees; unknown numbers are null, never zero. It, the tables, the pages and
`calibrated.urdf` are outputs and are not read back. `fit.npz` (`calib.core.results.saved_fit`) and the nominal robot
(`nominal.yaml`, `nominal.urdf`) are read back: so the folder can be moved, and loads like any robot, the same to the
last digits, with joint terms and places. A fit with the verdict FAIL is written without `calibrated.urdf`, and is not
read back as a calibrated robot (`calib.core.results.result_reading`), unless that is forced; then the files say so.
Unless forced, `calibrated.urdf` is not written either where it is worse than the nominal robot.
"""

from __future__ import annotations

import html
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.core.base.arrays import FloatArray, IntArray
from calib.core.base.files import write_folder
from calib.core.base.threads import one_blas_thread
from calib.core.base.units import ERROR_UNIT, in_unit
from calib.core.base.version import PROGRAM
from calib.core.base.words import as_data
from calib.core.data.measurement_columns import header, in_table_unit, joint_columns
from calib.core.data.table_writing import format_table
from calib.core.fitting.error_sets import STATES, ErrorSet
from calib.core.fitting.fitted import Fit
from calib.core.fitting.outliers import studentise_errors
from calib.core.judging import findings
from calib.core.judging.next_step import next_step
from calib.core.judging.reasons import Verdict
from calib.core.judging.repeatability import repeat_table, repeatability
from calib.core.judging.rules_model import why_no_origins
from calib.core.judging.verdict import judge
from calib.core.results.saved_fit import NOMINAL_URDF, NOMINAL_YAML, SAVED, VERSION, saved_bytes
from calib.core.results.sections.budget import budget_table
from calib.core.results.sections.details import contents_table, folds_table, starts_table
from calib.core.results.sections.determination import correlated_pairs, position_uncertainty_table, rank_content
from calib.core.results.sections.files_held import file_entries, files_of
from calib.core.results.sections.noise import instrument_blocks
from calib.core.results.sections.outliers import (
    excluded_rows,
    outlier_rows,
    residual_places,
    residual_sets,
    with_excluded,
)
from calib.core.results.sections.parameters import parameter_rows
from calib.core.results.sections.terms import terms_table
from calib.core.results.urdf import urdf_bytes
from calib.core.robots.accuracy_of_files import Holds
from calib.core.robots.description import description_yaml
from calib.core.robots.file_formats import loses, remarks_on_file, robot_for
from calib.core.robots.urdf.meshes import find_mesh
from calib.core.robots.urdf.text import UrdfText, apply_edits
from calib.core.rows.rows import Rows

_URDF = "calibrated.urdf"
_PARAMETER_COLUMNS = ("name", "nominal", "value", "std", "low95", "high95", "unit", "status")
_FILE = re.compile(rb"""\bfilename\s*=\s*(?:"([^"]*)"|'([^']*)')""")
_PAGES = ("report.html", "viewer.html")
_VERSION_1 = ("undecided_terms.csv", *(f"{name}{end}.csv" for name in ("without_terms", "with_tables", "to_last_axis")
              for end in ("", "_covariance")))  # fmt: skip
_NOT_ALWAYS = (_URDF, *_PAGES, *_VERSION_1)
"""Files that a new result replaces or removes."""
_ALWAYS = ("result.json", SAVED, "parameters.csv", "covariance.csv", "residuals.csv", NOMINAL_YAML, NOMINAL_URDF)
RESULT_FILES = (*_ALWAYS, *_NOT_ALWAYS)
"""Files of a fit that a result folder may hold."""


@one_blas_thread
def save(fit: Fit, folder: Path | str, *, force: bool = False, pages: Mapping[str, bytes] | None = None) -> None:
    """Write the files of the module docstring, and pages.

    A failed fit gets no `calibrated.urdf`. An old `calibrated.urdf`, and pages, are removed where they are not written
    again.

    Args:
        folder: Folder to write; files of other names in it stay.
        force: Whether to export a failed fit, with a remark in its files, and to replace files of other programs.
        pages: Further files for people, name -> content.

    Raises:
        InputError: The folder cannot be written, or holds files of these names that are not to be replaced.
    """
    verdict = judge(fit)
    failed = verdict.grade == "FAIL"
    nominal = {
        NOMINAL_YAML: description_yaml(fit.nominal.description.model_copy(update={"urdf": NOMINAL_URDF})).encode(),
        NOMINAL_URDF: _with_meshes(fit.nominal.urdf),
    }
    remark = _failure_comment(verdict, "not to be used") if failed else []
    content = to_dict(fit, forced=failed and force)
    files = {
        "result.json": (json.dumps(content, indent=1, allow_nan=False, ensure_ascii=False) + "\n").encode(),
        "parameters.csv": _parameter_table(fit, remark).encode(),
        "covariance.csv": _covariance_table(fit).encode(),
        "residuals.csv": _residual_table(fit),
        **nominal,
        SAVED: saved_bytes(fit, content, nominal, files_of(fit)),
    }
    if force or not (failed or why_no_origins(fit)):
        files[_URDF] = _calibrated_urdf(fit, _failure_comment(verdict, "exported by force") if failed else [])
    files |= pages or {}
    sources = (fit.nominal.path, fit.nominal.urdf.path, fit.identification.data.path)
    write_folder(folder, files, sorted(set(_NOT_ALWAYS) - set(files)), inputs=sources, force=force)


@one_blas_thread
def to_dict(fit: Fit, *, forced: bool = False) -> dict[str, object]:
    """Return the content of `result.json`; `forced` says whether a failed result is exported nevertheless."""
    data = fit.identification.data
    files = [data] if fit.validation is None else [data, fit.validation.data]
    return as_data(
        {
            "version": VERSION,
            "program": PROGRAM,
            "robot": fit.nominal.path,
            "data": data.path,
            "comments": list(dict.fromkeys(line for one in files for line in one.comments)),
            "verdict": judge(fit).to_dict(forced=forced),
            "next": str(next_step(fit)),
            "converged": fit.converged,
            "message": fit.message,
            "seconds": fit.seconds,
            "seed": fit.seed,
            "n_poses": data.n_poses,
            "n_rows": len(data),
            "n_readings": data.n_readings,
            **rank_content(fit),
            "sigma": fit.sigma,
            "sigma_stated": fit.sigma_stated,
            "degrees_of_freedom": fit.statistics.freedom,
            "effective_parameters": fit.statistics.effective_parameters,
            "chi_square": None if fit.chi_square is None else asdict(fit.chi_square),
            "interval_degrees_of_freedom": fit.statistics.interval_freedom,
            "widened": fit.interval_factor,
            "joint_error": fit.joint_error,
            "shared": None if fit.statistics.shared_scatter is None else fit.statistics.shared_scatter.ratio,
            "repeatability": repeatability(fit.identification)[0],
            "repeats": repeat_table(fit.identification),
            "repeats_validation": None if fit.validation is None else repeat_table(fit.validation),
            "observability": fit.observability,
            "parameters": parameter_rows(fit),
            "correlations": correlated_pairs(fit),
            "errors": fit.errors,
            "instruments": instrument_blocks(fit),
            "error_budget": budget_table(fit),
            "position_uncertainty": position_uncertainty_table(fit),
            "contains": contents_table(fit),
            "loss": fit.loss,
            "outliers": outlier_rows(fit),
            "excluded": excluded_rows(fit),
            "with_excluded": with_excluded(fit),
            "patterns": [asdict(pattern) for pattern in findings.patterns(fit)],
            "starts": starts_table(fit),
            "cross_validation": folds_table(fit),
            "joint_terms": terms_table(fit),
            "files": file_entries(fit),
        }
    )


def _calibrated_urdf(fit: Fit, remarks: list[str]) -> bytes:
    """The URDF, with a comment only if it holds less than the robot, or is forced."""
    lines = remarks_on_file(fit.robot, Holds.ORIGINS) if loses(fit.robot, Holds.ORIGINS) else []
    return urdf_bytes(robot_for(fit.robot, "urdf", force=True), [*remarks, *lines] or None)


def _with_meshes(urdf: UrdfText) -> bytes:
    """The URDF with the full paths of meshes that are named relative to it, or to a package."""
    edits = []
    for match in _FILE.finditer(urdf.source):
        group = 1 if match.group(1) is not None else 2
        name = html.unescape(match.group(group).decode("utf-8", "replace"))
        mesh = find_mesh(name, urdf.path)
        if mesh is not None and not Path(name).is_absolute():
            text = html.escape(str(mesh)).encode("ascii", "xmlcharrefreplace")
            edits.append((*match.span(group), text))
    return apply_edits(urdf.source, edits)


def _failure_comment(verdict: Verdict, how: str) -> list[str]:
    return [f"verdict: FAIL, {how}:", *(f"  {reason.text}" for reason in verdict.reasons if reason.grade == "FAIL")]


def _residual_table(fit: Fit) -> bytes:
    """Return CSV, one row per reading: joints, reading, errors before and after [mm], [mrad], [deg].

    A cell is empty where there is no number: of unfitted readings, of robots without loops. The last set is that of
    readings left out as outliers.
    """
    blocks: list[tuple[IntArray, dict[str, Sequence[object] | FloatArray]]] = []
    count, sets = 0, residual_sets(fit)
    for label, place in residual_places(sets).items():
        error_set, rows = sets[label]
        count += len(place)
        by_instrument = [(place[rows.layout.readings_of(name)], name) for name in rows.layout.instruments]
        blocks += [(places, _residual_columns(fit, label, error_set, rows, name)) for places, name in by_instrument]
    blocks.sort(key=lambda block: int(np.min(block[0], initial=count)))
    if len(blocks) == 1 and np.array_equal(blocks[0][0], np.arange(count)):
        return format_table(list(blocks[0][1].items())).encode()
    columns: dict[str, NDArray[Any]] = {}
    for places, block in blocks:
        for head, values in block.items():
            if isinstance(values, np.ndarray):
                column = columns.setdefault(head, np.full(count, np.nan))
                column[places] = values
            else:
                column = columns.setdefault(head, np.full(count, "", dtype=object))
                column[places] = np.fromiter(values, dtype=object, count=len(places))
    return format_table(list(columns.items())).encode()


def _residual_columns(
    fit: Fit, label: str, error_set: ErrorSet, rows: Rows, name: str
) -> dict[str, Sequence[object] | FloatArray]:
    used = label == "identification"
    studentised = studentise_errors(fit)
    layout, factor = rows.layout, float(np.sqrt(np.mean(fit.statistics.factors.values**2))) if used else 1.0
    instrument = fit.nominal.instrument(name)
    of_instrument = layout.readings_of(name)
    readings = error_set.data.readings[name]
    visits, n = layout.visit[of_instrument], len(readings)
    columns: dict[str, Sequence[object] | FloatArray] = {
        "set": [label] * n,
        "pose": [error_set.data.names[k] for k in visits],
        "target": [name] * n,
    }
    setups, n_pairs = list(fit.nominal.description.setups), len(fit.nominal.pairs[instrument.name])
    if setups and n_pairs:  # errors are in the measurement frame of their setup
        columns["setup"] = [setups[pair * len(setups) // n_pairs] for pair in readings.pairs]
    columns |= {f"looked_at_{key}": words for key, words in instrument.texts(readings.pairs, readings.details).items()}
    columns |= joint_columns(fit.robot, error_set.data.joints[visits])
    axes = [(axis, part.dimension) for part in instrument.parts for axis in part.axes]
    for state in STATES:
        for (axis, dimension), errors in zip(axes, getattr(error_set, state)[name].T, strict=True):
            columns[f"error_{state}_{axis} [{ERROR_UNIT[dimension]}]"] = in_unit(errors, ERROR_UNIT[dimension])
    dimensions = {column.name: column.dimension for column in instrument.columns()}
    for column, numbers in instrument.cells(readings.values).items():
        head = header(f"measured_{column.removeprefix(f'{name}_')}", dimensions[column])
        columns[head] = in_table_unit(numbers, dimensions[column])
    lengths = rows.distances()[of_instrument] / max(factor, 1e-30) / np.sqrt(np.maximum(layout.width[of_instrument], 1))
    unknown = np.full(n, np.nan)
    judgements = {
        "over_sigma": lengths if factor > 0 else unknown,
        "studentised": studentised.ratio[of_instrument] if used else unknown,
        "leverage": studentised.leverage[of_instrument] if used else unknown,
        "weight": fit.weights[of_instrument] if used else unknown,
        "loop_singular_value": error_set.singular_value[visits],
    }
    return columns | judgements


def _parameter_table(fit: Fit, comments: Sequence[str]) -> str:
    rows = fit.parameters.rows()
    columns = [("parameter" if key == "name" else key, [row[key] for row in rows]) for key in _PARAMETER_COLUMNS]
    return format_table(columns, comments)


def _covariance_table(fit: Fit) -> str:
    """Return CSV: the covariance of the free parameters in their display units, one row and one column for each.

    The hundreds of coefficients of curves are left out, as in the report.
    """
    free = [estimate for estimate, use in zip(fit.parameters.values(), fit.free, strict=True) if use]
    places = [k for k, estimate in enumerate(free) if not estimate.family]
    free = [free[k] for k in places]
    scale = np.array([estimate.per_si for estimate in free])
    shown = np.asarray(fit.covariance)[np.ix_(places, places)] * np.multiply.outer(scale, scale)
    columns: list[tuple[str, list[str] | FloatArray]] = [
        ("parameter", [estimate.name for estimate in free]),
        ("unit", [estimate.unit for estimate in free]),
        *((estimate.name, column) for estimate, column in zip(free, shown.T, strict=True)),
    ]
    return format_table(columns, ("covariance of the free parameters: unit of the row times unit of the column",))
