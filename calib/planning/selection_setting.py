"""The setting of a selection: candidates, assembled, linearised and checked before the first pose is chosen.

The rows of priors and measured poses stack with those of the chosen poses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray, IntArray
from calib.core.base.errors import InputError, NotIdentifiableError, require_known
from calib.core.base.memory import require_memory
from calib.core.data.in_memory import PosesLike, as_poses
from calib.core.data.measurements import Poses
from calib.core.numerics import linalg
from calib.core.robots.robot import Robot
from calib.core.rows.unknowns import Unknowns
from calib.planning.exchange import Spacing, uniform_start
from calib.planning.instrument_choice import Groups, PoseGroupPairs, already_read, pairs_of, require_planned_touches
from calib.planning.selection_bound import CERTIFIED, largest
from calib.planning.selection_problem import CHOICES, TASK, SelectionProblem, build_problem, index_of_score
from calib.shared.candidates import (
    PoseRows,
    assumed_sigma,
    build_candidates,
    near_measured,
    positions_at,
    require_free,
    rows_of_measured,
)


@dataclass(frozen=True, eq=False)
class SelectionSetting:
    """Everything known before the first choice.

    Attributes:
        index: Index to raise, of `CHOICES`.
        count: Number of poses; a pose counts once for each group of instruments that reads there.
        groups: Groups of instruments to choose among.
        poses, pose_rows: The poses to choose from.
        pairs: The candidates: these poses with groups of instruments.
        problem: The candidates in whitened coordinates.
        sigma: Noise of one measured position per axis, the unit of indices [m].
        sigma_assumed: Whether some noise is an assumption.
        already_measured: Number of measured candidates.
    """

    robot: Robot
    index: str
    count: int
    groups: Groups
    poses: Poses
    pose_rows: PoseRows
    pairs: PoseGroupPairs
    problem: SelectionProblem
    space: Spacing
    sigma: float
    sigma_assumed: bool
    already_measured: int

    def uniform(self) -> IntArray:
        """Return candidates evenly spread over their order, the requested number of each kind, (count,)."""
        return np.concatenate([uniform_start(members, count) for members, count in self._usable_by_kind()])

    def random(self, rng: np.random.Generator) -> IntArray:
        """Return candidates at random, the requested number of each kind, ascending, (count,)."""
        chosen = [rng.choice(members, count, replace=False) for members, count in self._usable_by_kind()]
        return np.sort(np.concatenate(chosen))

    @property
    def counts(self) -> IntArray:
        """Requested number of candidates of each kind, (n_kinds,)."""
        return np.array(self.groups.counts or (self.count,))

    def index_of_score(self, score: float) -> float:
        """Return the index of a choice with this score; the task index in m."""
        return index_of_score(self.problem, self.index, score, self.count, self.sigma)

    def _usable_by_kind(self) -> list[tuple[IntArray, int]]:
        """The usable candidates of each kind, (n,), and the requested number of them."""
        usable = np.flatnonzero(self.space.usable)
        return [(usable[self.space.kind[usable] == kind], int(count)) for kind, count in enumerate(self.counts)]


def prepare(
    robot: Robot,
    candidates: PosesLike,
    index: str,
    count: int,
    groups: Groups,
    measured: PosesLike | None = None,
    task: PosesLike | None = None,
    minimum_distance: float = 0.0,
    skip_unreachable: bool = False,
    sigma: float | None = None,
    exclude: Sequence[int] = (),
) -> SelectionSetting:
    """Assemble and linearise the candidates, and check that the index can be raised.

    For arguments and errors see `calib.planning.selection.select`.
    """
    require_known(index, CHOICES, "unknown index")
    require_free(robot)
    poses = as_poses(robot, candidates)
    noise, assumed = assumed_sigma(robot, sigma)
    if not (np.isfinite(minimum_distance) and minimum_distance >= 0):
        raise InputError(f"minimum distance {minimum_distance:g} m: must be zero or positive")
    if groups.chosen:
        require_planned_touches(robot, groups, poses)
    assembled = build_candidates(robot, poses, sigma, skip_unreachable=skip_unreachable)
    pairs = pairs_of(groups, assembled)
    if index not in CERTIFIED or minimum_distance > 0:
        require_memory(
            2 * pairs.rows.size,
            "a choice by an index without a bound, or with a least distance, looks at all candidates at once; it",
            "choose from each part of the candidates, and then from these choices",
        )
    allowed = assembled.usable.copy()
    for number in exclude:
        if not 0 <= number < len(poses):
            raise InputError(f"exclude: there is no candidate {number}; they are numbered 0 to {len(poses) - 1}")
        allowed[int(number)] = False
    points = points_of(assembled.positions) if minimum_distance > 0 else np.zeros((len(poses), 0))
    done_rows, n_before, same = None, 0, np.zeros(len(pairs.pose), dtype=bool)
    if measured is not None:
        done = as_poses(robot, measured)
        done_rows = rows_of_measured(robot, done, sigma)
        n_before, same = done.n_poses, already_read(groups, poses, done)
        if minimum_distance > 0:
            gaps = np.full(len(poses), np.inf)
            others = assembled.usable & ~near_measured(poses.joints, done.joints)
            gaps[others] = scipy.spatial.cKDTree(points_of(robot.positions(done.joints, done.conditions))).query(
                points[others]
            )[0]
            allowed &= gaps >= minimum_distance
    task_rows, n_task = assembled.position_rows, int(np.sum(assembled.usable))
    if task is not None:
        wanted = as_poses(robot, task)
        configurations = robot.assemble(wanted.joints, labels=wanted.labels, context=wanted.conditions)
        task_rows, n_task = positions_at(robot, configurations)[1], len(wanted)
    priors = Unknowns.chosen_by_poses(robot).prior.rows
    problem = build_problem(pairs.rows, done_rows, priors, n_before, task_rows, n_task * len(robot.reported_targets))
    _require_answer(problem, index)
    usable = pairs.possible & ~same & allowed[pairs.pose]
    kind = np.broadcast_to(np.intp(0), len(usable)) if groups.counts is None else pairs.group
    space = Spacing(usable, kind, pairs.pose, points[pairs.pose], minimum_distance)
    again = int(np.sum(same & pairs.possible))
    return SelectionSetting(robot, index, count, groups, poses, assembled, pairs, problem, space, noise, assumed, again)


def points_of(positions: FloatArray) -> FloatArray:
    """Return points (n, 3 n_targets) [m], whose distances are the RMS distances of the targets of two poses."""
    return positions.reshape(len(positions), 3 * positions.shape[1]) / np.sqrt(positions.shape[1])


def require_count(setting: SelectionSetting) -> None:
    """Raise `InputError` if there are too few candidates of a kind, or too few poses for the index."""
    space, usable = setting.space, setting.space.usable
    if setting.count < 1:
        raise InputError(f"count {setting.count}: choose at least one pose")
    names = [""] if setting.groups.counts is None else [f" of {name}" for name in setting.groups.names]
    for kind, (name, count) in enumerate(zip(names, setting.counts.tolist(), strict=True)):
        if count < 0:
            raise InputError(f"count {count}{name}: must be zero or more")
        left, n = int(np.sum(usable & (space.kind == kind))), int(np.sum(space.kind == kind))
        if count > left:
            of = "" if left == n else f" (of {n}; the others are excluded, measured already, or cannot be used)"
            raise InputError(
                f"count {count}{name} is above the {left} candidates that can be chosen{of}; give more candidates"
            )
    problem = setting.problem
    missing = problem.pose_information.rank.rank - int(linalg.matrix_rank(problem.before, hermitian=True))
    n_read = np.where(usable, setting.pairs.n_read, 0)
    n_values = int(sum(np.sum(n_read[best]) for best in largest(n_read, space.kind, setting.counts)))
    if n_values < missing:
        raise InputError(
            f"count {setting.count}: {n_values} measured values cannot determine {missing} parameters;"
            f" choose at least {-(-missing // int(np.max(n_read)))} poses (several times that for a useful result)"
        )


def _require_answer(problem: SelectionProblem, index: str) -> None:
    if problem.pose_information.rank.rank == 0:
        raise NotIdentifiableError(
            "the candidates determine no parameter at all; the targets depend on no free parameter"
        )
    if index == TASK and not np.isfinite(problem.task_floor):
        raise NotIdentifiableError(
            "the candidates do not determine the positions at the task poses, so their error has no bound;"
            " add candidates like the task poses, or hold parameters (`calib check` says which)"
        )
