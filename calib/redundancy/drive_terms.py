"""Errors of a drive that a second encoder behind it shows: play with memory, and yielding in proportion to a load.

Play of width 2 r is a stop operator, s in [-1, 1], the side of its play on which a joint rests:

    s = clip(s_before + (q - q_before) / r, -1, 1)         dq = c s,       c = -r for ideal play

s follows from the order of commands, or is stated in columns `play_<joint>` (`play_<joint>_1`, ... for several r).
Several r, each with its c, make any hysteresis that depends on the path alone and not on time (Prandtl and Ishlinskii).
If every motion is longer than 2 r, that is backlash by the direction of approach.

When it fails. s of the first rows is unknown: 0, until the joint has moved by 2 r in one direction.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import accumulate, pairwise

import numpy as np
from pydantic import Field

from calib.core.base.arrays import FloatArray
from calib.core.base.parameter import Parameter
from calib.core.base.sections import Quantity
from calib.core.base.units import quantity
from calib.core.robots.terms.term import Context, Joint, JointTerm, TermSection, coefficient

_SIZE = {"angle": 1e-3, "length": 1e-4}  # expected size of a coefficient [rad], [m]


class PlaySection(TermSection):
    """A joint's play; `travel` is r, half of the motion through the play: one or several."""

    travel: Quantity | list[Quantity]


@dataclass(frozen=True)
class Play(JointTerm):
    """Play with memory; see the module docstring. `travel` has every r [m or rad]."""

    section = PlaySection
    cause = "hysteresis"
    per = "to either side"
    in_auto = False
    joint: str
    parameters: tuple[Parameter, ...]
    travel: tuple[float, ...]

    @classmethod
    def from_section(cls, joint: Joint, section: PlaySection, sigma: float | None) -> Play:
        """Return the term of an entry in a robot description."""
        given = section.travel if isinstance(section.travel, list) else [section.travel]
        travel = tuple(quantity(each, joint.dimension, "travel", ValueError) for each in given)
        if not travel or min(travel) <= 0:
            raise ValueError("travel must be positive: it is half of the motion from one side of the play to the other")
        numbers = [""] if len(travel) == 1 else [f"_{k + 1}" for k in range(len(travel))]
        size = sigma or _SIZE[joint.dimension]
        return cls(
            joint.name, tuple(coefficient(f"{joint.name}.play{k}", joint.dimension, size) for k in numbers), travel
        )

    def reads(self) -> tuple[str, ...]:
        """Return `play_<joint>`, or one column for each r."""
        return tuple(f"play_{self.joint}{parameter.name.rpartition('.play')[2]}" for parameter in self.parameters)

    def states_by_order(self, q: FloatArray) -> Mapping[str, FloatArray]:
        """Return s of every r."""
        return {name: stop_states(q / r) for name, r in zip(self.reads(), self.travel, strict=True)}

    def columns(self, q: FloatArray, j: int, context: Context) -> FloatArray:
        """Return s of every r, (n, n_coefficients)."""
        return np.column_stack([context.column(name) for name in self.reads()])


def stop_states(way: FloatArray) -> FloatArray:
    """Return s of the stop operator for commands (n,) in units of r, (n,)."""
    steps = [b - a for a, b in pairwise(way.tolist())]
    states = list(accumulate(steps, lambda s, step: min(1.0, max(-1.0, s + step)), initial=0.0))
    return np.array(states[: len(way)])


class InProportionSection(TermSection):
    """A joint that yields in proportion to a `column` of the file: a torque, force or current, as pure numbers."""

    column: str = Field(min_length=1)


@dataclass(frozen=True)
class InProportion(JointTerm):
    """dq = c x, with x a column of the file: a drive that winds up under the stated torque or current."""

    section = InProportionSection
    cause = "load (compliance)"
    follows_command = False
    in_auto = False
    joint: str
    parameters: tuple[Parameter, ...]
    column: str

    @classmethod
    def from_section(cls, joint: Joint, section: InProportionSection, sigma: float | None) -> InProportion:
        """Return the term of an entry in a robot description."""
        name, size = f"{joint.name}.per_{section.column}", sigma or _SIZE[joint.dimension]
        return cls(joint.name, (coefficient(name, joint.dimension, size),), section.column)

    def reads(self) -> tuple[str, ...]:
        """Return the column to which the error is proportional."""
        return (self.column,)

    def columns(self, q: FloatArray, j: int, context: Context) -> FloatArray:
        """Return x, (n, 1)."""
        return context.column(self.column)[:, None]
