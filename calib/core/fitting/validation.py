"""Cross-validation by pose: every pose is predicted once by a fit that did not see it.

Poses are dealt into folds at random. Those with the same joint values (repeats of one pose that the file does not mark
as such) go into the same fold, because a repeat is no new pose. Or every setup is a fold: then its errors are those of
a robot or an instrument that was put up anew, and its own poses find that new place.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from functools import partial
from typing import Literal

import numpy as np

from calib.core.base.arrays import FloatArray, IntArray
from calib.core.base.errors import CalibrationError, InputError
from calib.core.base.threads import one_blas_thread
from calib.core.base.words import count_noun
from calib.core.base.workers import Progress, results_in_order
from calib.core.data.measurements import Measurements
from calib.core.data.pose_groups import shuffled_poses
from calib.core.fitting.error_sets import ErrorSet, Folds
from calib.core.fitting.fitted import Fit
from calib.core.instruments.kind import Readings

FitAndPredict = Callable[[Measurements, Measurements], Fit]
"""Function that fits the first measurements and predicts the second as its validation."""


def deal(data: Measurements, count: int, seed: int = 0) -> list[IntArray]:
    """Deal the poses into folds of about equal size; repeats of one pose stay together.

    Returns:
        Indices of each fold, ascending, (n_in_fold,) each; empty where there are fewer different poses than folds.
    """
    folds: list[list[int]] = [[] for _ in range(max(count, 1))]
    for group in shuffled_poses(data.joints, data.pose_numbers, seed):
        min(folds, key=len).extend(int(k) for k in group)
    return [np.sort(np.array(fold, dtype=np.intp)) for fold in folds]


def n_folds(data: Measurements, folds: int | Literal["setups"]) -> int:
    """Return how many folds there are; what is neither a number nor `setups` is an `InputError`."""
    if folds == "setups":
        return len(_setups(data))
    if not isinstance(folds, int):
        raise InputError(f"folds {folds!r:.40}: must be a number of folds, or 'setups'")
    return folds


def _setups(data: Measurements) -> list[int]:
    return [0] if data.setups is None else [int(setup) for setup in np.unique(data.setups)]


def _folds(data: Measurements, folds: int | Literal["setups"], seed: int) -> list[IntArray]:
    if folds == "setups":
        if data.setups is None or len(_setups(data)) < 2:
            raise InputError(f"folds setups: {data.path} has one setup only; give a number of folds")
        return [np.flatnonzero(data.setups == setup) for setup in _setups(data)]
    dealt = deal(data, folds, seed)
    if folds < 2 or min(len(fold) for fold in dealt) == 0:
        raise InputError(f"folds {folds}: must be 2 or more, and not more than there are different poses")
    return dealt


def cross_validate(
    data: Measurements,
    count: int | Literal["setups"],
    seed: int,
    fit: FitAndPredict,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Folds:
    """Fit once for each fold, without it.

    Args:
        count: Number of folds, 2 or more; or `setups`: each setup is a fold.
        fit: Fits one part and predicts the other; a function of a module, so that other processes find it.
        executor: Executor of the fits; this process if not given.

    Raises:
        InputError: More folds than poses, or fewer than 2; one setup only.
    """
    folds = _folds(data, count, seed)
    setups = tuple(_setups(data)) if count == "setups" else ()
    before, after, singular = dict[str, FloatArray](), dict[str, FloatArray](), np.empty(len(data))
    rms, converged = [], True
    fitted = results_in_order(partial(_leave_out_fold, fit, data), folds, executor, progress)
    for held, (errors, well) in zip(folds, fitted, strict=True):
        for whole, part in ((before, errors.before), (after, errors.after)):
            for name, rows in part.items():
                readings = data.readings[name]
                everywhere = whole.setdefault(name, np.empty((len(readings), rows.shape[1])))
                everywhere[readings_at(readings, held)] = rows
        singular[held] = errors.singular_value
        rms.append(errors.rms("after"))
        converged &= well
    errors = ErrorSet(data, errors.instruments, before, after, singular)
    return Folds(len(folds), seed, errors, tuple(rms), converged, setups)


@one_blas_thread
def _leave_out_fold(fit: FitAndPredict, data: Measurements, held: IntArray) -> tuple[ErrorSet, bool]:
    """Errors at the visits of one fold (n_in_fold,) by the fit of all others, and whether that converged."""
    used = data.subset(np.setdiff1d(np.arange(len(data)), held))
    try:
        fitted = fit(used, data.subset(held))
    except CalibrationError as error:
        part = f"{used.n_poses} of {count_noun(data.n_poses, 'pose')}"
        raise type(error)(f"fit without one fold ({part}): {error}; or ask for more folds") from error
    assert fitted.validation is not None
    return fitted.validation, fitted.converged


def readings_at(readings: Readings, visits: IntArray) -> IntArray:
    """Return indices of the readings at these visits (n,), in the order of the visits, (n_at_visits,)."""
    place = np.full(int(readings.visits.max(initial=-1)) + 1, -1)
    inside = visits[visits < len(place)]
    place[inside] = np.arange(len(inside))
    number = place[readings.visits]
    indices = np.flatnonzero(number >= 0)
    return indices[np.argsort(number[indices], kind="stable")]
