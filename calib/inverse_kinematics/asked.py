"""What a program asks of the calibrated robot: where its target is to be, and the nominal robot's joints there.

Whose frames, how much is kept and on which branch: see `calib.inverse_kinematics.compensation`, which answers.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from calib.arrays import BoolArray, FloatArray
from calib.data.measurements import Poses
from calib.errors import DataError, InputError
from calib.inverse_kinematics.goals import Goals
from calib.inverse_kinematics.inverse import TOLERANCE, problem, solve
from calib.inverse_kinematics.reaching import Configured, Reach, actuated_jacobian, descend
from calib.model.robot import Robot

KEEP = ("pose", "axis", "position")
"""What of the program is kept: the full pose, position and z axis of the target, or its position."""
_FURTHER = 0.5  # step between rows that may be a change of branch [rad, or characteristic lengths]
_ROUNDS = 200
_SINGULAR = 1e-6  # of the largest singular value
_STATED = {"full pose": "pose", "position and axis": "axis", "position": "position"}


@dataclass(frozen=True, eq=False)
class Asked:
    """What a program asks of the calibrated robot.

    Attributes:
        goals: Where its target is to be.
        joints: Joints with which the nominal robot is there, (n, n_actuated) [m or rad].
        reasons: Why there are none; empty where there are.
        keep: Of `KEEP`.
        nearly: What to be near, where less than the pose is kept.
        conditions: What is known of each row's load, temperature and time, (n,) [SI, degC].
        approach: From which side joints come, (n, n_actuated), where the program states it; else None.
    """

    goals: Goals
    joints: FloatArray
    reasons: tuple[str, ...]
    keep: str
    nearly: Goals | None = None
    conditions: Mapping[str, FloatArray] = field(default_factory=dict)
    approach: FloatArray | None = None


def as_meant(robot: Robot) -> Robot:
    """Return the robot that programs were written for: nominal, but its unknown base and targets where they are."""
    bare = robot.with_terms(())
    return bare.with_parameters({p.name: p.nominal_si for p in bare.parameters if not p.placement})


def asked_by_joints(meant: Robot, program: Poses, keep: str | None) -> Asked:
    """Return what joints of the nominal robot, as programs take it (`as_meant`), ask for.

    Raises:
        InputError: Motors move no target.
    """
    if not meant.mechanism.moved_targets:
        raise InputError(f"{meant.path}: its motors move none of its targets; add the tool to `targets`")
    joints = meant.joint_vector(program.joints)
    closed = meant.close(joints)
    mechanism, target, n = meant.mechanism, meant.mechanism.moved_targets[0], len(joints)
    positions, rotations = np.zeros((n, 3)), np.tile(np.eye(3), (n, 1, 1))
    pose_and_jacobian = actuated_jacobian(mechanism, target, joints[closed.ok], closed.passive[closed.ok])
    positions[closed.ok], rotations[closed.ok], jacobian = pose_and_jacobian
    if keep is None:
        keep = "pose" if _moves_freely(jacobian * mechanism.joint_scale, mechanism.length) else "position"
    pose = Goals(positions, rotations, names=tuple(program.names), labels=tuple(program.labels), target=target.name)
    goals = pose if keep == "pose" else replace(pose, rotations=None)
    if keep == "axis":
        goals = replace(goals, directions=rotations[:, :, 2])
    reasons = tuple("" if good else "cannot be assembled by the nominal robot" for good in closed.ok)
    return Asked(goals, joints, reasons, keep, None if keep == "pose" else pose, program.context, program.approach)


def _moves_freely(jacobian: FloatArray, length: float) -> bool:
    """Whether some pose lets the target move in all six directions, from (n, 6, n_actuated) of scaled joints."""
    if len(jacobian) == 0 or jacobian.shape[2] < 6:
        return False
    values = np.linalg.svd(jacobian / np.repeat([length, 1.0], 3)[:, None], compute_uv=False)
    return bool(np.any(values[:, 5] > _SINGULAR * values[:, 0]))


def asked_by_goals(meant: Robot, program: Goals) -> Asked:
    """Return what goals ask for, and the joints with which the nominal robot reaches them.

    Raises:
        DataError: A coordinate is not asked for.
    """
    whole = np.isfinite(program.positions).all(axis=1)
    if not np.all(whole):
        raise DataError(f"{program.labels[int(np.argmin(whole))]}: a coordinate is empty; a program needs all three")
    base = meant.mechanism.origin_names[meant.mechanism.targets[0].a - 1]
    # from the measurement frame as the description has it to where the calibration found it
    moved = meant.mechanism.placement(base).inverse() * meant.nominal.placement(base)
    goals = replace(
        program,
        positions=program.positions @ moved.rotation.T + moved.translation,
        rotations=None if program.rotations is None else moved.rotation @ program.rotations,
        directions=None if program.directions is None else program.directions @ moved.rotation.T,
    )
    solution = solve(meant, goals)
    reasons = tuple("" if good else f"by the nominal robot {solution.miss(k)}" for k, good in enumerate(solution.ok))
    joints = _on_one_branch(meant, problem(meant, goals), solution.q, solution.ok)
    return Asked(
        goals, joints, reasons, _STATED[program.asks_for], conditions=program.context, approach=program.approach
    )


def _on_one_branch(robot: Robot, reach: Reach, q: FloatArray, ok: BoolArray) -> FloatArray:
    """Solutions (n, n_actuated) without changes of branch between neighbouring rows, as far as that can be."""
    q, tried = q.copy(), np.zeros(len(q), dtype=bool)
    for _ in range(_ROUNDS):
        step = np.max(np.abs(np.diff(q / reach.scale, axis=0)), axis=1, initial=0.0)
        rows = np.flatnonzero((step > _FURTHER) & ok[1:] & ok[:-1] & ~tried[1:]) + 1
        if len(rows) == 0:
            break
        rows = rows[np.diff(rows, prepend=-2) > 1]  # those that follow one of them come after it
        tried[rows] = True
        start = robot.assemble(q[rows - 1])
        continued = descend(reach, rows, Configured(start.actuated, start.passive, np.full(len(rows), np.inf)))
        shorter = np.max(np.abs(continued.actuated - q[rows - 1]) / reach.scale, axis=1) < step[rows - 1]
        better = shorter & reached_goals(reach, continued)
        q[rows[better]] = continued.actuated[better]
        tried[np.minimum(rows[better] + 1, len(q) - 1)] = False
    return q


def reached_goals(reach: Reach, solutions: Configured) -> BoolArray:
    """Return which goals are reached, (n,)."""
    return solutions.distance <= TOLERANCE * min(1.0, reach.mechanism.length)
