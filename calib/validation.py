"""Position errors as tables, and splitting measurements into those to identify with and those to validate with."""

from __future__ import annotations

import numpy as np

from calib.errors import DataError
from calib.measurements import Measurements
from calib.mechanism import FloatArray


def error_table(errors: FloatArray) -> dict[str, object]:
    """Summarise position errors.

    Args:
        errors: Predicted minus measured, (n, 3) [m].

    Returns:
        `mean`, `max`, `rms`, `std` of the distance; and for each of `x`, `y`, `z` the `mean` and `max` of the absolute
        component, its `rms`, its `std` and its signed mean `bias`. All [mm]; std is NaN for a single error.
    """

    def spread(values: FloatArray) -> float:
        return float(np.std(values, ddof=1)) if len(values) > 1 else float("nan")

    millimetres = 1e3 * np.asarray(errors)
    distance = np.linalg.norm(millimetres, axis=1)
    table: dict[str, object] = {
        "mean": float(np.mean(distance)),
        "max": float(np.max(distance)),
        "rms": float(np.sqrt(np.mean(distance**2))),
        "std": spread(distance),
    }
    for axis, values in zip("xyz", millimetres.T, strict=True):
        table[axis] = {
            "mean": float(np.mean(np.abs(values))),
            "max": float(np.max(np.abs(values))),
            "rms": float(np.sqrt(np.mean(values**2))),
            "std": spread(values),
            "bias": float(np.mean(values)),
        }
    return table


def format_error(table: dict[str, object]) -> list[str]:
    """Return mean, max, rms, std and the mean of |x|, |y|, |z| of an error table as text [mm]."""
    axes = [table[axis] for axis in "xyz"]
    numbers = [table[key] for key in ("mean", "max", "rms", "std")]
    numbers += [axis["mean"] for axis in axes if isinstance(axis, dict)]
    return [f"{number:.4f}" for number in numbers]


def split(data: Measurements, fraction: float, seed: int = 0) -> tuple[Measurements, Measurements]:
    """Hold out a random part of the poses for validation; repeats of one pose stay together.

    Args:
        data: All measurements.
        fraction: Part of the poses to hold out, between 0 and 1.
        seed: Seed of the random choice.

    Returns:
        Measurements to identify with, and to validate with, both in file order.

    Raises:
        DataError: The fraction leaves one of them empty.
    """
    n_held = round(fraction * len(data)) if 0 < fraction < 1 else 0
    if not 0 < n_held < len(data):
        raise DataError(
            f"{data.path}: holding out {fraction:g} of {len(data)} poses leaves nothing to"
            f" {'validate' if n_held == 0 else 'identify'} with; give a fraction between 0 and 1, or a file"
        )
    order = np.random.default_rng(seed).permutation(len(data))
    return data.subset(np.sort(order[n_held:])), data.subset(np.sort(order[:n_held]))
