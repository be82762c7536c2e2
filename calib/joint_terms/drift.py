"""Drift: an error that grows with time (`drift`) or with temperature (`temperature`)."""

from __future__ import annotations

import numpy as np

from calib.arrays import FloatArray
from calib.joint_terms.term import Context, OneCoefficient

HOUR = 3600.0


class Drift(OneCoefficient):
    """dq = c times the hours, as the file counts time."""

    word = "drift"
    cause = "drift"
    depends_on = "time"
    expected_angle, expected_length = 1e-4, 2e-5  # per hour

    def columns(self, q: FloatArray, j: int, context: Context) -> FloatArray:
        """Return hours, (n, 1)."""
        return np.asarray(context.time[:, None] / HOUR)


class Temperature(OneCoefficient):
    """dq = c times the kelvins above 20 degC."""

    word = "temperature"
    cause = "drift"
    depends_on = "temperature"
    expected_angle, expected_length = 1e-4, 2e-5  # per kelvin

    def columns(self, q: FloatArray, j: int, context: Context) -> FloatArray:
        """Return kelvins, (n, 1)."""
        return np.asarray(context.temperature[:, None])
