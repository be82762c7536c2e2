"""Camera, board and lens from photographs, by least squares over all points.

Points have equal weights, or weights by the errors that the points of an image share
(`calib.photographs.shared_errors`). Shared errors give differences within an image more weight than differences between
images. This is right if the robot errs, wrong if lens or board are not as modelled, and blind to errors of the robot
that follow the pose. So callers use such weights only if they predict left-out images better
(`calib.photographs.hand_eye_calibration`): each image in turn, by a fit of the others.

Why. An image of 24 corners has 48 rows, but its robot pose is wrong once. If the rows count as independent, intervals
(`calib.photographs.intervals`) are several times too narrow, and images near the board, where the robot's error is
many pixels, outweigh images far from it.

When it fails. Errors of the robot that follow the pose smoothly go into C and M, and no image of the same region shows
them, left out or not. Intervals allow for them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray, ReadOnlyArrays
from calib.core.base.errors import NotConvergedError, NotIdentifiableError
from calib.core.base.units import quantity_text
from calib.core.numerics import linalg
from calib.photographs.intervals import arm_twists, intervals
from calib.photographs.scene import (
    POSES,
    BoardScene,
    HandEyePlacement,
    HandEyeUnknowns,
    linearise,
    plane_errors_on_board,
    residuals,
)
from calib.photographs.shared_errors import ErrorSizes, find_noise, normal_equations

LITTLE_TURN = np.deg2rad(15)
"""Photographs hardly determine the camera's pose if rotations about the second axis spread less."""
_STEPS = 40
_ENDS = 1e-13  # rounding dominates smaller steps
_NOISE_ROUNDS = 12
_NOISE_CONVERGED = 1e-8
_SINGULAR = 1e-7  # images do not show a direction with a smaller relative singular value of scaled columns


@dataclass(frozen=True, eq=False)
class HandEyeEstimate(ReadOnlyArrays):
    """A hand-eye fit.

    Attributes:
        placed: Poses of camera and board, and intrinsics.
        unknowns: What was fitted besides the poses.
        noise: Sizes of the errors; those of the arm count in the intervals alone.
        weights: Sizes of the errors by which images are weighted; pixels alone for equal weights.
        covariance: Covariance of [camera 6, board 6, intrinsics, (scale)], (k, k), in their own axes [m, rad, px, 1].
        freedom: Satterthwaite's degrees of freedom of each of them, (k,).
    """

    placed: HandEyePlacement
    unknowns: HandEyeUnknowns
    noise: ErrorSizes
    weights: ErrorSizes
    covariance: FloatArray
    freedom: FloatArray


def solve(
    scene: BoardScene, start: HandEyePlacement, unknowns: HandEyeUnknowns, noise: ErrorSizes, steps: int = _STEPS
) -> HandEyePlacement:
    """Return the minimum by damped Gauss-Newton steps at fixed noise."""
    placed, damping, last = start, 0.0, np.inf
    a, b, cost = normal_equations(linearise(scene, placed, unknowns), noise)
    for _ in range(steps):
        scale = 1.0 / np.sqrt(np.diag(a) + 1e-300)
        inner = scale[:, None] * a * scale + (damping + 1e-14) * np.eye(len(a))
        step = -scale * np.linalg.solve(inner, scale * b)
        size = float(np.linalg.norm(step / scale)) / (1.0 + np.sqrt(cost))
        tried = placed.step(step, unknowns)
        if np.any(tried.intrinsics[:2] <= 0) or tried.scale <= 0:
            damping = max(10 * damping, 1e-3)
            continue
        ahead = normal_equations(linearise(scene, tried, unknowns), noise)
        if not ahead[2] <= cost * (1 + 1e-12) + 1e-18:
            if size < 1e-9:
                break
            damping = max(10 * damping, 1e-4)
            continue
        placed, (a, b, cost), damping = tried, ahead, damping / 10 if damping > 1e-8 else 0.0
        if size < _ENDS or (size < 1e-9 and size >= 0.5 * last):
            break
        last = size
    return placed


def estimate(
    scene: BoardScene,
    start: HandEyePlacement,
    unknowns: HandEyeUnknowns = POSES,
    *,
    weighed: bool = False,
    near: ErrorSizes | None = None,
) -> HandEyeEstimate:
    """Return camera, board and lens with their noise and uncertainty.

    With `weighed`, images are weighted by the errors that their points share; else all points are equal. `near` are
    sizes of the errors of a similar problem, as first values.

    Raises:
        NotIdentifiableError: The images do not determine all unknowns.
        NotConvergedError: The sizes of the errors did not converge.
    """
    placed, noise = start, near
    if weighed:
        for _ in range(_NOISE_ROUNDS):
            before, noise = noise, find_noise(linearise(scene, placed, unknowns), noise)
            placed = solve(scene, placed, unknowns, noise)
            if before is not None and np.allclose(before.sizes, noise.sizes, _NOISE_CONVERGED, 1e-12):
                break
        else:
            raise NotConvergedError("the noise of the photographs could not be found from the residuals")
        weights = noise
    else:
        placed, weights = plain(scene, start, unknowns)
    linear = linearise(scene, placed, unknowns)
    require_determined(normal_equations(linear, weights)[0], scene)
    noise = weights if weighed else find_noise(linear, near)
    arm, covariance, freedom = intervals(linear, arm_twists(scene.tool), weights, noise)
    return HandEyeEstimate(placed, unknowns, replace(noise, arm=arm), weights, covariance, freedom)


def plain(
    scene: BoardScene, start: HandEyePlacement, unknowns: HandEyeUnknowns = POSES
) -> tuple[HandEyePlacement, ErrorSizes]:
    """Return the least-squares solution with equal weights, and the noise of its residuals, by which priors count.

    Raises:
        NotIdentifiableError: The images do not determine all unknowns.
    """
    has_prior, weights = bool(unknowns.free), ErrorSizes()
    placed = start if has_prior else solve(scene, start, unknowns, weights)
    for _ in range(_NOISE_ROUNDS if has_prior else 1):
        linear = linearise(scene, placed, unknowns)
        left = max(float(np.sum(linear.n_rows)) - linear.jr.shape[1], 1.0)
        before, weights = weights, ErrorSizes(max(float(np.sqrt(np.sum(linear.rr) / left)), 1e-6))
        if has_prior:
            placed = solve(scene, placed, unknowns, weights)
        if abs(before.pixel - weights.pixel) < _NOISE_CONVERGED * weights.pixel:
            break
    require_determined(normal_equations(linearise(scene, placed, unknowns), weights)[0], scene)
    return placed, weights


def require_determined(a: FloatArray, scene: BoardScene) -> None:
    """Raise `NotIdentifiableError` unless all unknowns show in the normal equations A, (k, k)."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(a), 1e-300))
    values = linalg.eigvalsh(scale[:, None] * a * scale)
    if values[0] > _SINGULAR**2 * values[-1] and np.all(np.isfinite(values)):
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


@dataclass(frozen=True, eq=False)
class LeftOutImages(ReadOnlyArrays):
    """Errors of left-out images, predicted minus detected: pixels (m, 2) [px], and on the board (m, 2) [m]."""

    pixels: FloatArray
    board: FloatArray


def predict_left_out_images(
    scene: BoardScene, placed: HandEyePlacement, unknowns: HandEyeUnknowns, weights: ErrorSizes
) -> LeftOutImages:
    """Return the errors of each image against a fit of the others, at fixed weights."""
    pixels, board = np.zeros_like(scene.pixels), np.zeros_like(scene.pixels)
    for i in range(len(scene)):
        part, in_image = scene.image_alone(i), scene.image == i
        without = solve(scene.select_images(np.arange(len(scene)) != i), placed, unknowns, weights, steps=6)
        pixels[in_image], board[in_image] = residuals(part, without), plane_errors_on_board(part, without)
    return LeftOutImages(pixels, board)


def rms(errors: FloatArray) -> float:
    """Return the root mean square length of the finite errors among (m, 2)."""
    squares = np.sum(errors**2, axis=1)
    known = np.isfinite(squares)
    return float(np.sqrt(np.mean(squares[known]))) if np.any(known) else float("nan")
