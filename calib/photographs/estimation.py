"""Camera, board and lens from photographs, by least squares over all points.

Points have equal weights, or weights by the errors that the points of an image share
(`calib.photographs.robot_errors`). Shared errors give differences within an image more weight than differences between
images. This is right if the robot errs, wrong if lens or board are not as modelled, and blind to errors of the robot
that follow the pose. So callers use such weights only if they predict left-out images better
(`calib.photographs.hand_eye`): each image in turn, by a fit of the others.

Why. An image of 24 corners has 48 rows, but its robot pose is wrong once. If the rows count as independent, intervals
(`calib.photographs.robot_errors`) are several times too narrow, and images near the board, where the robot's error is
many pixels, outweigh images far from it.

When it fails. Errors of the robot that follow the pose smoothly go into C and M, and no image of the same region shows
them, left out or not. Intervals allow for them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pinocchio as pin
import scipy

from calib.core.base.arrays import FloatArray, ReadOnlyArrays
from calib.core.base.errors import NotIdentifiableError
from calib.core.base.units import quantity_text
from calib.core.numerics import linalg
from calib.core.numerics.clusters import shifts_without_block
from calib.core.numerics.identifiability import extend_reduced, numerical_rank, unit_columns
from calib.core.numerics.least_squares import minimise
from calib.core.numerics.linear_model import LinearModel
from calib.core.numerics.tall import Span
from calib.photographs.robot_errors import ErrorSizes, ImageRows, arm_twists, intervals
from calib.photographs.scene import (
    POSES,
    BoardScene,
    HandEyePlacement,
    HandEyeUnknowns,
    plane_errors_on_board,
    residuals,
)

LITTLE_TURN = np.deg2rad(15)
"""Photographs hardly determine the camera's pose if rotations about the second axis spread less."""
_EVALUATIONS = 40
_TOLERANCE = 1e-16  # promised decrease that ends the iteration: the rest is a millionth of a standard deviation
_NOISE_ROUNDS = 3  # the noise decides only how wide priors count
_LEAST_NOISE = 1e-6  # px, of computed pixels
_WEIGHING_ROUNDS = 2
_DECIDES = 1.0 - 1e-9  # if an image decides more than this part of a direction, the others cannot predict it


@dataclass(frozen=True, eq=False)
class LeftOutImages(ReadOnlyArrays):
    """Left-out images: predicted minus detected pixels (m, 2) [px], and rays on the board minus points (m, 2) [m]."""

    pixels: FloatArray
    board: FloatArray


@dataclass(frozen=True, eq=False)
class HandEyeFit(ReadOnlyArrays):
    """A hand-eye fit.

    Attributes:
        scene: The images.
        placed: Poses of camera and board, and intrinsics.
        unknowns: What was fitted besides the poses.
        weights: Sizes of the errors by which images are weighted; pixels alone for equal weights.
    """

    scene: BoardScene
    placed: HandEyePlacement
    unknowns: HandEyeUnknowns
    weights: ErrorSizes

    @cached_property
    def rows(self) -> ImageRows:
        """Rows of the points around the solution."""
        return ImageRows.from_scene(self.scene, self.placed, self.unknowns)

    @cached_property
    def left_out(self) -> LeftOutImages:
        """Errors of each image against a fit of the others, as `left_out_errors` has them."""
        rows = self.rows
        pixels, by_board = left_out_errors(rows, self.weights), rows.pixels.jacobian[:, 6:8] / self.unknowns.scales[6:8]
        moved = np.linalg.solve(by_board.reshape(-1, 2, 2), (pixels - rows.pixels.residuals).reshape(-1, 2, 1))
        return LeftOutImages(pixels.reshape(-1, 2), plane_errors_on_board(self.scene, self.placed) - moved[:, :, 0])


@dataclass(frozen=True, eq=False)
class HandEyeEstimate(HandEyeFit):
    """A hand-eye fit with its uncertainty.

    Attributes:
        noise: Sizes of the errors; those of the arm count in the intervals alone.
        covariance: Covariance of [camera 6, board 6, intrinsics, (scale)], (k, k), in their own axes [m, rad, px, 1].
        freedom: Satterthwaite's degrees of freedom of each of them, (k,).
    """

    noise: ErrorSizes
    covariance: FloatArray
    freedom: FloatArray


def solve(scene: BoardScene, start: HandEyePlacement, unknowns: HandEyeUnknowns, noise: ErrorSizes) -> HandEyePlacement:
    """Return the minimum with the weights of these errors at the start."""
    begin, scales = ImageRows.from_scene(scene, start, unknowns), unknowns.scales

    def errors(x: FloatArray) -> FloatArray:
        placed = start.step(scales * x, unknowns)
        if np.any(placed.intrinsics[:2] <= 0) or placed.scale <= 0:
            return np.full(len(begin.image) + len(unknowns.free), np.nan)
        of_points = begin.whiten(noise, residuals(scene, placed).ravel())[0]
        return np.concatenate([of_points, unknowns.prior.times(begin.pixels.deviations + x)])

    def model(x: FloatArray) -> LinearModel:
        here = ImageRows.from_scene(scene, start.step(scales * x, unknowns), unknowns)
        for pose in (slice(6), slice(6, 12)):
            here.pixels.jacobian[:, pose] @= pin.Jexp6(pin.Motion(scales[pose] * x[pose]))
        return replace(here, levers=begin.levers).weigh(noise)

    end = minimise(errors, model, np.zeros(len(scales)), tolerance=_TOLERANCE, max_evaluations=_EVALUATIONS)
    return start.step(scales * end.x, unknowns)


def plain(scene: BoardScene, start: HandEyePlacement, unknowns: HandEyeUnknowns = POSES) -> HandEyeFit:
    """Return the least-squares solution with equal weights: the noise of its residuals, by which priors count.

    Raises:
        NotIdentifiableError: The images do not determine all unknowns.
    """
    placed, weights = start, ErrorSizes()
    for _ in range(_NOISE_ROUNDS):
        placed = solve(scene, placed, unknowns, weights)
        left = residuals(scene, placed)
        noise = float(np.sqrt(np.sum(left**2) / max(left.size - len(unknowns.scales), 1)))
        weights = ErrorSizes(max(noise, _LEAST_NOISE))
    fit = HandEyeFit(scene, placed, unknowns, weights)
    require_determined(fit.rows.weigh(weights), scene)
    return fit


def weigh_images(fit: HandEyeFit) -> HandEyeFit:
    """Return the fit with images weighted by the errors that their points share."""
    for _ in range(_WEIGHING_ROUNDS):
        weights = ErrorSizes.from_model(fit.rows.find_sizes())
        fit = replace(fit, placed=solve(fit.scene, fit.placed, fit.unknowns, weights), weights=weights)
    return fit


def estimate(fit: HandEyeFit) -> HandEyeEstimate:
    """Return a fit with its noise and uncertainty."""
    twists, scales = arm_twists(fit.scene.tool), fit.unknowns.scales
    at = fit.rows.find_sizes(twists)
    covariance, freedom = intervals(fit.rows, twists, fit.weights, at)
    known = fit.scene, fit.placed, fit.unknowns, fit.weights
    return HandEyeEstimate(*known, ErrorSizes.from_model(at), np.outer(scales, scales) * covariance, freedom)


def require_determined(model: LinearModel, scene: BoardScene) -> None:
    """Raise `NotIdentifiableError` unless all unknowns show in the rows and priors of a model."""
    rank = numerical_rank(unit_columns(extend_reduced(model.factor[:, :-1], model.prior.rows))[0])
    if rank.rank == rank.n_columns:
        return
    axes = turning(scene.tool)
    raise NotIdentifiableError(
        f"these {len(scene)} images do not determine where camera and board are: the tool turned by"
        f" {quantity_text(axes[0], 'deg', '.1f')} about its main axis and {quantity_text(axes[1], 'deg', '.1f')} about"
        " another one; turn it about two axes or more, by 20 deg or more"
    )


def turning(poses: FloatArray) -> FloatArray:
    """Return the spreads of rotations of poses (n, 4, 4) about three orthogonal axes, largest first, (3,) [rad].

    They are the same for poses of the tool and of the camera relative to the board: fixed transforms change only axes.
    """
    rotations = poses[:, :3, :3]
    middle = scipy.spatial.transform.Rotation.from_matrix(rotations).mean().as_matrix()
    turns = scipy.spatial.transform.Rotation.from_matrix(middle.T @ rotations).as_rotvec()
    return linalg.singular_values(turns)[:3] * 2 / np.sqrt(max(len(poses), 1)) if len(poses) > 2 else np.zeros(3)


def left_out_errors(rows: ImageRows, weights: ErrorSizes) -> FloatArray:
    """Return the pixel errors of each image against the linear fit of the others, (2 m,) [px].

    They are NaN where an image alone decides a direction, so that the others cannot predict it.
    """
    model, pixels = rows.weigh(weights), rows.pixels
    step, seen = model.step(), Span(pixels.jacobian, model.posterior_information.root)
    left = model.residuals + model.jacobian @ step
    moved, decided = shifts_without_block(model.span, rows.image, left, seen=seen, alone=_DECIDES)
    moved[decided[rows.image] >= _DECIDES] = np.nan
    return np.asarray(pixels.residuals + pixels.jacobian @ step + moved)


def rms(errors: FloatArray) -> float:
    """Return the root mean square length of the finite errors among (m, 2)."""
    squares = np.sum(errors**2, axis=1)
    known = np.isfinite(squares)
    return float(np.sqrt(np.mean(squares[known]))) if np.any(known) else float("nan")
