"""Rules of the verdict about the fit: convergence, noise, validation, what the model leaves out, other minima."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pinocchio as pin
import scipy

from calib.arrays import FloatArray
from calib.errors import DataError
from calib.identification.comparison import CHANCE, comparisons
from calib.identification.errors_found import ErrorSet
from calib.identification.fitted import Fit, FoundNoise
from calib.identification.reasons import Reason
from calib.identification.rules_data import UNLIKELY
from calib.identification.systematic import describe
from calib.linearisation.registration import registration
from calib.numerics.losses import median_length
from calib.numerics.rigid import best_transform
from calib.numerics.statistics import chi_square
from calib.numerics.variance_components import EXACT
from calib.units import ERROR_UNIT, PER_SI, error_scale, millimetres
from calib.words import counted, listed

NOISE_RATIO = 3.0
"""Found over stated noise from which the statement, or the model, is wrong."""
GROSS = 2.0
"""Noise of every instrument, over the largest that it has, from which the result rests on what the model leaves out."""
ELSEWHERE = 0.2
"""Errors of the nominal robot with its base placed by the data, over those where it is stated, if it is elsewhere."""
UNUSED_RATIO = 1.5
"""Residuals of poses that were not used, over their predicted scatter."""
FEW_POSES = 6
"""Validation poses from which a rigid motion explains errors only if there is one."""
EXPLAINED = 0.3
"""Errors on validation poses that a rigid motion of the frame leaves, over all of them, if it explains them."""
LARGE_NOISE = 0.1
"""Noise, over the spread of the measured positions, that means that nothing fits."""
LEFT_OUT = 0.01
"""The same, up to which it may be what a model leaves out of a healthy robot."""
OTHER_MINIMUM = 10.0
"""Difference of the cost within which another minimum explains the data as well."""


def not_converged(fit: Fit) -> Iterator[Reason]:
    """Judge how the iteration ended."""
    end = fit.convergence
    advice = "check units, joint order and signs, or try --starts"
    if end.converged:
        return
    if not end.weights_stand:
        text = (
            f"not converged: the weights of the robust loss '{fit.loss}' do not settle; too many measurements disagree"
        )
    elif not end.step_left < np.inf or end.step_left > 1.0:
        text = f"not converged: parameter {end.parameter} would still move by {end.step_left:.2g} standard deviations"
    else:
        text = f"not converged: {end.message}"
    yield Reason("FAIL", "not_converged", f"{text}; {advice}")


def noise(fit: Fit) -> Iterator[Reason]:
    """Compare the noise found with the positions, with the stated noise, and with what such instruments have."""
    sigma, spread = fit.sigma, _spread(fit)
    if sigma > LARGE_NOISE * spread:
        yield Reason(
            "FAIL",
            "noise_as_large_as_robot",
            f"noise found: {millimetres(sigma):.4g} mm per axis, for positions that spread over"
            f" {millimetres(spread):.4g} mm; nothing fits: check units, axes, joint order and signs, and that joints"
            " and positions belong together",
        )
    elif fit.computed:
        yield Reason(
            "CHECK",
            "no_noise",
            f"noise found: {_in_words(fit.first_noise, sigma, 1)}, less than any sensor has; these data were computed,"
            " not measured, and the intervals say nothing about a real robot",
        )
    else:
        for one in fit.noise:
            if one.freedom > 0:
                yield from _against_usual(fit, one) if one.stated is None else _against_statement(fit, one)


def _in_words(one: FoundNoise, size: float, digits: int = 3) -> str:
    """A noise [SI] in the unit of its group."""
    return f"{error_scale(one.group.dimension) * size:.{digits}g} {ERROR_UNIT[one.group.dimension]}"


def _of(fit: Fit, one: FoundNoise) -> str:
    return f" of {one.group.name}, {one.group.part}," if len(fit.noise) > 1 else ""


def _against_usual(fit: Fit, one: FoundNoise) -> Iterator[Reason]:
    usual = one.group.usual
    if one.sigma > usual:
        none_fits = all(other.stated is None and other.sigma > GROSS * other.group.usual for other in fit.noise)
        yield Reason(
            "FAIL" if none_fits and not _proven_by_another(fit) else "CHECK",
            "noise",
            f"noise found{_of(fit, one)} is {_in_words(one, one.sigma)} per axis, more than such an instrument has"
            f" ({_in_words(one, usual)} at most): the model does not explain the measurements, and what is left may"
            " have moved the parameters; look for what is missing or wrong in the description of the instrument, and"
            " prove the result by another instrument",
        )


def _proven_by_another(fit: Fit) -> bool:
    """Whether poses get better that an instrument judged with which nothing was fitted."""
    used = fit.identification.data.readings.keys()
    another = fit.validation is not None and bool(fit.validation.data.readings.keys() - used)
    return another and any(comparison.better for comparison in comparisons(fit))


def unproven(fit: Fit) -> bool:
    """Whether noise is so far above its statement that only poses that were not used tell whether the fit can be used.

    Args:
        fit: A fit that was judged with no such poses, or with some that prove nothing.
    """
    beyond = [] if fit.computed else [one for one in fit.noise if _beyond_statement(one)]
    provable = bool(beyond) and all(_may_be_left_out(fit, one) for one in beyond)
    return provable and not any(comparison.better or comparison.worse for comparison in comparisons(fit))


def _beyond_statement(one: FoundNoise) -> bool:
    if one.stated is None or one.freedom <= 0:
        return False
    ratio = one.sigma / one.stated
    return ratio > NOISE_RATIO and chi_square(ratio, one.freedom).p_larger < UNLIKELY


def _may_be_left_out(fit: Fit, one: FoundNoise) -> bool:
    """Whether a noise may be what the model leaves out of a healthy robot."""
    return one.group.dimension != "length" or one.sigma < LEFT_OUT * _spread(fit)


def _against_statement(fit: Fit, one: FoundNoise) -> Iterator[Reason]:
    stated = one.stated or 1.0
    ratio = one.sigma / stated
    chi = chi_square(ratio, one.freedom)
    numbers = f"{_in_words(one, one.sigma)} per axis where {_in_words(one, stated)} was stated"
    of = _of(fit, one)
    if _beyond_statement(one):
        yield _beyond(fit, one, f"noise found{of} is {ratio:.1f} times what was stated ({numbers})")
    elif chi.p_larger < UNLIKELY:
        text = f"noise found{of} is {ratio:.2f} times what was stated ({numbers}), more than chance explains"
        yield Reason("CHECK", "noise", f"{text}: state what robot and sensor do together, or look for what is missing")
    elif chi.p_smaller < UNLIKELY:
        text = f"noise found{of} is only {ratio:.2g} times what was stated ({numbers}), less than chance explains"
        advice = "state it anew; the same reading may have been used more than once"
        yield Reason("CHECK", "noise", f"{text}: {advice}")


def _beyond(fit: Fit, one: FoundNoise, text: str) -> Reason:
    """Judge a noise that is far above its statement."""
    text += ": the model does not explain the measurements;"
    compared = list(comparisons(fit))
    better = any(comparison.better for comparison in compared)
    bounded = one.group.dimension == "length" and np.isfinite(_spread(fit))
    no_worse = bounded and bool(compared) and not any(comparison.worse for comparison in compared)
    if not _may_be_left_out(fit, one):
        text += (
            f" no healthy robot leaves more than {100 * LEFT_OUT:g} % of the space measured"
            f" ({millimetres(_spread(fit)):.4g} mm): look at units, joint order and signs, and outliers; if it is all"
            " noise, state that (--sigma-mm)"
        )
        return Reason("FAIL", "noise", text)
    if better or no_worse:
        told = "do get better beyond chance" if better else "get neither better nor worse"
        text += (
            f" poses that were not used {told}, so what is left is what the model leaves out, or outliers, and"
            " intervals do not count it: state the noise of robot and sensor together (--sigma-mm)"
        )
        return Reason("CHECK", "noise", text)
    text += (
        " look at outliers and units, state the noise of robot and sensor together (--sigma-mm), or prove the result on"
        " other poses (--validate, --folds)"
    )
    return Reason("FAIL", "noise", text)


def not_assembled(fit: Fit) -> Iterator[Reason]:
    """Assemble the calibrated robot afresh."""
    if not fit.assembles:
        yield Reason(
            "FAIL",
            "not_assembled",
            "with the parameters found, the robot cannot be assembled from its home configuration: they are not those"
            " of this robot; check units, joint order and signs",
        )


def worse_on_validation(fit: Fit) -> Iterator[Reason]:
    """Compare errors on unused poses before and after."""
    for comparison in comparisons(fit):
        if comparison.worse:
            yield Reason(
                "FAIL",
                "worse_on_validation",
                f"worse than before on {comparison.name}: {comparison.words}, more than the uncertainty of the fit"
                f" explains (chance {100 * CHANCE:g} %); the fit follows its own measurements, not the robot: measure"
                " more poses, spread over the same space",
            )


def unused_fits_worse(fit: Fit) -> Iterator[Reason]:
    """Compare errors on unused poses with what noise and uncertainty predict."""
    if fit.validation is None or fit.computed:
        return
    judged, rows = fit.validation_studentised, fit.validation_rows
    if judged is None or rows is None:
        return
    size = judged.ratio * judged.scale / median_length(rows.layout.width)
    ratio = float(np.median(size))
    if ratio > UNUSED_RATIO:
        yield Reason(
            "CHECK",
            "validation",
            f"poses that were not used are {ratio:.1f} times as far off as noise and uncertainty predict: the robot"
            " does something there that the poses used do not show; measure also there",
        )


def base_elsewhere(fit: Fit) -> str:
    """Return what to do if the nominal robot fits with its base anywhere but where it is stated; else nothing."""
    robot, data = fit.nominal, fit.identification.data
    if robot.description.base.pose == "unknown":
        return ""
    try:
        stated, placed = (registration(robot, data, frame_known=known) for known in (True, False))
    except DataError:  # no points were measured
        return ""
    if placed.rms > ELSEWHERE * stated.rms:
        return ""
    pose = placed.T_base_measurement.inverse()
    xyz = ", ".join(f"{millimetres(value):.2f} mm" for value in pose.translation)
    rpy = ", ".join(f"{PER_SI['angle']['deg'] * value:.3f} deg" for value in pin.rpy.matrixToRpy(pose.rotation))
    has_own_base = isinstance(robot.description.parametrisation, str)  # then it cannot be called unknown
    unknown = "" if has_own_base else "set base: pose: unknown, or "
    return (
        f"base: pose: known does not fit these measurements (rms {millimetres(stated.rms):.4g} mm; placed by the data:"
        f" {millimetres(placed.rms):.4g} mm): {unknown}correct it to about xyz: [{xyz}], rpy: [{rpy}]"
    )


def frame_moved(fit: Fit) -> Iterator[Reason]:
    """See whether a rigid motion explains the errors on validation poses: whether they were measured from elsewhere."""
    if fit.validation is None or len(fit.validation.data) < FEW_POSES or fit.computed or _from_one_file(fit):
        return
    measured, errors = _points(fit.validation)
    if len(measured) < FEW_POSES:
        return
    predicted = measured + errors
    rotation, translation = best_transform(measured, predicted)
    left = _rms(predicted - measured @ rotation.T - translation)
    if left < EXPLAINED * _rms(errors):
        centre = measured.mean(axis=0)
        shift = millimetres(float(np.linalg.norm(rotation @ centre + translation - centre)))
        angle = float(np.degrees(np.arccos(np.clip((np.trace(rotation) - 1.0) / 2.0, -1.0, 1.0))))
        yield Reason(
            "CHECK",
            "frame_moved",
            f"the validation poses look as if the tracker, the base or its frame had moved between the two files, by"
            f" {shift:.3g} mm and {angle:.2g} deg: that explains all but {millimetres(left):.3g} mm RMS; measure both"
            " from one place, or hold out poses of one file (--validate 0.2)",
        )


def nothing_to_correct(fit: Fit) -> Iterator[Reason]:
    """See whether the calibration gains anything: on unused poses, else by an F test of all that was not placed."""
    if fit.computed:
        return
    entries = list(comparisons(fit))
    chance = _chance_of_gain(fit)
    no_gain = chance > UNLIKELY or (bool(entries) and all(entry.after >= entry.before for entry in entries))
    if not no_gain or any(entry.better or entry.worse for entry in entries):
        return
    said = "; ".join(f"on {entry.name} {entry.words}, no gain beyond the uncertainty" for entry in entries)
    if chance > UNLIKELY:
        said += f"{'; ' if said else ''}on the poses used, no more than chance gives (p = {chance:.2g})"
    yield Reason(
        "PASS",
        "nothing_to_correct",
        f"nothing to correct: {said}; the nominal values are as good as any, as far as measurements with"
        f" {_in_words(fit.first_noise, fit.sigma)} of noise can tell",
    )


def _chance_of_gain(fit: Fit) -> float:
    """Chance that the parameters explain as much of a robot at nominal, with base and targets placed alone."""
    root = np.sqrt(fit.weights)[fit.rows.layout.reading]
    whitened, rows = fit.whitened(fit.identification)
    before, after = float(np.sum((root * whitened) ** 2)), float(np.sum((root * rows.residuals) ** 2))
    k = fit.statistics.effective_parameters - int(np.sum(fit.unknowns.placement))
    if k < 0.5 or after <= 0:
        return 0.0
    return float(scipy.special.fdtrc(k, fit.statistics.freedom, max((before - after) / k, 0.0)))


def systematic(fit: Fit) -> Iterator[Reason]:
    """List patterns in the residuals."""
    patterns = [pattern for pattern in fit.patterns if pattern.significant]
    if patterns:
        words = [describe(pattern, fit.nominal.mechanism.dimensions) for pattern in patterns]
        yield Reason(
            "CHECK",
            "systematic",
            f"residuals are not only noise: {listed(words, '; ')}; the model leaves this out, and intervals do not"
            " count it",
        )


def other_minima(fit: Fit) -> Iterator[Reason]:
    """Look at what perturbed starts found."""
    if fit.starts is None:
        return
    best, *others = fit.starts.minima
    # without a statement the starts were weighed by a noise that was not found yet
    started = fit.starts.groups[0] * fit.whitening.groups[0].typical
    unit = 1.0 if fit.noise[0].stated is not None else (max(fit.noise[0].sigma, EXACT) / started) ** 2
    near = [other for other in others if other.cost - best.cost < OTHER_MINIMUM * unit]
    if near:
        yield Reason(
            "CHECK",
            "other_minimum",
            f"{counted(len(near), 'other minimum explains', 'other minima explain')} the data as well (RMS"
            f" {millimetres(near[0].rms):.4g} mm against {millimetres(best.rms):.4g} mm): the data do not say which is"
            " the robot; measure more different poses",
        )


def _rms(errors: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=1))))


def _points(error_set: ErrorSet) -> tuple[FloatArray, FloatArray]:
    """Measured points of all instruments, and their errors after calibration, (n, 3) each [m]."""
    measured: list[FloatArray] = [np.zeros((0, 3))]
    errors: list[FloatArray] = [np.zeros((0, 3))]
    for one, part, rows in error_set.parts():
        points = one.points(error_set.data.readings[one.name].values)
        if points is not None and part.name == "position":
            measured_rows = np.isfinite(points).all(axis=1)
            measured.append(points[measured_rows])
            errors.append(error_set.after[one.name][measured_rows][:, rows])
    return np.concatenate(measured), np.concatenate(errors)


def _spread(fit: Fit) -> float:
    """Root mean square distance per axis of measured positions from their centre [m], of the widest; inf without."""
    errors = fit.identification
    spreads = [np.inf]
    for one in errors.instruments:
        readings = errors.data.readings.get(one.name)
        points = None if readings is None else one.points(readings.values)
        if points is not None and len(points):
            spreads.append(float(np.sqrt(np.mean(np.nanvar(points, axis=0)))))
    return max(spreads[1:], default=np.inf)


def _from_one_file(fit: Fit) -> bool:
    """Whether the validation poses were held out of the file that was fitted."""
    used, unused = fit.identification.data, fit.validation.data if fit.validation is not None else None
    return unused is not None and used.path == unused.path and used.order is not None and unused.order is not None
