"""The next pose while measuring: near the robot's present pose, and nearly as helpful as the best.

As in `calib select --index task --measured`, a pose helps by as much as it lowers the predicted error over the
candidates. As long as the measured poses do not determine the robot, a pose helps by its information about everything
that all candidates would determine (log det, with a little prior information on every direction, so that the missing
direction counts most). Among the poses that help at least `ENOUGH` times as much as the best, the nearest is taken,
since most of the measuring time is travel.

Once the predicted error is small enough, further poses check it. The most helpful poses have the worst predictions, so
their errors do not represent the candidates: poses to check with are drawn at random.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from calib.core.base.arrays import FloatArray, ReadOnlyArrays
from calib.core.base.threads import one_blas_thread
from calib.core.data.measurements import Poses
from calib.core.numerics import linalg
from calib.core.robots.robot import Robot
from calib.planning.instrument_choice import ALL, groups_of
from calib.planning.measurement_order import distances_from
from calib.planning.selection_problem import DETERMINED, TASK
from calib.planning.selection_scores import DeterminantScores, TaskScores
from calib.planning.selection_setting import prepare

ENOUGH = 0.8
"""A nearer pose is taken if its gain is at least this part of the best gain."""
_KNOWN = 1e-6  # prior information on every direction, as part of the information of all candidates


@dataclass(frozen=True, eq=False)
class NextPose(ReadOnlyArrays):
    """The pose to measure next.

    Attributes:
        candidate: Its index among the candidates.
        name: Its name there.
        joints: Its joint values, (n_actuated,) [m or rad].
        before: Present predicted error over the candidates, root mean square [m]; infinite if undetermined.
        after: The same with this pose measured [m].
        travel: Longest joint travel from the robot's present pose, over that joint's range among the candidates.
        checks: Whether the pose was drawn at random to check the fit.
    """

    candidate: int
    name: str
    joints: FloatArray
    before: float
    after: float
    travel: float
    checks: bool = False


@one_blas_thread
def next_pose(
    robot: Robot,
    candidates: Poses,
    measured: Poses | ArrayLike | None = None,
    *,
    present: FloatArray | None = None,
    sigma: float | None = None,
    drawn: np.random.Generator | None = None,
) -> NextPose | None:
    """Return the pose to measure next; None if every reachable candidate is measured.

    Args:
        robot: The robot, linearised at its present values.
        candidates: Poses to choose from; the predicted error is over these.
        present: Present joint values of the robot, (n_actuated,) [m or rad]; default: home.
        sigma: Noise of one reading per axis [m]; default: the description's.
        drawn: Draw a pose to check with from this generator.

    Raises:
        DataError: Two candidates are equal.
        NotIdentifiableError: The candidates do not determine the positions at these same poses.
    """
    groups = groups_of(robot, ALL, 1)
    setting = prepare(robot, candidates, TASK, 1, groups, measured, skip_unreachable=True, sigma=sigma)
    problem, usable = setting.problem, setting.space.usable
    if not np.any(usable):
        return None
    determined = bool(linalg.eigvalsh(problem.before)[0] > DETERMINED)
    if determined:
        scores: TaskScores | DeterminantScores = TaskScores(problem, problem.before)
    else:
        scores = DeterminantScores.from_problem(problem, problem.before + _KNOWN * np.eye(len(problem.before)))
    gains = np.where(usable, scores.gains(), -np.inf)
    way = distances_from(setting.poses.joints, robot.home if present is None else present)[setting.pairs.pose]
    if drawn is None:
        best = int(np.argmin(np.where(gains >= ENOUGH * np.max(gains), way, np.inf)))
    else:
        best = int(drawn.choice(np.flatnonzero(usable)))
    pose = int(setting.pairs.pose[best])
    before = problem.task_trace(problem.before) if determined else np.inf
    after = before - gains[best] if determined else np.inf
    return NextPose(
        candidate=pose,
        name=setting.poses.names[pose],
        joints=setting.poses.joints[pose],
        before=float(np.sqrt(before + problem.task_floor)),
        after=float(np.sqrt(max(after, 0.0) + problem.task_floor)),
        travel=float(way[best]),
        checks=drawn is not None,
    )
