"""Serial arms and a positioner: where their owners read a point of the tool."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ..arms import Arm
from ..data_set import Rows, Split, drawn

UR_JOINTS = tuple(
    f"{joint}_joint" for joint in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
)


def _ur10(folder: Path) -> Iterator[Split]:
    table = np.genfromtxt(folder / "grid.csv", delimiter=",", skip_header=1, dtype=str)
    rows = Rows(table[:, 1:7].astype(float), table[:, 7:10].astype(float) / 1e3)
    yield Split("200 at random", *drawn(rows, 0, 200, 600))
    stretch = np.arange(len(rows)) * 40 // len(rows) % 4
    train, unseen = drawn(rows[stretch != 0], 0, 200)[0], drawn(rows[stretch == 0], 0, 600)[0]
    yield Split("every fourth of 40 stretches unseen", train, unseen)
    low = rows.q[:, 1] < np.median(rows.q[:, 1])
    yield Split("low half of the shoulder's lift fitted", drawn(rows[low], 0, 200)[0], drawn(rows[~low], 0, 600)[0])


UR10 = Arm(
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
    joints=UR_JOINTS,
    base="base_link",
    link="flange",
    splits=_ur10,
)


def _motoman(folder: Path) -> Iterator[Split]:
    tables = [np.loadtxt(folder / name, delimiter=",", skiprows=1) for name in ("train.csv", "test.csv")]
    train, test = (Rows(table[:, 3:], table[:, :3]) for table in tables)
    yield Split("the owners' file for testing unseen", train, test)
    rows = Rows(np.vstack([train.q, test.q]), np.vstack([train.read, test.read]))
    yield Split("half at random", *drawn(rows, 0, 106, 106))
    half = len(train) // 2
    yield Split("second half of a file unseen", train[np.arange(half)], train[np.arange(half, len(train))])
    low = rows.q[:, 3] < np.median(rows.q[:, 3])
    yield Split("low half of joint U fitted", rows[low], rows[~low])


MOTOMAN = Arm(
    name="Motoman",
    robot="right arm of a dual-arm Motoman",
    instrument="laser tracker",
    origin="https://github.com/ctu-vras/multirobot-calibration (leica_dataset; Stepanova et al., RCIM 73:102250, 2022)",
    licence="public, as the paper says; no licence file",
    columns="train.csv and test.csv: x1 y1 z1 [m], joints E S L U R B T [rad]; the owners' Denavit-Hartenberg table as"
    " robot.urdf",
    folder="motoman_right",
    files=("train.csv", "test.csv", "robot.urdf"),
    digest="fe91ad47a7c6193d73da5f9f6581314910253e330ba9e14f2d92e72e55fc3ae4",
    joints=tuple("ESLURBT"),
    base="l0",
    link="flange",
    point=(0.045, 0.0, 0.245),
    point_sigma=0.01,
    splits=_motoman,
    reasons={
        "low half of joint U fitted": (
            "a coupling of joints does not hold at values of joint U that were not fitted, and the fitted rows do not "
            "show it; without joint terms this project leaves 0.106 mm"
        ),
        "second half of a file unseen": (
            "79 rows of one region do not show what another region is like. Priors from a third to ten times as wide "
            "leave 0.12 to 0.14 mm in the others; the fitted rows do not show which are better"
        ),
    },
)


def _franka(folder: Path) -> Iterator[Split]:
    tables = [np.loadtxt(folder / name, delimiter=",", skiprows=1) for name in ("train.csv", "test.csv")]
    table = np.vstack(tables)
    rows = Rows(table[:, 1:8], table[:, 8:11])
    for seed in (0, 1):
        yield Split(f"80 at random, seed {seed}", *drawn(rows, seed, 80, 35))


FRANKA = Arm(
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
    splits=_franka,
)


def _positioner(folder: Path) -> Iterator[Split]:
    table = np.loadtxt(folder / "positions.csv", delimiter=",", skiprows=1)
    rows, half = Rows(table[:, 1:3], table[:, 3:6]), len(table) // 2
    yield Split("half at random", *drawn(rows, 0, 100, 105))
    first, second = rows[np.arange(half)], rows[np.arange(half, len(table))]
    yield Split("second half unseen", first, second)
    yield Split("first half unseen", second, first)


POSITIONER = Arm(
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
    splits=_positioner,
)


def _chessboard(folder: Path) -> Iterator[Split]:
    table = np.loadtxt(folder / "calibration.csv", delimiter=",", skiprows=1)
    rows, at = Rows(table[:, 6:12], table[:, :3]), np.arange(len(table)) % 4
    for k, words in ((0, "first"), (2, "third")):
        yield Split(f"the {words} of every four unseen", rows[at != k], rows[at == k])


CHESSBOARD = Arm(
    name="UR10, chessboard",
    robot="Universal Robots UR10",
    instrument="a chessboard's position; sensor and frame undocumented",
    origin="https://github.com/thanhndv212/figaroh-examples (examples/ur10)",
    licence="Apache-2.0",
    columns="calibration.csv: x1 y1 z1 [m], phix1 phiy1 phiz1 [rad], the six joints [rad]; and their robot.urdf",
    folder="ur10",
    files=("calibration.csv", "robot.urdf"),
    digest="3d125e0267ebe29700074ac05c5d0cdbcf3ecac1900852287087233053cf2fff",
    joints=UR_JOINTS,
    base="base_link",
    link="wrist_3_link",
    length_sigma=2e-3,
    angle_sigma=5e-3,
    splits=_chessboard,
    reasons={
        "the first of every four unseen": "6 unseen rows of a sensor that scatters by some 3 mm: a tie; the other split"
        " has the opposite order"
    },
    owners="their program, FIGAROH, leaves 2.95 mm in all 23 poses fitted",
)
