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
from dataclasses import dataclass, replace

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray, ReadOnlyArrays
from calib.core.base.contributions import Contribution, Contributions, Uncertainty
from calib.core.base.errors import ComputationError, DataError
from calib.core.base.threads import one_blas_thread
from calib.core.base.words import count_noun
from calib.photographs.camera_alone import LEAST_IMAGES, camera_alone, intrinsics_at_first
from calib.photographs.choices import (
    OffImage,
    OffPoint,
    fitting_images,
    fitting_points,
    images_far_off,
    lens_choices,
    unlikely,
)
from calib.photographs.estimation import HandEyeEstimate, HandEyeFit, LeftOutImages, estimate, rms, weigh_images
from calib.photographs.mistakes import Mistake, find_mistakes
from calib.photographs.scene import BoardScene, Mount, plane_errors_on_board, points_in_camera, residuals
from calib.photographs.starts import Start, start

_GAIN = 1.5
_ROUNDING = 1e-6  # px, of computed photographs


@dataclass(frozen=True, eq=False)
class HandEye(ReadOnlyArrays):
    """A hand-eye calibration.

    Attributes:
        scene: The images used.
        fitted: Estimate from these images.
        left_out: Errors of left-out images.
        residuals_without_robot: Residuals of a fit without the robot, (m, 2) [px]; NaN in images with too few points.
        outlying_images: Unused outlying images.
        points_off: Unused outlying points of other images, furthest first.
        mistakes: Mistakes that would explain the residuals, largest first.
        intrinsics_given: Intrinsics of the user, (9,), or None.
        rms_given: RMS error of left-out images with the user's intrinsics [px]; NaN if not computed.
        weighed: Whether images had different weights.
    """

    scene: BoardScene
    fitted: HandEyeEstimate
    left_out: LeftOutImages
    residuals_without_robot: FloatArray
    outlying_images: tuple[OffImage, ...]
    points_off: tuple[OffPoint, ...]
    mistakes: tuple[Mistake, ...]
    intrinsics_given: FloatArray | None
    rms_given: float
    weighed: bool

    @property
    def contains(self) -> dict[Uncertainty, Contributions]:
        """Contributions to the intervals of camera and board, and to `limit`."""
        of_poses = frozenset({Contribution.NOISE, Contribution.SCATTER, Contribution.JOINT_ERRORS})
        return {Uncertainty.POSITION: of_poses, Uncertainty.CLAIM: frozenset({Contribution.LEFT_OUT})}

    @property
    def pixels(self) -> FloatArray:
        """Predicted minus detected pixels, (m, 2) [px]."""
        return residuals(self.scene, self.fitted.placed)

    @property
    def board(self) -> FloatArray:
        """Residuals on the board: intersections of the pixels' rays with its plane minus its points, (m, 2) [m]."""
        return plane_errors_on_board(self.scene, self.fitted.placed)

    @property
    def lens_found(self) -> bool:
        """Whether intrinsics were fitted."""
        return bool(self.fitted.unknowns.free)

    @property
    def distance(self) -> float:
        """Mean distance from the camera to the detected points [m]."""
        return float(np.mean(np.linalg.norm(points_in_camera(self.scene, self.fitted.placed)[0], axis=1)))

    @property
    def limit(self) -> float:
        """Limit of the RMS error on the board that holds for as many new images like these in 95 of 100 cases [m].

        Each image is left out once. The degrees of freedom of their mean square follow from the spread (Satterthwaite),
        but are no more than the number of independent errors. The points of an image share the error of the robot,
        which counts as one; each point also has its own error, as large as in a fit without the robot. On the board
        the robot's error is a shift of two numbers. It counts as one because the fits without one image are almost the
        same and share their errors: if it counted as two, 7 in 100 simulated calibrations would exceed the limit. The
        mean of as many new images has the same degrees of freedom, and the ratio of both means follows F.

        Reference: satterthwaite1946.
        """
        squares = self.scene.rms_by_image(self.left_out.board) ** 2
        n, mean = len(squares), float(np.mean(squares))
        if not np.isfinite(mean):  # a ray does not meet the plane of the board
            return float("nan")
        ratio = rms(self.residuals_without_robot) / rms(self.left_out.pixels)
        point_share = min(ratio**2, 1.0) if np.isfinite(ratio) else 0.0  # part of the squares that is each point's own
        most = 1.0 / ((1.0 - point_share) ** 2 / n + point_share**2 / (2 * len(self.scene.pixels)))
        spread = float(np.var(squares, ddof=1)) / n
        freedom = min(most, 2 * mean**2 / spread) if spread > 0 else most
        return float(np.sqrt(mean * scipy.special.fdtri(freedom, freedom, 0.95)))

    def uncertainty(self) -> dict[str, tuple[float, float]]:
        """Return half widths of 95 % intervals of camera and board, each the largest of three axes: [m] and [rad]."""
        factor = scipy.special.stdtrit(self.fitted.freedom[:12], 0.975)
        half = factor * np.sqrt(np.diag(self.fitted.covariance)[:12])
        return {
            name: (float(np.max(half[k : k + 3])), float(np.max(half[k + 3 : k + 6])))
            for name, k in (("camera", 0), ("board", 6))
        }


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
    order = np.lexsort(
        (scene.pixels[:, 1], scene.pixels[:, 0], scene.image)
    )  # so that sums are equal to the last digit
    scene = replace(scene, image=scene.image[order], body=scene.body[order], pixels=scene.pixels[order])
    first, begin = _first_start(scene, intrinsics, mounts)
    begin, points = fitting_points(begin, first)
    tell(1, 5)
    kept = fitting_images(begin, intrinsics, lens)
    off, kept_scene = images_far_off(begin, kept), begin.scene.select_images(kept)
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
    mistakes = find_mistakes(begin.scene, fitted, intrinsics, first, of_lens, mounts)
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
