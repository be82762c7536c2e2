"""The kinds of effects that a model may leave out, their traits and sentences, and patterns of these kinds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum, StrEnum
from math import isnan
from typing import Self

from calib.core.base.units import DISPLAY_UNIT, ERROR_UNIT, Dimension, millimetres, quantity_text
from calib.core.base.words import joints_named


class Trait(Enum):
    """A property that some kinds of effects have."""

    IN_COURSE = "changes in the course of the measurement, and goes on changing after it"
    MOVED = "comes from a motion of something other than the robot: its base, an instrument or a target"
    MISPLACED = "is of a target that sits elsewhere than the description says"
    MISREAD = "is of one instrument, which reads something else than the description says"
    FOLLOWS_JOINTS = "follows the values of joints: at poses like those measured it stays as it is"
    BY_THE_DOZEN = "has dozens of candidates for each joint or target; only the best one is kept"


class Family(Enum):
    """Groups of kinds, each with an equal part of the chance of a false finding: many waves must not hide others."""

    SHIFTS = "shifts, and errors of joints"
    TURNS = "turns, lengths and slips"
    WAVES = "waves"


class Kind(StrEnum):
    """A kind of effect.

    Attributes:
        sentence: Text on a pattern of this kind; `describe` fills in the braces.
    """

    family: Family
    sentence: str
    traits: tuple[Trait, ...]

    AXIS = "axis", Family.SHIFTS, "a constant shift of {shift:+.3g} mm along {name}"
    TURN = "turn", Family.TURNS, "a turn of the measurement frame ({size})"
    SCALE = "scale", Family.TURNS, "lengths that are all read {ppm:+.0f} ppm too long ({size})"
    OFFSET = "offset", Family.SHIFTS, "readings of {name} are off by {constant} ({size})", Trait.MISREAD
    FACTOR = "factor", Family.TURNS, "readings of {name} are {ppm:+.0f} ppm too large ({size})", Trait.MISREAD
    DRIFT = (
        "drift",
        Family.SHIFTS,
        "a shift in the course of the measurement, as if a tracker or base had moved ({size})",
        Trait.IN_COURSE,
        Trait.MOVED,
    )
    TURNING = (
        "turning",
        Family.TURNS,
        "a turn in the course of the measurement, as if a tracker or base had turned ({size})",
        Trait.IN_COURSE,
        Trait.MOVED,
    )
    GROWTH = (
        "growth",
        Family.TURNS,
        "lengths that change in the course of the measurement, as if robot or instrument warmed up ({size})",
        Trait.IN_COURSE,
    )
    SLIP = (
        "slip",
        Family.TURNS,
        "{detail}, target {name} sits {shift:.3g} mm elsewhere on its link ({size})",
        Trait.IN_COURSE,
        Trait.MOVED,
        Trait.BY_THE_DOZEN,
    )
    LINK = (
        "link",
        Family.TURNS,
        "target {name} moves with {other}, as if it sat on the link behind it, {shift:.3g} mm from"
        " where the model has it ({size})",
        Trait.MISPLACED,
        Trait.BY_THE_DOZEN,
    )
    JOINT = "joint", Family.SHIFTS, "it follows {joint} ({size})", Trait.FOLLOWS_JOINTS
    COUPLING = (
        "coupling",
        Family.SHIFTS,
        "{joint} is off by {slope} for each {each} of {other} ({size})",
        Trait.FOLLOWS_JOINTS,
    )
    WAVE = ("wave", Family.WAVES, "it follows {joint} with {detail}, amplitude {height} ({size})", Trait.BY_THE_DOZEN)
    APPROACH = ("approach", Family.SHIFTS, "{joint} differs by {play} with the direction of approach ({size})")
    ZERO = ("zero", Family.SHIFTS, "{joint} changes in the course of the measurement ({size})", Trait.IN_COURSE)

    def __new__(cls, name: str, family: Family, sentence: str, *traits: Trait) -> Self:
        """Return a kind with its family, sentence and traits."""
        row = str.__new__(cls, name)
        row._value_, row.family, row.sentence, row.traits = name, family, sentence, traits
        return row


@dataclass(frozen=True)
class Pattern:
    """A tested effect.

    Attributes:
        name: The axis, joint or target; `xyz` for all axes.
        p_value: Chance of such a pattern from noise, over all tests.
        size: Root mean square of its contribution to positions [m], or if there are none, to other readings [SI]; of an
            effect in one instrument, to its readings.
        amount: The shift or slip [m], the constant of an instrument [SI], half the backlash or the height of a wave
            [m or rad], the relative error of lengths, the error for each unit of the other joint; NaN if the effect has
            several coefficients.
        significant: Whether it counts as a finding.
        dimension: Dimension of `size`.
        detail: In words, the cycles of a wave or the first visit of a slip; the other joint of a coupling or a link.
    """

    kind: Kind
    name: str
    p_value: float
    size: float
    amount: float
    significant: bool
    dimension: Dimension = "length"
    detail: str = ""


def describe(pattern: Pattern, dimensions: Mapping[str, Dimension]) -> str:
    """Return a pattern in words; `dimensions` says whether each joint is a length or an angle."""
    amount, joint = pattern.amount, dimensions.get(pattern.name, "length")
    return pattern.kind.sentence.format(
        name=pattern.name,
        detail=pattern.detail,
        size=f"{quantity_text(pattern.size, ERROR_UNIT[pattern.dimension])} RMS",
        joint=joints_named(pattern.name),
        other=joints_named(pattern.detail),
        shift=millimetres(amount),
        constant="a constant" if isnan(amount) else quantity_text(amount, ERROR_UNIT[pattern.dimension], "+.3g"),
        ppm=1e6 * amount,
        height=quantity_text(abs(amount), DISPLAY_UNIT[joint], ".2g"),
        play=quantity_text(2.0 * abs(amount), DISPLAY_UNIT[joint], ".2g"),
        slope=quantity_text(amount, ERROR_UNIT[joint], "+.2g"),
        each="rad" if dimensions.get(pattern.detail) == "angle" else "m",
    )
