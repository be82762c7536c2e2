"""Outlying points and outlying images, by name.

A point is left out if the other points of its image predict it elsewhere. An image is left out if its distance from the
prediction of the other images is larger than any error of a robot. At most a third of the images are left out, because
more cannot be outliers.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray
from calib.core.base.errors import ComputationError
from calib.core.numerics import linalg
from calib.photographs.camera_alone import point_errors
from calib.photographs.estimation import plain
from calib.photographs.lens_choice import LENS_NUMBERS, free_lens
from calib.photographs.scene import POSES, BoardScene, HandEyePlacement, HandEyeUnknowns, residuals, rows
from calib.photographs.starts import Start

_OFF = 5.0  # an image is left out if its error is more than this many times the median
_LEAST_OFF = 1.0  # smaller errors are always allowed [px]
_MOST_OFF = 1 / 3  # largest part of the images that is left out
_UNSEEN = 3e-5  # an image does not show a motion of the tool with a smaller relative singular value
_FEWEST = 5  # images that must stay if another is left out


@dataclass(frozen=True)
class OffPoint:
    """A point that does not fit the others of its image, and its distance from their prediction."""

    image: str
    u: float
    v: float
    distance_px: float


@dataclass(frozen=True)
class OffImage:
    """An image that does not fit the others, and the motion of the robot's tool that would make it fit."""

    name: str
    rms_px: float
    shift_m: float
    turn_rad: float


def fitting_points(begin: Start, intrinsics: FloatArray) -> tuple[Start, tuple[OffPoint, ...]]:
    """Return first values without outlying points, and these points, furthest first; `intrinsics` are (9,)."""
    scene = begin.scene
    far = point_errors(scene, intrinsics, LENS_NUMBERS)
    off = [
        OffPoint(scene.names[scene.image[k]], *map(float, (*scene.pixels[k], far[k])))
        for k in np.argsort(-far, kind="stable")[: np.count_nonzero(far)]
    ]
    return Start(scene.with_points(far == 0), begin.placed), tuple(off)


def fitting_images(scene: BoardScene, begin: Start, intrinsics: FloatArray | None, lens: str) -> BoolArray:
    """Return the mask of the images that fit the others, (n,)."""
    most = int(_MOST_OFF * len(scene))
    fewest = max(_FEWEST, len(scene) - most)
    every: BoolArray = np.ones(len(scene), dtype=bool)
    unknowns = POSES if lens == "given" else free_lens(begin.placed.intrinsics, scene, intrinsics is not None)
    errors_without = partial(_prediction_errors, scene, begin.placed, unknowns)
    candidates = np.argsort(-begin.rms)[: most + 1]
    trial = ~np.isin(np.arange(len(scene)), [i for i in candidates if begin.rms[i] > 3 * begin.typical][:most])
    if np.sum(trial) < _FEWEST:
        return every
    for _ in range(3):
        errors = errors_without(trial)
        if errors is None:
            return every
        now = errors <= _limit(errors[trial])
        if np.sum(now) < fewest:
            return every
        if np.array_equal(now, trial):
            break
        trial = now
    # an outlying image in the fit would hide its own distance
    errors = errors_without(trial)
    while errors is not None and np.sum(trial) > fewest:
        furthest = int(np.argmax(np.where(trial, errors, -np.inf)))
        without = trial & (np.arange(len(scene)) != furthest)
        errors = errors_without(without)
        if errors is None or not errors[furthest] > _limit(errors[without]):
            break
        trial = without
    return trial


def _limit(errors: FloatArray) -> float:
    """Error above which an image does not fit others with these errors [px]."""
    return max(_OFF * float(np.median(errors)), _LEAST_OFF)


def _prediction_errors(
    scene: BoardScene, begin: HandEyePlacement, unknowns: HandEyeUnknowns, kept: BoolArray
) -> FloatArray | None:
    """RMS error of each image against the fit of the other kept ones, (n,) [px]; None without such a fit."""
    kept_scene = scene.select_images(kept)
    try:
        fit = plain(kept_scene, begin, unknowns)
    except ComputationError:
        return None
    result = scene.rms_by_image(residuals(scene, fit.placed))
    result[kept] = kept_scene.rms_by_image(fit.left_out.pixels)
    return result


def images_far_off(scene: BoardScene, kept: BoolArray, begin: Start) -> tuple[OffImage, ...]:
    """Return the images that are not `kept` (n,), each with the motion of the tool that would make it fit."""
    if np.all(kept):
        return ()
    placed = plain(scene.select_images(kept), begin.placed).placed
    (r, _, by_error), off = rows(scene, placed), scene.rms_by_image(residuals(scene, placed))
    named = []
    for i in np.flatnonzero(~kept):
        own = scene.image == i
        error = linalg.lstsq(by_error[own].reshape(-1, 6), r[own].ravel(), rcond=_UNSEEN)
        shift, turn = map(float, np.linalg.norm(error.reshape(2, 3), axis=1))
        named.append(OffImage(scene.names[i], float(off[i]), shift, turn))
    return tuple(sorted(named, key=lambda image: -image.rms_px))
