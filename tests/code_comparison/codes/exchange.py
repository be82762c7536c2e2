"""What every code reads and answers: a folder with one problem, and one file. NumPy alone.

An arm: robot.urdf; robot_mdh.csv where the nominal arm has modified Denavit-Hartenberg parameters (of `calib export
mdh`); and problem.json with

    joints, base, link          names of the URDF
    point, point_sigma          nominal place of what is read on the link, how far it may be off (null: anywhere) [m]
    length_sigma, angle_sigma   how far origins may be off [m, rad]
    spacing                     of two sockets [m]; null where positions were read
    q, read                     of rows to fit: joints [rad]; and x, y, z [m], or the numbers of place and socket
    unseen                      joints of poses to predict, whose readings no code gets
    T_measured_base (4, 4), p_link_point [m]    a start

If cameras saw markers on the link, there are cameras (a lens, OpenCV's fx fy cx cy k1 k2 p1 p2 k3, and a start
T_base_camera) and a start T_link_markers instead of the other two, and `read` has the number of the camera, x, y, z of
the marker [m] and its pixel. The answer is then the link's pose in its base, 12 numbers in rows.

Photographs: problem.json with intrinsics fx fy cx cy as published, the size of images [px], the start T_base_camera and
T_tool_board (4, 4) [m]; tool, the tool in the base at each image (n, 4, 4); image, corners and pixels, one for each
point; and unseen_tool, unseen_image and unseen_corners, of which pixels are to be predicted.
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
    """One problem, as a code reads it: what problem.json has, numbers as arrays."""

    cameras = None

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        for name, value in json.loads((folder / "problem.json").read_text()).items():
            numbers = isinstance(value, list) and not isinstance(value[0], (str, dict))
            setattr(self, name, np.array(value) if numbers else value)

    @property
    def reads(self) -> str:
        """What was read of an arm."""
        return "sockets" if self.spacing else "pixels" if self.cameras else "points"


class Photographs(Problem):
    """One problem of photographs."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.size = tuple(self.size.tolist())

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
