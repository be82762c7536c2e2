"""The Motoman again, seen by two cameras: fitted to pixels alone, and predicted where the tracker measured it."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from ..arms import Arm, Chain, moved, placed
from ..data_set import Rows, Split
from .serial_arms import MOTOMAN


@dataclass(frozen=True, kw_only=True)
class Watched(Arm):
    """An arm with markers on its last link, which cameras beside it see.

    What is read of rows to fit: number of the camera, place of the marker x y z [m], pixel u v [px].

    Attributes:
        T_link_markers: About where the markers are, (4, 4) [m].
        lenses: Reads those of the cameras, of the folder: fx fy cx cy [px], k1 k2 p1 p2 k3, OpenCV's model.
    """

    T_link_markers: np.ndarray
    lenses: Callable[[Path], list[np.ndarray]]

    def write(self, here: Path, split: Split, folder: Path) -> None:
        self.nominal(here / self.urdf).write(folder / "robot.urdf")
        poses = Chain(folder / "robot.urdf", self.base, self.link, list(self.joints)).poses(split.train.q)
        read, cameras = split.train.read, []
        for k, lens in enumerate(self.lenses(here)):
            own = read[:, 0] == k
            seen = np.einsum("nij,nj->ni", poses[own] @ self.T_link_markers, np.insert(read[own, 1:4], 3, 1, axis=1))
            start = _resection(seen[:, :3].copy(), read[own, 4:].copy(), lens)
            cameras.append({"lens": lens, "T_base_camera": start})
        self.write_problem(split, folder, cameras=cameras, T_link_markers=self.T_link_markers)

    def errors(self, unseen: Rows, predicted: np.ndarray) -> np.ndarray:
        """Distances [m] from the tracker's points; the point on the link, and the base, are laid through them."""
        poses = np.insert(predicted.reshape(-1, 3, 4), 3, [0, 0, 0, 1], axis=1)
        T, point = placed(poses, unseen.read, np.array(self.point), self.point_sigma)
        at = np.einsum("nij,j->ni", T @ poses, [*point, 1])
        return np.linalg.norm(at[:, :3] - unseen.read, axis=1)


def _resection(points: np.ndarray, pixels: np.ndarray, lens: np.ndarray) -> np.ndarray:
    """Where a camera is that sees points (n, 3) at pixels (n, 2), (4, 4); a start."""
    fx, fy, cx, cy, *bend = lens
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
    _, turn, shift = cv2.solvePnP(points, pixels, matrix, np.array(bend), flags=cv2.SOLVEPNP_SQPNP)
    return np.linalg.inv(moved(Rotation.from_rotvec(turn.ravel()).as_matrix(), shift.ravel()))


def _table(folder: Path, name: str) -> list[dict[str, str]]:
    return list(csv.DictReader((folder / "camera" / f"{name}.csv").read_text().splitlines()))


def _lenses(folder: Path) -> list[np.ndarray]:
    return [np.array(list(row.values())[1:], float) for row in _table(folder, "cameras")]


def _splits(folder: Path) -> Iterator[Split]:
    cameras = [row["camera"] for row in _table(folder, "cameras")]
    markers = {row["marker"]: [float(row[f"{axis} [m]"]) for axis in "xyz"] for row in _table(folder, "markers")}
    poses = {row["pose"]: row for row in _table(folder, "poses")}
    joints = {pose: [float(row[f"{joint} [rad]"]) for joint in MOTOMAN.joints] for pose, row in poses.items()}
    kept = [row for row in _table(folder, "pixels") if poses[row["pose"]]["use"] == "train"]
    q = np.array([joints[row["pose"]] for row in kept])
    what = np.array([[cameras.index(row["camera"]), *markers[row["marker"]]] for row in kept])
    u, v = (np.array([float(row[f"{name} [px]"]) for row in kept]) for name in "uv")
    tracked = [pose for pose, row in poses.items() if row["use"] == "test" and row["x [m]"]]
    places = np.array([[float(poses[pose][f"{axis} [m]"]) for axis in "xyz"] for pose in tracked])
    unseen = Rows(np.array([joints[pose] for pose in tracked]), places)
    yield Split("pixels as in the files", Rows(q, np.column_stack([what, u, v])), unseen)
    yield Split("pixels turned back by 90 degrees", Rows(q, np.column_stack([what, v, 5999 - u])), unseen)


DATA = Watched(
    name="Motoman, pixels",
    robot=MOTOMAN.robot,
    instrument="two cameras for the fitted rows; a laser tracker for the unseen rows, whose points also place base and"
    " reflector",
    origin="https://github.com/ctu-vras/multirobot-calibration (same poses as above)",
    licence=MOTOMAN.licence,
    columns="camera/poses.csv: pose, joints [rad], x y z [m] by the tracker, use; pixels.csv: pose, camera, marker, u v"
    " [px]; markers.csv: marker, x y z [m]; cameras.csv: camera, fx fy cx cy [px], k1 k2 p1 p2 k3",
    folder="motoman_right",
    files=("camera/cameras.csv", "camera/markers.csv", "camera/pixels.csv", "camera/poses.csv", "robot.urdf"),
    digest="fb5879d9967245bf6798a3bc7ece23f1e585451a74911f348d90f5e1395c9f5c",
    joints=MOTOMAN.joints,
    base="l0",
    link="flange",
    point=(0.045, 0.0, 0.245),
    point_sigma=0.01,
    T_link_markers=moved(np.diag([1.0, -1, -1]), np.array([0, 0, 0.36])),
    lenses=_lenses,
    splits=_splits,
    reasons={
        "pixels as in the files": (
            "the images were turned by 90 degrees against their lenses, which the verdict names: every fit is worse "
            "than the nominal robot. Both verdicts are FAIL, so no robot file is written"
        ),
    },
)
