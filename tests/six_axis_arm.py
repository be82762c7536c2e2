"""A six-axis arm for tests of statistics, and measurements made for them."""

from pathlib import Path

import numpy as np

import calib
from calib.core.data.measurements import Measurements

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

HELD = ("j2.ry", "j4.y", "j1.rz", "j3.ry", "j3.y", "j6.y", "j5.rx", "j5.x", "j2.z", "j5.ry")
"""Ten components that depend on the other 26, for positions of one ball."""

HEAD = "urdf: arm.urdf\nname_mot: [j1, j2, j3, j4, j5, j6]\n"
YAML = f"""\
{HEAD}base: {{frame: l0}}
targets:
  ball: {{frame: l6, xyz: [50 mm, 20 mm, 100 mm]}}
parametrisation:
"""
NO_PRIORS = f"priors: false\nheld: [{', '.join(HELD)}]\n"


def free(*names: str) -> str:
    """Entries of a parametrisation with these components, lengths to 2 mm and angles to 5 mrad."""
    entry = "  - {{origin: {}, components: [{}], sigma: {}}}\n"
    return "".join(entry.format(*name.split("."), "5 mrad" if ".r" in name else "2 mm") for name in names)


def write_six_axis(folder: Path, yaml: str = NO_PRIORS + YAML + FREE) -> Path:
    (folder / "arm.urdf").write_text(URDF)
    (folder / "arm.yaml").write_text(yaml)
    return folder / "arm.yaml"


def six_axis_arm(folder: Path) -> calib.Robot:
    """The arm without priors; its 26 free parameters are all determined by positions."""
    return calib.load(write_six_axis(folder))


def joints(n: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1.5, 1.5, (n, 6))


def measurements(robot: calib.Robot, q: np.ndarray, positions: np.ndarray) -> Measurements:
    """Measurements from arrays; positions are (n, n_targets, 3)."""
    names = tuple(str(k) for k in range(len(q)))
    return calib.as_measurements(robot, calib.Poses(q, tuple(f"row {k}" for k in names), names, "test", ()), positions)


def noisy(robot: calib.Robot, q: np.ndarray, sigma: float, seed: int) -> Measurements:
    """What `robot` would measure, with normal noise."""
    positions = robot.positions(q)
    return measurements(robot, q, positions + sigma * np.random.default_rng(seed).standard_normal(positions.shape))
