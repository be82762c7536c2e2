"""Coupling: a joint that moves with another one, as by a belt, a tendon, or a motor that sits on the other's link."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from calib.core.base.errors import require_known
from calib.core.base.parameter import Parameter
from calib.core.base.units import Dimension
from calib.core.robots.terms.formula import Formula, Proportional, Source
from calib.core.robots.terms.term import Condition, Joint, JointTerm, TermSection, coefficient

EXPECTED: dict[Dimension, float] = {"angle": 1e-3, "length": 1e-3}
"""Expected error per radian or metre of the other joint, where nothing is stated [rad, m]."""


def coupling_name(joint: str, other: str) -> str:
    """Return the name of the coefficient of a joint that another one drives."""
    return f"{joint}.by_{other}"


class CouplingSection(TermSection):
    """A coupling.

    Attributes:
        driven_by: The other joint.
    """

    driven_by: str


@dataclass(frozen=True)
class Coupling(JointTerm):
    """dq = c times the command of another joint, in radians or metres."""

    section = CouplingSection
    cause = "coupling"
    depends_on = (Condition.ANOTHER_JOINT,)
    per = "per rad or m of it"
    counts_turns = True
    differs = True
    joint: str
    parameters: tuple[Parameter, ...]
    other: int

    @classmethod
    def from_section(cls, joint: Joint, section: CouplingSection, sigma: float | None) -> Coupling:
        """Return the term that an entry of a robot description means.

        Raises:
            ValueError: There is no such other joint.
        """
        other = section.driven_by
        require_known(other, joint.actuated, "driven_by: no actuated joint", ValueError)
        if other == joint.name:
            raise ValueError("driven_by names the joint itself; use the term `gain`")
        size = EXPECTED[joint.dimension] if sigma is None else sigma
        name = coupling_name(joint.name, other)
        return cls(joint.name, (coefficient(name, joint.dimension, size),), joint.actuated.index(other))

    @classmethod
    def entries(cls, term: str, joints: Sequence[str], actuated: Sequence[str]) -> tuple[TermSection, ...]:
        """Return an entry for each pair of a joint and another one that moved: data show which joint drives which."""
        pairs = ((joint, other) for joint in actuated for other in joints if joint != other)
        return tuple(CouplingSection(joint=joint, term=term, driven_by=other) for joint, other in pairs)

    def answers(self, section: TermSection) -> bool:
        """Whether a term couples the same two joints."""
        return isinstance(section, CouplingSection) and self.parameters[0].name == coupling_name(
            section.joint, section.driven_by
        )

    def driving_joint(self, actuated: tuple[str, ...]) -> str:
        """Return the joint that drives."""
        return actuated[self.other]

    def formula(self, j: int) -> Formula:
        """Return the other joint's command."""
        return Proportional(Source.COMMAND, self.other)
