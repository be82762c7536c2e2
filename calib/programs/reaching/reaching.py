"""Moving a robot's actuated joints towards goals of a target, through closed loops.

Problem. Find actuated joints a within limits so that the target, seen from the measurement frame, has the position p*
and, if the goal states them, the orientation R* or the direction z* of its z axis. The closures r(a, p) = 0 determine
the passive joints p, so the target moves with

    [dp; w] = (X_a - X_p C_p^-1 C_a) da            (implicit function theorem; X, C: derivatives of pose and closures)

in the axes of the measurement frame.

Method. Levenberg-Marquardt on e = [p - p*; L log3(R*^T R)] or [p - p*; L (R z - z*)], L the robot's characteristic
length. (The body's angular velocity in place of the derivative of log3 gives the exact gradient everywhere, and the
exact derivative at the solution.) An actuated joint at a limit is held if the step would take it beyond. A passive
joint near its limit is kept there by a heavy row, dp = -C_p^-1 C_a da, and a step that would carry another passive
joint past its limit is cut. The loops follow each trial step by its tangent and Newton, which keeps the assembly mode
of home (see `calib.core.robots.loops`); a step that they cannot follow counts as too long. All goals advance together
in arrays.

Tilts of links (`calib.core.robots.mechanism`) and uncommanded joints keep their values from the start.

When it fails. Local minima of |e| exist; `calib.programs.reaching.inverse` starts from several places. At a singular
pose of the robot convergence is slow, and the joint values are only as sharp as the pose determines them.

Reference: levenberg1944, marquardt1963.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
import pinocchio as pin

from calib.core.base.arrays import BoolArray, FloatArray, IntArray
from calib.core.robots import loops
from calib.core.robots.closure import AssemblyMode, motion
from calib.core.robots.continuation import newton
from calib.core.robots.mechanism import Mechanism, RelativeFrame
from calib.programs.reaching.goals import Goals

_CONVERGED = 2e-13  # norm of e at which rounding dominates [m]
LARGEST_STEP = 0.5  # largest step of a joint [rad, or characteristic lengths]
_ITERATIONS = 100
NEARLY = 1e-11  # a step without gain is rounding if the norm of e is less [m]
_SMALLEST_GAIN = 1e-7  # relative decrease of the distance that justifies another step
_SMALLEST_DAMPING, _LARGEST_DAMPING = 1e-12, 1e6  # relative to the mean diagonal of J^T J
NEAR_LIMIT = 1e-3  # a passive joint this close to its limit is held back [rad, or characteristic lengths]
_HEAVY = 1e3  # weight of the row that holds it


class ConfigurationRows:
    """Base of dataclasses of arrays with one row for each configuration."""

    def subset(self, index: IntArray) -> Self:
        """Return the rows with these indices (n,)."""
        return type(self)(*(values[index] for values in vars(self).values()))

    def take(self, index: IntArray, other: Self) -> None:
        """Overwrite the rows with these indices (n,) by the n rows of `other`."""
        for name, values in vars(self).items():
            values[index] = getattr(other, name)


@dataclass(frozen=True, eq=False)
class GoalConfigurations(ConfigurationRows):
    """Configurations during the search.

    Attributes:
        actuated: The driven joints, (n, n_driven) [m or rad].
        passive: (n, n_passive) [m or rad].
        distance: Norm of e, (n,) [m]; infinite where not yet computed.
    """

    actuated: FloatArray
    passive: FloatArray
    distance: FloatArray

    @classmethod
    def unknown(cls, actuated: FloatArray, passive: FloatArray) -> GoalConfigurations:
        """Return configurations, (n, n_driven) and (n, n_passive), with distances not yet computed."""
        return cls(actuated, passive, np.full(len(actuated), np.inf))


@dataclass(frozen=True, eq=False)
class LinearisedGoals(ConfigurationRows):
    """Errors of configurations at their goals, and their derivatives, joints scaled to radians.

    Attributes:
        error: e of the module docstring, (n, n_rows) [m].
        slope: J, its derivative by the actuated joints, (n, n_rows, n_actuated).
        passive_slope: G, the derivative of the passive joints by the actuated joints, (n, n_passive, n_actuated).
    """

    error: FloatArray
    slope: FloatArray
    passive_slope: FloatArray


@dataclass(frozen=True, eq=False)
class Reach:
    """Goals of one target of one robot.

    Attributes:
        mechanism: The robot.
        mode: Its assembly mode.
        target: The measured point seen from the measurement frame.
        goals: Goals of the target.
        lower, upper: Limits of the driven joints, (n_driven,) [m or rad].
    """

    mechanism: Mechanism
    mode: AssemblyMode
    target: RelativeFrame
    goals: Goals
    lower: FloatArray
    upper: FloatArray

    @property
    def scale(self) -> FloatArray:
        """Scale of each driven joint: 1 [rad], or the characteristic length [m], (n_driven,)."""
        return self.mechanism.driven_scale

    @cached_property
    def fixed_joints(self) -> BoolArray:
        """Mask of the driven joints that keep their values: tilts of links and uncommanded joints, (n_driven,)."""
        return self.mechanism.is_tilt | np.isin(self.mechanism.driven, list(self.goals.stands))

    def with_uncommanded(self, index: IntArray, commands: FloatArray) -> FloatArray:
        """Return commands (n, n_actuated) for the goals `index`, with the values of uncommanded joints."""
        commands = commands.copy()
        for name in self.goals.stands:
            commands[:, self.mechanism.actuated.index(name)] = np.asarray(self.goals.stands[name])[index]
        return commands

    def as_given(self, index: IntArray, at: GoalConfigurations) -> GoalConfigurations:
        """Return configurations with the uncommanded joints of the goals `index` (n,); loops closed."""
        if not self.goals.stands:
            return at
        n = len(self.mechanism.actuated)
        actuated = np.hstack([self.with_uncommanded(index, at.actuated[:, :n]), at.actuated[:, n:]])
        closed = loops.close(self.mechanism, self.mode, actuated, at.passive)
        passive = np.where(closed.ok[:, None], closed.passive, at.passive)
        return GoalConfigurations.unknown(actuated, passive)

    def linearise(
        self, index: IntArray, actuated: FloatArray, passive: FloatArray, closures: FloatArray | None = None
    ) -> LinearisedGoals:
        """Return e and its derivative at closed configurations, (n, n_actuated) and (n, n_passive), for the goals
        `index`.

        `closures` are [C_p C_a] there if known, (n, n_passive, n_passive + n_actuated).
        """
        position, rotation, jacobian, by_joint = motion(self.mechanism, self.target, actuated, passive, closures)
        jacobian = jacobian * self.scale
        given = ~np.isnan(self.goals.positions[index])
        error, slope = [self.goals.distances(position, index)], [jacobian[:, :3] * given[:, :, None]]
        length = self.mechanism.length
        if self.goals.rotations is not None:
            relative = self.goals.rotations[index].transpose(0, 2, 1) @ rotation
            error.append(length * np.array([pin.log3(turn) for turn in relative]).reshape(-1, 3))
            slope.append(length * rotation.transpose(0, 2, 1) @ jacobian[:, 3:])
        if self.goals.directions is not None:
            axis = rotation[:, :, 2]
            error.append(length * (axis - self.goals.directions[index]))
            slope.append(length * np.cross(jacobian[:, 3:], axis[:, :, None], axis=1))
        return LinearisedGoals(
            np.concatenate(error, axis=1),
            np.concatenate(slope, axis=1),
            by_joint * self.scale / self.mechanism.passive_scale[:, None],
        )

    def deviations(self, actuated: FloatArray, passive: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return positions (n, 3) [m], their distances (n,) [m] and angles (n,) [rad] from every goal.

        The configurations are `actuated` (n, n_actuated) and `passive` (n, n_passive).
        """
        position, rotation, *_ = motion(self.mechanism, self.target, actuated, passive)
        angle = np.zeros(len(position))
        if self.goals.rotations is not None:
            relative = self.goals.rotations.transpose(0, 2, 1) @ rotation
            angle = np.array([np.linalg.norm(pin.log3(turn)) for turn in relative])
        if self.goals.directions is not None:
            directions, axis = self.goals.directions, rotation[:, :, 2]
            angle = np.arctan2(np.linalg.norm(np.cross(directions, axis), axis=1), np.sum(directions * axis, axis=1))
        return position, np.linalg.norm(self.goals.distances(position), axis=1), angle

    def follow(
        self, at: GoalConfigurations, linear: LinearisedGoals, trial: FloatArray
    ) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Follow the loops from closed configurations to actuated joints (n, n_actuated) by the tangent and Newton.

        Returns passive joints (n, n_passive) [m or rad], [C_p C_a] (n, n_passive, n_passive + n_actuated), and the mask
        of loops that are closed within their limits (n,).
        """
        if not self.mechanism.loops:
            return at.passive, np.zeros((len(trial), 0, trial.shape[1])), np.ones(len(trial), dtype=bool)
        change = np.einsum("nij,nj->ni", linear.passive_slope, (trial - at.actuated) / self.scale)
        guess = at.passive + self.mechanism.passive_scale * change
        passive, by_passive, by_actuated, ok = newton(self.mechanism, self.mode, trial, guess)
        passive = loops.wrap_turns(self.mechanism, self.mode, passive)
        closures = np.concatenate([by_passive, by_actuated], axis=2)
        return passive, closures, ok & loops.are_within_limits(self.mechanism, passive)

    def room(self, passive: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return scaled distances of passive joints (n, n_passive) from their lower and upper limits."""
        below, above = passive - self.mechanism.lower, self.mechanism.upper - passive
        return below / self.mechanism.passive_scale, above / self.mechanism.passive_scale


def descend(
    reach: Reach, index: IntArray, start: GoalConfigurations, iterations: int = _ITERATIONS
) -> GoalConfigurations:
    """Bring the target as near to the goals `index` (n,) as so many trial steps from closed configurations go."""
    at = GoalConfigurations.unknown(start.actuated.copy(), start.passive.copy())
    if len(index) == 0:
        return at
    linear = reach.linearise(index, at.actuated, at.passive)
    at.distance[:] = np.linalg.norm(linear.error, axis=1)
    damping = np.full(len(index), 1e-3)
    active = np.flatnonzero(at.distance > _CONVERGED)
    for _ in range(iterations):
        if len(active) == 0:
            break
        current = linear.subset(active)
        trial = _trial(reach, at.subset(active), current, damping[active])
        passive, closures, followed = reach.follow(at.subset(active), current, trial)
        moved = np.flatnonzero(followed)
        distance = np.full(len(active), np.inf)
        if len(moved):
            trial_linear = reach.linearise(index[active[moved]], trial[moved], passive[moved], closures[moved])
            distance[moved] = np.linalg.norm(trial_linear.error, axis=1)
            gained = distance[moved] < at.distance[active[moved]]
            linear.take(active[moved[gained]], trial_linear.subset(np.flatnonzero(gained)))
        gain = (at.distance[active] - distance) / at.distance[active]
        better = gain > 0
        good, bad = active[better], active[~better]
        at.actuated[good], at.passive[good], at.distance[good] = trial[better], passive[better], distance[better]
        damping[good] = np.maximum(damping[good] / 10, _SMALLEST_DAMPING)
        damping[bad] *= 8
        stuck = np.where(
            better,
            (gain < _SMALLEST_GAIN) & (distance > NEARLY),
            (damping[active] > _LARGEST_DAMPING) | (at.distance[active] < NEARLY),
        )
        active = active[~stuck & (at.distance[active] > _CONVERGED)]
    return at


def _trial(reach: Reach, at: GoalConfigurations, linear: LinearisedGoals, damping: FloatArray) -> FloatArray:
    """Next actuated joints to try, (n, n_actuated) [m or rad]: a damped step within all limits."""
    nothing = np.zeros(linear.passive_slope.shape[:2])
    step = _damped_step(reach, at, linear, damping, nothing, nothing)
    if nothing.size:
        room_below, room_above = reach.room(at.passive)
        change = np.einsum("nij,nj->ni", linear.passive_slope, step)
        below, above = (room_below < NEAR_LIMIT) & (change < 0), (room_above < NEAR_LIMIT) & (change > 0)
        # the heavy rows aim at half the band, so that curvature carries no joint past its limit
        aim = np.where(below, NEAR_LIMIT / 2 - room_below, 0.0)
        aim = np.where(above, room_above - NEAR_LIMIT / 2, aim)
        step = _damped_step(reach, at, linear, damping, _HEAVY * (below | above), aim)
        change = np.einsum("nij,nj->ni", linear.passive_slope, step)
        room = np.maximum(np.where(change < 0, room_below, room_above) - NEAR_LIMIT / 2, NEAR_LIMIT / 4)
        step *= np.min(np.minimum(1.0, room / np.maximum(np.abs(change), 1e-300)), axis=1, keepdims=True)
    longest = np.max(np.abs(step), axis=1, keepdims=True)
    step = step * np.minimum(1.0, LARGEST_STEP / np.maximum(longest, 1e-300))
    return np.clip(at.actuated + reach.scale * step, reach.lower, reach.upper)


def _damped_step(
    reach: Reach,
    at: GoalConfigurations,
    linear: LinearisedGoals,
    damping: FloatArray,
    weight: FloatArray,
    aim: FloatArray,
) -> FloatArray:
    """Minimise |e + J s|^2 + |weight (G s - aim)|^2 + damping |s|^2 over joints that no limit holds."""
    slope, n_joints = linear.slope, linear.slope.shape[2]
    size = np.einsum("nij,nij->n", slope, slope)[:, None] / n_joints + 1e-300
    weighted = weight[:, :, None] * linear.passive_slope * np.sqrt(size)[:, :, None]
    gradient = np.einsum("nij,ni->nj", slope, linear.error) - np.einsum(
        "nij,ni->nj", weighted, weight * aim * np.sqrt(size)
    )
    held = ((at.actuated <= reach.lower) & (gradient > 0)) | ((at.actuated >= reach.upper) & (gradient < 0))
    held |= reach.fixed_joints
    rows = np.where(held[:, None, :], 0.0, np.concatenate([slope, weighted], axis=1))
    normal = rows.transpose(0, 2, 1) @ rows + (damping[:, None] * size)[:, :, None] * np.eye(n_joints)
    return -np.linalg.solve(normal, np.where(held, 0.0, gradient)[:, :, None])[:, :, 0]
