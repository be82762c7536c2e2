"""The part of `calib compensate` that is about G-code."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from calib.core.base.errors import DataError, InputError
from calib.core.base.own_files import GCODE_COMMENT
from calib.core.base.units import millimetres, quantity
from calib.core.base.words import counted
from calib.core.commands.common import Output, said_of_failure
from calib.core.rows.known_robot import KnownRobot
from calib.programs.languages.gcode import read_gcode
from calib.programs.languages.gcode_program import ROUNDING, GcodeProgram
from calib.programs.languages.straight_moves import CompensatedMoves, StraightMoves, compensate_moves
from calib.programs.reaching.expected_errors import (
    COUNTED,
    before_and_now,
    expected_now,
    left_as_it_is,
    of_frame,
    summary,
)

_TOLERANCE_MM = 0.01


def compensate_gcode(
    known: KnownRobot,
    path: str,
    result: str,
    places: tuple[str | None, str | None],
    rules: tuple[str | None, Collection[str]],
    tolerance_mm: float | None,
    out: str,
    output: Output,
) -> None:
    """Write a G-code program with which the calibrated robot goes where it says.

    Args:
        known: The calibrated robot.
        path: The program.
        result: Folder of the calibration, for messages.
        places: --zero and --start.
        rules: --dialect and --harmless.
        tolerance_mm: --tolerance-mm; 0.01 if not given.
        out: File to write.
        output: Where to print.

    Raises:
        InputError: An option that cannot be.
        DataError: Several targets, or a program that is not one of straight moves; with its line.
    """
    zero, start = (_point(text, option) for text, option in zip(places, ("--zero", "--start"), strict=True))
    tolerance_mm = _TOLERANCE_MM if tolerance_mm is None else tolerance_mm
    if not 1e-3 <= tolerance_mm <= 1e3:
        raise InputError(f"--tolerance-mm {tolerance_mm:g}: must lie between 0.001 and 1000")
    if len(known.robot.target_names) > 1:
        raise DataError(
            f"{known.robot.path}: has several targets, but G-code moves only one; describe that target alone"
        )
    program = read_gcode(path, start, *rules)
    output.check(out)
    tolerance = quantity(f"{tolerance_mm!r} mm", "length", "--tolerance-mm") - ROUNDING
    origin = np.zeros(3) if zero is None else np.array(zero)
    unknown = (np.nan, np.nan, np.nan)
    moves = StraightMoves(
        np.array([move.start or unknown for move in program.moves]) + origin,
        np.array([move.end for move in program.moves]) + origin,
        tuple(program.label(move) for move in program.moves),
    )
    with output.working(f"compensating {counted(len(program.moves), 'move')}"):
        compensated = compensate_moves(known, moves, tolerance)
    figures = _figures(compensated)
    between = f"between points at most {figures['between_mm']['max']:.4f} mm off"
    done = f"compensated for {known.robot.name} with {result}; {between}"
    if compensated.nothing_to_correct:
        done = f"left as it is for {known.robot.name}: {left_as_it_is(result)}"
    comments = (f"{done}; errors are {compensated.frame}", *said_of_failure(output, result, out))
    comments = tuple(" ".join(line.split()) for line in comments)
    ways = None if compensated.nothing_to_correct else [way - origin for way in compensated.waypoints]
    output.write(out, program.rewritten(ways, comments), GCODE_COMMENT)
    n_pieces = sum(len(way) for way in compensated.waypoints)
    output.json(
        {
            "n_moves": len(program.moves),
            "n_pieces": n_pieces,
            "n_measured": compensated.n_measured,
            "frame": compensated.frame,
            "counted": COUNTED,
            "nothing_to_correct": compensated.nothing_to_correct,
            **figures,
        }
    )
    output.say(_said(program, compensated, figures, result, out))


def _point(text: str | None, option: str) -> tuple[float, ...] | None:
    """Read X,Y,Z in mm [m]."""
    if text is None:
        return None
    parts = text.split(",")
    if len(parts) != 3:
        raise InputError(f"{option} '{text}': write three numbers in mm, such as 0,0,-400")
    return tuple(quantity(f"{part.strip()} mm", "length", option) for part in parts)


def _figures(compensated: CompensatedMoves) -> dict[str, dict[str, float]]:
    """Root mean square and largest error [mm]: without compensation, expected with it, and measured between points."""
    measured = compensated.deviations[np.isfinite(compensated.deviations)]
    between = measured + ROUNDING if len(measured) else np.zeros(1)
    shown = {"before_mm": compensated.before, "expected_mm": compensated.expected, "between_mm": between}
    return {name: summary(millimetres(values)) for name, values in shown.items()}


def _said(
    program: GcodeProgram, compensated: CompensatedMoves, figures: dict[str, dict[str, float]], result: str, out: str
) -> str:
    moves, n_pieces = counted(len(program.moves), "straight move"), sum(len(way) for way in compensated.waypoints)
    before, expected, between = figures["before_mm"], figures["expected_mm"], figures["between_mm"]
    if compensated.nothing_to_correct:
        lines = [
            f"{moves} left as they are: {left_as_it_is(result)}; written to {out}",
            expected_now("The tool", expected, "mm"),
        ]
    else:
        lines = [
            f"{moves} compensated as {counted(n_pieces, 'line')}, written to {out}",
            before_and_now("The tool", before, expected, "mm"),
            f"Between points it is off by another {between['max']:.4f} mm at worst, measured at"
            f" {counted(compensated.n_measured, 'point')}",
        ]
    return "\n".join([*lines, of_frame(compensated.frame)])
