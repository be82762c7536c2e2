"""Scenes from a robot, a fit or its folder, and measurements."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from calib import Fit, Measurements, Robot
from calib.core.base.errors import InputError
from calib.core.data.measurements import Poses
from calib.core.results.result_reading import load_result
from calib.core.results.version_1 import EarlierResult
from calib.core.rows.registration import register
from calib.core.rows.whitening import Whitening
from calib.shared.pose_check import check_poses
from viz.judgement import Judgement, judgement_of_fit, judgement_of_result
from viz.pose_sources import Sigmas, from_plan, measured_set, noise
from viz.poses import PredictingRobot, average_poses
from viz.reading_errors import reading_errors_of_set
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
    if result is None:
        if data is None:
            return ShownScene(build_scene(robot), robot, None)
        placed, comments = _place_robot(robot, data), remarks(data.comments)
        scene = _scene_of_data(data, placed, None, _stated_sigmas(robot, data), comments=comments)
        return ShownScene(scene, placed, None)
    if isinstance(result, Fit):
        return _from_fit(robot, result, data, mapped)
    loaded = load_result(result, robot, failed_too=True)  # a failed result is shown too, to find out why
    judgement = judgement_of_result(loaded.content["verdict"], loaded.content.get("next", ""))
    if isinstance(loaded, EarlierResult):
        return _from_earlier(robot, loaded, data, mapped, judgement)
    return _from_fit(loaded.nominal, loaded.fit, data, mapped, judgement)


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
        scene = scene_of_fit(fit, judgement)
    else:
        about = {"comments": remarks(data.comments), "uncertainty_notes": fit.reported_uncertainty.notes}
        verdict = judgement or judgement_of_fit(fit)
        scene = _scene_of_data(data, fit.placed, calibrated, noise(fit), verdict=verdict, **about)
    return ShownScene(_with_map(scene, calibrated, fit.placed, mapped), fit.robot, fit.placed)


def _scene_of_data(
    data: Measurements, placed: Robot, calibrated: PredictingRobot | None, sigmas: Sigmas, **about: Any
) -> ViewerScene:
    """The scene of measurements that were in no fit; `about` goes to `build_scene`."""
    shown, robot = measured_set(data, placed, calibrated, sigmas), None if calibrated is None else calibrated.robot
    return build_scene(placed, robot, average_poses(shown.table()), reading_errors_of_set(shown, robot), **about)


def _with_map(scene: ViewerScene, calibrated: PredictingRobot, nominal: Robot, count: int) -> ViewerScene:
    return replace(scene, map=workspace_map(calibrated, nominal, scene.poses, count)) if count else scene


def _from_earlier(
    robot: Robot, result: EarlierResult, data: Measurements | None, mapped: int, judgement: Judgement
) -> ShownScene:
    uncertainty = result.reported_uncertainty
    calibrated = PredictingRobot(result.robot, uncertainty.predict)
    about: dict[str, Any] = {"verdict": judgement, "uncertainty_notes": uncertainty.notes}
    if data is None:
        note = "readings are not shown: this result is of an earlier version and has none; fit again"
        placed, scene = robot, build_scene(robot, result.robot, notes=(note,), **about)
    else:
        placed = _place_robot(robot, data)
        scene = _scene_of_data(data, placed, calibrated, _stated_sigmas(robot, data), **about)
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
    stated = {
        group.name: group.typical for group in Whitening(robot, data).groups if group.stated and group.part.is_position
    }
    return {instrument.name: stated[instrument.group] for instrument in robot.instruments if instrument.group in stated}
