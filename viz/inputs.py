"""Scenes from a robot, a fit or its folder, and measurements."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from calib import Fit, Measurements, Robot
from calib.core.base.errors import InputError
from calib.core.data.measurements import Poses
from calib.core.results.result_reading import load_result
from calib.core.results.version_1 import EarlierResult
from calib.core.rows.registration import register
from calib.core.rows.whitening import Whitening
from calib.shared.pose_check import check_poses
from viz import reading_errors
from viz.judgement import Judgement, judgement_of_result
from viz.judgement import judgement_of_fit as judgement_of_fit
from viz.pose_sources import Sigmas, from_measurements, from_plan, noise
from viz.poses import PredictingRobot
from viz.remarks import remarks
from viz.scene import ViewerScene, build_scene, scene_of_fit
from viz.workspace_map import workspace_map

Result = Fit | str | Path


@dataclass(frozen=True, eq=False)
class ShownScene:
    """A scene with its robots: `solid`, and `ghost` or None."""

    scene: ViewerScene
    solid: Robot
    ghost: Robot | None


def gather(robot: Robot, result: Result | None = None, data: Poses | None = None, mapped: int = 0) -> ShownScene:
    """Return the scene to show.

    Args:
        robot: The nominal robot.
        result: A fit, or the folder of a saved fit; None: the robot alone.
        data: Measurements to compare with the robots, instead of those of the fit; or poses alone.
        mapped: Number of poses of the map of the uncertainty over the workspace; 0: no map.

    Raises:
        DataError: The folder holds no result, or one of another robot.
        InputError: A map without a result.
        UnreachablePoseError: A pose cannot be assembled.
    """
    if mapped and result is None:
        raise InputError("--map shows what a calibration knows: give its result with --result DIR")
    if data is not None and not isinstance(data, Measurements):
        return _planned_scene(robot, result, data)
    if isinstance(result, Fit):
        return _from_fit(robot, result, data, mapped)
    if result is not None:
        return _from_folder(robot, result, data, mapped)
    if data is not None:
        placed = _place_robot(robot, data)
        table = from_measurements(data, placed, None, _stated_sigmas(robot, data))
        readings = reading_errors.reading_errors_of_measurements(data, placed, None)
        return ShownScene(build_scene(placed, None, table, readings, comments=remarks(data.comments)), placed, None)
    return ShownScene(build_scene(robot), robot, None)


def _planned_scene(robot: Robot, result: Result | None, poses: Poses) -> ShownScene:
    """Poses without readings, with the collisions there."""
    if isinstance(result, Fit):
        robot = result.robot
    elif result is not None:
        robot = load_result(result, robot, failed_too=True).robot
    check = check_poses(robot, poses.joints)
    notes = (*([check.summary()] if check.n_blocked else []), *check.notes)
    return ShownScene(build_scene(robot, None, from_plan(robot, poses, check.hits), notes=notes), robot, None)


def _from_fit(
    robot: Robot, fit: Fit, data: Measurements | None, mapped: int, judgement: Judgement | None = None
) -> ShownScene:
    if fit.nominal.urdf.source != robot.urdf.source:
        raise InputError(f"the result is of another robot than {robot.path}; give the robot that was fitted")
    calibrated = PredictingRobot(fit.robot, fit.reported_uncertainty.predict)
    if data is None:
        return ShownScene(
            _with_map(scene_of_fit(fit, judgement), calibrated, fit.placed, mapped), fit.robot, fit.placed
        )
    table = from_measurements(data, fit.placed, calibrated, noise(fit))
    comments, notes = remarks(data.comments), fit.reported_uncertainty.notes
    readings = reading_errors.reading_errors_of_measurements(data, fit.placed, fit.robot)
    judgement = judgement or judgement_of_fit(fit)
    scene = build_scene(
        fit.placed, fit.robot, table, readings, verdict=judgement, uncertainty_notes=notes, comments=comments
    )
    return ShownScene(_with_map(scene, calibrated, fit.placed, mapped), fit.robot, fit.placed)


def _with_map(scene: ViewerScene, calibrated: PredictingRobot, nominal: Robot, count: int) -> ViewerScene:
    return replace(scene, map=workspace_map(calibrated, nominal, scene.poses, count)) if count else scene


def _from_folder(robot: Robot, folder: str | Path, data: Measurements | None, mapped: int) -> ShownScene:
    """The scene of a saved result, with its verdict; a failed result is shown too, to find out why."""
    result = load_result(folder, robot, failed_too=True)
    judgement = judgement_of_result(result.content["verdict"], result.content.get("next", ""))
    if not isinstance(result, EarlierResult):
        return _from_fit(result.nominal, result.fit, data, mapped, judgement)
    uncertainty = result.reported_uncertainty
    calibrated, placed = (
        PredictingRobot(result.robot, uncertainty.predict),
        robot if data is None else _place_robot(robot, data),
    )
    table = None if data is None else from_measurements(data, placed, calibrated, _stated_sigmas(robot, data))
    readings = () if data is None else reading_errors.reading_errors_of_measurements(data, placed, result.robot)
    notes = (
        ()
        if data is not None
        else ("readings are not shown: this result is of an earlier version and has none; fit again",)
    )
    scene = build_scene(
        placed, result.robot, table, readings, verdict=judgement, notes=notes, uncertainty_notes=uncertainty.notes
    )
    return ShownScene(_with_map(scene, calibrated, placed, mapped), result.robot, placed)


def _place_robot(robot: Robot, data: Measurements) -> Robot:
    """Return the robot before calibration, with unknown base and targets placed by the measurements."""
    description = robot.description
    unknown = description.base.pose == "unknown" or any(
        "unknown" in (target.position, target.orientation) for target in description.targets.values()
    )
    unknown |= any(place.unknown for instrument in robot.instruments for place in instrument.places())
    return register(robot, data) if unknown else robot


def _stated_sigmas(robot: Robot, data: Measurements) -> Sigmas:
    """Return the noise of measured points as stated in the description or the measurements."""
    stated = {
        group.name: group.typical for group in Whitening(robot, data).groups if group.stated and group.part.is_position
    }
    return {instrument.name: stated[instrument.group] for instrument in robot.instruments if instrument.group in stated}
