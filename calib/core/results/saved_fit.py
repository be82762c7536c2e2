"""The saved fit of a result folder, `fit.npz`, and the fit restored from it.

It holds what cannot be computed: description, measurements, settings, end values, assumed noise, verdict, and the
robots of files. Everything else (residuals, covariance, intervals) comes from evaluating the model once at the end
values, as in `calib.core.fitting.fit`. So both are equal up to rounding, and the file is no larger than the
measurements. Other starts, and trials of joint terms, stand in `result.json` and are not restored.

The file is a zip of NumPy arrays (`numpy.load` reads it), without pickle. Its entry `content` is JSON in UTF-8; an
array in it is `{"array": k}`, stored in the entry named k. The zip has a checksum of every entry, so that a damaged
file is never read as other numbers.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.core.base.errors import CalibrationError, ComputationError, DataError
from calib.core.base.threads import one_blas_thread
from calib.core.base.version import PROGRAM
from calib.core.data.measurements import Measurements
from calib.core.fitting.error_sets import ErrorSet, Folds
from calib.core.fitting.fit import Minimum, fit_at
from calib.core.fitting.fitted import Fit
from calib.core.fitting.outliers import Outlier
from calib.core.fitting.pose_checks import require_identifiable
from calib.core.fitting.problem import Problem
from calib.core.fitting.robust import RobustSolution
from calib.core.fitting.settings import RequestedOptions, Settings
from calib.core.fitting.solved_fit import Convergence
from calib.core.fitting.solving import reset_unseen
from calib.core.fitting.terms.candidate_terms import TermChoice
from calib.core.fitting.unexplained import UnexplainedErrors
from calib.core.instruments.kind import Readings
from calib.core.judging.verdict import JudgedFit
from calib.core.numerics.least_squares import LeastSquaresSolution
from calib.core.numerics.statistics import Factors
from calib.core.robots.accuracy_of_files import Accuracy, FileRobot, Holds, PoseUse
from calib.core.robots.robot import Robot
from calib.core.robots.terms.terms import stored_terms
from calib.core.rows.prediction import UndecidedTerms

VERSION = 2
"""Version of the format of a result folder."""
SAVED = "fit.npz"
"""File of a result folder that is read back."""
NOMINAL_YAML, NOMINAL_URDF = "nominal.yaml", "nominal.urdf"
"""Files of the nominal robot in a result folder."""
_MEASUREMENTS = ("joints", "labels", "names", "path", "ignored", "comments", "context", "approach", "setups", "order",
                 "approach_assumed")  # fmt: skip
_READINGS = ("visits", "pairs", "values", "covariance", "details", "labels")
_ENDED = LeastSquaresSolution(np.zeros(0), np.zeros(0), 0.0, converged=True, evaluations=0, message="")


def saved_bytes(
    fit: Fit, content: Mapping[str, Any], nominal: Mapping[str, bytes], files: Mapping[Holds, FileRobot]
) -> bytes:
    """Return `fit.npz`, from the content of `result.json`, files of the nominal robot, and the robots of files."""
    undecided = fit.undecided  # to find these takes as long as all else; other fits find theirs at first use
    shown = None if undecided is None else {**vars(undecided), "terms": _entries(undecided.terms)}
    return array_file(
        {
            "version": VERSION,
            "program": PROGRAM,
            "content": content,
            "sha256": {name: hashlib.sha256(file).hexdigest() for name, file in nominal.items()},
            "fit": _fit_entry(fit)
            | {"joint_error": fit.joint_error, "reading_noise": fit.reading_noise, "undecided": shown},
            "files": {
                holds.name: {**vars(robot), "accuracy": asdict(robot.accuracy) | {"poses": robot.accuracy.poses.name}}
                for holds, robot in files.items()
            },
        }
    )


def read_saved(folder: Path | str) -> dict[str, Any] | None:
    """Return the content of `fit.npz` as data; None without it. Damage or another version raises `DataError`."""
    path = Path(folder) / SAVED
    if not path.is_file():
        return None
    try:
        saved: dict[str, Any] = read_array_file(path.read_bytes())
    except (OSError, ValueError) as error:
        raise DataError(f"{path}: cannot be read ({error}); run the fit again") from None
    if saved.get("version") != VERSION:
        raise DataError(f"{path}: is not of format version {VERSION}; run the fit again")
    require_unchanged(folder, saved["sha256"])
    return saved


def require_unchanged(folder: Path | str, sha256: Mapping[str, str]) -> None:
    """Raise `DataError` if a file of a result folder is missing or differs from its digest, by name."""
    for name, digest in sha256.items():
        path = Path(folder) / name
        if not path.is_file():
            raise DataError(f"{path}: no such file; run the fit again")
        if hashlib.sha256(path.read_bytes()).hexdigest() != digest:
            raise DataError(f"{path}: was changed after the fit, so the result is no longer valid; run the fit again")


def _fit_entry(fit: Fit) -> dict[str, Any]:
    robust, folds, convergence = fit.loss != "none", fit.folds, asdict(fit.convergence)
    return {
        "terms": _entries(fit.nominal.description.terms),
        "held": fit.nominal.description.held,
        "nominal": fit.nominal.values,
        "placed": fit.placed.values,
        "values": fit.robot.values,
        "scales": fit.unknowns.scales,
        "noise": {"groups": fit.scales},
        "passive": fit.configurations.passive,
        "robust": {"weights": fit.weights, "factors": vars(fit.statistics.factors)} if robust else None,
        "settings": {"sigma": fit.sigma_given, "loss": fit.loss, "seed": fit.seed},
        "asked": vars(fit.requested_options),
        "placed_later": fit.placed_later,
        "seconds": fit.seconds,
        "convergence": convergence,
        "choice": None if fit.terms is None else fit.terms.requested,
        "identification": _measurements_entry(fit.identification.data),
        "validation": None if fit.validation is None else _measurements_entry(fit.validation.data),
        "folds": None if folds is None else {**vars(folds), "errors": _errors_entry(folds.errors)},
        "excluded": [asdict(outlier) for outlier in fit.excluded],
        "with_all": None if fit.with_all is None else _fit_entry(fit.with_all),
        "reduced": {holds.name: _fit_entry(other) for holds, other in (fit.reduced or {}).items()},
    }


def _entries(terms: tuple[Any, ...]) -> list[dict[str, Any]]:
    return [section.model_dump(mode="json") for section in terms]


def _measurements_entry(data: Measurements) -> dict[str, Any]:
    entry = {name: getattr(data, name) for name in _MEASUREMENTS}
    own = {name: {key: getattr(one, key) for key in _READINGS} for name, one in data.readings.items()}
    return entry | {"labels": tuple(data.labels), "names": tuple(data.names), "readings": own}


def _errors_entry(errors: ErrorSet) -> dict[str, Any]:
    return {"before": dict(errors.before), "after": dict(errors.after), "singular_value": errors.singular_value}


def saved_files(saved: Mapping[str, Any]) -> dict[Holds, FileRobot]:
    """Return the robots of the files of a result; those of a failed result were forced already."""
    failed, files = saved["content"]["verdict"]["grade"] == "FAIL", {}
    for name, entry in saved["files"].items():
        accuracy = Accuracy(**entry["accuracy"] | {"poses": PoseUse[entry["accuracy"]["poses"]]})
        robot = FileRobot(**entry | {"accuracy": accuracy})
        files[Holds[name]] = replace(robot, withheld="") if failed else robot
    return files


def with_saved_terms(robot: Robot, entry: Mapping[str, Any]) -> Robot:
    """Return a nominal robot with the joint terms and the held parameters of a fit."""
    robot = robot.with_terms(stored_terms(entry["terms"]))
    return replace(robot, description=robot.description.model_copy(update={"held": tuple(entry["held"])}))


@one_blas_thread
def evaluate_fit(robot: Robot, entry: Mapping[str, Any], where: str) -> JudgedFit:
    """Return a saved fit: the model of a nominal robot, with or without its terms, evaluated at the end values.

    `entry` is the entry `fit` of the content of `read_saved`. `ComputationError` if the fit cannot be restored.
    """
    try:
        fit = JudgedFit.from_fit(_fit_of(robot, entry))
    except (CalibrationError, ValueError, LookupError, TypeError) as error:
        raise ComputationError(f"{where}: this version cannot evaluate the fit ({error}); run the fit again") from None
    if "reading_noise" in entry:  # else found at first use
        vars(fit)["unexplained"] = UnexplainedErrors(entry["reading_noise"], entry["joint_error"], _undecided_of(entry))
    return fit


def _fit_of(robot: Robot, entry: Mapping[str, Any]) -> Fit:
    nominal = with_saved_terms(robot, entry).with_parameters(entry["nominal"])
    later, settings, robust = tuple(entry["placed_later"]), Settings(**entry["settings"]), entry["robust"]
    seen, data = nominal.fix(*later) if later else nominal, _measurements_of(entry["identification"], nominal)
    problem = Problem.from_data(seen, data, settings.sigma, entry["passive"])
    groups, unknowns = entry["noise"]["groups"], replace(problem.unknowns, scales=entry["scales"])
    problem = replace(problem, unknowns=unknowns, noise_found=problem.whitening.is_unstated | (groups != 1.0))
    if np.any(entry["noise"].get("ratios", 0.0)):
        raise ValueError("readings of a pose were weighted as ones that share an error")
    start, end = (problem.evaluate(seen.with_parameters(entry[state])) for state in ("placed", "values"))
    begin = reset_unseen(problem, start)
    weighing = {"weights": robust["weights"], "factors": Factors(**robust["factors"])} if robust else {}
    end_point = RobustSolution(problem, end, groups, _ENDED, **weighing)
    minimum = Minimum(nominal, (), start, require_identifiable(problem, begin), end_point)
    validation = None if entry["validation"] is None else _measurements_of(entry["validation"], nominal)
    fit = fit_at(minimum, settings, validation)
    requested, folds = entry["choice"], entry["folds"]
    choice = TermChoice(requested, nominal.description.terms, (), _undecided_of(entry))
    if folds is not None:
        folds = Folds(**_tuples(folds) | {"errors": ErrorSet(data, nominal.instruments, **folds["errors"])})
    return replace(
        fit,
        placed=fit.placed.free(*later) if later else fit.placed,
        robot=fit.robot.free(*later) if later else fit.robot,
        placed_later=later,
        seconds=entry["seconds"],
        convergence=Convergence(**_tuples(entry["convergence"])),
        requested_options=RequestedOptions(**_tuples(entry["asked"])),
        terms=None if requested is None else choice,
        folds=folds,
        excluded=tuple(Outlier(**outlier) for outlier in entry["excluded"]),
        with_all=None if entry["with_all"] is None else _fit_of(robot, entry["with_all"]),
    )


def _undecided_of(entry: Mapping[str, Any]) -> UndecidedTerms | None:
    own = entry.get("undecided")
    return None if own is None else UndecidedTerms(stored_terms(own["terms"]), tuple(own["names"]), own["spread"])


def _tuples(entry: Mapping[str, Any]) -> dict[str, Any]:
    return {key: tuple(value) if isinstance(value, list) else value for key, value in entry.items()}


def _measurements_of(entry: Mapping[str, Any], robot: Robot) -> Measurements:
    readings = {name: Readings(**_tuples(own)) for name, own in entry["readings"].items()}
    return Measurements(**_tuples(entry) | {"readings": readings}, robot=robot)


_CONTENT, _ARRAY = "content", "array"


def array_file(content: object) -> bytes:
    """Return the file of mappings, sequences, arrays, text and numbers; NaN and infinite numbers included."""
    arrays: list[NDArray[Any]] = []
    text = json.dumps(content, default=lambda array: {_ARRAY: _place_in(arrays, array)})
    entries = {_CONTENT: np.frombuffer(text.encode(), dtype=np.uint8)}
    entries |= {str(k): array for k, array in enumerate(arrays)}
    stream = io.BytesIO()
    np.savez_compressed(stream, allow_pickle=False, **entries)
    return stream.getvalue()


def read_array_file(file: bytes) -> Any:
    """Return the content that `array_file` wrote, sequences as lists, or raise `ValueError` if it is damaged."""
    try:
        with np.load(io.BytesIO(file), allow_pickle=False) as entries:
            content = json.loads(entries[_CONTENT].tobytes())
            return _with_arrays(content, {name: entries[name] for name in entries.files if name != _CONTENT})
    except Exception as error:  # zip, zlib, NumPy and JSON raise many kinds of errors for damage
        raise ValueError(f"it is damaged: {error}") from None


def _place_in(arrays: list[NDArray[Any]], array: object) -> int:
    """The index of an array among others, at whose end it is put unless it is there."""
    if not isinstance(array, np.ndarray):
        raise TypeError(f"cannot be stored: {type(array).__name__}")
    known = next((k for k, other in enumerate(arrays) if other is array), len(arrays))
    arrays += [array] * (known == len(arrays))
    return known


def _with_arrays(value: Any, arrays: dict[str, NDArray[Any]]) -> Any:
    if isinstance(value, dict):
        if value.keys() == {_ARRAY}:
            return arrays[str(value[_ARRAY])]
        return {key: _with_arrays(part, arrays) for key, part in value.items()}
    return [_with_arrays(part, arrays) for part in value] if isinstance(value, list) else value
