"""First values of focal length, camera and board in closed form; images and points that do not fit the others.

1. The focal length, if it is not stated. A homography from board to pixels, counted from the middle of the image, is
   H = K [r1 r2 t]. Its conditions r1 . r2 = 0 and |r1| = |r2| are linear in 1 / f^2 (zhang2000).
2. The pose of the board in the camera at each image (`calib.core.instruments.camera.view_poses`), then the hand-eye
   problem in closed form (`calib.core.instruments.hand_eye`) from all images. If large errors remain, some images may
   be wrong: then sets of four images are drawn at random, and the solution with the smallest median error is kept.
3. Reweighted least squares: images that are further off than most get less weight.

Where it is not said whether the camera is on the tool or at the base, both are tried; the wrong one does not fit.

References: zhang2000, daniilidis1999.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray, IntArray, ReadOnlyArrays
from calib.core.base.errors import DataError, NotIdentifiableError
from calib.core.instruments.camera import LEAST_POINTS, rays, view_poses
from calib.core.instruments.hand_eye import solve_poses
from calib.core.numerics import linalg
from calib.core.numerics.chances import FALSE_ALARM
from calib.core.numerics.losses import median_length
from calib.photographs.scene import BoardScene, HandEyePlacement, Mount, linearise, points_in_camera, residuals, rows
from calib.photographs.shared_errors import ErrorSizes, normal_equations

_TRIALS = 25
_GOOD = 5.0  # px, median error of the images below which no subsets are tried
_AT_ONCE = 4
_MOST_POINTS = 12  # points of an image from which its pose is computed; more add little
_ROUNDS = 25
_SEED = 0
_LOST = 1e14  # condition number from which the pose of a board is undetermined
_FAR = 2.5  # medians from which an image counts less
_NO_NOISE = 1e-9  # px: rounding of pixels that were computed
_SMALLEST = 1e-6  # least part of a point's noise that remains once its image is placed; less counts as none
LEAST_ALONE = 6
"""Least number of points of an image that its own pose cannot explain exactly."""
LEAST_IMAGES = 3


@dataclass(frozen=True, eq=False)
class Start(ReadOnlyArrays):
    """First values for a fit of photographs.

    Attributes:
        scene: The images, with the mount that fits.
        placed: Approximate placement of camera and board.
        rms: Root mean square residual of each image, (n,) [px].
    """

    scene: BoardScene
    placed: HandEyePlacement
    rms: FloatArray

    @property
    def typical(self) -> float:
        """Median over the images of their root mean square residual [px]."""
        return float(np.median(self.rms))


def first_focal(scene: BoardScene) -> float:
    """Return the focal length that follows from the homographies of the images [px].

    Raises:
        NotIdentifiableError: The images do not determine it, such as when all see the board from the front.
    """
    middle = np.array(scene.size) / 2
    left, right = [], []
    for i in np.flatnonzero(scene.counts >= 6):
        in_image = scene.image == i
        h = _homography(scene.body[in_image, :2], (scene.pixels[in_image] - middle) / middle[0])
        if h is None:
            continue
        a, b = h[:, 0], h[:, 1]
        size = float(a @ a + b @ b)
        left += [(a[0] * b[0] + a[1] * b[1]) / size, (a[0] ** 2 + a[1] ** 2 - b[0] ** 2 - b[1] ** 2) / size]
        right += [-a[2] * b[2] / size, -(a[2] ** 2 - b[2] ** 2) / size]
    square = np.array(left) @ np.array(left)
    value = float(np.array(left) @ np.array(right) / square) if square > 0 else 0.0
    focal = float(middle[0] / np.sqrt(value)) if value > 0 else float("nan")
    if not 0.2 * middle[0] < focal < 50 * middle[0]:
        raise NotIdentifiableError(
            "the photographs do not determine the focal length; give intrinsics (--camera FILE), or tilt the board"
            " by 30 deg in"
            " some images"
        )
    return focal


def _homography(body: FloatArray, seen: FloatArray) -> FloatArray | None:
    """H with seen ~ H body by the direct linear transform, in units of the board; None where points are in line."""
    centre, size = body.mean(axis=0), float(np.std(body))
    x = np.hstack([(body - centre) / size, np.ones((len(body), 1))])
    zeros = np.zeros_like(x)
    design = np.vstack([np.hstack([x, zeros, -seen[:, :1] * x]), np.hstack([zeros, x, -seen[:, 1:] * x])])
    _, values, vt = linalg.svd(design)
    if values[-2] < 1e-6 * values[0]:
        return None
    return vt[-1].reshape(3, 3)


def intrinsics_at_first(scene: BoardScene) -> FloatArray:
    """Return intrinsics to begin with where none are given, (9,)."""
    focal = first_focal(scene)
    return np.array([focal, focal, (scene.size[0] - 1) / 2, (scene.size[1] - 1) / 2, 0, 0, 0, 0, 0])


def views(scene: BoardScene) -> FloatArray:
    """Return approximate poses of the board in the camera, for the images that determine one, (k, 4, 4) [m].

    Poses of the robot are not used. The focal length follows from the homographies; where these do not determine it,
    it is the width of the image.
    """
    try:
        intrinsics = intrinsics_at_first(scene)
    except NotIdentifiableError:
        width, height = scene.size
        intrinsics = np.array([width, width, (width - 1) / 2, (height - 1) / 2, 0.0, 0.0, 0.0, 0.0, 0.0])
    poses, errors = single_views(scene, intrinsics)
    return poses[np.isfinite(errors)]


def single_views(scene: BoardScene, intrinsics: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the board in the camera at each image (n, 4, 4) [m], and its error, (n,) [rad]; inf where not solved."""
    chosen = np.concatenate(
        [rows[np.unique(np.linspace(0, len(rows) - 1, _MOST_POINTS).astype(int))] for rows in _points_by_image(scene)]
    )
    return view_poses(scene.body[chosen], rays(scene.pixels[chosen], intrinsics), scene.image[chosen], len(scene))


def _points_by_image(scene: BoardScene) -> list[IntArray]:
    ends = np.cumsum(scene.counts)
    return [np.arange(end - count, end) for end, count in zip(ends, scene.counts, strict=True)]


def start(scene: BoardScene, intrinsics: FloatArray, *, mounts: tuple[Mount, ...] = ("tool", "base")) -> Start:
    """Return first values for a fit of photographs.

    Args:
        scene: The images.
        intrinsics: (9,).
        mounts: Possible mounts of the camera.

    Raises:
        DataError: Too few images with enough points.
    """
    enough = scene.counts >= LEAST_POINTS
    if np.sum(enough) < LEAST_IMAGES:
        raise DataError(
            f"{int(np.sum(enough))} images show {LEAST_POINTS} points or more; give at least {LEAST_IMAGES}, better 10"
            " to 20"
        )
    views, errors = single_views(scene, intrinsics)
    usable = np.flatnonzero(np.isfinite(errors))
    best: Start | None = None
    for mount in mounts:
        candidate = _start(replace(scene, mount=mount), intrinsics, views, usable)
        best = candidate if best is None or candidate.typical < best.typical else best
        if best.typical < _GOOD:
            break
    assert best is not None
    return best


def _start(scene: BoardScene, intrinsics: FloatArray, views: FloatArray, usable: IntArray) -> Start:
    links, now, none = scene.links, (np.eye(4), np.eye(4)), (False, False)
    whole = _robust(scene, HandEyePlacement(*solve_poses(links[usable], views[usable], now, none), intrinsics))
    if whole.typical < _GOOD or len(usable) <= _AT_ONCE:
        return whole
    generator = np.random.default_rng(_SEED)
    subsets = np.array([generator.choice(usable, _AT_ONCE, replace=False) for _ in range(_TRIALS)])
    poses = zip(*solve_poses(links[subsets], views[subsets], now, none), strict=True)
    tried = [HandEyePlacement(camera, board, intrinsics) for camera, board in poses]
    tried.sort(key=lambda placed: _median_error(scene, placed))
    return min([whole, *(_robust(scene, placed) for placed in tried[:3])], key=lambda candidate: candidate.typical)


def _median_error(scene: BoardScene, placed: HandEyePlacement) -> float:
    return float(np.median(image_rms(scene, placed)))


def image_rms(scene: BoardScene, placed: HandEyePlacement) -> FloatArray:
    """Return the root mean square residual of each image, (n,) [px]; a board behind the camera counts as far off."""
    errors = np.sum(residuals(scene, placed) ** 2, axis=1)
    behind = points_in_camera(scene, placed)[0][:, 2] <= 0
    errors = np.where(behind, np.maximum(errors, float(max(scene.size)) ** 2), errors)
    return np.sqrt(scene.sums(errors) / np.maximum(scene.counts, 1))


def _robust(scene: BoardScene, placed: HandEyePlacement) -> Start:
    """Damped least-squares steps; images that are further off than most get less weight."""
    rms, damping = image_rms(scene, placed), 1e-3
    for _ in range(_ROUNDS):
        scale = _FAR * max(float(np.median(rms)), 1e-3)
        weight = 1.0 / (1.0 + (rms / scale) ** 2)
        linear = linearise(scene, placed, ())
        part = linear.times(weight)
        a, b, _ = normal_equations(part, ErrorSizes(), None, np.zeros(0))
        size = 1.0 / np.sqrt(np.diag(a) + 1e-300)
        step = -size * np.linalg.solve(size[:, None] * a * size + damping * np.eye(12), size * b)
        tried = placed.step(step, ())
        ahead = image_rms(scene, tried)
        cost, new_cost = (float(np.sum(np.log1p((errors / scale) ** 2))) for errors in (rms, ahead))
        if new_cost <= cost:
            settled = cost - new_cost < 1e-6 * max(cost, 1e-12)
            placed, rms, damping = tried, ahead, damping / 10
            if settled:
                break
        else:
            damping *= 10
            if damping > 1e6:
                break
    return Start(scene, placed, rms)


def camera_alone(
    scene: BoardScene, intrinsics: FloatArray, free: tuple[int, ...] = ()
) -> tuple[FloatArray, FloatArray]:
    """Return residuals (m, 2) [px] and intrinsics (9,) of a fit without robot, with a pose of the board for each image.

    An image with fewer than six points is not used, because its own pose could explain them; its residuals are NaN.

    Args:
        scene: The images.
        intrinsics: First values of the intrinsics, (9,).
        free: Indices of the intrinsics that are fitted.
    """
    alone = _board_free(scene, intrinsics, free)
    result = np.full_like(scene.pixels, np.nan)
    if alone is None:
        return result, intrinsics
    result[np.isin(scene.image, alone.images)] = residuals(alone.scene, alone.placed)
    return result, alone.placed.intrinsics


@dataclass(frozen=True, eq=False)
class _FreeBoards(ReadOnlyArrays):
    """The board with a free pose in each image; `tool` of the scene is the pose of the board in the camera."""

    scene: BoardScene
    placed: HandEyePlacement
    images: IntArray


def _board_free(scene: BoardScene, intrinsics: FloatArray, free: tuple[int, ...] = ()) -> _FreeBoards | None:
    """Place the board in each image with enough points; None if a pose is not determined. See `camera_alone`."""
    use = scene.counts >= LEAST_ALONE
    if free and np.sum(use) < LEAST_IMAGES:
        free = ()
    used = scene.select_images(use)
    if len(used) == 0:
        return None
    views, _ = single_views(used, intrinsics)
    # each image counts as one pose of the robot: the camera is in the base, the board on the tool at the origin
    placed = HandEyePlacement(np.eye(4), np.eye(4), intrinsics)
    alone = replace(used, tool=views, mount="base")
    for _ in range(_ROUNDS):
        linear = linearise(alone, placed, free)
        if not np.all(np.isfinite(linear.gg)) or np.max(linalg.cond(linear.gg)) > _LOST:
            return None
        inverse = np.linalg.inv(linear.gg)
        pull = linear.gr
        if free:
            jg, jj, jr = linear.jg[:, 12:], linear.jj[:, 12:, 12:], linear.jr[:, 12:]
            a = np.sum(jj - jg @ inverse @ jg.transpose(0, 2, 1), axis=0)
            b = np.sum(jr - np.einsum("nab,nbc,nc->na", jg, inverse, linear.gr), axis=0)
            change = -linalg.lstsq(a, b, rcond=1e-12)
            pull = linear.gr + np.einsum("nba,b->na", jg, change)
            placed = placed.step(np.concatenate([np.zeros(12), change]), free)
        steps = -np.einsum("nab,nb->na", inverse, pull)
        moved = np.array(
            [
                HandEyePlacement(pose, np.eye(4), intrinsics).step(np.r_[step, np.zeros(6)], ()).camera
                for pose, step in zip(alone.tool, steps, strict=True)
            ]
        )
        alone = replace(alone, tool=moved)
        if np.max(np.abs(steps)) < 1e-10:
            break
    return _FreeBoards(alone, placed, np.flatnonzero(use))


def point_errors(scene: BoardScene, intrinsics: FloatArray, free: tuple[int, ...]) -> FloatArray:
    """Return the distances of outlying points from where the other points of their image put them, (m,) [px]; else 0.

    Each image has its own pose of the board, so that neither the robot nor another image matters. The point of an image
    with the largest studentised residual is left out, and the board is placed again, until no residual is larger than
    chance explains: in one of a hundred sets of good points (`calib.core.numerics.losses`). Where more than half of the
    points would be left out, or too few would stay, the image keeps all: then the image or its board is wrong.

    Args:
        scene: The images.
        intrinsics: First values of the intrinsics, (9,).
        free: Indices of the intrinsics that are fitted.
    """
    far: FloatArray = np.zeros(len(scene.pixels))
    alone = _board_free(scene, intrinsics, free)
    if alone is None or 2 * len(alone.scene.pixels) <= 6 * len(alone.scene) + len(free):
        return far
    lens, images = alone.placed.intrinsics, alone.images
    number = np.flatnonzero(np.isin(scene.image, images))  # index in the scene of each point that is tested
    sizes, lengths = _studentised_residuals(alone)
    freedom = 2 * len(number) - 6 * len(images) - len(free)
    scale = max(float(np.median(sizes)) / float(median_length(np.array([2]))[0]), _NO_NOISE)
    for i in images:
        own = np.flatnonzero(scene.image == i)
        at, gone = np.isin(number, own), np.zeros(len(own), dtype=bool)
        size, length = sizes[at], lengths[at]
        while True:
            chance = len(number) * scipy.special.fdtrc(2, freedom / 2, (size / scale) ** 2 / 2)
            k = int(np.argmax(np.where(gone, -np.inf, size)))
            if chance[k] >= FALSE_ALARM:
                far[own[gone]] = length[gone]
                break
            gone[k] = True
            if 2 * np.sum(gone) > len(own) or np.sum(~gone) < LEAST_ALONE:
                break
            others = scene.with_points(np.isin(np.arange(len(far)), own[~gone])).select_images(
                np.arange(len(scene)) == i
            )
            again = _board_free(others, lens)
            if again is None:
                break
            whole = scene.select_images(np.arange(len(scene)) == i)
            shown = _FreeBoards(replace(whole, tool=again.scene.tool, mount="base"), again.placed, again.images)
            length = np.linalg.norm(residuals(shown.scene, shown.placed), axis=1)
            size = np.where(gone, length, 0.0)
            size[~gone] = _studentised_residuals(again)[0]
    return far


def _studentised_residuals(alone: _FreeBoards) -> tuple[FloatArray, FloatArray]:
    """Studentised residuals (over the noise that remains once the image is placed), and plain lengths, (m,) [px]."""
    r, _, g = rows(alone.scene, alone.placed, ())
    inverse = np.linalg.inv(linearise(alone.scene, alone.placed, ()).gg)[alone.scene.image]
    left = np.eye(2) - g @ inverse @ g.transpose(0, 2, 1)
    values, vectors = linalg.eigh(left)
    turned = np.einsum("mba,mb->ma", vectors, r)
    squares = np.where(values > _SMALLEST, turned**2 / np.maximum(values, _SMALLEST), 0.0)
    return np.sqrt(np.sum(squares, axis=1)), np.linalg.norm(r, axis=1)
