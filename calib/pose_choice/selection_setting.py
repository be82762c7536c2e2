"""The setting of a selection: everything assembled, linearised and checked before the first pose is chosen.

Priors and poses already measured are information that is there before: their rows stack with those of the poses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from calib.arrays import BoolArray, FloatArray
from calib.data.in_memory import as_poses
from calib.data.measurements import Poses
from calib.errors import InputError, NotIdentifiableError, nearest
from calib.linearisation.candidates import (
    Candidates,
    assumed_sigma,
    build_candidates,
    near_measured,
    require_free,
    rows_of_measured,
)
from calib.linearisation.unknowns import Unknowns
from calib.model.robot import Robot
from calib.numerics.observability import prior_rows
from calib.pose_choice.exchange import Spacing
from calib.pose_choice.selection_problem import TASK, Problem, build_problem
from calib.pose_choice.selection_scores import CHOICES


@dataclass(frozen=True)
class Wanted:
    """What was asked for.

    Attributes:
        index: One of `CHOICES`.
        count: Number of poses.
        minimum_distance: Least distance between the targets of two poses [m].
        off_grid: Whether poses shall leave the grid.
    """

    index: str
    count: int
    minimum_distance: float
    off_grid: bool


@dataclass(frozen=True, eq=False)
class Setting:
    """Everything that is known before the first choice.

    Attributes:
        robot: The robot.
        wanted: What was asked for.
        found: The candidates.
        problem: The same in whitened coordinates.
        space: Which candidates may be chosen.
        measured_points: Points of the poses already measured, (n, 3 n_targets) [m].
        sigma: Noise of one measured position per axis, which is the unit of indices [m].
        sigma_assumed: Whether some noise is only assumed.
        already_measured: How many candidates are measured already.
        sigma_given: Noise of positions that replaces what the description states [m], or None.
    """

    robot: Robot
    wanted: Wanted
    found: Candidates
    problem: Problem
    space: Spacing
    measured_points: FloatArray
    sigma: float
    sigma_assumed: bool
    already_measured: int
    sigma_given: float | None


def prepare(
    robot: Robot,
    candidates: Poses | ArrayLike,
    wanted: Wanted,
    measured: Poses | ArrayLike | None,
    task: Poses | ArrayLike | None,
    exclude: Sequence[int],
    skip_unreachable: bool,
    sigma: float | None,
) -> Setting:
    """Assemble and linearise everything, and check that the question has an answer.

    Args:
        robot: The robot; its present values are where it is linearised.
        candidates: Poses to choose from, (n, n_actuated) [m or rad], or from a file.
        wanted: What was asked for.
        measured: Poses that are measured already, as `candidates`.
        task: Poses whose accuracy counts, as `candidates`; the candidates themselves if None.
        exclude: Candidates not to choose, by their number.
        skip_unreachable: Leave out candidates that cannot be assembled, instead of an error.
        sigma: Noise of one reading per axis [m]; the description's if None.

    Raises:
        InputError: An argument is wrong; count above the candidates, or too small for the parameters.
        DataError: A candidate is given twice.
        UnreachablePoseError: Candidates cannot be assembled.
        NotIdentifiableError: No choice determines what the index is about.
    """
    if wanted.index not in CHOICES:
        raise InputError(f"index '{wanted.index}'{nearest(wanted.index, CHOICES)}")
    require_free(robot)
    poses = as_poses(robot, candidates)
    noise, assumed = assumed_sigma(robot, sigma)
    if not (np.isfinite(wanted.minimum_distance) and wanted.minimum_distance >= 0):
        raise InputError(f"minimum distance {wanted.minimum_distance:g} m: must be zero or positive")
    candidates_found = build_candidates(robot, poses, sigma, skip_unreachable=skip_unreachable)
    found = candidates_found.found
    done_rows, n_before, points, again = None, 0, points_of(found.positions[:0]), 0
    usable = candidates_found.usable & ~_excluded(exclude, len(poses))
    if measured is not None:
        done = as_poses(robot, measured)
        done_rows, positions, _ = rows_of_measured(robot, done, sigma)
        n_before, points = done.n_poses, points_of(positions)
        same = near_measured(poses.joints, done.joints)
        again = int(np.sum(same))
        usable &= ~same
    candidate_points = points_of(found.positions)
    if wanted.minimum_distance > 0 and len(points):
        usable[usable] = cKDTree(points).query(candidate_points[usable])[0] >= wanted.minimum_distance
    _require_count(wanted.count, usable, len(poses))
    task_rows = found.position_rows[candidates_found.usable]
    if task is not None:
        task_rows = rows_of_measured(robot, as_poses(robot, task), sigma)[2]
    problem = build_problem(
        found.rows, done_rows, prior_rows(Unknowns.chosen_by_poses(robot).has_prior), n_before, task_rows
    )
    _require_answer(problem, wanted)
    space = Spacing(candidate_points, wanted.minimum_distance, usable)
    return Setting(robot, wanted, candidates_found, problem, space, points, noise, assumed, again, sigma)


def points_of(positions: FloatArray) -> FloatArray:
    """Points whose distance is the root mean square over targets, (n, 3 n_targets) [m]."""
    result: FloatArray = positions.reshape(len(positions), 3 * positions.shape[1]) / np.sqrt(positions.shape[1])
    return result


def _excluded(exclude: Sequence[int], n: int) -> BoolArray:
    for number in exclude:
        if not 0 <= number < n:
            raise InputError(f"exclude: there is no candidate {number}; they are numbered 0 to {n - 1}")
    result: BoolArray = np.isin(np.arange(n), np.asarray(exclude, dtype=np.intp))
    return result


def _require_count(count: int, usable: BoolArray, n: int) -> None:
    left = int(np.sum(usable))
    if count < 1:
        raise InputError(f"count {count}: choose at least one pose")
    if count > left:
        of = "" if left == n else f" (of {n}; the others are excluded, measured already, or cannot be used)"
        raise InputError(f"count {count} is above the {left} candidates that can be chosen{of}; give more candidates")


def _require_answer(problem: Problem, wanted: Wanted) -> None:
    rank, per_pose = problem.known.rank.rank, problem.rows.shape[1]
    if rank == 0:
        raise NotIdentifiableError(
            "the candidates determine no parameter at all; the targets do not depend on any free one"
        )
    missing = rank - int(np.linalg.matrix_rank(problem.before, hermitian=True))
    if per_pose * wanted.count < missing:
        raise InputError(
            f"count {wanted.count}: {per_pose * wanted.count} coordinates cannot determine {missing} parameters;"
            f" choose at least {-(-missing // per_pose)} poses (several times that for a useful result)"
        )
    if wanted.index == TASK and not np.isfinite(problem.task_floor):
        raise NotIdentifiableError(
            "the candidates do not determine the positions at the task poses, so their error has no bound;"
            " add candidates like the task poses, or hold parameters (`calib check` says which)"
        )
