"""Poses to try a robot with where nobody gives any: spread at random over its joint limits.

A closed-loop robot can take only part of its joint limits, sometimes a small one. The box of the limits is therefore
drawn in towards home, by a third each time, until enough of the poses in it close, at a distance from singularities.

Touches tell less than positions would: of one socket, the size of the robot stays open, because the ball is in the same
place every time. So poses of a robot that touches are brought to what it touches, one thing after the other, where that
is found from where they are.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.arrays import FloatArray
from calib.data.measurements import Poses, of_visits
from calib.errors import DataError
from calib.linearisation.simulate import MET, at_contact
from calib.model.robot import Robot
from calib.observation.kind import Readings

_DRAWN_IN = 2.0 / 3.0
_SMALLEST_BOX = 0.01  # of the joint limits
_TRIES = 4  # poses tried for each one wanted, in each box


def sample(robot: Robot, count: int, rng: np.random.Generator) -> Poses:
    """Return `count` poses that the robot can take, named by their number; at contact where it touches something.

    Where too few poses touch anything, as the description places it, they are all left as they are, and say nothing of
    touches (`calib.linearisation.observed.unsaid_touches`).

    Args:
        robot: The robot at its present values.
        count: How many.
        rng: Source of the joint values.

    Raises:
        DataError: Not enough were found, even near home; or a sliding joint has no limits.
    """
    touches = [one for one in robot.instruments if not one.columns()]
    tried = _poses(_spread(robot, _TRIES * count if touches else count, rng))
    if not touches:
        return tried
    looks = [(one, pair, detail) for one in touches for pair, detail in zip(*one.looks(), strict=True)]
    wanted = {}
    for one in touches:
        visits = np.array([k for k in range(len(tried)) if looks[k % len(looks)][0] is one], dtype=np.intp)
        pairs, details = (np.array([looks[k % len(looks)][part] for k in visits]) for part in (1, 2))
        wanted[one.name] = Readings(visits, pairs, np.zeros((len(visits), one.n_rows)), None, details)
    commands, misses = at_contact(robot, tried, wanted)
    there = np.flatnonzero(misses < MET)
    if len(there) < count:
        return _poses(tried.joints[:count])
    found = {name: of_visits(one, there[:count]) for name, one in wanted.items()}
    said = {
        name: Readings(one.visits, one.pairs, np.zeros((len(one), 0)), None, one.details) for name, one in found.items()
    }
    return replace(_poses(commands[there[:count]]), wanted=said)


def _poses(joints: FloatArray) -> Poses:
    names = tuple(str(k + 1) for k in range(len(joints)))
    return Poses(joints, tuple(f"sampled pose {name}" for name in names), names, "sampled poses", ())


def _spread(robot: Robot, count: int, rng: np.random.Generator) -> FloatArray:
    """Joint values that the robot can take, (count, n_actuated)."""
    lower, upper = _limits(robot)
    found = np.zeros((0, len(robot.joint_names)))
    size = 1.0
    while len(found) < count and size > _SMALLEST_BOX:
        low, high = robot.home + size * (lower - robot.home), robot.home + size * (upper - robot.home)
        q = rng.uniform(low, high, (_TRIES * count, len(low)))
        closed = robot.close(q)
        good = np.flatnonzero(closed.ok)
        distance = robot.singular_values(robot.configurations(q[good], closed.at(good)))
        found = np.vstack([found, q[good[distance >= robot.description.singularity_limit]]])[:count]
        size *= _DRAWN_IN
    if len(found) < count:
        raise DataError(
            f"{robot.path}: only {len(found)} of {count} random poses can be assembled; give a file of poses"
        )
    return found


def _limits(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """Joint limits that contain home; a turning joint without limits gets half a turn to both sides."""
    joints = {joint.name: joint for joint in robot.urdf.joints}
    lower, upper = robot.home.copy(), robot.home.copy()
    for k, name in enumerate(robot.joint_names):
        low, high = joints[name].lower, joints[name].upper
        if robot.mechanism.dimensions[name] == "length" and not np.isfinite(high - low):
            raise DataError(
                f"{robot.path}: sliding joint '{name}' has no limits to spread poses over; give a file of poses"
            )
        lower[k] = min(lower[k], low if np.isfinite(low) else robot.home[k] - np.pi)
        upper[k] = max(upper[k], high if np.isfinite(high) else robot.home[k] + np.pi)
    return lower, upper
