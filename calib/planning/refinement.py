"""Off the grid: move chosen poses continuously, to do better than any choice from the candidates.

Problem. Maximise an index over the joint values of all chosen poses, within a region. Method: pattern search, pose by
pose. Around each pose trial poses are laid out, one step forward and back along each joint, along a random direction,
and along the pose's last success. Those that are not in the region are struck out; the rest are candidates like any
other, so the index of each follows from a change of rank three, and the best one takes the pose's place if the index
rises. A pose that found nothing halves its step; one that did doubles it. No derivatives, so no index needs its own
code, and the index never falls. All trial poses of a round are assembled together.

Where poses may go: between the candidates. What lies around the robot is not known; that the candidates can be measured
is. So a pose may go only as far from the nearest candidate as candidates are from each other, both in joint space and
where the targets are, and not beyond the ranges of joints and positions that the candidates span, nor beyond the joint
limits of the URDF. Candidates on a surface keep the poses near that surface. Loops stay closed in the robot's assembly
mode, at least `singularity_limit` away from a singularity. Look at the poses before sending them all the same.

When it fails. A pattern search finds a local optimum. How far it is from the best is not known, but whether it is
above the proven bound of all choices from the candidates is.

Reference: Kolda, Lewis and Torczon 2003.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import scipy

from calib.core.base.arrays import BoolArray, FloatArray, ReadOnlyArrays
from calib.core.base.threads import one_blas_thread
from calib.core.base.workers import Progress, in_order
from calib.core.numerics import linalg
from calib.core.robots.closure import residual
from calib.core.robots.continuation import closing_tolerance
from calib.core.robots.joint_errors import actual_joints, term_columns
from calib.core.robots.robot import Robot
from calib.core.robots.terms.term import Context
from calib.core.rows.candidates import configurations_at, rows_of_poses
from calib.planning.selection_problem import SelectionProblem
from calib.planning.selection_scores import Scores, scores_of

_FIRST_STEP = 0.1  # of a joint's range
_LARGEST_STEP = 0.25
_SMALLEST_STEP = 3e-3
_MAX_ROUNDS = 150
_RISE = 1e-5  # relative rise of a score for which a pose moves; less is crawling
_RIDGE = 1e-9  # of K; without one pose a direction may be lost, and must be found again
_NEWTON_STEPS = 8
_CHUNK = 512  # trial poses that are assembled together, by one worker
_CLOSED = 1e-9  # closure residual from which `Robot.close` finishes at once [m, rad]
_SPACING = 95  # percentile of the candidates' distances to their nearest neighbours: a few lie apart
_ROUNDING = 1e-9  # [m, or part of a distance]


@dataclass(frozen=True, eq=False)
class Refined(ReadOnlyArrays):
    """Moved poses.

    Attributes:
        joints: (n_poses, n_actuated) [m or rad].
        positions: Targets, (n_poses, n_targets, 3) [m].
        rows: Whitened rows, (n_poses, 3 n_targets, r).
    """

    joints: FloatArray
    positions: FloatArray
    rows: FloatArray


def refine(
    robot: Robot,
    problem: SelectionProblem,
    index: str,
    joints: FloatArray,
    conditions: Context,
    region: Region,
    rng: np.random.Generator,
    sigma: float | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Refined:
    """Move poses until no trial pose raises the index.

    Args:
        robot: The robot.
        problem: Candidates that the poses were chosen from; its directions and scales are kept.
        index: Index to raise.
        joints: Poses to start from, (n_poses, n_actuated) [m or rad].
        conditions: Of each pose, wherever it goes.
        region: Where they may go.
        rng: Source of the random directions.
        sigma: Noise of positions per axis in place of what is stated [m], or None.
        executor: Who assembles trial poses; this process if not given.
        progress: Told in each round how many poses have found their place, of how many.
    """
    q, width = joints.copy(), region.upper - region.lower
    whiten = problem.known.directions / problem.known.strengths
    evaluate = partial(_evaluate, partial(_assembled, robot, whiten, problem.rows.shape[1], sigma), region, executor)
    _, positions, rows, passive = evaluate(q, None, conditions)
    step, last = np.full(len(q), _FIRST_STEP), np.zeros_like(q)
    for _ in range(_MAX_ROUNDS):
        active = np.flatnonzero(step > _SMALLEST_STEP)
        if not len(active):
            break
        trials = np.stack([_trials(q[k], last[k], step[k], width, rng) for k in active])
        trials = np.clip(trials, region.lower, region.upper)
        seeds = np.repeat(passive[active], trials.shape[1], axis=0)
        trial_conditions = conditions.at(np.repeat(active, trials.shape[1]))
        flat = evaluate(trials.reshape(-1, q.shape[1]), seeds, trial_conditions)
        inside, points, trial_rows, closed = (part.reshape(*trials.shape[:2], *part.shape[1:]) for part in flat)
        gathered = problem.before + np.einsum("nki,nkj->ij", rows, rows)
        for a, k in enumerate(active):
            rest = gathered - rows[k].T @ rows[k]
            free = inside[a] & region.apart(points[a], np.delete(positions, k, axis=0))
            trial = _better(problem, index, rest, rows[k], trial_rows[a], free)
            if trial is None:
                step[k], last[k] = step[k] / 2, 0.0
                continue
            last[k] = trials[a, trial] - q[k]
            q[k], positions[k], rows[k], passive[k] = (
                trials[a, trial],
                points[a, trial],
                trial_rows[a, trial],
                closed[a, trial],
            )
            gathered = rest + rows[k].T @ rows[k]
            step[k] = min(2 * step[k], _LARGEST_STEP)
        if progress is not None:
            progress(int(np.sum(step <= _SMALLEST_STEP)), len(q))
    return Refined(q, positions.reshape(len(q), -1, 3), rows)


def _trials(q: FloatArray, last: FloatArray, step: float, width: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Joint values one step away, (n_trials, n_actuated)."""
    axes = np.eye(len(q)) * width
    random = rng.standard_normal(len(q))
    random = width * random / np.linalg.norm(random)
    moves = np.vstack([axes, -axes, random, -random]) * step
    result: FloatArray = q + np.vstack([moves, last, 2 * last])
    return result


_Assembled = tuple[BoolArray, FloatArray, FloatArray, FloatArray]
"""Which poses may stand there (n,), points (n, 3 n_targets) [m], whitened rows (n, k, r), passive joints; NaN: open."""
_Poses = tuple[FloatArray, FloatArray | None, Context]
"""Joint values (n, n_actuated), passive joints nearby (n, n_passive), if they are known, and the conditions."""


def _evaluate(
    assemble: Callable[[_Poses], _Assembled],
    region: Region,
    executor: Executor | None,
    q: FloatArray,
    seed: FloatArray | None,
    conditions: Context,
) -> _Assembled:
    """Assemble poses, in chunks of one size, so that the numbers do not depend on who does them."""
    pieces = [slice(k, k + _CHUNK) for k in range(0, len(q), _CHUNK)]
    chunks = [(q[piece], None if seed is None else seed[piece], conditions.at(piece)) for piece in pieces]
    parts = list(in_order(assemble, chunks, executor))
    allowed, points, rows, passive = (np.concatenate([part[k] for part in parts]) for k in range(4))
    closed = np.flatnonzero(allowed)
    allowed[closed] = region.holds(q[closed], points[closed])
    return allowed, points, rows, passive


@one_blas_thread
def _assembled(robot: Robot, whiten: FloatArray, width: int, sigma: float | None, poses: _Poses) -> _Assembled:
    """Assemble poses near others, as rows of that width; those near a singularity may not stand there."""
    q, seed, conditions = poses
    n = len(q)
    allowed, rows = np.zeros(n, dtype=bool), np.full((n, width, whiten.shape[1]), np.nan)
    points = np.full((n, 3 * len(robot.target_names)), np.nan)
    passive = np.full((n, len(robot.passive_names)), np.nan)
    near, columns = np.arange(n), term_columns(robot, q, conditions)
    if seed is not None:
        seed = _followed(robot, actual_joints(robot, q, columns), seed)
        near = np.flatnonzero(np.all(np.isfinite(seed), axis=1))
        seed = seed[near]
    columns = tuple(phi[near] for phi in columns)
    closed = robot.close(q[near], seed, columns)
    good = near[closed.ok]
    passive[good] = closed.passive[closed.ok]
    configurations = configurations_at(robot, q[near], closed, columns, np.flatnonzero(closed.ok))
    allowed[good] = robot.singular_values(configurations) >= robot.description.singularity_limit
    pose_rows = rows_of_poses(robot, configurations, sigma)
    points[good] = pose_rows.positions.reshape(len(good), -1)
    rows[good] = pose_rows.rows @ whiten
    return allowed, points, rows, passive


def _followed(robot: Robot, q: FloatArray, seed: FloatArray) -> FloatArray:
    """Passive joints by a few Newton steps from those of a nearby pose; NaN where these do not lead to a closed pose.

    `Robot.close` would search for a way round, which costs more than the trial pose is worth.
    """
    mechanism, passive = robot.mechanism, seed.copy()
    if not mechanism.loops:
        return passive
    active, tolerance = np.arange(len(q)), closing_tolerance(mechanism)
    for _ in range(_NEWTON_STEPS):
        values, slope, _ = residual(mechanism, q[active], passive[active])
        active, values, slope = (part[np.max(np.abs(values), axis=1) > tolerance] for part in (active, values, slope))
        if len(active) == 0:
            break
        try:
            passive[active] -= np.linalg.solve(slope, values[:, :, None])[:, :, 0]
        except np.linalg.LinAlgError:  # one of them is exactly singular
            passive[active] -= (linalg.pinv(slope) @ values[:, :, None])[:, :, 0]
    values = residual(mechanism, q, passive)[0]
    inside = np.all((passive >= mechanism.lower) & (passive <= mechanism.upper), axis=1)
    passive[~inside | (np.max(np.abs(values), axis=1) > _CLOSED)] = np.nan
    return passive


def _better(
    problem: SelectionProblem, index: str, rest: FloatArray, present: FloatArray, trials: FloatArray, free: BoolArray
) -> int | None:
    """Return the free trial that raises the index most above the present pose, or None."""
    if not np.any(free):
        return None
    rows = np.concatenate([np.where(free[:, None, None], trials, 0.0), present[None]])
    local = replace(problem, rows=rows)
    state: Scores = scores_of(local, index, rest + _RIDGE * np.eye(len(rest)))
    best = state.best(np.append(free, False), add=True)
    now, then = state.moved(len(rows) - 1, add=True).value, state.moved(best, add=True).value
    return best if then > now + _RISE * abs(now) else None


@dataclass(frozen=True, eq=False)
class Region:
    """Where poses may move.

    Attributes:
        lower, upper: Joint values, (n_actuated,) [m or rad].
        low_point, high_point: Box of all targets' positions, (3 n_targets,) [m].
        scale: What one radian of each joint is compared with, (n_actuated,).
        joints, points: Candidates: joints over `scale` (n, n_actuated), and targets (n, 3 n_targets) [m].
        joint_reach, point_reach: Largest distance from the nearest of them.
        distance: Least distance between poses, see `calib.planning.exchange.Spacing` [m].
        occupied: Points of poses already measured, from `calib.planning.selection_setting.points_of`,
            (n_measured, 3 n_targets) [m].
    """

    lower: FloatArray
    upper: FloatArray
    low_point: FloatArray
    high_point: FloatArray
    scale: FloatArray
    joints: scipy.spatial.cKDTree
    points: scipy.spatial.cKDTree
    joint_reach: float
    point_reach: float
    distance: float
    occupied: FloatArray

    def holds(self, q: FloatArray, points: FloatArray) -> BoolArray:
        """Return which poses lie in the region.

        Args:
            q: Joint values, (n, n_actuated) [m or rad].
            points: Their targets, (n, 3 n_targets) [m].

        Returns:
            (n,).
        """
        margin = _ROUNDING * np.maximum(1.0, np.abs(self.high_point))
        inside = np.all((points >= self.low_point - margin) & (points <= self.high_point + margin), axis=1)
        near = self.joints.query(q / self.scale)[0] <= self.joint_reach * (1 + _ROUNDING) + _ROUNDING
        seen_near = self.points.query(points)[0] <= self.point_reach * (1 + _ROUNDING) + _ROUNDING
        result: BoolArray = inside & near & seen_near
        return result

    def apart(self, points: FloatArray, others: FloatArray) -> BoolArray:
        """Return which points keep the least distance to other poses.

        Args:
            points: (n, 3 n_targets) [m].
            others: (n_others, 3 n_targets) [m].

        Returns:
            (n,).
        """
        if self.distance == 0:
            return np.ones(len(points), dtype=bool)
        scale = np.sqrt(points.shape[1] / 3)  # of `calib.planning.selection_setting.points_of`
        everyone = np.vstack([others / scale, self.occupied])
        gaps = np.linalg.norm(points[:, None] / scale - everyone, axis=2)
        result: BoolArray = np.min(gaps, axis=1, initial=np.inf) >= self.distance
        return result


def region_of(
    robot: Robot, joints: FloatArray, positions: FloatArray, distance: float = 0.0, occupied: FloatArray | None = None
) -> Region:
    """Return the region of candidates.

    Args:
        robot: The robot, for its joint limits.
        joints: Candidates, (n, n_actuated) [m or rad].
        positions: Their targets, (n, n_targets, 3) [m].
        distance: Least distance between poses [m].
        occupied: See `Region`.
    """
    limits = {joint.name: (joint.lower, joint.upper) for joint in robot.urdf.joints}
    lower = np.array([limits[name][0] for name in robot.joint_names])
    upper = np.array([limits[name][1] for name in robot.joint_names])
    points, scale = positions.reshape(len(positions), -1), robot.mechanism.joint_scale
    joint_tree, point_tree = scipy.spatial.cKDTree(joints / scale), scipy.spatial.cKDTree(points)
    return Region(
        np.maximum(lower, np.min(joints, axis=0)),
        np.minimum(upper, np.max(joints, axis=0)),
        np.min(points, axis=0),
        np.max(points, axis=0),
        scale,
        joint_tree,
        point_tree,
        _spacing(joint_tree),
        _spacing(point_tree),
        distance,
        np.zeros((0, points.shape[1])) if occupied is None else occupied,
    )


def _spacing(tree: scipy.spatial.cKDTree) -> float:
    """How far candidates are from their nearest neighbours; 0 for one alone."""
    if tree.n < 2:
        return 0.0
    return float(np.percentile(tree.query(tree.data, k=[2])[0], _SPACING))
