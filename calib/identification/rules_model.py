"""Rules of the verdict about the fit: convergence, noise, validation, what the model leaves out, other minima."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.stats import chi2
from scipy.stats import f as f_distribution

from calib.identification.comparison import CHANCE, comparisons
from calib.identification.fitted import Fit
from calib.identification.reasons import Reason
from calib.identification.rules_data import UNLIKELY
from calib.identification.systematic import describe
from calib.model.mechanism import FloatArray
from calib.numerics.rigid import best_transform
from calib.numerics.statistics import EXACT
from calib.words import counted, listed

NOISE_RATIO = 3.0
"""Found over stated noise from which the statement, or the model, is wrong."""
UNUSED_RATIO = 1.5
"""Residuals of poses that were not used, over their predicted scatter."""
FEW_POSES = 6
"""Validation poses from which a rigid motion explains errors only if there is one."""
EXPLAINED = 0.3
"""Errors on validation poses that a rigid motion of the frame leaves, over all of them, if it explains them."""
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
        proven = any(found.better for found in comparisons(fit))
        yield Reason(
            "CHECK" if proven else "FAIL",
            "noise",
            f"noise found is {ratio:.1f} times what was stated ({numbers}): the model does not explain the"
            " measurements;"
            + (
                " poses that were not used do get better beyond chance, so what is left is what the model leaves out,"
                " and intervals do not count it: state the noise of robot and sensor together (--sigma-mm)"
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
    for found in comparisons(fit):
        if found.worse:
            yield Reason(
                "FAIL",
                "worse_on_validation",
                f"worse than before on {found.name}: {found.words}, more than the uncertainty of the fit explains"
                f" (chance {100 * CHANCE:g} %); the fit follows its own measurements, not the robot: measure more"
                " poses, spread over the same space",
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


def frame_moved(fit: Fit) -> Iterator[Reason]:
    """See whether a rigid motion explains the errors on validation poses: whether they were measured from elsewhere."""
    if fit.validation is None or len(fit.validation.data) < FEW_POSES or fit.computed:
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


def nothing_to_correct(fit: Fit) -> Iterator[Reason]:
    """See whether the calibration gains anything: on unused poses, else by an F test of all that was not placed."""
    if fit.computed:
        return
    found = list(comparisons(fit))
    chance = _chance_of_gain(fit)
    no_gain = chance > UNLIKELY or (bool(found) and all(entry.after >= entry.before for entry in found))
    if not no_gain or any(entry.better or entry.worse for entry in found):
        return
    said = "; ".join(f"on {entry.name} {entry.words}, no gain beyond the uncertainty" for entry in found)
    if chance > UNLIKELY:
        said += f"{'; ' if said else ''}on the poses used, no more than chance gives (p = {chance:.2g})"
    yield Reason(
        "PASS",
        "nothing_to_correct",
        f"nothing to correct: {said}; the nominal values are as good as any, as far as measurements with"
        f" {1e3 * fit.statistics.sigma:.3g} mm of noise can tell",
    )


def _chance_of_gain(fit: Fit) -> float:
    """Chance that the parameters explain as much of a robot at nominal, with base and targets placed alone."""
    weight = (fit.identification.data.counts[:, None] * fit.weights)[:, :, None]
    before = float(np.sum(weight * fit.identification.before**2))
    after = float(np.sum(weight * fit.identification.after**2))
    placed = sum(p.placement for p, use in zip(fit.nominal.parameters, fit.free, strict=True) if use)
    k = fit.statistics.effective_parameters - placed
    if k < 0.5 or after <= 0:
        return 0.0
    return float(f_distribution.sf((before - after) / k / fit.statistics.sigma**2, k, fit.statistics.freedom))


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


def _rms(errors: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=2))))


def _spread(fit: Fit) -> float:
    """Root mean square distance per axis of the measured positions from their centre [m], of the widest target."""
    positions = fit.identification.data.positions
    return float(np.max(np.sqrt(np.mean(np.var(positions, axis=0), axis=1))))
