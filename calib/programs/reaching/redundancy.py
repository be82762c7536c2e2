"""Redundant robots: of all configurations that reach a goal, the one nearest to given joint values.

Problem. Minimise f = |w|^2 / 2 over the actuated joints s within their limits, such that the target stays at its goal,
e(s) = 0. Here w = s* - s is the difference to the given joint values s* (lengths divided by the robot's characteristic
length).

Method. Sequential quadratic programming. The constraints are c = [e; distances of passive joints from the limits that
hold them]. A is the derivative of c by the joints that no limit holds, and P the projector on the null space of A. The
step

    d = -A^+ c + n,      P B P n = P (w + B A^+ c)

goes back to the goal and along it at once. B is the Hessian of the Lagrangian f + c^T l, with the multipliers
l = (A^+)^T w. It starts at the identity, which is the Hessian of f, and learns the curvature of the goal from the steps
by the damped BFGS formula (powell1978), so that convergence is faster than linear. A step is accepted if it lowers

    |w + A^+ c|^2 / 2 + sigma |A^+ c|^2 / 2

The first term is, to second order, the value of f once the goal is reached again. So the curvature of the goal alone
shortens no step (fletcher1970). If a step is not accepted, a third of it is tried, and B is the identity again. A step
ends at the first limit that it meets. An actuated joint at a limit is held if the step would cross the limit; a passive
joint is held as in `calib.programs.reaching.reaching`. At the end `descend` removes the last picometres of e.

When it fails. The answer is a local minimum. If steps become too short, or their number is exhausted, the last
configuration is returned; it is never farther from s* than the start.
"""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray, IntArray
from calib.core.numerics import linalg
from calib.programs.reaching.reaching import (
    LARGEST_STEP,
    NEAR_LIMIT,
    NEARLY,
    ConfigurationRows,
    GoalConfigurations,
    LinearisedGoals,
    Reach,
    descend,
)

_STEPS = 60
_TOLERANCE = 1e-7  # tolerance of w within the null space [rad, or characteristic lengths]
_SHORTEST = 1e-3  # smallest tried part of a step
_WEIGHT = 100.0  # sigma; with 20, two in a hundred searches end early, with 1 one search in seven
_ROUNDING = 1e-12  # rounding of a step: a smaller component crosses no limit


def without_full_turns(reach: Reach, at: GoalConfigurations, near: FloatArray) -> GoalConfigurations:
    """Subtract whole turns of joints where this brings them nearer to `near`, (n, n_actuated), within limits."""
    mechanism, actuated = reach.mechanism, at.actuated.copy()
    for j in np.flatnonzero(mechanism.actuated_repeats).tolist():
        turns = 2 * np.pi * np.round((actuated[:, j] - near[:, j]) / (2 * np.pi))
        inside = (actuated[:, j] - turns >= reach.lower[j]) & (actuated[:, j] - turns <= reach.upper[j])
        actuated[inside, j] -= turns[inside]
    return GoalConfigurations(actuated, at.passive, at.distance)


def near_joints(reach: Reach, index: IntArray, start: GoalConfigurations, near: FloatArray) -> GoalConfigurations:
    """Move solved configurations towards the actuated joints `near`, (n, n_actuated), keeping the goals."""
    n, n_joints = start.actuated.shape
    at = deepcopy(start)
    linear = reach.linearise(index, at.actuated, at.passive)
    hessian, part = np.tile(np.eye(n_joints), (n, 1, 1)), np.ones(n)
    active = np.arange(n)
    for _ in range(_STEPS):
        current, now = linear.subset(active), at.subset(active)
        way = (near[active] - now.actuated) / reach.scale
        held, step, left = _step(reach, now, current, way, hessian[active])
        moving = np.flatnonzero((left > _TOLERANCE) | (np.linalg.norm(current.error, axis=1) > NEARLY))
        active = active[moving]
        if len(active) == 0:
            break
        now, current, held, step = now.subset(moving), current.subset(moving), held.subset(moving), step[moving]
        trial = _trial(reach, now, current, held, part[active], step)
        good, reached, trial_linear, change = _successful_trials(
            reach, index[active], now, current, held, trial, near[active]
        )
        part[active] /= 3
        accepted = active[good]
        part[accepted] = np.minimum(1.0, 6 * part[accepted])
        bad = np.setdiff1d(active, accepted)
        hessian[bad] = np.eye(n_joints)
        hessian[accepted] = _update_hessian(
            hessian[accepted], (reached.actuated - at.actuated[accepted]) / reach.scale, change
        )
        at.take(accepted, reached)
        linear.take(accepted, trial_linear)
        active = active[part[active] > _SHORTEST]
    reached = descend(reach, index, at, 8)
    closer = np.linalg.norm((reached.actuated - near) / reach.scale, axis=1) < np.linalg.norm(
        (start.actuated - near) / reach.scale, axis=1
    )
    kept = np.flatnonzero(~closer | (reached.distance > NEARLY))
    reached.take(kept, start.subset(kept))
    return reached


@dataclass(frozen=True, eq=False)
class _ActiveLimits(ConfigurationRows):
    """Masks of joints at active limits: actuated, passive, and passive joints nearer to their lower limit."""

    joints: BoolArray
    passive: BoolArray
    low: BoolArray

    def rows(self, linear: LinearisedGoals) -> FloatArray:
        """Return A with columns for the held joints too, (n, n_rows + n_passive, n_actuated)."""
        return np.concatenate([linear.slope, self.passive[:, :, None] * linear.passive_slope], axis=1)

    def gap(self, reach: Reach, linear: LinearisedGoals, passive: FloatArray) -> FloatArray:
        """Return c, (n, n_rows + n_passive)."""
        below, above = reach.room(passive)
        off = np.where(self.low, below - NEAR_LIMIT / 2, NEAR_LIMIT / 2 - above)
        return np.concatenate([linear.error, np.where(self.passive, off, 0.0)], axis=1)


def _step(
    reach: Reach, at: GoalConfigurations, linear: LinearisedGoals, way: FloatArray, hessian: FloatArray
) -> tuple[_ActiveLimits, FloatArray, FloatArray]:
    """The active limits, the step d (n, n_actuated), and the largest entry of P w that remains, (n,)."""
    below, above = reach.room(at.passive)
    low, high = at.actuated <= reach.lower, at.actuated >= reach.upper
    held = _ActiveLimits(np.tile(reach.fixed_joints, (len(low), 1)), np.zeros(below.shape, dtype=bool), below < above)
    for _ in range(low.shape[1] + 1):
        inverse, projector = _inverse(held.rows(linear), held)
        back = -np.einsum("nij,nj->ni", inverse, held.gap(reach, linear, at.passive))
        matrix = projector @ hessian @ projector + np.eye(low.shape[1]) - projector
        aim = projector @ (way[:, :, None] - hessian @ back[:, :, None])
        step = back + (projector @ np.linalg.solve(matrix, aim))[:, :, 0]
        change = np.einsum("nij,nj->ni", linear.passive_slope, step)
        outward = ((low & (step < -_ROUNDING)) | (high & (step > _ROUNDING))) & ~held.joints
        passive = ((below < NEAR_LIMIT) & (change < -_ROUNDING)) | ((above < NEAR_LIMIT) & (change > _ROUNDING))
        passive &= ~held.passive
        if not (np.any(outward) or np.any(passive)):
            break
        held = _ActiveLimits(held.joints | outward, held.passive | passive, held.low)
    return held, step, np.max(np.abs(projector @ way[:, :, None]), axis=(1, 2))


def _inverse(rows: FloatArray, held: _ActiveLimits) -> tuple[FloatArray, FloatArray]:
    """A^+ (n, n_actuated, n_rows) and P (n, n_actuated, n_actuated), both zero in the rows of held joints."""
    left, values, right = linalg.svd(np.where(held.joints[:, None, :], 0.0, rows), full_matrices=False)
    used = values > 1e-9 * values[:, :1]
    weights = np.where(used, 1 / np.where(used, values, 1.0), 0.0)
    inverse = (right * weights[:, :, None]).transpose(0, 2, 1) @ left.transpose(0, 2, 1)
    taken = np.where(used[:, :, None], right, 0.0)
    projector = np.eye(rows.shape[2]) - taken.transpose(0, 2, 1) @ taken
    projector = np.where(held.joints[:, :, None] | held.joints[:, None, :], 0.0, projector)
    return inverse, projector


def _trial(
    reach: Reach,
    at: GoalConfigurations,
    linear: LinearisedGoals,
    held: _ActiveLimits,
    part: FloatArray,
    step: FloatArray,
) -> FloatArray:
    """Actuated joints after a part of the step, or at the first limit on the way, (n, n_actuated)."""
    change = np.einsum("nij,nj->ni", linear.passive_slope, step)
    room = np.where(step < 0, at.actuated - reach.lower, reach.upper - at.actuated) / reach.scale
    below, above = reach.room(at.passive)
    passive_room = np.maximum(np.where(change < 0, below, above) - NEAR_LIMIT / 2, NEAR_LIMIT / 4)
    length = part * np.minimum(1.0, LARGEST_STEP / np.maximum(np.max(np.abs(step), axis=1), 1e-300))
    for moved, space, free in ((step, room, ~held.joints), (change, passive_room, ~held.passive)):
        ratio = space / np.maximum(np.abs(moved), 1e-300)
        length = np.minimum(length, np.min(ratio, axis=1, initial=np.inf, where=free & (np.abs(moved) > _ROUNDING)))
    return np.clip(at.actuated + length[:, None] * reach.scale * step, reach.lower, reach.upper)


def _successful_trials(
    reach: Reach,
    index: IntArray,
    at: GoalConfigurations,
    linear: LinearisedGoals,
    held: _ActiveLimits,
    trial: FloatArray,
    near: FloatArray,
) -> tuple[IntArray, GoalConfigurations, LinearisedGoals, FloatArray]:
    """Indices (n,) of trials that lower the merit, their configurations and derivatives, and the change of A^T l."""
    passive, closures, followed = reach.follow(at, linear, trial)
    moved = np.flatnonzero(followed)
    trial_linear = reach.linearise(index[moved], trial[moved], passive[moved], closures[moved])
    tied = held.subset(moved)
    before = held.rows(linear)[moved]
    merit, _ = _merit(
        before, held.gap(reach, linear, at.passive)[moved], tied, (near - at.actuated)[moved] / reach.scale
    )
    rows, gap = tied.rows(trial_linear), tied.gap(reach, trial_linear, passive[moved])
    new, multipliers = _merit(rows, gap, tied, (near - trial)[moved] / reach.scale)
    lower = np.flatnonzero(new < merit)
    good = moved[lower]
    change = np.einsum("nij,ni->nj", (rows - before)[lower], multipliers[lower])
    reached = GoalConfigurations(trial[good], passive[good], np.linalg.norm(trial_linear.error[lower], axis=1))
    return good, reached, trial_linear.subset(lower), change


def _merit(rows: FloatArray, gap: FloatArray, held: _ActiveLimits, way: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The merit function, (n,), and the multipliers l, (n, n_rows)."""
    inverse, _ = _inverse(rows, held)
    back = np.einsum("nij,nj->ni", inverse, gap)
    merit: FloatArray = 0.5 * np.sum((way + back) ** 2, axis=1) + 0.5 * _WEIGHT * np.sum(back**2, axis=1)
    return merit, np.einsum("nij,ni->nj", inverse, way)


def _update_hessian(hessian: FloatArray, step: FloatArray, change: FloatArray) -> FloatArray:
    """B after a step (n, n_actuated) that changed the gradient of c^T l by `change`: damped BFGS, positive definite."""
    product = np.einsum("nij,nj->ni", hessian, step)
    curvature = np.maximum(np.sum(step * product, axis=1, keepdims=True), 1e-300)
    gradient = step + change
    along = np.sum(step * gradient, axis=1, keepdims=True)
    weight = np.where(along < 0.2 * curvature, 0.8 * curvature / np.maximum(curvature - along, 1e-300), 1.0)
    damped = weight * gradient + (1 - weight) * product
    along = np.maximum(np.sum(step * damped, axis=1, keepdims=True), 1e-300)
    removed, added = product / np.sqrt(curvature), damped / np.sqrt(along)
    learned = hessian - removed[:, :, None] * removed[:, None, :] + added[:, :, None] * added[:, None, :]
    return np.where(curvature[:, :, None] > 1e-24, learned, hessian)
