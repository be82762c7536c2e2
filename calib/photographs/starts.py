"""First values of camera and board, in closed form.

1. The pose of the board in the camera at each image (`calib.photographs.camera_alone.single_views`), then the hand-eye
   problem in closed form (`calib.core.instruments.hand_eye`) from all images, improved by least squares with less
   weight for outlying points (`calib.core.instruments.camera_places`).
2. If large errors remain, some images may be wrong: then sets of four images are drawn at random, and the solution with
   the smallest median error is kept.

If the mount of the camera is unknown, both are tried; the wrong mount does not fit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib.core.base.arrays import FloatArray, IntArray, ReadOnlyArrays
from calib.core.base.errors import DataError
from calib.core.instruments.camera import LEAST_POINTS, rays
from calib.core.instruments.camera_places import Places, Sightings, refine_places
from calib.core.instruments.hand_eye import solve_poses
from calib.photographs.camera_alone import LEAST_IMAGES, single_views
from calib.photographs.scene import BoardScene, HandEyePlacement, Mount, points_in_camera, residuals

_TRIALS = 25
_GOOD = 5.0  # px; no subsets are tried if the median error of the images is less
_AT_ONCE = 4
_POINTS = 12  # approximate number of points per image that improve places; more add little
_GOLDEN = 0.618034  # steps by this ratio reach all rows and columns of a board evenly
_STEPS = 20
_SEED = 0


@dataclass(frozen=True, eq=False)
class Start(ReadOnlyArrays):
    """First values for a fit of photographs: the images, with the mount that fits, and camera and board about there."""

    scene: BoardScene
    placed: HandEyePlacement

    @cached_property
    def rms(self) -> FloatArray:
        """Root mean square residual of each image, (n,) [px]; large for a board behind the camera."""
        errors, behind = residuals(self.scene, self.placed), points_in_camera(self.scene, self.placed)[0][:, 2] <= 0
        lengths = np.linalg.norm(errors, axis=1)
        lengths[behind] = np.maximum(lengths[behind], max(self.scene.size))
        return self.scene.rms_by_image(lengths[:, None])

    @property
    def typical(self) -> float:
        """Median over the images of their root mean square residual [px]."""
        return float(np.median(self.rms))


def start(scene: BoardScene, intrinsics: FloatArray, *, mounts: tuple[Mount, ...] = ("tool", "base")) -> Start:
    """Return first values for a fit of photographs; intrinsics are (9,).

    Raises:
        DataError: Too few images with enough points.
    """
    enough = scene.counts >= LEAST_POINTS
    if np.sum(enough) < LEAST_IMAGES:
        raise DataError(
            f"{int(np.sum(enough))} images show {LEAST_POINTS} points or more; give at least {LEAST_IMAGES}, better 10"
            " to 20"
        )
    views, found = single_views(scene, intrinsics)
    usable = np.flatnonzero(found)
    tried: list[Start] = []
    for mount in mounts:
        tried.append(_start(replace(scene, mount=mount), intrinsics, views, usable))
        if tried[-1].typical < _GOOD:
            break
    return min(tried, key=lambda candidate: candidate.typical)


def _start(scene: BoardScene, intrinsics: FloatArray, views: FloatArray, usable: IntArray) -> Start:
    links, now, none = scene.links, (np.eye(4), np.eye(4)), (False, False)
    in_image = np.arange(len(scene.image)) - np.searchsorted(scene.image, scene.image)
    some = scene.with_points((in_image * _GOLDEN) % 1.0 < _POINTS / scene.counts[scene.image])
    sightings = Sightings(links[some.image], some.body, rays(some.pixels, intrinsics), some.image)

    def start_at(places: Places, steps: int = 0) -> Start:
        improved = refine_places(sightings, places, steps=steps) if steps else places
        return Start(scene, HandEyePlacement(*improved, intrinsics))

    whole = start_at(solve_poses(links[usable], views[usable], now, none), _STEPS)
    if whole.typical < _GOOD or len(usable) <= _AT_ONCE:
        return whole
    generator = np.random.default_rng(_SEED)
    subsets = np.array([generator.choice(usable, _AT_ONCE, replace=False) for _ in range(_TRIALS)])
    tried = [start_at(places) for places in zip(*solve_poses(links[subsets], views[subsets], now, none), strict=True)]
    best = sorted(tried, key=lambda candidate: candidate.typical)[:3]
    improved = [start_at((each.placed.camera, each.placed.board), _STEPS) for each in best]
    return min([whole, *improved], key=lambda candidate: candidate.typical)
