"""Joint values that reach goals, through closed loops, with the robot's current (calibrated) parameters.

`calib.programs.reaching.reaching` has the iteration from one start; `Search` chooses the starts. Goals are solved
nearest to home first, each from the nearest solved goal. Failed goals are tried again from other neighbours, and then
from configurations spread evenly over the joint limits (the same for every description of the robot). Every iteration
is local, so a goal reported out of reach is not proven so, but the spread starts make it unlikely that a reachable goal
is missed. Assembly mode and joint limits are kept; where the goal leaves a choice, the solution stays near home or near
given joint values.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import ArrayLike

from calib.core.base.arrays import BoolArray, FloatArray, IntArray, ReadOnlyArrays, numbers_in
from calib.core.base.errors import DataError, InputError, UnreachablePoseError, nearest
from calib.core.base.units import quantity_text
from calib.core.base.words import count_noun, listing
from calib.core.data.measurements import Poses
from calib.core.robots import loops
from calib.core.robots.closure import motion
from calib.core.robots.configurations import joint_vector
from calib.core.robots.joint_errors import actual_joints, term_columns
from calib.core.robots.joint_sampling import joint_samples
from calib.core.robots.loading import RobotLike
from calib.core.robots.robot import Robot
from calib.core.robots.terms.term import Context
from calib.core.rows.frames import KnownRobot
from calib.programs.reaching.correction_frames import Calibrated, known_robot, measurement_frame
from calib.programs.reaching.expected_errors import ExpectedError
from calib.programs.reaching.goals import Goals, goals_of_poses
from calib.programs.reaching.joint_commands import commands_for
from calib.programs.reaching.reaching import GoalConfigurations, Reach, descend
from calib.programs.reaching.redundancy import near_joints, without_full_turns

TOLERANCE = 1e-9
"""Largest miss of a reached goal [m, rad]."""
_NEIGHBOURS = 3
_SPREAD, _SPREAD_NEIGHBOURS = 256, (8, 64)
_LARGEST_ROUND = 8192  # iterations in one round


def _within_joint_limits(reach: Reach, q: FloatArray) -> FloatArray:
    """Joint values (..., n_actuated) clipped to the joint limits."""
    n = q.shape[-1]
    return np.clip(q, reach.lower[:n], reach.upper[:n])


class Search:
    """The best known configuration for each goal, from home (clipped to the joint limits) on."""

    def __init__(self, reach: Reach, robot: Robot) -> None:
        n = len(reach.goals)
        start = robot.assemble(_within_joint_limits(reach, robot.home))
        self.reach, self.home = reach, GoalConfigurations.unknown(start.actuated, start.passive)
        self._reached = TOLERANCE * min(1.0, reach.mechanism.length)
        self.best = reach.as_given(np.arange(n), self.home.subset(np.zeros(n, dtype=np.intp)))
        given = _features(reach, reach.goals.positions, reach.goals.rotations, reach.goals.directions)
        self._features = np.where(np.isnan(given), self._features_at(self.home), given)

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
        position, rotation, *_ = motion(self.reach.mechanism, self.reach.target, at.actuated, at.passive)
        return _features(self.reach, position, rotation, rotation[:, :, 2])


def _features(
    reach: Reach, positions: FloatArray, rotations: FloatArray | None, directions: FloatArray | None
) -> FloatArray:
    """Coordinates (n, k) [m] of what the goals state, in which similar poses are near each other."""
    parts, length = [positions], reach.mechanism.length
    if reach.goals.rotations is not None and rotations is not None:
        parts.append(length * rotations.reshape(-1, 9) / np.sqrt(2))
    if reach.goals.directions is not None and directions is not None:
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


BETWEEN_SIDES = "needs a joint inside its play, where no command can hold it"
_ROUNDS = 20
_SETTLED = 1e-14  # change of a tilt [rad]


@dataclass(frozen=True, eq=False)
class Solution(ReadOnlyArrays):
    """Joint values, and their errors at the goals.

    Attributes:
        q: Actuated joints, (n, n_actuated) [m or rad]; the nearest found where `ok` is False.
        ok: Mask of the goals reached to `TOLERANCE` at joint values that `Robot.assemble` accepts, (n,).
        miss_position: Distance from the goal, (n,) [m].
        miss_angle: Angle from the orientation or direction of the goal, (n,) [rad]; 0 where there is no goal.
        positions: Positions of the target at `q`, (n, 3) [m].
        labels: Name of each goal in messages.
        expected: Expected errors of the real robot. If the verdict finds nothing to correct, `q` is for the nominal
            robot, and these are the errors of the calibrated robot.
    """

    q: FloatArray
    ok: BoolArray
    miss_position: FloatArray
    miss_angle: FloatArray
    positions: FloatArray
    labels: tuple[str, ...]
    expected: ExpectedError

    def __str__(self) -> str:
        n, reached = len(self.q), int(np.sum(self.ok))
        worst = quantity_text(self.miss_position.max(), "mm", ".2g") if n else "nothing"
        following = (
            "send q to the robot, or write it as a file: calib solve ROBOT GOALS --out FILE"
            if reached == n
            else "take goals that are in reach: misses() says what is wrong with each of the others"
        )
        return (
            f"{reached} of {count_noun(n, 'goal')} reached; the largest miss is {worst}\n"
            f"Inside: q {self.q.shape} [m or rad]; ok, which goals are reached; miss_position [m] and miss_angle [rad];"
            " positions, where the target is at q [m]; expected, how far off the real robot will be\n"
            f"Next: {following}"
        )

    def unreached_goals(self) -> list[str]:
        """Return a phrase for every goal that is out of reach."""
        return [f"{self.labels[k]} {self.miss(k)}" for k in map(int, np.flatnonzero(~self.ok))]

    def miss(self, k: int) -> str:
        """Return the miss of goal k, in words."""
        length, angle = float(self.miss_position[k]), float(self.miss_angle[k])
        if not np.isfinite(self.q[k]).all():
            return BETWEEN_SIDES
        if length <= TOLERANCE and angle <= TOLERANCE:
            return "can be reached, but no way there was found from home in its assembly mode"
        return f"misses by {quantity_text(length, 'mm', '.3f')}" + (
            f" and {quantity_text(angle, 'deg', '.3f')}" if angle > TOLERANCE else ""
        )

    def require_all(self) -> None:
        """Raise `UnreachablePoseError` that names the goals out of reach."""
        misses = self.unreached_goals()
        if misses:
            more = f" (and {len(misses) - 5} more)" if len(misses) > 5 else ""
            raise UnreachablePoseError(
                f"out of reach within the joint limits, in home's assembly mode:"
                f" {'; '.join(misses[:5])}{more}; goals are {self.expected.frame}; move these"
                " goals, leave them out, or leave empty the cells of coordinates that need not be met"
            )


def solve(
    calibrated: RobotLike | Calibrated | KnownRobot, goals: Goals | ArrayLike, *, near: ArrayLike | None = None
) -> Solution:
    """Find joint values that bring a target to its goals in the measurement frame.

    Args:
        calibrated: The robot with nominal or calibrated parameters, its description, or its URDF. A fit or a loaded
            result also gives expected errors; if its verdict finds nothing to correct, the nominal robot is used, with
            base and targets placed for the best agreement with the calibrated robot.
        goals: `Goals`; or positions of the first target, (n, 3) [m], with NaN in the same free coordinates of all rows;
            or poses of that target as `robot.forward` gives them, (n, 4, 4) or (4, 4).
        near: Joint values to stay near where a goal leaves a choice, (n_actuated,) or (n, n_actuated) [m or rad];
            default: home.

    Raises:
        InputError: `calibrated` is not a robot, or the goals are joint values.
        DataError: Unknown target, `near` of the wrong shape, or a position with NaN in some of its coordinates.
    """
    frame = measurement_frame(known_robot(calibrated))
    robot, goals = frame.meant if frame.nothing_to_correct else frame.robot, _goals(goals)
    reach = problem(robot, goals)
    conditions = goals.conditions(len(robot.home))
    best = _search(robot, reach, _near(robot, reach, near), conditions)
    positions, miss, angle = reach.deviations(best.actuated, best.passive)
    index = np.arange(len(goals))
    commands = reach.with_uncommanded(index, commands_for(robot, best.actuated, conditions))
    ok = (miss <= TOLERANCE) & (angle <= TOLERANCE) & np.isfinite(commands).all(axis=1)
    reached = np.flatnonzero(ok)
    columns = term_columns(robot, commands[reached], conditions.select(reached))
    ok[reached] = robot.close(commands[reached], columns=columns).ok  # the loops were followed from elsewhere
    reached = np.flatnonzero(ok)
    expected = ExpectedError.from_frame(frame, goals, commands[reached], reached, conditions.select(reached))
    return Solution(commands, ok, miss, angle, positions, goals.labels, expected)


def _goals(goals: Goals | ArrayLike) -> Goals:
    """Goals from an array; all positions of an array have the same free coordinates."""
    if isinstance(goals, Poses):
        raise InputError("goals: are joint values; give positions (n, 3) [m], or calib.Goals")
    if isinstance(goals, Goals):
        return goals
    values = numbers_in(goals, "goals")
    if values.shape[-2:] == (4, 4) and values.ndim in (2, 3):
        return goals_of_poses(values)
    goals = Goals(np.atleast_2d(values))
    odd = np.any(np.isnan(goals.positions) != np.isnan(goals.positions[:1]), axis=1)
    if np.any(odd):
        raise DataError(
            f"{goals.labels[int(np.argmax(odd))]}: its NaN coordinates are not those of the first goal; a coordinate"
            " that is left free is NaN in all goals. Or give calib.Goals"
        )
    return goals


def _near(robot: Robot, reach: Reach, near: ArrayLike | None) -> FloatArray:
    """Commands near which each goal is solved, inside the joint limits, (n, n_actuated) [m or rad]."""
    n = len(reach.goals)
    commands = robot.home if near is None else joint_vector(robot, near)
    if np.ndim(commands) == 2 and len(commands) not in (1, n):
        raise DataError(f"near: {len(commands)} rows for {n} goals; give one row, or one for each")
    return _within_joint_limits(reach, np.broadcast_to(commands, (n, len(robot.home))))


def _search(robot: Robot, reach: Reach, near: FloatArray, conditions: Context) -> GoalConfigurations:
    """The best configuration for each goal, as near to commands (n, n_actuated) as the goal allows."""
    joints = actual_joints(robot, near, term_columns(robot, near, conditions))
    search = Search(reach, robot)
    search.run(robot)
    solved = np.flatnonzero(search.is_solved)
    turned = without_full_turns(reach, search.best.subset(solved), joints[solved])
    search.best.take(solved, near_joints(reach, solved, turned, joints[solved]))
    return with_tilts(robot, reach, np.arange(len(reach.goals)), search.best, conditions)


def problem(robot: Robot, goals: Goals) -> Reach:
    """Return the problem of reaching goals within the joint limits.

    Raises:
        DataError: The robot does not have the target.
        InputError: The robot has joints that are not commanded, and the goals do not give their values.
    """
    lacking = [name for name in robot.sensed_names if name not in goals.stands]
    if lacking:
        raise InputError(
            f"{robot.path}: inclinometers read {listing(lacking)}, so these are not commanded; give their values at"
            " each goal, in columns of these joints or of their sensors (in Python: calib.Goals with stands); if a"
            " program cannot have such columns, make these joints fixed in the URDF, at their present values"
        )
    target = robot.mechanism.targets[0]
    if goals.target:
        named = {pair.name: pair for pair in robot.mechanism.targets}
        if goals.target not in named:
            raise DataError(f"no target '{goals.target}'{nearest(goals.target, named)}")
        target = named[goals.target]
    lower, upper = robot.urdf.limits(robot.mechanism.driven)
    stands = np.isin(robot.mechanism.driven, robot.sensed_names)  # their limits do not apply
    lower, upper = np.where(stands, -np.inf, lower), np.where(stands, np.inf, upper)
    return Reach(robot.mechanism, robot.mode, target, goals, lower, upper)


def with_tilts(
    robot: Robot, reach: Reach, index: IntArray, solution: GoalConfigurations, context: Context
) -> GoalConfigurations:
    """Descend again until tilts of links and uncommanded joints agree with the commands, for the goals `index` (n,).

    These values are small and nearly equal at neighbouring joint values, so each round gains digits.
    """
    for _ in range(_ROUNDS if np.any(reach.fixed_joints) and robot.terms else 0):
        commands = reach.with_uncommanded(index, commands_for(robot, solution.actuated, context))
        commands = np.where(np.isfinite(commands), commands, solution.actuated[:, : commands.shape[1]])
        driven = actual_joints(robot, commands, term_columns(robot, commands, context))
        if np.max(np.abs(driven - solution.actuated)[:, reach.fixed_joints], initial=0.0) < _SETTLED:
            break
        closed = loops.close(reach.mechanism, reach.mode, driven, solution.passive)
        passive = np.where(closed.ok[:, None], closed.passive, solution.passive)
        solution = descend(reach, index, GoalConfigurations(driven, passive, solution.distance))
    return solution
