"""Data for a page to move a robot by hand: joint values from the motors, and the closures of its loops.

The page follows the loops itself, from a pose with closed loops, in small steps of the motors with Newton's method at
each (`templates/drive.js`, the same equations as `calib.core.robots.loops`). It stops if a loop does not close, if a
passive joint meets its limit, or before a singularity, behind which another assembly mode begins.

The joint errors of the calibrated robot, except bending by gravity, are a sum of functions of one motor each. The page
interpolates tables of these with cubics. Conditions are neutral, as in `Robot.positions` without a context: no
direction of approach, 20 degC, time 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from calib import Robot
from calib.core.base.arrays import FloatArray
from calib.core.robots.joint_errors import actual_joints, columns_of_terms
from calib.core.robots.mechanism import RelativeFrame
from calib.core.robots.terms.term import Condition, Context
from viz.bodies import Bodies

_TABLE_STEP = 5e-3  # of a motor [rad, or characteristic lengths]; errs by 2e-7 rad for 60 waves a turn of 1 mrad
_NEGLIGIBLE = 1e-12  # largest joint error without a table [m or rad]


@dataclass(frozen=True, eq=False)
class ErrorTable:
    """Error of one motor as a function of one command.

    Attributes:
        joint: Index of the motor with the error.
        axis: Index of the motor whose command decides.
        low, step: First command of the table, and the step between commands [m or rad].
        errors: (n,) [m or rad].
    """

    joint: int
    axis: int
    low: float
    step: float
    errors: FloatArray


@dataclass(frozen=True, eq=False)
class Drive:
    """All joints as functions of the motors. Values of moving joints are in the order of `PosedRobot.values`.

    Attributes:
        by_actuated, by_passive, constant: Values of moving joints are by_actuated times motors plus by_passive times
            passive joints plus constant: (n_moving, n_actuated), (n_moving, n_passive), (n_moving,).
        columns: Index of each passive joint among moving joints, (n_passive,).
        loops: Closures between bodies.
        passive_range: Limits of passive joints, (2, n_passive) [m or rad]; infinite without limits.
        turning: Whether each passive joint is revolute, (n_passive,).
        sliding: Whether each motor is prismatic, (n_actuated,).
        range: Range of each motor, (2, n_actuated) [m or rad].
        home: Motors at home, (n_actuated,) [m or rad].
        targets: Name and body of each target.
        length: Characteristic length [m].
        tables: Joint errors of the robot that is drawn solid.
        remarks: Errors that the page omits.
        complete: Whether no error is omitted, so that positions are those of the robot.
    """

    by_actuated: FloatArray
    by_passive: FloatArray
    constant: FloatArray
    columns: tuple[int, ...]
    loops: tuple[RelativeFrame, ...]
    passive_range: FloatArray
    turning: tuple[bool, ...]
    sliding: tuple[bool, ...]
    range: FloatArray
    home: FloatArray
    targets: tuple[tuple[str, int], ...]
    length: float
    tables: tuple[ErrorTable, ...]
    remarks: tuple[str, ...]
    complete: bool

    def to_dict(self) -> dict[str, Any]:
        """Return the drive as data for the page's script; infinite limits are null."""
        return {
            "by_actuated": self.by_actuated.tolist(),
            "by_passive": self.by_passive.tolist(),
            "constant": self.constant.tolist(),
            "columns": list(self.columns),
            "loops": [
                {"a": loop.a, "b": loop.b, "full": loop.full_pose, "rows": list(loop.rows)} for loop in self.loops
            ],
            "passive_range": [[value if np.isfinite(value) else None for value in ends] for ends in self.passive_range],
            "turning": list(self.turning),
            "sliding": list(self.sliding),
            "range": self.range.tolist(),
            "home": self.home.tolist(),
            "targets": [{"name": name, "body": body} for name, body in self.targets],
            "length": self.length,
            "tables": [vars(table) | {"errors": np.round(table.errors, 13).tolist()} for table in self.tables],
            "remarks": list(self.remarks),
            "complete": self.complete,
        }


def drive_of(robot: Robot, bodies: Bodies, shown: FloatArray) -> Drive:
    """Return the data by which a page moves by hand the robot that is drawn solid.

    The ranges of the motors include the shown poses, (n, n_actuated) [m or rad].
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
    return Drive(
        mechanism.select_actuated[moving, : len(mechanism.actuated)],
        mechanism.select_passive[moving],
        mechanism.constant[moving],
        tuple(names.index(name) for name in mechanism.passive),
        mechanism.loops,
        np.stack([mechanism.lower, mechanism.upper]),
        tuple((~mechanism.is_metre_column).tolist()),
        tuple(sliding.tolist()),
        reach,
        robot.home,
        tuple((name, target.b) for name, target in zip(robot.target_names, mechanism.targets, strict=True)),
        mechanism.length,
        _tables(robot, reach),
        _remarks(robot),
        not any(term.needs_torque for term in robot.terms),
    )


def _tables(robot: Robot, reach: FloatArray) -> tuple[ErrorTable, ...]:
    """Errors of motors as functions of one motor each, over the motors' ranges."""
    if not robot.terms:
        return ()
    at_home = _errors(robot, robot.home[None])[0]
    tables = []
    for k, scale in enumerate(robot.mechanism.joint_scale):
        count = 4 + int(np.ptp(reach[:, k]) / (_TABLE_STEP * scale))
        q = np.tile(robot.home, (count, 1))
        q[:, k] = np.linspace(reach[0, k], reach[1, k], count)
        errors = _errors(robot, q) - at_home
        errors[:, k] += at_home[k]
        for j in np.flatnonzero(np.max(np.abs(errors), axis=0) > _NEGLIGIBLE):
            tables.append(ErrorTable(int(j), k, float(q[0, k]), float(q[1, k] - q[0, k]), errors[:, j]))
    return tuple(tables)


def _errors(robot: Robot, q: FloatArray) -> FloatArray:
    """Errors of motors at commands q, without gravity, under neutral conditions, (n, n_actuated) [m or rad]."""
    columns = columns_of_terms(robot.terms, robot.mechanism, q, Context.neutral(*q.shape))
    return actual_joints(robot, q, columns)[:, : q.shape[1]] - q


def _remarks(robot: Robot) -> tuple[str, ...]:
    """Remarks on joint terms that are no functions of the motors."""
    torque = sorted({term.joint for term in robot.terms if term.needs_torque})
    remarks = [f"Left out here: bending by gravity in {', '.join(torque)}."] if torque else []
    conditions = {condition for term in robot.terms if not term.needs_torque for condition in term.depends_on}
    kinds = sorted(condition.words for condition in conditions - {Condition.ANOTHER_JOINT})
    return (*remarks, f"Not known here, and taken as neutral: {', '.join(kinds)}.") if kinds else tuple(remarks)
