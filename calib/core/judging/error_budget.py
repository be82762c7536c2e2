"""The error budget: the parts of the error before calibration by cause, and the rest after it.

Between the robot before (values p_0) and after (p_1), let e(t) be the errors of the readings at p_0 + t (p_1 - p_0),
J(t) their derivative, and d_k the change of the parameters of cause k. By the chain rule

    |e(0)|^2 - |e(1)|^2  =  sum over k of  s_k,        s_k = - integral over t of 2 e(t)^T J_k(t) d_k

which adds up exactly and depends on no order of adding the causes: s_k is the Aumann-Shapley value, nearly the mean
over all orders (Shapley) where e is nearly linear. Three Gauss points integrate it. A part is negative where a cause
makes these readings worse.

Unknown base and targets are placed as well as possible before calibration, too. They can absorb a part of the change
J_k d_k of another cause: its projection on their columns. That part counts as one of the places: a base that is lower
and a first joint that is higher are the same robot, and the split must not depend on which was found. The part of the
places is then near zero.

On unused readings (validation), s_k is the error that the calibration really removes, and e(1) the rest. On the used
readings, noise was fitted too: with m rows, leverage h_k of the parameters of cause k (the sum over the rows of
J_k (K J^T)_k, K the scaled covariance) and s^2 = |e(1)|^2 / (m - sum of h), every s_k is s^2 h_k too large in the mean,
and |e(1)|^2 as much too small; this is corrected.

The rest splits into noise and unexplained errors only if the noise is known otherwise: from repeats of poses (which
contain the robot's repeatability too), or as stated.

Standard deviations come from the choice of poses (by the sum of each pose, since its repeats share errors). Those of
causes also come from their parameters (`Fit.uncertainty`): s_k = (J_k d_k)^T J d has the gradient J_k^T J d (of its own
parameters) + J^T J_k d_k, with J_k projected if there are places. J^T is taken at t = 1, where directions that the
readings do not determine move no reading: they do not count, however uncertain they are.

When it fails. With few poses the split of the rest is uncertain. Parameters of a named parametrisation all count as
geometry.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray, IntArray
from calib.core.fitting.error_sets import ErrorSet
from calib.core.fitting.fitted import Fit
from calib.core.instruments.kind import Part
from calib.core.judging.repeatability import repeatability
from calib.core.numerics import linalg
from calib.core.numerics.identifiability import RANK_TOLERANCE, reduce_rows, unit_columns
from calib.core.robots.robot import Robot
from calib.core.rows.observed import observe
from calib.core.rows.rows import Layout, Rows
from calib.core.rows.unknowns import Unknowns

PLACES, GEOMETRY = "base, targets and instruments", "geometry (joint origins)"
NOISE, UNEXPLAINED = "noise", "not explained"
REST = "noise and unexplained errors, not separable"
ENOUGH_REPEATS = 10.0
"""Repeats give a known noise if they have at least this many degrees of freedom."""
_AS_LARGE = 1.1  # the rest counts as noise if it is at most this many times the noise (RMS)
_SURE = 0.5  # the unexplained mean square plus two standard deviations must be below this part of the noise's


@dataclass(frozen=True)
class CauseShare:
    """Part of the mean square error before calibration of one cause, and its standard deviation [SI, squared]."""

    cause: str
    mean_square: float
    std: float


@dataclass(frozen=True)
class ErrorBudget:
    """Causes of the error before calibration.

    Attributes:
        used: Whether it covers the used readings, corrected for the fit to them; else the validation readings.
        before, after: Mean square error of a reading before and after [SI, squared].
        shares: The causes, then the rest; they add up to `before`.
        noise_from: `repeats` or `stated`; empty where the noise is not known.
        advice: Whether more modelling may help, in one sentence.
    """

    used: bool
    part: Part
    n_readings: int
    n_poses: int
    before: float
    after: float
    shares: tuple[CauseShare, ...]
    noise_from: str
    advice: str


def causes_of(robot: Robot) -> tuple[str, ...]:
    """Return the cause of each parameter, (n_parameters,)."""
    places = {robot.mechanism.origin(name) for name in robot.mechanism.places}
    parameters = robot.parametrisation.parameters
    causes = [PLACES if p.placement or p.name.rpartition(".")[0] in places else GEOMETRY for p in parameters]
    causes += [PLACES for instrument in robot.instruments for _ in instrument.unknowns]
    return (*causes, *(term.cause for term in robot.terms for _ in term.parameters))


def joint_causes(robot: Robot) -> tuple[str, ...]:
    """Return the joints whose origins or errors each parameter changes, as its cause, (n_parameters,)."""
    causes, own = list(causes_of(robot)), robot.values[: len(robot.parametrisation.parameters)]
    moved = robot.parametrisation.twists(own)
    for k, cause in enumerate(causes):
        if cause == GEOMETRY:
            causes[k] = " and ".join(name for name, twist in moved.items() if np.any(twist[:, k]))
    terms = [term.joint for term in robot.terms for _ in term.parameters]
    return (*causes[: len(causes) - len(terms)], *terms)


def error_budget(fit: Fit, causes_by_parameter: Sequence[str]) -> ErrorBudget:
    """Return the error budget of the validation readings of a fit, or of all readings without validation.

    Args:
        causes_by_parameter: The cause of each parameter, (n_parameters,), such as `causes_of`.

    Raises:
        UnreachablePoseError: The robot cannot be assembled on the path from before to after.
    """
    errors, unknowns, unused = fit.validation or fit.identification, fit.unknowns, fit.validation_rows
    rows = fit.rows if unused is None else unused
    of_parameter = np.array(causes_by_parameter)[unknowns.index]
    causes = list(dict.fromkeys(of_parameter.tolist()))
    members = np.array([of_parameter == cause for cause in causes])
    layout = rows.layout
    counted = np.array([group.part.name == errors.main_part.name for group in layout.groups] + [False])[layout.group]
    before, removed, gradient, pose = _integrate(fit, errors, members, layout, counted)
    n, n_poses, width = len(before), len(np.unique(pose)), int(np.sum(counted))
    if fit.validation is None:
        leverage = _leverage(rows, unknowns, members, counted)
        left = float(np.sum(before) - np.sum(removed))
        removed = removed - left / max(width - float(np.sum(leverage)), 1.0) * leverage / n
    n_free, known = len(unknowns), fit.uncertainty.covariance_of(fit.robot)
    spread = np.einsum("kf,fg,kg->k", gradient, known[:n_free, :n_free], gradient) / n**2
    shares = [
        CauseShare(cause, float(np.mean(part)), float(np.hypot(_std(part, pose), np.sqrt(max(extra, 0.0)))))
        for cause, part, extra in zip(causes, removed.T, spread, strict=True)
    ]
    typical = np.array([group.typical if group.stated else np.nan for group in layout.groups])
    stated = float(np.sum(typical[layout.group[counted]] ** 2)) / n
    noise, noise_std, source = _noise(errors, stated, width / n)
    rest = before - np.sum(removed, axis=1)
    left, left_std = float(np.mean(rest)), _std(rest, pose)
    if source:
        beyond = CauseShare(UNEXPLAINED, left - noise, float(np.hypot(left_std, noise_std)))
        shares += [CauseShare(NOISE, noise, noise_std), beyond]
    else:
        shares.append(CauseShare(REST, left, left_std))
    by_chance = float(np.hypot(noise_std, noise * np.sqrt(2.0 / n_poses)))
    advice = _advice(left, noise, shares[-1], source, by_chance)
    mean = float(np.mean(before))
    return ErrorBudget(fit.validation is None, errors.main_part, n, n_poses, mean, left, tuple(shares), source, advice)


def _integrate(
    fit: Fit, errors: ErrorSet, members: BoolArray, layout: Layout, counted: BoolArray
) -> tuple[FloatArray, FloatArray, FloatArray, IntArray]:
    """Integrate over the path from before to after, for parameters of causes (n_causes, n_free) and rows that count.

    Returns |e(0)|^2 and s_k of each reading, (n_readings,) and (n_readings, n_causes), the gradient of the sum of s_k
    by the unknowns, (n_causes, n_free), and the pose of each reading.
    """
    before, after, unknowns = fit.placed, fit.robot, fit.unknowns
    way = after.values - before.values
    steps = (members * way[unknowns.index]).T
    places, n_causes = _cause_of_places(unknowns, members), len(members)
    removed = np.zeros((layout.n_rows, n_causes))
    pulling = np.zeros((layout.n_rows, 2 + n_causes))  # factors of J^T at t = 1
    of_counted = slice(None) if np.all(counted) else counted
    for node, weight in zip(*np.polynomial.legendre.leggauss(3), strict=True):
        robot = before.with_parameters(before.values + (node + 1.0) / 2.0 * way)
        jacobian, residuals = _linear_model(robot, errors, unknowns, layout)
        by_places, moved = _basis(jacobian[of_counted][:, unknowns.placement]), (jacobian @ steps)[of_counted]
        total = np.sum(moved, axis=1)
        absorbed = by_places @ (by_places.T @ total)
        moved -= by_places @ (by_places.T @ moved)
        moved[:, places] += absorbed
        removed[of_counted] -= weight * residuals[of_counted, None] * moved
        pulling[of_counted] += weight / 2.0 * np.column_stack([total - absorbed, absorbed, moved])
    pulled = _linear_model(after, errors, unknowns, layout)[0][of_counted].T @ pulling[of_counted]
    gradient = members * pulled[:, 0] + pulled[:, 2:].T
    gradient[places] += pulled[:, 1]
    chosen = np.unique(layout.reading[counted])
    squares = np.where(counted, _flat(errors.before, layout), 0.0) ** 2
    columns = (np.bincount(layout.reading, column) for column in (squares, *removed.T))
    sums: FloatArray = np.stack([column[chosen] for column in columns], axis=1).astype(float)
    return sums[:, 0], sums[:, 1:], gradient, layout.pose[chosen]


def _linear_model(robot: Robot, errors: ErrorSet, unknowns: Unknowns, layout: Layout) -> tuple[FloatArray, FloatArray]:
    """Derivative (n_rows, n_free) and residuals (n_rows,) of all rows, of a robot on the path."""
    data = errors.data
    configurations = robot.assemble(data.joints, errors.passive, data.labels, data.conditions)
    observed = observe(robot, configurations, data.readings)
    jacobian = _flat({name: block.derivative_by(unknowns.index) for name, block in observed.items()}, layout)
    return jacobian, _flat({name: block.residuals for name, block in observed.items()}, layout)


def _leverage(rows: Rows, unknowns: Unknowns, members: BoolArray, counted: BoolArray) -> FloatArray:
    n = rows.jacobian.shape[1]  # only rows that count; a triangular factor has the same sums over them
    jacobian = rows.factor[:n, :-1] if np.all(counted) else reduce_rows(rows.jacobian[counted])
    pulled = (jacobian @ rows.posterior_information.root) @ rows.posterior_information.root.T
    placing = _basis(jacobian[:, unknowns.placement])
    absorbed = placing.T @ jacobian
    leverage: FloatArray = members @ np.sum((jacobian - placing @ absorbed) * pulled, axis=0)
    leverage[_cause_of_places(unknowns, members)] += float(np.sum(absorbed * (placing.T @ pulled)))
    return leverage


def _cause_of_places(unknowns: Unknowns, members: BoolArray) -> int:
    """Number of the cause of unknown places; any cause if there are no places, since nothing is added then."""
    return int(np.argmax(members[:, int(np.argmax(unknowns.placement))]))


def _basis(columns: FloatArray) -> FloatArray:
    """Orthonormal basis of columns (n, k), (n, rank); a turn of a target does not move its point: that is rounding."""
    return linalg.orth(unit_columns(columns)[0], RANK_TOLERANCE)


def _flat(arrays: Mapping[str, FloatArray], layout: Layout) -> FloatArray:
    parts = [arrays[name].reshape(-1, *arrays[name].shape[2:]) for name in layout.instruments]
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def _std(parts: FloatArray, pose: IntArray) -> float:
    number = np.unique(pose, return_inverse=True)[1]
    sums = np.bincount(number, parts - np.mean(parts))
    if len(sums) < 2:
        return float("nan")
    return float(np.sqrt(len(sums) / (len(sums) - 1) * np.sum(sums**2)) / len(parts))


def _noise(errors: ErrorSet, stated: float, width: float) -> tuple[float, float, str]:
    """Mean square of the noise of a reading with `width` components, its standard deviation, and its source."""
    scatter, freedom = repeatability(errors)
    if freedom >= ENOUGH_REPEATS and errors.main_part.is_position:
        return width * scatter**2, width * scatter**2 * float(np.sqrt(2.0 / freedom)), "repeats"
    return (stated, 0.0, "stated") if np.isfinite(stated) else (float("nan"), float("nan"), "")


def _advice(left: float, noise: float, beyond: CauseShare, source: str, by_chance: float) -> str:
    """One sentence on whether to go on modelling; `by_chance`: standard deviation of `beyond` if all of it is noise.

    A few large errors make the mean square uncertain, but noise alone does not leave them: so the smaller of both
    standard deviations counts. Readings of a pose count as one there, since they may share their noise.
    """
    if not source:
        return (
            "Without the noise, it is unknown whether more modelling would help: state it (--sigma-mm), or read some"
            " poses several times"
        )
    known = "repeatability (the scatter of repeats)" if source == "repeats" else "the stated noise"
    if left <= _AS_LARGE**2 * noise and beyond.mean_square + 2.0 * beyond.std <= _SURE * noise:
        return f"The rest is no larger than {known}; more modelling will not help"
    if beyond.mean_square > 2.0 * np.fmin(beyond.std, by_chance) and left > _AS_LARGE**2 * noise:
        return f"The rest is larger than {known}: more modelling may help, or the noise is larger than that"
    return f"Too few poses to tell whether the rest is larger than {known}"
