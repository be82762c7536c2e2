"""The part of `calib compensate` that is about tables of corrections."""

from __future__ import annotations

from calib.core.base.errors import InputError
from calib.core.base.units import PER_SI, millimetres
from calib.core.base.words import count_noun
from calib.core.data.measurement_columns import cells_of
from calib.core.data.measurements import Poses
from calib.core.data.table_writing import format_table
from calib.programs.commands.report import Job, frame_words, no_correction_sentence, summary
from calib.programs.languages.correction_grid import correction_grid
from calib.programs.reaching.goals import Goals


def compensate_grid(job: Job, program: Poses | Goals, grid: str) -> None:
    """Write the table of corrections for the box of a program's positions, and report its interpolation error.

    Raises:
        InputError: The program has joint values, or `grid` is not three usable numbers of nodes.
    """
    if not isinstance(program, Goals):
        raise InputError("--grid: PROGRAM has joints; give positions with one orientation")
    try:
        nx, ny, nz = (int(part) for part in grid.split(","))
    except ValueError:
        raise InputError(f"--grid '{grid}': write three numbers of nodes, such as 5,5,3") from None
    with job.output.working("compensating the grid"):
        corrections = correction_grid(job.robot_knowledge, program, (nx, ny, nz))
    compensation, degrees = corrections.compensation, PER_SI["angle"]["deg"]
    parts = [
        (f"{compensation.target}_{{}} [mm]", millimetres(corrections.nodes)),
        ("add_{} [mm]", millimetres(corrections.shift)),
    ]
    if program.rotations is not None:
        parts.append(("turn_{} [deg]", corrections.turn * degrees))
    columns = [(name.format(axis), cells_of(values[:, k])) for name, values in parts for k, axis in enumerate("xyz")]
    off, angle = summary(millimetres(corrections.position_errors)), summary(corrections.angle_errors * degrees)
    wrong = (
        f"linear interpolation is off by {off['rms']:.4f} mm (RMS), {off['max']:.4f} mm and {angle['max']:.4f} deg at"
        " worst"
    )
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
    more = (
        [] if kept else [f"{wrong[0].upper()}{wrong[1:]}, at {len(corrections.position_errors)} points between nodes"]
    )
    what = count_noun(len(corrections.nodes), "node"), "with corrections", "all zero"
    subjects = "At the nodes the tool", ""
    job.report(compensation, figures, {"n_nodes": len(corrections.nodes)}, what, more, subjects)
