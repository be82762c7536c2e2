"""What a URDF without a robot description stands for."""

from __future__ import annotations

from calib.errors import DescriptionError, nearest
from calib.model.description import BaseSection, Description, TargetSection
from calib.model.parametrisation import default_sections
from calib.model.urdf_text import HELD_TYPES, UrdfText


def describe(urdf: UrdfText, urdf_path: str, target: str | None = None) -> Description:
    """Return the description that a plain URDF stands for.

    Args:
        urdf: The URDF.
        urdf_path: How the description names it.
        target: Link that carries the measured point; the last link if not given.

    Raises:
        DescriptionError: The tree branches, so that there is no last link, or nothing moves.
    """
    parent_of = {joint.child: joint for joint in urdf.joints}

    def moving(link: str) -> list[str]:
        names: list[str] = []
        while link in parent_of:
            joint = parent_of[link]
            if joint.type not in HELD_TYPES and joint.mimic is None:
                names.insert(0, joint.name)
            link = joint.parent
        return names

    if target is None:
        ends = [link for link in urdf.links if all(joint.parent != link for joint in urdf.joints)]
        longest = max(ends, key=lambda link: len(moving(link)))
        if any(not set(moving(link)) <= set(moving(longest)) for link in ends):
            raise DescriptionError(
                f"{urdf.path}: the robot branches, so it has no last link; choose a link such as"
                f" {', '.join(ends[:10])}{', ...' if len(ends) > 10 else ''} with"
                f" `calib init {urdf.path} --target LINK --out FILE`"
            )
        target = [link for link in ends if moving(link) == moving(longest)][-1]
    elif target not in urdf.links:
        raise DescriptionError(f"{urdf.path}: no link '{target}'{nearest(target, urdf.links)}")
    names = moving(target)
    if not names:
        raise DescriptionError(f"{urdf.path}: no joint moves link '{target}'; there is nothing to calibrate")
    root = next(link for link in urdf.links if link not in parent_of)
    return Description(
        urdf=urdf_path,
        name_mot=tuple(names),
        base=BaseSection(frame=root, pose="unknown"),
        targets={target: TargetSection(frame=target, position="unknown")},
        parametrisation=default_sections(),
    )
