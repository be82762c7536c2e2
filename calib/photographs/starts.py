"""Where to begin, without any guess: closed forms on the poses, and which images do not fit the others.

1. The focal length, where nobody states it: of a homography H = K [r1 r2 t] from board to pixels, counted from the
   middle of the image, r1 . r2 = 0 and |r1| = |r2| are linear in 1 / f^2 (zhang2000).
2. The board in the camera at each image (`calib.instruments.camera.view_poses`), and the hand-eye problem in closed
   form (`calib.instruments.hand_eye`): from all images; where that leaves much, from four at a time chosen at random,
   since some may be wrong. The solution with the smallest median error of images is kept.
3. Least squares in which images that lie further off than most count less, again and again.

Both ways to mount the camera are tried where it is not said; the wrong one fits no robot.

References: zhang2000, daniilidis1999.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.base.arrays import FloatArray, IntArray, ReadOnlyArrays
from calib.base.errors import DataError, NotIdentifiableError
from calib.instruments.camera import LEAST_POINTS, rays, view_poses
from calib.instruments.hand_eye import fixed_poses
from calib.photographs.estimation import Noise, normal_equations
from calib.photographs.scene import Mount, Placed, Scene, in_camera, linearised, residuals

_TRIALS = 25
_GOOD = 5.0  # px, of most images: then there is no need to ask subsets
_AT_ONCE = 4
_MOST_POINTS = 12  # of an image, for its pose: more tell little more
_ROUNDS = 25
_SEED = 0
_LOST = 1e14  # condition of the pose of a board
_FAR = 2.5  # medians from which an image counts less
LEAST_IMAGES = 3


@dataclass(frozen=True, eq=False)
class Start(ReadOnlyArrays):
    """Where to begin.

    Attributes:
        scene: The images, with the mount that fits.
        placed: Where camera and board are, about.
        rms: Of each image, (n,) [px].
    """

    scene: Scene
    placed: Placed
    rms: FloatArray

    @property
    def typical(self) -> float:
        """Median of the images [px]."""
        return float(np.median(self.rms))


def first_focal(scene: Scene) -> float:
    """Return the focal length that the homographies of single images tell [px].

    Raises:
        NotIdentifiableError: The board was seen from the front in all of them, or they tell none.
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
            "the photographs do not tell the focal length; give intrinsics (--camera FILE), or tilt the board"
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
    _, values, vt = np.linalg.svd(design)
    if values[-2] < 1e-6 * values[0]:
        return None
    return vt[-1].reshape(3, 3)


def intrinsics_at_first(scene: Scene) -> FloatArray:
    """Return intrinsics to begin with where none are given, (9,)."""
    focal = first_focal(scene)
    return np.array([focal, focal, (scene.size[0] - 1) / 2, (scene.size[1] - 1) / 2, 0, 0, 0, 0, 0])


def single_views(scene: Scene, intrinsics: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the board in the camera at each image (n, 4, 4) [m], and its error, (n,) [rad]; inf where not solved."""
    chosen = np.concatenate(
        [rows[np.unique(np.linspace(0, len(rows) - 1, _MOST_POINTS).astype(int))] for rows in _by_image(scene)]
    )
    return view_poses(scene.body[chosen], rays(scene.pixels[chosen], intrinsics), scene.image[chosen], len(scene))


def _by_image(scene: Scene) -> list[IntArray]:
    ends = np.cumsum(scene.counts)
    return [np.arange(end - count, end) for end, count in zip(ends, scene.counts, strict=True)]


def start(scene: Scene, intrinsics: FloatArray, *, mounts: tuple[Mount, ...] = ("tool", "base")) -> Start:
    """Return where to begin.

    Args:
        scene: The images.
        intrinsics: (9,).
        mounts: Where the camera may be.

    Raises:
        DataError: Too few images with enough points.
    """
    enough = scene.counts >= LEAST_POINTS
    if np.sum(enough) < LEAST_IMAGES:
        raise DataError(
            f"{int(np.sum(enough))} images show {LEAST_POINTS} points or more; it takes {LEAST_IMAGES}, and 10"
            f" to 20 are"
            " sensible"
        )
    views, errors = single_views(scene, intrinsics)
    usable = np.flatnonzero(np.isfinite(errors))
    best: Start | None = None
    for mount in mounts:
        candidate = _started(replace(scene, mount=mount), intrinsics, views, usable)
        best = candidate if best is None or candidate.typical < best.typical else best
        if best.typical < _GOOD:
            break
    assert best is not None
    return best


def _started(scene: Scene, intrinsics: FloatArray, views: FloatArray, usable: IntArray) -> Start:
    links, now, none = scene.links, (np.eye(4), np.eye(4)), (False, False)
    whole = _robust(scene, Placed(*fixed_poses(links[usable], views[usable], now, none), intrinsics))
    if whole.typical < _GOOD or len(usable) <= _AT_ONCE:
        return whole
    generator = np.random.default_rng(_SEED)
    subsets = [generator.choice(usable, _AT_ONCE, replace=False) for _ in range(_TRIALS)]
    tried = [Placed(*fixed_poses(links[some], views[some], now, none), intrinsics) for some in subsets]
    tried.sort(key=lambda placed: _median_error(scene, placed))
    return min([whole, *(_robust(scene, placed) for placed in tried[:3])], key=lambda candidate: candidate.typical)


def _median_error(scene: Scene, placed: Placed) -> float:
    return float(np.median(image_rms(scene, placed)))


def image_rms(scene: Scene, placed: Placed) -> FloatArray:
    """Return the root mean square residual of each image, (n,) [px]; a board behind the camera counts as far off."""
    errors = np.sum(residuals(scene, placed) ** 2, axis=1)
    behind = in_camera(scene, placed)[0][:, 2] <= 0
    errors = np.where(behind, np.maximum(errors, float(max(scene.size)) ** 2), errors)
    return np.sqrt(scene.sums(errors) / np.maximum(scene.counts, 1))


def _robust(scene: Scene, placed: Placed) -> Start:
    """Damped steps in which images that lie further off than most count less."""
    rms, damping = image_rms(scene, placed), 1e-3
    for _ in range(_ROUNDS):
        scale = _FAR * max(float(np.median(rms)), 1e-3)
        weight = 1.0 / (1.0 + (rms / scale) ** 2)
        linear = linearised(scene, placed, ())
        part = linear.times(weight)
        a, b, _ = normal_equations(part, Noise(), None, np.zeros(0))
        size = 1.0 / np.sqrt(np.diag(a) + 1e-300)
        step = -size * np.linalg.solve(size[:, None] * a * size + damping * np.eye(12), size * b)
        tried = placed.moved(step, ())
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


def camera_alone(scene: Scene, intrinsics: FloatArray, free: tuple[int, ...] = ()) -> tuple[FloatArray, FloatArray]:
    """Return what is left with the board placed freely in each image, no robot: residuals (m, 2) [px], intrinsics (9,).

    Images with fewer than six points, which their own pose could explain, are left out of the lens, and NaN.

    Args:
        scene: The images.
        intrinsics: To begin with.
        free: Which of them are sought.
    """
    use = scene.counts >= 6
    if free and np.sum(use) < LEAST_IMAGES:
        free = ()
    used = scene.only(use)
    result = np.full_like(scene.pixels, np.nan)
    if len(used) == 0:
        return result, intrinsics
    views, _ = single_views(used, intrinsics)
    # each image a robot pose of its own: the camera in the base, the board on the tool at the origin
    placed = Placed(np.eye(4), np.eye(4), intrinsics)
    alone = replace(used, tool=views, mount="base")
    for _ in range(_ROUNDS):
        linear = linearised(alone, placed, free)
        if np.max(np.linalg.cond(linear.gg)) > _LOST or not np.all(np.isfinite(linear.gg)):
            return result, intrinsics  # no pose of the board explains an image
        inverse = np.linalg.inv(linear.gg)
        change = np.zeros(0)
        if free:
            jg, jj, jr = linear.jg[:, 12:], linear.jj[:, 12:, 12:], linear.jr[:, 12:]
            a = np.sum(jj - jg @ inverse @ jg.transpose(0, 2, 1), axis=0)
            b = np.sum(jr - np.einsum("nab,nbc,nc->na", jg, inverse, linear.gr), axis=0)
            change = -np.linalg.lstsq(a, b, rcond=1e-12)[0]
            pull = linear.gr + np.einsum("nba,b->na", jg, change)
            placed = placed.moved(np.concatenate([np.zeros(12), change]), free)
        else:
            pull = linear.gr
        steps = -np.einsum("nab,nb->na", inverse, pull)
        moved = np.array(
            [
                Placed(pose, np.eye(4), intrinsics).moved(np.r_[step, np.zeros(6)], ()).camera
                for pose, step in zip(alone.tool, steps, strict=True)
            ]
        )
        alone = replace(alone, tool=moved)
        if np.max(np.abs(steps)) < 1e-10:
            break
    result[use[scene.image]] = residuals(alone, placed)
    return result, placed.intrinsics
