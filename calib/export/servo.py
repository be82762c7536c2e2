"""Servos for the exported motors, as stiff as a simulator can be asked to hold.

A position servo that holds a load sags by load / stiffness. The stiffness here follows from the inertia that a motor
feels, so that every robot, light or heavy, sags by the gravity that acts on it over (2 pi f)^2: at 100 Hz, about
0.03 mm where gravity acts fully along the motion.
"""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from calib.export.links import possible_inertia, read_links
from calib.model.closure import residual
from calib.model.robot import Robot
from calib.model.urdf_text import UrdfText

SERVO_FREQUENCY = 100.0
"""Undamped frequency of the position servos at home, with critical damping [Hz]."""
_LEAST_INERTIA = 1e-9


def motor_inertia(robot: Robot, urdf: UrdfText) -> tuple[float, ...]:
    """Return the inertia that each motor feels at home, the loops closed and the other motors at rest [kg or kg m^2].

    With dq = E da for the motors' rates da (passive joints follow through the loops), it is the diagonal of E^T M E.
    """
    mechanism = robot.mechanism
    model = mechanism.model.copy()
    for name, link in read_links(urdf).items():
        if link.inertial is not None and link.inertial.mass > 0 and mechanism.frames.get(name, 0) > 0:
            body = pin.Inertia(link.inertial.mass, link.inertial.centre, possible_inertia(link.inertial.inertia))
            model.appendBodyToJoint(mechanism.frames[name], body, pin.SE3.Identity())
    found = robot.assemble(robot.home)
    joints = mechanism.all_joints(found.actuated, found.passive)[0]
    rates = mechanism.select_actuated
    if mechanism.passive:
        _, by_passive, by_actuated = residual(mechanism, found.actuated, found.passive)
        rates = rates - mechanism.select_passive @ np.linalg.solve(by_passive[0], by_actuated[0])
    mass = pin.crba(model, model.createData(), joints)
    mass = np.triu(mass) + np.triu(mass, 1).T
    return tuple(float(value) for value in np.diag(rates.T @ mass @ rates))


def servo_gains(inertia: float) -> tuple[float, float]:
    """Return stiffness and damping of a critically damped servo [N/m, N s/m or N m, N m s], six digits each."""
    rate, inertia = 2 * math.pi * SERVO_FREQUENCY, max(inertia, _LEAST_INERTIA)
    return float(f"{rate**2 * inertia:.6g}"), float(f"{2 * rate * inertia:.6g}")
