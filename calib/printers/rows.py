"""Measured rows of a delta printer, their checks, and the geometry expected before they are used.

A probe has one offset, so a single height with another offset is mistyped. If positions fit no rod or radius, the
stated steps of the motors are wrong. Any other row is checked against all other rows (`left_out_errors`).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy

from calib.core.base.arrays import BoolArray, FloatArray, ReadOnlyArrays
from calib.core.base.errors import DataError
from calib.core.base.units import from_unit, millimetres, quantity_text
from calib.core.base.words import listing
from calib.core.numerics import linalg
from calib.core.numerics.chances import FALSE_ALARM, FEWEST
from calib.printers.linear_delta import DISTANCE, HEIGHT, PARAMETERS, TOWERS, DeltaGeometry, tower_angles

_FITS = 2e-3  # largest error of rows with the right steps and the saved settings [m]
_FACTORS = (1.0, 0.5, 2.0, 0.25, 4.0, 0.125, 8.0)
_FAR, _TIMES = 0.5e-3, 6.0  # a row is far off above this error [m], and above this multiple of the median
_ALIKE = 0.02  # largest relative difference of equal arms
_STEP = 1e-6  # step of central differences [m or rad]


@dataclass(frozen=True, eq=False)
class PrinterRows(ReadOnlyArrays):
    """Measured numbers, heights of a place before distances of two.

    Attributes:
        names, lines: Name and line of each in the file.
        is_height: Mask of the heights, (n,).
        values: Measured values, (n,) [m].
        places: Travel of the three carriages down to both places, which are one for a height, (n, 2, 3) [m].
    """

    names: tuple[str, ...] = ()
    lines: tuple[int, ...] = ()
    is_height: BoolArray = field(default_factory=lambda: np.zeros(0, dtype=bool))
    values: FloatArray = field(default_factory=lambda: np.zeros(0))
    places: FloatArray = field(default_factory=lambda: np.zeros((0, 2, 3)))

    def __len__(self) -> int:
        return len(self.names)


@dataclass(frozen=True)
class PrinterFile:
    """A printer's settings: file, geometry, and measured rows."""

    path: str
    geometry: DeltaGeometry
    rows: PrinterRows = field(default_factory=PrinterRows)


def _are_alike(arms: tuple[float, ...]) -> bool:
    return max(arms) - min(arms) <= _ALIKE * min(arms)


def expected_geometry(printer: PrinterFile, arm: float | None = None) -> DeltaGeometry:
    """Return the geometry expected of a printer before its rows are used.

    The firmware's numbers come from these rows, so they are no prior. It expects angles as designed, a radius rounded
    to the millimetre, and equal endstops. If distances were measured, all arms have the mean length, rounded to the
    millimetre. Without rows, and for arms that no distance has changed, the file's numbers are used.

    A designed or measured length `arm` of the arms [m] replaces theirs.

    Raises:
        DataError: The file's arms are not equal, and none is stated.
    """
    file = printer.geometry
    if arm is None and not _are_alike(file.arms):
        shown = listing([f"{millimetres(value):.4g}" for value in file.arms])
        raise DataError(
            f"{printer.path}: has arms of {shown} mm, but all arms of a printer have one length. Probing cannot find"
            " it: measure an arm and state it, such as --length arm=288mm"
        )

    def rounded(values: tuple[float, ...]) -> float:
        return from_unit(float(round(millimetres(sum(values) / len(values)))), "mm")

    if arm is None and not np.all(printer.rows.is_height):
        arm = rounded(file.arms)
    arms = file.arms if arm is None else (arm, arm, arm)
    if not printer.rows:
        return replace(file, arms=arms)
    end = rounded(file.endstops)
    return DeltaGeometry(rounded((file.radius,)), tower_angles(file.angles[2]), arms, (end, end, end))


def residuals(geometry: DeltaGeometry, rows: PrinterRows) -> FloatArray:
    """Return predicted minus measured values, (n_rows,) [m]; NaN where the arms do not meet."""
    first, last = (geometry.nozzle(rows.places[:, k]) for k in (0, 1))
    return np.where(rows.is_height, first[:, 2], np.linalg.norm(last - first, axis=1)) - rows.values


def require_steps(printer: PrinterFile, micro: Sequence[float]) -> None:
    """Raise `DataError` if the positions of the file fit with other microsteps than stated, of three motors."""

    def median_error(factors: tuple[float, ...]) -> float:
        scaled = replace(printer.rows, places=printer.rows.places * factors)
        values = np.abs(residuals(printer.geometry, scaled))
        return float(np.median(np.where(np.isnan(values), np.inf, values)))

    as_stated = median_error((1.0, 1.0, 1.0))
    if as_stated <= _FITS:
        return
    best = min(itertools.product(_FACTORS, repeat=3), key=median_error)
    if median_error(best) <= _FITS:
        wrong = ", ".join(
            f"[stepper_{tower}] microsteps: {m / f:g} in place of {m:g}"
            for tower, m, f in zip(TOWERS, micro, best, strict=True)
            if f != 1
        )
        raise DataError(
            f"{printer.path}: the probed positions were counted in other microsteps than the file has; they fit"
            f" {wrong}: write these into a copy of the file, or probe again"
        )
    off = f"are {quantity_text(as_stated, 'mm', '.1f')} from what was measured"
    shown = off if np.isfinite(as_stated) else "are out of reach"
    raise DataError(
        f"{printer.path}: with the settings of the file its probed positions {shown}; they were taken before"
        " rotation_distance, microsteps or arms were changed: probe again"
    )


def require_plausible(printer: PrinterFile) -> None:
    """Raise `DataError` for a row far from the prediction of all others."""
    rows = printer.rows
    heights = rows.values[rows.is_height].tolist()
    for k, value in enumerate(heights):
        others = set(heights) - {value}
        if len(heights) > 3 and heights.count(value) == 1 and len(others) == 1:
            raise DataError(
                f"{printer.path}, line {rows.lines[k]}: {rows.names[k]} is {quantity_text(value, 'mm', 'g')}, and all"
                f" others are {quantity_text(others.pop(), 'mm', 'g')}, the offset of the probe; correct it"
            )
    saved = np.abs(residuals(printer.geometry, rows))
    saved = np.where(np.isnan(saved), np.inf, saved)
    k, off, chance = int(np.argmax(saved)), float(np.max(saved)), 1.0
    errors = left_out_errors(printer) if np.all(np.isfinite(saved)) else None
    if errors is not None:
        k = int(np.argmin(errors[1]))
        off, chance = abs(float(errors[0][k])), len(saved) * float(errors[1][k])
    far = len(saved) > 3 and saved[k] > max(_FAR, _TIMES * float(np.median(np.delete(saved, k))))
    if far or (chance < FALSE_ALARM and off > _FAR):
        judges = "the other rows" + ("" if errors is not None else " and the saved settings")
        raise DataError(
            f"{printer.path}, line {rows.lines[k]}: {rows.names[k]} {quantity_text(rows.values[k], 'mm', 'g')} is"
            f" {quantity_text(off, 'mm', '.2f')} off the value from {judges}; correct it or its position, or remove"
            " both"
        )


def left_out_errors(printer: PrinterFile) -> tuple[FloatArray, FloatArray] | None:
    """Return the error of each row against the prediction of the others, and its probability; None if undetermined.

    Saved settings cannot predict: a firmware made them from all rows, including a mistyped one. So each row is left out
    in turn. Nine numbers are estimated from the others and the priors of `calib.printers.linear_delta`, by one step
    from the saved settings (rows are almost linear within a millimetre). The error over its standard deviation is
    Student's t, with the degrees of freedom of the other rows.

    Returns:
        (n_rows,) [m], and (n_rows,) probabilities. None if rows are too few, or arms are not equal.

    Reference: cook1982.
    """
    geometry, rows = printer.geometry, printer.rows
    if not _are_alike(geometry.arms):
        return None
    start, sigma = geometry.values, np.array([error for _, error in PARAMETERS.values()])
    noise = np.where(rows.is_height, HEIGHT, DISTANCE)
    ends = [
        [residuals(DeltaGeometry.from_values(start + sign * step, geometry.angles[2]), rows) for sign in (1, -1)]
        for step in _STEP * np.eye(len(start))
    ]
    slope = np.array([(more - less) / (2 * _STEP) for more, less in ends]).T / noise[:, None]
    error = residuals(geometry, rows) / noise
    prior = np.diag(1 / sigma), (start - expected_geometry(printer).values) / sigma
    off, chance = np.empty(len(rows)), np.empty(len(rows))
    for k in range(len(rows)):
        kept = np.arange(len(rows)) != k
        inverse = linalg.pinv(np.vstack([slope[kept], prior[0]]))
        change = -inverse @ np.concatenate([error[kept], prior[1]])
        freedom = np.sum(kept) - np.trace(slope[kept] @ inverse[:, : np.sum(kept)])
        if freedom < FEWEST:
            return None
        rest = error[kept] + slope[kept] @ change
        off[k] = error[k] + slope[k] @ change
        spread = math.sqrt(rest @ rest / freedom * (1 + np.sum((slope[k] @ inverse) ** 2)))
        chance[k] = 2 * scipy.special.stdtr(freedom, -abs(off[k]) / spread)
    return off * noise, chance
