"""Accuracy after the poses measured so far, with an interval of the error at poses predicted before they were fitted.

Errors of the model show only at measured poses that the fit has not used. So every new pose is first predicted by the
fit of the poses before it, and then fitted (Dawid's prequential principle). Only the last poses test the present fit:
at most `MOST`, measured since the part of the predicted error that more poses lower met the goal. While there
are fewer than `LEAST` such poses, the last `LAST` of all poses count. Let s_k be the mean square error at pose k, and m
its mean over n poses. m is approximately distributed as g chi^2_h with the same mean and variance,

    h = 2 n m^2 / (var(s) (1 + 8 / n))        at most 3 n, the value for isotropic normal errors
    95 % interval of sqrt(E s)  sqrt(m h / chi^2_h(0.975)) to sqrt(m h / chi^2_h(0.025))

The sample variance of few skewed numbers is too small more often than not. With the factor (1 + 8 / n), the upper end
is above the truth in 95 of 100 cases, also where errors lie along one line or have heavy tails.

When it fails. Similar poses test the fit in one neighbourhood only; the interval takes them as independent.

Reference: dawid1984.
"""

from __future__ import annotations

import html
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray, ReadOnlyArrays
from calib.core.base.errors import CalibrationError
from calib.core.base.units import DISPLAY_UNIT, in_unit, millimetres, quantity_text
from calib.core.base.words import as_data, count_noun
from calib.core.data.measurements import Measurements
from calib.core.fitting.fit import errors_on
from calib.core.fitting.fitted import Fit
from calib.core.instruments.kind import Comparison
from calib.core.numerics import linalg
from calib.core.robots.robot import Robot
from calib.core.rows.observed import views_of_instruments
from calib.planning.next_pose import NextPose
from calib.planning.predicted_error import RootMeanSquare
from calib.shared.candidates import near_measured

UNKNOWN = RootMeanSquare(math.inf, 0.0, math.inf)
"""An unknown distance."""
LAST = 20
"""The error of this many last poses is judged while more poses still lower the predicted error."""
MOST = 40
"""The error of at most this many last poses is judged once what more poses lower meets the goal."""
LEAST = 10
"""Least number of poses for an error."""
_TOO_SMALL = 8.0


@dataclass(frozen=True, eq=False, repr=False)
class Progress(ReadOnlyArrays):
    """Accuracy after the poses measured so far.

    Attributes:
        robot: The nominal robot.
        goal: Root mean square position error to reach [m].
        n_poses: Number of measured poses.
        n_candidates: Number of reachable candidates: the goal is about them, and the next pose is one of them.
        fit: The calibration from all measured poses; None while they do not suffice.
        reason_without_fit: Reason why there is no fit yet.
        predicted: Error over the candidates that the fit predicts.
        lowered: Part of it that more poses lower: of parameters and undecided terms, without errors of joints.
        unseen: Error at the last poses, each predicted by a fit of the poses before it, including noise of readings;
            without measured positions, estimated from the errors of the readings.
        n_unseen: Number of these poses.
        n_settled: Number of these that were predicted by fits of which `lowered` met the goal.
        next_pose: Pose to measure next; None if all candidates are measured.
        seconds: Duration of this update.
    """

    robot: Robot
    goal: float
    n_poses: int
    n_candidates: int
    fit: Fit | None
    reason_without_fit: CalibrationError | None
    predicted: RootMeanSquare
    lowered: RootMeanSquare
    unseen: RootMeanSquare
    n_unseen: int
    n_settled: int
    next_pose: NextPose | None
    seconds: float

    def __repr__(self) -> str:
        return f"<Progress after {count_noun(self.n_poses, 'pose')}: {'stop' if self.stop else 'go on'}>"

    def __str__(self) -> str:
        return self.report()

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(self.report())}</pre>"

    @property
    def stop(self) -> bool:
        """Whether the goal is met with 95 %, by the predicted error and by the errors at unseen poses."""
        converged = self.fit is not None and self.fit.converged
        return converged and self.predicted.high95 <= self.goal and self.unseen.high95 <= self.goal

    @property
    def out_of_reach(self) -> bool:
        """Whether more poses cannot help: what they lower meets the goal, but the unseen error does not."""
        return self.lowered.high95 <= self.goal < self.unseen.low95 and self.n_settled == self.n_unseen

    @property
    def poses_left(self) -> int | None:
        """Estimated number of further poses for the goal; None if unknown.

        The part of the predicted error that more poses lower falls like the inverse root of their number, or faster
        with well-chosen poses; then at least `LEAST` poses must be predicted by fits of which it meets the goal.
        """
        if self.stop:
            return 0
        if self.fit is None or self.out_of_reach or not math.isfinite(self.predicted.high95):
            return None
        stays = self.predicted.high95**2 - self.lowered.high95**2
        if stays >= self.goal**2:
            return None
        more = max(0, math.ceil(self.n_poses * (self.lowered.high95**2 / (self.goal**2 - stays) - 1)))
        if not more and self.n_settled >= LEAST:
            return None
        return more + LEAST - (0 if more else self.n_settled)

    def report(self) -> str:
        """Return the progress as text."""
        head = f"{count_noun(self.n_poses, 'pose')} ({self.seconds:.2f} s)"
        return "\n  ".join([head, *self.error_lines(), *self._next()])

    def error_lines(self) -> list[str]:
        """Return the lines about the errors and the goal."""
        if self.fit is None:
            lines = [f"not yet a calibration: {self.reason_without_fit}"]
        else:
            where = f"over {self.n_candidates} candidates"
            if self.lowered != self.predicted:  # errors of joints are another part
                where += f"; more poses lower {quantity_text(self.lowered.value, 'mm')} of it"
            lines = [
                f"predicted error  {_format_error(self.predicted)} {where}",
                f"unseen error     {self._unseen_shown()}",
            ]
        return [*lines, f"goal {quantity_text(self.goal, 'mm', '.4g')}: {self._verdict()}"]

    def to_dict(self) -> dict[str, object]:
        """Return the progress as data for JSON, in mm and degrees; unknown numbers are None."""
        following = self.next_pose
        return as_data(
            {
                "robot": self.robot.path,
                "poses": self.n_poses,
                "goal_mm": millimetres(self.goal),
                "stop": self.stop,
                "poses_left": self.poses_left,
                "out_of_reach": self.out_of_reach,
                "obstacle": None if self.reason_without_fit is None else str(self.reason_without_fit),
                "predicted_mm": _as_data(self.predicted),
                "lowered_mm": _as_data(self.lowered),
                "unseen_mm": _as_data(self.unseen) | {"poses": self.n_unseen},
                "next": None
                if following is None
                else {
                    "pose": following.name,
                    "checks": following.checks,
                    "joints": {name: {"value": value, "unit": unit} for name, value, unit in self._joints(following)},
                    "way": following.travel,
                    "predicted_mm": {when: millimetres(getattr(following, when)) for when in ("before", "after")},
                },
                "seconds": self.seconds,
            }
        )

    def _verdict(self) -> str:
        if self.stop:
            return "STOP: it is met, with 95 % confidence"
        if self.out_of_reach:
            return (
                "not reached, and more poses will not help: what they lower meets the goal, unseen errors do not;"
                " the model leaves something out (calib fit --terms auto), or the noise of a reading is above the goal"
            )
        noise = None if self.fit is None else self.fit.first_noise
        if noise is not None and noise.group.part.is_position:
            scatter = float(np.sqrt(3.0)) * noise.sigma
            # the lower 95 % limit of the scatter
            if scatter * np.sqrt(noise.freedom / scipy.special.chdtri(noise.freedom, 0.025)) > self.goal:
                shown = f"{quantity_text(scatter, 'mm')} RMS"
                return f"not yet; readings that scatter by {shown} about the model can never show that the goal is met"
        return "not yet"

    def _unseen_shown(self) -> str:
        if not math.isfinite(self.unseen.high95):
            return f"too few unseen poses yet ({self.n_unseen})"
        shown = "" if reads_positions(self.robot) else ", as far as readings show positions"
        where = f"the last {self.n_unseen} poses, each predicted before it was fitted"
        return f"{_format_error(self.unseen)} at {where}{shown}"

    def _next(self) -> list[str]:
        following = self.next_pose
        if self.stop or self.out_of_reach:
            return []
        if following is None:
            return ["every candidate that can be reached is measured; give others"]
        joints = ", ".join(f"{name} {value:.4f} {unit}" for name, value, unit in self._joints(following))
        help_ = "determines more of what is unknown"
        if following.checks:
            help_ = "is drawn at random, to check the prediction"
        elif math.isfinite(following.before) and following.before > 0:
            help_ = f"lowers the predicted error by {100 * (1 - following.after / following.before):.2g} %"
        return [f"next: pose {following.name}, which {help_}", f"  {joints}"]

    def _joints(self, following: NextPose) -> list[tuple[str, float, str]]:
        named = zip(self.robot.joint_names, following.joints, strict=True)
        stated = ((name, value, self.robot.mechanism.dimensions[name]) for name, value in named)
        return [(name, in_unit(float(value), DISPLAY_UNIT[kind]), DISPLAY_UNIT[kind]) for name, value, kind in stated]


def _format_error(error: RootMeanSquare) -> str:
    low, high = (f"{millimetres(length):.3g}" for length in (error.low95, error.high95))
    return f"{quantity_text(error.value, 'mm')} RMS (95 %: {low} to {high})"


def _as_data(error: RootMeanSquare) -> dict[str, object]:
    return {
        "rms": millimetres(error.value),
        "low95": millimetres(error.low95),
        "high95": millimetres(error.high95),
    }


def reads_positions(robot: Robot) -> bool:
    """Whether an instrument reads positions of a target."""
    return any(part.is_position for instrument in robot.instruments for part in instrument.parts)


def squares_of(fit: Fit, data: Measurements) -> list[float]:
    """Return the mean square position error of each new pose, in order of appearance [m^2].

    Without instruments that read positions, position errors are estimated from the errors of the readings.

    Args:
        data: Measurements that the fit has not used; visits that repeat poses of the fit are skipped.
    """
    new = data[~near_measured(data.joints, fit.identification.data.joints)]
    if not len(new):
        return []
    total, count = np.zeros(new.n_poses), np.zeros(new.n_poses)
    for name, squares in (_position_squares if reads_positions(fit.robot) else _shown_squares)(fit, new):
        pose = new.pose_numbers[new.readings[name].visits]
        np.add.at(total, pose, np.nan_to_num(squares))
        np.add.at(count, pose, np.isfinite(squares).astype(float))
    means: list[float] = (total[count > 0] / count[count > 0]).tolist()
    return means


def _position_squares(fit: Fit, new: Measurements) -> Iterator[tuple[str, FloatArray]]:
    """Squared error of each measured position, (n,) [m^2], by instrument."""
    errors = errors_on(fit.placed, fit.robot, new)
    for instrument, part, rows in errors.parts():
        if part.is_position:
            yield instrument.name, np.nansum(errors.after[instrument.name][:, rows] ** 2, axis=1)


def _shown_squares(fit: Fit, new: Measurements) -> Iterator[tuple[str, FloatArray]]:
    """Squared position error behind each reading, (n,) [m^2], by instrument; NaN if it shows none.

    The smallest motion [dp; L dw] of the target explains the reading's error, with the robot's characteristic length L,
    along the directions that the reading determines; the other directions count with the same size.
    """
    robot = fit.robot
    configurations = robot.assemble(new.joints, labels=new.labels, context=new.conditions)
    for name, seen in views_of_instruments(robot, configurations, new.readings).items():
        readings, instrument = new.readings[name], robot.instrument(name)
        compared = instrument.compare(seen, robot.values[robot.unknowns[name]], readings)
        if not isinstance(compared, Comparison):
            continue
        read = np.isfinite(compared.residuals).all(axis=1)
        by_motion = compared.by_twist[read] / np.repeat([1.0, robot.mechanism.length], 3)
        motion = np.einsum("nxr,nr->nx", linalg.pinv(by_motion), compared.residuals[read])
        squares = np.full(len(readings), np.nan)
        n_seen = np.clip(linalg.matrix_rank(by_motion), 0, 3)
        squares[read] = np.where(n_seen > 0, 3.0 / np.maximum(n_seen, 1) * np.sum(motion**2, axis=1), np.nan)
        yield name, squares


def unseen_rms(squares: Sequence[float]) -> RootMeanSquare:
    """Return the root mean square of mean square errors [m^2] with its interval; unknown if there are too few."""
    n = len(squares)
    if n < LEAST:
        return UNKNOWN
    mean, variance = float(np.mean(squares)), float(np.var(squares, ddof=1))
    variance *= 1.0 + _TOO_SMALL / n
    freedom = min(3.0 * n, 2.0 * n * mean**2 / variance) if variance > 0 else 3.0 * n
    low, high = np.sqrt(mean * freedom / scipy.special.chdtri(freedom, [0.025, 0.975]))
    return RootMeanSquare(float(np.sqrt(mean)), float(low), float(high))
