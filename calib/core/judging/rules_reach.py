"""Rules of the verdict about the region where a calibration holds, and about a stated tolerance."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray, evenly_spread
from calib.core.base.memoize import memoize
from calib.core.base.units import DISPLAY_UNIT, quantity_text, stated_tolerance
from calib.core.base.words import count_noun, joints_named, listing
from calib.core.fitting.fitted import Fit
from calib.core.fitting.pose_checks import unmoved_joints, wrapped_terms
from calib.core.fitting.terms.joint_curves import is_beyond_learned
from calib.core.judging.claim import Claim, known_at_used
from calib.core.judging.reasons import Answer, Code, Reason
from calib.core.numerics.halton import halton
from calib.core.robots.robot import Robot
from calib.core.robots.terms.term import Context
from calib.core.rows.prediction import order_of_joints, recombined_joints, without_common_motion

BEYOND_LIMIT = 0.01
"""Messages name a pose if a joint is beyond its limit by more than this [rad, or characteristic lengths]."""
CORNER = 0.1
"""At least one joint must move through this part of the range between its limits."""
LESS_KNOWN = 3.0
"""A calibration does not reach where positions are more than this many times as uncertain as at the used poses."""
WIDENED = np.sqrt(2.0)
"""If joint terms make positions this many times as uncertain, most of the uncertainty comes from the terms."""
UNMOVED = 1e-6
"""Positions that are known to less than this have no unknown parameters [m]."""
_TRIED = 50  # poses at which a joint is moved through its limits in the model
_NO_VARIANCE = 1e-9  # part of each variance, added so that a singular matrix can be inverted
_SAMPLED = 200  # poses at which uncertainties are computed


def check_joint_motion(fit: Fit) -> Iterator[Reason]:
    """Compare the motion of each joint with the range that its limits allow (or a turn, without limits).

    Look for joints that moved so little that positions are unknown where they move further.
    """
    data, robot = fit.identification.data, fit.nominal
    allowed, reach = _joint_ranges(robot), np.ptp(data.joints, axis=0)
    part = reach / allowed
    if np.all(np.isfinite(allowed) & (allowed > 0)) and 0 < np.max(part) < CORNER:
        yield Code.ONE_CORNER.says(
            f"all poses lie in one corner: no joint moved through more than {100 * np.max(part):.2g} % of its range,"
            " and elsewhere the robot is not calibrated: measure poses all over the space where it will work"
        )
    still = np.isin(robot.joint_names, unmoved_joints(robot, data.joints))
    if np.all(part[~still] < CORNER):
        return
    for j in np.flatnonzero((part < CORNER) & ~still):
        at_used, away = _uncertain_at_used(fit), _uncertain_at(fit, _poses_over_range(fit, int(j), float(allowed[j])))
        if away > _well_known(fit, at_used):
            name = robot.joint_names[j]
            dimension = robot.mechanism.dimensions[name]
            moved = quantity_text(float(reach[j]), DISPLAY_UNIT[dimension], ".2g")
            yield Code.JOINT_MOVED_LITTLE.says(
                f"{joints_named(name)} moved through only {moved}. Positions are known to"
                f" {quantity_text(at_used, 'mm', '.2g')} at the poses used, but to {quantity_text(away, 'mm', '.2g')}"
                " RMS where it moves further. Measure poses that move it through its range"
            )


def far_validation(fit: Fit) -> Iterator[Reason]:
    """Report validation poses that lie where the used poses leave positions uncertain."""
    known = None if fit.computed else fit.validation_uncertainty
    if known is None:
        return
    at_used, away = known_at_used(fit), float(np.median(known.reported_distance))
    if away > _well_known(fit, at_used):
        yield Code.VALIDATED_ELSEWHERE.says(
            f"validation poses lie far from the poses used: positions are known to {quantity_text(away, 'mm', '.2g')}"
            f" there, but to {quantity_text(at_used, 'mm', '.2g')} RMS at the poses used. Measure there too, and"
            " validate among the poses used"
        )


def _poses_over_range(fit: Fit, j: int, allowed: float) -> FloatArray:
    used = fit.identification.data.joints
    q = used[evenly_spread(len(used), _TRIED)].copy()
    middle = np.mean(q[:, j])
    lower, upper = (limits[j] for limits in fit.nominal.urdf.limits(fit.nominal.joint_names))
    q[:, j] = np.clip(middle + allowed * np.linspace(-0.5, 0.5, len(q)), lower, upper)
    return q


@memoize
def _uncertain_at_used(fit: Fit) -> float:
    data = fit.identification.data
    used = evenly_spread(len(data), _SAMPLED)
    return _uncertain_at(fit, data.joints[used], data.conditions.select(used))


def _uncertain_at(fit: Fit, q: FloatArray, context: Context | None = None) -> float:
    """Root mean square uncertainty of positions at poses q (n, n_actuated) without their common motion [m]."""
    return _size(fit, _slope(fit, q, context))


def _well_known(fit: Fit, at_used: float) -> float:
    """Largest uncertainty of well-known positions [m], from the uncertainty `at_used` at the used poses."""
    lengths = fit.first_noise.group.part.dimension == "length"
    return max(LESS_KNOWN * at_used, np.sqrt(3.0) * fit.sigma if lengths else 0.0)


def check_joint_limits(fit: Fit) -> Iterator[Reason]:
    """Look for joint values that the robot's own limits exclude."""
    data, robot = fit.identification.data, fit.nominal
    lower, upper = robot.urdf.limits(robot.joint_names)
    excess = np.maximum(lower - data.joints, data.joints - upper) / robot.mechanism.joint_scale
    beyond = np.flatnonzero(np.max(excess, axis=1) > BEYOND_LIMIT)
    if len(beyond):
        joints = [robot.joint_names[j] for j in np.flatnonzero(np.max(excess, axis=0) > BEYOND_LIMIT)]
        impossible = excess > np.maximum((upper - lower) / robot.mechanism.joint_scale, 2.0 * np.pi)  # no wrong limit
        yield Code.BEYOND_JOINT_LIMITS.says(
            f"{count_noun(len(beyond), 'pose lies', 'poses lie')} beyond the URDF's limits of {joints_named(*joints)}:"
            f" {listing([data.labels[k] for k in beyond])}; check the joint's sign, zero, unit and column, or the"
            " limits",
            counted=not np.any(impossible),
        )


def turns_not_counted(fit: Fit) -> Iterator[Reason]:
    """Look for joint terms that count turns of a joint whose values may be wrapped."""
    for words in wrapped_terms(fit.nominal, fit.identification.data.joints):
        yield Code.TURNS_NOT_COUNTED.says(words)


def _joint_ranges(robot: Robot) -> FloatArray:
    """Range of each actuated joint, a turn at most, (n_actuated,) [m or rad]; infinite where unknown."""
    lower, upper = robot.urdf.limits(robot.joint_names)
    return np.asarray(np.minimum(upper - lower, np.where(robot.mechanism.turning, 2 * np.pi, np.inf)))


def check_curve_ranges(fit: Fit) -> Iterator[Reason]:
    """Look for validation poses outside the learned range of a joint's curve, where positions are uncertain."""
    known = None if fit.computed else fit.validation_uncertainty
    if known is None or fit.validation is None:
        return
    outside = is_beyond_learned(fit.robot, fit.identification.data.joints, fit.validation.data.joints)
    away = np.max(known.reported_distance, axis=1)
    outside[away <= _well_known(fit, known_at_used(fit))] = False
    poses = np.flatnonzero(np.any(outside, axis=1))
    if len(poses):
        joints = [fit.robot.joint_names[j] for j in np.flatnonzero(np.any(outside, axis=0))]
        yield Code.BEYOND_CURVES.says(
            f"{count_noun(len(poses), 'validation pose lies', 'validation poses lie')} where no error curve of"
            f" {joints_named(*joints)} was learned: {listing([fit.validation.data.labels[k] for k in poses])}. The"
            " curve is unknown there: measure there too before you rely on it"
        )


def blocks_disagree(fit: Fit) -> Iterator[Reason]:
    """Report parameters that depend on a box of joint space, or on the setup."""
    apart = fit.regions
    if apart is not None and apart.is_significant:
        yield Code.BLOCKS_DISAGREE.says(
            f"the parameters depend on {apart.dependence}, {apart.ratio:.2g} times more than noise explains: the model"
            " leaves something out. Intervals and the uncertainty of positions include it; at places unlike those"
            " measured, errors may be larger"
        )


def terms_untested(fit: Fit) -> Iterator[Reason]:
    """Look for joint terms that leave positions uncertain where each joint keeps its measured values."""
    accuracy = _widening_sentence(fit, lambda: recombined_joints(fit.identification.data.joints, _SAMPLED))
    if accuracy:
        yield Code.TERMS_UNTESTED.says(
            f"the poses used hardly determine the joint terms at other combinations of the same joint values: positions"
            f" are known to {accuracy}. Measure poses that combine joint values in other ways, or validate on such"
            " poses (--validate)"
        )


def terms_beyond(fit: Fit) -> Iterator[str]:
    """Report the uncertainty of positions beyond the joint values from which terms were learned."""
    accuracy = _widening_sentence(fit, lambda: _over_joint_ranges(fit))
    if accuracy:
        yield f"not all of the joints' range was measured: over all of it, positions are known to {accuracy}"


def positions_not_claimed(fit: Fit) -> Iterator[str]:
    """Report how well positions are known if the claim is about other readings, which may hardly show them.

    The joints have their measured values in new combinations: at contacts with one point, positions are equal.
    """
    part = fit.identification.main_part
    if part.is_position:
        return
    known = _uncertain_at(fit, recombined_joints(fit.identification.data.joints, _SAMPLED))
    if known > UNMOVED:
        yield (
            f"positions of the tool: the claim is about {part.readings}. With the measured values of the joints in"
            f" other combinations, positions are known to {quantity_text(known, 'mm', '.2g')} RMS, not counting where"
            " the base stands"
        )


def _over_joint_ranges(fit: Fit) -> FloatArray:
    """Poses over the range of each joint, within its limits, (`_SAMPLED`, n_actuated)."""
    q = fit.identification.data.joints
    lower, upper = fit.nominal.urdf.limits(fit.nominal.joint_names)
    half = _joint_ranges(fit.nominal) / 2
    low, high = np.maximum(lower, np.mean(q, axis=0) - half), np.minimum(upper, np.mean(q, axis=0) + half)
    bounded = np.isfinite(half)
    low, high = np.where(bounded, low, q.min(axis=0)), np.where(bounded, high, q.max(axis=0))
    order, signs = order_of_joints(q)
    sample = halton(_SAMPLED, len(low))[:, order]
    return np.asarray(low + (high - low) * np.where(signs < 0, 1 - sample, sample))


def _widening_sentence(fit: Fit, sample: Callable[[], FloatArray]) -> str:
    """The uncertainty of positions at sampled poses and at the used ones, in words; empty if terms hardly matter.

    Base and tool are placed anew, because their place does not depend on the terms.
    """
    terms = np.isin(fit.unknowns.index, np.arange(len(fit.nominal.parameters))[fit.robot.coefficients])
    slope = _slope(fit, sample()) if np.any(terms) and not fit.computed else np.zeros((0, 0))
    if not len(slope):
        return ""
    at_used, away = _uncertain_at_used(fit), _size(fit, slope)
    if away <= _well_known(fit, at_used):
        return ""
    covariance = fit.uncertainty.covariance_of(fit.robot)
    known = np.append(terms, np.zeros(len(covariance) - len(terms), dtype=bool))
    given = np.vdot(slope.T @ slope, _covariance_given(covariance, known))
    if away <= WIDENED * np.sqrt(3.0 * given / len(slope)):
        return ""
    used = f"{quantity_text(at_used, 'mm', '.2g')} at the poses used"
    return f"{quantity_text(away, 'mm', '.2g')} RMS there, and to {used}, not counting base and tool"


def _slope(fit: Fit, q: FloatArray, context: Context | None = None) -> FloatArray:
    """Derivative of positions at poses q (n, n_actuated) that close by all uncertain quantities, (3 n, n_uncertain).

    The motion of all positions as one body is left out.
    """
    closed, robot = np.flatnonzero(fit.robot.close(q).ok), fit.robot
    if not len(closed):
        return np.zeros((0, len(fit.uncertainty.lasting(robot))))
    conditions = (context or Context.neutral(*q.shape)).select(closed)
    linear, targets = fit.uncertainty.linearise(robot, q[closed], conditions, turns=False), robot.reported_targets
    rows = without_common_motion(linear.positions[:, targets], linear.jacobian[:, targets])
    return rows.reshape(-1, rows.shape[-1])


def _size(fit: Fit, slope: FloatArray) -> float:
    """Root mean square uncertainty of positions with this derivative (3 n, n_uncertain) [m]; 0 where there are none."""
    return float(np.sqrt(3.0 * max(fit.uncertainty.sum_of_variances(fit.robot, slope), 0.0) / max(len(slope), 1)))


def _covariance_given(covariance: FloatArray, known: BoolArray) -> FloatArray:
    """Covariance of all quantities if some of them were known (n,): the conditional one of the others, and zeros."""
    size = np.sqrt(np.where(np.diag(covariance) > 0.0, np.diag(covariance), 1.0))
    unit = covariance / np.outer(size, size) + _NO_VARIANCE * np.diag(known)  # some may not be determined
    left = unit - unit[:, known] @ np.linalg.solve(unit[np.ix_(known, known)], unit[known])
    return np.where(known | known[:, None], 0.0, left * np.outer(size, size))


def check_tolerance(fit: Fit, claim: Claim) -> Iterator[Reason]:
    """Compare the claim with the smallest tolerance that the description or the measurements state."""
    every = [fit.identification.data, *([] if fit.validation is None else [fit.validation.data])]
    stated = {data.path: stated_tolerance(data.comments, data.path) for data in every}
    stated[str(fit.nominal.path)] = fit.nominal.description.tolerance
    known = {path: size for path, size in stated.items() if size is not None}
    if not known:
        return
    path = min(known, key=lambda name: known[name])
    measured, allowed = claim.at_measured_poses, f"the tolerance of {quantity_text(known[path], 'mm', '.4g')} ({path})"
    if not measured.is_position or measured.dimension != "length":
        yield Code.TOLERANCE.says(
            f"it is not known whether the tool is within {allowed}: positions were not measured", answer=Answer.LOOK
        )
    elif not np.isfinite(measured.limit95):
        yield Code.TOLERANCE.says(
            f"{count_noun(measured.n_poses, 'pose')} are too few to tell whether the tool is within {allowed}",
            answer=Answer.OTHER_POSES,
        )
    elif measured.limit95 > known[path]:
        yield Code.TOLERANCE.says(
            f"the claim is {measured.in_unit(measured.limit95)} (95 % of the time), above {allowed}"
        )
