"""Result folders of format version 1: robot, uncertainty and noise from the tables that people read.

They hold no measurements that a model could be evaluated with, so that views of them have no readings.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, wraps
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import DataError
from calib.core.base.files import read_text
from calib.core.base.units import DISPLAY_UNIT, ERROR_UNIT, from_unit, per_si
from calib.core.data.parameter_files import read_parameters
from calib.core.data.tables import Table, read_table
from calib.core.fitting.estimates import Covariance, Estimate, Estimates
from calib.core.judging.promise import Promise
from calib.core.judging.verdict import JudgedFit
from calib.core.results.loaded_result import LoadedResult, reading_keys
from calib.core.results.saved_fit import require_unchanged
from calib.core.robots.accuracy_of_files import Accuracy, FileRobot, Holds, PoseUse
from calib.core.robots.robot import Robot
from calib.core.robots.robot_files import without_terms
from calib.core.robots.terms.terms import stored_terms
from calib.core.rows.prediction import ParameterUncertainty, UndecidedTerms

_AGAIN = "run the fit again"
Answer = TypeVar("Answer")


def _readable(read: Callable[..., Answer]) -> Callable[..., Answer]:
    """Decorate a reader: content that no fit wrote is an error in one line."""

    @wraps(read)
    def reading(self: Any, *words: Any) -> Answer:
        try:
            return read(self, *words)
        except (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError) as error:
            where = getattr(self, "path", self)
            raise DataError(f"{where}: is a damaged result of format version 1 ({error!r}); {_AGAIN}") from None

    return reading


@_readable
def read_content(folder: Path | str) -> dict[str, Any]:
    """Return `result.json` of a folder of version 1, or raise `DataError` if it is missing or broken."""
    path = Path(folder) / "result.json"
    if not path.exists():
        raise DataError(f"{folder}: holds no result (no result.json); give the folder that `calib fit --out` wrote")
    try:
        content: Any = json.loads(read_text(path, "a result that `calib fit` wrote", DataError))
    except (ValueError, RecursionError) as error:
        raise DataError(f"{path}: cannot be read ({error}); {_AGAIN}") from None
    if not isinstance(content, dict) or content.get("version") != 1:
        raise DataError(f"{path}: is not a result of format version 1 (fit.npz of a later one is missing); {_AGAIN}")
    require_unchanged(folder, content["sha256"])
    verdict, terms = content["verdict"], content["joint_terms"]
    if verdict["grade"] not in ("PASS", "CHECK", "FAIL") or (verdict["grade"] == "FAIL" and not verdict["reasons"]):
        raise DataError(f"{path}: is a damaged result of format version 1 (its verdict); {_AGAIN}")
    stored_terms(terms["entries"] if terms["asked"] is not None else ())
    dict(content["errors"]), [row["name"] for row in content["parameters"]], int(content["n_poses"])
    return content


@_readable
def calibrated_robot(folder: str, robot: Robot, content: dict[str, Any]) -> Robot:
    """Return the calibrated robot from the nominal one, which has its joint terms."""
    values = read_parameters(Path(folder) / "parameters.csv", robot, complete=True)
    found = robot.with_parameters(values)
    return replace(found, files={holds: _file_robot(folder, entry, holds, found) for holds, entry in _files(content)})


def _files(content: dict[str, Any]) -> list[tuple[Holds, dict[str, Any]]]:
    return [(Holds[entry["holds"].upper()], entry) for entry in content.get("files") or ()]


def _file_robot(folder: str, entry: dict[str, Any], holds: Holds, robot: Robot) -> FileRobot:
    errors = [np.nan if entry[key] is None else float(entry[key]) for key in ("rms_nominal", "rms", "limit95")]
    zeros, name = entry["joint_zeros"] or (), entry["values"]
    before, rms, limit95 = (from_unit(error, ERROR_UNIT[entry["dimension"]]) for error in errors)
    poses, number, part = PoseUse[entry["poses"].upper()], int(entry["n_poses"]), str(entry["part"])
    accuracy = Accuracy(poses, number, part, entry["dimension"], before, rms, limit95)
    if zeros:
        signs = np.array([float(zero["sign"]) for zero in zeros])
        units = [DISPLAY_UNIT[robot.mechanism.dimensions[zero["joint"]]] for zero in zeros]
        offsets = np.array([from_unit(float(zero["offset"]), unit) for zero, unit in zip(zeros, units, strict=True)])
        return FileRobot({}, accuracy, entry["withheld"] or "", signs, offsets)
    values = robot.values_by_name
    if name is not None:
        values = read_parameters(Path(folder) / f"{name}.csv", without_terms(robot, holds), complete=True)
    return FileRobot(values, accuracy, entry["withheld"] or "")


@dataclass(frozen=True, eq=False, repr=False)
class EarlierResult(LoadedResult):
    """A result of format version 1."""

    @property
    def fit(self) -> JudgedFit:
        """Raise `DataError`, because this version has no fit."""
        raise DataError(f"{self.path}: an earlier version wrote it, without the measurements; {_AGAIN}")

    @property
    @_readable
    def parameters(self) -> Estimates:
        """Parameters in the form of `result.json`."""
        estimates = {}
        for row, p, value in zip(self.content["parameters"], self.robot.parameters, self.robot.values, strict=True):
            std, low, high = (np.nan if row[key] is None else float(row[key]) for key in ("std", "low95", "high95"))
            numbers = (p.nominal_si, float(value), std / p.per_si, (high - low) / 2 / p.per_si)
            estimates[p.name] = Estimate(p.name, p.unit, *numbers, row["status"], p.family, p.per_si)
        return Estimates(estimates)

    @cached_property
    def uncertainty(self) -> ParameterUncertainty:
        """Uncertainty of the parameters, from `covariance.csv`."""
        return self._uncertainty(self.robot, "covariance.csv", self.content, self._undecided_terms())

    @property
    def covariance(self) -> Covariance:
        """Covariance of the free parameters, from `covariance.csv`."""
        return Covariance(self.free_names, self.uncertainty.covariance)

    def _uncertainty_of(self, robot: Robot) -> ParameterUncertainty:
        if np.array_equal(robot.values, self.robot.values):
            return self.uncertainty
        name, entry = next(
            (f"{entry['values']}_covariance.csv", entry)
            for holds, entry in _files(self.content)
            if entry["values"] and np.array_equal(self.robot.held_by(holds).values, robot.values)
        )
        return self._uncertainty(robot, name, entry, None)

    @_readable
    def _uncertainty(
        self, robot: Robot, name: str, own: dict[str, Any], undecided: UndecidedTerms | None
    ) -> ParameterUncertainty:
        names, scale, covariance = self._matrix(name, robot)
        freedom, joint_error = float(own["interval_degrees_of_freedom"]), float(own.get("joint_error", 0.0))
        factor = float(scipy.special.stdtrit(freedom, 0.975))
        if not np.isfinite(factor) or joint_error < 0 or covariance.shape != (len(names), len(names)):
            raise ValueError(f"the numbers in {name}, or the degrees of freedom, are wrong")
        free = np.array([p.name in names for p in robot.parameters])
        return ParameterUncertainty(free, covariance / scale[:, None] / scale, factor, undecided, joint_error)

    def _matrix(self, name: str, robot: Robot) -> tuple[list[str], FloatArray, FloatArray]:
        """Names of parameters (n,), their units over SI (n,), and numbers (n, m) of a table of parameters."""
        table, by_name = read_table(Path(self.path) / name), {p.name: p for p in robot.parameters}
        names = table.text("parameter")
        units = zip(names, table.text("unit"), strict=True)
        scale = np.array([per_si(unit, by_name[own].dimension, f"{table.path}, '{own}'") for own, unit in units])
        numbers = np.array([[float(cell) for cell in row[2:]] for row in table.rows])
        if not np.all(np.isfinite(numbers)):
            raise ValueError(f"{name} holds no numbers")
        return names, scale, numbers

    @_readable
    def _undecided_terms(self) -> UndecidedTerms | None:
        entries = self.content["joint_terms"].get("undecided")
        if not entries:
            return None
        terms = stored_terms(entries)
        whole = self.robot.with_terms((*self.robot.description.terms, *terms))
        names, scale, spread = self._matrix("undecided_terms.csv", whole)
        return UndecidedTerms(terms, tuple(names), spread / scale[:, None])

    @cached_property
    def _residuals(self) -> Table:
        return read_table(Path(self.path) / "residuals.csv")

    def _joints(self) -> FloatArray:
        table, dimensions = self._residuals, self.robot.mechanism.dimensions
        return np.stack([table.column(name, dimensions[name]) for name in self.robot.joint_names], axis=1)

    @property
    @_readable
    def joints(self) -> FloatArray:
        """Joint values of the fitted visits, from `residuals.csv`, (n, n_actuated) [m or rad]."""
        return self._joints()[np.array(self._residuals.text("set")) == "identification"]

    @_readable
    def readings(self) -> dict[str, dict[bytes, float]]:
        """Return the readings, from `residuals.csv`."""
        table, joints = self._residuals, self._joints()
        sets, targets = np.array(table.text("set")), np.array(table.text("target"))
        errors = [k for k, name in enumerate(table.names) if name.startswith("error_after_")]
        first, same = errors[0], [k for k in errors if table.units[k] == table.units[errors[0]]]
        sums = (sum(float(row[k] or 0) ** 2 for k in same) if row[first] else np.nan for row in table.rows)
        squares = np.array(list(sums))
        result: dict[str, dict[bytes, float]] = {str(name): {} for name in dict.fromkeys(sets)}
        for name in dict.fromkeys(targets.tolist()):
            instrument = self.robot.instrument(name)
            heads = {column: f"measured_{column.name.removeprefix(f'{name}_')}" for column in instrument.columns()}
            cells = {c.name: table.column(head, c.dimension, gaps=True) for c, head in heads.items()}
            values = instrument.values(cells)
            values = np.broadcast_to(values, (len(sets), values.shape[1]))
            for label, own in result.items():
                rows = np.flatnonzero((sets == label) & (targets == name))
                own.update(zip(reading_keys(name, joints[rows], values[rows]), squares[rows].tolist(), strict=True))
        return result

    @property
    def rms(self) -> float:
        """Root mean square error after calibration [SI], from `result.json`."""
        name = next(name for name in ("validation", "cross_validation", "identification") if name in self.errors)
        blocks = {block["name"]: [part["name"] for part in block["parts"]] for block in self.content["instruments"]}
        read = [part for name in blocks for part in self.robot.instrument(name).parts if part.name in blocks[name]]
        part, shown = next((p for p in read if p.is_position), read[0]), self.errors[name]["after"]["rms"]
        return np.nan if shown is None else from_unit(float(shown), ERROR_UNIT[part.dimension])

    @property
    @_readable
    def promise(self) -> Promise:
        """The promise, from `result.json` and the poses of `residuals.csv`."""
        content, sigma = self.content, dict[tuple[str, str], float]()
        for block in content["instruments"]:
            instrument = self.robot.instrument(block["name"])
            units = {part.name: ERROR_UNIT[part.dimension] for part in instrument.parts}
            for part in block["parts"]:
                if part["sigma"] is not None:
                    sigma[instrument.group, part["name"]] = from_unit(float(part["sigma"]), units[part["name"]])
        shared = 1.0 if content["shared"] is None else float(content["shared"])
        numbers = (float(content["degrees_of_freedom"]), sigma, shared, float(content["effective_parameters"]))
        names = np.array(self._residuals.text("pose"))[np.array(self._residuals.text("set")) == "identification"]
        return Promise(self.robot, self.uncertainty, *numbers, self.joints, tuple(names.tolist()))
