"""Watching a robot being measured: refit after every pose, report accuracy and the next pose, say when to stop.

    watch = calib.Watch(robot, "0.1 mm", candidates=candidates)
    while not (progress := watch.update(measured_so_far())).stop:
        move_to(progress.next_pose.joints)

The goal is a root mean square position error over the candidates. It holds with 95 % where the upper end of two 95 %
intervals lies below it: that of the error predicted from the covariance of the fit, and that of the errors at the last
poses that were judged before they were fitted (`calib.planning.progress`). The second contains the noise of readings:
a goal below that noise is never seen to hold.

Where not positions are read, but distances or angles, their errors count as the errors of positions that they show.
"""

from __future__ import annotations

import time
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
from calib.core.rows.candidates import configurations_at, require_free
from calib.core.rows.free_poses import free_poses
from calib.core.rows.jacobian import linearise
from calib.core.rows.prediction import RootMeanSquare, predicted_rms
from calib.planning.next_pose import NextPose, next_pose
from calib.planning.pose_sampling import sample
from calib.planning.progress import LAST, LEAST, MOST, UNKNOWN, Progress, squares_of, unseen_rms

CANDIDATES = 300
"""Poses that are sampled where none are given."""
_MOST_BAD = 100  # lines that are passed over; the file is then another one than was meant


class Watch:
    """A robot that is being measured; see the module docstring.

    Args:
        robot: The nominal robot.
        goal: Root mean square position error to reach, such as `0.1 mm`, or a number [m].
        candidates: Poses that the goal is about, and to choose the next one from; or joint values alone, (n,
            n_actuated) [m or rad]. Sampled over the joint limits if not given.
        sigma: Noise of one measured position per axis [m]; the description's if not given.
        seed: Seed of sampled candidates, and of poses to check with.

    Attributes:
        candidates: Those at which nothing is hit.
        notes: Which candidates are left out, and what was not checked.

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
        self._passive: FloatArray | None = None  # of the candidates at the fit before: near those of the next
        self._n_reached = len(self.candidates)  # by the present fit
        self._squares: list[float] = []
        self._met = False  # whether the predicted error of the fit meets the goal
        self._settled = 0  # how many of the last squares are by fits of which that is so

    def update(self, data: Measurements | None = None) -> Progress:
        """Predict the new poses, then fit all, and return the progress.

        Args:
            data: All measurements so far, those of the last update first; otherwise everything starts again. None:
                nothing is measured yet.

        Raises:
            UnreachablePoseError: A measured pose cannot be assembled.
            DataError: A candidate is given twice.
            NotIdentifiableError: The candidates do not determine the positions at them.
        """
        started = time.perf_counter()
        obstacle: CalibrationError | None = DataError("nothing is measured")
        if data is not None and len(data):
            self._judge(data)
            self._fit, obstacle = self._try_fit(data)
            self._data = data
        predicted = self._predict_error(self._fit)
        n_unseen = min(self._settled, MOST) if self._settled >= LEAST else min(len(self._squares), LAST)
        self._met = predicted.high95 <= self.goal
        return Progress(
            robot=self.robot,
            goal=self.goal,
            n_poses=0 if data is None else data.n_poses,
            n_candidates=self._n_reached,
            fit=self._fit,
            reason_without_fit=obstacle,
            predicted=predicted,
            unseen=unseen_rms(self._squares[-n_unseen:] if n_unseen else []),
            n_unseen=n_unseen,
            n_settled=min(self._settled, n_unseen),
            next_pose=self._next(data),
            seconds=time.perf_counter() - started,
        )

    def _judge(self, data: Measurements) -> None:
        """Judge what is new; of many first poses, the last by a fit of the others."""
        before, known = self._data, 0
        if before is not None:
            known = n = len(before)
            if len(data) < n or data.names[:n] != before.names or not np.array_equal(data.joints[:n], before.joints):
                self._fit, self._squares, known = None, [], 0  # others than before
        judge, met = self._fit, self._met
        if judge is None:
            known = int(np.sum(data.pose_numbers < data.n_poses - LAST))
            judge = self._try_fit(data[:known])[0] if known else None
            met = self._predict_error(judge).high95 <= self.goal
        if judge is not None and known < len(data):
            new = squares_of(judge, data[known:])
            self._squares += new
            self._settled = self._settled + len(new) if met else 0

    def _try_fit(self, data: Measurements) -> tuple[Fit | None, CalibrationError | None]:
        """A fit of these, or why there is none yet."""
        try:
            return calibrate(self.robot, data, None, self._settings), None
        except (DataError, NotIdentifiableError, NotConvergedError) as error:  # too few poses, all on one line
            return None, error

    def _predict_error(self, fit: Fit | None) -> RootMeanSquare:
        if fit is None:
            return UNKNOWN
        columns = term_columns(fit.robot, self.candidates.joints, self.candidates.conditions)
        closed = fit.robot.close(self.candidates.joints, self._passive, columns)
        self._passive = closed.passive
        reached = np.flatnonzero(closed.ok)
        self._n_reached = len(reached)
        if not len(reached):
            return UNKNOWN
        linear = linearise(fit.robot, configurations_at(fit.robot, self.candidates.joints, closed, columns, reached))
        uncertainty = fit.statistics
        return predicted_rms(
            linear.jacobian[:, fit.robot.reported_targets][..., fit.unknowns.index],
            uncertainty.covariance,
            uncertainty.coverage_factor,
        )

    def _next(self, data: Measurements | None) -> NextPose | None:
        """The pose to measure next, by the present fit or by the nominal robot."""
        fit, measured = self._fit, data if data is not None and len(data) else None
        sigma = self._settings.sigma
        if fit is not None and sigma is None and fit.sigma_stated is None and fit.first_noise.group.part.is_position:
            sigma = max(fit.sigma, 1e-9)  # noise found; data without noise leave none
        robot = self.robot if fit is None else fit.robot
        present = None if measured is None else measured.joints[-1]
        drawn = np.random.default_rng([self._seed, measured.n_poses]) if self._met and measured is not None else None
        return next_pose(robot, self.candidates, measured, present=present, sigma=sigma, drawn=drawn)


class GrowingFile:
    """A CSV file to look at now and then; a last line without its end is left for the next time.

    A line that cannot be read, or whose pose cannot be assembled, is passed over until it is corrected.

    Args:
        path: The file; it need not exist yet.
        robot: Robot with these joints and instruments.
    """

    def __init__(self, path: str, robot: Robot) -> None:
        self._path, self._robot = path, robot
        self._seen: list[str] = []
        self._bad: dict[int, str] = {}  # lines that are passed over, by their place
        self._new_remarks: list[str] = []

    def remarks(self) -> list[str]:
        """Return the errors of lines that are passed over since the last call."""
        remarks, self._new_remarks = self._new_remarks, []
        return remarks

    def read_changes(self) -> Measurements | None:
        """Return the measurements of the whole lines; None where there are none, or none since the last time.

        Raises:
            DataError: The header is not valid, or no line can be read, or a hundred cannot.
        """
        if not Path(self._path).exists():
            return None
        lines = read_text(self._path, "a CSV file", DataError, growing=True).split("\n")
        places = [k for k, line in enumerate(lines) if line.strip() and not line.lstrip().startswith("#")]
        if lines == self._seen or len(places) < 2:  # a header is no row
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
            bad, problem = self._first_bad(rows, problem)
            rows.remove(bad)
            if not rows or len(self._bad) >= _MOST_BAD:
                raise first
            self._bad[bad] = lines[bad]
            self._new_remarks.append(f"{problem}; this line is skipped until it is corrected")
        return None

    def _first_bad(self, rows: list[int], problem: CalibrationError) -> tuple[int, CalibrationError]:
        """The first row that cannot be read, by halving, and why; of all rows something cannot, as is known."""
        low, high = 0, len(rows) - 1
        while low < high:
            middle = (low + high) // 2
            _, other = self._read_lines(rows[middle])
            low, high, problem = (middle + 1, high, problem) if other is None else (low, middle, other)
        return rows[low], problem

    def _read_lines(self, last: int) -> tuple[Measurements | None, CalibrationError | None]:
        """Measurements of the lines up to a last one, without those passed over; or why they cannot be read."""
        lines = ["" if k in self._bad else line for k, line in enumerate(self._seen[: last + 1])]
        try:
            data = read_measurements(self._path, self._robot, growing=lines)
            self._robot.assemble(data.joints, labels=data.labels, context=data.conditions)
        except (DataError, UnreachablePoseError) as error:
            return None, error
        return (data if len(data) else None), None
