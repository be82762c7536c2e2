"""Placing an unknown measurement frame and unknown targets before anything else is fitted.

Where the tracker stands and where the reflector sits on the flange are often not known beforehand. Both follow from the
measurements and the robot as its other parameters have it, by one fit over all targets (`calib.numerics.placement`).
The stated sigma of a target counts, with the noise of the residuals. What the measurements leave open stays where it
is.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from calib.data.measurements import Measurements
from calib.model import kinematics
from calib.model.mechanism import FloatArray, RelativeFrame
from calib.model.parameters import index_of
from calib.model.robot import Robot
from calib.numerics.placement import MovingPoint, Placement, place


def register(robot: Robot, data: Measurements) -> Robot:
    """Return the robot with the unknown ones of base and targets placed where its measurements show them.

    All its other parameters, and held ones of base and targets, keep their values.

    Raises:
        UnreachablePoseError: A pose cannot be assembled.
        DataError: Measurements that are not finite.
    """
    frame_known = robot.description.base.pose == "known"
    found = registration(robot, data, frame_known=frame_known)
    values: dict[str, float] = {}
    for target, point in zip(robot.mechanism.targets, found.points, strict=True):
        if not _is_known(robot, target):
            values |= _named(_origin(robot, target.b), ("x", "y", "z"), point)
    if not frame_known:
        base = _origin(robot, robot.mechanism.targets[0].a)
        T_measurement_link = found.T_base_measurement.inverse()
        turned = pin.log3(robot.nominal.placement(base).rotation @ T_measurement_link.rotation)
        values |= _named(base, ("x", "y", "z"), T_measurement_link.translation)
        values |= _named(base, ("rx", "ry", "rz"), turned)
    return robot.with_parameters({name: value for name, value in values.items() if name not in robot.description.held})


def registration(robot: Robot, data: Measurements, *, frame_known: bool) -> Placement:
    """Return where the measurements show the measurement frame and the unknown targets.

    Args:
        robot: The robot; its current values are what an open place stays near.
        data: Measurements.
        frame_known: Whether the measurement frame is where the robot has it, whatever the description says.

    Raises:
        UnreachablePoseError: A pose cannot be assembled.
        DataError: Measurements that are not finite.
    """
    points = [
        MovingPoint(poses, data.positions[:, t], *_expected(robot, robot.mechanism.targets[t]))
        for t, poses in enumerate(_carriers(robot, data))
    ]
    T_base_measurement = robot.mechanism.placement(_origin(robot, robot.mechanism.targets[0].a))
    return place(points, data.counts, T_base_measurement, frame_known=frame_known)


def _expected(robot: Robot, target: RelativeFrame) -> tuple[FloatArray, FloatArray]:
    """Where a target is expected in its link, and how sure that is, (3,) each [m]; see `MovingPoint`."""
    origin = _origin(robot, target.b)
    point, sigma = robot.mechanism.placement(origin).translation.copy(), np.zeros(3)
    if _is_known(robot, target):
        return point, sigma
    for k, axis in enumerate("xyz"):
        parameter = robot.parameters[index_of(robot.parameters, f"{origin}.{axis}")]
        if parameter.name not in robot.description.held:
            sigma[k] = parameter.sigma if parameter.prior else np.inf
            point[k] = parameter.nominal if parameter.prior else point[k]
    return point, sigma


def _carriers(robot: Robot, data: Measurements) -> list[FloatArray]:
    """Poses of the link that carries each target, in the link of the measurement frame, (n, 4, 4) [m] each."""
    mechanism = robot.mechanism
    parents = mechanism.model.parents
    pairs = tuple(
        RelativeFrame(target.name, parents[target.a], parents[target.b], True, ()) for target in mechanism.targets
    )
    configurations = robot.assemble(data.joints, labels=data.labels)
    joints = mechanism.all_joints(configurations.actuated, configurations.passive)
    swept = kinematics.sweep(mechanism, joints, pairs)
    return [kinematics.relative_pose(swept, pair) for pair in pairs]


def _is_known(robot: Robot, target: RelativeFrame) -> bool:
    return robot.description.targets[target.name].position == "known"


def _origin(robot: Robot, joint: int) -> str:
    return robot.mechanism.origin_names[joint - 1]


def _named(origin: str, components: tuple[str, ...], numbers: FloatArray) -> dict[str, float]:
    return {f"{origin}.{component}": float(number) for component, number in zip(components, numbers, strict=True)}
