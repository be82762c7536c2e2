"""Rules of the verdict about the fit: convergence, validation, what the model leaves out, other minima."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pinocchio as pin
import scipy

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import DataError
from calib.core.base.units import ERROR_UNIT, in_unit, millimetres, quantity_text
from calib.core.base.words import count_noun, joints_named, listing, significant
from calib.core.fitting.fitted import Fit
from calib.core.fitting.unseen_errors import moved_frame
from calib.core.judging import findings
from calib.core.judging.better_or_worse import HARM, comparisons
from calib.core.judging.claim import Benefit, Claim, is_elsewhere, unlike_measured
from calib.core.judging.effect_kinds import Pattern, Trait, describe
from calib.core.judging.reasons import Answer, Code, Grade, Reason
from calib.core.judging.rules_noise import LEFT_OUT, impossible, measured_space, noise_in_words
from calib.core.numerics.chances import EXACT, UNLIKELY
from calib.core.numerics.placement import Placement
from calib.core.robots.accuracy_of_files import Accuracy, Holds, PoseUse
from calib.core.robots.robot import Robot
from calib.core.robots.robot_files import lost_by
from calib.core.rows.registration import registration

ELSEWHERE = 0.2
"""The stated place of base or targets is wrong if placing them by the data leaves less than this part of the errors of
the nominal robot."""
NEAR = 0.1
"""If the robot fits, base or targets placed by the data leave less than this part of the spread of the positions."""
BELIEVED = 0.5
"""A reading counts if a robust loss gives it more than this weight."""
AT_END = 0.55
"""Ratio of a change in the course of the measurement to all residuals, up to which a claim holds at its end. A linear
growth is sqrt(3) times as large at the end as on average, so the residuals are 1.25 times as large there if the ratio
is sqrt(0.3)."""
AFTER = 0.3
"""The same ratio for a change that is certain, up to which a claim holds after the measurement, for half as long as it
took. A linear growth has seven times its mean square there, so the residuals are 1.25 times as large if the ratio is
sqrt(0.09)."""
_NOT_THE_ROBOT = (
    ". The fit describes its own measurements, not the robot. Measure more poses, spread over the space where the robot"
    " will work"
)
_FURTHER_ERRORS = ". There the robot has errors that the poses used do not show. Measure there too"
_AT_LIMIT = 1e-6  # distance from its limit at which a passive joint stopped a fit [m, rad]
_MOST_PATTERNS = 3  # named in the sentence
_LISTED_APART = (Trait.IN_COURSE, Trait.MISREAD, Trait.MISPLACED)  # patterns with one of these
OTHER_MINIMUM = 10.0
"""Another minimum explains the data as well if its cost is larger by at most this."""


def check_solution(fit: Fit) -> Iterator[Reason]:
    """Report an iteration that did not converge, and a robot that cannot be assembled from its home configuration."""
    end, receding = fit.convergence, fit.convergence.receding_parameters
    why, advice = end.message, "check units, joint order and signs, or try --starts"
    if not end.has_settled_weights:
        why = f"the weights of the robust loss '{fit.loss}' do not settle; too many measurements disagree"
        advice = "leave the outliers out (--exclude-outliers), or fit without this loss"
    elif receding:
        it = "it" if len(receding) == 1 else "them"
        why = f"these poses do not determine {listing(receding)}: the fit would move {it} without limit"
        advice = f"measure poses that differ more, or hold what they do not determine (--fix {receding[0]})"
    elif not end.step_left < np.inf or end.step_left > 1.0:
        why = f"parameter {end.parameter} would still move by {end.step_left:.2g} standard deviations"
    if not end.converged:
        mechanism, passive = fit.robot.mechanism, fit.configurations.passive
        gaps = np.minimum(passive - mechanism.lower, mechanism.upper - passive)
        for k in np.flatnonzero(np.any(gaps < _AT_LIMIT, axis=0)):
            joint = joints_named(mechanism.passive[k])
            why += f"; passive {joint} is at its limit in the URDF, which may be too narrow"
        yield Code.NOT_CONVERGED.says(f"not converged: {why}; {advice}")
    if not fit.assembles:
        yield Code.NOT_ASSEMBLED.says(
            "with the parameters found, the robot cannot be assembled from its home configuration, so they are wrong;"
            " check units, joint order and signs"
        )


def worse_on_validation(fit: Fit) -> Iterator[Reason]:
    """Compare errors on unused poses before and after."""
    for comparison in comparisons(fit):
        if comparison.worse:
            chance = f"{comparison.words} (chance below {100 * UNLIKELY:g} %)"
            yield _worse_reason(fit, f"on {comparison.name}: {chance}")


def _worse_reason(fit: Fit, where: str) -> Reason:
    moved = moved_frame(fit)
    text = f"the calibration makes the robot worse {where}{'' if _misplaced(fit) else _NOT_THE_ROBOT}"
    return Code.WORSE_ON_VALIDATION.says(text, answer=Answer.HOLD_OUT if moved else None)


def _misplaced(fit: Fit) -> bool:
    """Whether errors at the validation poses come from their frame, which moved and cannot be placed anew."""
    moved = moved_frame(fit)
    return moved is not None and moved.errors is None


def residuals_grew(fit: Fit) -> Iterator[Reason]:
    """Report used readings that fit worse than with the nominal robot, in sum or of one instrument.

    Least squares make their sum smaller. Where it grew, weights or priors counted more than the readings.
    """
    if fit.computed:
        return
    layout, believed = fit.rows.layout, fit.weights > BELIEVED
    whitened = fit.whitened_errors(fit.identification)
    squares = [np.bincount(layout.reading, errors**2, layout.n_readings) for errors in whitened]
    sums = [float(np.sum(by_reading[believed])) for by_reading in squares]
    if sums[1] > HARM**2 * sums[0]:
        yield Code.RESIDUALS_GREW.says(
            f"errors at the poses used are {np.sqrt(sums[1] / sums[0]):.2f} times those of the nominal robot with base"
            " and targets placed: priors or weights count more in this fit than the measurements; check the stated"
            " noise and the sigmas of the description"
        )
        return
    for instrument, part, of_part in fit.identification.parts():
        kept = believed[layout.readings_of(instrument.name)]
        if not np.any(kept):
            continue
        states = fit.identification.before, fit.identification.after
        sizes = [float(np.nanmean(errors[instrument.name][kept][:, of_part] ** 2)) for errors in states]
        if sizes[1] > HARM**2 * sizes[0]:
            unit = ERROR_UNIT[part.dimension]
            before_rms, after_rms = (in_unit(float(np.sqrt(size * len(part.axes))), unit) for size in sizes)
            yield Code.INSTRUMENTS_DISAGREE.says(
                f"readings of {instrument.name}, {part.name}, fit worse than before ({after_rms:.4g} {unit} RMS,"
                f" {before_rms:.4g} before), while those of other instruments fit better: the instruments contradict"
                " each other; check the description of each, and its stated noise"
            )


def claim_broken(fit: Fit, claim: Claim, *, no_correction: bool) -> Iterator[Reason]:
    """Compare errors on unused poses with the claim; `no_correction` says that the robot needs no correction."""
    misplaced, claimed = _misplaced(fit), claim.at_measured_poses
    anew = "" if moved_frame(fit) is None or misplaced else ", their frame placed anew,"
    for accuracy in (seen.accuracy for seen in claim.unused if not seen.holds):
        rms, promised = accuracy.in_unit(accuracy.rms), claimed.in_unit(claimed.rms)
        times = f"{accuracy.rms / claimed.rms:.1f} times"
        if accuracy.rms > accuracy.before and claim.gain is not Benefit.BETTER and not no_correction:
            yield _worse_reason(
                fit,
                f"at {accuracy.pose_words}{anew}: {rms} RMS after, {accuracy.in_unit(accuracy.before)} before, and"
                f" {times} what it claims ({promised})",
            )
        else:
            yield Code.VALIDATION.says(
                f"{accuracy.pose_words}{anew} are {times} as far off as claimed ({rms} RMS; claimed: {promised})"
                + ("" if misplaced else f"{_where(fit, accuracy)}{_FURTHER_ERRORS}")
            )


def _where(fit: Fit, accuracy: Accuracy) -> str:
    """A clause for more validation poses unlike the measured ones than chance explains; empty if there are not more."""
    unlike = unlike_measured(fit)
    if accuracy.poses is not PoseUse.VALIDATION or fit.validation is None or not is_elsewhere(unlike):
        return ""
    setups = [data.setups for data in (fit.identification.data, fit.validation.data)]
    if setups[0] is not None and setups[1] is not None and not np.any(np.isin(setups[1], setups[0])):
        return ". They are of a setup that was not used"
    return f". {np.sum(unlike)} of them lie farther from the poses used than these lie from each other"


def places_elsewhere(fit: Fit, grade: Grade) -> Iterator[Reason]:
    """Report a nominal robot that fits only with its base or its targets elsewhere than stated."""
    robot, data = fit.nominal, fit.identification.data
    frame_known = robot.description.base.pose == "known"
    targets_known = any(section.position == "known" for section in robot.description.targets.values())
    try:
        stated, _ = registration(robot, data, frame_known=frame_known)
        spread = float(np.sqrt(np.sum(np.nanvar(data.points(robot).reshape(-1, 3), axis=0))))
        for base, targets in ((True, False), (False, True), (True, True)):
            if (frame_known or not base) and (targets_known or not targets):
                known = {"frame_known": frame_known and not base, "targets_known": not targets}
                placed, seen = registration(robot, data, **known)
                if placed.rms <= min(ELSEWHERE * stated.rms, NEAR * spread):
                    break
        else:
            return
    except DataError:  # no points were measured
        return
    code = Code.BASE_ELSEWHERE if base else Code.TARGET_ELSEWHERE
    places = _base_in_words(robot, placed) if base else ""
    if targets:
        wrong = [k for k, name in enumerate(seen) if robot.description.targets[name].position == "known"]
        places += " and " if places else "targets: "
        places += listing(
            [f"{seen[k]}: set position: unknown, or xyz: [{_xyz(placed.points[k])}]" for k in wrong], "; "
        )
    what = " and ".join(["base: pose: known"] * base + ["position: known"] * targets)
    stated_rms, placed_rms = (quantity_text(each.rms, "mm", ".4g") for each in (stated, placed))
    yield code.says(
        f"{what} does not fit these measurements (RMS {stated_rms}; placed by the data: {placed_rms}): {places}",
        grade=grade,
    )


def _base_in_words(robot: Robot, placed: Placement) -> str:
    pose = placed.T_base_measurement.inverse()
    rpy = ", ".join(quantity_text(value, "deg", ".3f") for value in pin.rpy.matrixToRpy(pose.rotation))
    has_own_base = isinstance(robot.description.parametrisation, str)  # then it cannot be called unknown
    unknown = "" if has_own_base else "set base: pose: unknown, or "
    return f"{unknown}correct it to about xyz: [{_xyz(pose.translation)}], rpy: [{rpy}]"


def _xyz(point: FloatArray) -> str:
    return ", ".join(quantity_text(value, "mm", ".2f") for value in point)


def frame_moved(fit: Fit) -> Iterator[Reason]:
    """Report a rigid motion that explains the errors on validation poses: they were measured from elsewhere."""
    moved = moved_frame(fit)
    if moved is None or fit.validation is None:
        return
    placed = ""
    if moved.errors is not None:
        before, after = (significant(millimetres(e.rms("after"))) for e in (fit.validation, moved.errors))
        placed = f". With the frame placed anew, the RMS error falls from {before} to {after} mm"
    shift, angle = significant(millimetres(moved.shift)), significant(in_unit(float(moved.angle), "deg"), 2)
    yield Code.FRAME_MOVED.says(
        f"the tracker, the base or its frame probably moved between the two files, by {shift} mm and {angle} deg: this"
        f" leaves {significant(millimetres(moved.rms_after))} mm RMS unexplained{placed}. Measure both files from one"
        " place, or hold out poses of one file (--validate 0.25)"
    )


def nothing_to_correct(fit: Fit) -> Iterator[Reason]:
    """Report a calibration without gain: on unused poses, else by an F test of all parameters but placements."""
    if fit.computed:
        return
    entries = comparisons(fit)
    if np.all(fit.unknowns.placement) or any(entry.better or entry.worse for entry in entries):
        return
    chance = _chance_of_gain(fit)
    evidence = "; ".join(f"on {entry.name} {entry.words}, no gain beyond the uncertainty" for entry in entries)
    if chance > UNLIKELY:
        evidence += f"{'; ' if evidence else ''}on the poses used, no more than chance gives (p = {chance:.2g})"
        yield Code.NOTHING_TO_CORRECT.says(
            f"nothing to correct: {evidence}. No error of the parameters is visible beside"
            f" the noise of {noise_in_words(fit.first_noise, fit.sigma)}"
        )
    elif entries and all(entry.accuracy.rms >= entry.accuracy.before for entry in entries):
        yield Code.NO_GAIN.says(
            f"poses that were not used get no better: {evidence}. Only the poses used get better: the fit describes"
            " what is special about them. Measure more poses, spread over the space where the robot will work"
        )


def _chance_of_gain(fit: Fit) -> float:
    """Chance that parameters explain as much if the nominal robot, with base and targets placed, has no error.

    With few poses the noise found is uncertain, so that almost any gain may be chance. If all noise is stated, and the
    residuals agree with it, the gain is also tested as a chi-square with the stated noise. The smaller chance counts.
    """
    layout = fit.rows.layout
    root = np.sqrt(fit.weights)[layout.reading]
    before, after = ((root * residuals) ** 2 for residuals in fit.whitened_errors(fit.identification))
    k = fit.statistics.effective_parameters - int(np.sum(fit.unknowns.placement))
    if k < 0.5 or np.sum(after) <= 0:
        return 0.0
    gained = max(float(np.sum(before - after)), 0.0)
    chance = float(scipy.special.fdtrc(k, fit.statistics.freedom, gained / k))
    over_stated = np.array([estimate.sigma / (estimate.stated or np.nan) for estimate in fit.noise])
    freedoms = np.array([estimate.freedom for estimate in fit.noise])
    if np.all(scipy.special.chdtrc(freedoms, freedoms * over_stated**2) >= UNLIKELY):
        by_stated = float(np.sum((over_stated[layout.group] ** 2 * (before - after))[layout.group >= 0]))
        chance = min(chance, float(scipy.special.chdtrc(k, max(by_stated, 0.0))))
    return chance


def files_hold_less(fit: Fit) -> Iterator[Reason]:
    """State the error of `calibrated.urdf` where it holds less than the model, and why it is not written."""
    if fit.reduced is None:  # no files were requested
        return
    why = why_no_origins(fit)
    if why:
        others = "calib's own commands use the terms" if fit.robot.terms else "the nominal robot is as good as any"
        yield Code.FILE_WITHHELD.says(
            f"calibrated.urdf and other files of joint origins are not written: {why}; {others}. --force writes them"
        )
    elif lost_by(fit.robot, Holds.ORIGINS):
        origins, whole = (fit.robot.files[holds].accuracy for holds in (Holds.ORIGINS, Holds.EVERYTHING))
        yield Code.FILE_HOLDS_LESS.says(
            f"a URDF cannot hold joint terms. The origins in calibrated.urdf are those that fit best without them:"
            f" {origins.words}. Nominal robot: {origins.in_unit(origins.before)}; whole model:"
            f" {whole.in_unit(whole.rms)}"
        )


def why_no_origins(fit: Fit) -> str:
    """Return why no file of joint origins is written for a fit that did not fail; empty if one is."""
    known = fit.robot.files.get(Holds.ORIGINS)
    lost = "the fit without joint terms, which such a file needs, did not succeed"
    return known.withheld if known is not None else lost if lost_by(fit.robot, Holds.ORIGINS) else ""


def systematic(fit: Fit) -> Iterator[Reason]:
    """List patterns in the residuals: those that change in the course of the measurement, misplaced targets, others.

    The claim includes them, except for changes that go on. Where a pattern is more than a healthy robot leaves, or a
    misplaced target makes most of the residuals, the description is wrong, and doubt remains.
    """
    if impossible(fit):  # patterns of a model that does not fit at all
        return
    patterns = [pattern for pattern in findings.patterns(fit) if pattern.significant]
    left = fit.identification.rms("after")
    grows = max((change.size for change in findings.changes(fit)), default=0.0)
    for trait in (*_LISTED_APART, None):
        kinds = [pattern for pattern in patterns if trait in (*pattern.kind.traits, None)]
        patterns = [pattern for pattern in patterns if pattern not in kinds]
        if not kinds:
            continue
        worst = max(kinds, key=lambda pattern: pattern.size)
        in_claim = worst.dimension != "length" or worst.size < LEFT_OUT * measured_space(fit)
        advice = ""
        if trait is Trait.MISREAD:
            wrong = listing(list(dict.fromkeys(pattern.name for pattern in kinds)))
            advice = f"; correct the readings of {wrong}, or the description (such as the `offset` of a distance)"
            in_claim = all(pattern.size < AT_END * _left_of_instrument(fit, pattern) for pattern in kinds)
        elif trait is Trait.MISPLACED:
            advice = "; correct the target's frame in the description"
            in_claim &= worst.size < AT_END * left
        elif Trait.MOVED in worst.kind.traits:
            advice = "; if something moved, use the rows before or after that, or describe setups"
        if trait is Trait.IN_COURSE:
            in_claim &= worst.size < AT_END * left and grows < AFTER * left
        words = [describe(pattern, fit.nominal.mechanism.dimensions) for pattern in kinds]
        yield Code.SYSTEMATIC.says(
            f"a systematic error remains: {listing(words, '; ', _MOST_PATTERNS)}. Intervals of parameters do not"
            f" include it{advice}",
            answer=Answer.CORRECT if advice else None,
            counted=in_claim,
        )


def _left_of_instrument(fit: Fit, pattern: Pattern) -> float:
    """Root mean square of the residuals of the instrument of a pattern, of the pattern's dimension [SI]."""
    return next(
        float(np.sqrt(np.nanmean(np.sum(fit.identification.after[instrument.name][:, of_part] ** 2, axis=1))))
        for instrument, part, of_part in fit.identification.parts()
        if instrument.name == pattern.name and part.dimension == pattern.dimension
    )


def check_minima(fit: Fit) -> Iterator[Reason]:
    """Report other minima from perturbed starts."""
    if fit.starts is None:
        return
    best, *others = fit.starts.minima
    # without a stated noise the starts were weighted by an assumed one
    started = fit.starts.groups[0] * fit.whitening.groups[0].typical
    unit = 1.0 if fit.noise[0].stated is not None else (max(fit.noise[0].sigma, EXACT) / started) ** 2
    near = [other for other in others if other.cost - best.cost < OTHER_MINIMUM * unit]
    if near:
        yield Code.OTHER_MINIMUM.says(
            f"{count_noun(len(near), 'other minimum explains', 'other minima explain')} the data as well (RMS"
            f" {quantity_text(near[0].rms, 'mm', '.4g')} against {quantity_text(best.rms, 'mm', '.4g')}): the"
            " measurements do not show which of them is the robot; measure poses that differ more"
        )
