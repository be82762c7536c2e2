"""Joint values that reach goals, through closed loops, with the robot's current (calibrated) parameters.

The iteration from one start is in `calib.inverse_kinematics.reaching`. This module chooses the starts: goals are solved
nearest to home first, each from the nearest solved one; those that fail are tried again from other neighbours, and then
from configurations spread evenly over the joint limits (a Halton sequence, so that the answer is always the same). As
every search is local, a goal that is called out of reach is not proven so, but the spread starts make it unlikely that
a reachable one is missed. Assembly mode and joint limits are kept; where the goal leaves a choice, the solution stays
near home, or near given joint values.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import ArrayLike

from calib.arrays import BoolArray, FloatArray, IntArray, ReadOnlyArrays
from calib.data.measurements import Poses
from calib.errors import DataError, InputError, UnreachablePoseError, nearest
from calib.inverse_kinematics.goals import Goals
from calib.inverse_kinematics.reaching import Configured, Reach, actuated_jacobian, descend
from calib.inverse_kinematics.redundancy import nearer, unwound
from calib.joint_terms.term import Context
from calib.model import loops
from calib.model.robot import Robot, require_robot
from calib.numerics.halton import halton
from calib.units import millimetres

TOLERANCE = 1e-9
"""Largest miss of a goal that counts as reached [m, rad]."""
_NEIGHBOURS = 3
_SPREAD, _SPREAD_NEIGHBOURS = 256, (8, 64)
_ROUNDS = 20
_SETTLED = 1e-14  # change of a tilt [rad]
_LARGEST_ROUND = 8192  # searches in one round


@dataclass(frozen=True, eq=False)
class Solution(ReadOnlyArrays):
    """Joint values found, and how well they reach.

    Attributes:
        q: Actuated joints, (n, n_actuated) [m or rad]; where `ok` is False the nearest that was found.
        ok: Which goals are reached to `TOLERANCE`, at joint values at which `Robot.assemble` finds the robot, (n,).
        miss_position: Distance from the wanted position, (n,) [m].
        miss_angle: Angle from the wanted orientation or direction, (n,) [rad]; 0 where none is asked for.
        positions: Where the target is at `q`, (n, 3) [m].
        labels: What to call each goal in messages.
    """

    q: FloatArray
    ok: BoolArray
    miss_position: FloatArray
    miss_angle: FloatArray
    positions: FloatArray
    labels: tuple[str, ...]

    def misses(self) -> list[str]:
        """Return a phrase for every goal that is not reached."""
        return [f"{self.labels[k]} {self.miss(k)}" for k in map(int, np.flatnonzero(~self.ok))]

    def miss(self, k: int) -> str:
        """Return by how much goal k is missed, in words."""
        length, angle = float(self.miss_position[k]), float(self.miss_angle[k])
        if length <= TOLERANCE and angle <= TOLERANCE:
            return "can be reached, but no way there was found from home in its assembly mode"
        return f"misses by {millimetres(length):.3f} mm" + (
            f" and {np.degrees(angle):.3f} deg" if angle > TOLERANCE else ""
        )

    def require_all(self) -> None:
        """Raise `UnreachablePoseError` that names the goals that are not reached."""
        misses = self.misses()
        if misses:
            more = f" (and {len(misses) - 5} more)" if len(misses) > 5 else ""
            raise UnreachablePoseError(
                f"out of reach within the joint limits, in home's assembly mode:"
                f" {'; '.join(misses[:5])}{more}; move these goals, leave them out, or leave"
                " the cells of coordinates empty that need not be met"
            )


def solve(robot: Robot, goals: Goals | ArrayLike, *, near: ArrayLike | None = None) -> Solution:
    """Find joint values that bring a target to its goals.

    Args:
        robot: The robot, with nominal or calibrated parameters.
        goals: Where the target is wanted; or positions of the first target alone, (n, 3) [m], with
            NaN throughout for a coordinate that is not asked for. `Goals` may differ in that from row to row.
        near: Joint values to stay near where a goal leaves a choice, (n_actuated,) or (n, n_actuated) [m or rad]; home
            if not given.

    Raises:
        InputError: The robot is none, or the goals are joint values.
        DataError: Unknown target, `near` of the wrong shape, or positions of which only some have a NaN.
    """
    require_robot(robot)
    if isinstance(goals, Poses):
        raise InputError("goals: are joint values; give positions (n, 3) [m], or calib.Goals")
    if not isinstance(goals, Goals):
        goals = Goals(np.atleast_2d(np.asarray(goals, dtype=float)))
        odd = np.any(np.isnan(goals.positions) != np.isnan(goals.positions[:1]), axis=1)
        if np.any(odd):
            raise DataError(
                f"{goals.labels[int(np.argmax(odd))]}: not the same coordinates are NaN as in the first; one that is"
                " not asked for is NaN in all, or else give calib.Goals"
            )
    reach = problem(robot, goals)
    wanted = robot.home if near is None else robot.joint_vector(near)
    if np.ndim(wanted) == 2 and len(wanted) not in (1, len(goals)):
        raise DataError(f"near: {len(wanted)} rows for {len(goals)} goals; give one row, or one for each")
    wanted = _inside(reach, np.broadcast_to(wanted, (len(goals), len(robot.home))))
    conditions = goals.conditions(len(robot.home))
    wanted = robot.actual(wanted, robot.term_columns(wanted, conditions))
    search = _Search(reach, _closed_start(robot, reach))
    search.run(robot)
    solved = np.flatnonzero(search.solved)
    turned = unwound(reach, search.best.subset(solved), wanted[solved])
    search.keep(solved, nearer(reach, solved, turned, wanted[solved]))
    best = settled(robot, reach, np.arange(len(goals)), search.best, conditions)
    positions, miss, angle = reach.misses(best.actuated, best.passive)
    ok = (miss <= TOLERANCE) & (angle <= TOLERANCE)
    commands = robot.commands(best.actuated, conditions)
    reached = np.flatnonzero(ok)
    columns = robot.term_columns(commands[reached], conditions.at(reached))
    ok[reached] = robot.close(commands[reached], columns=columns).ok  # the loops were followed from elsewhere
    return Solution(commands, ok, miss, angle, positions, goals.labels)


def problem(robot: Robot, goals: Goals) -> Reach:
    """Return goals of a robot with the limits of its joints; a target that it does not have is a `DataError`."""
    target = robot.mechanism.targets[0]
    if goals.target:
        named = {pair.name: pair for pair in robot.mechanism.targets}
        if goals.target not in named:
            raise DataError(f"no target '{goals.target}'{nearest(goals.target, named)}")
        target = named[goals.target]
    return Reach(robot.mechanism, robot.mode, target, goals, *robot.urdf.limits(robot.mechanism.driven))


def settled(robot: Robot, reach: Reach, index: IntArray, found: Configured, context: Context) -> Configured:
    """Descend again until links are tilted as they are at the commands that are found.

    They tilt so little, and so nearly alike at neighbouring joint values, that each round gains digits.

    Args:
        robot: The robot.
        reach: The problem.
        index: Which goals, (n,).
        found: What was found for them.
        context: The conditions of each.
    """
    tilts = reach.mechanism.is_tilt
    for _ in range(_ROUNDS if np.any(tilts) else 0):
        commands = robot.commands(found.actuated, context)
        driven = robot.actual(commands, robot.term_columns(commands, context))
        if np.max(np.abs(driven - found.actuated)[:, tilts], initial=0.0) < _SETTLED:
            break
        closed = loops.close(reach.mechanism, reach.mode, driven, found.passive)
        passive = np.where(closed.ok[:, None], closed.passive, found.passive)
        found = descend(reach, index, Configured(driven, passive, found.distance))
    return found


def _inside(reach: Reach, q: FloatArray) -> FloatArray:
    """Joint values (..., n_actuated) moved inside the joint limits where they are not."""
    n = q.shape[-1]
    return np.clip(q, reach.lower[:n], reach.upper[:n])


def _closed_start(robot: Robot, reach: Reach) -> Configured:
    """Home, moved inside the joint limits where it is not."""
    found = robot.assemble(_inside(reach, robot.home))
    return Configured(found.actuated, found.passive, np.array([np.inf]))


class _Search:
    """The best configuration found for each goal so far.

    Args:
        reach: The problem.
        home: One closed configuration to start from.
    """

    def __init__(self, reach: Reach, home: Configured) -> None:
        n = len(reach.goals)
        self.reach, self.home = reach, home
        self.best = Configured(
            np.repeat(home.actuated, n, axis=0), np.repeat(home.passive, n, axis=0), np.full(n, np.inf)
        )
        told = _features(reach.goals.positions, reach.goals.rotations, reach.goals.directions, reach.mechanism.length)
        self._features = np.where(np.isnan(told), self._features_at(home), told)

    @property
    def solved(self) -> BoolArray:
        """Which goals are reached, (n,)."""
        return self.best.distance <= TOLERANCE * min(1.0, self.reach.mechanism.length)

    def run(self, robot: Robot) -> None:
        """Try every start of the module docstring until a goal is reached."""
        for batch in self._batches():
            self._improve(batch, self._known(), 1)
        self._improve(np.flatnonzero(~self.solved), self._known(), _NEIGHBOURS)
        if np.all(self.solved):
            return
        spread = _spread(robot, self.reach)
        for count in _SPREAD_NEIGHBOURS:
            left = np.flatnonzero(~self.solved)
            self._improve(left, spread, min(count, _LARGEST_ROUND // max(len(left), 1)))

    def keep(self, index: IntArray, found: Configured) -> None:
        """Take over what was found for the goals `index`."""
        self.best.actuated[index], self.best.passive[index] = found.actuated, found.passive
        self.best.distance[index] = found.distance

    def _batches(self) -> Iterator[IntArray]:
        """Goals in order of their distance from home's pose, in batches that double in size."""
        home = self._features_at(self.home)
        order = np.argsort(np.linalg.norm(self._features - home, axis=1), kind="stable")
        start, size = 0, 8
        while start < len(order):
            yield order[start : start + size]
            start, size = start + size, 2 * size

    def _known(self) -> Configured:
        """Home and all solved configurations."""
        solved = self.best.subset(np.flatnonzero(self.solved))
        return Configured(
            *(
                np.concatenate(parts)
                for parts in (
                    (self.home.actuated, solved.actuated),
                    (self.home.passive, solved.passive),
                    (self.home.distance, solved.distance),
                )
            )
        )

    def _improve(self, todo: IntArray, starts: Configured, count: int) -> None:
        """Search for the goals `todo`, each from the `count` nearest starts; keep what is better."""
        count = min(count, len(starts.actuated))
        if len(todo) == 0 or count == 0:
            return
        nearest_starts = scipy.spatial.cKDTree(self._features_at(starts)).query(
            self._features[todo], k=range(1, count + 1)
        )[1]
        found = descend(self.reach, np.repeat(todo, count), starts.subset(nearest_starts.ravel()))
        best = np.argmin(found.distance.reshape(-1, count), axis=1) + count * np.arange(len(todo))
        better = np.flatnonzero(found.distance[best] < self.best.distance[todo])
        self.keep(todo[better], found.subset(best[better]))

    def _features_at(self, at: Configured) -> FloatArray:
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
    """Coordinates in which poses that are alike are near each other, (n, k) [m]."""
    parts = [positions]
    if rotations is not None:
        parts.append(length * rotations.reshape(-1, 9) / np.sqrt(2))
    if directions is not None:
        parts.append(length * directions)
    return np.concatenate(parts, axis=1)


def _spread(robot: Robot, reach: Reach) -> Configured:
    """Configurations spread over the joint limits (one turn about home where there are none) that close."""
    turn, n_actuated = np.pi * robot.mechanism.joint_scale, len(robot.home)
    lower, upper = reach.lower[:n_actuated], reach.upper[:n_actuated]
    lower = np.where(np.isfinite(lower), lower, robot.home - turn)
    upper = np.where(np.isfinite(upper), upper, robot.home + turn)
    sample = halton(_SPREAD, n_actuated)
    actuated = reach.mechanism.untilted(np.array(lower + sample * (upper - lower), dtype=np.float64))
    closed = loops.close(reach.mechanism, reach.mode, actuated)
    return Configured(actuated[closed.ok], closed.passive[closed.ok], np.full(int(closed.ok.sum()), np.inf))
