"""What a number that says how sure something is contains: a name for each mechanism, and which numbers it is part of.

Each number carries the set that it contains. Of a given fit that may be fewer than the table has: there is nothing to
widen by regions that agree (`calib.core.fitting.fitted.Fit.contains`).
"""

from __future__ import annotations

from collections.abc import Iterable
from enum import Enum
from typing import Self


class Sureness(Enum):
    """Numbers that say how sure something is, in words."""

    COVARIANCE = "covariance of parameters"
    INTERVAL = "intervals of parameters"
    POSITION = "uncertainty of positions"
    CLAIM = "claim (`rms`, `limit95`)"
    GAIN = "better or worse than before"


class Contribution(Enum):
    """A mechanism: its name, what it counts, the module that has it, and the numbers that it is part of."""

    NOISE = (
        "noise and priors",
        "noise of the readings and spread of the priors, propagated to the parameters",
        "numerics.statistics",
        (Sureness.COVARIANCE, Sureness.INTERVAL, Sureness.POSITION, Sureness.GAIN),
    )
    OFFSETS = (
        "offsets as weights",
        "readings of a pose that share an offset weigh less, if that predicts other poses better",
        "fitting.solving",
        (Sureness.COVARIANCE, Sureness.INTERVAL, Sureness.POSITION, Sureness.GAIN),
    )
    SCATTER = (
        "scatter of poses",
        "readings of a pose scatter together, more than independent ones would",
        "numerics.clusters",
        (Sureness.COVARIANCE, Sureness.INTERVAL, Sureness.POSITION, Sureness.GAIN),
    )
    SIZES = (
        "sizes of families",
        "the amplitude of a curve was estimated from the same readings",
        "numerics.prior_sizes",
        (Sureness.COVARIANCE, Sureness.INTERVAL, Sureness.POSITION, Sureness.GAIN),
    )
    REGIONS = (
        "regions left out",
        "parameters change by more than noise explains if a region or a setup is left out",
        "fitting.regions",
        (Sureness.COVARIANCE, Sureness.INTERVAL, Sureness.POSITION),
    )
    SECOND_ORDER = (
        "second order",
        "the model is not linear over the uncertainty of the parameters",
        "fitting.curvature",
        (Sureness.INTERVAL,),
    )
    UNDECIDED = (
        "undecided terms",
        "sizes of joint terms, also of terms that the data neither show nor exclude",
        "fitting.terms.term_sizes",
        (Sureness.INTERVAL, Sureness.POSITION),
    )
    JOINT_ERRORS = (
        "unexplained joint errors",
        "what the model leaves out, as an error of each joint that differs from pose to pose",
        "fitting.unexplained",
        (Sureness.POSITION,),
    )
    FRAME = (
        "frame",
        "positions are in the robot's own base frame, fitted to them; the uncertainty of that fit does not count",
        "rows.reported_uncertainty",
        (Sureness.POSITION,),
    )
    LEFT_OUT = (
        "poses left out",
        "errors of each pose, predicted by the fit of all others",
        "fitting.unseen_errors",
        (Sureness.CLAIM,),
    )
    BEFORE_AND_AFTER = (
        "before and after",
        "errors at poses that were not used, after calibration compared with before",
        "judging.better_or_worse",
        (Sureness.GAIN,),
    )

    def __new__(cls, name: str, counts: str, module: str, numbers: tuple[Sureness, ...]) -> Self:
        """Return a row of the table."""
        row = object.__new__(cls)
        row._value_, row.counts, row.module, row.numbers = name, counts, module, numbers
        return row

    counts: str
    module: str
    numbers: tuple[Sureness, ...]


Contributions = frozenset[Contribution]
"""What a number contains."""


def contributions_to(number: Sureness) -> Contributions:
    """Return all that may be part of a number."""
    return frozenset(own for own in Contribution if number in own.numbers)


def names_of(contributions: Iterable[Contribution]) -> list[str]:
    """Return their names, in the order of the table."""
    chosen = set(contributions)
    return [own.value for own in Contribution if own in chosen]


def markdown_table() -> str:
    """Return the table of docs/uncertainty.md: mechanisms, and the numbers that they are part of."""
    numbers = list(Sureness)
    lines = [
        f"| mechanism | what it counts | {' | '.join(number.value for number in numbers)} |",
        f"|---|---|{'|'.join(':-:' for _ in numbers)}|",
    ]
    for own in Contribution:
        page = f"reference/api/calib.core.{own.module}.md"
        marks = " | ".join("●" if number in own.numbers else "" for number in numbers)
        lines.append(f"| [{own.value}]({page}) | {own.counts} | {marks} |")
    return "\n".join(lines) + "\n"
