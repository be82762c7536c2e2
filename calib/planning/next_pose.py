"""The pose to measure next, while measuring: nearly the one that helps most, and near to where the robot stands.

As in `calib select --index task --measured`, a pose helps by as much as it lowers the predicted error over the
candidates. Before the measured poses determine the robot, no error can be predicted; then it is the information of
one more pose about what all candidates would determine (log det, with a little of every direction known beforehand, so
that the one that is missing most counts most). Of the poses that help at least `ENOUGH` times as much as the best, the
nearest is taken: measuring takes time, most of it for the way.

Once the predicted error is small enough, poses are measured to check it. What helps most is where predictions are
worst, so errors there say nothing about the candidates as a whole: poses to check with are drawn at random.
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
from calib.planning.rank_three_scores import DeterminantScores, TaskScores
from calib.planning.selection_problem import DETERMINED, TASK
from calib.planning.selection_setting import Request, prepare

ENOUGH = 0.8
"""Part of the best pose's help that a nearer one must give."""
_KNOWN = 1e-6  # part of the information of all candidates on a direction, added to every direction at the start


@dataclass(frozen=True, eq=False)
class NextPose(ReadOnlyArrays):
    """The pose to measure next.

    Attributes:
        candidate: Its number among the candidates.
        name: Its name there.
        joints: Its joint values, (n_actuated,) [m or rad].
        before: Predicted error over the candidates now, root mean square; infinite where it is not determined [m].
        after: The same with this pose measured; infinite where it is not determined [m].
        travel: Longest way of a joint from where the robot stands, in the range of that joint over the candidates.
        checks: Whether it was drawn at random, to check with.
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
    """Return the pose to measure next; None where every candidate that can be reached is measured.

    Args:
        robot: The robot; its present values are where it is linearised.
        candidates: Poses to choose from; the predicted error counts at them.
        measured: Measurements so far.
        present: Present joint values of the robot, (n_actuated,) [m or rad]; home if not given.
        sigma: Noise of one reading per axis [m]; the description's if not given.
        drawn: Draw the pose with these random numbers, to check with.

    Raises:
        DataError: A candidate is given twice.
        NotIdentifiableError: The candidates do not determine the positions at them.
    """
    request = Request(TASK, 1, 0.0, groups_of(robot, ALL, 1))
    setting = prepare(robot, candidates, request, measured, None, (), True, sigma)
    problem, usable = setting.problem, setting.space.usable
    if not np.any(usable):
        return None
    determined = bool(linalg.eigvalsh(problem.before)[0] > DETERMINED)
    if determined:
        scores: TaskScores | DeterminantScores = TaskScores(problem, problem.before)
    else:
        scores = DeterminantScores.from_problem(problem, problem.before + _KNOWN * np.eye(len(problem.before)))
    gains = np.where(usable, scores.gains(), -np.inf)
    way = distances_from(setting.candidates.joints, robot.home if present is None else present)[setting.pairs.pose]
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
        joints=setting.candidates.joints[pose],
        before=float(np.sqrt(before + problem.task_floor)),
        after=float(np.sqrt(max(after, 0.0) + problem.task_floor)),
        travel=float(way[best]),
        checks=drawn is not None,
    )
