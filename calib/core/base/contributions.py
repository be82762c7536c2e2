"""Contributions to measures of uncertainty: each mechanism by name, and the numbers that contain it.

Each number carries the set of its contributions. For a given fit the set may be smaller than in the table: regions that
agree, for example, widen nothing (`calib.core.fitting.fitted.Fit.contains`). docs/uncertainty.md says what each
mechanism counts, and which module computes it.
"""

from __future__ import annotations

from collections.abc import Iterable
from enum import Enum
from typing import Self


class Uncertainty(Enum):
    """Measures of uncertainty, in words."""

    COVARIANCE = "covariance of parameters"
    INTERVAL = "intervals of parameters"
    POSITION = "uncertainty of positions"
    CLAIM = "claim (`rms`, `limit95`)"
    GAIN = "better or worse than before"


_ALL_BUT_CLAIM = (Uncertainty.COVARIANCE, Uncertainty.INTERVAL, Uncertainty.POSITION, Uncertainty.GAIN)


class Contribution(Enum):
    """A mechanism: its name, and the numbers that contain it."""

    NOISE = ("noise and priors", _ALL_BUT_CLAIM)
    SCATTER = ("scatter of poses", _ALL_BUT_CLAIM)
    SIZES = ("sizes of families", _ALL_BUT_CLAIM)
    REGIONS = ("regions left out", (Uncertainty.COVARIANCE, Uncertainty.INTERVAL, Uncertainty.POSITION))
    SECOND_ORDER = ("second order", (Uncertainty.INTERVAL,))
    UNDECIDED = ("undecided terms", (Uncertainty.INTERVAL, Uncertainty.POSITION))
    JOINT_ERRORS = ("unexplained joint errors", (Uncertainty.POSITION,))
    SIDES = ("unknown directions of approach", (Uncertainty.POSITION,))
    FRAME = ("frame", (Uncertainty.POSITION,))
    LEFT_OUT = ("poses left out", (Uncertainty.CLAIM,))
    BEFORE_AND_AFTER = ("before and after", (Uncertainty.GAIN,))

    def __new__(cls, name: str, numbers: tuple[Uncertainty, ...]) -> Self:
        """Return a contribution, whose value is its name."""
        row = object.__new__(cls)
        row._value_, row.numbers = name, numbers
        return row

    numbers: tuple[Uncertainty, ...]


Contributions = frozenset[Contribution]
"""Set of the contributions to a number."""


def contributions_to(number: Uncertainty) -> Contributions:
    """Return all contributions that a number may contain."""
    return frozenset(own for own in Contribution if number in own.numbers)


def names_of(contributions: Iterable[Contribution]) -> list[str]:
    """Return the names of contributions, in the order of the table."""
    chosen = set(contributions)
    return [own.value for own in Contribution if own in chosen]
