"""UR10, a point on the tool of an undocumented sensor that saw a chessboard."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ..arms import Arm
from ..data_set import Rows, Split

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")


def _splits(folder: Path) -> Iterator[Split]:
    table = np.loadtxt(folder / "calibration.csv", delimiter=",", skiprows=1)
    rows, at = Rows(table[:, 6:12], table[:, :3]), np.arange(len(table)) % 4
    for k, words in ((0, "first"), (2, "third")):
        yield Split(f"the {words} of every four unseen", rows[at != k], rows[at == k])


DATA = Arm(
    name="UR10, chessboard",
    robot="Universal Robots UR10",
    instrument="a chessboard's position; sensor and frame undocumented",
    origin="https://github.com/thanhndv212/figaroh-examples (examples/ur10)",
    licence="Apache-2.0",
    columns="calibration.csv: x1 y1 z1 [m], phix1 phiy1 phiz1 [rad], the six joints [rad]; and their robot.urdf",
    folder="ur10",
    files=("calibration.csv", "robot.urdf"),
    digest="3d125e0267ebe29700074ac05c5d0cdbcf3ecac1900852287087233053cf2fff",
    joints=tuple(f"{joint}_joint" for joint in JOINTS),
    base="base_link",
    link="wrist_3_link",
    length_sigma=2e-3,
    angle_sigma=5e-3,
    splits=_splits,
    reasons={
        "the first of every four unseen": "6 unseen rows of a sensor that scatters by some 3 mm: a tie; the other split"
        " has the opposite order"
    },
    owners="their program, FIGAROH, leaves 2.95 mm in all 23 poses fitted",
)
