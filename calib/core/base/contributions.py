"""Contributions to measures of uncertainty: each mechanism by name, and the numbers that contain it.

Each number carries the set of its contributions. For a given fit the set may be smaller than in the table: regions that
agree, for example, widen nothing (`calib.core.fitting.fitted.Fit.contains`).
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


class Contribution(Enum):
    """A mechanism: its name, its effect, the module that computes it, and the numbers that contain it."""

    NOISE = (
        "noise and priors",
        "noise of the readings and spread of the priors, propagated to the parameters",
        "numerics.statistics",
        (Uncertainty.COVARIANCE, Uncertainty.INTERVAL, Uncertainty.POSITION, Uncertainty.GAIN),
    )
    SCATTER = (
        "scatter of poses",
        "readings of a pose scatter together, more than independent ones would",
        "numerics.clusters",
        (Uncertainty.COVARIANCE, Uncertainty.INTERVAL, Uncertainty.POSITION, Uncertainty.GAIN),
    )
    SIZES = (
        "sizes of families",
        "the amplitude of a curve was estimated from the same readings",
        "numerics.size_search",
        (Uncertainty.COVARIANCE, Uncertainty.INTERVAL, Uncertainty.POSITION, Uncertainty.GAIN),
    )
    REGIONS = (
        "regions left out",
        "parameters change by more than noise explains if a region or a setup is left out",
        "fitting.regions",
        (Uncertainty.COVARIANCE, Uncertainty.INTERVAL, Uncertainty.POSITION),
    )
    SECOND_ORDER = (
        "second order",
        "the model is not linear over the uncertainty of the parameters",
        "fitting.curvature",
        (Uncertainty.INTERVAL,),
    )
    UNDECIDED = (
        "undecided terms",
        "joint terms that the fit lacks, although the data show or allow them; uncertain sizes of the fit's terms",
        "fitting.terms.kind_model",
        (Uncertainty.INTERVAL, Uncertainty.POSITION),
    )
    JOINT_ERRORS = (
        "unexplained joint errors",
        "what the model leaves out, as an error of each joint that differs from pose to pose",
        "fitting.unexplained",
        (Uncertainty.POSITION,),
    )
    FRAME = (
        "frame",
        "positions are in a base frame that is fitted to them; the uncertainty of this frame does not count",
        "rows.frames",
        (Uncertainty.POSITION,),
    )
    LEFT_OUT = (
        "poses left out",
        "errors of each pose, predicted by the fit of all others",
        "fitting.unseen_errors",
        (Uncertainty.CLAIM,),
    )
    BEFORE_AND_AFTER = (
        "before and after",
        "errors before and after calibration, at poses that were not used",
        "judging.better_or_worse",
        (Uncertainty.GAIN,),
    )

    def __new__(cls, name: str, counts: str, module: str, numbers: tuple[Uncertainty, ...]) -> Self:
        """Return a contribution with what it counts, its module and its numbers."""
        row = object.__new__(cls)
        row._value_, row.counts, row.module, row.numbers = name, counts, module, numbers
        return row

    counts: str
    module: str
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
