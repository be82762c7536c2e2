"""From what a user has (a robot, a fit or its folder, measurements) to a scene."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib import Fit, Measurements, Robot
from calib.errors import InputError
from calib.linearisation.registration import register
from calib.reporting.results import load_calibrated, load_uncertainty, read_result
from calib.words import counted
from viz import poses as pose_tables
from viz.judgement import of_result, of_verdict
from viz.poses import IDENTIFICATION, Calibrated, PoseTable
from viz.remarks import remarks
from viz.scene import Scene, build_scene, scene_of_fit

Result = Fit | str | Path


@dataclass(frozen=True, eq=False)
class Shown:
    """A scene and the robots that it was made from.

    Attributes:
        scene: The scene.
        solid: The robot that is drawn solid.
        ghost: The robot that is drawn as a ghost, or None.
    """

    scene: Scene
    solid: Robot
    ghost: Robot | None


def gather(robot: Robot, result: Result | None = None, data: Measurements | None = None) -> Shown:
    """Return what to show.

    Args:
        robot: The nominal robot.
        result: A fit, or the folder that one was saved to; none: the robot as it is.
        data: Measurements to judge the robots with, instead of those of the fit.

    Raises:
        DataError: The folder holds no result, or one of another robot.
        UnreachablePoseError: A pose cannot be assembled.
    """
    if isinstance(result, Fit):
        return _from_fit(robot, result, data)
    if result is not None:
        return _from_folder(robot, result, data)
    if data is not None:
        sigma = float("nan") if robot.description.sigma is None else robot.description.sigma
        placed = register(robot, data) if _unknown_place(robot) else robot
        table = pose_tables.from_measurements(data, placed, None, sigma)
        return Shown(build_scene(placed, None, table, comments=remarks(data.comments)), placed, None)
    return Shown(build_scene(robot), robot, None)


def _from_fit(robot: Robot, fit: Fit, data: Measurements | None) -> Shown:
    if fit.nominal.urdf.source != robot.urdf.source:
        raise InputError(f"the result is of another robot than {robot.path}; give the robot that was fitted")
    if data is None:
        return Shown(scene_of_fit(fit), fit.robot, fit.placed)
    calibrated = Calibrated(fit.robot, fit.uncertainty)
    table = pose_tables.from_measurements(data, fit.placed, calibrated, fit.statistics.sigma)
    scene = build_scene(fit.placed, fit.robot, table, verdict=of_verdict(fit.verdict), comments=remarks(data.comments))
    return Shown(scene, fit.robot, fit.placed)


def _from_folder(robot: Robot, folder: str | Path, data: Measurements | None) -> Shown:
    """A failed result is shown, too: to look at it is how one finds out why; its verdict is shown with it."""
    model = load_calibrated(folder, robot, failed_too=True)
    uncertainty = load_uncertainty(folder, robot)
    calibrated = Calibrated(model, lambda q: uncertainty.at(model, q))
    content = read_result(folder)
    if data is None:
        table = pose_tables.from_result(folder, calibrated)
        placed = _placed(robot, table)
    else:
        placed = register(robot, data) if _unknown_place(robot) else robot
        table = pose_tables.from_measurements(data, placed, calibrated, float(content["sigma"]))
    left_out = content["excluded"] if data is None else []
    notes = (f"not shown: left out of the fit, {counted(len(left_out), 'outlier')}",) if left_out else ()
    said = remarks(content.get("comments", ()) if data is None else data.comments)
    scene = build_scene(placed, model, table, verdict=of_result(content["verdict"]), notes=notes, comments=said)
    return Shown(scene, model, placed)


def _unknown_place(robot: Robot) -> bool:
    description = robot.description
    return description.base.pose == "unknown" or any(t.position == "unknown" for t in description.targets.values())


def _placed(robot: Robot, table: PoseTable) -> Robot:
    """Return the robot before calibration: an unknown base and unknown targets from the poses that were fitted."""
    if not _unknown_place(robot):
        return robot
    rows = np.flatnonzero(np.array(table.group) == IDENTIFICATION)
    n_targets = len(robot.target_names)
    first = rows[::n_targets]
    n = len(first)
    positions = table.measured[rows].reshape(n, n_targets, 3)
    names = tuple(table.labels[row] for row in first)
    return register(
        robot,
        Measurements(
            table.joints[first],
            names,
            names,
            "",
            (),
            positions,
            np.ones(n, dtype=np.intp),
            np.full(positions.shape, np.nan),
        ),
    )
