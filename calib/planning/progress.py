"""What is known after the poses measured so far: as an object, as text and as data for programs.

Errors at poses that were judged before they were fitted, and how sure their root mean square is.

The predicted error counts noise alone. What the model leaves out shows only where the robot is measured and the fit has
not been: every new pose is predicted by the fit of the poses before it, then fitted (Dawid's prequential principle).
The last poses are the ones that tell about the present fit: the last `MOST` since the predicted error met the goal; or,
while these are fewer than `LEAST`, the last `LAST` of all. With s_k the mean square error at pose k and m their mean
over n poses, m is nearly g chi^2_h of the same mean and variance,

    h = 2 n m^2 / (var(s) (1 + 8 / n))        at most 3 n, which normal errors alike in all directions have
    95 % interval of sqrt(E s)  sqrt(m h / chi^2_h(0.975)) to sqrt(m h / chi^2_h(0.025))

The variance of few skewed numbers comes out too small more often than not; with the factor behind it, the upper end
lies above the truth in 95 of 100 cases also where errors lie along one line or have heavy tails.

When it fails. Poses that are alike tell about each other's neighbourhood only; the interval takes them as independent.

Reference: dawid1984.
"""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from calib.base.arrays import ReadOnlyArrays
from calib.base.errors import CalibrationError
from calib.base.units import DISPLAY_UNIT, display_scale, millimetres
from calib.base.words import as_data, counted
from calib.data.measurements import Measurements
from calib.fitting.fit import errors_on
from calib.fitting.fitted import Fit
from calib.planning.next_pose import NextPose
from calib.robots.robot import Robot
from calib.rows.candidates import near_measured
from calib.rows.prediction import RootMeanSquare

UNKNOWN = RootMeanSquare(math.inf, 0.0, math.inf)
"""Of a distance that nothing has told yet."""
LAST = 20
"""Poses that tell about the present fit while none has promised the goal yet."""
MOST = 40
"""Poses that tell about it at most once fits promise the goal."""
LEAST = 10
"""Fewer tell nothing."""
_TOO_SMALL = 8.0


@dataclass(frozen=True, eq=False, repr=False)
class Progress(ReadOnlyArrays):
    """What is known after the poses measured so far.

    Attributes:
        robot: The nominal robot.
        goal: Root mean square position error to reach [m].
        n_poses: Poses measured.
        n_candidates: Poses that the goal is about, and to choose from.
        fit: The calibration of all of them; None where they do not suffice yet.
        obstacle: Why they do not.
        predicted: Error over the candidates that noise leaves, by the covariance of the fit.
        unseen: Error at the last poses, each judged by a fit that had not seen it; noise of the readings included.
            Where nobody reads positions: the predicted error, times how much larger the errors of readings were there
            than promised.
        n_unseen: How many poses that is about.
        n_settled: How many of them were judged by fits whose predicted error met the goal.
        next_pose: Where to measure next; None where all candidates are measured.
        seconds: Duration of this update.
    """

    robot: Robot
    goal: float
    n_poses: int
    n_candidates: int
    fit: Fit | None
    obstacle: CalibrationError | None
    predicted: RootMeanSquare
    unseen: RootMeanSquare
    n_unseen: int
    n_settled: int
    next_pose: NextPose | None
    seconds: float

    def __repr__(self) -> str:
        return f"<Progress after {counted(self.n_poses, 'pose')}: {'stop' if self.stop else 'go on'}>"

    def __str__(self) -> str:
        return self.report()

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(self.report())}</pre>"

    @property
    def stop(self) -> bool:
        """Whether the goal holds with 95 %: by the predicted error, and at poses that no fit had seen."""
        converged = self.fit is not None and self.fit.converged
        return converged and self.predicted.high95 <= self.goal and self.unseen.high95 <= self.goal

    @property
    def out_of_reach(self) -> bool:
        """Whether more poses cannot help: noise leaves less than the goal, but fits that say so are further off."""
        return self.predicted.high95 <= self.goal < self.unseen.low95 and self.n_settled == self.n_unseen

    def report(self) -> str:
        """Return it as text."""
        head = f"{counted(self.n_poses, 'pose')} ({self.seconds:.2f} s)"
        if self.fit is None:
            lines = [f"not yet a calibration: {self.obstacle}"]
        else:
            lines = [
                f"predicted error  {_shown(self.predicted)} over {self.n_candidates} candidates",
                f"unseen error     {self._unseen_shown()}",
            ]
        goal = f"goal {millimetres(self.goal):.4g} mm: {self._verdict()}"
        return "\n  ".join([head, *lines, goal, *self._next()])

    def to_dict(self) -> dict[str, object]:
        """Return it as data for JSON, in mm and degrees; None where not known."""
        following = self.next_pose
        return as_data(
            {
                "robot": self.robot.path,
                "poses": self.n_poses,
                "goal_mm": millimetres(self.goal),
                "stop": self.stop,
                "out_of_reach": self.out_of_reach,
                "obstacle": None if self.obstacle is None else str(self.obstacle),
                "predicted_mm": _as_data(self.predicted),
                "unseen_mm": _as_data(self.unseen) | {"poses": self.n_unseen},
                "next": None
                if following is None
                else {
                    "pose": following.name,
                    "checks": following.checks,
                    "joints": {name: {"value": value, "unit": unit} for name, value, unit in self._joints(following)},
                    "way": following.way,
                    "predicted_mm": {
                        "before": millimetres(following.before),
                        "after": millimetres(following.after),
                    },
                },
                "seconds": self.seconds,
            }
        )

    def _verdict(self) -> str:
        if self.stop:
            return "STOP: it holds with 95 %"
        if self.out_of_reach:
            return (
                "not reached, and more poses will not do it: unseen errors are beyond what noise explains; look for"
                " what the model leaves out (calib fit --terms auto), or for noise above the goal"
            )
        return "not yet"

    def _unseen_shown(self) -> str:
        if not math.isfinite(self.unseen.high95):
            return f"too few poses yet that no fit had seen ({self.n_unseen})"
        where = f"the last {self.n_unseen} poses, each judged before it was fitted"
        if reads_positions(self.robot):
            return f"{_shown(self.unseen)} at {where}"
        times = self.unseen.value / self.predicted.value
        return f"{_shown(self.unseen)}: readings were off {times:.2g} times as much as promised at {where}"

    def _next(self) -> list[str]:
        following = self.next_pose
        if self.stop or following is None:
            return [] if self.stop else ["every candidate that can be reached is measured"]
        joints = ", ".join(f"{name} {value:.4f} {unit}" for name, value, unit in self._joints(following))
        help_ = "brings in what is missing"
        if following.checks:
            help_ = "is drawn at random, to check what is predicted"
        elif math.isfinite(following.before) and following.before > 0:
            help_ = f"lowers the predicted error by {100 * (1 - following.after / following.before):.2g} %"
        return [f"next: pose {following.name}, which {help_}", f"  {joints}"]

    def _joints(self, following: NextPose) -> list[tuple[str, float, str]]:
        """Name, value and unit of each joint."""
        named = zip(self.robot.joint_names, following.joints, strict=True)
        told = ((name, value, self.robot.mechanism.dimensions[name]) for name, value in named)
        return [(name, float(value) * display_scale(kind), DISPLAY_UNIT[kind]) for name, value, kind in told]


def _shown(error: RootMeanSquare) -> str:
    value, low, high = (f"{millimetres(one):.3g}" for one in (error.value, error.low95, error.high95))
    return f"{value} mm RMS (95 %: {low} to {high})"


def _as_data(error: RootMeanSquare) -> dict[str, object]:
    return {
        "rms": millimetres(error.value),
        "low95": millimetres(error.low95),
        "high95": millimetres(error.high95),
    }


def reads_positions(robot: Robot) -> bool:
    """Whether an instrument reads positions of a target."""
    return any(part.is_position for one in robot.instruments for part in one.parts)


def squares_of(fit: Fit, data: Measurements) -> list[float]:
    """Return the mean square position error of each pose that a fit has not seen, in order of appearance [m^2].

    Where no instrument reads positions: the mean square error of its readings over the variance that the fit promises.

    Args:
        fit: The fit.
        data: Measurements that it has not seen; those that repeat poses that it has are left out.
    """
    new = data[~near_measured(data.joints, fit.identification.data.joints)]
    if not len(new):
        return []
    errors = errors_on(fit.placed, fit.robot, new)
    total, count = np.zeros(new.n_poses), np.zeros(new.n_poses)
    if not reads_positions(fit.robot):
        rows = fit.whitened(errors)[1]
        read = rows.layout.group >= 0
        by_parameter = (rows.jacobian / fit.unknowns.scales)[read]
        variance = 1.0 + np.sum((by_parameter @ fit.statistics.covariance) * by_parameter, axis=1)
        np.add.at(total, rows.layout.pose_of_row[read], rows.residuals[read] ** 2 / variance)
        np.add.at(count, rows.layout.pose_of_row[read], 1.0)
    for one, part, own in errors.parts():
        if part.is_position:
            pose = new.pose_numbers[new.readings[one.name].visits]
            np.add.at(total, pose, np.nansum(errors.after[one.name][:, own] ** 2, axis=1))
            np.add.at(count, pose, 1.0)
    squares: list[float] = (total[count > 0] / count[count > 0]).tolist()
    return squares


def unseen_rms(squares: Sequence[float]) -> RootMeanSquare:
    """Return the root mean square of these mean square errors [m^2], with its interval; unknown of too few."""
    n = len(squares)
    if n < LEAST:
        return UNKNOWN
    mean, variance = float(np.mean(squares)), float(np.var(squares, ddof=1))
    variance *= 1.0 + _TOO_SMALL / n
    freedom = min(3.0 * n, 2.0 * n * mean**2 / variance) if variance > 0 else 3.0 * n
    low, high = np.sqrt(mean * freedom / scipy.special.chdtri(freedom, [0.025, 0.975]))
    return RootMeanSquare(float(np.sqrt(mean)), float(low), float(high))
