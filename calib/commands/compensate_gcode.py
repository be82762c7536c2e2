"""The part of `calib compensate` that is about G-code."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from calib.arrays import FloatArray
from calib.commands.common import Output, said_of_failure
from calib.data.gcode import ROUNDING, GcodeProgram
from calib.data.gcode_reader import read_gcode
from calib.errors import DataError, InputError
from calib.inverse_kinematics.straight_moves import CompensatedMoves, StraightMoves, compensate_moves
from calib.linearisation.prediction import PositionUncertainty
from calib.model.robot import Robot
from calib.own_files import GCODE_COMMENT
from calib.units import millimetres, quantity
from calib.words import counted

_TOLERANCE_MM = 0.01


def compensate_gcode(
    calibrated: Robot,
    predict: Callable[[FloatArray], PositionUncertainty],
    path: str,
    result: str,
    places: tuple[str | None, str | None],
    tolerance_mm: float | None,
    out: str,
    output: Output,
) -> None:
    """Write a G-code program with which the calibrated robot goes where it says.

    Args:
        calibrated: The robot.
        predict: Predicts positions at joints (n, 3) [m or rad].
        path: The program.
        result: Folder of the calibration, for messages.
        places: --zero and --start.
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
    if len(calibrated.target_names) > 1:
        raise DataError(f"{calibrated.path}: has several targets; which of them X, Y and Z are of is not known")
    program = read_gcode(path, start)
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
        found = compensate_moves(calibrated, moves, tolerance)
        expected = predict(found.q).distance[:, 0]
    figures = _figures(found, expected)
    comments = (
        f"compensated for {calibrated.name} with {result}; between points at most"
        f" {figures['between_mm']['max']:.4f} mm off",
        *said_of_failure(output, result, out),
    )
    text = program.rewritten([way - origin for way in found.told], [" ".join(line.split()) for line in comments])
    output.write(out, text, GCODE_COMMENT)
    n_pieces = sum(len(way) for way in found.told)
    output.json({"n_moves": len(program.moves), "n_pieces": n_pieces, "n_measured": found.n_measured, **figures})
    output.say(_said(program, n_pieces, found.n_measured, figures, out))


def _point(text: str | None, option: str) -> tuple[float, ...] | None:
    """Read X,Y,Z in mm [m]."""
    if text is None:
        return None
    parts = text.split(",")
    if len(parts) != 3:
        raise InputError(f"{option} '{text}': write three numbers in mm, such as 0,0,-400")
    return tuple(quantity(f"{part.strip()} mm", "length", option) for part in parts)


def _figures(found: CompensatedMoves, expected: FloatArray) -> dict[str, dict[str, float]]:
    """Root mean square and largest error [mm]: without compensation, expected with it, and measured between points."""
    measured = found.deviations[np.isfinite(found.deviations)]
    between = measured + ROUNDING if len(measured) else np.zeros(1)
    shown = {"before_mm": found.before, "expected_mm": expected, "between_mm": between}
    return {
        name: {"rms": millimetres(float(np.sqrt(np.mean(values**2)))), "max": millimetres(float(np.max(values)))}
        for name, values in shown.items()
    }


def _said(program: GcodeProgram, n_pieces: int, n_measured: int, figures: dict[str, dict[str, float]], out: str) -> str:
    before, expected, between = figures["before_mm"], figures["expected_mm"], figures["between_mm"]
    return (
        f"{counted(len(program.moves), 'straight move')} compensated as {counted(n_pieces, 'line')}, written to {out}\n"
        f"The tool was off by {before['rms']:.4f} mm (rms); expected now: {expected['rms']:.4f} mm,"
        f" {expected['max']:.4f} mm at worst, from the noise of the measurements alone\n"
        f"Between points it is off by another {between['max']:.4f} mm at worst, measured at"
        f" {counted(n_measured, 'point')}"
    )
