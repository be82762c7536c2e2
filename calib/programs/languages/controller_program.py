"""Compensated programs of controllers that use the nominal model.

Poses become joints of the nominal robot (`calib.programs.languages.postures`) in the order in which the program goes
to them. Joints are compensated as in every program of joints (`calib.programs.reaching.compensation`). The written
pose of a target is the nominal forward kinematics of its joint command, in the target's own tool and frame, so the
controller's inverse kinematics reaches it.

The written file is read back: `rounding` is the motion of the target by the file's decimals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.core.base.arrays import FloatArray, IntArray
from calib.core.base.errors import DataError
from calib.core.base.units import quantity_text
from calib.core.base.words import count_noun
from calib.core.data.measurements import Poses
from calib.core.robots.robot import Robot
from calib.core.rows.frames import KnownRobot
from calib.programs.languages import fanuc
from calib.programs.languages.postures import NominalCell, Sides
from calib.programs.languages.robot_program import ProgramTarget, RobotProgram
from calib.programs.reaching.compensation import Compensation, compensate
from calib.programs.reaching.correction_frames import Calibrated, as_described, known_robot

COUPLED = ("j3", "j2+j3")
"""Meanings of the third joint in a FANUC description: J3, or the sum of J2 and J3."""
_JUST = 1e-9


@dataclass(frozen=True, eq=False)
class CompensatedProgram:
    """A controller's program with compensated targets.

    Attributes:
        program: The program as read.
        compensation: Compensation of the targets with a solution, in the program's order.
        rows: Numbers of these targets, (n,).
        values: New numbers of each target [SI]; None where the target stays unchanged.
        reasons: Why a target stays unchanged; empty where it does not.
        configurations: A remark on every target whose joints no longer match its stated configuration, and on a
            program that states no joints for its first target.
        rounding: Distances by which the decimals of the file move the target, (n,) [m].
        lever: Largest distance of the program's tools from the description's target [m].
        base, flange: Links between which the controller states poses.
    """

    program: RobotProgram
    compensation: Compensation
    rows: IntArray
    values: tuple[tuple[float, ...] | None, ...]
    reasons: tuple[str, ...]
    configurations: tuple[str, ...]
    rounding: FloatArray
    lever: float
    base: str
    flange: str

    def files(self) -> tuple[bytes, ...]:
        """Return the contents of the compensated files."""
        return self.program.rewritten(self.values)


def compensate_program(
    calibrated: Robot | Calibrated | KnownRobot,
    program: RobotProgram,
    *,
    base: str | None = None,
    flange: str | None = None,
    third_joint: str | None = None,
) -> CompensatedProgram:
    """Change a controller's program so that the calibrated robot goes to the program's targets.

    Args:
        calibrated: A fit, a loaded result or a robot.
        program: The program.
        base: Link of the controller's base; default: `base` if the URDF has it, else the description's base.
        flange: Link of the controller's flange; default: `tool0` if the URDF has it, else the target's link.
        third_joint: Member of `COUPLED`, for joint values of FANUC; without it, they stay unchanged.

    Raises:
        DataError: No target can be solved, or the joint values are of another robot.
        InputError: No such link, or a link that moves against the description's base or target.
    """
    known = known_robot(calibrated)
    nominal = as_described(known.robot)
    cell = NominalCell(nominal, base, flange)
    joints = _Joints(program, nominal, third_joint)
    q, reasons = _solve_targets(program, cell, joints)
    rows = np.flatnonzero(np.isfinite(q).all(axis=1))
    if len(rows) == 0:
        target, why = next((target, why) for target, why in zip(program.targets, reasons, strict=True) if why)
        raise DataError(f"{target.label}: {why}; no target of the program can be compensated")
    targets = [program.targets[k] for k in map(int, rows)]
    labels, names = zip(*((target.label, target.name or str(target.line)) for target in targets), strict=True)
    compensation = compensate(known, Poses(q[rows], labels, names, program.sources[0].path, ()))
    values: list[tuple[float, ...] | None] = [None] * len(program.targets)
    rounding, remarks = np.zeros(len(rows)), _remark_on_start(program)
    if not compensation.nothing_to_correct:
        for n, k in enumerate(map(int, rows)):
            if compensation.reasons[n]:
                continue
            target, command = program.targets[k], compensation.q[n]
            flange_pose = cell.flange_poses(command[None])[0]
            values[k] = joints.to_program(command) if target.rotation is None else target.numbers_of(flange_pose)
            held = program.as_written(values[k] or (), k)
            rounding[n] = _rounding_shift(cell, joints, target, command, held)
            remarks += _remark_on_configuration(cell, joints, target, q[k], command)
    for n, k in enumerate(map(int, rows)):
        reasons[k] = compensation.reasons[n]
    lever = max((cell.lever(each.tool.pose) for each in targets if each.rotation is not None), default=0.0)
    texts = (tuple(values), tuple(reasons), tuple(remarks))
    return CompensatedProgram(program, compensation, rows, *texts, rounding, lever, cell.base, cell.flange)


class _Joints:
    """Conversion between joint values of a program and of the description."""

    def __init__(self, program: RobotProgram, robot: Robot, third_joint: str | None) -> None:
        n, is_fanuc = len(robot.joint_names), program.language == fanuc.LANGUAGE
        self._coupled = (np.arange(n) == 2) * (is_fanuc and third_joint == COUPLED[1])
        lengths = [name for name in robot.joint_names if robot.mechanism.dimensions[name] != "angle"]
        joints = [target for target in program.targets if target.rotation is None]
        self.why = ""
        if joints and (n != len(joints[0].cells) or lengths):
            mismatch = f"joint '{lengths[0]}' is a length" if lengths else f"the robot has {count_noun(n, 'motor')}"
            self.why = f"has {count_noun(len(joints[0].cells), 'angle')}, and {mismatch}"
        elif is_fanuc and third_joint is None:
            self.why = (
                "has joint values; say with --third-joint whether the description's third joint is J3 or J2 + J3"
                " (descriptions of ROS-Industrial: j2+j3)"
            )
        home = "home, which is between two of them; give the description a home with N, U and T"
        zero = "all joints at zero, which is between two of them; correct the zeros of the URDF"
        self.zero = Sides(robot, robot.home, home) if is_fanuc else Sides(robot, np.zeros(n), zero)

    def to_joints(self, values: Sequence[float]) -> FloatArray:
        return np.array(values) + values[1] * self._coupled

    def to_program(self, q: FloatArray) -> tuple[float, ...]:
        return tuple(map(float, q - q[1] * self._coupled))


def _solve_targets(program: RobotProgram, cell: NominalCell, joints: _Joints) -> tuple[FloatArray, list[str]]:
    """Joints of the nominal robot at each target, (n, n_actuated) [m or rad], NaN without a solution, and why."""
    n = len(cell.robot.home)
    q, reasons = np.full((len(program.targets), n), np.nan), [""] * len(program.targets)
    before = cell.robot.home
    for k, target in enumerate(program.targets):
        if target.rotation is None:
            reasons[k] = joints.why
            solution = None if joints.why else joints.to_joints(target.values)
        else:
            near = np.array(target.near) if len(target.near) == n else before
            solution, reasons[k] = cell.solve(target.flange, near, target.configuration, joints.zero)
        if solution is not None:
            q[k] = before = solution
    return q, reasons


def _rounding_shift(
    cell: NominalCell, joints: _Joints, target: ProgramTarget, command: FloatArray, held: tuple[float, ...]
) -> float:
    """Distance by which the file's decimals move the description's target [m]."""
    exact = cell.flange_poses(command[None])[0]
    if target.rotation is None:
        rounded = cell.flange_poses(joints.to_joints(held)[None])[0]
    else:
        cells = tuple(replace(old, value=value) for old, value in zip(target.cells, held, strict=True))
        rounded = replace(target, cells=cells).flange
    return float(np.linalg.norm(cell.target_position(exact) - cell.target_position(rounded)))


def _remark_on_start(program: RobotProgram) -> list[str]:
    """A remark if nothing says on which branch of the inverse kinematics the program begins."""
    first = program.targets[0]
    if first.rotation is None or first.near or first.configuration is not None:
        return []
    near = (
        "those nearest to the description's home are taken; if the robot comes with others, begin with a move to joints"
    )
    return [f"{first.label} is the first target, and states no joints: {near}"]


def _remark_on_configuration(
    cell: NominalCell, joints: _Joints, target: ProgramTarget, q: FloatArray, command: FloatArray
) -> list[str]:
    """A remark if the command violates the target's configuration more than the program's joints did."""
    says = target.configuration
    if says is None:
        return []
    was, now = (cell.distance_to_statement(values, says, joints.zero) for values in (q, command))
    if now <= max(was, 0.0) + _JUST:
        return []
    over = [j for j, (low, high) in says.ranges.items() if j < len(command) and not low <= command[j] <= high]
    names = ", ".join(f"{cell.robot.joint_names[j]} at {quantity_text(command[j], 'deg', '.4f')}" for j in over)
    changed = f"no longer fits the joint values ({names or 'another side'}); correct it"
    return [f"{target.label}: its configuration ({says.text}) is unchanged, but {changed}"]
