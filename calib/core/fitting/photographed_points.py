"""What a sensor sees as positions of a point, for code that uses positions alone.

Each photograph gives the board's pose in the camera, whatever the joints are. So a robot with a camera is like a robot
whose target, the board's origin, is measured in a frame of unknown place on the link that carries the camera. A sensor
that reads positions of a point itself is like that, too.

When it fails. The depth of a small board is uncertain, and its pose may be one of two that look alike. Such positions
show signs, quarter turns and orders, but are not good enough for a calibration.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.data.in_memory import plain_readings
from calib.core.data.measurements import Measurements
from calib.core.instruments.camera import rays, view_poses
from calib.core.instruments.pixel import Pixel
from calib.core.instruments.relation import Relation
from calib.core.robots.description import BaseSection, TargetSection
from calib.core.robots.loading import build
from calib.core.robots.robot import Robot


def photographed_points(robot: Robot, data: Measurements) -> tuple[Robot, Measurements] | None:
    """Return the nominal robot, and measurements that state what its first sensor saw as positions [m].

    None is returned for a robot without such a sensor, or with another instrument that reads positions.
    """
    if any(each.reads_positions for each in robot.instruments):
        return None
    for each in (each for each in robot.instruments if each.name in data.readings):
        if isinstance(each, Pixel):
            target = TargetSection(frame=robot.description.targets[each.target].frame, position="unknown")
            return _positioned(robot, data, each.place.link, {each.target: target}, _boards(each, data))
        if isinstance(each, Relation) and each.seen_points(data.readings[each.name].values) is not None:
            return _seen_place(robot, data, each)
    return None


def _boards(camera: Pixel, data: Measurements) -> FloatArray:
    """Origins of the board in the camera, (n, 3) [m]; NaN where it was not seen."""
    readings = data.readings[camera.name]
    visits, view = np.unique(readings.visits, return_inverse=True)
    seen = rays(readings.values, np.array(camera.intrinsics))
    poses, errors = view_poses(camera.body(readings.details), seen, view.reshape(-1), len(visits))
    points = np.full((len(data), 3), np.nan)
    points[visits] = np.where(np.isfinite(errors)[:, None], poses[:, :3, 3], np.nan)
    return points


def _seen_place(robot: Robot, data: Measurements, sensor: Relation) -> tuple[Robot, Measurements]:
    """The robot whose target is the point that the sensor saw most often, and its measurements."""
    readings = data.readings[sensor.name]
    most = int(np.argmax(np.bincount(readings.pairs)))
    own = readings.subset(np.flatnonzero(readings.pairs == most))
    points, seen = np.full((len(data), 3), np.nan), sensor.seen_points(own.values)
    assert seen is not None  # as `photographed_points` has checked
    points[own.visits] = seen
    place = sensor.own[most]
    target = TargetSection(frame=place.link, xyz=place.xyz, position="unknown")
    return _positioned(robot, data, robot.description.targets[sensor.target].frame, {place.name: target}, points)


def _positioned(
    robot: Robot, data: Measurements, link: str, target: dict[str, TargetSection], points: FloatArray
) -> tuple[Robot, Measurements]:
    """The robot whose target is measured in a frame of unknown place on a link, and its measurements (n, 3) [m]."""
    changes: dict[str, Any] = {
        "base": BaseSection(frame=link, pose="unknown"),
        "targets": target,
        **{"instruments": {}, "setups": {}, "columns": {}, "held": (), "elimination_order": ()},
        **{"fleet": None, "model": None},
    }
    positioned = build(robot.description.model_copy(update=changes), robot.urdf, robot.path)
    return positioned, replace(data, readings={next(iter(target)): plain_readings(points)}, robot=positioned)
