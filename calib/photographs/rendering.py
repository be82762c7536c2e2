"""Simulated photographs of a printed board, for examples and tests without a camera.

Every pixel is a few rays (`calib.core.instruments.camera.rays`, lens distortion included), each intersected with the
plane of the board, whose colour is known exactly (`calib.photographs.printing.Paper`); a raster would shift every
corner. Then come blur, noise and rounding to grey values, as in a camera. The only light is a slope of brightness, and
nothing hides the board.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import InputError
from calib.core.base.units import in_unit, millimetres
from calib.core.base.words import json_file
from calib.core.data.measurements import Measurements
from calib.core.instruments.board import Board
from calib.core.instruments.camera import project, rays
from calib.core.instruments.kind import Readings, View
from calib.core.instruments.pixel import Pixel
from calib.core.robots.robot import Robot
from calib.core.rows.observed import views_of_instruments
from calib.photographs.opencv import GreyImage, encode
from calib.photographs.printing import Paper

_RAYS = 2  # per pixel, across and down
_MARGIN = 0.12  # white paper around the board, as part of its size
_NODES = 40  # across the image, for the interpolation of rays
_PAPER, _INK, _TABLE = 215.0, 35.0, 120.0


@dataclass(frozen=True, eq=False)
class Photographer:
    """A camera that takes simulated photographs of a board; intrinsics are (9,).

    Blur [px] and noise of grey values are standard deviations.
    """

    board: Board
    intrinsics: FloatArray
    size: tuple[int, int]
    blur: float = 0.7
    noise: float = 2.0

    @cached_property
    def _paper(self) -> Paper:
        return Paper(self.board)

    @cached_property
    def _rays(self) -> FloatArray:
        around = (np.arange(_RAYS) + 0.5) / _RAYS - 0.5
        u, v = ((np.arange(length)[:, None] + around).ravel() for length in self.size)
        return _smooth_rays(u, v, self.intrinsics)

    def photograph(self, T_camera_board: FloatArray, generator: np.random.Generator) -> GreyImage:
        """Return the photograph of the board at a pose in the camera, (4, 4) [m]."""
        board, margin = np.array(self.board.size), _MARGIN * max(self.board.size)
        width, height = self.size
        fine = np.full((_RAYS * height, _RAYS * width), _TABLE)
        part = self._visible_rays(T_camera_board, margin)
        pixel_rays = self._rays[part].reshape(-1, 2)
        directions = np.hstack([pixel_rays, np.ones((len(pixel_rays), 1))])
        normal, place = T_camera_board[:3, 2], T_camera_board[:3, 3]
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = (normal @ place) / (directions @ normal)
        at = (depth[:, None] * directions - place) @ T_camera_board[:3, :2]
        at = np.nan_to_num(at, nan=-1e9, posinf=1e9, neginf=-1e9)
        inside = np.all((at >= -margin) & (at <= board + margin), axis=1) & (depth > 0)
        grey = np.full(len(at), _TABLE)
        grey[inside] = np.where(self._paper.black(at[inside]), _INK, _PAPER)
        fine[part] = grey.reshape(fine[part].shape)
        image = fine.reshape(height, _RAYS, width, _RAYS).mean(axis=(1, 3)) * np.linspace(0.9, 1.05, width)
        image = scipy.ndimage.gaussian_filter(image, self.blur)
        image += self.noise * generator.standard_normal(image.shape)
        return np.clip(np.rint(image), 0, 255).astype(np.uint8)

    def _visible_rays(self, pose: FloatArray, margin: float) -> tuple[slice, slice]:
        """Rows and columns of rays that may meet the paper."""
        width, height = self.board.size
        corners = [(x, y, 0.0) for x in (-margin, width + margin) for y in (-margin, height + margin)]
        points = np.array(corners) @ pose[:3, :3].T + pose[:3, 3]
        if np.any(points[:, 2] <= 0):
            return slice(None), slice(None)
        pixels = project(points, self.intrinsics)[0]
        low = np.floor(pixels.min(axis=0) - 0.05 * max(self.size)).astype(int)
        high = np.ceil(pixels.max(axis=0) + 0.05 * max(self.size)).astype(int)
        columns, rows = (
            slice(_RAYS * int(np.clip(low[k], 0, self.size[k])), _RAYS * int(np.clip(high[k], 0, self.size[k])))
            for k in (0, 1)
        )
        return rows, columns


def _smooth_rays(u: FloatArray, v: FloatArray, intrinsics: FloatArray) -> FloatArray:
    """Rays of all pixels of a grid, (n_v, n_u, 2), interpolated by splines since a lens is smooth."""
    nodes = [np.linspace(ends[0], ends[-1], _NODES) for ends in (v, u)]
    grid = np.stack(np.meshgrid(nodes[1], nodes[0]), axis=-1).reshape(-1, 2)
    node_rays = rays(grid, intrinsics).reshape(_NODES, _NODES, 2)
    parts = [scipy.interpolate.RectBivariateSpline(*nodes, node_rays[:, :, k])(v, u) for k in (0, 1)]
    return np.stack(parts, axis=-1)


def example(board: Board, count: int, generator: np.random.Generator) -> dict[str, bytes]:
    """Return simulated photographs of a board by a camera on a robot's tool, with the poses, as files by name.

    The robot's poses have errors of 0.2 mm and 0.2 mrad per axis; `truth.json` has the true poses of camera and board.
    """
    size = (640, 480)
    intrinsics = np.array([610.0, 612.0, 323.0, 236.0, -0.12, 0.06, 0.0, 0.0, 0.0])
    photographer = Photographer(board, intrinsics, size)
    T_tool_camera = _pose((0.04, -0.06, 0.09), (2.0, -3.0, 91.0))
    T_base_board = _pose((0.55, -0.1, 0.02), (180.0, 2.0, 30.0))
    middle = np.array([*np.array(board.size) / 2, 0.0])
    away = 1.5 if board.dictionary else 2.3  # without markers, all of the board must be in the image
    distance = away * intrinsics[0] / size[1] * float(np.hypot(*board.size)) / np.sqrt(2)
    files: dict[str, bytes] = {}
    lines = ["image,x [mm],y [mm],z [mm],qx,qy,qz,qw"]
    for k in range(count):
        angle = 2 * np.pi * k / count
        tilt = (28.0 * np.cos(angle), 28.0 * np.sin(angle), float(generator.uniform(-50, 50)))
        T_camera_board = _pose((0.0, 0.0, 0.0), tilt)
        aside = distance * generator.uniform(-0.12, 0.12, 2)
        T_camera_board[:3, 3] = [*aside, distance * generator.uniform(0.85, 1.2)] - T_camera_board[:3, :3] @ middle
        files[f"shot_{k + 1:02d}.png"] = encode(photographer.photograph(T_camera_board, generator))
        tool = T_base_board @ np.linalg.inv(T_camera_board) @ np.linalg.inv(T_tool_camera)
        error = 2e-4 * generator.standard_normal(6)
        true_tool = tool @ _pose(tuple(error[:3]), tuple(in_unit(error[3:], "deg")))
        quaternion = scipy.spatial.transform.Rotation.from_matrix(true_tool[:3, :3]).as_quat(canonical=True)
        numbers = [
            *(f"{value:.4f}" for value in millimetres(true_tool[:3, 3])),
            *(f"{value:.7f}" for value in quaternion),
        ]
        lines.append(",".join([f"shot_{k + 1:02d}.png", *numbers]))
    files["poses.csv"] = ("# simulated: a camera on the tool\n" + "\n".join(lines) + "\n").encode()
    truth = {
        "simulated": True,
        "camera_in_tool": T_tool_camera.tolist(),
        "board_in_base": T_base_board.tolist(),
        "intrinsics": intrinsics.tolist(),
    }
    files["truth.json"] = json_file(truth)
    return files


def _pose(xyz: tuple[float, ...], degrees: tuple[float, ...]) -> FloatArray:
    result = np.eye(4)
    result[:3, :3] = scipy.spatial.transform.Rotation.from_euler("xyz", degrees, degrees=True).as_matrix()
    result[:3, 3] = xyz
    return result


def photographs(robot: Robot, camera: Pixel, data: Measurements, rng: np.random.Generator) -> dict[str, bytes]:
    """Return the simulated photographs of a robot's camera at each visit, by file name.

    Raises:
        InputError: Two visits have one name.
    """
    assert camera.board is not None
    assert camera.image is not None
    again = next((name for k, name in enumerate(data.names) if name in data.names[:k]), None)
    if again is not None:
        raise InputError(
            f"{data.path}: pose '{again}' appears twice; photographs are named after poses, so these need names of"
            " their own"
        )
    visits = np.arange(len(data))
    pairs, nothing = np.zeros(len(data), dtype=np.intp), np.zeros((len(data), 0))
    looks = Readings(visits, pairs, nothing, None, nothing)
    configurations = robot.assemble(data.joints, labels=data.labels, context=data.conditions)
    view = views_of_instruments(robot, configurations, {camera.name: looks})[camera.name]
    assert isinstance(view, View)
    intrinsics = camera.numbers(robot.values[robot.unknowns[camera.name]])
    photographer = Photographer(camera.board, intrinsics, (int(camera.image[0]), int(camera.image[1])))
    poses = np.tile(np.eye(4), (len(data), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = view.rotation, view.translation
    return {
        f"{name}.png": encode(photographer.photograph(pose, rng)) for name, pose in zip(data.names, poses, strict=True)
    }
