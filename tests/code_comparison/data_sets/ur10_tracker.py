"""UR10, a laser tracker's sensor on the flange, one evening."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ..arms import Arm
from ..data_set import Rows, Split, drawn, some

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")


def _splits(folder: Path) -> Iterator[Split]:
    table = np.genfromtxt(folder / "grid.csv", delimiter=",", skip_header=1, dtype=str)
    rows = Rows(table[:, 1:7].astype(float), table[:, 7:10].astype(float) / 1e3)
    yield Split("200 at random", *drawn(rows, 0, 200, 600))
    stretch = np.arange(len(rows)) * 40 // len(rows) % 4
    train, unseen = some(rows[stretch != 0], 0, 200), some(rows[stretch == 0], 0, 600)
    yield Split("every fourth of 40 stretches unseen", train, unseen)
    low = rows.q[:, 1] < np.median(rows.q[:, 1])
    yield Split("low half of the shoulder's lift fitted", some(rows[low], 0, 200), some(rows[~low], 0, 600))


DATA = Arm(
    name="UR10",
    robot="Universal Robots UR10 (CB3)",
    instrument="laser tracker",
    origin="https://github.com/christianlandgraf/ipa-robot-accuracy (Series A; Landgraf et al., CASE 2021)",
    licence="MIT",
    columns="grid.csv: time [s], the six joints [rad], x y z [mm], rx ry rz [deg], temperature [degC], use; and the"
    " maker's lengths as robot.urdf",
    folder="ur10_tracker",
    files=("grid.csv", "robot.urdf"),
    digest="4f3600eb96bf6e245bc26e63f1e04d77805ef5330fd475f7d047e4003c4bde72",
    joints=tuple(f"{joint}_joint" for joint in JOINTS),
    base="base_link",
    link="flange",
    splits=_splits,
)
