"""What a URDF without a robot description stands for."""

from __future__ import annotations

from calib.model.arm_chain import ArmChain
from calib.model.description import BaseSection, Description, TargetSection
from calib.model.parametrisation import default_sections


def describe(chain: ArmChain, urdf_path: str) -> Description:
    """Return the description that a plain URDF stands for.

    The base is the link that the first moving joint stands on, not the root: where an unknown base is, a fixed joint
    between the two says nothing.

    Args:
        chain: Its arm, or the chain to the link that carries the measured point.
        urdf_path: How the description names the URDF.
    """
    return Description(
        urdf=urdf_path,
        name_mot=chain.joints,
        base=BaseSection(frame=chain.base, pose="unknown"),
        targets={chain.target: TargetSection(frame=chain.target, position="unknown")},
        parametrisation=default_sections(),
    )
