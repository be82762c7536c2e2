"""Two arms with a ball on the flange in one of two sockets, no instrument at all."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from ..arms import Arm
from ..data_set import Rows, Split

RAW = "https://raw.githubusercontent.com/platonics-delft/kinematics_calibration/05a05ab"


def _splits(folder: Path, arm: str, places: tuple[str, ...]) -> Iterator[Split]:
    q, read = [], []
    for k, place in enumerate(places):
        for hole in (0, 1):
            q.append(np.loadtxt(folder / arm / place / f"hole_{hole}.csv", delimiter=","))
            read.append(np.tile([k, hole], (len(q[-1]), 1)))
    rows = Rows(np.vstack(q), np.vstack(read).astype(float))
    for k, place in enumerate(places):
        here = rows.read[:, 0] == k
        yield Split("places", f"place {place} unseen", rows[~here], rows[here])


def _arm(name, arm, robot, urdf, joint, base, link, places, files, owners="", reasons=None):
    addresses = {path: f"{RAW}/data/{path}" for path in files} | {f"urdf/{urdf}": f"{RAW}/assets/{urdf}"}
    return Arm(
        name=name,
        robot=robot,
        instrument="a ball in two sockets",
        origin="https://github.com/platonics-delft/kinematics_calibration (MUKCa)",
        licence="MIT",
        columns="files of seven joints [rad] without a header, one for each socket of each place",
        folder="mukca",
        files=files,
        addresses=addresses,
        urdf=f"urdf/{urdf}",
        joints=tuple(f"{joint}{k}" for k in range(1, 8)),
        base=base,
        link=link,
        point=(0.0, 0.0, 0.035),
        point_sigma=0.01,
        spacing=0.05,
        splits=partial(_splits, arm=arm, places=places),
        owners=owners,
        reasons=reasons or {},
    )


PANDA = _arm(
    "Panda in sockets", "panda_1", "Franka Panda", "panda.urdf", "panda_joint", "panda_link0", "panda_hand_tcp",
    ("front", "right", "back-high"),
    {
        "panda_1/front/hole_0.csv": "8150ed4a6d027fe245ae8f444cd01a6064626208d298380520f57a8fd3580d00",
        "panda_1/front/hole_1.csv": "4c268a8a54bbe2f62c08017b090ce84c5cb5c348700deb81b884d2911c56cb6e",
        "panda_1/right/hole_0.csv": "4b3920f88a1e759c3069015015f34d4ff9ae79213549998dce0a41d3b9271df3",
        "panda_1/right/hole_1.csv": "d59894defa190a02c757e89eee0f4aba3d56ce5918744d041e2545e101f69aa1",
        "panda_1/back-high/hole_0.csv": "fce2785bbb5c921285dae197a7348c9cb8cd2cbd2562cf192107958f6475eb25",
        "panda_1/back-high/hole_1.csv": "0167d20da3bdc10946991ce64caeaf223463e3adba03cf7ed81bc2b2c713c844",
        "urdf/panda.urdf": "6e30a37df12389628e68dfc18b98286284ca9e8f21eeff854965c75c1704d63f",
    },
    owners="the owners report a mean of 0.347 mm at unseen places, from each socket's own mean (a weaker measure)",
)  # fmt: skip
KUKA = _arm(
    "KUKA in sockets", "kuka_14", "KUKA LBR iiwa 14", "iiwa14.urdf", "joint_a", "base_link", "tool0",
    ("front", "left_back", "raised_left"),
    {
        "kuka_14/front/hole_0.csv": "6a23482ad523f21d63b692c411d17b046c86a184b453941eaaac49ccf638691f",
        "kuka_14/front/hole_1.csv": "6c223d26c61b79813465d9411f62442506c8bf51d49cefd3e27538c920ec9262",
        "kuka_14/left_back/hole_0.csv": "95aa5241598b6320a9afaf07a7798bf144f0f9725233104e4bdb30afde6549b3",
        "kuka_14/left_back/hole_1.csv": "2c7683a3c02b36307c9dbd4285fec4f7f023474fbdebde3028ac19405b25dd94",
        "kuka_14/raised_left/hole_0.csv": "f28eaae6e23dd036bdbbacc7890e9ff43d3bdfe42a10029f008394adb8de3c71",
        "kuka_14/raised_left/hole_1.csv": "271509707e1292ab672d35a9254f344e92a122a4dce294012bde219253dbd007",
        "urdf/iiwa14.urdf": "29e6e2e55bf676b4e901a4fd63a3b22373cc6f473aafdf09bf21ee922c64e141",
    },
)  # fmt: skip
