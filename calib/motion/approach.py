"""Approach and retreat of a touch: along the normal of the touched surface.

The normal is z of a plane's or socket's axes, and of a sphere the line from its centre. The target is moved along it by
the smallest change of joint values, within their limits.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.data.measurements import Poses
from calib.core.instruments.kind import Readings
from calib.core.instruments.touch import Touch
from calib.core.robots.joint_errors import term_columns
from calib.core.robots.robot import Robot
from calib.core.rows.candidates import configurations_at
from calib.core.rows.observed import predict_readings
from calib.core.rows.simulate import MET, touching_configurations

_OFF = 0.05  # distance from contact at which the straight approach begins [m]


def approaches(robot: Robot, poses: Poses) -> FloatArray:
    """Return joint values from which each pose is approached, (n, n_actuated) [m or rad]; the pose itself if it touches
    nothing; NaN if there are none.
    """
    touches = [touch for touch in robot.instruments if isinstance(touch, Touch) and touch.name in poses.planned]
    if not touches:
        return poses.joints
    in_sockets = {touch.name: replace(touch, surface="socket") for touch in touches}  # a socket reads the whole offset
    touching_robot = replace(robot, instruments=tuple(in_sockets.get(each.name, each) for each in robot.instruments))
    columns = term_columns(robot, poses.joints, poses.conditions)
    closed = robot.close(poses.joints, columns=columns)
    good = np.flatnonzero(closed.ok)
    configurations = configurations_at(robot, poses.joints, closed, columns, good)
    off, touched = {}, np.zeros(len(poses), dtype=bool)
    for touch in touches:
        looks = poses.planned[touch.name]
        looks = looks.subset(np.flatnonzero(closed.ok[looks.visits]))
        at = replace(looks, visits=np.searchsorted(good, looks.visits))
        offset = predict_readings(touching_robot, configurations, {touch.name: at})[touch.name].values
        sides = offset if touch.surface == "sphere" else np.tile([0.0, 0.0, 1.0], (len(offset), 1))
        sides = sides / np.maximum(np.linalg.norm(sides, axis=1, keepdims=True), MET)
        off[touch.name] = Readings(looks.visits, looks.pairs, offset + _OFF * sides, None, looks.details)
        touched[looks.visits] = True
    commands, misses = touching_configurations(touching_robot, poses, off)
    there = np.where((misses < MET)[:, None], commands, np.nan)
    return np.where(touched[:, None], there, poses.joints)
