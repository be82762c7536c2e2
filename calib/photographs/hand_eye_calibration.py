"""Hand-eye calibration from photographs, with the robot's poses as given, judged by left-out images.

Order of work: (1) first values (`calib.photographs.starts`); (2) points far from where the other points of their image
predict them, and images far from where the other images predict them, are left out and named; (3) the lens: intrinsics
as given, or from the same images, whichever predicts left-out images better; (4) equal weights, or weights by the
errors that the points of an image share (`calib.photographs.estimation`), by the same rule; (5) the residual of the
camera alone, with the board placed freely in each image: the rest comes from the robot's poses; (6) mistakes that
would explain the residuals (`calib.photographs.mistakes`).

"Better" is more than chance: n log(RMS before / RMS after) must exceed 1.5, with the RMS of n left-out images. With few
images, a smaller gain is too often chance, and then new images are predicted worse.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import ComputationError, DataError
from calib.core.base.threads import one_blas_thread
from calib.core.base.words import count_noun
from calib.photographs.camera_alone import LEAST_IMAGES, camera_alone, intrinsics_at_first
from calib.photographs.estimation import HandEyeFit, estimate, rms, weigh_images
from calib.photographs.hand_eye import HandEye
from calib.photographs.images_off import fitting_images, fitting_points, images_far_off
from calib.photographs.lens_choice import lens_choices, unlikely
from calib.photographs.mistakes import find_mistakes
from calib.photographs.scene import BoardScene, Mount
from calib.photographs.starts import Start, start

_GAIN = 1.5
_ROUNDING = 1e-6  # px, of computed photographs


@one_blas_thread
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
        scene: The images, in the order in which they were taken; its mount is ignored.
        intrinsics: As given, (9,); None if unknown.
        lens: `given`: as they are; `found`: from the images; `auto`: whichever predicts left-out images better.
        mounts: Possible mounts of the camera.
        progress: Called with the number of finished steps and of all five.

    Raises:
        DataError: Too few images.
        NotIdentifiableError: The images do not determine all unknowns.
    """
    tell = progress or (lambda done, total: None)
    if lens == "given" and intrinsics is None:
        raise DataError("no intrinsics are given, so the lens cannot stay as given; give them with --camera FILE")
    scene = _sort_points(scene)
    first, begin = _first_start(scene, intrinsics, mounts)
    begin, points = fitting_points(begin, first)
    tell(1, 5)
    cleaned = begin.scene
    kept = fitting_images(cleaned, begin, intrinsics, lens)
    off = images_far_off(cleaned, kept, begin)
    kept_scene = cleaned.select_images(kept)
    tell(2, 5)
    choices = lens_choices(kept_scene, begin.placed, first, intrinsics, lens)
    better = choices[0]
    for choice in choices[1:]:
        if _gain(better, choice) > _GAIN:
            better = choice
    chosen = choices[0] if lens == "given" else better
    rms_given = float("nan") if choices[0].unknowns.free else rms(choices[0].left_out.pixels)
    tell(3, 5)
    by_errors = weigh_images(chosen)
    weighed = _gain(chosen, by_errors) > _GAIN
    fitted = estimate(by_errors if weighed else chosen)
    tell(4, 5)
    alone = camera_alone(kept_scene, fitted.placed.intrinsics, fitted.unknowns.free)
    of_lens = fitted if better is chosen else estimate(better)
    mistakes = find_mistakes(cleaned, fitted, intrinsics, first, of_lens, mounts)
    tell(5, 5)
    points = tuple(point for point in points if point.image in kept_scene.names)
    return HandEye(kept_scene, fitted, fitted.left_out, alone, off, points, mistakes, intrinsics, rms_given, weighed)


def _first_start(
    scene: BoardScene, intrinsics: FloatArray | None, mounts: tuple[Mount, ...]
) -> tuple[FloatArray, Start]:
    """First intrinsics, (9,), and first values: as given, unless these are implausible and fitted ones do better."""
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
    """The same images with their points in a fixed order, so that sums are equal to the last digit."""
    order = np.lexsort((scene.pixels[:, 1], scene.pixels[:, 0], scene.image))
    return replace(scene, image=scene.image[order], body=scene.body[order], pixels=scene.pixels[order])


def _gain(before: HandEyeFit, after: HandEyeFit) -> float:
    errors = [rms(fit.left_out.pixels) + _ROUNDING for fit in (before, after)]
    return float(len(before.scene) * np.log(errors[0] / errors[1]))


def require_images(count: int) -> None:
    """Raise `DataError` unless there are enough images with a board and a pose."""
    if count < LEAST_IMAGES:
        raise DataError(
            f"{count_noun(count, 'image')} with a board and a pose of the robot; give at least {LEAST_IMAGES}, better"
            " 10 to 20"
        )
