"""What commands say of expected errors: how large, in which frame, and what is counted."""

from __future__ import annotations

import numpy as np

from calib.base.arrays import FloatArray
from calib.base.units import ERROR_UNIT, Dimension, error_scale
from calib.using.expected_errors import ExpectedError

COUNTED = "expected errors count measurement noise and the priors, not what the model leaves out"
"""What an expected error counts."""


def of_frame(frame: str) -> str:
    """Say where and how errors count, in two sentences.

    Args:
        frame: In which frame, in words.
    """
    return f"Errors are {frame}.\n{COUNTED[0].upper()}{COUNTED[1:]}."


def left_as_it_is(result: str) -> str:
    """Say why nothing was corrected.

    Args:
        result: Folder of the calibration.
    """
    return f"the verdict of {result} is that nothing is to be corrected"


def figures(expected: ExpectedError) -> dict[tuple[str, str], FloatArray]:
    """Return expected errors and their limits by name and unit, (n,) each; of what is asked for."""
    parts: tuple[tuple[str, Dimension, FloatArray, FloatArray], ...] = (
        ("", "length", expected.distance, expected.distance95),
        ("_angle", "angle", expected.angle, expected.angle95),
    )
    return {
        (f"{figure}{ending}", ERROR_UNIT[dimension]): error_scale(dimension) * values
        for ending, dimension, rms, limits in parts
        if np.any(np.isfinite(rms))
        for figure, values in zip(("expected", "low95", "high95"), (rms, *limits), strict=True)
    }


def summary(values: FloatArray) -> dict[str, float]:
    """Return root mean square and largest of errors (n,)."""
    return {"rms": float(np.sqrt(np.mean(values**2))), "max": float(np.max(values))}


def expected_now(what: str, expected: dict[str, float], unit: str) -> str:
    """Say how large an error is expected to be.

    Args:
        what: Of what it is, such as `The tool`.
        expected: Its `summary`.
        unit: Of this.
    """
    return f"{what} is expected to be off by {expected['rms']:.4f} {unit} (rms), {expected['max']:.4f} {unit} at worst"


def before_and_now(what: str, before: dict[str, float], expected: dict[str, float], unit: str) -> str:
    """Say how large an error was, and is expected to be.

    Args:
        what: Of what it is.
        before: Its `summary` without compensation.
        expected: Its `summary` now.
        unit: Of both.
    """
    return (
        f"{what} was off by {before['rms']:.4f} {unit} (rms); expected now: {expected['rms']:.4f} {unit},"
        f" {expected['max']:.4f} {unit} at worst"
    )
