"""Places that only poses show with which nothing is fitted: a tool or a tracker put up anew for the validation.

Where they are is not known from the fit, and says nothing about the robot. So they are placed by those poses alone,
before and after calibration, all else held: what is left is what the robot itself is off there.

When it fails. Few poses of a small part of joint space let such a place take up errors of the robot.
"""

from __future__ import annotations

from calib.data.measurements import Measurements
from calib.fitting.problem import Problem
from calib.fitting.solving import place
from calib.robots.robot import Robot


def unseen(robot: Robot, data: Measurements, later: Measurements) -> tuple[str, ...]:
    """Return the free parameters of places that readings of `later` look at, or from, and those of `data` do not.

    Args:
        robot: The robot.
        data: Measurements to fit.
        later: Others.
    """
    new = _origins(robot, later) - _origins(robot, data)
    free = zip(robot.parameters, robot.is_free, strict=True)
    return tuple(p.name for p, is_free in free if p.placement and is_free and p.name.rpartition(".")[0] in new)


def placed_by(later: Measurements, robot: Robot, names: tuple[str, ...]) -> Robot:
    """Return a robot with these places where some measurements alone show them, all else as it is.

    Args:
        later: Measurements that show them.
        robot: The robot, before or after calibration; of the places, the free ones are placed.
        names: Parameters of the places.

    Raises:
        NotConvergedError: They cannot be placed.
        UnreachablePoseError: A pose cannot be assembled.
    """
    others = [p.name for p in robot.parameters if p.name not in names]
    alone = robot.fix(*others)
    return robot.with_parameters(place(Problem(alone, later)).values)


def _origins(robot: Robot, data: Measurements) -> set[str]:
    """Names of the origins at both ends of all that was read."""
    names, found = ("", *robot.mechanism.origin_names), set[str]()
    for name, readings in data.readings.items():
        pairs = robot.pairs(robot.instrument(name))
        for pair in {int(k) for k in readings.pairs}:
            found |= {names[pairs[pair].a], names[pairs[pair].b]}
    return found
