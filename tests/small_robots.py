"""Small robots for tests, simple enough to compute by hand."""

import re
from pathlib import Path

import numpy as np

import calib
from tests.project import EXAMPLES
from tests.urdf_trees import urdf_of

ARM_URDF = """\
<?xml version="1.0"?>
<robot name="small arm">
  <link name="ground"/> <link name="upper"/> <link name="slider"/> <link name="hand"/> <link name="tool"/>
  <joint name="turn" type="revolute">
    <parent link="ground"/> <child link="upper"/>
    <origin xyz="0 0 0.5"/> <axis xyz="0 0 1"/> <limit lower="-3" upper="3" effort="1" velocity="1"/>
  </joint>
  <joint name="slide" type="prismatic">
    <parent link="upper"/> <child link="slider"/>
    <origin xyz="0.25 0 0" rpy="0 0 0"/> <axis xyz="1 0 0"/> <limit lower="0" upper="1" effort="1" velocity="1"/>
  </joint>
  <joint name="wrist" type="continuous">
    <parent link="slider"/> <child link="hand"/>
    <origin xyz="0.125 0 0.0" rpy="0 1.5707963267948966 0"/> <axis xyz="0 1 0"/>
  </joint>
  <joint name="flange" type="fixed">
    <parent link="hand"/> <child link="tool"/> <origin rpy="0 0 0.75" xyz="0 0 1e-1"/>
  </joint>
</robot>
"""

ARM_YAML = """\
urdf: arm.urdf
name_mot: [turn, slide, wrist]
base: {frame: ground}
targets:
  tip: {frame: tool, xyz: [10 mm, 20 mm, 30 mm]}
parametrisation:
  - {origin: all, components: [x, y, z], sigma: 2 mm}
  - {origin: all, components: [rx, ry, rz], sigma: 5 mrad}
"""

PARALLELOGRAM_URDF = """\
<robot name="parallelogram">
  <link name="ground"/> <link name="crank"/> <link name="coupler"/> <link name="rocker"/>
  <link name="coupler_end"/> <link name="rocker_end"/>
  <joint name="a" type="continuous"> <parent link="ground"/> <child link="crank"/> <axis xyz="0 0 1"/> </joint>
  <joint name="b" type="continuous">
    <parent link="crank"/> <child link="coupler"/> <origin xyz="0.5 0 0"/> <axis xyz="0 0 1"/>
  </joint>
  <joint name="c" type="continuous">
    <parent link="ground"/> <child link="rocker"/> <origin xyz="1 0 0"/> <axis xyz="0 0 1"/>
  </joint>
  <joint name="d" type="D_TYPE">
    <parent link="coupler"/> <child link="coupler_end"/> <origin xyz="1 0 0"/> <axis xyz="0 0 1"/>
  </joint>
  <joint name="e" type="fixed"> <parent link="rocker"/> <child link="rocker_end"/> <origin xyz="0.5 0 0"/> </joint>
</robot>
"""

PARALLELOGRAM_YAML = """\
urdf: parallelogram.urdf
name_mot: [a]
closed_loop: [[rocker_end, coupler_end]]
type: [3d]
closed_loop_axes: [[x, y]]
home: {a: 90 deg, b: -90 deg, c: 90 deg}
base: {frame: ground}
targets: {pin: {frame: coupler, xyz: [500 mm, 0, 0]}}
parametrisation: [{origin: all, components: [x, y], sigma: 1 mm}]
"""


def write_arm(folder: Path, yaml: str = ARM_YAML, urdf: str = ARM_URDF) -> Path:
    """Write the arm into a folder and return the path of its description.

    Its tip is at Rz(turn) (0.375 + slide + r, 0.02 cos 0.75 + 0.01 sin 0.75, .) for a wrist that lifts the tool by r.
    """
    (folder / "arm.urdf").write_text(urdf)
    (folder / "arm.yaml").write_text(yaml)
    return folder / "arm.yaml"


def write_parallelogram(folder: Path, yaml: str = PARALLELOGRAM_YAML, *, turning_end: bool = False) -> Path:
    """Write a parallelogram with sides of 1 m and 0.5 m: b = -a, c = a, its pin at (0.5 cos a + 0.5, 0.5 sin a).

    For a loop of whole frames, its joint d turns: d = a.
    """
    urdf = PARALLELOGRAM_URDF.replace("D_TYPE", "continuous" if turning_end else "fixed")
    (folder / "parallelogram.urdf").write_text(urdf)
    (folder / "parallelogram.yaml").write_text(yaml)
    return folder / "parallelogram.yaml"


def small_arm(folder: Path) -> calib.Robot:
    """The arm as a robot."""
    return calib.load(write_arm(folder))


def write_pose_loop(folder):
    """A five-bar as a 6d closure: the second tip has a joint of its own, so that three rows close three joints.

    Returns the robot description's path.
    """
    turned = '<origin xyz="{} 0 0" rpy="0.02 -0.01 0.03"/><axis xyz="0 0 1"/>'
    joints = (
        ("motor_left", "revolute", "ground", "left", -0.1),
        ("motor_right", "revolute", "ground", "right", 0.1),
        ("elbow_left", "revolute", "left", "left_end", 0.3),
        ("elbow_right", "revolute", "right", "right_end", 0.3),
        ("tip_left_origin", "fixed", "left_end", "tip_left", 0.4),
        ("tip_right_turn", "revolute", "right_end", "tip_right", 0.4),
    )
    (folder / "pose_loop.urdf").write_text(urdf_of(*((*names, turned.format(x)) for *names, x in joints)))
    # the assembled home from the planar geometry; the tilts of the origins open it by less than the 1 mm allowed
    angles = 2.0 + 0.03, 1.1 + 0.03
    left, right = ([x + 0.3 * np.cos(a), 0.3 * np.sin(a)] for x, a in zip((-0.1, 0.1), angles, strict=True))
    across = np.subtract(right, left)
    high = np.sqrt(0.16 - across @ across / 4) / np.linalg.norm(across)
    tip = np.add(left, right) / 2 + high * np.array([-across[1], across[0]])
    ends = [float(np.arctan2(*(tip - end)[::-1])) for end in (left, right)]
    elbows = [end - angle - 0.03 for end, angle in zip(ends, angles, strict=True)]
    (folder / "pose_loop.yaml").write_text(
        "urdf: pose_loop.urdf\nname_mot: [motor_left, motor_right]\nclosed_loop: [[tip_left, tip_right]]\ntype: [6d]\n"
        "closed_loop_axes: [[x, y, rz]]\nbase: {frame: ground}\n"
        "targets: {tip: {frame: tip_left, xyz: [0.05, 0.02, 0.1]}}\n"
        "parametrisation: [{origin: all, components: [x, y, z], sigma: 1 mm},"
        " {origin: all, components: [rx, ry, rz], sigma: 1 mrad}]\n"
        f"home: {{motor_left: 2.0, motor_right: 1.1, elbow_left: {elbows[0]!r}, elbow_right: {elbows[1]!r},"
        f" tip_right_turn: {ends[0] - ends[1]!r}}}\n"
    )
    return folder / "pose_loop.yaml"


def edited_five_bar(folder, *changes):
    """The five-bar of the documentation with some of its URDF replaced."""
    text = (EXAMPLES / "five_bar.urdf").read_text()
    for old, new in changes:
        text, count = re.subn(old, new, text)
        assert count, old
    (folder / "five_bar.urdf").write_text(text)
    (folder / "five_bar.yaml").write_text((EXAMPLES / "five_bar.yaml").read_text())
    return calib.load(folder / "five_bar.yaml")
