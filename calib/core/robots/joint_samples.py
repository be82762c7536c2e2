"""Points spread evenly over the joints of a robot, the same ones however it is described.

The coordinates of a Halton point are unlike each other. Which joint has which follows from the robot at home: joints
are sorted by how far they are from the base, then by how they move the targets there; and the way that a joint moves
them says which end of its range is which. So neither the names of joints and their order count, nor which way of an
axis is called positive. Of the way the part along directions counts that no robot has, so that rounding decides
nothing.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.numerics.halton import halton
from calib.core.robots.closure import AssemblyMode, actuated_jacobian

_DIRECTIONS = np.array([0.083, 0.131, 0.179, 0.777, 1.139, 1.621])  # directions of velocities and turns of a target


def joint_samples(mode: AssemblyMode, count: int) -> FloatArray:
    """Return the first points, (count, n_driven), from 0 to 1; the first one is a corner.

    Args:
        mode: Home of the nominal robot.
    """
    mechanism = mode.mechanism
    motion = np.zeros(len(mechanism.driven))
    for target in mechanism.targets:  # seen from the base's link, wherever the measurement frame is
        seen = replace(target, a=mechanism.model.parents[target.a])
        jacobian = actuated_jacobian(mechanism, seen, mode.actuated[None], mode.passive[None])[2][0]
        motion += _DIRECTIONS / np.repeat([mechanism.length, 1.0], 3) @ jacobian * mechanism.driven_scale
    n_actuated = len(mechanism.actuated)
    order = np.arange(len(motion))  # how links are tilted comes last
    order[:n_actuated] = np.lexsort((np.abs(motion[:n_actuated]), mechanism.depths))
    samples = np.empty((count, len(motion)))
    samples[:, order] = halton(count, len(motion))
    return np.where(motion < 0, 1 - samples, samples)
