"""The part of `calib compensate` that is about tables of corrections."""

from __future__ import annotations

import numpy as np

from calib.core.base.errors import InputError
from calib.core.base.units import PER_SI, millimetres
from calib.core.base.words import counted
from calib.core.commands.common import Output, said_of_failure
from calib.core.data.measurement_columns import cells_of
from calib.core.data.measurements import Poses
from calib.core.data.table_writing import format_table
from calib.core.rows.known_robot import KnownRobot
from calib.programs.languages.correction_grid import correction_grid
from calib.programs.reaching.expected_errors import (
    COUNTED,
    before_and_now,
    expected_now,
    left_as_it_is,
    of_frame,
    summary,
)
from calib.programs.reaching.goals import Goals


def compensate_grid(
    known: KnownRobot, program: Poses | Goals, grid: str, result: str, out: str, output: Output
) -> None:
    """Write the table of corrections, and say how wrong interpolation in it is.

    Args:
        known: The calibrated robot.
        program: Whose positions the table is for.
        grid: --grid.
        result: Folder of the calibration, for messages.
        out: File to write.
        output: Where to print.

    Raises:
        InputError: A program of joints, or numbers of nodes that make no grid.
    """
    if not isinstance(program, Goals):
        raise InputError("--grid: PROGRAM has joints; give positions with one orientation")
    try:
        nx, ny, nz = (int(part) for part in grid.split(","))
    except ValueError:
        raise InputError(f"--grid '{grid}': write three numbers of nodes, such as 5,5,3") from None
    with output.working("compensating the grid"):
        corrections = correction_grid(known, program, (nx, ny, nz))
    name, degrees = corrections.target, PER_SI["angle"]["deg"]
    columns: list[tuple[str, list[object]]] = []
    for k, axis in enumerate("xyz"):
        columns.append((f"{name}_{axis} [mm]", cells_of(millimetres(corrections.nodes[:, k]))))
    for k, axis in enumerate("xyz"):
        columns.append((f"add_{axis} [mm]", cells_of(millimetres(corrections.shift[:, k]))))
    for k, axis in enumerate("xyz") if program.rotations is not None else ():
        columns.append((f"turn_{axis} [deg]", cells_of(corrections.turn[:, k] * degrees)))
    off, angle = millimetres(corrections.position_errors), corrections.angle_errors * degrees
    wrong = (
        f"linear interpolation is off by {np.sqrt(np.mean(off**2)):.4f} mm (RMS), {np.max(off):.4f} mm and"
        f" {np.max(angle):.4f} deg at worst"
    )
    kept, before = corrections.nothing_to_correct, summary(millimetres(corrections.before))
    expected = summary(millimetres(corrections.expected))
    done = f"all zero: {left_as_it_is(result)}" if kept else wrong
    comments = (
        f"corrections from {result}; {done}; errors are {corrections.frame}; {COUNTED}",
        *said_of_failure(output, result, out),
    )
    output.write(out, format_table(columns, comments))
    output.json(
        {
            "n_nodes": len(corrections.nodes),
            "frame": corrections.frame,
            "counted": COUNTED,
            "nothing_to_correct": kept,
            "before_mm": before,
            "expected_mm": expected,
            "interpolation_mm": {"rms": float(np.sqrt(np.mean(off**2))), "max": float(np.max(off))},
            "interpolation_deg": {"max": float(np.max(angle))},
        }
    )
    nodes = f"{counted(len(corrections.nodes), 'node')} written to {out}"
    subject = "At the nodes the tool"
    if kept:
        lines = [f"{nodes}, all zero: {left_as_it_is(result)}", expected_now(subject, expected, "mm")]
    else:
        lines = [
            f"{nodes}; {wrong}, at {len(off)} points between them",
            before_and_now(subject, before, expected, "mm"),
        ]
    output.say("\n".join([*lines, of_frame(corrections.frame)]))
