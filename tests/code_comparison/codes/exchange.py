"""What every code reads and answers: a folder with one problem, and one file. NumPy and SciPy alone.

robot.urdf, and robot_mdh.csv where the nominal arm has modified Denavit-Hartenberg parameters (of `calib export mdh`);
problem.json: joints, base and link (names of the URDF), point (nominal place of what is read on the link [m]),
point_sigma (how far it may be off [m], null: anywhere), length_sigma and angle_sigma (how far origins may be off
[m, rad]), spacing (of two sockets [m], null where positions were read), and a start: T_measured_base (4 x 4) and
p_link_point [m];
train.csv: the joints [rad], then x, y, z [m] as read, or the numbers of the place and of the socket;
unseen.csv: the joints of poses to predict, whose readings no code gets.
If cameras saw markers on the link, problem.json has cameras (a lens, OpenCV's fx fy cx cy k1 k2 p1 p2 k3, and a start
T_base_camera) and a start T_link_markers instead of the other two; train.csv has the joints, the number of the camera,
x, y, z of the marker [m] and its pixel. The answer is then the link's pose in its base, 12 numbers in rows.

Photographs have other files: problem.json with intrinsics fx fy cx cy as published, the size of images [px], and a
start: T_base_camera and T_tool_board (4 x 4) [m]; train_tool.csv, the tool in the base, 16 numbers for each image;
train.csv: image, x y z of a corner on the board [m], and its pixel; unseen_tool.csv and unseen.csv the same, without
pixels.
"""

import json
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np


@dataclass
class Answer:
    """What a code found.

    Attributes:
        points: Predicted points of the unseen poses, (n, 3) [m], in the frame of the readings, or the base (sockets);
            poses of the link in its base, (n, 12), of arms that cameras saw; or pixels of unseen corners, (n, 2).
        claimed_rms: The error that it states for the calibrated robot, root mean square [m, px].
        own_claim: Whether that is a claim about new poses; otherwise it is what its residuals are.
        verdict: Its judgement of the result, if it has one.
        package: Name and version of what was run.
    """

    points: np.ndarray
    claimed_rms: float | None = None
    own_claim: bool = False
    verdict: str | None = None
    package: str = ""


class Problem:
    """One problem, as a code reads it."""

    def __init__(self, folder: Path) -> None:
        told: dict[str, Any] = json.loads((folder / "problem.json").read_text())
        self.folder = folder
        self.joints: list[str] = told["joints"]
        self.base, self.link = told["base"], told["link"]
        self.point, self.point_sigma = np.array(told["point"]), told["point_sigma"]
        self.length_sigma, self.angle_sigma = told["length_sigma"], told["angle_sigma"]
        self.spacing, self.cameras = told["spacing"], told.get("cameras")
        self.reads = "sockets" if self.spacing else "pixels" if self.cameras else "points"
        self.T_measured_base, self.p_link_point, self.T_link_markers = (
            np.array(told.get(name)) for name in ("T_measured_base", "p_link_point", "T_link_markers")
        )
        train = np.loadtxt(folder / "train.csv", delimiter=",", skiprows=1, ndmin=2)
        self.q, self.read = train[:, : len(self.joints)], train[:, len(self.joints) :]
        self.unseen = np.loadtxt(folder / "unseen.csv", delimiter=",", skiprows=1, ndmin=2)


class Photographs:
    """One problem of photographs, as a code reads it."""

    def __init__(self, folder: Path) -> None:
        told: dict[str, Any] = json.loads((folder / "problem.json").read_text())
        self.intrinsics, self.size = np.array(told["intrinsics"]), tuple(told["size"])
        self.T_base_camera, self.T_tool_board = np.array(told["T_base_camera"]), np.array(told["T_tool_board"])
        parts = ("train", "unseen")
        tables = [np.loadtxt(folder / f"{name}.csv", delimiter=",", ndmin=2) for name in parts]
        (self.image, self.unseen_image), (self.corners, self.unseen_corners) = (
            [table[:, 0].astype(int) for table in tables],
            [table[:, 1:4] for table in tables],
        )
        self.pixels = tables[0][:, 4:]
        self.tool, self.unseen_tool = (
            np.loadtxt(folder / f"{name}_tool.csv", delimiter=",", ndmin=2).reshape(-1, 4, 4) for name in parts
        )

    def predicted(self, camera: np.ndarray, board: np.ndarray, lens: np.ndarray) -> np.ndarray:
        """Pixels of unseen corners, (n, 2); see `seen`."""
        return seen(self.unseen_tool[self.unseen_image], self.unseen_corners, camera, board, lens)


# -- what a user writes, if no package does
def seen(tool: np.ndarray, corners: np.ndarray, camera: np.ndarray, board: np.ndarray, lens: np.ndarray) -> np.ndarray:
    """Pixels (n, 2) of corners (n, 3) of a board on the tool (n, 4, 4); OpenCV's lens fx fy cx cy k1 k2 (p1 p2 k3)."""
    poses = np.linalg.inv(camera) @ tool @ board
    x, y, z = np.einsum("nij,nj->in", poses[:, :3, :3], corners) + poses[:, :3, 3].T
    x, y = x / z, y / z
    k1, k2, p1, p2, k3 = [*lens[4:], 0, 0, 0][:5]
    r2 = x**2 + y**2
    bend = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    u = x * bend + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    v = y * bend + 2 * p2 * x * y + p1 * (r2 + 2 * y**2)
    return np.column_stack([lens[0] * u + lens[2], lens[1] * v + lens[3]])


# -- end
_seconds = 0.0


@contextmanager
def fit_time() -> Iterator[None]:
    """What runs inside is the fit; its processor time is added up."""
    global _seconds
    started = time.process_time()
    yield
    _seconds += time.process_time() - started


def main(solve: Any, reader: Any = Problem) -> None:
    """Read the folder that the command line names, solve it, write the answer where it says."""
    folder, path, *options = sys.argv[1:]
    answer: Answer = solve(reader(Path(folder)), *options)
    told = vars(answer) | {"points": np.asarray(answer.points).tolist(), "fit_seconds": _seconds}
    Path(path).write_text(json.dumps(told))


def moved(turn: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """Return poses (..., 4, 4) of rotation matrices (..., 3, 3) and shifts (..., 3)."""
    result = np.zeros((*turn.shape[:-2], 4, 4))
    result[..., :3, :3], result[..., :3, 3], result[..., 3, 3] = turn, shift, 1.0
    return result
