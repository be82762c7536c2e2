"""Programs of the nominal robot, changed so that the calibrated robot goes to the same goals.

Definition. Joints q bring the nominal robot's tool to T(q). The compensated command q' brings the calibrated robot's
tool there:

    T_calibrated(q') = T_nominal(q),      q' near q

Frame. Both sides are seen from the frame of the program (`calib.programs.reaching.correction_frames`): a measured
frame, or the robot's own base frame, placed for the best agreement of both robots. A tool with an unknown place on its
link is placed in the same way. Hence a moved tracker or reflector changes no command. A base or tool with a known or a
fitted origin belongs to the robot and is corrected. The expected error is the uncertainty of exactly this difference.
Goals are those of the description's tool, the only tool that a controller has.

No correction. If the verdict of the calibration finds nothing to correct, q' = q, and the error of the calibrated robot
counts into the expected error.

Kept components. The full pose is kept if the joints can reach it. A robot with less freedom keeps the position, with
the orientation as near as the joints allow. Redundant joints stay near those of the program.

Method. Each row starts at its own nominal joints and follows the loops from there (`reaching.descend`), which keeps the
program's branch of the inverse kinematics and its assembly mode. Goals given as poses are first solved for the nominal
robot; a row on another branch than the row before is solved again from there. Nothing is clipped: a row that needs a
joint past its limit, or is out of reach, gets no command but a reason.

When it fails. Next to a singular pose of the robot a small correction of the tool can need a large correction of the
joints; `jumps` names rows to which the compensated program goes further than the program itself.
"""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from calib.core.base.arrays import BoolArray, FloatArray, IntArray, numbers_in
from calib.core.base.errors import InputError, nearest
from calib.core.base.units import DISPLAY_UNIT, quantity_text
from calib.core.data.in_memory import as_poses
from calib.core.data.measurements import Poses, directions_of_motion
from calib.core.data.tables import is_source
from calib.core.robots.acceleration import compile_for
from calib.core.robots.closure import motion
from calib.core.robots.joint_errors import actual_joints, term_columns
from calib.core.robots.robot import Robot
from calib.core.robots.terms.term import Context
from calib.core.rows.frames import KnownRobot
from calib.programs.reaching.correction_frames import (
    Calibrated,
    CorrectionFrame,
    as_described,
    known_robot,
    program_frame,
)
from calib.programs.reaching.expected_errors import ExpectedError, FramedErrors, shown_errors, words_of
from calib.programs.reaching.goals import Goals, goals_of_poses
from calib.programs.reaching.inverse import BETWEEN_SIDES, TOLERANCE, problem, with_tilts
from calib.programs.reaching.joint_commands import commands_for
from calib.programs.reaching.program_task import KEEP, ProgramTask, is_reached, task_of_goals, task_of_joints
from calib.programs.reaching.reaching import GoalConfigurations, Reach, descend
from calib.programs.reaching.redundancy import near_joints

_JUMP = 0.1  # excess of a step between rows over the program's step [rad, or characteristic lengths]
_CLOSINGS = 4  # closings of the loops for each row
_BEYOND = 1e-9  # excess over a limit that is not rounding [m or rad]


@dataclass(frozen=True, eq=False)
class Compensation(FramedErrors):
    """A compensated program.

    Attributes:
        names: Pose name of each row.
        labels: Name of each row in messages.
        target: Name of the target.
        kept_components: The kept components of poses, of `KEEP`.
        program: Joints with which the nominal robot reaches the goals, (n, n_actuated) [m or rad]; NaN where none.
        q: Compensated commands, (n, n_actuated) [m or rad]; NaN where there are none.
        reasons: Why a row has no command; empty if it has one.
        programmed: The goal of the target in the measurement frame, (n, 3) [m]; NaN where unknown.
        before: Errors of the calibrated robot there without compensation, (n,) [m]; NaN where unknown.
        expected: Root mean square error that remains, from the uncertainty of the parameters, (n,) [m]; NaN where there
            is no command or the uncertainty of the robot is unknown. If nothing is to be corrected, the error of the
            calibrated robot.
        low95, high95: Limits of the error in 95 of 100 cases, (n,) [m].
        before_angle, expected_angle, low95_angle, high95_angle: The same for the orientation if the pose is kept,
            for the z axis if only that is kept, (n,) [rad]; NaN if only the position is kept.
        scale: Scale of each joint: 1 rad, or its length, (n_actuated,).
    """

    names: tuple[str, ...]
    labels: tuple[str, ...]
    target: str
    kept_components: str
    program: FloatArray
    q: FloatArray
    reasons: tuple[str, ...]
    programmed: FloatArray
    before: FloatArray
    expected: FloatArray
    low95: FloatArray
    high95: FloatArray
    before_angle: FloatArray
    expected_angle: FloatArray
    low95_angle: FloatArray
    high95_angle: FloatArray
    scale: FloatArray

    @cached_property
    def ok(self) -> BoolArray:
        """Mask of the rows that have a command, (n,)."""
        return np.asarray(np.isfinite(self.q).all(axis=1))

    def figures(self) -> dict[tuple[str, str], FloatArray]:
        """Return errors (n,) and their limits for the kept components, by name and unit in files."""
        names = ("before", "expected", "low95", "high95")
        endings = ("",) if self.kept_components == "position" else ("", "_angle")
        return shown_errors(names, [[getattr(self, f"{name}{ending}") for name in names] for ending in endings])

    def unreached_rows(self) -> list[str]:
        """Return a phrase for every row that has no command."""
        return [f"{label} {why}" for label, why in zip(self.labels, self.reasons, strict=True) if why]

    def controller_poses(self, robot: Robot) -> tuple[FloatArray, FloatArray]:
        """Return the poses to send to a controller that uses the nominal model of `robot`.

        Returns:
            Positions (n, 3) [m] in the measurement frame of the description and rotations (n, 3, 3); NaN where there is
            no command.
        """
        nominal = as_described(robot)
        positions, rotations = np.full((len(self.q), 3), np.nan), np.full((len(self.q), 3, 3), np.nan)
        rows = np.flatnonzero(self.ok)
        closed = nominal.close(self.q[rows])
        rows, target = rows[closed.ok], nominal.mechanism.targets[nominal.target_names.index(self.target)]
        positions[rows], rotations[rows], *_ = motion(
            nominal.mechanism, target, self.q[rows], closed.passive[closed.ok]
        )
        return positions, rotations

    def jumps(self) -> list[str]:
        """Return a remark on every row to which some joint goes much further than in the program."""
        steps = [np.max(np.abs(np.diff(q / self.scale, axis=0)), axis=1, initial=0.0) for q in (self.program, self.q)]
        with np.errstate(invalid="ignore"):
            rows = np.flatnonzero(steps[1] > steps[0] + _JUMP) + 1
        return [
            f"{self.labels[k]}: a joint goes {steps[1][k - 1]:.2f} rad from the row before, but only"
            f" {steps[0][k - 1]:.2f} rad in the program; the robot is near a singular pose there"
            for k in map(int, rows)
        ]


def compensate(
    calibrated: Robot | Calibrated | KnownRobot, program: Poses | Goals | ArrayLike, *, keep: str | None = None
) -> Compensation:
    """Correct a program of the nominal robot for the calibrated one.

    Args:
        calibrated: A fit or a loaded result; or a robot alone, whose expected errors are unknown, and whose frame is
            placed by poses around home.
        program: Joints of the nominal robot, as `Poses` or (n, n_actuated) [m or rad]; or `Goals` for one of its
            targets, in the measurement frame of the nominal description; or poses of that target as the nominal robot's
            `forward` gives them, (n, 4, 4) or (4, 4). For a robot with four joints, (4, 4) are joint values.
        keep: Kept components of a program of joints, of `KEEP`; default: the pose if the joints can reach any.

    Raises:
        InputError: `keep` is not in `KEEP`, or is given with goals, which define it themselves.
        DataError: Goals of an unknown target, or joint values of the wrong shape.
    """
    known = known_robot(calibrated)
    if keep is not None and keep not in KEEP:
        raise InputError(f"keep '{keep}'{nearest(keep, KEEP)}")
    if keep is not None and isinstance(program, Goals):
        raise InputError("keep: is for programs of joints, not of poses or positions; leave it out")
    is_array = not (isinstance(program, (Goals, Poses)) or is_source(program))
    shape = numbers_in(cast(ArrayLike, program), "program").shape if is_array else ()
    if shape[-2:] == (4, 4) and (len(shape) == 3 or len(known.robot.joint_names) != 4):
        program = goals_of_poses(cast(ArrayLike, program))
    if not isinstance(program, Goals):
        program = as_poses(known.robot, program)
    return compensate_in(program_frame(known), program, keep)


def compensate_in(frame: CorrectionFrame, program: Poses | Goals, keep: str | None = None) -> Compensation:
    """Compensate a program of joints or goals in a frame; see `compensate`."""
    with compile_for(_CLOSINGS * len(program) if frame.nominal.mechanism.loops else 0):
        if isinstance(program, Goals):
            return _compensate(frame, task_of_goals(frame.nominal, frame.meant, program))
        return _compensate(frame, task_of_joints(frame.meant, program, keep))


def _compensate(frame: CorrectionFrame, task: ProgramTask) -> Compensation:
    robot, n = frame.robot, len(task.goals)
    reach = problem(robot, task.goals)
    meant = np.where(np.array(task.reasons)[:, None] == "", task.goals.positions, np.nan)
    program = np.where(np.isfinite(meant[:, :1]), task.joints, np.nan)
    approach = task.goals.approach
    directions = directions_of_motion(task.joints) if approach is None else approach
    context = Context.from_conditions(directions, task.goals.context, task.goals.setups)
    columns = term_columns(robot, task.joints, context)
    closed = robot.close(task.joints, columns=columns)
    reasons = np.array(task.reasons, dtype=object)
    reasons[(reasons == "") & ~closed.ok] = "cannot be assembled by the calibrated robot at the program's own joints"
    rows = np.flatnonzero(reasons == "")
    start = GoalConfigurations.unknown(actual_joints(robot, task.joints, columns), closed.passive).subset(rows)
    q, before = np.full(task.joints.shape, np.nan), np.full((2, n), np.nan)
    before[:, rows] = replace(reach, goals=task.goals.subset(rows)).deviations(start.actuated, start.passive)[1:]
    if task.goals.asks_for == "position":
        before[1] = np.nan
    if frame.nothing_to_correct:
        commands = task.joints[rows]
        reasons[rows] = [_joint_beyond_limits(reach, command, "in the program") for command in commands]
    else:
        commands, reasons[rows] = _solve_rows(robot, reach, task, rows, start, context.select(rows))
    good = np.flatnonzero(reasons[rows] == "")
    q[rows[good]] = commands[good]
    errors = ExpectedError.from_frame(frame, task.goals, commands[good], rows[good], context.select(rows[good]))
    return Compensation(
        names=task.goals.names,
        labels=task.goals.labels,
        target=reach.target.name,
        kept_components=task.kept_components,
        program=program,
        q=q,
        reasons=tuple(reasons),
        programmed=meant,
        before=before[0],
        expected=errors.distance,
        low95=errors.distance95[0],
        high95=errors.distance95[1],
        before_angle=before[1],
        expected_angle=errors.angle,
        low95_angle=errors.angle95[0],
        high95_angle=errors.angle95[1],
        scale=robot.mechanism.joint_scale,
        **words_of(frame),
    )


def _solve_rows(
    robot: Robot, reach: Reach, task: ProgramTask, rows: IntArray, start: GoalConfigurations, context: Context
) -> tuple[FloatArray, list[str]]:
    """Commands for rows, (n_rows, n_actuated) [m or rad], and the reason of each row without a command."""
    near = start if task.nearly_reached is None else descend(problem(robot, task.nearly_reached), rows, start)
    solutions = _solve_beyond_limits(
        reach, rows, start, near_joints(reach, rows, descend(reach, rows, near), near.actuated)
    )
    solutions = with_tilts(robot, reach, rows, solutions, context)
    commands = reach.with_uncommanded(rows, commands_for(robot, solutions.actuated, context))
    reach_of_rows = replace(reach, goals=task.goals.subset(rows))
    return commands, _reasons(robot, reach_of_rows, solutions, commands, task.joints[rows])


def _solve_beyond_limits(
    reach: Reach, rows: IntArray, start: GoalConfigurations, solutions: GoalConfigurations
) -> GoalConfigurations:
    """Solutions without limits of the actuated joints, for goals that have none within the limits."""
    nothing = np.full(len(reach.lower), np.inf)
    missed = np.flatnonzero(~is_reached(reach, solutions))
    free = descend(replace(reach, lower=-nothing, upper=nothing), rows[missed], start.subset(missed))
    won = is_reached(reach, free)
    together = deepcopy(solutions)
    together.take(missed[won], free.subset(np.flatnonzero(won)))
    return together


def _reasons(
    robot: Robot, reach: Reach, solutions: GoalConfigurations, commands: FloatArray, program: FloatArray
) -> list[str]:
    """The reason why each command (n, n_actuated) is unusable; empty for a usable command."""
    _, miss, angle = reach.deviations(solutions.actuated, solutions.passive)
    known = np.asarray(np.isfinite(commands).all(axis=1))
    closed = robot.close(np.where(known[:, None], commands, program)).ok  # the loops were followed from elsewhere
    result = []
    for k, reached in enumerate(is_reached(reach, solutions)):
        if not known[k]:
            result.append(BETWEEN_SIDES)
            continue
        why = _joint_beyond_limits(reach, program[k], "in the program") or (
            _joint_beyond_limits(reach, commands[k], "needed") if reached else ""
        )
        if not (why or reached):
            degrees = f" and {quantity_text(angle[k], 'deg', '.3f')}" if angle[k] > TOLERANCE else ""
            why = f"is out of reach by {quantity_text(miss[k], 'mm', '.3f')}{degrees}"
        result.append(why or ("" if closed[k] else "cannot be reached from home in its assembly mode"))
    return result


def _joint_beyond_limits(reach: Reach, q: FloatArray, what: str) -> str:
    """The joint of q (n_actuated,) that is furthest past its limit, in words; empty if none is."""
    n = len(q)
    past = np.maximum(q - reach.upper[:n], reach.lower[:n] - q) / reach.scale[:n]
    j = int(np.argmax(past))
    if past[j] <= _BEYOND:
        return ""
    name = reach.mechanism.actuated[j]
    dimension = reach.mechanism.dimensions[name]
    limit = reach.upper[j] if q[j] > reach.upper[j] else reach.lower[j]
    value, bound = (quantity_text(float(x), DISPLAY_UNIT[dimension], ".3f") for x in (q[j], limit))
    return f"is past the limit of joint '{name}': {value} {what}, {bound} allowed"
