"""Validation poses that were read from elsewhere: a frame that moved, and the error of the robot without that motion.

Where one rigid motion explains most of the errors at validation poses that are far apart, the tracker, the base or its
frame moved after the calibration. Its place says nothing about the robot. So these poses place their frames anew,
before and after calibration: the errors that remain are the robot's own.

When it fails. A base that the description calls known is not placed. Errors of the robot that look like a motion of its
frame count as one, where they are most of all errors; the verdict says that a frame moved.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import ComputationError, UnreachablePoseError
from calib.core.base.memoize import memoize
from calib.core.fitting.error_sets import ErrorSet
from calib.core.fitting.fit import errors_on, free_places, place_from_data, reading_origins
from calib.core.fitting.fitted import Fit
from calib.core.numerics.rigid import best_transform

FEW_POSES = 6
"""Fewest validation poses for which a good rigid fit of their errors shows a real motion."""
CLOSE = 0.3
"""The robot's errors look like one motion if the validation points are within this part of the used points' spread."""
EXPLAINED = 0.3
"""A rigid motion explains the errors on validation poses if at most this part of them remains after it."""


@dataclass(frozen=True, eq=False)
class MovedFrame:
    """Motion of the frame of the validation poses.

    Attributes:
        shift: Distance at the centre of their points [m].
        angle: Angle of the turn [rad].
        rms_after: Root mean square error that the motion leaves [m].
        errors: Errors at these poses, with their frame placed anew; None where it cannot be placed.
    """

    shift: float
    angle: float
    rms_after: float
    errors: ErrorSet | None


@memoize
def moved_frame(fit: Fit) -> MovedFrame | None:
    """Return the motion of the frame of the validation poses; None where it did not move."""
    if fit.validation is None or len(fit.validation.data) < FEW_POSES or fit.computed or _from_one_file(fit):
        return None
    measured, errors = _points(fit.validation)
    if len(measured) < FEW_POSES:
        return None
    spread, used = (np.std(points - np.mean(points, axis=0)) for points in (measured, _points(fit.identification)[0]))
    if spread < CLOSE * used:
        return None
    predicted = measured + errors
    rotation, translation = best_transform(measured, predicted)
    left = _rms(predicted - measured @ rotation.T - translation)
    if left >= EXPLAINED * _rms(errors):
        return None
    centre = measured.mean(axis=0)
    shift = float(np.linalg.norm(rotation @ centre + translation - centre))
    angle = float(np.arccos(np.clip((np.trace(rotation) - 1.0) / 2.0, -1.0, 1.0)))
    return MovedFrame(shift, angle, left, _errors_when_replaced(fit))


def validation_errors(fit: Fit) -> ErrorSet | None:
    """Return the errors at the validation poses for the verdict: with their frame placed anew where it moved."""
    moved = moved_frame(fit)
    return fit.validation if moved is None or moved.errors is None else moved.errors


def _errors_when_replaced(fit: Fit) -> ErrorSet | None:
    assert fit.validation is not None
    robot, data = fit.robot, fit.validation.data
    names = free_places(robot, {frame for frame, _ in reading_origins(robot, data)})
    if not names:
        return None
    try:
        return errors_on(place_from_data(data, fit.placed, names), place_from_data(data, robot, names), data)
    except (ComputationError, UnreachablePoseError):
        return None


def _rms(errors: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=1))))


def _points(error_set: ErrorSet) -> tuple[FloatArray, FloatArray]:
    """Measured points of all instruments, and their errors after calibration, (n, 3) each [m]."""
    measured: list[FloatArray] = [np.zeros((0, 3))]
    errors: list[FloatArray] = [np.zeros((0, 3))]
    for instrument, part, rows in error_set.parts():
        points = instrument.points(error_set.data.readings[instrument.name].values)
        if points is not None and part.is_position:
            measured_rows = np.isfinite(points).all(axis=1)
            measured.append(points[measured_rows])
            errors.append(error_set.after[instrument.name][measured_rows][:, rows])
    return np.concatenate(measured), np.concatenate(errors)


def _from_one_file(fit: Fit) -> bool:
    """Whether the validation poses were held out of the file that was fitted."""
    used, unused = fit.identification.data, fit.validation.data if fit.validation is not None else None
    return unused is not None and used.path == unused.path and used.order is not None and unused.order is not None
