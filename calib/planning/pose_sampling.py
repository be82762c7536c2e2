"""Poses to try a robot with where none are given: spread at random over its joint limits (`Robot.sample`).

Touches tell less than positions would: of one socket, the size of the robot stays open, because the ball is in the same
place every time. So poses of a robot that touches are brought to what it touches, one thing after the other, where that
is found from where they are.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from calib.base.arrays import FloatArray
from calib.base.memory import require_memory
from calib.base.other_words import worded
from calib.base.words import counted
from calib.data.measurements import Poses, of_visits
from calib.instruments.kind import Readings
from calib.robots.joint_sampling import TRIES, Ranges
from calib.robots.loading import RobotLike, as_robot
from calib.robots.robot import Robot
from calib.rows.simulate import MET, at_contact

_NUMBERS_OF_EACH = 120  # of 8 bytes, for joint values, names and the text of a file: 700 to 850 bytes were measured


@worded
def sample(
    robot: RobotLike,
    count: int,
    seed: int | np.random.Generator = 0,
    *,
    within: Poses | Ranges | ArrayLike | None = None,
) -> Poses:
    """Return `count` poses that the robot can take, named by their number; at contact where it touches something.

    Where too few poses touch anything, as the description places it, they are all left as they are, and say nothing of
    touches (`calib.rows.observed.unsaid_touches`).

    Args:
        robot: The robot at its present values.
        count: How many.
        seed: Of the joint values; or where the random numbers come from.
        within: Ranges to stay in, inside the joint limits: by name [SI]; or poses, or joint values alone, that span
            them, (n, n_actuated) [m or rad].

    Raises:
        InputError: The count or the seed is negative, or a range is not one; or more than fits into memory.
        DataError: Not enough were found, even near home; or a sliding joint has no limits.
    """
    robot = as_robot(robot)
    touches = [one for one in robot.instruments if one.touches]
    spanned = within.joints if isinstance(within, Poses) else within
    total = TRIES * count if touches and count > 0 else count
    require_memory(_NUMBERS_OF_EACH * max(total, 0), f"sampling {counted(count, 'pose')}", "sample fewer")
    tried = _poses(robot, robot.sample(total, seed, within=spanned))
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
        return _poses(robot, tried.joints[:count])
    found = {name: of_visits(one, there[:count]) for name, one in wanted.items()}
    said = {
        name: Readings(one.visits, one.pairs, np.zeros((len(one), 0)), None, one.details) for name, one in found.items()
    }
    return replace(_poses(robot, commands[there[:count]]), wanted=said)


def _poses(robot: Robot, joints: FloatArray) -> Poses:
    names = tuple(str(k + 1) for k in range(len(joints)))
    return Poses(joints, tuple(f"sampled pose {name}" for name in names), names, "sampled poses", (), robot=robot)
