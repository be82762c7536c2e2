"""Compliance: joints give way under gravity, in proportion to the torque that they hold.

The torque is that of the URDF's masses and of the payload (Pinocchio's generalized gravity at the nominal
configuration), through closed loops by virtual work. The payload is the mass in the column `load`, beside what the URDF
has; it hangs at the first target that motors move, or at the frame that the robot description calls `payload`.
"""

from __future__ import annotations

import numpy as np

from calib.arrays import FloatArray
from calib.joint_terms.term import Context, OneCoefficient


class Compliance(OneCoefficient):
    """dq = c times the torque of gravity that the joint holds."""

    word = "compliance"
    cause = "load (compliance)"
    depends_on = "the load"
    expected_angle, expected_length = 2e-5, 1e-7  # [rad / (N m), m / N]
    needs_torque = True

    def columns(self, q: FloatArray, j: int, context: Context) -> FloatArray:
        """Return the torque, (n, 1)."""
        assert context.torque is not None
        return np.asarray(context.torque[:, j : j + 1])
