"""Reading back a result folder, as an object or as the calibrated robot in it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from calib.core.base.errors import ComputationError, DataError, DescriptionError
from calib.core.results import version_1
from calib.core.results.loaded_result import LoadedResult
from calib.core.results.saved_fit import NOMINAL_YAML, read_saved, saved_files
from calib.core.robots import loading
from calib.core.robots.robot import Robot
from calib.core.robots.terms.terms import stored_terms

_SAME = 1e-6  # m, rad and axes, as files round them


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
    if not Path(path).exists():
        raise DescriptionError(
            f"{path}: no such file or folder; give a robot description (YAML), a URDF or a result folder"
        )
    return load_result(path).robot if Path(path).is_dir() else loading.load(path)


def load_result(folder: Path | str, robot: Robot | None = None, *, failed_too: bool = False) -> LoadedResult:
    """Load a result folder of `calib fit --out`, or of `save`.

    Args:
        robot: The nominal robot that gets the values of the result; the one in the folder if not given.
        failed_too: Whether to load a result that failed and was not forced.

    Raises:
        DataError: The folder holds no result, or a damaged one, or one of another robot.
        ComputationError: The verdict of the result is FAIL, and it was not forced.
    """
    saved = read_saved(folder)
    content = version_1.read_content(folder) if saved is None else saved["content"]
    own = loading.load(Path(folder) / NOMINAL_YAML)
    nominal = own if robot is None else robot
    terms = content["joint_terms"]
    if terms["asked"] is not None:
        try:
            nominal = nominal.with_terms(stored_terms(terms["entries"]))
        except DescriptionError:
            raise DataError(
                f"{folder}: is the result of another robot ({content['robot']}); its joint terms do not fit this one"
            ) from None
    if [row["name"] for row in content["parameters"]] != [p.name for p in nominal.parameters]:
        raise DataError(f"{folder}: is the result of another robot ({content['robot']}); its parameters differ")
    joints = {joint.name: (joint.xyz, joint.rpy, joint.axis) for joint in own.urdf.joints}
    for joint in nominal.urdf.joints:
        here = joint.xyz, joint.rpy, joint.axis
        if not np.allclose(joints.get(joint.name, here), here, rtol=0, atol=_SAME):
            raise DataError(
                f"{folder}: is the result of another robot ({content['robot']}), whose joint '{joint.name}' has another"
                " origin or axis in its URDF"
            )
    verdict = content["verdict"]
    if verdict["grade"] == "FAIL" and not verdict.get("forced") and not failed_too:
        raise ComputationError(
            f"{folder}: the fit failed and gives no calibrated robot ({verdict['reasons'][0]}); fit again, with --force"
            " if you want these numbers anyway"
        )
    if robot is None:
        nominal = replace(nominal, path=str(folder))
    if saved is None:
        calibrated = version_1.calibrated_robot(str(folder), nominal, content)
        return version_1.EarlierResult(str(folder), own, calibrated, content, {})
    calibrated = replace(nominal.with_parameters(saved["fit"]["values"]), files=saved_files(saved))
    return LoadedResult(str(folder), own, calibrated, content, saved)


def read_content(folder: Path | str) -> dict[str, Any]:
    """Return the content of `result.json` in a folder, or raise `DataError` if it holds no result."""
    saved = read_saved(folder)
    return version_1.read_content(folder) if saved is None else saved["content"]


def forced_lines(folder: Path | str) -> list[str]:
    """Return lines for an exported file if its result failed; empty if it did not."""
    verdict = read_content(folder)["verdict"]
    if verdict["grade"] != "FAIL":
        return []
    return ["verdict: FAIL, exported by force:", *(f"  {reason}" for reason in verdict["reasons"])]
