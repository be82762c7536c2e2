"""Errors of a calibrated robot at poses that its fit has not seen: one definition for a whole model and for files.

The covariance of the parameters counts the uncertainty from noise. For a robot without the terms that its joints need,
or with joint zeros alone, that is the least part. So the stated error comes from errors at poses that had no part in
the fit. They contain the errors of the model, the uncertainty of its parameters, and the noise of the readings there.
The poses are

* those of the validation, if there are any; else
* those left out in turn (cross-validation), each predicted by the fit of the other folds; else
* all used poses, each predicted by the fit of all others, by the linear model: with the whitened rows J_k and residuals
  r_k of a pose, H_k = J_k C J_k^T and C the inverse of the information of all rows and priors, the parameters without
  it move by

      du = C J_k^T (1 - H_k)^-1 r_k

  A pose that alone decides a direction, such as the only pose of a setup, is left out: no other pose predicts it.

Of the errors at n such poses (of positions: distances between predicted and read, the mean over repeats of a pose) are
stated

    rms       their root mean square
    limit95   the k-th smallest, k = ceil(0.95 (n + 1)): the error at one more pose drawn like these stays below with a
              chance of at least 95 %, whatever the errors' distribution (wilks1941). It takes 19 poses.

Validation poses may be read from elsewhere. Where one rigid motion explains most of the errors at poses that are far
apart, the tracker, the base or its frame moved after the calibration. Its place says nothing about the robot. So these
poses place their frames anew, before and after calibration: the errors that remain are the robot's own.

When it fails. Poses unlike these (another region, load or temperature) may be worse. A base that the description calls
known is not placed. Errors of the robot that look like a motion of its frame count as one, where they are most of all
errors; the verdict says that a frame moved.

Reference: cook1982, chapter 2 (one case left out); wilks1941.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from calib.core.base.arrays import FloatArray, IntArray
from calib.core.base.errors import ComputationError, UnreachablePoseError
from calib.core.base.memoize import memoize
from calib.core.base.threads import one_blas_thread
from calib.core.fitting.error_sets import ErrorSet
from calib.core.fitting.fit import errors_on, free_places, place_from_data, reading_origins
from calib.core.fitting.fitted import Fit
from calib.core.fitting.validation import readings_at
from calib.core.numerics.chances import HARDLY
from calib.core.numerics.clusters import shifts_without_block
from calib.core.numerics.rigid import best_transform
from calib.core.numerics.statistics import chi_square
from calib.core.numerics.tall import Span
from calib.core.robots.accuracy_of_files import Accuracy, PoseUse
from calib.core.rows.rows import Rows

COVERED = 0.95
"""Chance of `Accuracy.limit95`."""
_DECIDES = 1.0 - 1e-6
"""If one pose decides more than this part of a direction, the other poses cannot predict it."""
FEW_POSES = 6
"""Fewest validation poses for which a good rigid fit of their errors shows a real motion."""
CLOSE = 0.3
"""The robot's errors look like one motion if the validation points are within this part of the used points' spread."""
EXPLAINED = 0.3
"""A rigid motion explains the errors on validation poses if at most this part of them remains after it."""


def unused_errors(fit: Fit) -> list[tuple[ErrorSet, PoseUse]]:
    """Return the errors at poses that had no part in the fit, if there are any; the verdict's first."""
    folds = None if fit.folds is None else fit.folds.errors
    sets = ((validation_errors(fit), PoseUse.VALIDATION), (folds, PoseUse.FOLDS))
    return [(errors, poses) for errors, poses in sets if errors is not None]


def accuracy(fit: Fit) -> Accuracy:
    """Return the error of the robot of a fit at poses that it has not seen; at those used if there are no others."""
    unseen = unused_errors(fit)
    if not unseen:
        predicted = leave_one_out_errors(fit)
        unseen = [(fit.identification, PoseUse.USED) if predicted is None else (predicted, PoseUse.ONE_BY_ONE)]
    return accuracy_of_errors(*unseen[0])


def accuracy_of_errors(errors: ErrorSet, poses: PoseUse) -> Accuracy:
    """Return the size of errors before and after calibration at these poses."""
    part, squares = errors.main_part, errors.squares("after")
    numbers = errors.rms("before"), float(np.sqrt(np.mean(squares))), limit95(np.sqrt(squares))
    return Accuracy(poses, errors.data.n_poses, part.name, part.dimension, *numbers, part.is_position, part.readings)


def limit95(lengths: FloatArray) -> float:
    """Return the limit that one more length, drawn like these (n,), keeps with a chance of 95 % or more.

    NaN where they are fewer than 19.
    """
    k = math.ceil(COVERED * (len(lengths) + 1) - 1e-9)  # 0.95 is no binary number
    return float(np.sort(lengths)[k - 1]) if k <= len(lengths) else math.nan


@memoize
@one_blas_thread
def leave_one_out_errors(fit: Fit) -> ErrorSet | None:
    """Return errors of used poses, each predicted by the fit of all others; None if no pose can be predicted."""
    data, (moved, decided) = fit.identification.data, _prediction_shifts(fit.weighted_rows, fit.span)
    read = fit.whitening.unwhiten_rows(moved, fit.scales)
    after = {name: errors + read.get(name, 0.0) for name, errors in fit.identification.after.items()}
    predictable = np.isin(data.pose_numbers, np.flatnonzero(decided > _DECIDES), invert=True)
    whole = replace(fit.identification, after=after)
    return errors_at_visits(whole, np.flatnonzero(predictable)) if np.any(predictable) else None


@memoize
def _prediction_shifts(rows: Rows, seen: Span) -> tuple[FloatArray, FloatArray]:
    """Shifts of whitened rows where their pose is left out, (n_rows,), and the largest part that each pose decides.

    Copies of a fit share them, as they hold the same rows.
    """
    return shifts_without_block(rows.span, rows.layout.pose_of_row, rows.residuals, seen=seen, alone=_DECIDES)


def left_out_ratio(fit: Fit) -> float:
    """Return the ratio of errors of left-out poses to those by noise and covariance; 1 where chance explains it.

    With whitened residuals r and e = (1 - H)^-1 r of a pose, used and left out: E r.e = n f^2 for its n rows, where f^2
    is r.r of all over the degrees of freedom. It is more if sizes of terms were chosen to suit the readings.
    """
    rows, freedom = fit.weighted_rows, fit.statistics.freedom
    square = float(np.sum(rows.residuals**2)) + fit.statistics.factors.confirmed
    if fit.computed or not (freedom > 0 and square > 0):
        return 1.0
    (moved, decided), layout = _prediction_shifts(rows, fit.span), rows.layout
    kept = (layout.group >= 0) & ~np.isin(layout.pose_of_row, np.flatnonzero(decided > _DECIDES))
    r, moved = rows.residuals[kept], (np.sqrt(fit.weights)[layout.reading] * moved)[kept]
    more = float(r @ (r + moved)) / max(len(r), 1) * freedom / square
    ratio = math.sqrt(max(more, 1.0))
    return ratio if chi_square(ratio, len(r)).p_larger < HARDLY else 1.0


def rms_shift_left_out(fit: Fit) -> float:
    """Return the root mean square shift of predictions of used poses when the pose itself is left out [SI].

    It covers the main part of the readings and the poses of `leave_one_out_errors`; NaN if there are none.
    """
    predicted, whole = leave_one_out_errors(fit), fit.identification
    if predicted is None:
        return math.nan
    used = errors_at_visits(whole, np.flatnonzero(np.isin(whole.data.names, predicted.data.names)))
    moved = {name: errors - used.after[name] for name, errors in predicted.after.items()}
    return replace(predicted, after=moved).rms("after")


def errors_at_visits(errors: ErrorSet, visits: IntArray) -> ErrorSet:
    """Return errors at some of the visits (n,)."""
    if len(visits) == len(errors.data):
        return errors
    kept = {name: readings_at(readings, visits) for name, readings in errors.data.readings.items()}
    before, after = (
        {name: rows[kept[name]] for name, rows in state.items()} for state in (errors.before, errors.after)
    )
    return ErrorSet(errors.data.subset(visits), errors.instruments, before, after, errors.singular_value[visits])


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
    if fit.validation is None or len(fit.validation.data) < FEW_POSES or fit.computed:
        return None
    used, unused = fit.identification.data, fit.validation.data
    if used.path == unused.path and used.order is not None and unused.order is not None:
        return None  # they were held out of the file that was fitted
    measured, errors = _points(fit.validation)
    if len(measured) < FEW_POSES:
        return None
    both = measured, _points(fit.identification)[0]
    spread, spread_used = (np.std(points - np.mean(points, axis=0)) for points in both)
    if spread < CLOSE * spread_used:
        return None
    predicted = measured + errors
    rotation, translation = best_transform(measured, predicted)
    left = float(np.linalg.norm(predicted - measured @ rotation.T - translation))
    if left >= EXPLAINED * np.linalg.norm(errors):
        return None
    centre = measured.mean(axis=0)
    shift = float(np.linalg.norm(rotation @ centre + translation - centre))
    angle = float(np.arccos(np.clip((np.trace(rotation) - 1.0) / 2.0, -1.0, 1.0)))
    return MovedFrame(shift, angle, left / math.sqrt(len(measured)), _errors_when_replaced(fit))


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
