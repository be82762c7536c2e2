"""Hand-eye calibration from photographs, with a robot that is taken as it is: found, and judged by images left out.

Order of work: (1) where to begin (`calib.photographs.starts`); (2) points that lie far off where the others of their
image put them are left out, and images that lie far off where the other images put them are set aside, all by name;
(3) the lens: intrinsics as given, or found from the same images, whichever predicts images that are left out in turn
better; (4) every point alike or images weighed by what their points share (`calib.photographs.estimation`), by the same
rule; (5) what the camera alone leaves, the board placed freely in each image: the rest comes with the robot's poses;
(6) mistakes that would explain what is left (`calib.photographs.mistakes`).

"Better" is more than chance: with n images, n log(RMS / RMS) of those left out must gain more than 1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy

from calib.base.arrays import BoolArray, FloatArray, ReadOnlyArrays
from calib.base.errors import ComputationError, DataError, NotIdentifiableError
from calib.base.words import counted
from calib.instruments.camera import NAMES
from calib.photographs.estimation import Estimate, Noise, Prior, estimate, left_out, plain
from calib.photographs.mistakes import Mistake, find_mistakes
from calib.photographs.scene import Mount, Placed, Scene, linearised, on_board, residuals
from calib.photographs.starts import (
    LEAST_IMAGES,
    Start,
    camera_alone,
    image_rms,
    intrinsics_at_first,
    points_off,
    start,
)

LENSES = ("auto", "given", "found")
_GAIN = 1.0
_OFF = 5.0  # medians of images left out from which one is set aside
_LEAST_OFF = 1.0  # px
_MOST_OFF = 1 / 3  # of the images: more are no outliers
_FEWEST = 5  # images that must stay to call another one off
_LENS = ("fx", "fy", "cx", "cy", "k1", "k2")
_FOCAL, _MIDDLE, _RADIAL = 0.1, 0.05, 0.5  # how far off: of the focal length, of the width; k1 and k2


@dataclass(frozen=True, eq=False)
class LeftOut(ReadOnlyArrays):
    """Images predicted by the others.

    Attributes:
        pixels: Predicted minus found, (m, 2) [px].
        board: The same on the board, (m, 2) [m].
    """

    pixels: FloatArray
    board: FloatArray


@dataclass(frozen=True)
class OffPoint:
    """A point that does not fit the others of its image.

    Attributes:
        image: Name of the image.
        pixel: Where it was found [px].
        distance: How far from where the others put it [px].
    """

    image: str
    pixel: tuple[float, float]
    distance: float


@dataclass(frozen=True)
class OffImage:
    """An image that does not fit the others.

    Attributes:
        name: Of the image.
        rms: How far its points are off [px].
        shift, turn: By how much the robot's tool would have to be elsewhere [m], [rad].
    """

    name: str
    rms: float
    shift: float
    turn: float


@dataclass(frozen=True, eq=False)
class HandEye(ReadOnlyArrays):
    """A hand-eye calibration.

    Attributes:
        scene: The images that were used.
        fitted: What they say.
        left: The images left out in turn.
        alone: What the camera alone leaves, (m, 2) [px]; NaN where too few points were seen.
        off: Images that were set aside.
        points_off: Points of other images that were left out, furthest first.
        mistakes: What would explain what is left, largest first.
        intrinsics_given: As given, (9,); None where none were.
        rms_given: At images left out with intrinsics as given [px]; NaN where none were or not tried.
        weighed: Whether images were weighed.
    """

    scene: Scene
    fitted: Estimate
    left: LeftOut
    alone: FloatArray
    off: tuple[OffImage, ...]
    points_off: tuple[OffPoint, ...]
    mistakes: tuple[Mistake, ...]
    intrinsics_given: FloatArray | None
    rms_given: float
    weighed: bool

    @property
    def pixels(self) -> FloatArray:
        """Predicted minus found, (m, 2) [px]."""
        return residuals(self.scene, self.fitted.placed)

    @property
    def board(self) -> FloatArray:
        """How far pixels lie from their points on the board, (m, 2) [m]."""
        return on_board(self.scene, self.fitted.placed)

    @property
    def lens_found(self) -> bool:
        """Whether intrinsics were found."""
        return bool(self.fitted.free)

    def by_image(self, errors: FloatArray) -> FloatArray:
        """Return the root mean square of errors (m, 2) of each image, (n,)."""
        return np.sqrt(self.scene.sums(np.sum(errors**2, axis=1)) / self.scene.counts)

    @property
    def limit(self) -> float:
        """RMS error on the board that new images like these stay below with a chance of 95 % [m].

        From the mean of the mean squares of images left out, which has as many degrees of freedom as their spread says
        (Satterthwaite), but no more than there are errors: the points of an image share the robot's, which on the board
        is a shift, two numbers; the rest, which the camera alone leaves, is each point's own.

        Reference: satterthwaite1946.
        """
        squares = self.by_image(self.left.board) ** 2
        n, mean = len(squares), float(np.mean(squares))
        ratio = rms(self.alone) / rms(self.left.pixels)
        point_share = min(ratio**2, 1.0) if np.isfinite(ratio) else 0.0  # part of the squares
        most = 1.0 / ((1.0 - point_share) ** 2 / (2 * n) + point_share**2 / (2 * len(self.scene.pixels)))
        spread = float(np.var(squares, ddof=1)) / n
        freedom = min(most, 2 * mean**2 / spread) if spread > 0 else most
        return float(np.sqrt(mean * freedom / scipy.special.chdtri(freedom, 0.95)))

    def uncertainty(self) -> dict[str, tuple[float, float]]:
        """Return half widths of 95 % intervals of camera and board: along the worst axis, and about it [m], [rad]."""
        factor = scipy.special.stdtrit(self.fitted.freedom[:12], 0.975)
        half = factor * np.sqrt(np.diag(self.fitted.covariance)[:12])
        return {
            name: (float(np.max(half[k : k + 3])), float(np.max(half[k + 3 : k + 6])))
            for name, k in (("camera", 0), ("board", 6))
        }


def rms(errors: FloatArray) -> float:
    """Return the root mean square length of errors (m, 2), without those that are not known."""
    squares = np.sum(errors**2, axis=1)
    known = np.isfinite(squares)
    return float(np.sqrt(np.mean(squares[known]))) if np.any(known) else float("nan")


def calibrate(
    scene: Scene,
    intrinsics: FloatArray | None,
    *,
    lens: str = "auto",
    mounts: tuple[Mount, ...] = ("tool", "base"),
    progress: Callable[[int, int], None] | None = None,
) -> HandEye:
    """Return the hand-eye calibration of a camera.

    Args:
        scene: The images, in the order in which they were taken; its mount does not count.
        intrinsics: As given, (9,); None where nobody knows.
        lens: `given`: as they are; `found`: from the images; `auto`: whichever predicts images left out better.
        mounts: Where the camera may be.
        progress: Told after each of five steps.

    Raises:
        DataError: Too few images.
        NotIdentifiableError: They do not determine what is sought.
        NotConvergedError: The noise was not found.
    """
    tell = progress or (lambda done, total: None)
    if lens == "given" and intrinsics is None:
        raise DataError("intrinsics are to stay as given, and none are; give --camera FILE")
    scene = _in_order_of_content(scene)
    first = intrinsics_at_first(scene) if intrinsics is None else intrinsics
    begin, points = _without_points_off(start(scene, first, mounts=mounts), first)
    tell(1, 5)
    sure = begin.scene
    kept, begin = _without_off(sure, begin, intrinsics, lens)
    off = _named_off(sure, kept, begin)
    kept_scene = sure.only(kept)
    tell(2, 5)
    prior = _prior(first, kept_scene, intrinsics is not None)
    choices = _lenses(kept_scene, begin.placed, prior, intrinsics, lens)
    chosen = choices[0]
    better = chosen
    for other in choices[1:]:
        if _gain(better.left, other.left, len(kept_scene)) > _GAIN:
            better = other
    chosen = choices[0] if lens == "given" else better
    rms_given = float("nan") if choices[0].free else rms(choices[0].left.pixels)
    tell(3, 5)
    fitted, left = estimate(kept_scene, chosen.placed, chosen.free, chosen.prior), chosen.left
    used, weighed = chosen.prior, False
    if fitted.noise.shift > 0 or fitted.noise.turn > 0:
        try:
            other_fitted = estimate(kept_scene, fitted.placed, fitted.free, used, weighed=True, near=fitted.noise)
            other_left = _left(kept_scene, other_fitted.placed, other_fitted.free, other_fitted.weights, used)
            if _gain(left, other_left, len(kept_scene)) > _GAIN:
                fitted, left, weighed = other_fitted, other_left, True
        except ComputationError:
            pass  # weights that cannot be found are not used
    tell(4, 5)
    alone, _ = camera_alone(kept_scene, fitted.placed.intrinsics, fitted.free)
    of_lens = fitted if better is chosen else estimate(kept_scene, better.placed, better.free, better.prior)
    mistakes = find_mistakes(sure, kept_scene, fitted, used, intrinsics, first, of_lens)
    tell(5, 5)
    points = tuple(point for point in points if point.image in kept_scene.names)
    return HandEye(kept_scene, fitted, left, alone, off, points, mistakes, intrinsics, rms_given, weighed)


def _in_order_of_content(scene: Scene) -> Scene:
    """The same images, their points in one order whatever the file has, so that sums are the same to the last digit."""
    order = np.lexsort((scene.pixels[:, 1], scene.pixels[:, 0], scene.image))
    return replace(scene, image=scene.image[order], body=scene.body[order], pixels=scene.pixels[order])


def _gain(before: LeftOut, after: LeftOut, n: int) -> float:
    return float(n * np.log(rms(before.pixels) / rms(after.pixels)))


def _left(scene: Scene, placed: Placed, free: tuple[int, ...], weights: Noise, prior: Prior | None) -> LeftOut:
    pixels, board = np.zeros_like(scene.pixels), np.zeros_like(scene.pixels)
    for i, without in enumerate(left_out(scene, placed, free, weights, prior)):
        in_image = scene.image == i
        part = scene.only(np.arange(len(scene)) == i)
        pixels[in_image], board[in_image] = residuals(part, without), on_board(part, without)
    return LeftOut(pixels, board)


def _prior(first: FloatArray, scene: Scene, given: bool) -> Prior:
    """What is expected of a lens: as wide as a mistake may be, so that images decide where they can."""
    numbers = [NAMES.index(name) for name in _LENS]
    width = float(max(scene.size))
    focal = (_FOCAL if given else 1.0) * first[0]
    sigma = np.array([focal, focal, _MIDDLE * width, _MIDDLE * width, _RADIAL, _RADIAL])
    return Prior(first[numbers], sigma)


@dataclass(frozen=True, eq=False)
class _Choice:
    """One way to take the lens, by plain least squares."""

    placed: Placed
    free: tuple[int, ...]
    prior: Prior | None
    left: LeftOut


def _lenses(scene: Scene, begin: Placed, prior: Prior, intrinsics: FloatArray | None, lens: str) -> list[_Choice]:
    """Ways to take the lens: as given first; found, without distortion only where none is given, and with it."""
    result: list[_Choice] = []
    if intrinsics is not None and lens != "found":
        placed, weights = plain(scene, begin, ())
        result.append(_Choice(placed, (), None, _left(scene, placed, (), weights, None)))
    for count in (6,) if intrinsics is not None else (4, 6):
        free = tuple(NAMES.index(name) for name in _LENS[:count])
        part = Prior(prior.values[:count], prior.sigma[:count])
        try:
            placed, weights = plain(scene, begin, free, part)
        except (ComputationError, np.linalg.LinAlgError):
            continue
        result.append(_Choice(placed, free, part, _left(scene, placed, free, weights, part)))
    if not result:
        plain(scene, begin, ())  # says what the images do not determine
        raise NotIdentifiableError("the photographs do not determine the lens; give intrinsics (--camera FILE)")
    return result


def _without_points_off(begin: Start, intrinsics: FloatArray) -> tuple[Start, tuple[OffPoint, ...]]:
    """Where to begin without points that do not fit their image, and these, furthest first."""
    scene = begin.scene
    far = points_off(scene, intrinsics, tuple(NAMES.index(name) for name in _LENS))
    off = [
        OffPoint(scene.names[scene.image[k]], (float(scene.pixels[k, 0]), float(scene.pixels[k, 1])), float(far[k]))
        for k in np.argsort(-far, kind="stable")[: np.count_nonzero(far)]
    ]
    kept = scene.of_points(far == 0) if off else scene
    return Start(kept, begin.placed, image_rms(kept, begin.placed) if off else begin.rms), tuple(off)


def _without_off(scene: Scene, begin: Start, intrinsics: FloatArray | None, lens: str) -> tuple[BoolArray, Start]:
    """Which images fit the others, (n,), and where these begin."""
    kept = np.ones(len(scene), dtype=bool)
    free = () if lens == "given" else tuple(NAMES.index(name) for name in _LENS)
    most = int(_MOST_OFF * len(scene))
    candidates = np.argsort(-begin.rms)[: most + 1]
    trial = kept.copy()
    trial[[i for i in candidates if begin.rms[i] > 3 * begin.typical][:most]] = False
    if np.sum(trial) < _FEWEST:
        return kept, begin
    for _ in range(3):
        errors = _foretold(scene, trial, begin.placed, free, intrinsics)
        if errors is None:
            return kept, begin
        level = max(_OFF * float(np.median(errors[trial])), _LEAST_OFF)
        now = errors <= level
        if np.sum(now) < max(_FEWEST, len(scene) - most):
            return kept, begin
        if np.array_equal(now, trial):
            break
        trial = now
    return trial, begin


def _foretold(
    scene: Scene, kept: BoolArray, begin: Placed, free: tuple[int, ...], intrinsics: FloatArray | None
) -> FloatArray | None:
    """How far off each image is from where the kept ones put it, itself aside, (n,) [px]; None if that is not known."""
    kept_scene = scene.only(kept)
    prior = _prior(begin.intrinsics, kept_scene, intrinsics is not None) if free else None
    try:
        placed, weights = plain(kept_scene, begin, free, prior)
    except ComputationError:
        return None
    result = np.zeros(len(scene))
    left = _left(kept_scene, placed, free, weights, prior)
    result[kept] = np.sqrt(kept_scene.sums(np.sum(left.pixels**2, axis=1)) / kept_scene.counts)
    for i in np.flatnonzero(~kept):
        part = scene.only(np.arange(len(scene)) == i)
        result[i] = rms(residuals(part, placed))
    return result


def _named_off(scene: Scene, kept: BoolArray, begin: Start) -> tuple[OffImage, ...]:
    """Images that are set aside, and by how much the robot would have to be elsewhere."""
    if np.all(kept):
        return ()
    placed, _ = plain(scene.only(kept), begin.placed, ())
    named = []
    for i in np.flatnonzero(~kept):
        part = scene.only(np.arange(len(scene)) == i)
        linear = linearised(part, placed, ())
        error = -np.linalg.lstsq(linear.gg[0], linear.gr[0], rcond=1e-9)[0]
        named.append(
            OffImage(
                scene.names[i],
                rms(residuals(part, placed)),
                float(np.linalg.norm(error[:3])),
                float(np.linalg.norm(error[3:])),
            )
        )
    return tuple(sorted(named, key=lambda image: -image.rms))


def require_images(count: int) -> None:
    """Raise `DataError` unless there are enough images with a board and a pose."""
    if count < LEAST_IMAGES:
        raise DataError(
            f"{counted(count, 'image')} with a board and a pose of the robot; it takes {LEAST_IMAGES}, and 10 to 20 are"
            " sensible"
        )
