"""Cross-validation by pose: every pose is predicted once by a fit that did not see it.

Poses are dealt into folds at random; those with the same joint values (repeats of one pose that the file does not mark
as such) go into the same fold, because a repeat is no new pose.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from calib.data.measurements import Measurements
from calib.errors import InputError
from calib.identification.fitted import ErrorSet, Fit
from calib.identification.validation import deal
from calib.model.mechanism import FloatArray


@dataclass(frozen=True, eq=False)
class Folds:
    """Errors of all poses, each predicted by the fit of the other folds.

    Attributes:
        count: Number of folds.
        seed: Seed of the random choice.
        errors: In the order of the data.
        rms: Root mean square distance after calibration of each fold [m], (count,).
        converged: Whether all fits converged.
    """

    count: int
    seed: int
    errors: ErrorSet
    rms: tuple[float, ...]
    converged: bool


def cross_validate(
    data: Measurements, count: int, seed: int, fit: Callable[[Measurements, Measurements], Fit]
) -> Folds:
    """Fit once for each fold, without it.

    Args:
        data: All measurements.
        count: Number of folds, 2 or more.
        seed: Seed of the random choice.
        fit: Fits the first measurements and predicts the second (as its validation).

    Raises:
        InputError: More folds than poses, or fewer than 2.
    """
    folds = deal(data, count, seed)
    if count < 2 or min(len(fold) for fold in folds) == 0:
        raise InputError(f"folds {count}: must be 2 or more, and not more than there are different poses")
    before: FloatArray = np.empty(data.positions.shape)
    after: FloatArray = np.empty(data.positions.shape)
    singular: FloatArray = np.empty(len(data))
    rms, converged = [], True
    for held in folds:
        kept = np.setdiff1d(np.arange(len(data)), held)
        found = fit(data.subset(kept), data.subset(held))
        errors = found.validation
        assert errors is not None
        before[held], after[held], singular[held] = errors.before, errors.after, errors.singular_value
        rms.append(float(np.sqrt(np.mean(np.sum(errors.after**2, axis=2)))))
        converged &= found.converged
    return Folds(count, seed, ErrorSet(data, before, after, singular), tuple(rms), converged)
