"""Result of a hand-eye calibration, and the errors that it predicts for new images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray, ReadOnlyArrays
from calib.core.base.contributions import Contribution, Contributions, Uncertainty
from calib.photographs.estimation import HandEyeEstimate, LeftOutImages, rms
from calib.photographs.images_off import OffImage, OffPoint
from calib.photographs.mistakes import Mistake
from calib.photographs.scene import BoardScene, plane_errors_on_board, points_in_camera, residuals


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

    def rms_by_image(self, errors: FloatArray) -> FloatArray:
        """Return the root mean square of errors (m, 2) of each image, (n,)."""
        return self.scene.rms_by_image(errors)

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
        squares = self.rms_by_image(self.left_out.board) ** 2
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
