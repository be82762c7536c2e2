"""The claim of a calibration on the error of the robot where it was measured, and its test at unused poses.

Each used pose is predicted by the fit of all others. Of the errors at further poses like them, 95 in 100 stay below
`limit95`, whatever their distribution (`calib.core.fitting.unseen_errors`). docs/verdict.md says when the claim holds,
when the robot gets better, and which poses are unlike those measured. Chance allows one case in a thousand: for the
root mean square by F, with as many degrees of freedom as coordinates were read, or as poses where the readings of a
pose share errors; for numbers of poses by the binomial distribution; for the gain without unused poses by Student's t
of the squared error of each pose, when it is left out, minus the nominal robot's.

At other poses. The claimed mean square error consists of errors that no parameter describes and of the uncertainty of
the parameters. Elsewhere the second grows: where positions are known to k' and not to k, both root mean squares
(`calib.core.rows.prediction`),

    rms'^2 = rms^2 + k'^2 - k^2        where k' is larger

and `limit95` grows in proportion. In `rms`, each pose is predicted without its own readings, so k counts that, too:
k^2 = k_all^2 + s^2, with k_all from the covariance of the fit of all poses, and s the root mean square shift of
predictions when the pose itself is left out. For independent noise f, the covariance of this shift equals the
information that the pose adds about itself: cov r_k = f^2 (1 - H_k), so that with the step du of
`calib.core.fitting.unseen_errors` cov du = f^2 C J_k^T (1 - H_k)^-1 J_k C.

When it fails. New poses unlike the measured ones may be worse by errors of the model: in another region, under another
load, at another place of a touched object. A change in the course of the measurement goes on after it. Copies of a pose
predict each other.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property, partial
from typing import Any, Self

import numpy as np
import scipy

from calib.core.base.arrays import BoolArray
from calib.core.base.contributions import Contributions, Uncertainty, contributions_to
from calib.core.base.units import ERROR_UNIT, Dimension, from_unit, in_unit
from calib.core.base.words import listing
from calib.core.data.pose_groups import APART, is_apart
from calib.core.fitting.error_sets import ErrorSet
from calib.core.fitting.fitted import Fit
from calib.core.fitting.unseen_errors import (
    COVERED,
    accuracy_of_errors,
    errors_at_visits,
    leave_one_out_errors,
    rms_shift_left_out,
)
from calib.core.judging import findings
from calib.core.judging.better_or_worse import UnusedErrors, comparisons, surely_positive
from calib.core.numerics.chances import UNLIKELY
from calib.core.robots.accuracy_of_files import Accuracy, PoseUse

MORE = 1.25
"""A claim holds if errors at unused poses are at most this many times the claimed ones."""
_HALF = 0.5  # a joint's motion is reported if it is less than this part of the range between its limits


class Benefit(Enum):
    """The effect of a calibration on unused poses."""

    BETTER = "better"
    WORSE = "worse"
    NONE = "neither better nor worse"


@dataclass(frozen=True)
class ErrorElsewhere:
    """Expected error at other poses [m]: `rms`, 95 % limit, and `times`, its ratio to that at the measured poses."""

    rms: float
    limit95: float
    times: float


@dataclass(frozen=True)
class SeenUnused:
    """Errors of the robot at poses that had no part in the fit.

    Attributes:
        accuracy: Error at all of them.
        without_outliers: Error without a few outliers, if it decides about the claim; else None.
        holds: Whether the claim holds there.
    """

    accuracy: Accuracy
    without_outliers: Accuracy | None
    holds: bool


@dataclass(frozen=True)
class Claim:
    """The claim of a calibration.

    Attributes:
        at_measured_poses: Error at poses like the measured ones. `before` is NaN if only places were free, which were
            found from all poses, left-out ones included.
        unused: The errors at poses that had no part in the fit.
        gain: Change of the errors at these poses.
        region: Poses of the claim, in words.
        joints_moved_little: Joints that moved through less than half of their range, and the part.
        find_known: Function that returns `rms`; this is slow, and takes half as long as the rest of a verdict.
    """

    at_measured_poses: Accuracy
    unused: tuple[SeenUnused, ...]
    gain: Benefit
    region: str
    joints_moved_little: tuple[str, ...]
    find_known: Callable[[], float] = field(compare=False, repr=False)

    @cached_property
    def rms(self) -> float:
        """Root mean square uncertainty of positions at these poses, each by the readings of all others [m].

        NaN for a claim on other readings.
        """
        return self.find_known()

    def error_at(self, known: float) -> ErrorElsewhere:
        """Return the expected error at poses whose positions have the root mean square uncertainty `known` [m]."""
        rms = self.at_measured_poses.rms
        times = float(np.sqrt(1.0 + max(known**2 - self.rms**2, 0.0) / rms**2))
        return ErrorElsewhere(times * rms, times * self.at_measured_poses.limit95, times)

    @property
    def contains(self) -> Contributions:
        """Contributions that the numbers contain."""
        return contributions_to(Uncertainty.CLAIM)

    @property
    def holds(self) -> bool:
        """Whether the errors at unused poses are as claimed."""
        return all(seen.holds for seen in self.unused)

    @property
    def words(self) -> str:
        """The claim as a sentence."""
        measured = self.at_measured_poses
        subject = "The tool is" if measured.is_position else f"{measured.readings.capitalize()} are"
        off = f"off by {measured.in_unit(measured.rms)} RMS"
        if np.isfinite(measured.limit95):
            off = f"within {measured.in_unit(measured.limit95)} of where the model says, 95 % of the time"
        shown = "".join(
            f" At {seen.accuracy.pose_words}: RMS {seen.accuracy.in_unit(seen.accuracy.rms)}, {kept.in_unit(kept.rms)}"
            " without outliers."
            for seen in self.unused
            if (kept := seen.without_outliers)
        )
        narrow = (
            " Elsewhere errors may be larger; joints that moved through less than half of their range:"
            f" {listing(self.joints_moved_little)}."
        )
        narrow = narrow if self.joints_moved_little else ""
        return f"{subject} {off}, {self.region} (each predicted from the others).{narrow}{shown}"

    def to_dict(self) -> dict[str, object]:
        """Return the entry of `result.json`; errors in the unit of errors."""
        measured, unit = self.at_measured_poses, ERROR_UNIT[self.at_measured_poses.dimension]
        return {
            "part": measured.part,
            "unit": unit,
            "dimension": measured.dimension,
            "is_position": measured.is_position,
            "readings": measured.readings,
            "limit95": in_unit(measured.limit95, unit),
            "rms": in_unit(measured.rms, unit),
            "rms_before": in_unit(measured.before, unit) if np.isfinite(measured.before) else None,
            "n_poses": measured.n_poses,
            "known": in_unit(self.rms, unit),
            "region": self.region,
            "joints_moved_little": list(self.joints_moved_little),
            "not_used": [
                {
                    "poses": seen.accuracy.poses.name.lower(),
                    "n_poses": seen.accuracy.n_poses,
                    "rms": in_unit(seen.accuracy.rms, unit),
                    "rms_without_outliers": in_unit(kept.rms, unit) if (kept := seen.without_outliers) else None,
                    "holds": seen.holds,
                }
                for seen in self.unused
            ],
            "holds": self.holds,
            "gain": self.gain.value,
        }

    @classmethod
    def from_dict(cls, entry: Mapping[str, Any]) -> Self:
        """Return the claim of a `result.json` entry, NaN where not stored; KeyError, TypeError, ValueError if bad."""
        dimension: Dimension = entry["dimension"]
        is_position = bool(entry["is_position"])

        def error(number: float | None) -> float:
            return np.nan if number is None else from_unit(float(number), ERROR_UNIT[dimension])

        def seen(of: Mapping[str, Any], poses: PoseUse) -> Accuracy:
            before, rms, limit95 = (error(of.get(key)) for key in ("rms_before", "rms", "limit95"))
            n_poses, part = int(of["n_poses"]), str(entry["part"])
            readings = str(entry.get("readings", f"readings ({part})"))
            return Accuracy(poses, n_poses, part, dimension, before, rms, limit95, is_position, readings)

        def unused(other: Mapping[str, Any]) -> SeenUnused:
            accuracy, kept = seen(other, PoseUse[other["poses"].upper()]), error(other.get("rms_without_outliers"))
            return SeenUnused(accuracy, None if np.isnan(kept) else replace(accuracy, rms=kept), bool(other["holds"]))

        return cls(
            seen(entry, PoseUse.ONE_BY_ONE),
            tuple(map(unused, entry["not_used"])),
            Benefit(entry["gain"]),
            str(entry["region"]),
            tuple(entry["joints_moved_little"]),
            partial(error, entry["known"]),
        )


def claim_of(fit: Fit) -> Claim | None:
    """Return the claim of a fit; None for computed data, and where no pose can be predicted."""
    predicted = None if fit.computed else leave_one_out_errors(fit)
    if predicted is None:
        return None
    measured = accuracy_of_errors(predicted, PoseUse.ONE_BY_ONE)
    if np.all(fit.unknowns.placement):
        measured = replace(measured, before=float("nan"))
    seen = list[SeenUnused]()
    for compared in comparisons(fit):
        accuracy = compared.accuracy
        if (accuracy.part, accuracy.dimension) == (measured.part, measured.dimension):
            more = accuracy.rms > _most(fit, measured, accuracy) * measured.rms
            kept = _accuracy_without_outliers(fit, measured, compared) if more else None
            seen.append(SeenUnused(accuracy, kept, not more or kept is not None))
    region = f"at poses like the {fit.identification.data.n_poses} measured"
    return Claim(measured, tuple(seen), _gain(fit, predicted), region, _narrow(fit), partial(_known, fit, measured))


def _accuracy_without_outliers(fit: Fit, measured: Accuracy, compared: UnusedErrors) -> Accuracy | None:
    """Return the error at unused poses without a few outliers, if the claim holds for them; else None."""
    where, errors = compared.accuracy.poses, compared.errors
    outliers = findings.validation_outliers if where is PoseUse.VALIDATION else findings.outliers
    gone = {outlier.pose for outlier in outliers(fit)}
    if not 0 < len(gone) <= (1.0 - COVERED) * len(errors.data):
        return None
    kept = np.setdiff1d(np.arange(len(errors.data)), list(gone))
    accuracy = accuracy_of_errors(errors_at_visits(errors, kept), where)
    lengths = np.sqrt(errors.squares("after"))
    beyond = int(np.sum(lengths > MORE * measured.limit95))
    few = beyond == 0 or scipy.special.bdtrc(beyond - 1, len(lengths), 1.0 - COVERED) >= UNLIKELY
    return accuracy if few and accuracy.rms <= _most(fit, measured, accuracy) * measured.rms else None


def unlike_measured(fit: Fit) -> BoolArray:
    """Return a mask of validation visits that are unlike the measured ones by the module docstring, (n_visits,)."""
    if fit.validation is None:
        return np.zeros(0, dtype=bool)
    used, other = fit.identification.data, fit.validation.data
    if used.setups is None or other.setups is None:
        return is_apart(other.joints, used.joints)
    return is_apart(other.joints, used.joints) | ~np.isin(other.setups, used.setups)


def is_elsewhere(unlike: BoolArray) -> bool:
    """Return whether more visits are unlike the measured ones (mask (n_visits,)) than chance explains."""
    return bool(scipy.special.bdtrc(np.sum(unlike) - 1, len(unlike), APART) < UNLIKELY) if np.any(unlike) else False


def known_at_used(fit: Fit) -> float:
    """Return the root mean square uncertainty of positions at the used poses [m]."""
    return float(np.sqrt(np.mean(fit.identification_uncertainty.reported_distance**2)))


def _known(fit: Fit, measured: Accuracy) -> float:
    return math.hypot(known_at_used(fit), rms_shift_left_out(fit)) if measured.is_position else math.nan


def _most(fit: Fit, measured: Accuracy, seen: Accuracy) -> float:
    coordinates = 1 if fit.statistics.shared_scatter is not None else len(fit.identification.main_part.axes)
    bound = scipy.special.fdtri(coordinates * seen.n_poses, coordinates * measured.n_poses, 1.0 - UNLIKELY)
    return max(MORE, float(np.sqrt(bound)))


def _gain(fit: Fit, predicted: ErrorSet) -> Benefit:
    compared = comparisons(fit)
    worse, better = any(each.worse for each in compared), any(each.better for each in compared)
    if not compared:
        change = predicted.squares("after") - predicted.squares("before")
        worse, better = surely_positive(change), surely_positive(-change)
    return Benefit.WORSE if worse else Benefit.BETTER if better else Benefit.NONE


def _narrow(fit: Fit) -> tuple[str, ...]:
    """Joints that moved through less than half of their range, and the part that they moved through."""
    robot = fit.nominal
    lower, upper = robot.urdf.limits(robot.joint_names)
    parts = np.ptp(fit.identification.data.joints, axis=0) / (upper - lower)
    known = np.isfinite(upper - lower)
    names = zip(robot.joint_names, parts, known, strict=True)
    return tuple(f"{name} {100 * part:.0f} %" for name, part, limited in names if limited and part < _HALF)
