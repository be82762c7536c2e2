"""`calib compensate`: a program for the nominal robot, changed so that the calibrated one does what was meant."""

from __future__ import annotations

from pathlib import Path

import click
import numpy as np
import pinocchio as pin

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import DataError, InputError, UnreachablePoseError
from calib.core.base.units import ERROR_UNIT, PER_SI, error_scale, millimetres
from calib.core.base.words import counted
from calib.core.commands.common import Output, loaded, result_folder, said_of_failure, shared_options
from calib.core.data.measurement_columns import (
    approach_columns,
    cells_of,
    condition_columns,
    joint_columns,
    pose_columns,
)
from calib.core.data.measurement_files import read_poses
from calib.core.data.measurements import Poses
from calib.core.data.table_writing import format_table
from calib.core.data.tables import read_table
from calib.core.results.result_reading import load_result, read_content
from calib.core.robots.robot import Robot
from calib.programs.commands.compensate_gcode import compensate_gcode
from calib.programs.commands.compensate_grid import compensate_grid
from calib.programs.commands.compensate_program import compensate_controller
from calib.programs.languages import languages
from calib.programs.languages.controller_program import COUPLED
from calib.programs.languages.gcode import SUFFIXES
from calib.programs.languages.gcode_dialects import DIALECTS
from calib.programs.reaching.compensation import Compensation, compensate
from calib.programs.reaching.expected_errors import (
    COUNTED,
    before_and_now,
    expected_now,
    left_as_it_is,
    of_frame,
    summary,
)
from calib.programs.reaching.goals import Goals, read_goals
from calib.programs.reaching.program_task import KEEP

_OF_GCODE = "--zero, --start, --tolerance-mm and --dialect"
_FIGURES = ("before", "expected", "low95", "high95")
_OF_POSITIONS: tuple[tuple[str, str, float], ...] = tuple(
    (figure, ERROR_UNIT["length"], error_scale("length")) for figure in _FIGURES
)
_OF_ANGLES = tuple((f"{figure}_angle", ERROR_UNIT["angle"], error_scale("angle")) for figure in _FIGURES)


@click.command("compensate")
@click.argument("robot")
@click.argument("program")
@click.option("--result", metavar="DIR", help="Result folder of `calib fit`, if ROBOT is not one itself.")
@click.option(
    "--keep",
    type=click.Choice(KEEP),
    help="What to keep of a program of joints. Default: the full pose if the joints can reach any, else the position.",
)
@click.option(
    "--grid",
    metavar="NX,NY,NZ",
    help="Write a table of corrections instead, at NX x NY x NZ nodes over the box of PROGRAM's positions.",
)
@click.option(
    "--tolerance-mm",
    type=float,
    help="G-code: largest error of the tool between points; moves are cut to meet it.  [default: 0.01]",
)
@click.option(
    "--zero",
    metavar="X,Y,Z",
    help="G-code: where the program's zero is in the measurement frame of the description [mm].  [default: 0,0,0]",
)
@click.option(
    "--start",
    metavar="X,Y,Z",
    help="G-code: where the machine stands at first and after homing, in the program's coordinates [mm].",
)
@click.option(
    "--dialect",
    type=click.Choice(tuple(DIALECTS)),
    help="G-code: whose rules hold; cnc: milling machines.  [default: what the file says; .nc, .ngc: cnc]",
)
@click.option(
    "--harmless",
    metavar="WORD",
    multiple=True,
    help="G-code, controllers' programs: a macro, command or routine that changes no position, target, tool, frame or"
    " mode.",
)
@click.option(
    "--frames",
    metavar="FILE",
    multiple=True,
    help="Controllers' programs: tools and frames that PROGRAM does not declare; a table, RAPID module or $config.dat.",
)
@click.option("--base-link", metavar="LINK", help="Controllers' programs: the controller's base frame in the URDF.")
@click.option("--flange-link", metavar="LINK", help="Controllers' programs: the controller's flange in the URDF.")
@click.option(
    "--third-joint", type=click.Choice(COUPLED), help="FANUC, joint values: what the third joint of the URDF is."
)
@click.option(
    "--skip-unreachable",
    is_flag=True,
    help="Also write what cannot be compensated: rows are empty and marked; targets of a program stay as they are.",
)
@click.option("-o", "--out", required=True, metavar="FILE", help="File to write: the compensated program.")
@shared_options(json_output=True)
def command(
    robot: str,
    program: str,
    result: str | None,
    keep: str | None,
    grid: str | None,
    tolerance_mm: float | None,
    zero: str | None,
    start: str | None,
    dialect: str | None,
    harmless: tuple[str, ...],
    frames: tuple[str, ...],
    base_link: str | None,
    flange_link: str | None,
    third_joint: str | None,
    skip_unreachable: bool,
    out: str,
    output: Output,
) -> None:
    """Correct PROGRAM, written for the nominal ROBOT, for the calibrated one.

    PROGRAM is a table (CSV), G-code, or a controller's program: URScript (.script), RAPID (.mod), KRL (.src), FANUC
    (.ls).

    A table has a column for every joint; or positions, poses, or positions with an axis of a target, as for `calib
    solve`, in the measurement frame of the description. The written table has the joint values to command, and for
    each row how far the tool is off before and after. For poses it also has the poses to send to a controller that
    computes joints with the nominal model. The tool is where the description has it. If the base is unknown, the
    program is meant in the robot's own base frame, placed where the nominal and the calibrated robot agree best over
    the measured poses. If the verdict of the calibration finds nothing to correct, the program stays as it is. If
    inclinometers measure joints, each row also has the columns of these joints or of their sensors.

    G-code (.gcode, .nc, .ngc, .g) is for machines with three motors, Cartesian or delta, whose controller uses the
    nominal model. Straight moves are cut into pieces so short that the tool stays within --tolerance-mm of the line.
    Other moves are refused, and moves behind commands that may have changed what they mean. All other lines stay.

    In a controller's program, only the numbers of the targets change. Targets that it computes at run time are listed
    with their lines. Poses are those of link `tool0` in link `base` if the URDF has them, else those of the target's
    link in the description's base; --base-link and --flange-link choose others.
    """
    result = result_folder(robot, result)
    nominal = loaded(robot, output)
    known = load_result(result, nominal).known
    suffix = Path(program).suffix.lower()
    links = (base_link, flange_link, third_joint)
    of_gcode = (zero, start, tolerance_mm, dialect)
    if suffix not in languages.SUFFIXES and (frames or any(link is not None for link in links)):
        raise InputError(
            "--frames, --base-link, --flange-link and --third-joint are for programs of controllers"
            f" ({', '.join(languages.SUFFIXES)}); leave them out"
        )
    if suffix in languages.SUFFIXES:
        if any(option is not None for option in (keep, grid, *of_gcode)):
            raise InputError(f"--keep, --grid, {_OF_GCODE} are not for programs of controllers")
        compensate_controller(known, program, result, frames, harmless, links, skip_unreachable, out, output)
        return
    if suffix in SUFFIXES:
        if keep is not None or grid is not None or skip_unreachable:
            raise InputError("--keep, --grid and --skip-unreachable are for programs in CSV; leave them out")
        compensate_gcode(known, program, result, (zero, start), (dialect, harmless), tolerance_mm, out, output)
        return
    if harmless or any(option is not None for option in of_gcode):
        raise InputError(f"{_OF_GCODE} are for G-code, --harmless for programs ({', '.join(SUFFIXES)}); leave them out")
    rows = _read(program, nominal, output)
    output.check(out)
    if grid is not None:
        compensate_grid(known, rows, grid, result, out, output)
        return
    with output.working(f"compensating {len(rows)} rows"):
        compensation = compensate(known, rows, keep=keep)
    if not skip_unreachable or not np.any(compensation.ok):
        _require_all(compensation, compensation.frame if isinstance(rows, Goals) else "")
    for miss in compensation.misses():
        output.note(f"{miss}; left empty")
    output.remarks(compensation.jumps())
    done = (
        f"left as it is: {left_as_it_is(result)}" if compensation.nothing_to_correct else f"compensated with {result}"
    )
    comments = (
        f"{program} for {nominal.name}, {done}; kept: {compensation.keep}; errors are {compensation.frame}; {COUNTED}",
        *said_of_failure(output, result, out),
    )
    output.write(out, format_table(_columns(nominal, rows, compensation), comments))
    figures, held_out, n = _summary(compensation), _held_out(result), len(rows)
    output.json(
        {
            "robot": nominal.path,
            "kept": compensation.keep,
            "frame": compensation.frame,
            "counted": COUNTED,
            "nothing_to_correct": compensation.nothing_to_correct,
            "n_rows": n,
            "n_unreachable": n - int(np.sum(compensation.ok)),
            **figures,
            "held_out_rms_mm": held_out,
            "rows": _rows(nominal, compensation),
        }
    )
    output.say(_said(compensation, figures, held_out, result, out))


def _read(path: str, robot: Robot, output: Output) -> Poses | Goals:
    """The program; joint values count where there are both."""
    names = read_table(path, robot.description.columns).names
    present = [name for name in robot.commanded_names if name in names]
    if not present:
        return read_goals(path, robot)
    targets = [name for name in names if any(name == f"{t}_{axis}" for t in robot.target_names for axis in "xyz")]
    if targets and len(present) < len(robot.commanded_names):
        missing = next(name for name in robot.commanded_names if name not in names)
        raise DataError(
            f"{path}: has columns of joints and of targets, but none for joint '{missing}'; give all joints, or none"
        )
    if targets:
        output.note(f"note: {path} has joints and target columns; the joints are the program")
    return read_poses(path, robot)


def _require_all(compensation: Compensation, frame: str) -> None:
    """Raise `UnreachablePoseError` that names the rows without a command, and the frame of goals."""
    misses = compensation.misses()
    if misses:
        more = f" (and {len(misses) - 5} more)" if len(misses) > 5 else ""
        raise UnreachablePoseError(
            f"{counted(len(misses), 'row')} of {len(compensation.names)} cannot be compensated:"
            f" {'; '.join(misses[:5])}{more}{f'; goals are {frame}' if frame else ''}; change these rows, or mark them"
            " with --skip-unreachable"
        )


def _columns(robot: Robot, program: Poses | Goals, compensation: Compensation) -> list[tuple[str, list[object]]]:
    """Columns of the file; cells without a command are empty."""
    columns = list(pose_columns(robot, compensation.names, compensation.q).items())
    if isinstance(program, Goals):
        for name, values in _poses_to_command(robot, program, compensation).items():
            columns.append((name, cells_of(values)))
    columns += condition_columns(robot, len(program), program.setups, program.context).items()
    columns += approach_columns(robot, program.approach).items()
    for figure, unit, scale in _shown(compensation):
        columns.append((f"{figure} [{unit}]", cells_of(getattr(compensation, figure) * scale)))
    columns.append(("status", [why or "ok" for why in compensation.reasons]))
    return columns


def _shown(compensation: Compensation) -> tuple[tuple[str, str, float], ...]:
    """Figures of each row, their unit and what that is of an SI unit; of angles where an orientation is kept."""
    return _OF_POSITIONS + (() if compensation.keep == "position" else _OF_ANGLES)


def _poses_to_command(robot: Robot, program: Goals, compensation: Compensation) -> dict[str, FloatArray]:
    """What a controller with the nominal model must be told, in the program's columns."""
    positions, rotations = compensation.controller_poses(robot)
    name = compensation.target
    shown = {f"{name}_{axis} [mm]": millimetres(positions[:, k]) for k, axis in enumerate("xyz")}
    if program.rotations is not None:
        angles = _rpy(rotations) * PER_SI["angle"]["deg"]
        shown |= {f"{name}_r{axis} [deg]": angles[:, k] for k, axis in enumerate("xyz")}
    if program.directions is not None:
        shown |= {f"{name}_a{axis}": rotations[:, k, 2] for k, axis in enumerate("xyz")}
    return shown


def _rpy(rotations: FloatArray) -> FloatArray:
    """Roll, pitch, yaw about fixed axes, (n, 3) [rad]; NaN where the rotation is."""
    return np.array([np.full(3, np.nan) if np.isnan(R).any() else pin.rpy.matrixToRpy(R) for R in rotations])


def _summary(compensation: Compensation) -> dict[str, dict[str, float]]:
    """Root mean square and largest error of all rows, before and after [mm], and of orientations [mrad]."""
    return {
        f"{figure}_{unit}": summary(scale * getattr(compensation, figure)[compensation.ok])
        for figure, unit, scale in _shown(compensation)
        if figure.startswith(_FIGURES[:2])
    }


def _rows(robot: Robot, compensation: Compensation) -> list[dict[str, object]]:
    """One entry for each row; null where there is no number."""
    joints = joint_columns(robot, compensation.q)
    return [
        {
            "pose": name,
            "status": compensation.reasons[k] or "ok",
            "joints": {joint: float(values[k]) for joint, values in joints.items()} if compensation.ok[k] else None,
            **{
                f"{figure}_{unit}": float(getattr(compensation, figure)[k]) * scale
                for figure, unit, scale in _shown(compensation)
            },
        }
        for k, name in enumerate(compensation.names)
    ]


def _held_out(folder: str) -> float | None:
    """Root mean square error of measurements that the fit had not seen [mm]; None where it was not given any."""
    errors = read_content(folder)["errors"].get("validation")
    return None if errors is None else errors["after"].get("rms")


def _said(
    compensation: Compensation, figures: dict[str, dict[str, float]], held_out: float | None, result: str, out: str
) -> str:
    kept = compensation.nothing_to_correct
    count = f"{int(np.sum(compensation.ok))} of {counted(len(compensation.names), 'row')}"
    done = f"left as they are: {left_as_it_is(result)};" if kept else f"compensated ({compensation.keep} kept),"
    lines = [f"{count} {done} written to {out}"]
    turned = f"Its {'orientation' if compensation.keep == 'pose' else 'axis'}"
    for subject, ending in (("The tool", "_mm"), (turned, "_angle_mrad")):
        if f"expected{ending}" in figures:
            before, expected, unit = figures[f"before{ending}"], figures[f"expected{ending}"], ending.rpartition("_")[2]
            lines.append(
                expected_now(subject, expected, unit) if kept else before_and_now(subject, before, expected, unit)
            )
    lines.append(of_frame(compensation.frame))
    if held_out is not None:
        lines.append(f"Poses that the fit did not use were off by {held_out:.4f} mm (RMS), their noise included")
    return "\n".join(lines)
