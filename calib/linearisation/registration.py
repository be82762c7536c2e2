"""Placing an unknown measurement frame and unknown targets before anything else is fitted.

Where the tracker stands and where the reflector sits on the flange are often not known beforehand. Both follow in
closed form from the measurements and the nominal robot, well enough for the iteration to start from. The measurement
frame comes from one target, the places of the others from that frame. Each target is tried for the frame, since one
that few joints move leaves it open (a point on the first link: which way up?); the one that explains all measurements
best is taken.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from calib.data.measurements import Measurements
from calib.errors import DataError
from calib.model.mechanism import FloatArray, RelativeFrame
from calib.model.robot import Robot
from calib.numerics.placement import place_base_and_target, place_target


def register(robot: Robot, data: Measurements) -> Robot:
    """Return the robot with the unknown ones of base and targets placed by closed-form fits.

    Raises:
        DataError: The measured points are too few or lie on a line, so that they fix no frame.
    """
    if robot.description.base.pose == "known":
        return robot.with_parameters(_target_values(robot, data, robot.nominal.placement(_base(robot))))
    placed: list[Robot] = []
    problems: list[DataError] = []
    for t in range(len(robot.target_names)):
        try:
            placed.append(robot.with_parameters(_from_one_target(robot, data, t)))
        except DataError as error:
            problems.append(error)
    if not placed:
        raise problems[0]
    return min(placed, key=lambda found: float(np.sum((found.positions(data.joints) - data.positions) ** 2)))


def _base(robot: Robot) -> str:
    return robot.nominal.origin_names[robot.nominal.targets[0].a - 1]


def _is_known(robot: Robot, target: RelativeFrame) -> bool:
    return robot.description.targets[target.name].position == "known"


def _from_one_target(robot: Robot, data: Measurements, t: int) -> dict[str, float]:
    """Base from target t, and the other targets from that."""
    target = robot.nominal.targets[t]
    guess = robot.nominal.placement(robot.nominal.origin_names[target.b - 1]).translation
    frame, _ = place_base_and_target(
        _carrier_in_base_link(robot, data, target),
        data.positions[:, t],
        guess,
        point_known=_is_known(robot, target),
    )
    T_measurement_link = frame.inverse()
    turned = pin.log3(robot.nominal.placement(_base(robot)).rotation @ T_measurement_link.rotation)
    values = _named(_base(robot), ("x", "y", "z"), T_measurement_link.translation)
    values |= _named(_base(robot), ("rx", "ry", "rz"), turned)
    return values | _target_values(robot, data, frame)


def _target_values(robot: Robot, data: Measurements, T_link_measurement: pin.SE3) -> dict[str, float]:
    """Places of the unknown targets where the measurement frame is known."""
    values: dict[str, float] = {}
    for t, target in enumerate(robot.nominal.targets):
        if not _is_known(robot, target):
            poses = _carrier_in_base_link(robot, data, target)
            point = place_target(poses, data.positions[:, t], T_link_measurement)
            values |= _named(robot.nominal.origin_names[target.b - 1], ("x", "y", "z"), point)
    return values


def _carrier_in_base_link(robot: Robot, data: Measurements, target: RelativeFrame) -> FloatArray:
    """Nominal poses of the link that carries the target, in the link of the measurement frame, (n, 4, 4)."""
    nominal = robot.nominal
    carrier = nominal.model.parents[target.b]
    link = next(name for name, frame in nominal.frames.items() if frame == carrier)
    T_link_measurement = nominal.placement(nominal.origin_names[target.a - 1]).homogeneous
    poses: FloatArray = T_link_measurement @ robot.forward(data.joints, link)
    return poses


def _named(origin: str, components: tuple[str, ...], numbers: FloatArray) -> dict[str, float]:
    return {f"{origin}.{component}": float(number) for component, number in zip(components, numbers, strict=True)}
