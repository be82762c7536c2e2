"""Formulas of joint terms: phi as data, so that it can be computed here and written down in other languages.

Every phi is one of two things: a number that is known of a command, or its smooth sign, times a constant; or sines and
cosines of multiples of a joint's command.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

import numpy as np

from calib.core.base.arrays import FloatArray


class Source(Enum):
    """Quantities of a command that terms are proportional to."""

    ONE = "one"
    COMMAND = "the command of a joint"
    APPROACH = "the direction of approach of a joint"
    TIME = "time"
    WARMTH = "kelvins above the reference"
    TORQUE = "the torque of gravity that a driven joint holds"

    @property
    def has_joints(self) -> bool:
        """Whether there is one for each joint."""
        return self in (Source.COMMAND, Source.APPROACH, Source.TORQUE)


Known = Mapping[Source, FloatArray]
"""Values of each source at n commands, (n, n_joints) or (n, 1)."""


@dataclass(frozen=True)
class Proportional:
    """phi = factor x, one column; with a knee h, phi = factor x / sqrt(x^2 + h^2): the sign of x, but smooth.

    Attributes:
        source: The quantity x.
        place: Index of the joint, where there is a number for each.
        factor: Factor of x.
        knee: h, in the unit of x; 0: phi is proportional to x.
    """

    source: Source
    place: int = 0
    factor: float = 1.0
    knee: float = 0.0

    def columns(self, known: Known) -> FloatArray:
        """Return phi, (n, 1)."""
        values = known[self.source][:, self.place : self.place + 1]
        if self.knee:
            values = values / np.hypot(values, self.knee)
        return np.asarray(values if self.factor == 1.0 else self.factor * values)

    def slope(self, known: Known) -> FloatArray:
        """Return the derivative of phi by x, (n, 1)."""
        values = known[self.source][:, self.place : self.place + 1]
        if not self.knee:
            return np.full_like(values, self.factor)
        return np.asarray(self.factor * self.knee**2 / np.hypot(values, self.knee) ** 3)


@dataclass(frozen=True)
class WaveFormula:
    """phi = sin(k base q), cos(k base q) for every order k, two columns each.

    Attributes:
        place: Number of the actuated joint whose command is q.
        base: Phase per unit of q [rad/rad or rad/m].
        orders: Every k.
    """

    place: int
    base: float
    orders: tuple[int, ...]

    def columns(self, known: Known) -> FloatArray:
        """Return phi, (n, 2 n_orders)."""
        q = known[Source.COMMAND][:, self.place]
        phase = np.outer(q, self.orders) * self.base
        return np.stack([np.sin(phase), np.cos(phase)], axis=2).reshape(len(q), 2 * phase.shape[1])


Formula = Proportional | WaveFormula
