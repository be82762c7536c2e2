"""Terms with one coefficient: zero, gain, coupling, backlash, drift, and what gives way under gravity.

Backlash has a side. Where the load is small, the motion before decides it. Where gravity loads the joint, it rests on
the side to which gravity pulls it, wherever it came from, and changes over where the torque changes its sign:
dq = -c tau / sqrt(tau^2 + h^2), with the torque tau that the joint holds. h stands for friction: a torque about as
small leaves the joint somewhere between the sides. It also keeps derivatives finite.

Compliance: joints give way in proportion to the torque of gravity that they hold. The torque is that of the URDF's
masses and of the payload (Pinocchio's generalized gravity at the nominal configuration), through closed loops by
virtual work. The payload is the mass in the column `load`, which the URDF does not have; it hangs at the first target
that motors move, or at the frame that the robot description calls `payload`.

Bending: bearings and links give way across the axis of a joint, in proportion to the torque that they hold there.
Joints of a robot arm are about as soft against tilting as about their axis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar

from pydantic import Field

from calib.core.base.errors import require_known
from calib.core.base.parameter import Parameter
from calib.core.robots.terms.formula import Proportional, Source
from calib.core.robots.terms.term import Condition, Joint, JointTerm, TermSection, coefficient

_HOUR = 3600.0


@dataclass(frozen=True)
class OneCoefficient(JointTerm):
    """A term with one coefficient, dq = c phi, named after its joint and the term.

    Attributes of the class:
        source: Quantity that phi is proportional to, for the term's own joint if there is one for each.
        factor: Factor from this quantity to phi.
        word: Last part of the coefficient's name.
        expected_angle, expected_length: Expected size of the coefficient of a joint that turns [rad] or slides [m],
            where nothing is stated.
    """

    source: ClassVar[Source]
    factor: ClassVar[float] = 1.0
    word: ClassVar[str]
    expected_angle: ClassVar[float]
    expected_length: ClassVar[float]
    joint: str
    parameters: tuple[Parameter, ...]

    @classmethod
    def from_section(cls, joint: Joint, section: Any, sigma: float | None) -> JointTerm:
        """Return the term that an entry of a robot description means."""
        return cls(joint.name, cls.coefficients(joint, sigma))

    def formula(self, j: int) -> Proportional:
        """Return phi."""
        return Proportional(self.source, j if self.source.has_joints else 0, self.factor)

    @classmethod
    def coefficients(cls, joint: Joint, sigma: float | None, word: str = "") -> tuple[Parameter, ...]:
        """Return its coefficient, of the expected size where none is stated; `word` in place of that of the class."""
        dimension = "angle" if cls.tilts else joint.dimension  # a joint that slides tilts, too
        expected = cls.expected_angle if dimension == "angle" else cls.expected_length
        size = expected if sigma is None else sigma
        return (coefficient(f"{joint.name}.{word or cls.word}", dimension, size),)


class Zero(OneCoefficient):
    """dq = c: the joint's zero, where that alone is looked for. Joint origins have it already, so it is not listed."""

    word, source = "zero", Source.ONE
    expected_angle, expected_length = 5e-3, 1e-3


class Gain(OneCoefficient):
    """dq = c q, with q in radians or metres, as of a gear ratio, a belt, or the pitch of a lead screw."""

    word, source = "gain", Source.COMMAND
    cause = "gain and harmonics"
    counts_turns = True
    differs = True
    expected_angle, expected_length = 1e-3, 1e-3  # a thousandth of the motion


class Backlash(OneCoefficient):
    """dq = c (half the play) times the direction of approach, +1 or -1; 0 where it is not known."""

    word, source = "backlash", Source.APPROACH
    cause = "backlash"
    depends_on = (Condition.APPROACH,)
    per = "to either side"
    follows_command = False
    expected_angle, expected_length = 2e-4, 5e-5  # half of the play


class Drift(OneCoefficient):
    """dq = c times the hours, as the file counts time."""

    word, source, factor = "drift", Source.TIME, 1.0 / _HOUR
    cause = "drift"
    depends_on = (Condition.TIME,)
    per = "per hour"
    follows_command = False
    in_auto = False
    expected_angle, expected_length = 1e-4, 2e-5  # per hour


class Temperature(OneCoefficient):
    """dq = c times the kelvins above 20 degC."""

    word, source = "temperature", Source.WARMTH
    cause = "drift"
    depends_on = (Condition.TEMPERATURE,)
    per = "per kelvin"
    follows_command = False
    in_auto = False
    expected_angle, expected_length = 1e-4, 2e-5  # per kelvin


class Compliance(OneCoefficient):
    """dq = c times the torque of gravity that the joint holds; c < 0 where it gives way."""

    word, source = "compliance", Source.TORQUE
    cause = "load (compliance)"
    depends_on = (Condition.LOAD,)
    per = "per N m or N"
    expected_angle, expected_length = 2e-5, 1e-7  # [rad / (N m), m / N]
    needs_torque = True


class GravityBacklashSection(TermSection):
    """Backlash whose side gravity decides; from `torque` on, it has taken up most of the play [N m; N if it slides]."""

    torque: Annotated[float, Field(gt=0, allow_inf_nan=False)] = 1.0


@dataclass(frozen=True)
class GravityBacklash(OneCoefficient):
    """dq = c (half the play) towards the side to which gravity pulls; the side changes smoothly about the torque
    `knee`.
    """

    section = GravityBacklashSection
    word, source, factor = "gravity_backlash", Source.TORQUE, -1.0  # gravity pulls against what the joint holds
    cause = "backlash"
    depends_on = (Condition.LOAD,)
    per = "to the side of gravity"
    expected_angle, expected_length = Backlash.expected_angle, Backlash.expected_length
    needs_torque = True
    in_auto = False
    knee: float

    @classmethod
    def from_section(cls, joint: Joint, section: GravityBacklashSection, sigma: float | None) -> GravityBacklash:
        """Return the term that an entry of a robot description means."""
        return cls(joint.name, cls.coefficients(joint, sigma), section.torque)

    def formula(self, j: int) -> Proportional:
        """Return the sign of the torque, smooth."""
        return replace(super().formula(j), knee=self.knee)


class Bending(Compliance):
    """The link tilts by c times the torque of gravity across the axis, the same about every direction across."""

    word = "bending"
    tilts = True


class CouplingSection(TermSection):
    """A coupling with another joint, `driven_by`."""

    driven_by: str


@dataclass(frozen=True)
class Coupling(OneCoefficient):
    """dq = c times the command of another joint: of a belt, a tendon, or a motor that sits on the other's link.

    `other` is the index of that joint among the actuated ones.
    """

    section = CouplingSection
    source = Source.COMMAND
    cause = "coupling"
    depends_on = (Condition.ANOTHER_JOINT,)
    per = "per rad or m of it"
    counts_turns = True
    differs = True
    expected_angle, expected_length = 1e-3, 1e-3  # per radian or metre of the other joint
    other: int

    @classmethod
    def from_section(cls, joint: Joint, section: CouplingSection, sigma: float | None) -> Coupling:
        """Return the term of an entry of a robot description; an unknown other joint is a `ValueError`."""
        other = section.driven_by
        require_known(other, joint.actuated, "driven_by: no actuated joint", ValueError)
        if other == joint.name:
            raise ValueError("driven_by names the joint itself; use the term `gain`")
        return cls(joint.name, cls.coefficients(joint, sigma, f"by_{other}"), joint.actuated.index(other))

    @classmethod
    def entries(cls, term: str, joints: Sequence[str], actuated: Sequence[str]) -> tuple[TermSection, ...]:
        """Return an entry for each pair of a joint and another one that moved: data show which joint drives which."""
        pairs = ((joint, other) for joint in actuated for other in joints if joint != other)
        return tuple(CouplingSection(joint=joint, term=term, driven_by=other) for joint, other in pairs)

    def answers(self, section: TermSection) -> bool:
        """Whether a term couples the same two joints."""
        return isinstance(section, CouplingSection) and (
            self.parameters[0].name == f"{section.joint}.by_{section.driven_by}"
        )

    def driving_joint(self, actuated: tuple[str, ...]) -> str:
        """Return the joint that drives."""
        return actuated[self.other]

    def formula(self, j: int) -> Proportional:
        """Return the other joint's command."""
        return super().formula(self.other)
