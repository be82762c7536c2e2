"""Simulated photographs of a robot's camera, one for each visit: `calib simulate --photographs`."""

from __future__ import annotations

import numpy as np

from calib.core.base.errors import InputError
from calib.core.data.measurements import Measurements
from calib.core.instruments.kind import Readings, View
from calib.core.instruments.pixel import Pixel
from calib.core.robots.robot import Robot
from calib.core.rows.observed import seen_by
from calib.photographs.opencv import encoded
from calib.photographs.rendering import Photographer


def photographs(robot: Robot, camera: Pixel, data: Measurements, rng: np.random.Generator) -> dict[str, bytes]:
    """Return what a camera photographs at each visit, by the name of the file.

    Raises:
        InputError: Two visits have one name.
    """
    assert camera.board is not None
    assert camera.image is not None
    again = next((name for k, name in enumerate(data.names) if name in data.names[:k]), None)
    if again is not None:
        raise InputError(
            f"{data.path}: pose '{again}' appears twice; photographs are named after poses, so these need names of"
            " their own"
        )
    visits = np.arange(len(data))
    pairs, nothing = np.zeros(len(data), dtype=np.intp), np.zeros((len(data), 0))
    looks = Readings(visits, pairs, nothing, None, nothing)
    configurations = robot.assemble(data.joints, labels=data.labels, context=data.conditions)
    view = seen_by(robot, configurations, {camera.name: looks})[camera.name]
    assert isinstance(view, View)
    intrinsics = camera.numbers(robot.values[robot.unknowns(camera.name)])
    photographer = Photographer(camera.board, intrinsics, (int(camera.image[0]), int(camera.image[1])))
    poses = np.tile(np.eye(4), (len(data), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = view.rotation, view.translation
    return {
        f"{name}.png": encoded(photographer.photograph(pose, rng)) for name, pose in zip(data.names, poses, strict=True)
    }
