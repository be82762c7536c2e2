"""What a URDF without a robot description stands for, and the commented text of a description to start from."""

from __future__ import annotations

import textwrap

import yaml

from calib.model.arm_chain import ArmChain
from calib.model.description import BaseSection, Description, TargetSection
from calib.model.parametrisation import default_sections
from calib.model.urdf_text import HELD_TYPES, UrdfText

_TEXT = """\
# Robot description of {robot}. Lengths and angles are m and rad, or carry a unit: 0.04 mm, 1.5 deg.
urdf: {urdf}

# Joints with a motor, in the order of every joint vector. Measurement files have one column for each.
{remark}name_mot: {actuated}

# Closed loops: cut them open in the URDF, name the two frames that coincide, and constrain only the directions that
# the mechanism constrains (a planar five-bar about x: y and z). Passive joints are those of the loops without a motor.
# closed_loop: [[frame_a, frame_b]]
# type: [3d]                      # 3d: the points coincide; 6d: the whole frames
# closed_loop_axes: [[y, z]]
# home: {{{home}}}                # an assembled configuration, needed with loops: every joint of them

# The frame of the measurements: fixed to this link. 'unknown': found from the measurements (a tracker anywhere);
# 'known': measurements are in this link's frame, or in one that sees it at `xyz: [..]`, `rpy: [..]`.
base: {{frame: {base}, pose: unknown}}

# What is measured: columns <name>_x, <name>_y, <name>_z. `xyz` is about where the point is on the link; add
# `sigma: 10 mm` if you know how far off that may be, which helps where the last joints hardly turned.
targets:
  {target}: {{frame: {target}, xyz: [0 mm, 0 mm, 0 mm], position: unknown}}

# What may be wrong, and by how much (sigma, one standard deviation). `all` means every joint origin that moves a
# target; an entry with a joint's name overrides it. x, y, z: translation; rx, ry, rz: small rotations about the
# joint frame's axes.
# Joints on the way: {joints}
parametrisation:
  - {{origin: all, components: [x, y, z], sigma: {length}}}
  - {{origin: all, components: [rx, ry, rz], sigma: {angle}}}
# held: [{example}.x]             # keep some at nominal
# priors: false                   # let the measurements alone decide

# Standard deviation of one measured coordinate; left out, it is found from the residuals.
# sigma: 0.04 mm

# Columns of foreign files, and what they stand for.
# columns: {{x1: "{target}_x [m]", j1: "{example} [deg]"}}
"""


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


def description_text(urdf: UrdfText, description: Description, remark: str = "") -> str:
    """Return the YAML text of a plain URDF's description, with comments.

    Args:
        urdf: The URDF.
        description: What it stands for.
        remark: What to say about the joints that it leaves out.
    """
    target = next(iter(description.targets))
    lengths, angles = default_sections()
    parent = {joint.child: joint for joint in urdf.joints}
    link = target
    joints: list[str] = []
    while link != description.base.frame:
        joints.insert(0, parent[link].name)
        link = parent[link].parent
    moving = [joint.name for joint in urdf.joints if joint.type not in HELD_TYPES]

    def quoted(value: object) -> str:  # as an entry of a list, so that commas and brackets are quoted too
        text = str(yaml.safe_dump([value], default_flow_style=True, allow_unicode=True, width=10**6))
        return text.strip()[1:-1]

    remark = " ".join(remark.split())
    lines = textwrap.wrap(remark[:1].upper() + remark[1:], 116, break_long_words=False, break_on_hyphens=False)
    return _TEXT.format(
        remark="".join(f"# {line}\n" for line in lines),
        robot=" ".join(urdf.name.split()) or "a robot",
        urdf=quoted(description.urdf),
        actuated=quoted(list(description.name_mot)),
        home=", ".join(f"{quoted(name)}: 0" for name in moving[:2]),
        base=quoted(description.base.frame),
        target=quoted(target),
        joints=" ".join(", ".join(joints).split()),
        length=lengths.sigma,
        angle=angles.sigma,
        example=quoted(description.name_mot[0]),
    )
