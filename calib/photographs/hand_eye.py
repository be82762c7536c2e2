"""What a hand-eye calibration has found, and what it promises for new images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray, ReadOnlyArrays
from calib.photographs.estimation import HandEyeEstimate
from calib.photographs.images_off import OffImage, OffPoint
from calib.photographs.left_out_images import LeftOutImages, rms
from calib.photographs.mistakes import Mistake
from calib.photographs.scene import BoardScene, plane_errors_on_board, points_in_camera, residuals


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

    scene: BoardScene
    fitted: HandEyeEstimate
    left: LeftOutImages
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
        return plane_errors_on_board(self.scene, self.fitted.placed)

    @property
    def lens_found(self) -> bool:
        """Whether intrinsics were found."""
        return bool(self.fitted.free)

    def rms_by_image(self, errors: FloatArray) -> FloatArray:
        """Return the root mean square of errors (m, 2) of each image, (n,)."""
        return np.sqrt(self.scene.sums(np.sum(errors**2, axis=1)) / self.scene.counts)

    @property
    def distance(self) -> float:
        """Mean distance from the camera to the points that it saw [m]."""
        return float(np.mean(np.linalg.norm(points_in_camera(self.scene, self.fitted.placed)[0], axis=1)))

    @property
    def limit(self) -> float:
        """RMS error on the board that as many new images like these stay below with a chance of 95 % [m].

        The mean of the mean squares of images left out has as many degrees of freedom as their spread says
        (Satterthwaite), but no more than there are errors: the points of an image share the robot's, which counts as
        one; the rest, which the camera alone leaves, is each point's own. On the board the robot's error is a shift of
        two numbers, but images left out also share the errors of a fit that is almost the same: in simulated set-ups
        two numbers an image would be exceeded by 7 in 100. The mean of as many new images has as many degrees of
        freedom, and their ratio follows F.

        Reference: satterthwaite1946.
        """
        squares = self.rms_by_image(self.left.board) ** 2
        n, mean = len(squares), float(np.mean(squares))
        if not np.isfinite(mean):  # a ray that does not meet the plane of the board
            return float("nan")
        ratio = rms(self.alone) / rms(self.left.pixels)
        point_share = min(ratio**2, 1.0) if np.isfinite(ratio) else 0.0  # part of the squares
        most = 1.0 / ((1.0 - point_share) ** 2 / n + point_share**2 / (2 * len(self.scene.pixels)))
        spread = float(np.var(squares, ddof=1)) / n
        freedom = min(most, 2 * mean**2 / spread) if spread > 0 else most
        return float(np.sqrt(mean * scipy.special.fdtri(freedom, freedom, 0.95)))

    def uncertainty(self) -> dict[str, tuple[float, float]]:
        """Return half widths of 95 % intervals of camera and board: along the worst axis, and about it [m], [rad]."""
        factor = scipy.special.stdtrit(self.fitted.freedom[:12], 0.975)
        half = factor * np.sqrt(np.diag(self.fitted.covariance)[:12])
        return {
            name: (float(np.max(half[k : k + 3])), float(np.max(half[k + 3 : k + 6])))
            for name, k in (("camera", 0), ("board", 6))
        }
