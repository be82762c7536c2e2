"""Backlash: an error of half the play, by the direction from which the joint came."""

from __future__ import annotations

import numpy as np

from calib.arrays import FloatArray
from calib.joint_terms.term import Context, OneCoefficient


class Backlash(OneCoefficient):
    """dq = c times the direction of approach, +1 or -1; 0 where it is not known."""

    word = "backlash"
    cause = "backlash"
    depends_on = "the direction of approach"
    expected_angle, expected_length = 2e-4, 5e-5  # half of the play

    def columns(self, q: FloatArray, j: int, context: Context) -> FloatArray:
        """Return the direction of approach, (n, 1)."""
        return np.asarray(context.approach[:, j : j + 1])
