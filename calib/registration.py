"""Placing an unknown measurement frame and unknown targets before anything else is fitted.

Where the tracker stands and where the reflector sits on the flange are often not known beforehand. Both follow in
closed form from the measurements and the nominal robot, well enough for the iteration to start from. The measurement
frame comes from the first target; the others follow from it.
"""

from __future__ import annotations

import pinocchio as pin

from calib.measurements import Measurements
from calib.mechanism import FloatArray, RelativeFrame
from calib.placement import place_base_and_target, place_target
from calib.robot import Robot


def register(robot: Robot, data: Measurements) -> Robot:
    """Return the robot with the unknown ones of base and targets placed by closed-form fits.

    Raises:
        DataError: The measured points are too few or lie on a line, so that they fix no frame.
    """
    nominal = robot.nominal
    base = nominal.origin_names[nominal.targets[0].a - 1]
    frame = nominal.placement(base)
    values: dict[str, float] = {}
    for t, target in enumerate(nominal.targets):
        origin = nominal.origin_names[target.b - 1]
        point = nominal.placement(origin).translation
        known = robot.description.targets[target.name].position == "known"
        poses = _carrier_in_base_link(robot, data, target)
        if t == 0 and robot.description.base.pose == "unknown":
            frame, point = place_base_and_target(poses, data.positions[:, t], point, point_known=known)
            T_measurement_link = frame.inverse()
            turned = pin.log3(nominal.placement(base).rotation @ T_measurement_link.rotation)
            values |= _named(base, ("x", "y", "z"), T_measurement_link.translation)
            values |= _named(base, ("rx", "ry", "rz"), turned)
        elif not known:
            point = place_target(poses, data.positions[:, t], frame)
        if not known:
            values |= _named(origin, ("x", "y", "z"), point)
    return robot.with_parameters(values)


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
