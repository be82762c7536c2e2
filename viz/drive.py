"""Data for a page to move a robot by hand: joint values from the motors, and the closures of its loops.

The page follows the loops itself, from a pose with closed loops, in small steps of the motors with Newton's method at
each (`templates/drive.js`, the same equations as `calib.core.robots.loops`). It stops if a loop does not close, if a
passive joint meets its limit, or before a singularity, behind which another assembly mode begins.

The joint errors of the calibrated robot, except bending by gravity, are a sum of functions of one motor each. The page
interpolates tables of these with cubics. Conditions are neutral, as in `Robot.positions` without a context: no
direction of approach, 20 degC, time 0.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from calib import Robot
from calib.core.base.arrays import FloatArray
from calib.core.robots.joint_errors import actual_joints, columns_of_terms
from calib.core.robots.terms.term import Condition, Context
from viz.bodies import Bodies

_TABLE_STEP = 5e-3  # of a motor [rad, or characteristic lengths]; errs by 2e-7 rad for 60 waves a turn of 1 mrad
_NEGLIGIBLE = 1e-12  # largest joint error without a table [m or rad]


def drive_data(robot: Robot, bodies: Bodies, shown: FloatArray) -> dict[str, Any]:
    """Return the data by which a page moves by hand the robot that is drawn solid.

    The ranges of the motors include the shown poses, (n, n_actuated) [m or rad]. Values of moving joints, in the order
    of `PosedRobot.values`, are `by_actuated` times motors plus `by_passive` times passive joints plus `constant`.
    `columns` are the passive joints among them. Limits are null where there are none. `complete`: no error of the robot
    is omitted, so that positions are the robot's.
    """
    mechanism, moving = robot.mechanism, bodies.moving
    names = [mechanism.origin_names[joint] for joint in moving]
    joints = {joint.name: joint for joint in robot.urdf.joints}
    sliding = np.array([joints[name].type == "prismatic" for name in robot.joint_names], dtype=bool)
    way = np.where(sliding, mechanism.length, np.pi)  # to both sides of home, for motors without limits
    low, high = (np.array([getattr(joints[name], end) for name in robot.joint_names]) for end in ("lower", "upper"))
    low = np.where(np.isfinite(low), low, robot.home - way)
    high = np.where(np.isfinite(high), high, robot.home + way)
    reach = np.stack([np.min([low, *shown], axis=0), np.max([high, *shown], axis=0)])
    limits = np.stack([mechanism.lower, mechanism.upper])
    return {
        "by_actuated": mechanism.select_actuated[moving, : len(mechanism.actuated)].tolist(),
        "by_passive": mechanism.select_passive[moving].tolist(),
        "constant": mechanism.constant[moving].tolist(),
        "columns": [names.index(name) for name in mechanism.passive],
        "loops": [
            {"a": loop.a, "b": loop.b, "full": loop.full_pose, "rows": list(loop.rows)} for loop in mechanism.loops
        ],
        "passive_range": [[value if np.isfinite(value) else None for value in ends] for ends in limits],
        "turning": (~mechanism.is_metre_column).tolist(),
        "sliding": sliding.tolist(),
        "range": reach.tolist(),
        "home": robot.home.tolist(),
        "targets": [
            {"name": name, "body": target.b} for name, target in zip(robot.target_names, mechanism.targets, strict=True)
        ],
        "length": mechanism.length,
        "tables": _tables(robot, reach),
        "remarks": _remarks(robot),
        "complete": not any(term.needs_torque for term in robot.terms),
    }


def _tables(robot: Robot, reach: FloatArray) -> list[dict[str, Any]]:
    """Errors of each motor `joint` as functions of the command of one motor `axis`, over its range [m or rad]."""
    if not robot.terms:
        return []
    at_home = _errors(robot, robot.home[None])[0]
    tables = []
    for k, scale in enumerate(robot.mechanism.joint_scale):
        count = 4 + int(np.ptp(reach[:, k]) / (_TABLE_STEP * scale))
        q = np.tile(robot.home, (count, 1))
        q[:, k] = np.linspace(reach[0, k], reach[1, k], count)
        errors = _errors(robot, q) - at_home
        errors[:, k] += at_home[k]
        for j in np.flatnonzero(np.max(np.abs(errors), axis=0) > _NEGLIGIBLE):
            table = {"joint": int(j), "axis": k, "low": float(q[0, k]), "step": float(q[1, k] - q[0, k])}
            tables.append(table | {"errors": np.round(errors[:, j], 13).tolist()})
    return tables


def _errors(robot: Robot, q: FloatArray) -> FloatArray:
    """Errors of motors at commands q, without gravity, under neutral conditions, (n, n_actuated) [m or rad]."""
    columns = columns_of_terms(robot.terms, robot.mechanism, q, Context.neutral(*q.shape))
    return actual_joints(robot, q, columns)[:, : q.shape[1]] - q


def _remarks(robot: Robot) -> list[str]:
    """Remarks on joint terms that are no functions of the motors."""
    torque = sorted({term.joint for term in robot.terms if term.needs_torque})
    remarks = [f"Left out here: bending by gravity in {', '.join(torque)}."] if torque else []
    conditions = {condition for term in robot.terms if not term.needs_torque for condition in term.depends_on}
    kinds = sorted(condition.words for condition in conditions - {Condition.ANOTHER_JOINT})
    return [*remarks, f"Not known here, and taken as neutral: {', '.join(kinds)}."] if kinds else remarks
