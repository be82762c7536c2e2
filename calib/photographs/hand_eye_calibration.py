"""Hand-eye calibration from photographs, with a robot that is taken as it is: found, and judged by images left out.

Order of work: (1) where to begin (`calib.photographs.starts`); (2) points that lie far off where the others of their
image put them are left out, and images that lie far off where the other images put them are set aside, all by name;
(3) the lens: intrinsics as given, or found from the same images, whichever predicts images that are left out in turn
better; (4) every point alike or images weighed by what their points share (`calib.photographs.estimation`), by the same
rule; (5) what the camera alone leaves, the board placed freely in each image: the rest comes with the robot's poses;
(6) mistakes that would explain the residuals (`calib.photographs.mistakes`).

"Better" is more than chance: with n images, n log(RMS / RMS) of those left out must gain more than 1.5. Where images
are few, what gains less is chance too often, and then new images are predicted worse.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import ComputationError, DataError
from calib.core.base.words import count_noun
from calib.photographs.camera_alone import LEAST_IMAGES, camera_alone, intrinsics_at_first
from calib.photographs.estimation import estimate
from calib.photographs.hand_eye import HandEye
from calib.photographs.images_off import fitting_images, fitting_points, images_far_off
from calib.photographs.left_out_images import LeftOutImages, predict_left_out_images, rms
from calib.photographs.lens_choice import lens_choices, lens_prior, unlikely
from calib.photographs.mistakes import find_mistakes
from calib.photographs.scene import BoardScene, Mount
from calib.photographs.starts import Start, start

_GAIN = 1.5


def calibrate(
    scene: BoardScene,
    intrinsics: FloatArray | None,
    *,
    lens: str = "auto",
    mounts: tuple[Mount, ...] = ("tool", "base"),
    progress: Callable[[int, int], None] | None = None,
) -> HandEye:
    """Return the hand-eye calibration of a camera.

    Args:
        scene: The images, in the order in which they were taken; its mount does not count.
        intrinsics: As given, (9,); None if unknown.
        lens: `given`: as they are; `found`: from the images; `auto`: whichever predicts images left out better.
        mounts: Possible mounts of the camera.
        progress: Told after each of five steps.

    Raises:
        DataError: Too few images.
        NotIdentifiableError: They do not determine what is sought.
        NotConvergedError: The noise was not found.
    """
    tell = progress or (lambda done, total: None)
    if lens == "given" and intrinsics is None:
        raise DataError("no intrinsics are given, so the lens cannot stay as given; give them with --camera FILE")
    scene = _sort_points(scene)
    first, begin = _first_start(scene, intrinsics, mounts)
    begin, points = fitting_points(begin, first)
    tell(1, 5)
    sure = begin.scene
    kept = fitting_images(sure, begin, intrinsics, lens)
    off = images_far_off(sure, kept, begin)
    kept_scene = sure.select_images(kept)
    tell(2, 5)
    prior = lens_prior(first, kept_scene, first is intrinsics)
    choices = lens_choices(kept_scene, begin.placed, prior, intrinsics, lens)
    chosen = choices[0]
    better = chosen
    for other in choices[1:]:
        if _gain(better.left_out, other.left_out, len(kept_scene)) > _GAIN:
            better = other
    chosen = choices[0] if lens == "given" else better
    rms_given = float("nan") if choices[0].free else rms(choices[0].left_out.pixels)
    tell(3, 5)
    fitted, left = estimate(kept_scene, chosen.placed, chosen.free, chosen.prior), chosen.left_out
    used, weighed = chosen.prior, False
    if fitted.noise.shift > 0 or fitted.noise.turn > 0:
        try:
            other_fitted = estimate(kept_scene, fitted.placed, fitted.free, used, weighed=True, near=fitted.noise)
            other_left = predict_left_out_images(
                kept_scene, other_fitted.placed, other_fitted.free, other_fitted.weights, used
            )
            if _gain(left, other_left, len(kept_scene)) > _GAIN:
                fitted, left, weighed = other_fitted, other_left, True
        except ComputationError:
            pass  # weights that cannot be found are not used
    tell(4, 5)
    alone = camera_alone(kept_scene, fitted.placed.intrinsics, fitted.free)
    of_lens = fitted if better is chosen else estimate(kept_scene, better.placed, better.free, better.prior)
    mistakes = find_mistakes(sure, kept_scene, fitted, used, intrinsics, first, of_lens, mounts)
    tell(5, 5)
    points = tuple(point for point in points if point.image in kept_scene.names)
    return HandEye(kept_scene, fitted, left, alone, off, points, mistakes, intrinsics, rms_given, weighed)


def _first_start(
    scene: BoardScene, intrinsics: FloatArray | None, mounts: tuple[Mount, ...]
) -> tuple[FloatArray, Start]:
    """Return intrinsics to begin with, (9,), and where to begin: as given, unless no lens has them and others fit."""
    begun = [] if intrinsics is None else [(intrinsics, start(scene, intrinsics, mounts=mounts))]
    if intrinsics is None or unlikely(intrinsics, scene.size):
        try:
            first = intrinsics_at_first(scene)
            begun.append((first, start(scene, first, mounts=mounts)))
        except ComputationError:
            if not begun:
                raise
    return min(begun, key=lambda each: each[1].typical)


def _sort_points(scene: BoardScene) -> BoardScene:
    """The same images, their points in one order whatever the file has, so that sums are the same to the last digit."""
    order = np.lexsort((scene.pixels[:, 1], scene.pixels[:, 0], scene.image))
    return replace(scene, image=scene.image[order], body=scene.body[order], pixels=scene.pixels[order])


def _gain(before: LeftOutImages, after: LeftOutImages, n: int) -> float:
    return float(n * np.log(rms(before.pixels) / rms(after.pixels)))


def require_images(count: int) -> None:
    """Raise `DataError` unless there are enough images with a board and a pose."""
    if count < LEAST_IMAGES:
        raise DataError(
            f"{count_noun(count, 'image')} with a board and a pose of the robot; give at least {LEAST_IMAGES}, better"
            f" 10"
            " to 20"
        )
