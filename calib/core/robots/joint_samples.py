"""Points spread evenly over the joints of a robot, the same ones however it is described.

The coordinates of a Halton point are unlike each other. The robot at home decides which joint gets which: joints are
sorted by their distance from the base, then by how they move the targets; and the motion of the targets decides which
end of a joint's range is the lower one. So names and order of joints do not count, nor which direction of an axis is
called positive. The motion is compared along skew directions that no robot's axes have, so that rounding decides
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
    order = np.arange(len(motion))  # tilts of links come last
    order[:n_actuated] = np.lexsort((np.abs(motion[:n_actuated]), mechanism.depths))
    samples = np.empty((count, len(motion)))
    samples[:, order] = halton(count, len(motion))
    return np.where(motion < 0, 1 - samples, samples)
