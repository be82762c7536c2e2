"""Franka arm, a point on its flange by a camera system."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ..arms import Arm
from ..data_set import Rows, Split, drawn


def _splits(folder: Path) -> Iterator[Split]:
    tables = [np.loadtxt(folder / name, delimiter=",", skiprows=1) for name in ("train.csv", "test.csv")]
    table = np.vstack(tables)
    rows = Rows(table[:, 1:8], table[:, 8:11])
    for seed in (0, 1):
        yield Split(f"80 at random, seed {seed}", *drawn(rows, seed, 80, 35))


DATA = Arm(
    name="Franka",
    robot="Franka Research 3, URDF of the Panda",
    instrument="camera on the flange",
    origin="https://github.com/PhilNad/robot-arm-kinematic-calibration (Examples/calib_data.pickle)",
    licence="MIT",
    columns="train.csv and test.csv: pose, seven joints [rad], x y z [m] and the rotation matrix of the camera's pose",
    folder="fr3_camera_poses",
    files=("train.csv", "test.csv", "robot.urdf"),
    digest="efe8b4655fe5b8aff518ce0d0cb42149b75335e9c06a3046877ad4259118dd88",
    joints=tuple(f"panda_joint{k}" for k in range(1, 8)),
    base="panda_link0",
    link="panda_link8",
    length_sigma=2e-3,
    angle_sigma=5e-3,
    splits=_splits,
)
