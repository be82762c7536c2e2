"""How a claim is found and held against poses that the fit has not used: see `calib.judging.claim`."""

from __future__ import annotations

import numpy as np
import scipy

from calib.base.arrays import FloatArray
from calib.base.words import listed
from calib.fitting.error_sets import ErrorSet
from calib.fitting.fitted import Fit
from calib.fitting.unseen_errors import left_out_one_by_one, of_errors
from calib.judging.better_or_worse import CHANCE, comparisons
from calib.judging.claim import Claim, Gain
from calib.robots.held import Accuracy, SeenAt

MORE = 1.25
"""Errors at poses that were not used, over those claimed, up to which a claim holds."""
_UNLUCKY = 1e-3  # chance that a claim that holds is called broken where poses are few
_FEWEST = 5  # poses from which Student's t says anything
_HALF = 0.5  # part of what a joint's limits allow, below which its reach is told


def claim_of(fit: Fit) -> Claim | None:
    """Return what a fit claims; None where its data do not tell (they were computed, or each pose stands alone)."""
    foretold = None if fit.computed else left_out_one_by_one(fit)
    if foretold is None:
        return None
    told = of_errors(foretold, SeenAt.ONE_BY_ONE)
    unused = []
    if fit.validation is not None:
        unused.append(of_errors(fit.validation, SeenAt.VALIDATION))
    if fit.folds is not None:
        unused.append(of_errors(fit.folds.errors, SeenAt.FOLDS))
    shown = tuple(one for one in unused if (one.part, one.dimension) == (told.part, told.dimension))
    broken = tuple(one for one in shown if one.rms > _most(fit, told, one) * told.rms)
    return Claim(told, shown, broken, _gain(fit, foretold), _region(fit))


def _most(fit: Fit, told: Accuracy, seen: Accuracy) -> float:
    """Return how many times the error claimed another one may be."""
    coordinates = 1 if fit.statistics.shared is not None else len(fit.identification.main_part.axes)
    bound = scipy.special.fdtri(coordinates * seen.n_poses, coordinates * told.n_poses, 1.0 - _UNLUCKY)
    return max(MORE, float(np.sqrt(bound)))


def _squares(errors: ErrorSet, state: str) -> FloatArray:
    """Squared error of each visit, (n_visits,), of the main part of its readings."""
    lengths = errors.errors(state, errors.main_part.name)
    return np.asarray(np.nansum(np.square(lengths).reshape(len(lengths), -1), axis=1))


def _gain(fit: Fit, foretold: ErrorSet) -> Gain:
    compared = list(comparisons(fit))
    if any(one.worse for one in compared):
        return Gain.WORSE
    if compared:
        return Gain.BETTER if any(one.better for one in compared) else Gain.NONE
    change = _squares(foretold, "after") - _squares(foretold, "before")
    if len(change) < _FEWEST:
        return Gain.NONE
    spread = float(np.std(change, ddof=1)) / np.sqrt(len(change))
    t = float(np.mean(change)) / spread if spread > 0 else 0.0
    chance = scipy.special.stdtr(len(change) - 1, np.array([t, -t]))
    return Gain.BETTER if chance[0] < CHANCE else Gain.WORSE if chance[1] < CHANCE else Gain.NONE


def _region(fit: Fit) -> str:
    """Which poses a claim is about."""
    data, robot = fit.identification.data, fit.nominal
    where = f"at poses like the {data.n_poses} measured"
    lower, upper = robot.urdf.limits(robot.joint_names)
    reach, allowed = np.ptp(data.joints, axis=0), upper - lower
    small = [
        f"{name} {100 * part:.0f} %"
        for name, part, known in zip(robot.joint_names, reach / allowed, np.isfinite(allowed), strict=True)
        if known and part < _HALF
    ]
    if small:
        where += f", where joints move through less than half of their limits: {listed(small)}"
    return where
