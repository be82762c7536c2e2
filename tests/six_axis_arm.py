"""A six-axis arm for tests of statistics: every listed parameter is determined by positions alone."""

from pathlib import Path

import numpy as np

import calib
from calib.measurements import Measurements

_JOINTS = (
    ("j1", "0 0 1", "0 0 0.4"),
    ("j2", "0 1 0", "0.05 0 0.1"),
    ("j3", "0 1 0", "0 0 0.6"),
    ("j4", "1 0 0", "0.2 0 0.05"),
    ("j5", "0 1 0", "0.4 0 0"),
    ("j6", "1 0 0", "0.1 0 0"),
)

URDF = (
    '<robot name="six axes">\n<link name="l0"/>\n'
    + "".join(
        f'<link name="l{k + 1}"/>\n<joint name="{name}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/>'
        f'<origin xyz="{xyz}"/><axis xyz="{axis}"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>\n'
        for k, (name, axis, xyz) in enumerate(_JOINTS)
    )
    + "</robot>\n"
)

FREE = """\
  - {origin: all, components: [x, y, z], sigma: 2 mm}
  - {origin: all, components: [rx, ry, rz], sigma: 5 mrad}
"""

YAML = """\
urdf: arm.urdf
name_mot: [j1, j2, j3, j4, j5, j6]
base: {frame: l0}
targets:
  ball: {frame: l6, xyz: [50 mm, 20 mm, 100 mm]}
priors: false
parametrisation:
"""


def write_six_axis(folder: Path, yaml: str = YAML + FREE) -> Path:
    (folder / "arm.urdf").write_text(URDF)
    (folder / "arm.yaml").write_text(yaml)
    return folder / "arm.yaml"
