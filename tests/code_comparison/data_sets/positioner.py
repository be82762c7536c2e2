"""Positioner of two axes, its table by a camera system."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ..arms import Arm
from ..data_set import Rows, Split, drawn


def _splits(folder: Path) -> Iterator[Split]:
    table = np.loadtxt(folder / "positions.csv", delimiter=",", skiprows=1)
    rows, half = Rows(table[:, 1:3], table[:, 3:6]), len(table) // 2
    yield Split("half at random", *drawn(rows, 0, 100, 105))
    first, second = rows[np.arange(half)], rows[np.arange(half, len(table))]
    yield Split("second half unseen", first, second)
    yield Split("first half unseen", second, first)


DATA = Arm(
    name="Positioner",
    robot="positioner of two axes",
    instrument="camera system",
    origin="https://github.com/ros-industrial/industrial_calibration (examples/data/kinematic_calibration)",
    licence="Apache-2.0",
    columns="positions.csv: pose, two joints [rad], x y z [m] of the table; the geometry of the example as robot.urdf",
    folder="positioner",
    files=("positions.csv", "robot.urdf"),
    digest="84a930d3c21ba67ff6e25ddcbfde5a7823fa77710c26e99bc86f315f74a6950f",
    joints=("j1", "j2"),
    base="world",
    link="table",
    length_sigma=2e-3,
    angle_sigma=5e-3,
    splits=_splits,
)
