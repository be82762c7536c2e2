"""Whether the values of joints that turn without end count whole turns."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.words import joints_named, listing
from calib.core.robots.robot import Robot

_FILLED = 0.75  # values over more than this part of a turn are near both of its ends, and may be wrapped there
_ROUND = 1e-3  # beyond the ends of a turn, values that were rounded [rad]


def uncounted_turns(robot: Robot, joints: FloatArray) -> list[str]:
    """Return the endless joints whose values (n_poses, n_actuated) fill one turn and stay within it.

    Such values may be wrapped: the number of whole turns is then unknown.
    """
    endless = {joint.name for joint in robot.urdf.joints if joint.type == "continuous"}
    turn, within = 2.0 * np.pi, np.zeros(joints.shape[1], dtype=bool)
    for least in (-np.pi, 0.0):
        within |= (joints.min(axis=0) > least - _ROUND) & (joints.max(axis=0) < least + turn + _ROUND)
    filled = within & (np.ptp(joints, axis=0) > _FILLED * turn)
    return [name for name, wrapped in zip(robot.joint_names, filled, strict=True) if wrapped and name in endless]


def may_be_wrapped(joints: Sequence[str], wrong: Sequence[str]) -> str:
    """Return the problem and its remedy, where values of `joints` may be wrapped and `wrong` terms count turns."""
    return (
        f"all values of {joints_named(*joints)} lie within one turn, and the URDF"
        f" states no limits. If these values were wrapped, {listing(wrong)} cannot be right. Give values that count"
        " turns; or give limits, if the joint turns no further; or use harmonics or a curve, which repeat with the"
        " turn"
    )


def wrapped_terms(robot: Robot, joints: FloatArray) -> tuple[str, ...]:
    """Return the problem with joint terms that count turns, where joint values (n_poses, n_actuated) may be wrapped."""
    uncounted = uncounted_turns(robot, joints)
    followed = [
        (term.driving_joint(robot.joint_names), term.parameters[0].name) for term in robot.terms if term.counts_turns
    ]
    wrong = {name: joint for joint, name in followed if joint in uncounted}
    return (may_be_wrapped(list(dict.fromkeys(wrong.values())), list(wrong)),) if wrong else ()
