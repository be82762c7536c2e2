"""PASS, CHECK or FAIL: whether a fit can be trusted, with reasons in words that say what to do.

Each rule tests one thing. Tests with a chance state it: chi-square, gain, comparisons, repeats and left-out blocks
0.1 %, patterns and outliers 1 % each. Good data therefore get a CHECK by chance in about one fit of thirty (measured:
docs/verdict.md, which also says what the grades mean). Errors that leave no trace in the measurements are listed beside
it (`not_covered`).

Entry points of the group `calib.reasons` add rules of other packages: functions of a fit that yield reasons.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np

from calib.core.base.errors import InputError
from calib.core.base.memoize import memoize
from calib.core.base.registry import list_entry_points
from calib.core.base.threads import one_blas_thread
from calib.core.base.units import millimetres
from calib.core.data.in_memory import PosesLike, as_poses
from calib.core.data.measurements import Measurements, Poses
from calib.core.fitting.fitted import Fit
from calib.core.fitting.likely_mistakes import likely_mistake
from calib.core.fitting.outliers import Outlier
from calib.core.fitting.unseen_errors import leave_one_out_errors
from calib.core.judging import findings, rules_data, rules_model, rules_noise, rules_parameters, rules_reach
from calib.core.judging.claim import MORE, Benefit, ErrorElsewhere, claim_of
from calib.core.judging.effect_kinds import Pattern, Trait
from calib.core.judging.error_budget import ENOUGH_REPEATS, ErrorBudget
from calib.core.judging.reasons import Code, Reason, Verdict
from calib.core.judging.repeatability import repeatability, scatter_within_poses
from calib.core.judging.row_derivatives import has_time, scales
from calib.core.robots.terms.term import Context
from calib.core.rows.frames import KnownRobot

_RULES: tuple[Callable[[Fit], Iterator[Reason]], ...] = (
    rules_model.worse_on_validation,
    rules_data.dead_readings,
    rules_model.residuals_grew,
    rules_model.check_solution,
    rules_noise.misread,
    rules_noise.noise,
    rules_data.doubtful_readings,
    rules_model.frame_moved,
    rules_parameters.lengths_scaled,
    rules_parameters.joints_scaled,
    rules_parameters.joint_moves_otherwise,
    rules_parameters.far_from_nominal,
    rules_data.poses_that_say_little,
    rules_reach.check_joint_motion,
    rules_reach.far_validation,
    rules_reach.check_joint_limits,
    rules_reach.terms_untested,
    rules_parameters.large_terms,
    rules_parameters.unlike_fleet,
    rules_reach.turns_not_counted,
    rules_data.too_few_poses,
    rules_data.moves_as_one,
    rules_parameters.hardly_determined,
    rules_model.nothing_to_correct,
    rules_model.files_hold_less,
    rules_model.systematic,
    rules_reach.blocks_disagree,
    rules_reach.check_curve_ranges,
    rules_data.check_rounding,
    rules_data.outliers,
    rules_data.used_twice,
    rules_data.repeats,
    rules_model.check_minima,
    rules_data.leverage,
)
_ORDER = ("FAIL", "CHECK", "PASS")
_IN_MISTAKE = {Code.ZERO_READINGS, Code.EQUAL_COLUMNS, Code.JOINT_SCALED}
"""Reasons that a likely mistake already names."""
_SUPERSEDED = (
    (Code.WORSE_ON_VALIDATION, Code.NO_GAIN),
    (Code.NOISE_AS_LARGE_AS_ROBOT, Code.SYSTEMATIC),
    (Code.NOISE_AS_LARGE_AS_ROBOT, Code.JOINT_SCALED),
    (Code.POSES_EQUAL, Code.NOISE_AS_LARGE_AS_ROBOT),  # a robot that did not move
    (Code.EQUAL_COLUMNS, Code.INSTRUMENTS_DISAGREE),
)
"""Reasons, and others that they include or explain."""
_NOTHING_FITS = {Code.NOT_CONVERGED, Code.NOT_ASSEMBLED, Code.NOISE_AS_LARGE_AS_ROBOT, Code.FAR_FROM_NOMINAL}
_MOVED = {Code.AT_BOUNDS}  # effect of a base that is a little elsewhere
NO_MATTER = 0.25
"""A message leaves out an unseen scale error if its effect is below this part of the noise."""
LARGEST = 0.1
"""A larger scale error is not small: a line without a limit says that data of this kind do not show any."""
LIKE_SHUFFLED = 0.8
"""Rows may have been shuffled if neighbours are at least this part as far apart as distant rows."""
_FEW = 10  # the order of fewer rows shows nothing


@memoize
@one_blas_thread
def judge(fit: Fit) -> Verdict:
    """Return the verdict on a fit: the worst of the reasons found, FAIL before CHECK.

    Raises:
        InputError: A rule of another package cannot be loaded, fails, or yields anything other than reasons.
    """
    reasons = [*(reason for rule in _RULES for reason in rule(fit)), *_reasons_of_others(fit)]
    codes, claim = {reason.code for reason in reasons}, claim_of(fit)
    no_correction = Code.NOTHING_TO_CORRECT in codes
    if claim is not None:
        worse = Code.WORSE_ON_VALIDATION in codes
        broken = () if worse else rules_model.claim_broken(fit, claim, no_correction=no_correction)
        reasons = [*broken, *reasons, *rules_reach.check_tolerance(fit, claim)]
    codes_so_far = {reason.code for reason in reasons}
    superseded = {less for more, less in _SUPERSEDED if more in codes_so_far}
    reasons = [reason for reason in reasons if reason.code not in superseded]
    nothing_fits = bool(codes & _NOTHING_FITS) and not fit.convergence.receding_parameters  # else poses are the cause
    gross = nothing_fits or rules_noise.is_noise_too_large(fit)
    scaled = any(reason.code == Code.JOINT_SCALED for reason in reasons)
    mistake = likely_mistake(fit.nominal, fit.identification.data, fit.sigma, gross=False) if scaled else ""
    if not mistake and (gross or codes & _MOVED):
        elsewhere = list(rules_model.places_elsewhere(fit, "FAIL" if nothing_fits else "CHECK"))
        reasons = [*elsewhere, *reasons]
        if gross and not elsewhere:
            mistake = likely_mistake(fit.nominal, fit.identification.data, fit.sigma)
    if mistake:
        text = f"{mistake}; correct the data, or the description where that is wrong"
        reasons = [reason for reason in reasons if reason.code not in _IN_MISTAKE]
        reasons.insert(0, Code.LIKELY_MISTAKE.says(text, grade="FAIL" if gross else "CHECK"))
    if claim is not None and claim.holds and (claim.gain is Benefit.BETTER or no_correction):
        reasons = [replace(reason, grade="PASS") if reason.counted else reason for reason in reasons]
    first = {Code.FRAME_MOVED}
    if claim is not None and any(seen.without_outliers is not None for seen in claim.unused):
        first.add(Code.OUTLIERS)  # the claim holds without them
    reasons.sort(key=lambda reason: (_ORDER.index(reason.grade), reason.code not in first, reason.counted))
    grade = reasons[0].grade if reasons else "PASS"
    if grade == "FAIL":  # other findings say nothing about numbers that must not be used
        return Verdict(grade, tuple(reason for reason in reasons if reason.grade != "PASS"))
    return Verdict(grade, tuple(reasons), not_covered(fit), claim)


def _reasons_of_others(fit: Fit) -> Iterator[Reason]:
    for entry in list_entry_points("calib.reasons"):
        whose = f"reason '{entry.name}' of the verdict ({entry.value})"
        try:
            given = list(entry.load()(fit))
        except Exception as error:  # another package may raise anything
            raise InputError(
                f"{whose}: {type(error).__name__}: {error}; mend or uninstall the package that has it"
            ) from None
        if not all(isinstance(reason, Reason) for reason in given):
            raise InputError(
                f"{whose}: yields something other than calib.core.judging.reasons.Reason; mend its package"
            )
        yield from given


def not_covered(fit: Fit) -> tuple[str, ...]:
    """Return the errors that the measurements of a fit cannot show, a line each."""
    if fit.computed:
        return ()
    seen_in_order = any(Trait.IN_COURSE in p.kind.traits for p in findings.patterns(fit) if p.significant)
    order = () if seen_in_order else unordered(fit.identification.data)  # such a pattern says that rows are in order
    n_sample, n_poses = (each.identification.data.n_poses for each in (findings.sample_of_poses(fit), fit))
    fewer = f"a pattern that only more poses show: patterns and causes were judged on {n_sample} of {n_poses} poses"
    unseen = (*rules_reach.positions_not_claimed(fit), *_scale(fit), *_whose_noise(fit), *_single_visits(fit))
    return (*[fewer] * (n_sample < n_poses), *unseen, *order, *rules_reach.terms_beyond(fit))


def _scale(fit: Fit) -> Iterator[str]:
    """Line on an error of all lengths that the measurements would not show; angles need none."""
    column, linear = scales(findings.setting(fit))[:, :1], findings.linear(fit)
    if np.any(column):
        least, nothing = linear.visible(column), "nothing else"
        made = least * float(np.linalg.norm(column)) / np.sqrt(linear.freedom - linear.confirmed)
    else:
        contacts = any(group.part.dimension == "length" for group in fit.whitening.groups)  # at unknown places
        least = made = np.inf if contacts else 0.0
        nothing = "nothing"
    if made > NO_MATTER * linear.factor:
        below = f" below {float(f'{millimetres(least):.2g}'):g} mm in 1 m" if least < LARGEST else ""
        yield f"a scale error{below}, of the instrument or from heat ({nothing} of known length was measured)"


def _whose_noise(fit: Fit) -> Iterator[str]:
    """Lines on errors that the model leaves out, where the noise was neither stated nor measured by repeats."""
    estimate = fit.first_noise
    measured = repeatability(fit.identification)[1] >= ENOUGH_REPEATS
    if estimate.stated is None and not measured and estimate.group.part.is_position:
        data, by_noise = fit.identification.data, replace(fit.uncertainty, joint_error=0.0)
        frame = replace(fit.reported_uncertainty, uncertainty=by_noise)
        known = frame.predict(data.joints, data.conditions, fit.identification.passive, turns=False)
        predicted = float(np.mean(known.reported_distance**2))
        single = millimetres(float(np.sqrt(predicted + 3.0 * estimate.sigma**2)))
        yield (
            "scatter of the robot (play, changing loads): it looks like the instrument's noise, which was not stated"
            f" (--sigma-mm). If the robot makes all of this scatter, single positions are known to {single:.2g} mm RMS"
        )


def _single_visits(fit: Fit) -> Iterator[str]:
    """Line on the error of single visits, where that of the mean of a pose's visits, which is claimed, is smaller."""
    spread, predicted = scatter_within_poses(fit.identification), leave_one_out_errors(fit)
    if spread > 0.0 and predicted is not None and predicted.main_part.is_position:
        claimed = predicted.rms("after")
        single = float(np.hypot(claimed, spread))
        if single > MORE * claimed:
            yield (
                "scatter of repeats: the claim is about the mean of a pose's repeats. A single one is off by"
                f" {millimetres(single):.4f} mm RMS"
            )


def unordered(poses: Poses) -> tuple[str, ...]:
    """Return a line if rows have no time, and their order would not show a drift; else nothing."""
    n = len(poses)
    reach = np.ptp(poses.joints, axis=0)
    if n < _FEW or has_time(poses) or not np.any(reach > 0):
        return ()
    q = poses.joints[:, reach > 0] / reach[reach > 0]
    near = float(np.mean(np.linalg.norm(np.diff(q, axis=0), axis=1)))
    apart = [float(np.mean(np.linalg.norm(q - np.roll(q, n // part, axis=0), axis=1))) for part in (2, 3, 4)]
    if near < LIKE_SHUFFLED * float(np.mean(apart)):
        return ()
    assumed = isinstance(poses, Measurements) and poses.approach_assumed
    stated = poses.approach is not None and not assumed and np.all(np.any(poses.approach != 0, axis=0)[reach > 0])
    unseen = "a drift or a slip" if stated else "a drift, a slip or a backlash"
    return (
        f"the rows have no time and seem to be in random order. If they were not measured in this order, {unseen} does"
        " not show: sort them, or add a column 'time'",
    )


@dataclass(frozen=True, eq=False, repr=False)
class JudgedFit(Fit):
    """A fit with its findings and its verdict, each made at first use."""

    with_all: JudgedFit | None = None

    @classmethod
    def from_fit(cls, fit: Fit) -> Self:
        """Return a fit with its findings and its verdict."""
        values = {field.name: getattr(fit, field.name) for field in fields(fit)}
        if fit.with_all is not None:
            values["with_all"] = JudgedFit.from_fit(fit.with_all)
        if fit.reduced is not None:
            values["reduced"] = {holds: JudgedFit.from_fit(other) for holds, other in fit.reduced.items()}
        return cls(**values)

    def __repr__(self) -> str:
        return (
            f"<{type(self).__name__} of '{self.nominal.name}': {self.verdict.grade}, {self.identification.data.n_poses}"
            f" poses, {len(self.unknowns)} free parameters>"
        )

    @property
    def verdict(self) -> Verdict:
        """PASS, CHECK or FAIL, with reasons."""
        return judge(self)

    def claim_at(self, poses: PosesLike, context: Context | None = None) -> ErrorElsewhere | None:
        """Return the expected error of the tool at other poses than the measured ones; None without a claim on
        positions.

        Args:
            poses, context: Commands (n, n_actuated) [m or rad], and their conditions.

        Raises:
            DataError, UnreachablePoseError: The poses are not valid, or a loop stays open.
        """
        claim = self.verdict.claim
        if claim is None or not claim.at_measured_poses.is_position:
            return None
        given = as_poses(self.robot, poses)
        known = self.reported_uncertainty.predict(given.joints, given.conditions if context is None else context)
        return claim.error_at(float(np.sqrt(np.mean(known.reported_distance**2))))

    @property
    def outliers(self) -> tuple[Outlier, ...]:
        """Used readings further off than noise explains, worst first."""
        return findings.outliers(self)

    @property
    def validation_outliers(self) -> tuple[Outlier, ...]:
        """Validation readings further off than noise and uncertainty explain, worst first."""
        return findings.validation_outliers(self)

    @property
    def patterns(self) -> tuple[Pattern, ...]:
        """Systematic patterns that were tested in the residuals, most significant first."""
        return findings.patterns(self)

    @property
    def budget(self) -> ErrorBudget | None:
        """Causes of the error before and after calibration; None where the robot cannot be assembled on the path."""
        return findings.budget(self)

    @property
    def known_robot(self) -> KnownRobot:
        """The calibrated robot, with its uncertainty and the measured poses."""
        joints, no_correction = self.identification.data.joints, self.verdict.nothing_to_correct
        return KnownRobot(self.robot, self.uncertainty, joints, no_correction)
