"""Commands at which joints with errors are where they should be."""

from __future__ import annotations

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.robots.joint_errors import actual_joints, term_columns
from calib.core.robots.robot import Robot
from calib.core.robots.terms.term import Context

_COMMAND_ROUNDS = 50
_COMMANDED = 1e-10  # largest distance of a joint from its goal at the end [m or rad]
_CONVERGED = 1e-14  # the iteration ends once all joints are nearer to their goals [m or rad]


def commands_for(robot: Robot, actual: FloatArray, context: Context | None = None) -> FloatArray:
    """Return the commands (n, n_actuated) at which the driven joints (n, n_driven or n_actuated) are at `actual` [m or
    rad].

    q = actual - dq(q) is iterated until it converges. Joint errors change so little with q that each round gains
    digits. Where they change much, as where backlash changes its side, a round that gains nothing is taken back, and
    the next step is half as long. The result is NaN where this does not converge: a joint that falls from one side of
    its play to the other cannot be between them.
    """
    n_actuated = len(robot.joint_names)
    goal = q = np.array(actual[:, :n_actuated])
    if not robot.terms:
        return q
    part, off = np.ones((len(q), 1)), np.full((len(q), 1), np.inf)
    best, step = q, np.zeros_like(q)
    for _ in range(_COMMAND_ROUNDS):
        left = goal - actual_joints(robot, q, term_columns(robot, q, context))[:, :n_actuated]
        still = np.max(np.abs(left), axis=1, keepdims=True, initial=0.0)
        worse = (still > off) & (still > _COMMANDED)
        part, off = np.where(worse, part / 2, part), np.where(worse, off, still)
        best, step = np.where(worse, best, q), np.where(worse, step / 2, part * left)
        q = best + step
        if not np.any(still >= _CONVERGED):
            break
    q[np.flatnonzero(off > _COMMANDED)] = np.nan
    return q
