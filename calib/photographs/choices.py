"""What a hand-eye calibration uses: points and images that fit the others, and choices for the lens.

A point is left out if the other points of its image predict it elsewhere. An image is left out if its distance from the
prediction of the other images is larger than any error of a robot. At most a third of the images are left out, because
more cannot be outliers.

Left-out images show distortion badly, because the robot's errors are larger. Single images with a freely placed board
show it well. If two numbers of distortion explain more of their residuals than chance does (an F test), a lens without
distortion is no choice.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
import scipy

from calib.core.base.arrays import BoolArray, FloatArray
from calib.core.base.errors import ComputationError, NotIdentifiableError
from calib.core.instruments.camera import NAMES
from calib.core.numerics import linalg
from calib.core.numerics.chances import FALSE_ALARM
from calib.photographs.camera_alone import camera_alone, point_errors
from calib.photographs.estimation import HandEyeFit, plain
from calib.photographs.scene import POSES, BoardScene, HandEyePlacement, HandEyeUnknowns, residuals, rows
from calib.photographs.starts import Start

LENSES = ("auto", "given", "found")
LENS_NUMBERS = tuple(NAMES.index(name) for name in ("fx", "fy", "cx", "cy", "k1", "k2"))
_OFF = 5.0  # an image is left out if its error is more than this many times the median
_LEAST_OFF = 1.0  # smaller errors are always allowed [px]
_MOST_OFF = 1 / 3  # largest part of the images that is left out
_UNSEEN = 3e-5  # an image does not show a motion of the tool with a smaller relative singular value
_FEWEST = 5  # images that must stay if another is left out
_FOCAL, _MIDDLE, _RADIAL = 0.1, 0.05, 0.5  # prior sigmas: parts of the focal length and of the width; k1 and k2
_FROM_MIDDLE = 0.12  # largest distance of a principal point from the middle of the image, as part of its width
_MOST_ASPECT = 1.25  # largest ratio of fx and fy


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


def fitting_images(begin: Start, intrinsics: FloatArray | None, lens: str) -> BoolArray:
    """Return the mask of the images that fit the others, (n,)."""
    scene = begin.scene
    n, most = len(scene), int(_MOST_OFF * len(scene))
    fewest = max(_FEWEST, n - most)
    every: BoolArray = np.ones(n, dtype=bool)
    unknowns = POSES if lens == "given" else free_lens(begin.placed.intrinsics, scene, intrinsics is not None)

    def errors_without(kept: BoolArray) -> FloatArray | None:
        """RMS error of each image against the fit of the other kept ones, (n,) [px]; None without such a fit."""
        try:
            fit = plain(scene.select_images(kept), begin.placed, unknowns)
        except ComputationError:
            return None
        result = scene.rms_by_image(residuals(scene, fit.placed))
        result[kept] = fit.scene.rms_by_image(fit.left_out.pixels)
        return result

    candidates = np.argsort(-begin.rms)[: most + 1]
    trial = ~np.isin(np.arange(n), [i for i in candidates if begin.rms[i] > 3 * begin.typical][:most])
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
        without = trial & (np.arange(n) != furthest)
        errors = errors_without(without)
        if errors is None or not errors[furthest] > _limit(errors[without]):
            break
        trial = without
    return trial


def _limit(errors: FloatArray) -> float:
    """Error above which an image does not fit others with these errors [px]."""
    return max(_OFF * float(np.median(errors)), _LEAST_OFF)


def images_far_off(begin: Start, kept: BoolArray) -> tuple[OffImage, ...]:
    """Return the images that are not `kept` (n,), each with the motion of the tool that would make it fit."""
    if np.all(kept):
        return ()
    scene = begin.scene
    placed = plain(scene.select_images(kept), begin.placed).placed
    r, _, by_error = rows(scene, placed)
    off, named = scene.rms_by_image(r), []
    for i in np.flatnonzero(~kept):
        own = scene.image == i
        error = linalg.lstsq(by_error[own].reshape(-1, 6), r[own].ravel(), rcond=_UNSEEN)
        shift, turn = map(float, np.linalg.norm(error.reshape(2, 3), axis=1))
        named.append(OffImage(scene.names[i], float(off[i]), shift, turn))
    return tuple(sorted(named, key=lambda image: -image.rms_px))


def unlikely(given: FloatArray, size: tuple[int, int]) -> list[tuple[str, str]]:
    """Return reasons (code, words) why given intrinsics, (9,), fit no lens for images of a size."""
    width, height = size
    middle, result = np.array([(width - 1) / 2, (height - 1) / 2]), []
    away = float(np.max(np.abs(given[2:4] - middle)))
    if away > _FROM_MIDDLE * max(width, height):
        exchanged = float(np.max(np.abs(given[3:1:-1] - middle))) < away / 2
        text = (
            f"the principal point given, {given[2]:.0f}, {given[3]:.0f} px, is far from the middle of images of {width}"
            f" x {height} px: {'cx and cy are exchanged' if exchanged else 'the intrinsics are of another image'}, or"
            " the images were turned, cut or scaled since"
        )
        result.append(("principal_point", text))
    if not 1 / _MOST_ASPECT < given[0] / given[1] < _MOST_ASPECT:
        text = f"fx and fy as given differ ({given[0]:.0f} and {given[1]:.0f} px): one of them is wrong"
        result.append(("focal", text))
    return result


def free_lens(first: FloatArray, scene: BoardScene, given: bool, count: int = len(LENS_NUMBERS)) -> HandEyeUnknowns:
    """Return `count` numbers of the lens as unknowns, expected near first intrinsics, (9,).

    Their prior is so wide that images decide where they can.
    """
    width = float(max(scene.size))
    focal = (_FOCAL if given else 1.0) * first[0]
    sigma = np.array([focal, focal, _MIDDLE * width, _MIDDLE * width, _RADIAL, _RADIAL])
    free = LENS_NUMBERS[:count]
    return HandEyeUnknowns(free, first[list(free)], sigma[:count])


def lens_choices(
    scene: BoardScene, begin: HandEyePlacement, first: FloatArray, intrinsics: FloatArray | None, lens: str
) -> list[HandEyeFit]:
    """Return fits of choices for the lens: intrinsics (9,) as given, then with distortion from `first` ones, (9,).

    A fit without distortion is a choice too if no lens is given and single images show no distortion.

    Raises:
        NotIdentifiableError: The images do not determine the lens of any choice.
    """
    result: list[HandEyeFit] = []
    if intrinsics is not None and lens != "found":
        result.append(plain(scene, replace(begin, intrinsics=intrinsics), POSES))
    for count in (6,) if intrinsics is not None or _is_distorted(scene, begin.intrinsics) else (4, 6):
        with suppress(ComputationError, np.linalg.LinAlgError):
            result.append(plain(scene, begin, free_lens(first, scene, first is intrinsics, count)))
    if not result:
        plain(scene, begin)  # raises an error that names the undetermined unknowns
        raise NotIdentifiableError("the photographs do not determine the lens; give intrinsics (--camera FILE)")
    return result


def _is_distorted(scene: BoardScene, first: FloatArray) -> bool:
    """Whether single images show more distortion than chance does; `first` are first intrinsics, (9,)."""
    squares = []
    for count in (4, 6):
        lengths = np.sum(camera_alone(scene, first, LENS_NUMBERS[:count]) ** 2, axis=1)
        known = np.isfinite(lengths)
        squares.append(float(np.sum(lengths[known])))
    freedom = 2 * np.count_nonzero(known) - 6 * len(np.unique(scene.image[known])) - 6
    if not (freedom > 0 and squares[1] > 0):
        return False
    ratio = (squares[0] - squares[1]) / 2 / (squares[1] / freedom)
    return bool(scipy.special.fdtrc(2, freedom, max(ratio, 0.0)) < FALSE_ALARM)
