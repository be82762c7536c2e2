"""Photographs of a board, with the pose of the robot's tool at each: data, unknowns and predicted pixels.

The camera is fixed to one end of the robot by C, and the board to the other end by M. A point of the board is seen at

    p = C^-1 A_i M X        A_i = L_i for a camera that stands beside the robot (board on the tool)
                            A_i = L_i^-1 for a camera on the tool (board beside the robot)

with L_i the tool in the robot's base at image i, X a point in the frame of the board, and p the point in the frame of
the camera. Pixels follow by `calib.core.instruments.camera`. Unknown are C, M and the intrinsics. Steps move a pose in
its own axes, C exp(xi), and so does an error e_i of the robot at an image, L_i exp(e_i): e_i = [d; w] moves the tool by
d and turns it by w.

The solver needs only sums over the points of each image: J^T J, J^T G, G^T G, J^T r, G^T r and r^T r. Here r are the
residuals, J is their derivative by the unknowns, and G their derivative by e_i. Weights for errors that the points of
an image share are then algebra with 6 x 6 matrices (`calib.photographs.shared_errors`).

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
from calib.core.numerics.rigid import cross_matrices
from calib.photographs.detection import DetectedImage

Mount = Literal["tool", "base"]
SIDES: dict[Mount, str] = {"tool": "on the tool", "base": "beside the robot"}
OTHER: dict[Mount, Mount] = {"tool": "base", "base": "tool"}


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

    def image_alone(self, i: int) -> BoardScene:
        """Return the scene with one image."""
        return self.select_images(np.arange(len(self)) == i)

    def with_points(self, chosen: BoolArray) -> BoardScene:
        """Return the scene with the chosen points, (m,), and all images."""
        return replace(self, image=self.image[chosen], body=self.body[chosen], pixels=self.pixels[chosen])

    def sums(self, values: FloatArray) -> FloatArray:
        """Return the sums, (n, ...), of values (m, ...) over the points of each image."""
        result = np.zeros((len(self), *values.shape[1:]))
        np.add.at(result, self.image, values)
        return result

    @property
    def counts(self) -> IntArray:
        """Points in each image, (n,)."""
        return np.bincount(self.image, minlength=len(self))

    def rms_by_image(self, errors: FloatArray) -> FloatArray:
        """Return the root mean square length of errors (m, 2) in each image, (n,)."""
        return np.sqrt(self.sums(np.sum(errors**2, axis=1)) / np.maximum(self.counts, 1))


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
        """Return the placement after a step [camera 6, board 6, intrinsics, scale], (k,), as columns of `ImageSums`."""
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


POSES = HandEyeUnknowns()
"""Only the poses of camera and board are fitted."""


@dataclass(frozen=True, eq=False)
class ImageSums(ReadOnlyArrays):
    """Residuals and derivatives, summed over the points of each image; see the module docstring.

    Attributes:
        jj, jg, gg: J^T J, J^T G, G^T G, (n, k, k), (n, k, 6), (n, 6, 6).
        jr, gr, rr: J^T r, G^T r, r^T r, (n, k), (n, 6), (n,).
        n_rows: Rows of each image, (n,).
        weight, off: Prior of the unknowns: 1 / sigma^2 (0: none), and present minus expected values, (k,) each.
        n_arm: Number of columns, the last ones, for errors of the arm (`calib.photographs.intervals`).
    """

    jj: FloatArray
    jg: FloatArray
    gg: FloatArray
    jr: FloatArray
    gr: FloatArray
    rr: FloatArray
    n_rows: IntArray
    weight: FloatArray
    off: FloatArray
    n_arm: int = 0

    def with_columns(self, by_unknowns: FloatArray, by_errors: FloatArray, n_arm: int = 0) -> ImageSums:
        """Return the sums with further columns J a + G b of J, a (n, k, c) and b (n, 6, c); `n_arm` of them are of the
        arm.
        """
        a, b = by_unknowns.transpose(0, 2, 1), by_errors.transpose(0, 2, 1)
        j_new = self.jj @ by_unknowns + self.jg @ by_errors
        new_g = a @ self.jg + b @ self.gg
        jj = np.block([[self.jj, j_new], [j_new.transpose(0, 2, 1), a @ j_new + new_g @ by_errors]])
        jr = np.concatenate(
            [self.jr, np.einsum("nck,nk->nc", a, self.jr) + np.einsum("nck,nk->nc", b, self.gr)], axis=1
        )
        weight, off = (np.pad(part, (0, a.shape[1])) for part in (self.weight, self.off))
        jg = np.concatenate([self.jg, new_g], axis=1)
        return replace(self, jj=jj, jg=jg, jr=jr, weight=weight, off=off, n_arm=n_arm)

    def with_arm(self, twists: FloatArray) -> ImageSums:
        """Return the sums with further columns for errors of the arm, which move the tool by `twists`, (n, 6, k)."""
        n, _, n_arm = twists.shape
        return self.with_columns(np.zeros((n, self.jj.shape[1], n_arm)), twists, n_arm)


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
    return (
        pixels - scene.pixels,
        np.concatenate(columns, axis=2),
        by_point @ _robot_error_derivative(scene, placed, body),
    )


def _robot_error_derivative(scene: BoardScene, placed: HandEyePlacement, body: FloatArray) -> FloatArray:
    """Derivative of points in the camera by an error of the robot's tool, (m, 3, 6)."""
    if scene.mount == "base":
        carried = body @ placed.board[:3, :3].T + placed.board[:3, 3]  # in the tool
        turned = (placed.camera[:3, :3].T @ scene.tool[:, :3, :3])[scene.image]
        return np.concatenate([turned, -turned @ cross_matrices(carried)], axis=2)
    seen = (scene.links @ placed.board)[scene.image]
    carried = np.einsum("kab,kb->ka", seen[:, :3, :3], body) + seen[:, :3, 3]
    turned = np.tile(placed.camera[:3, :3].T, (len(body), 1, 1))
    return -np.concatenate([turned, -turned @ cross_matrices(carried)], axis=2)


def linearise(scene: BoardScene, placed: HandEyePlacement, unknowns: HandEyeUnknowns = POSES) -> ImageSums:
    """Return residuals and derivatives, summed over the points of each image; see `rows`."""
    r, j, g = rows(scene, placed, unknowns)
    k = j.shape[2]
    wide = np.concatenate([j, g, r[:, :, None]], axis=2)
    images = (part.reshape(-1, k + 7) for part in np.split(wide, np.cumsum(scene.counts)[:-1]))
    squares = np.array([part.T @ part for part in images])
    jj, jg, gg = squares[:, :k, :k], squares[:, :k, k:-1], squares[:, k:-1, k:-1]
    jr, gr, rr = squares[:, :k, -1], squares[:, k:-1, -1], squares[:, -1, -1]
    weight, off = np.zeros((2, k))
    weight[unknowns.lens] = 1.0 / unknowns.sigma**2
    off[unknowns.lens] = placed.intrinsics[list(unknowns.free)] - unknowns.expected
    return ImageSums(jj, jg, gg, jr, gr, rr, 2 * scene.counts, weight, off)


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
