"""The task of a program for the calibrated robot: goals of its target, and joint values of the nominal robot there.

`calib.programs.reaching.compensation` solves the task and defines its frame, kept components and branch.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray
from calib.core.base.errors import DataError, InputError
from calib.core.data.measurements import Poses
from calib.core.numerics import linalg
from calib.core.robots.closure import motion
from calib.core.robots.configurations import joint_vector
from calib.core.robots.robot import Robot
from calib.programs.reaching.goals import Goals
from calib.programs.reaching.inverse import TOLERANCE, problem, solve
from calib.programs.reaching.reaching import GoalConfigurations, Reach, descend

KEEP = ("pose", "axis", "position")
"""Part of the program's poses that is kept: the full pose, position and z axis of the target, or its position."""
_FURTHER = 0.5  # a larger step between rows may change the branch [rad, or characteristic lengths]
_ROUNDS = 200
_SINGULAR = 1e-6  # relative to the largest singular value
_STATED = {"full pose": "pose", "position and axis": "axis", "position": "position"}


@dataclass(frozen=True, eq=False)
class ProgramTask:
    """Goals of a program for the calibrated robot.

    Attributes:
        goals: Goals of its target, and their conditions.
        joints: Joint values with which the nominal robot reaches the goals, (n, n_actuated) [m or rad].
        reasons: Reason for each goal that the nominal robot does not reach; empty for the others.
        kept_components: The kept components, one of `KEEP`.
        nearly_reached: Full poses to stay near if only a position or an axis is kept; else None.
    """

    goals: Goals
    joints: FloatArray
    reasons: tuple[str, ...]
    kept_components: str
    nearly_reached: Goals | None


def task_of_joints(meant: Robot, program: Poses, keep: str | None) -> ProgramTask:
    """Return the task of a program that gives joint values of the nominal robot, `meant`, in the frame of the program.

    `keep` is one of `KEEP`; None: the pose if the joints move the target in all directions, else the position.

    Raises:
        InputError: The motors move no target.
    """
    if not meant.mechanism.moved_targets:
        raise InputError(f"{meant.path}: its motors move none of its targets; add the tool to `targets`")
    joints, mechanism = joint_vector(meant, program.joints), meant.mechanism
    pose = Goals(
        np.zeros((len(joints), 3)),
        names=tuple(program.names),
        labels=tuple(program.labels),
        target=mechanism.moved_targets[0].name,
        context=program.context,
        approach=program.approach,
        setups=program.setups,
        stands={name: joints[:, meant.joint_names.index(name)] for name in meant.sensed_names},
    )
    pose, jacobian, closed = _goals_reached(meant, joints, pose)
    if keep is None:
        keep = "pose" if _moves_freely(jacobian * mechanism.joint_scale, mechanism.length) else "position"
    reasons = tuple("" if good else "cannot be assembled by the nominal robot" for good in closed)
    return _task(pose, joints, reasons, keep)


def _goals_reached(robot: Robot, joints: FloatArray, goals: Goals) -> tuple[Goals, FloatArray, BoolArray]:
    """Goals at the target's poses, the Jacobian (n_closed, 6, n_actuated), and the mask of closed loops, (n,)."""
    closed = robot.close(joints)
    target = robot.mechanism.targets[robot.target_names.index(goals.target or robot.target_names[0])]
    positions, rotations = np.zeros((len(joints), 3)), np.tile(np.eye(3), (len(joints), 1, 1))
    there = motion(robot.mechanism, target, joints[closed.ok], closed.passive[closed.ok])
    positions[closed.ok], rotations[closed.ok], jacobian, _ = there
    return replace(goals, positions=positions, rotations=rotations, directions=None), jacobian, closed.ok


def _task(pose: Goals, joints: FloatArray, reasons: tuple[str, ...], keep: str) -> ProgramTask:
    """The task with the kept components of full poses."""
    goals = pose if keep == "pose" else replace(pose, rotations=None)
    if keep == "axis":
        assert pose.rotations is not None
        goals = replace(goals, directions=pose.rotations[:, :, 2])
    return ProgramTask(goals, joints, reasons, keep, None if keep == "pose" else pose)


def _moves_freely(jacobian: FloatArray, length: float) -> bool:
    """Whether the target can move in all six directions at some pose, from Jacobians (n, 6, n_actuated)."""
    if len(jacobian) == 0 or jacobian.shape[2] < 6:
        return False
    values = linalg.singular_values(jacobian / np.repeat([length, 1.0], 3)[:, None])
    return bool(np.any(values[:, 5] > _SINGULAR * values[:, 0]))


def task_of_goals(nominal: Robot, meant: Robot, program: Goals) -> ProgramTask:
    """Return the task of a program that gives goals: the poses to which the nominal robot brings the tool.

    Goals are in the frames of the description, which the controller assumes; `meant` is the nominal robot in the frame
    of the program.

    Raises:
        DataError: A coordinate is free.
    """
    filled = np.isfinite(program.positions).all(axis=1)
    if not np.all(filled):
        raise DataError(f"{program.labels[int(np.argmin(filled))]}: a coordinate is empty; a program needs all three")
    solution = solve(nominal, program)
    reasons = tuple("" if good else f"by the nominal robot {solution.miss(k)}" for k, good in enumerate(solution.ok))
    joints = _without_branch_changes(nominal, problem(nominal, program), solution.q, solution.ok)
    return _task(_goals_reached(meant, joints, program)[0], joints, reasons, _STATED[program.asks_for])


def _without_branch_changes(robot: Robot, reach: Reach, q: FloatArray, ok: BoolArray) -> FloatArray:
    """Solutions (n, n_actuated) with as few changes of branch between neighbouring rows as possible."""
    q, tried = q.copy(), np.zeros(len(q), dtype=bool)
    for _ in range(_ROUNDS):
        step = np.max(np.abs(np.diff(q / reach.scale, axis=0)), axis=1, initial=0.0)
        rows = np.flatnonzero((step > _FURTHER) & ok[1:] & ok[:-1] & ~tried[1:]) + 1
        if len(rows) == 0:
            break
        rows = rows[np.diff(rows, prepend=-2) > 1]  # the first of consecutive rows; the next in later rounds
        tried[rows] = True
        start = robot.assemble(q[rows - 1])
        continued = descend(
            reach, rows, reach.as_given(rows, GoalConfigurations.unknown(start.actuated, start.passive))
        )
        shorter = np.max(np.abs(continued.actuated - q[rows - 1]) / reach.scale, axis=1) < step[rows - 1]
        better = shorter & is_reached(reach, continued)
        q[rows[better]] = continued.actuated[better]
        tried[np.minimum(rows[better] + 1, len(q) - 1)] = False
    return q


def is_reached(reach: Reach, solutions: GoalConfigurations) -> BoolArray:
    """Return the mask of reached goals, (n,)."""
    return solutions.distance <= TOLERANCE * min(1.0, reach.mechanism.length)
