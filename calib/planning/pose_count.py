"""How many poses are needed: predicted accuracy against the number of poses measured.

The question that is asked first. For each number m it is answered three times, from the information of the given poses
alone: for m of them spread uniformly over their order; for the m of them that are best for this purpose (exchange for
the task index); and, beyond the poses there are, for all of them measured m / n times on average. Only measurement
noise counts: where the model does not fit the robot, more poses do not help, which the residuals of a fit show.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.base.arrays import FloatArray
from calib.base.errors import NotIdentifiableError
from calib.numerics.observability import TaskIndex, information, task_index
from calib.planning.exchange import Spacing, exchange, uniform_start
from calib.planning.selection_problem import TASK, build_problem

_COUNTS = 8  # numbers of poses up to all of them
_MOST_CHOSEN, _MOST_CANDIDATES = 400, 2000  # for more, the search for the best poses would take long
_BEYOND = (2, 4)  # how many times all poses
_NOTHING_NEW = 1e-3  # part of a pose's strongest direction; repeats that hardly differ add no more than this


@dataclass(frozen=True)
class CountRow:
    """Predicted accuracy with one number of poses.

    Attributes:
        count: Number of poses.
        uniform: With that many of the given poses spread uniformly; None beyond the poses there are.
        chosen: With the best of the given poses; beyond them, with all measured several times. None where the search
            for the best would take long.
    """

    count: int
    uniform: TaskIndex | None
    chosen: TaskIndex | None


def accuracy_by_count(
    rows: FloatArray, priors: FloatArray, task_rows: FloatArray, counts: tuple[int, ...] | None = None
) -> tuple[CountRow, ...]:
    """Predict the accuracy for several numbers of poses.

    Args:
        rows: Whitened rows of each pose, (n_poses, n_rows_per_pose, n_parameters).
        priors: Prior rows, (n_priors, n_parameters).
        task_rows: Scaled derivative of positions at the poses whose accuracy counts, (n_task, 3 n_targets,
            n_parameters) [m].
        counts: Numbers of poses up to those there are; chosen here if not given.

    Returns:
        A row for each number, but for those that are found too small to determine what all poses do.
    """
    n = len(rows)
    candidates = uniform_start(np.arange(n), min(n, _MOST_CANDIDATES))
    problem = build_problem(rows[candidates], None, priors, 0, task_rows)
    if problem.known.rank.rank == 0:  # no number of poses determines anything
        return ()
    rank_left = problem.known.rank.rank - int(np.linalg.matrix_rank(problem.before, hermitian=True))
    least = max(1, -(-rank_left // _directions_of_a_pose(rows[candidates])))
    if counts is None:
        counts = tuple(int(m) for m in np.unique(np.round(np.geomspace(min(least + 1, n), n, _COUNTS))))
    space = Spacing(np.zeros((len(candidates), 3)), 0.0, np.ones(len(candidates), dtype=bool))
    table = []
    for count in counts:
        uniform = _accuracy(rows[uniform_start(np.arange(n), count)], priors, task_rows, 1.0)
        chosen = uniform if count == n else None
        if count < n and count <= _MOST_CHOSEN:
            start = uniform_start(np.arange(len(candidates)), count)
            try:
                best = candidates[exchange(problem, TASK, start, space).chosen]
            except NotIdentifiableError:  # fewer than determine what all do
                continue
            chosen = _accuracy(rows[best], priors, task_rows, 1.0)
        table.append(CountRow(count, uniform, chosen))
    for times in _BEYOND:
        table.append(CountRow(times * n, None, _accuracy(rows, priors, task_rows, float(times))))
    return tuple(table)


def _directions_of_a_pose(rows: FloatArray) -> int:
    """How many directions a pose determines at most; its rows, (n, n_rows, n_parameters), may repeat each other."""
    strengths = np.linalg.svd(rows, compute_uv=False)
    return max(1, int(np.max(np.sum(strengths > _NOTHING_NEW * strengths[:, :1], axis=1))))


def _accuracy(rows: FloatArray, priors: FloatArray, task_rows: FloatArray, times: float) -> TaskIndex:
    return task_index(information(np.sqrt(times) * rows, priors).position_errors(task_rows))
