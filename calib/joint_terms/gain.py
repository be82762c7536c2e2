"""Gain: an error in proportion to the joint's value, as of a gear ratio, a belt, or the pitch of a lead screw."""

from __future__ import annotations

import numpy as np

from calib.arrays import FloatArray
from calib.joint_terms.term import Context, OneCoefficient


class Gain(OneCoefficient):
    """dq = c q, with q in radians or metres."""

    word = "gain"
    counts_turns = True
    expected_angle, expected_length = 1e-3, 1e-3  # a thousandth of the motion

    def columns(self, q: FloatArray, j: int, context: Context) -> FloatArray:
        """Return q, (n, 1)."""
        return np.asarray(q[:, j : j + 1])
