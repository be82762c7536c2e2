"""Starts of the search for goals: the nearest solved goals, then configurations spread evenly.

Goals are solved nearest to home first, each from the nearest solved goal. Failed goals are tried again from other
neighbours, and then from configurations spread evenly over the joint limits (the same for every description of the
robot). `calib.programs.reaching.reaching` has the iteration from one start. Every iteration is local, so a goal
reported out of reach is not proven so, but the spread starts make it unlikely that a reachable goal is missed.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import scipy

from calib.core.base.arrays import BoolArray, FloatArray, IntArray
from calib.core.robots import loops
from calib.core.robots.closure import actuated_jacobian
from calib.core.robots.joint_sampling import joint_samples
from calib.core.robots.robot import Robot
from calib.programs.reaching.reaching import GoalConfigurations, Reach, descend

TOLERANCE = 1e-9
"""Largest miss of a reached goal [m, rad]."""
_NEIGHBOURS = 3
_SPREAD, _SPREAD_NEIGHBOURS = 256, (8, 64)
_LARGEST_ROUND = 8192  # iterations in one round


def within_joint_limits(reach: Reach, q: FloatArray) -> FloatArray:
    """Return joint values (..., n_actuated) clipped to the joint limits."""
    n = q.shape[-1]
    return np.clip(q, reach.lower[:n], reach.upper[:n])


def start_configuration(robot: Robot, reach: Reach) -> GoalConfigurations:
    """Return home, clipped to the joint limits."""
    start = robot.assemble(within_joint_limits(reach, robot.home))
    return GoalConfigurations.unknown(start.actuated, start.passive)


class Search:
    """The best known configuration for each goal; `home` is one closed configuration to start from."""

    def __init__(self, reach: Reach, home: GoalConfigurations) -> None:
        n = len(reach.goals)
        self.reach, self.home = reach, home
        self._reached = TOLERANCE * min(1.0, reach.mechanism.length)
        self.best = reach.as_given(np.arange(n), home.subset(np.zeros(n, dtype=np.intp)))
        goal_features = _features(
            reach.goals.positions, reach.goals.rotations, reach.goals.directions, reach.mechanism.length
        )
        self._features = np.where(np.isnan(goal_features), self._features_at(home), goal_features)

    @property
    def is_solved(self) -> BoolArray:
        """Mask of the goals that are reached, (n,)."""
        return self.best.distance <= self._reached

    def run(self, robot: Robot) -> None:
        """Try every start of the module docstring until each goal is reached."""
        for batch in self._batches():
            self._improve(batch, self._known_configurations(), 1)
        self._improve(np.flatnonzero(~self.is_solved), self._known_configurations(), _NEIGHBOURS)
        if np.all(self.is_solved):
            return
        spread = _spread_configurations(robot, self.reach)
        for count in _SPREAD_NEIGHBOURS:
            left = np.flatnonzero(~self.is_solved)
            self._improve(left, spread, min(count, _LARGEST_ROUND // max(len(left), 1)))

    def _batches(self) -> Iterator[IntArray]:
        """Goals in order of their distance from home's pose, in batches that double in size."""
        home = self._features_at(self.home)
        order = np.argsort(np.linalg.norm(self._features - home, axis=1), kind="stable")
        start, size = 0, 8
        while start < len(order):
            yield order[start : start + size]
            start, size = start + size, 2 * size

    def _known_configurations(self) -> GoalConfigurations:
        """Home and all solved configurations."""
        solved = self.best.subset(np.flatnonzero(self.is_solved))
        pairs = zip(vars(self.home).values(), vars(solved).values(), strict=True)
        return GoalConfigurations(*map(np.concatenate, pairs))

    def _improve(self, todo: IntArray, starts: GoalConfigurations, count: int) -> None:
        """Iterate for the goals `todo`, each from the `count` nearest starts; keep improvements."""
        count = min(count, len(starts.actuated))
        if len(todo) == 0 or count == 0:
            return
        nearest_starts = scipy.spatial.cKDTree(self._features_at(starts)).query(
            self._features[todo], k=range(1, count + 1)
        )[1]
        index = np.repeat(todo, count)
        solutions = descend(self.reach, index, self.reach.as_given(index, starts.subset(nearest_starts.ravel())))
        misses = np.maximum(solutions.distance, self._reached).reshape(-1, count)  # among reached ones, the first wins
        best = np.argmin(misses, axis=1) + count * np.arange(len(todo))
        better = np.flatnonzero(solutions.distance[best] < self.best.distance[todo])
        self.best.take(todo[better], solutions.subset(best[better]))

    def _features_at(self, at: GoalConfigurations) -> FloatArray:
        position, rotation, _ = actuated_jacobian(self.reach.mechanism, self.reach.target, at.actuated, at.passive)
        goals = self.reach.goals
        return _features(
            position,
            None if goals.rotations is None else rotation,
            None if goals.directions is None else rotation[:, :, 2],
            self.reach.mechanism.length,
        )


def _features(
    positions: FloatArray, rotations: FloatArray | None, directions: FloatArray | None, length: float
) -> FloatArray:
    """Coordinates (n, k) [m] in which similar poses are near each other."""
    parts = [positions]
    if rotations is not None:
        parts.append(length * rotations.reshape(-1, 9) / np.sqrt(2))
    if directions is not None:
        parts.append(length * directions)
    return np.concatenate(parts, axis=1)


def _spread_configurations(robot: Robot, reach: Reach) -> GoalConfigurations:
    """Closed configurations spread over the joint limits (one turn about home for joints without limits)."""
    turn, n_actuated = np.pi * robot.mechanism.joint_scale, len(robot.home)
    lower, upper = reach.lower[:n_actuated], reach.upper[:n_actuated]
    lower = np.where(np.isfinite(lower), lower, robot.home - turn)
    upper = np.where(np.isfinite(upper), upper, robot.home + turn)
    sample = joint_samples(reach.mode, _SPREAD)[:, :n_actuated]
    actuated = reach.mechanism.without_tilts(np.array(lower + sample * (upper - lower), dtype=np.float64))
    closed = loops.close(reach.mechanism, reach.mode, actuated)
    return GoalConfigurations.unknown(actuated[closed.ok], closed.passive[closed.ok])
