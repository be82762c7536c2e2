"""The kinds of effects that a model may leave out: what is true of each, and its sentence."""

from __future__ import annotations

from enum import Enum, StrEnum
from typing import Self


class Trait(Enum):
    """What is true of some kinds of effects."""

    IN_COURSE = "changes in the course of the measurement, and goes on changing after it"
    MOVED = "is of what moved beside the robot: its base, an instrument or a target"
    MISPLACED = "is of a target that sits elsewhere than the description says"
    FOLLOWS_JOINTS = "follows the values of joints: at poses like those measured it stays as it is"
    BY_THE_DOZEN = "is tried by the dozen for each joint or target, and the best is kept"


class Family(Enum):
    """Kinds that share an equal part of the chance of a false finding: the many waves must not hide the others."""

    SHIFTS = "shifts, and errors of joints"
    TURNS = "turns, lengths and slips"
    WAVES = "waves"


class Kind(StrEnum):
    """A kind of effect.

    Attributes:
        family: Which kinds it shares the chance of a false finding with.
        sentence: What a pattern of it says; in braces, what is of the pattern and of its
            `calib.core.judging.residual_patterns.PatternWords`.
        traits: What is true of it.
    """

    family: Family
    sentence: str
    traits: tuple[Trait, ...]

    AXIS = "axis", Family.SHIFTS, "a constant shift of {words.shift:+.3g} mm along {pattern.name}"
    TURN = "turn", Family.TURNS, "a turn of the measurement frame ({words.size})"
    SCALE = "scale", Family.TURNS, "lengths that are all read {words.ppm:+.0f} ppm too long ({words.size})"
    DRIFT = (
        "drift",
        Family.SHIFTS,
        "a shift in the course of the measurement, as if a tracker or base had moved ({words.size})",
        Trait.IN_COURSE,
        Trait.MOVED,
    )
    TURNING = (
        "turning",
        Family.TURNS,
        "a turn in the course of the measurement, as if a tracker or base had turned ({words.size})",
        Trait.IN_COURSE,
        Trait.MOVED,
    )
    GROWTH = (
        "growth",
        Family.TURNS,
        "lengths that change in the course of the measurement, as if robot or instrument warmed up ({words.size})",
        Trait.IN_COURSE,
    )
    SLIP = (
        "slip",
        Family.TURNS,
        "{pattern.detail}, target {pattern.name} sits {words.shift:.3g} mm elsewhere on its link ({words.size})",
        Trait.IN_COURSE,
        Trait.MOVED,
        Trait.BY_THE_DOZEN,
    )
    LINK = (
        "link",
        Family.TURNS,
        "target {pattern.name} moves with {words.other}, as if it sat on the link behind it, {words.shift:.3g} mm from"
        " where the model has it ({words.size})",
        Trait.MISPLACED,
        Trait.BY_THE_DOZEN,
    )
    JOINT = "joint", Family.SHIFTS, "it follows {words.joint} ({words.size})", Trait.FOLLOWS_JOINTS
    COUPLING = (
        "coupling",
        Family.SHIFTS,
        "{words.joint} is off by {words.slope} for each {words.each} of {words.other} ({words.size})",
        Trait.FOLLOWS_JOINTS,
    )
    WAVE = (
        "wave",
        Family.WAVES,
        "it follows {words.joint} with {pattern.detail}, amplitude {words.height} ({words.size})",
        Trait.BY_THE_DOZEN,
    )
    APPROACH = (
        "approach",
        Family.SHIFTS,
        "{words.joint} differs by {words.play} with the direction of approach ({words.size})",
    )
    ZERO = (
        "zero",
        Family.SHIFTS,
        "{words.joint} changes in the course of the measurement ({words.size})",
        Trait.IN_COURSE,
    )

    def __new__(cls, name: str, family: Family, sentence: str, *traits: Trait) -> Self:
        """Return a row of the table."""
        row = str.__new__(cls, name)
        row._value_, row.family, row.sentence, row.traits = name, family, sentence, traits
        return row
