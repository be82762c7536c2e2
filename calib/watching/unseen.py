"""Errors at poses that were judged before they were fitted, and how sure their root mean square is.

The predicted error counts noise alone. What the model leaves out shows only where the robot is measured and the fit has
not been: every new pose is predicted by the fit of the poses before it, then fitted (Dawid's prequential principle).
The last poses are the ones that tell about the present fit: the last `MOST` since the predicted error met the goal; or,
while these are fewer than `LEAST`, the last `LAST` of all. With s_k the mean square error at pose k and m their mean
over n poses, m is nearly g chi^2_h of the same mean and variance,

    h = 2 n m^2 / (var(s) (1 + 8 / n))        at most 3 n, which normal errors alike in all directions have
    95 % interval of sqrt(E s)  sqrt(m h / chi^2_h(0.975)) to sqrt(m h / chi^2_h(0.025))

The variance of few skewed numbers comes out too small more often than not; with the factor behind it, the upper end
lies above the truth in 95 of 100 cases also where errors lie along one line or have heavy tails.

When it fails. Poses that are alike tell about each other's neighbourhood only; the interval takes them as independent.

Reference: dawid1984.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy

from calib.data.measurements import Measurements
from calib.identification.fit import errors_on
from calib.identification.fitted import Fit
from calib.linearisation.candidates import near_measured
from calib.linearisation.prediction import RootMeanSquare
from calib.watching.progress import UNKNOWN

LAST = 20
"""Poses that tell about the present fit while none has promised the goal yet."""
MOST = 40
"""Poses that tell about it at most once fits promise the goal."""
LEAST = 10
"""Fewer tell nothing."""
_TOO_SMALL = 8.0


def squares_of(fit: Fit, data: Measurements) -> list[float]:
    """Return the mean square position error of each pose that a fit has not seen, in order of appearance [m^2].

    Args:
        fit: The fit.
        data: Measurements that it has not seen; those that repeat poses that it has are left out.
    """
    new = data[~near_measured(data.joints, fit.identification.data.joints)]
    if not len(new):
        return []
    errors = errors_on(fit.placed, fit.robot, new)
    total, count = np.zeros(new.n_poses), np.zeros(new.n_poses)
    for one, part, rows in errors.parts():
        if part.name == "position":
            pose = new.pose_numbers[new.readings[one.name].visits]
            np.add.at(total, pose, np.nansum(errors.after[one.name][:, rows] ** 2, axis=1))
            np.add.at(count, pose, 1.0)
    squares: list[float] = (total[count > 0] / count[count > 0]).tolist()
    return squares


def unseen_rms(squares: Sequence[float]) -> RootMeanSquare:
    """Return the root mean square of these mean square errors [m^2], with its interval; unknown of too few."""
    n = len(squares)
    if n < LEAST:
        return UNKNOWN
    mean, variance = float(np.mean(squares)), float(np.var(squares, ddof=1))
    variance *= 1.0 + _TOO_SMALL / n
    freedom = min(3.0 * n, 2.0 * n * mean**2 / variance) if variance > 0 else 3.0 * n
    low, high = np.sqrt(mean * freedom / scipy.special.chdtri(freedom, [0.025, 0.975]))
    return RootMeanSquare(float(np.sqrt(mean)), float(low), float(high))
