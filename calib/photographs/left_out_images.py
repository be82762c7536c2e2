"""Images predicted by the others: each left out in turn, and the rest solved again."""

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
    """Images predicted by the others.

    Attributes:
        pixels: Predicted minus found, (m, 2) [px].
        board: The same on the board, (m, 2) [m].
    """

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
    """Return how far each image is from where a fit of the others puts it; weights stay as they are."""
    pixels, board = np.zeros_like(scene.pixels), np.zeros_like(scene.pixels)
    for i in range(len(scene)):
        only: BoolArray = np.arange(len(scene)) == i
        part, in_image = scene.select_images(only), scene.image == i
        without = solve(scene.select_images(~only), placed, free, weights, prior, scaled=scaled, steps=6)
        pixels[in_image], board[in_image] = residuals(part, without), plane_errors_on_board(part, without)
    return LeftOutImages(pixels, board)


def rms(errors: FloatArray) -> float:
    """Return the root mean square length of errors (m, 2), without those that are not known."""
    squares = np.sum(errors**2, axis=1)
    known = np.isfinite(squares)
    return float(np.sqrt(np.mean(squares[known]))) if np.any(known) else float("nan")
