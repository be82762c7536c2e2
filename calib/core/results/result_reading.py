"""Reading back what `calib.core.results.results` wrote: a calibrated robot, its uncertainty, and what it predicts."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import ComputationError, DataError, DescriptionError
from calib.core.base.files import read_text
from calib.core.base.threads import one_blas_thread
from calib.core.base.units import error_scale, per_si
from calib.core.base.words import counted, listed
from calib.core.data.measurements import Poses
from calib.core.data.parameter_files import read_parameters
from calib.core.data.tables import read_table
from calib.core.fitting.terms.joint_curves import beyond_learned
from calib.core.judging.promise import Promise
from calib.core.judging.reasons import Code
from calib.core.results.result_content import FORMAT_VERSION, NOMINAL_URDF, NOMINAL_YAML, UNDECIDED
from calib.core.results.result_format import damage, unchanged
from calib.core.results.sections.files_held import file_entry, stored_files
from calib.core.robots import loading
from calib.core.robots.held import Holds
from calib.core.robots.robot import Robot
from calib.core.robots.terms.terms import stored_terms
from calib.core.rows.known_robot import KnownRobot
from calib.core.rows.prediction import ParameterUncertainty, UndecidedTerms

_AGREE = 1e-9  # of the same value in two files [m or rad]
_MOST_FREEDOM = 1e9  # degrees of freedom: more than any file has rows; tails of F and t are not found far beyond


def forced_lines(folder: Path | str) -> list[str]:
    """Return what an exported file must say about the result that it comes from: nothing, unless that failed."""
    verdict = read_result(folder).get("verdict", {})
    if verdict.get("grade") != "FAIL":
        return []
    return ["verdict: FAIL, exported by force:", *(f"  {reason}" for reason in verdict["reasons"])]


def load(path: Path | str) -> Robot:
    """Load a robot from a description (YAML) or a plain URDF (`calib.core.robots.loading.load`), or a calibrated one.

    Args:
        path: Path of the file, or of a result folder, which gives the calibrated robot.

    Raises:
        UrdfError: The URDF is not valid.
        DescriptionError: The file is missing, or the description is not valid, or does not fit the URDF.
        DataError: The folder holds no result, or a damaged one.
        ComputationError: The verdict of the result is FAIL, and it was not forced.
    """
    folder = Path(path)
    if not folder.exists():
        raise DescriptionError(
            f"{path}: no such file or folder; give a robot description (YAML), a URDF or a result folder"
        )
    if not folder.is_dir():
        return loading.load(path)
    content = read_result(folder)
    for name in (NOMINAL_YAML, NOMINAL_URDF):
        unchanged(folder, name, content)
    return replace(load_calibrated(folder, loading.load(folder / NOMINAL_YAML)), path=str(path))


def joints_used(folder: Path | str, robot: Robot) -> FloatArray:
    """Return the joint values from which a result was identified, (n, n_actuated) [m or rad]; none if not stored."""
    if not (Path(folder) / "residuals.csv").is_file():
        return np.zeros((0, len(robot.joint_names)))
    table = read_table(unchanged(folder, "residuals.csv", read_result(folder)))
    used = np.array(table.text("set")) == "identification"
    joints = [table.column(name, robot.mechanism.dimensions[name]) for name in robot.joint_names]
    return np.stack(joints, axis=1)[used]


def load_calibrated(folder: Path | str, robot: Robot, *, failed_too: bool = False) -> Robot:
    """Return `robot` with the parameters of a result folder.

    Args:
        folder: Of `save`.
        robot: The nominal robot.
        failed_too: Whether to load a result that failed and was not forced, to look at it.

    Raises:
        DataError: The folder holds no result, or one of another robot.
        ComputationError: The verdict of the result is FAIL, and it was not forced.
    """
    content = read_result(folder)
    robot = _with_stored_terms(folder, content, robot)
    names = [row.get("name") for row in content["parameters"]]
    if names != [parameter.name for parameter in robot.parameters]:
        raise DataError(f"{folder}: is the result of another robot ({content['robot']}); its parameters differ")
    verdict = content.get("verdict", {})
    if verdict.get("grade") == "FAIL" and not verdict.get("forced") and not failed_too:
        raise ComputationError(
            f"{folder}: the fit failed and gives no calibrated robot ({verdict['reasons'][0]}); fit again, with --force"
            " if you want these numbers anyway"
        )
    calibrated = robot.with_parameters(
        read_parameters(unchanged(folder, "parameters.csv", content), robot, complete=True)
    )
    for row, parameter, value in zip(content["parameters"], robot.parameters, calibrated.values, strict=True):
        shown, per_si = row.get("value"), parameter.per_si
        if not isinstance(shown, (int, float)) or not abs(shown / per_si - value) <= _AGREE:
            raise DataError(
                f"{folder}: parameters.csv and result.json give different values of '{parameter.name}';"
                " run the fit again"
            )
    return replace(calibrated, files=stored_files(folder, content, calibrated))


def _with_stored_terms(folder: Path | str, content: dict[str, Any], robot: Robot) -> Robot:
    """The robot with the joint terms that the fit was asked for; its own where it was asked for none."""
    stored = content.get("joint_terms") or {}
    if stored.get("asked") is None:
        return robot
    try:
        return robot.with_terms(stored_terms(stored.get("entries")))
    except ValueError:
        raise DataError(f"{folder}: its joint terms cannot be read; run the fit again") from None
    except DescriptionError:
        raise DataError(
            f"{folder}: is the result of another robot ({content['robot']}); its joint terms do not fit this one"
        ) from None


def poses_beyond_curves(folder: Path | str, robot: Robot, poses: Poses) -> list[str]:
    """Return a remark on poses that lie where no error curve of a joint of the result was learned.

    Args:
        folder: Of `save`.
        robot: The calibrated robot.
        poses: Where it shall predict.

    Raises:
        DataError: The folder holds no result.
    """
    learned = np.zeros((2, len(robot.joint_names)))
    curves = (read_result(folder).get("joint_terms") or {}).get("curves", [])
    for curve in curves:
        name = curve["joint"]
        if name not in robot.joint_names:
            raise DataError(f"{folder}: has an error curve of joint '{name}', which the robot does not have; run the"
                            " fit again")  # fmt: skip
        scale = per_si(curve["unit"], robot.mechanism.dimensions[name], f"{folder}, curve of joint '{name}'")
        learned[:, robot.joint_names.index(name)] = curve["low"] / scale, curve["high"] / scale
    outside = beyond_learned(robot, learned, poses.joints) if curves else np.zeros((0, 0), dtype=bool)
    beyond = np.flatnonzero(np.any(outside, axis=1))
    if not len(beyond):
        return []
    joints = [robot.joint_names[j] for j in np.flatnonzero(np.any(outside, axis=0))]
    return [
        f"{counted(len(beyond), 'pose lies', 'poses lie')} where no error curve of {listed(joints)} was learned"
        f" ({listed([poses.labels[k] for k in beyond])}): there it is as uncertain as before measuring"
    ]


def load_uncertainty(folder: Path | str, robot: Robot, holds: Holds = Holds.EVERYTHING) -> ParameterUncertainty:
    """Return the uncertainty of a result folder.

    Args:
        folder: Of `save`.
        robot: The calibrated robot, as files get it that hold so much.
        holds: How much.

    Raises:
        DataError: The file is missing or broken, or belongs to another robot.
    """
    content = read_result(folder)
    entry = file_entry(content, holds)
    path = unchanged(folder, f"{entry['values']}_covariance.csv" if entry.get("values") else "covariance.csv", content)
    table = read_table(path)
    names = table.text("parameter") if "parameter" in table.names else []
    known = [p for p in robot.parameters if p.name in names]
    if table.names != ("parameter", "unit", *names) or names != [p.name for p in known]:
        raise DataError(f"{path}: is not the covariance of parameters of {robot.path}; run the fit again")
    units = zip(known, table.text("unit"), strict=True)
    scale = np.array(
        [per_si(unit, parameter.dimension, f"{path}, parameter '{parameter.name}'") for parameter, unit in units]
    )
    try:
        covariance = np.array([[float(cell) for cell in row[2:]] for row in table.rows]) / scale[:, None] / scale
    except ValueError:
        raise DataError(f"{path}: holds text where a number is expected; run the fit again") from None
    own = entry if entry.get("values") else content
    freedom, joint_error = own.get("interval_degrees_of_freedom"), own.get("joint_error", 0.0)
    numbers = np.all(np.isfinite(covariance)) and isinstance(freedom, (int, float)) and 0 < freedom < _MOST_FREEDOM
    if not numbers or not isinstance(joint_error, (int, float)) or joint_error < 0:
        raise DataError(f"{folder}: its covariance or degrees of freedom are not numbers; run the fit again")
    free = np.array([p.name in names for p in robot.parameters])
    undecided = None if entry.get("values") else _undecided_terms(folder, content, robot)
    factor = float(scipy.special.stdtrit(freedom, 0.975))
    return ParameterUncertainty(free, covariance, factor, undecided, float(joint_error))


def _undecided_terms(folder: Path | str, content: dict[str, Any], robot: Robot) -> UndecidedTerms | None:
    """Joint terms that a choice left undecided; None if it left none, or an earlier version wrote the result."""
    entries = (content.get("joint_terms") or {}).get("undecided")
    if not entries:
        return None
    path = unchanged(folder, UNDECIDED, content)
    table = read_table(path)
    directions = [k for k, name in enumerate(table.names) if name.startswith("direction_")]
    try:
        bare = UndecidedTerms(stored_terms(entries), (), np.zeros((0, 0)))
        whole = {p.name: p for p in bare.added_to(robot).parameters}
        names, units = table.text("parameter"), table.text("unit")
        scale = np.array(
            [
                per_si(unit, whole[name].dimension, f"{path}, parameter '{name}'")
                for name, unit in zip(names, units, strict=True)
            ]
        )
        spread = np.array([[float(row[k]) for k in directions] for row in table.rows]) / scale[:, None]
    except (ValueError, KeyError, DescriptionError):
        raise DataError(f"{path}: does not fit the joint terms in result.json; run the fit again") from None
    if not directions or not np.all(np.isfinite(spread)):
        raise DataError(f"{path}: holds no numbers; run the fit again")
    return UndecidedTerms(bare.terms, tuple(names), spread)


def load_known(folder: Path | str, robot: Robot) -> KnownRobot:
    """Return the calibrated robot of a result folder, with how well it is known and where it was measured.

    Args:
        folder: Of `save`.
        robot: The nominal robot.

    Raises:
        DataError: The folder holds no result, one of another robot, or a damaged one.
        ComputationError: The verdict of the result is FAIL, and it was not forced.
    """
    calibrated = load_calibrated(folder, robot)
    codes = read_result(folder).get("verdict", {}).get("codes", ())
    return KnownRobot(
        calibrated, load_uncertainty(folder, calibrated), joints_used(folder, robot), Code.NOTHING_TO_CORRECT in codes
    )


@one_blas_thread
def load_promise(folder: Path | str, robot: Robot) -> Promise:
    """Return what the calibration in a result folder predicts of its robot.

    Args:
        folder: Of `save`.
        robot: The nominal robot.

    Raises:
        DataError: The folder holds no result, one of another robot, or one without the noise of each instrument.
        ComputationError: The verdict of the result is FAIL, and it was not forced.
    """
    calibrated, known, content = load_calibrated(folder, robot), load_uncertainty(folder, robot), read_result(folder)
    sigma: dict[tuple[str, str], float] = {}
    try:
        for block in content["instruments"]:
            instrument = robot.instrument(block["name"])
            dimensions = {part.name: part.dimension for part in instrument.parts}
            for part in block["parts"]:
                scale = error_scale(dimensions[part["name"]])
                if part["sigma"] is not None:
                    sigma[instrument.group, part["name"]] = float(part["sigma"]) / scale
        shared = 1.0 if content["shared"] is None else float(content["shared"])
        freedom = float(content["degrees_of_freedom"])
    except (KeyError, TypeError, ValueError):
        raise DataError(f"{folder}: does not say the noise of each instrument; run the fit again") from None
    return Promise(calibrated, known.covariance, freedom, sigma, shared)


def read_result(folder: Path | str) -> dict[str, Any]:
    """Return `result.json` of a result folder as a dictionary.

    Raises:
        DataError: Missing, broken, or of another version.
    """
    path = Path(folder) / "result.json"
    if not path.exists():
        raise DataError(f"{folder}: holds no result (no result.json); give the folder that `calib fit --out` wrote")
    try:
        content = json.loads(read_text(path, "a result that `calib fit` wrote", DataError))
    except (ValueError, RecursionError) as error:
        raise DataError(f"{path}: cannot be read ({error}); run the fit again") from None
    if not isinstance(content, dict) or content.get("version") != FORMAT_VERSION:
        raise DataError(f"{path}: is not a result of format version {FORMAT_VERSION}; run the fit again")
    if problem := damage(content):
        raise DataError(f"{path}: is damaged, {problem}; run the fit again")
    return content
