"""Bending: bearings and links give way across the axis of a joint, in proportion to the torque that they hold there.

The torque is that of `calib.joint_terms.compliance`, about axes across the joint's own. Joints of a robot arm are about
as soft against tilting as about their axis.
"""

from __future__ import annotations

from calib.joint_terms.compliance import Compliance
from calib.joint_terms.term import Joint, JointTerm, TermSection, coefficient


class Bending(Compliance):
    """The link tilts by c times the torque of gravity across the axis, the same about every direction across."""

    word = "bending"
    tilts = True

    @classmethod
    def of(cls, joint: Joint, section: TermSection, sigma: float | None) -> JointTerm:
        """Return the term that an entry of a robot description means."""
        size = cls.expected_angle if sigma is None else sigma  # a joint that slides tilts, too
        return cls(joint.name, (coefficient(f"{joint.name}.{cls.word}", "angle", size),))
