"""Rules of the verdict about the fit: convergence, noise, validation, what the model leaves out, other minima."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pinocchio as pin
from scipy.stats import chi2
from scipy.stats import f as f_distribution

from calib.identification.fitted import ErrorSet, Fit
from calib.identification.reasons import Reason
from calib.identification.rules_data import UNLIKELY
from calib.identification.systematic import describe
from calib.linearisation.registration import registration
from calib.model.mechanism import FloatArray
from calib.numerics.rigid import best_transform
from calib.numerics.statistics import EXACT
from calib.units import PER_SI
from calib.words import counted, listed

NOISE_RATIO = 3.0
"""Found over stated noise from which the statement, or the model, is wrong."""
PROVEN = 0.5
"""Errors on poses that were not used, after over before, that prove a calibration."""
UNUSED_RATIO = 1.5
"""Residuals of poses that were not used, over their predicted scatter."""
FEW_POSES = 6
"""Validation poses from which a rigid motion explains errors only if there is one."""
EXPLAINED = 0.3
"""Errors on validation poses that a rigid motion of the frame leaves, over all of them, if it explains them."""
ELSEWHERE = 0.2
"""Errors of the nominal robot with its base placed by the data, over those where it is stated, if it is elsewhere."""
LARGE_NOISE = 0.1
"""Noise, over the spread of the measured positions, that means that nothing fits."""
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
    """Compare the noise found with the positions and with the stated noise."""
    found, stated, chi = fit.statistics.sigma, fit.sigma_stated, fit.chi_square
    spread = _spread(fit)
    if found > LARGE_NOISE * spread:
        yield Reason(
            "FAIL",
            "noise_as_large_as_robot",
            f"noise found: {1e3 * found:.4g} mm per axis, for positions that spread over {1e3 * spread:.4g} mm; nothing"
            " fits: check units, axes, joint order and signs, and that joints and positions belong together",
        )
    elif fit.computed:
        yield Reason(
            "CHECK",
            "no_noise",
            f"noise found: {1e3 * found:.1g} mm, less than any sensor has; these data were computed, not measured, and"
            " the intervals say nothing about a real robot",
        )
    elif stated is not None and chi is not None:
        yield from _against_statement(fit, found / stated, chi.p_larger, chi.p_smaller)


def _against_statement(fit: Fit, ratio: float, p_larger: float, p_smaller: float) -> Iterator[Reason]:
    numbers = (
        f"{1e3 * fit.statistics.sigma:.3g} mm per axis where {1e3 * fit.statistics.sigma / ratio:.3g} mm was stated"
    )
    if ratio > NOISE_RATIO and p_larger < UNLIKELY:
        proven = any(_rms(found.after) < PROVEN * _rms(found.before) for _, found in _unused(fit))
        yield Reason(
            "CHECK" if proven else "FAIL",
            "noise",
            f"noise found is {ratio:.1f} times what was stated ({numbers}): the model does not explain the"
            " measurements;"
            + (
                " poses that were not used do get better, so what is left is what the model leaves out: state the noise"
                " of robot and sensor together (--sigma-mm)"
                if proven
                else " look at outliers and units, state the noise of robot and sensor together (--sigma-mm), or prove"
                " the result on other poses (--validate, --folds)"
            ),
        )
    elif p_larger < UNLIKELY:
        text = f"noise found is {ratio:.2f} times what was stated ({numbers}), more than chance explains"
        yield Reason("CHECK", "noise", f"{text}: state what robot and sensor do together, or look for what is missing")
    elif p_smaller < UNLIKELY:
        text = f"noise found is only {ratio:.2g} times what was stated ({numbers}), less than chance explains"
        advice = "state it anew (in mm); the same reading may have been used more than once"
        yield Reason("CHECK", "noise", f"{text}: {advice}")


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
    for name, found in _unused(fit):
        before, after = _rms(found.before), _rms(found.after)
        if after > before:
            yield Reason(
                "FAIL",
                "worse_on_validation",
                f"worse than before on {name}: RMS {1e3 * after:.4f} mm after, {1e3 * before:.4f} mm before; the fit"
                " follows its own measurements, not the robot: measure more poses, spread over the same space",
            )


def unused_fits_worse(fit: Fit) -> Iterator[Reason]:
    """Compare errors on unused poses with what noise and uncertainty predict."""
    if fit.validation is None or fit.validation_uncertainty is None or fit.computed:
        return
    noise = fit.statistics.sigma**2 / fit.validation.data.counts[:, None, None]
    expected = noise + fit.validation_uncertainty.std**2
    ratio = float(np.sqrt(np.median(np.sum(fit.validation.after**2 / expected, axis=2)) / chi2(3).median()))
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
    stated, placed = (registration(robot, data, frame_known=known) for known in (True, False))
    if placed.rms > ELSEWHERE * stated.rms:
        return ""
    pose = placed.T_base_measurement.inverse()
    xyz = ", ".join(f"{1e3 * value:.2f} mm" for value in pose.translation)
    rpy = ", ".join(f"{PER_SI['angle']['deg'] * value:.3f} deg" for value in pin.rpy.matrixToRpy(pose.rotation))
    has_own_base = isinstance(robot.description.parametrisation, str)  # then it cannot be called unknown
    unknown = "" if has_own_base else "set base: pose: unknown, or "
    return (
        f"base: pose: known does not fit these measurements (rms {1e3 * stated.rms:.4g} mm; placed by the data:"
        f" {1e3 * placed.rms:.4g} mm): {unknown}correct it to about xyz: [{xyz}], rpy: [{rpy}]"
    )


def frame_moved(fit: Fit) -> Iterator[Reason]:
    """See whether a rigid motion explains the errors on validation poses: whether they were measured from elsewhere."""
    if fit.validation is None or len(fit.validation.data) < FEW_POSES or fit.computed or _from_one_file(fit):
        return
    measured = fit.validation.data.positions.reshape(-1, 3)
    predicted = measured + fit.validation.after.reshape(-1, 3)
    rotation, translation = best_transform(measured, predicted)
    left = _rms((predicted - measured @ rotation.T - translation)[:, None])
    if left < EXPLAINED * _rms(fit.validation.after):
        centre = measured.mean(axis=0)
        shift = 1e3 * float(np.linalg.norm(rotation @ centre + translation - centre))
        angle = float(np.degrees(np.arccos(np.clip((np.trace(rotation) - 1.0) / 2.0, -1.0, 1.0))))
        yield Reason(
            "CHECK",
            "frame_moved",
            f"the validation poses look as if the tracker, the base or its frame had moved between the two files, by"
            f" {shift:.3g} mm and {angle:.2g} deg: that explains all but {1e3 * left:.3g} mm RMS; measure both from one"
            " place, or hold out poses of one file (--validate 0.2)",
        )


def no_gain(fit: Fit) -> Iterator[Reason]:
    """F test of all parameters against placing base and targets alone."""
    weight = (fit.identification.data.counts[:, None] * fit.weights)[:, :, None]
    before = float(np.sum(weight * fit.identification.before**2))
    after = float(np.sum(weight * fit.identification.after**2))
    placed = sum(p.placement for p, use in zip(fit.nominal.parameters, fit.free, strict=True) if use)
    k = fit.statistics.effective_parameters - placed
    if k < 0.5 or after <= 0 or fit.computed:
        return
    p_value = float(f_distribution.sf((before - after) / k / fit.statistics.sigma**2, k, fit.statistics.freedom))
    if p_value > UNLIKELY:
        yield Reason(
            "CHECK",
            "no_gain",
            f"the calibration explains no more than chance would (p = {p_value:.2g}): the robot may be as good as its"
            " nominal model, or the measurements too noisy or too few",
        )


def systematic(fit: Fit) -> Iterator[Reason]:
    """List patterns in the residuals."""
    found = [pattern for pattern in fit.patterns if pattern.significant]
    if found:
        words = [describe(pattern, fit.nominal.mechanism.dimensions) for pattern in found]
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
    unit = 1.0 if fit.sigma_stated is not None else (max(fit.statistics.sigma, EXACT) / fit.starts.sigma) ** 2
    near = [other for other in others if other.cost - best.cost < OTHER_MINIMUM * unit]
    if near:
        yield Reason(
            "CHECK",
            "other_minimum",
            f"{counted(len(near), 'other minimum explains', 'other minima explain')} the data as well (RMS"
            f" {1e3 * near[0].rms:.4g} mm against {1e3 * best.rms:.4g} mm): the data do not say which is the"
            " robot; measure more different poses",
        )


def _from_one_file(fit: Fit) -> bool:
    """Whether the validation poses were held out of the file that was fitted."""
    used, unused = fit.identification.data, fit.validation.data if fit.validation is not None else None
    return unused is not None and used.path == unused.path and used.order is not None and unused.order is not None


def _unused(fit: Fit) -> Iterator[tuple[str, ErrorSet]]:
    if fit.validation is not None:
        yield "the validation poses", fit.validation
    if fit.folds is not None:
        yield "poses left out in turns", fit.folds.errors


def _rms(errors: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=2))))


def _spread(fit: Fit) -> float:
    """Root mean square distance per axis of the measured positions from their centre [m], of the widest target."""
    positions = fit.identification.data.positions
    return float(np.max(np.sqrt(np.mean(np.var(positions, axis=0), axis=1))))
