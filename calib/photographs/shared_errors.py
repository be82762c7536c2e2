"""Rows of photographs, and the sizes of the errors that the points of an image share.

Residuals of image i, to first order, are

    r_i = J_i x + G_i (e_i + N_i k) + noise        noise ~ N(0, s^2)
                                                   e_i ~ N(0, diag(s_t^2 s_t^2 s_t^2 s_r^2 s_r^2 s_r^2))
                                                   k ~ N(0, s_a^2)

with x the unknowns, e_i an error of the robot's tool at this image, and k errors of the arm, which are the same at all
images (`calib.photographs.intervals`). The columns of G for shifts and for turns of the tool, each image with its own,
and the columns G N are three families of columns of a mixed model. So the four sizes come from its restricted
likelihood (`calib.core.numerics.mixed_model`), with the priors of `calib.core.numerics.size_search` around 1 mm and
1 mrad. The points of an image enter by the triangular factor of [G_i J_i r_i]. Its rows below the sixth do not contain
G; those of all images are reduced together.

Weights of images are the inverse of V_i = s^2 I + G_i diag(s_t^2 s_t^2 s_t^2 s_r^2 s_r^2 s_r^2) G_i^T.

When it fails. Sizes of several mm or mrad from few images are found up to a fifth too small, as their prior expects
less.

Reference: patterson1971; gelman2006.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray, IntArray, ReadOnlyArrays
from calib.core.numerics.identifiability import reduce_rows
from calib.core.numerics.linear_model import LinearModel, RowGroups
from calib.core.numerics.mixed_model import MixedModel, SolvedModel
from calib.core.numerics.mixed_rows import MixedRows, whiten_scatter
from calib.core.numerics.prior import Prior
from calib.core.numerics.size_search import likeliest_sizes
from calib.photographs.scene import POSES, BoardScene, HandEyePlacement, HandEyeUnknowns, rows

EXPECTED = 1e-3
"""Expected errors of the robot, around which their sizes have a wide prior [m, rad]."""
_GAIN = 1e-7  # least fall of the cost for which the search of the sizes continues


@dataclass(frozen=True)
class ErrorSizes:
    """Sizes (sigmas) of the errors.

    Attributes:
        pixel: Error of a pixel coordinate [px].
        shift, turn: Error of the robot's tool per axis [m], [rad].
        arm: Error of each length [m] and angle [rad] of the arm; zero if not considered.
    """

    pixel: float = 1.0
    shift: float = 0.0
    turn: float = 0.0
    arm: float = 0.0

    @staticmethod
    def from_model(at: SolvedModel) -> ErrorSizes:
        """Return the sizes of `ImageRows.find_sizes`."""
        robot, pixel, _ = at.model.sizes(at.logs)
        return ErrorSizes(float(pixel[0]), *map(float, EXPECTED * robot))


@dataclass(frozen=True, eq=False)
class ImageRows(ReadOnlyArrays):
    """Pixels of a scene around a placement, by scaled unknowns (`HandEyeUnknowns.scales`) and errors of the tool.

    Attributes:
        pixels: Residuals (2 m,) [px], J (2 m, k), and the prior.
        levers: G, (2 m, 6).
        image: Image of each row, (2 m,).
    """

    pixels: LinearModel
    levers: FloatArray
    image: IntArray

    @staticmethod
    def from_scene(scene: BoardScene, placed: HandEyePlacement, unknowns: HandEyeUnknowns = POSES) -> ImageRows:
        """Return the rows of the points of a scene."""
        r, j, g = rows(scene, placed, unknowns)
        scales, deviations = unknowns.scales, np.zeros(j.shape[2])
        deviations[unknowns.lens] = (placed.intrinsics[list(unknowns.free)] - unknowns.expected) / unknowns.sigma
        pixels = LinearModel(r.ravel(), j.reshape(r.size, -1) * scales, unknowns.prior, deviations)
        return ImageRows(pixels, g.reshape(r.size, 6), np.repeat(scene.image, 2))

    def whiten(self, noise: ErrorSizes, *arrays: FloatArray) -> list[FloatArray]:
        """Return V^-1/2 times arrays of rows, (2 m, ...), by the errors of pixels and tool."""
        levers = self.levers * np.repeat([noise.shift, noise.turn], 3) / noise.pixel
        return [array / noise.pixel for array in whiten_scatter(levers, self.image, *arrays)]

    def weigh(self, noise: ErrorSizes) -> LinearModel:
        """Return the rows with the weights of these errors."""
        residuals, jacobian = self.whiten(noise, self.pixels.residuals, self.pixels.jacobian)
        return replace(self.pixels, residuals=residuals, jacobian=jacobian)

    def with_columns(self, columns: FloatArray) -> ImageRows:
        """Return the rows with further columns of J without a prior, (2 m, c)."""
        none, known = np.zeros(columns.shape[1]), self.pixels
        jacobian, prior = np.hstack([known.jacobian, columns]), Prior(np.append(known.prior.has, none > 0))
        wide = replace(known, jacobian=jacobian, prior=prior, deviations=np.append(known.deviations, none))
        return replace(self, pixels=wide)

    def find_sizes(self, twists: FloatArray | None = None) -> SolvedModel:
        """Return the mixed model with the likeliest sizes of the errors, those of pixels last.

        Args:
            twists: Motions N of the tool by each error of the arm, (n, 6, n_arm); no such errors if not given.
        """
        known, n = self.pixels, int(self.image[-1]) + 1
        every, ends = np.hstack([self.levers, known.jacobian]), np.searchsorted(self.image, np.arange(n + 1))
        parts = [reduce_rows(every[a:b], known.residuals[a:b]) for a, b in pairwise(ends)]
        upper, lower = [part[:6] for part in parts], reduce_rows(np.vstack([part[6:, 6:] for part in parts]))
        robot = [scipy.linalg.block_diag(*[part[:, of] for part in upper]) for of in (slice(3), slice(3, 6))]
        if twists is not None:
            robot.append(np.vstack([part[:, :6] @ twist for part, twist in zip(upper, twists, strict=True)]))
        by_errors = np.pad(EXPECTED * np.hstack(robot), ((0, len(lower)), (0, 0)))
        right = np.vstack([part[:, 6:] for part in upper] + [lower])
        family = np.repeat(np.arange(-1, len(robot)), [known.jacobian.shape[1], *(part.shape[1] for part in robot)])
        model = LinearModel(
            right[:, -1],
            np.hstack([right[:, :-1], by_errors]),
            Prior(np.append(known.prior.has, np.ones(by_errors.shape[1], dtype=bool))),
            np.append(known.deviations, np.zeros(by_errors.shape[1])),
            RowGroups(np.zeros(len(right), dtype=np.intp), np.array([len(self.image)])),
        )
        found, none = np.zeros(1, dtype=bool), np.zeros((len(right), 0))
        mixed = MixedRows.from_linear_problem(model, family, found, np.arange(len(right)), none)
        return likeliest_sizes(MixedModel.from_rows(mixed), least_gain=_GAIN)
