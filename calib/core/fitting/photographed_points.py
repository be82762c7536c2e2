"""Photographs of a board as positions of a point, for code that uses positions alone.

Each photograph gives the board's pose in the camera, whatever the joints are. So a robot with a camera is like a robot
whose target, the board's origin, is measured in a frame of unknown place on the link that carries the camera.

When it fails. The depth of a small board is uncertain, and its pose may be one of two that look alike. Such positions
show signs, quarter turns and orders, but are not good enough for a calibration.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from calib.core.data.in_memory import plain_readings
from calib.core.data.measurements import Measurements
from calib.core.instruments.camera import rays, view_poses
from calib.core.instruments.pixel import Pixel
from calib.core.robots.description import BaseSection, TargetSection
from calib.core.robots.loading import build
from calib.core.robots.robot import Robot


def photographed_points(robot: Robot, data: Measurements) -> tuple[Robot, Measurements] | None:
    """Return the nominal robot and its measurements with the first camera's photographs as positions [m].

    None is returned for a robot without a camera, or with another instrument that reads positions.
    """
    cameras = [each for each in robot.instruments if isinstance(each, Pixel) and each.name in data.readings]
    if not cameras or any(each.reads_positions for each in robot.instruments):
        return None
    camera = cameras[0]
    readings, description = data.readings[camera.name], robot.description
    visits, view = np.unique(readings.visits, return_inverse=True)
    seen = rays(readings.values, np.array(camera.intrinsics))
    poses, errors = view_poses(camera.body(readings.details), seen, view.reshape(-1), len(visits))
    points = np.full((len(data), 3), np.nan)
    points[visits] = np.where(np.isfinite(errors)[:, None], poses[:, :3, 3], np.nan)
    target = TargetSection(frame=description.targets[camera.target].frame, position="unknown")
    changes: dict[str, Any] = {
        "base": BaseSection(frame=camera.place.link, pose="unknown"),
        "targets": {camera.target: target},
        **{"instruments": {}, "setups": {}, "columns": {}, "held": (), "elimination_order": ()},
        **{"fleet": None, "model": None},
    }
    positioned = build(description.model_copy(update=changes), robot.urdf, robot.path)
    return positioned, replace(data, readings={camera.target: plain_readings(points)}, robot=positioned)
