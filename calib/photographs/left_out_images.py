"""Each image left out in turn and predicted by a fit of the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray, ReadOnlyArrays
from calib.photographs.estimation import solve
from calib.photographs.scene import BoardScene, HandEyePlacement, plane_errors_on_board, residuals
from calib.photographs.shared_errors import ErrorSizes, IntrinsicsPrior


@dataclass(frozen=True, eq=False)
class LeftOutImages(ReadOnlyArrays):
    """Errors of left-out images, predicted minus detected: pixels (m, 2) [px], and on the board (m, 2) [m]."""

    pixels: FloatArray
    board: FloatArray


def predict_left_out_images(
    scene: BoardScene,
    placed: HandEyePlacement,
    free: Sequence[int],
    weights: ErrorSizes,
    prior: IntrinsicsPrior | None = None,
    *,
    scaled: bool = False,
) -> LeftOutImages:
    """Return the errors of each image against a fit of the others, at fixed weights."""
    pixels, board = np.zeros_like(scene.pixels), np.zeros_like(scene.pixels)
    for i in range(len(scene)):
        only: BoolArray = np.arange(len(scene)) == i
        part, in_image = scene.select_images(only), scene.image == i
        without = solve(scene.select_images(~only), placed, free, weights, prior, scaled=scaled, steps=6)
        pixels[in_image], board[in_image] = residuals(part, without), plane_errors_on_board(part, without)
    return LeftOutImages(pixels, board)


def rms(errors: FloatArray) -> float:
    """Return the root mean square length of the finite errors among (m, 2)."""
    squares = np.sum(errors**2, axis=1)
    known = np.isfinite(squares)
    return float(np.sqrt(np.mean(squares[known]))) if np.any(known) else float("nan")
