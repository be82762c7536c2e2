"""Calibration while measuring: refit after every pose, report accuracy and the next pose, and say when to stop.

    watch = calib.Watch(robot, "0.1 mm", candidates=candidates)
    while not (progress := watch.update(measured_so_far())).stop:
        move_to(progress.next_pose.joints)

The goal is a root mean square position error over the candidates. It holds with 95 % if the upper ends of two 95 %
intervals are below it: of the error that the fit predicts (`Fit.uncertainty`), and of the errors at the last poses,
each predicted before it was fitted (`calib.planning.progress`). The second contains the noise of readings, so a goal
below that noise never holds.

Readings of distances or angles count by the position errors that they show.
"""

from __future__ import annotations

import time
from bisect import bisect_left
from pathlib import Path

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import (
    CalibrationError,
    DataError,
    InputError,
    NotConvergedError,
    NotIdentifiableError,
    UnreachablePoseError,
)
from calib.core.base.files import read_text
from calib.core.base.units import quantity
from calib.core.calibrating.calibrate import calibrate
from calib.core.data.in_memory import PosesLike, as_poses
from calib.core.data.measurement_files import read_measurements
from calib.core.data.measurements import Measurements
from calib.core.fitting.fitted import Fit
from calib.core.fitting.settings import Settings
from calib.core.robots.joint_errors import term_columns
from calib.core.robots.loading import RobotLike, as_robot
from calib.core.robots.robot import Robot
from calib.planning.next_pose import NextPose, next_pose
from calib.planning.pose_sampling import sample
from calib.planning.predicted_error import RootMeanSquare, predicted_rms
from calib.planning.progress import LAST, LEAST, MOST, UNKNOWN, Progress, squares_of, unseen_rms
from calib.shared.candidates import require_free
from calib.shared.pose_check import free_poses

CANDIDATES = 300
"""Number of sampled candidates if none are given."""
_MOST_BAD = 100  # skipped lines; with more, the file is probably the wrong one


class Watch:
    """A robot that is being measured; see the module docstring.

    Args:
        robot: The nominal robot.
        goal: Root mean square position error to reach, such as `0.1 mm`, or a number [m].
        candidates: Poses of the goal, from which the next pose is chosen, or joint values (n, n_actuated) [m or rad];
            default: sampled over the joint limits.
        sigma: Noise of one measured position per axis [m]; default: the description's.
        seed: Seed of sampled candidates, and of poses to check with.

    Attributes:
        candidates: Candidates without collisions.
        notes: Remarks on the other candidates, and on missing checks.

    Raises:
        InputError: The goal is not a positive length.
        DataError: No candidates can be sampled.
    """

    def __init__(
        self,
        robot: RobotLike,
        goal: str | float,
        *,
        candidates: PosesLike | None = None,
        sigma: float | None = None,
        seed: int = 0,
    ) -> None:
        self.robot = robot = as_robot(robot)
        require_free(robot)
        self.goal = quantity(goal, "length", "goal")
        if self.goal <= 0:
            raise InputError(f"goal {goal}: must be a positive length, such as 0.1 mm")
        candidates = sample(robot, CANDIDATES, seed) if candidates is None else as_poses(robot, candidates)
        self.candidates, self.notes = free_poses(robot, candidates)
        self._settings, self._seed = Settings(sigma), seed
        self._data: Measurements | None = None
        self._fit: Fit | None = None
        self._passive: FloatArray | None = None  # of the candidates at the last fit; the next fit starts there
        self._n_reached = len(self.candidates)  # number that the present fit reaches
        self._squares: list[float] = []
        self._met = False  # whether the part of the predicted error that more poses lower meets the goal
        self._settled = 0  # number of the last squares from fits of which it met the goal

    def update(self, data: Measurements | None = None) -> Progress:
        """Predict the new poses, then fit all, and return the progress.

        Args:
            data: All measurements so far, beginning with those of the last update; otherwise everything starts again.
                None: nothing is measured yet.

        Raises:
            UnreachablePoseError: A measured pose cannot be assembled.
            DataError: Two candidates are equal.
            NotIdentifiableError: The candidates do not determine the positions at them.
        """
        started = time.perf_counter()
        obstacle: CalibrationError | None = DataError("nothing is measured")
        if data is not None and len(data):
            self._judge(data)
            self._fit, obstacle = self._try_fit(data)
            self._data = data
        predicted, lowered = self._predict_errors(self._fit)
        n_unseen = min(self._settled, MOST) if self._settled >= LEAST else min(len(self._squares), LAST)
        self._met = lowered.high95 <= self.goal
        return Progress(
            robot=self.robot,
            goal=self.goal,
            n_poses=0 if data is None else data.n_poses,
            n_candidates=self._n_reached,
            fit=self._fit,
            reason_without_fit=obstacle,
            predicted=predicted,
            lowered=lowered,
            unseen=unseen_rms(self._squares[-n_unseen:] if n_unseen else []),
            n_unseen=n_unseen,
            n_settled=min(self._settled, n_unseen),
            next_pose=self._next(data),
            seconds=time.perf_counter() - started,
        )

    def _judge(self, data: Measurements) -> None:
        """Predict the new poses by the last fit; of many first poses, predict the last by a fit of the others."""
        before, known = self._data, 0
        if before is not None:
            known = n = len(before)
            if len(data) < n or data.names[:n] != before.names or not np.array_equal(data.joints[:n], before.joints):
                self._fit, self._squares, known = None, [], 0  # the measurements are not the earlier ones and more
        judge, met = self._fit, self._met
        if judge is None:
            known = int(np.sum(data.pose_numbers < data.n_poses - LAST))
            judge = self._try_fit(data[:known])[0] if known else None
            met = self._predict_errors(judge)[1].high95 <= self.goal
        if judge is not None and known < len(data):
            new = squares_of(judge, data[known:])
            self._squares += new
            self._settled = self._settled + len(new) if met else 0

    def _try_fit(self, data: Measurements) -> tuple[Fit | None, CalibrationError | None]:
        try:
            return calibrate(self.robot, data, None, self._settings), None
        except (DataError, NotIdentifiableError, NotConvergedError) as error:  # too few poses, all on one line
            return None, error

    def _predict_errors(self, fit: Fit | None) -> tuple[RootMeanSquare, RootMeanSquare]:
        if fit is None:
            return UNKNOWN, UNKNOWN
        columns = term_columns(fit.robot, self.candidates.joints, self.candidates.conditions)
        closed = fit.robot.close(self.candidates.joints, self._passive, columns)
        self._passive = closed.passive
        reached = np.flatnonzero(closed.ok)
        self._n_reached = len(reached)
        if not len(reached):
            return UNKNOWN, UNKNOWN
        known, poses = fit.uncertainty, self.candidates
        near, conditions = closed.passive[reached], poses.conditions.select(reached)
        linear = known.linearise(fit.robot, poses.joints[reached], conditions, near, turns=False)
        jacobian, covariance = linear.jacobian[:, fit.robot.reported_targets], known.covariance_of(fit.robot)
        lasting = known.lasting(fit.robot)
        whole, part = (
            predicted_rms(jacobian[..., some], covariance[np.ix_(some, some)], known.coverage_factor, lasting[some])
            for some in (np.ones_like(lasting), lasting)
        )
        return whole, part

    def _next(self, data: Measurements | None) -> NextPose | None:
        """The pose to measure next, by the present fit or by the nominal robot."""
        fit, measured = self._fit, data if data is not None and len(data) else None
        sigma = self._settings.sigma
        if fit is not None and sigma is None and fit.sigma_stated is None and fit.first_noise.group.part.is_position:
            sigma = max(fit.sigma, 1e-9)  # estimated noise; it is zero for data without noise
        robot = self.robot if fit is None else fit.robot
        present = None if measured is None else measured.joints[-1]
        drawn = np.random.default_rng([self._seed, measured.n_poses]) if self._met and measured is not None else None
        return next_pose(robot, self.candidates, measured, present=present, sigma=sigma, drawn=drawn)


class GrowingFile:
    """A CSV file that grows while it is read.

    An unfinished last line is left for the next time. A line that cannot be read, or whose pose cannot be assembled, is
    skipped until it is corrected. The file need not exist yet.
    """

    def __init__(self, path: str, robot: Robot) -> None:
        self._path, self._robot = path, robot
        self._seen: list[str] = []
        self._bad: dict[int, str] = {}  # skipped lines by index
        self._new_remarks: list[str] = []

    def remarks(self) -> list[str]:
        """Return the errors of lines skipped since the last call."""
        remarks, self._new_remarks = self._new_remarks, []
        return remarks

    def read_changes(self) -> Measurements | None:
        """Return the measurements of the finished lines; None if there are none, or none since the last call.

        Raises:
            DataError: The header is not valid, no line can be read, or more than a hundred lines cannot be read.
        """
        if not Path(self._path).exists():
            return None
        lines = read_text(self._path, "a CSV file", DataError, growing=True).split("\n")
        places = [k for k, line in enumerate(lines) if line.strip() and not line.lstrip().startswith("#")]
        if lines == self._seen or len(places) < 2:  # the header alone has no rows
            return None
        self._seen = lines
        self._bad = {k: line for k, line in self._bad.items() if lines[k : k + 1] == [line]}
        rows = [k for k in places[1:] if k not in self._bad]
        first = None
        while rows:
            data, problem = self._read_lines(rows[-1])
            if problem is None:
                return data
            first = first or problem
            bad = rows[bisect_left(rows, True, hi=len(rows) - 1, key=lambda k: self._read_lines(k)[1] is not None)]
            problem = self._read_lines(bad)[1]
            rows.remove(bad)
            if not rows or len(self._bad) >= _MOST_BAD:
                raise first
            self._bad[bad] = lines[bad]
            self._new_remarks.append(f"{problem}; this line is skipped until it is corrected")
        return None

    def _read_lines(self, last: int) -> tuple[Measurements | None, CalibrationError | None]:
        """Measurements of the lines up to `last`, without skipped ones; or the reason why they cannot be read."""
        lines = ["" if k in self._bad else line for k, line in enumerate(self._seen[: last + 1])]
        try:
            data = read_measurements(self._path, self._robot, growing=lines)
            self._robot.assemble(data.joints, labels=data.labels, context=data.conditions)
        except (DataError, UnreachablePoseError) as error:
            return None, error
        return (data if len(data) else None), None
