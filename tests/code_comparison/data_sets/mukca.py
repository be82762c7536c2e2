"""Two arms with a ball on the flange in one of two sockets, no instrument at all."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from ..arms import Arm
from ..data_set import Rows, Split


def _splits(folder: Path, arm: str, places: tuple[str, ...]) -> Iterator[Split]:
    q, read = [], []
    for k, place in enumerate(places):
        for hole in (0, 1):
            q.append(np.loadtxt(folder / arm / place / f"hole_{hole}.csv", delimiter=","))
            read.append(np.tile([k, hole], (len(q[-1]), 1)))
    rows = Rows(np.vstack(q), np.vstack(read).astype(float))
    for k, place in enumerate(places):
        here = rows.read[:, 0] == k
        yield Split(f"place {place} unseen", rows[~here], rows[here])


def _arm(name, arm, robot, urdf, joint, base, link, places, digest, owners=""):
    return Arm(
        name=name,
        robot=robot,
        instrument="a ball in two sockets",
        origin="https://github.com/platonics-delft/kinematics_calibration (MUKCa)",
        licence="MIT",
        columns="files of seven joints [rad] without a header, one for each socket of each place",
        folder="mukca",
        files=(*(f"{arm}/{place}/hole_{hole}.csv" for place in places for hole in (0, 1)), f"urdf/{urdf}"),
        digest=digest,
        urdf=f"urdf/{urdf}",
        joints=tuple(f"{joint}{k}" for k in range(1, 8)),
        base=base,
        link=link,
        point=(0.0, 0.0, 0.035),
        point_sigma=0.01,
        spacing=0.05,
        splits=partial(_splits, arm=arm, places=places),
        owners=owners,
    )


PANDA = _arm(
    "Panda in sockets", "panda_1", "Franka Panda", "panda.urdf", "panda_joint", "panda_link0", "panda_hand_tcp",
    ("front", "right", "back-high"),
    "6863b22932cf51a1feabed82af0368ad92dd20d08123b19231481baeefdc6ea8",
    owners="the owners report a mean of 0.347 mm at unseen places, from each socket's own mean (a weaker measure)",
)  # fmt: skip
KUKA = _arm(
    "KUKA in sockets", "kuka_14", "KUKA LBR iiwa 14", "iiwa14.urdf", "joint_a", "base_link", "tool0",
    ("front", "left_back", "raised_left"),
    "c2bcb06d030c8b0436c2bac829cf709012b6ed7b05a6230238745947efd17408",
)  # fmt: skip
