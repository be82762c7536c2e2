"""Errors of joints that residuals show in addition to noise, and that no parameter describes.

Residuals larger than the noise show that the model leaves something out: gears, play, a bending link. Its effect at
another pose is unknown, but its size is known. It is stated as an independent error of each joint at each pose, which
its lever carries to positions (`calib.core.rows.prediction`). Its size, delta, is in rad, for a joint that slides in
characteristic lengths of the robot. It is the likeliest scatter d of the mixed model of all rows and priors
(`calib.core.numerics.mixed_model`). A significance test would ignore small errors, which still make intervals too
narrow.

Stated noise is 1 in whitened rows, and all residuals beyond it are delta. Unstated noise is found together with delta.
They are told apart by geometry: joints move the tool far in some directions and hardly in others, and noise does not;
readings that repeat a pose share its errors of joints. An error of few joints, such as of a coupling, looks more like
noise than like an error of all joints. But noise does not follow joint values, and such an error does. So where noise
is not stated, kinds of joint errors with few coefficients are in the model with their own sizes
(`calib.core.fitting.terms.kind_model`): each with its likeliest size, if the likelihood is higher with it by a factor
of 20 (kass1995), times their number. Otherwise one of many absent kinds looks present by chance, and adds large
errors far from the measured poses. The fit has none of these kinds, so its robot has the whole error of each kind that
the rows show. That error counts, and its uncertainty is added. Where `--terms auto` has found the sizes of all kinds,
these count instead.

The part that rows cannot tell from noise counts as delta, because the noise of readings does not move the tool
(`calib.core.numerics.size_search.scatter_given_noise`). With known noise that part is zero; where all joints move all
readings alike, as in a gantry, it is most of the residuals.
An outlier counts no more than the largest error that is none, since it may be a wrong reading
(`calib.core.fitting.outliers`). A reading at a pose has the noise beside delta (`reading_noise`): the found noise
contains both. With a robust loss it is the found noise, as weighted residuals are smaller than noise. Delta is no part
of the covariance of parameters, which is found from the same residuals. Of very many poses, a part determines it.

When it fails. A stated noise that is too small counts as an error of the joints. Errors that the parameters absorbed
show in no residual: at poses unlike the measured ones the robot may be further off. For a robot that its parameters
describe, noise alone makes delta larger than 0 in about half of all fits.

Reference: kass1995; patterson1971.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.core.base.arrays import FloatArray, ReadOnlyArrays
from calib.core.base.threads import one_blas_thread
from calib.core.fitting.outliers import bounded_weights
from calib.core.fitting.solved_fit import SolvedFit
from calib.core.fitting.terms.candidate_terms import TELLS, CandidateTerm, candidates
from calib.core.fitting.terms.kind_model import KindModel, with_kinds
from calib.core.numerics.mixed_model import MixedModel, SolvedModel
from calib.core.numerics.size_search import least_sizes, likeliest_sizes, noise_given_scatter, scatter_given_noise
from calib.core.robots.robot import Robot
from calib.core.rows.prediction import UndecidedTerms

_SHORTEST = 0.3  # a component of usual size is negligible if its length is below this part of the fit's noise


@dataclass(frozen=True, eq=False)
class UnexplainedErrors(ReadOnlyArrays):
    """Errors that residuals show in addition to noise.

    Attributes:
        reading_noise: Noise of each group of rows beside errors of joints, (n_groups,) [SI].
        joint_error: Delta of the module docstring [rad]; 0 where noise explains the residuals.
        terms: Kinds of joint errors that the fit lacks, and its residuals show; None if there are none.
    """

    reading_noise: FloatArray
    joint_error: float = 0.0
    terms: UndecidedTerms | None = None


@one_blas_thread
def unexplained_errors(fit: SolvedFit, *, sized: bool) -> UnexplainedErrors:
    """Return the errors that the residuals of a fit show in addition to noise.

    `sized` says whether the sizes of all kinds of joint terms were found for it.
    """
    groups, found = fit.whitening.groups, np.array([noise.sigma for noise in fit.noise])
    if fit.computed:
        return UnexplainedErrors(found)
    stated = np.array([group.stated for group in groups])
    kinds = () if sized or np.all(stated) else _kinds_of_few_coefficients(fit)
    model, units = KindModel(fit, kinds), np.where(stated, 1.0, fit.scales)
    read = model.informative_rows
    read = read[np.any(fit.weighted_rows.jacobian[read] != 0.0, axis=1)]
    seen = np.isin(np.arange(len(groups)), fit.whitening.layout.group[read])  # rows say nothing of other groups
    rows = model.rows(read, units, stated | ~seen, bounded_weights(fit))
    mixed = MixedModel.from_rows(rows, _SHORTEST)
    if not np.any(mixed.spread > 0.0):  # joints move none of the rows
        return UnexplainedErrors(found)
    at = likeliest_sizes(mixed)
    delta, noise = scatter_given_noise(at), found
    whole = np.all(fit.weights == 1.0)  # else residuals are smaller than noise
    if whole and delta > 0.0 and delta >= np.exp(at.logs[-1]):  # noise of own shape looks like errors of joints
        least = noise_given_scatter(at, delta) * units * [group.typical for group in groups]
        noise = np.where(seen, np.minimum(found, least), found)
    return UnexplainedErrors(noise, delta, _shown(model, fit.robot, at))


def _kinds_of_few_coefficients(fit: SolvedFit) -> tuple[CandidateTerm, ...]:
    kinds = [kind for kind in candidates(fit.robot, fit.identification.data) if not kind.refusal]
    robot = with_kinds(fit.robot, kinds)
    return tuple(kind for kind in kinds if not kind.is_curve_in(robot))


def _shown(model: KindModel, robot: Robot, at: SolvedModel) -> UndecidedTerms | None:
    """Kinds that a robot lacks and the rows show, with their likeliest sizes; None if there are none."""
    n, least, known = at.model.n_families, least_sizes(at.model), at
    for k in (k for k in np.argsort(at.logs[:n]) if at.logs[k] > least[k]):
        logs = known.logs.copy()
        logs[k] = least[k]
        without = at.model.solve(logs)
        if without.cost - known.cost < TELLS + np.log(n):
            known = without
    absent = known.logs[:n] <= least[:n]
    if np.all(absent):
        return None
    shown_logs, none = known.logs.copy(), np.append(least[:n], known.logs[n:])
    shown_logs[:n][absent] = none[:n][absent] = -np.inf
    return model.undecided(at.model, none, shown_logs[None], robot)
