"""Photographs of a board, with the pose of the robot's tool at each: data, unknowns and predicted pixels.

The camera is fixed to one end of the robot by C, and the board to the other end by M. A point of the board is seen at

    p = C^-1 A_i M X        A_i = L_i for a camera that stands beside the robot (board on the tool)
                            A_i = L_i^-1 for a camera on the tool (board beside the robot)

with L_i the tool in the robot's base at image i, X a point in the frame of the board, and p the point in the frame of
the camera. Pixels follow by `calib.core.instruments.camera`. Unknown are C, M and the intrinsics. Steps move a pose in
its own axes, C exp(xi), and so does an error e_i of the robot at an image, L_i exp(e_i): e_i = [d; w] moves the tool by
d and turns it by w.

Parameters here: `placed` or `start`, poses of camera and board with the intrinsics; `unknowns`, what is fitted
besides these poses; `noise`, sizes of errors; `intrinsics`, (9,); `mounts`, possible mounts of the camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
import pinocchio as pin

from calib.core.base.arrays import BoolArray, FloatArray, IntArray, ReadOnlyArrays
from calib.core.instruments.board import Board
from calib.core.instruments.camera import project, rays
from calib.core.numerics.prior import Prior
from calib.core.numerics.rigid import cross_matrices
from calib.photographs.detection import DetectedImage

Mount = Literal["tool", "base"]
SIDES: dict[Mount, str] = {"tool": "on the tool", "base": "beside the robot"}
OTHER: dict[Mount, Mount] = {"tool": "base", "base": "tool"}
LITTLE_COVERAGE = 0.4
"""Part of the image that points must cover; with less, the lens is extrapolated."""
_CHANGE = 0.01  # reasonable change of a pose [m, rad], and of the size of the board
_CELLS = 8  # fields of an image, across and down; the board should be seen in each


@dataclass(frozen=True, eq=False)
class BoardScene(ReadOnlyArrays):
    """Images of a board.

    Attributes:
        names: Names of the images.
        tool: L_i, tool in base at each image, (n, 4, 4) [m].
        image: Image of each point, ascending, (m,).
        body: Points in the board's frame, (m, 3) [m].
        pixels: Detected pixels of the points, (m, 2).
        mount: Place of the camera: on the tool or beside the robot.
        size: Width and height of the images [px].
    """

    names: tuple[str, ...]
    tool: FloatArray
    image: IntArray
    body: FloatArray
    pixels: FloatArray
    mount: Mount
    size: tuple[int, int]

    def __len__(self) -> int:
        return len(self.names)

    @property
    def links(self) -> FloatArray:
        """A_i, (n, 4, 4) [m]."""
        return self.tool if self.mount == "base" else np.linalg.inv(self.tool)

    def select_images(self, chosen: BoolArray) -> BoardScene:
        """Return the scene with the chosen images, (n,), and their points."""
        names = tuple(name for name, keep in zip(self.names, chosen, strict=True) if keep)
        kept = self.with_points(chosen[self.image])
        return replace(kept, names=names, tool=self.tool[chosen], image=(np.cumsum(chosen) - 1)[kept.image])

    def with_points(self, chosen: BoolArray) -> BoardScene:
        """Return the scene with the chosen points, (m,), and all images."""
        return replace(self, image=self.image[chosen], body=self.body[chosen], pixels=self.pixels[chosen])

    @property
    def counts(self) -> IntArray:
        """Points in each image, (n,)."""
        return np.bincount(self.image, minlength=len(self))

    @property
    def coverage(self) -> float:
        """Covered part of the image: fields of 8 x 8 with points, or between such fields along a row or a column."""
        x, y = np.clip((self.pixels / self.size * _CELLS).astype(int), 0, _CELLS - 1).T
        seen = np.zeros((_CELLS, _CELLS), dtype=bool)
        seen[y, x] = True

        def between_true(rows: BoolArray) -> BoolArray:
            before = np.maximum.accumulate(rows, axis=1)
            after = np.maximum.accumulate(rows[:, ::-1], axis=1)[:, ::-1]
            return before & after

        return float(np.mean(seen | (between_true(seen) & between_true(seen.T).T)))

    def rms_by_image(self, errors: FloatArray) -> FloatArray:
        """Return the root mean square length of errors (m, 2) in each image, (n,)."""
        squares = np.bincount(self.image, np.sum(errors**2, axis=1), len(self))
        return np.sqrt(squares / np.maximum(self.counts, 1))


def scene_of(detected_images: Sequence[DetectedImage], board: Board, tool: FloatArray) -> BoardScene:
    """Return the scene of images of a board, with the pose of the tool at each image, (n, 4, 4) [m]."""
    points = board.points()
    counts = [len(image.points) for image in detected_images]
    return BoardScene(
        tuple(image.name for image in detected_images),
        tool,
        np.repeat(np.arange(len(detected_images)), counts),
        np.array([points[name] for image in detected_images for name in image.points]),
        np.concatenate([image.pixels for image in detected_images]),
        "tool",
        detected_images[0].size,
    )


@dataclass(frozen=True, eq=False)
class HandEyePlacement(ReadOnlyArrays):
    """Poses of camera and board, and the intrinsics.

    Attributes:
        camera: C, camera in its parent frame, (4, 4) [m].
        board: M, board in its parent frame, (4, 4) [m].
        intrinsics: fx fy cx cy k1 k2 p1 p2 k3, (9,).
        scale: Size of the board over its described size.
    """

    camera: FloatArray
    board: FloatArray
    intrinsics: FloatArray
    scale: float = 1.0

    def step(self, step: FloatArray, unknowns: HandEyeUnknowns) -> HandEyePlacement:
        """Return the placement after a step [camera 6, board 6, intrinsics, scale], (k,)."""
        intrinsics, scale = self.intrinsics.copy(), self.scale
        intrinsics[list(unknowns.free)] += step[unknowns.lens]
        if unknowns.scaled:
            scale += float(step[unknowns.lens.stop])
        return HandEyePlacement(
            _step_pose(self.camera, step[:6]), _step_pose(self.board, step[6:12]), intrinsics, scale
        )


def _step_pose(pose: FloatArray, step: FloatArray) -> FloatArray:
    return pose @ np.asarray(pin.exp6(pin.Motion(step)).homogeneous)


@dataclass(frozen=True, eq=False)
class HandEyeUnknowns(ReadOnlyArrays):
    """Unknowns of a fit besides the poses of camera and board.

    Attributes:
        free: Indices of the fitted intrinsics.
        expected, sigma: Their expected values and sigmas, (f,) each.
        scaled: Whether the size of the board is fitted.
    """

    free: tuple[int, ...] = ()
    expected: FloatArray = field(default_factory=lambda: np.zeros(0))
    sigma: FloatArray = field(default_factory=lambda: np.zeros(0))
    scaled: bool = False

    @property
    def lens(self) -> slice:
        """Columns of the intrinsics."""
        return slice(12, 12 + len(self.free))

    @property
    def scales(self) -> FloatArray:
        """Reasonable changes of all unknowns, the sigmas of the intrinsics, (k,) [m, rad, px, 1]."""
        return np.concatenate([np.full(12, _CHANGE), self.sigma, np.full(int(self.scaled), _CHANGE)])

    @property
    def prior(self) -> Prior:
        """Prior of the unknowns, divided by `scales`."""
        return Prior(np.isin(np.arange(len(self.scales)), np.arange(12, 12 + len(self.free))))


POSES = HandEyeUnknowns()
"""Only the poses of camera and board are fitted."""


def points_in_camera(scene: BoardScene, placed: HandEyePlacement) -> tuple[FloatArray, FloatArray]:
    """Return the points in the camera, (m, 3) [m], and the board in the camera at each image, (n, 4, 4)."""
    poses = np.linalg.inv(placed.camera) @ scene.links @ placed.board
    at = poses[scene.image]
    return np.einsum("kab,kb->ka", at[:, :3, :3], placed.scale * scene.body) + at[:, :3, 3], poses


def residuals(scene: BoardScene, placed: HandEyePlacement) -> FloatArray:
    """Return predicted minus detected pixels, (m, 2) [px]."""
    return project(points_in_camera(scene, placed)[0], placed.intrinsics)[0] - scene.pixels


def rows(
    scene: BoardScene, placed: HandEyePlacement, unknowns: HandEyeUnknowns = POSES
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return residuals (m, 2) [px], J (m, 2, k) and G (m, 2, 6)."""
    points, poses = points_in_camera(scene, placed)
    pixels, by_point, by_number = project(points, placed.intrinsics)
    body = placed.scale * scene.body
    turned = poses[scene.image, :3, :3]
    by_camera = np.concatenate([-np.tile(np.eye(3), (len(points), 1, 1)), cross_matrices(points)], axis=2)
    by_board = np.concatenate([turned, -turned @ cross_matrices(body)], axis=2)
    columns = [by_point @ by_camera, by_point @ by_board, by_number[:, :, list(unknowns.free)]]
    if unknowns.scaled:
        columns.append(by_point @ np.einsum("kab,kb->ka", turned, scene.body)[:, :, None])
    on_tool, by_pose = (placed.camera, columns[0]) if scene.mount == "tool" else (placed.board, columns[1])
    # exp(e) T = T exp(Ad(T^-1) e): an error of the tool moves what is on it, by a pose T
    return pixels - scene.pixels, np.concatenate(columns, axis=2), by_pose @ pin.SE3(on_tool).actionInverse


def plane_errors_on_board(scene: BoardScene, placed: HandEyePlacement) -> FloatArray:
    """Return the intersections of the pixels' rays with the board's plane, minus the board's points, (m, 2) [m].

    A ray that does not meet the plane in front of the camera gives infinity.
    """
    poses = points_in_camera(scene, placed)[1][scene.image]
    seen = rays(scene.pixels, placed.intrinsics)
    directions = np.hstack([seen, np.ones((len(seen), 1))])
    normal, place = poses[:, :3, 2], poses[:, :3, 3]
    along = np.einsum("ka,ka->k", normal, directions)
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.einsum("ka,ka->k", normal, place) / along
    depth = np.where((np.abs(along) > 1e-6) & (depth > 0), depth, np.inf)
    with np.errstate(invalid="ignore"):
        away = np.einsum("kba,kb->ka", poses[:, :3, :3], depth[:, None] * directions - place)[:, :2]
        return np.where(np.isfinite(depth)[:, None], away / placed.scale - scene.body[:, :2], np.inf)
