"""`calib compensate`: a program of the nominal robot, changed so that the calibrated robot does what it says."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import numpy as np
import pinocchio as pin

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import DataError, InputError, UnreachablePoseError
from calib.core.base.units import in_unit, millimetres
from calib.core.base.words import count_noun, listing
from calib.core.commands.common import Output, load_robot, result_folder, shared_options
from calib.core.data.measurement_columns import (
    approach_columns,
    cells_of,
    condition_columns,
    pose_columns,
)
from calib.core.data.measurement_files import read_poses
from calib.core.data.measurements import Poses
from calib.core.data.table_writing import format_table
from calib.core.data.tables import read_table
from calib.core.results.result_reading import load_result, read_content
from calib.core.robots.robot import Robot
from calib.programs.commands.compensate_program import compensate_controller, compensate_gcode
from calib.programs.commands.report import Job, figures_of, frame_words, no_correction_sentence, rows_of, summary
from calib.programs.languages import languages
from calib.programs.languages.controller_program import COUPLED
from calib.programs.languages.correction_grid import correction_grid
from calib.programs.languages.gcode import SUFFIXES
from calib.programs.languages.gcode_dialects import DIALECTS
from calib.programs.reaching.compensation import Compensation, compensate
from calib.programs.reaching.goals import Goals, read_goals
from calib.programs.reaching.program_task import KEEP


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
    help="G-code: the firmware of the machine; cnc: milling machines."
    "  [default: what the file says; .nc, .ngc, .tap, .cnc: cnc]",
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
def command(robot: str, program: str, result: str | None, out: str, output: Output, **options: Any) -> None:
    """Correct PROGRAM, written for the nominal ROBOT, for the calibrated one.

    PROGRAM is a table (CSV), G-code, or a controller's program: URScript (.script), RAPID (.mod), KRL (.src), FANUC
    (.ls).

    A table has a column for every joint; or positions, poses, or positions with an axis of a target, as for `calib
    solve`, in the measurement frame of the description. The written table has the joint values to command, and for
    each row how far the tool is off before and after. For poses it also has the poses to send to a controller that
    computes joints with the nominal model. The tool is where the description has it. If the base is unknown, the
    program is meant in the nominal robot's base frame, fitted to the calibrated robot over the measured poses. If the
    verdict of the calibration finds nothing to correct, the program stays as it is. If inclinometers measure joints,
    each row also has the columns of these joints or of their sensors.

    G-code (.gcode, .g, .nc, .ngc, .tap, .cnc) is for machines with three motors, Cartesian or delta, whose controller
    uses the nominal model. Straight moves are cut into pieces so short that the tool stays within --tolerance-mm of the
    line. Other moves are refused. So are moves after a command that may have changed their meaning. All other lines
    stay.

    In a controller's program, only the numbers of the targets change. Targets that it computes at run time are listed
    with their lines. Poses are those of link `tool0` in link `base` if the URDF has them, else those of the target's
    link in the description's base; --base-link and --flange-link choose others.
    """
    result = result_folder(robot, result)
    nominal = load_robot(robot, output)
    job = Job(nominal, load_result(result, nominal).known_robot, program, result, out, output)
    suffix = Path(program).suffix.lower()
    kind = "controllers' programs" if suffix in languages.SUFFIXES else "G-code" if suffix in SUFFIXES else "tables"
    compensate_kind, names = _KINDS[kind]
    given = [name for name, value in options.items() if value not in (None, (), False)]
    wrong = [f"--{name.replace('_', '-')}" for name in given if name not in names]
    if wrong:
        raise InputError(f"{listing(wrong)}: not for {kind} such as {program}; leave out")
    compensate_kind(job, **{name: options[name] for name in names})


def _compensate_table(job: Job, *, keep: str | None, grid: str | None, skip_unreachable: bool) -> None:
    """Write a table of joint commands for the calibrated robot, or a grid of corrections."""
    output, nominal = job.output, job.nominal
    rows = _read_program(job.program, nominal, output)
    output.check(job.out)
    if grid is not None:
        _compensate_grid(job, rows, grid)
        return
    with output.working(f"compensating {len(rows)} rows"):
        compensation = compensate(job.robot_knowledge, rows, keep=keep)
    if not skip_unreachable or not np.any(compensation.ok):
        _require_all(compensation, compensation.frame if isinstance(rows, Goals) else "")
    for miss in compensation.unreached_rows():
        output.note(f"{miss}; left empty")
    output.remarks(compensation.jumps())
    done = f"compensated with {job.result}"
    if compensation.nothing_to_correct:
        done = f"left as it is: {no_correction_sentence(job.result)}"
    kept = f"kept: {compensation.kept_components}; {frame_words(compensation)}"
    comments = job.comments(f"{job.program} for {nominal.name}, {done}; {kept}")
    columns = _columns(nominal, rows, compensation)
    output.write(job.out, format_table(columns, comments))
    kept_names, targets = {name.partition(" [")[0] for name, _ in columns}, tuple(f"{t}_" for t in nominal.target_names)
    names = read_table(job.program, nominal.description.columns).names
    lost = [name for name in names if name not in kept_names and not name.startswith(targets)]
    if lost:
        output.note(f"note: {job.program}: not in the written table: {listing(lost)}")
    n_reached, unseen = int(np.sum(compensation.ok)), read_content(job.result)["errors"].get("validation")
    held_out = None if unseen is None else unseen["after"].get("rms")
    states = {"status": [why or "ok" for why in compensation.reasons]}
    content = {
        "robot": nominal.path,
        "kept": compensation.kept_components,
        "n_rows": len(rows),
        "n_unreachable": len(rows) - n_reached,
        "held_out_rms_mm": held_out,
        "rows": rows_of(nominal, compensation.names, compensation.q, compensation.ok, states, compensation.figures()),
    }
    what = (
        f"{n_reached} of {count_noun(len(rows), 'row')}",
        f"compensated ({compensation.kept_components} kept)",
        "left as they are",
    )
    subjects = "The tool", f"Its {'orientation' if compensation.kept_components == 'pose' else 'axis'}"
    more = []
    if held_out is not None:
        more.append(f"Poses that the fit did not use were off by {held_out:.4f} mm (RMS), their noise included")
    job.report(compensation, figures_of(compensation), content, what, more, subjects)


_KINDS: dict[str, tuple[Callable[..., None], tuple[str, ...]]] = {
    "controllers' programs": (
        compensate_controller,
        ("harmless", "frames", "skip_unreachable", "base_link", "flange_link", "third_joint"),
    ),
    "G-code": (compensate_gcode, ("harmless", "zero", "start", "tolerance_mm", "dialect")),
    "tables": (_compensate_table, ("skip_unreachable", "keep", "grid")),
}
"""The function that compensates each kind of program, and its options; all other options belong to every kind."""


def _read_program(path: str, robot: Robot, output: Output) -> Poses | Goals:
    """The program as joint values if the table has joint columns, else as goals."""
    names = read_table(path, robot.description.columns).names
    if {"before", "expected", "status"} <= {*names}:
        raise DataError(f"{path}: is compensated already; give the table from which it was made")
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
    misses = compensation.unreached_rows()
    if misses:
        raise UnreachablePoseError(
            f"{count_noun(len(misses), 'row')} of {len(compensation.names)} cannot be compensated:"
            f" {listing(misses, '; ')}{f'; goals are {frame}' if frame else ''}; change these rows, or mark them with"
            " --skip-unreachable"
        )


def _columns(robot: Robot, program: Poses | Goals, compensation: Compensation) -> list[tuple[str, list[object]]]:
    """Columns of the written table; cells without a command are empty."""
    columns = list(pose_columns(robot, compensation.names, compensation.q).items())
    if isinstance(program, Goals):
        for name, values in _poses_to_command(robot, program, compensation).items():
            columns.append((name, cells_of(values)))
    columns += condition_columns(robot, len(program), program.setups, program.context).items()
    columns += approach_columns(robot, program.approach).items()
    columns += [(f"{name} [{unit}]", cells_of(values)) for (name, unit), values in compensation.figures().items()]
    columns.append(("status", [why or "ok" for why in compensation.reasons]))
    return columns


def _poses_to_command(robot: Robot, program: Goals, compensation: Compensation) -> dict[str, FloatArray]:
    """Columns of the poses [mm, deg] to send to a controller that has the nominal model."""
    positions, rotations = compensation.controller_poses(robot)
    name = compensation.target
    shown = {f"{name}_{axis} [mm]": millimetres(positions[:, k]) for k, axis in enumerate("xyz")}
    if program.rotations is not None:
        angles = in_unit(np.array([pin.rpy.matrixToRpy(R) for R in rotations]), "deg")
        shown |= {f"{name}_r{axis} [deg]": angles[:, k] for k, axis in enumerate("xyz")}
    if program.directions is not None:
        shown |= {f"{name}_a{axis}": rotations[:, k, 2] for k, axis in enumerate("xyz")}
    return shown


def _compensate_grid(job: Job, program: Poses | Goals, grid: str) -> None:
    """Write the table of corrections for the box of a program's positions, and report its interpolation error."""
    if not isinstance(program, Goals):
        raise InputError("--grid: PROGRAM has joints; give positions with one orientation")
    try:
        nx, ny, nz = (int(part) for part in grid.split(","))
    except ValueError:
        raise InputError(f"--grid '{grid}': write three numbers of nodes, such as 5,5,3") from None
    with job.output.working("compensating the grid"):
        corrections = correction_grid(job.robot_knowledge, program, (nx, ny, nz))
    compensation = corrections.compensation
    parts = [
        (f"{compensation.target}_{{}} [mm]", millimetres(corrections.nodes)),
        ("add_{} [mm]", millimetres(corrections.shift)),
    ]
    if program.rotations is not None:
        parts.append(("turn_{} [deg]", in_unit(corrections.turn, "deg")))
    columns = [(name.format(axis), cells_of(values[:, k])) for name, values in parts for k, axis in enumerate("xyz")]
    off, angle = summary(millimetres(corrections.position_errors)), summary(in_unit(corrections.angle_errors, "deg"))
    worst = f"{off['max']:.4f} mm and {angle['max']:.4f} deg at worst"
    wrong = f"linear interpolation is off by {off['rms']:.4f} mm (RMS), {worst}"
    kept = compensation.nothing_to_correct
    done = f"all zero: {no_correction_sentence(job.result)}" if kept else wrong
    comments = job.comments(f"corrections from {job.result}; {done}; {frame_words(compensation)}")
    job.output.write(job.out, format_table(columns, comments))
    figures = {
        "before_mm": summary(millimetres(corrections.error_before)),
        "expected_mm": summary(millimetres(corrections.expected_error)),
        "interpolation_mm": off,
        "interpolation_deg": {"max": angle["max"]},
    }
    at = f"{wrong[0].upper()}{wrong[1:]}, at {len(corrections.position_errors)} points between nodes"
    what = count_noun(len(corrections.nodes), "node"), "with corrections", "all zero"
    subjects = "At the nodes the tool", ""
    job.report(compensation, figures, {"n_nodes": len(corrections.nodes)}, what, [] if kept else [at], subjects)
