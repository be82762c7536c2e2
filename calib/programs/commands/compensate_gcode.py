"""The part of `calib compensate` that is about G-code."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import DataError, InputError
from calib.core.base.own_files import GCODE_COMMENT
from calib.core.base.units import millimetres, quantity
from calib.core.base.words import count_noun
from calib.programs.commands.report import Job, no_correction_sentence, summary
from calib.programs.languages.gcode import read_gcode
from calib.programs.languages.gcode_program import ROUNDING
from calib.programs.languages.straight_moves import CompensatedMoves, StraightMoves, compensate_moves

_TOLERANCE_MM = 0.01


def compensate_gcode(
    job: Job,
    *,
    zero: str | None,
    start: str | None,
    dialect: str | None,
    harmless: Collection[str],
    tolerance_mm: float | None,
) -> None:
    """Write a G-code program that leads the calibrated robot through the points of the given program.

    Raises:
        InputError: An option has a value that cannot be.
        DataError: The robot has several targets, or the program has other moves than straight ones (names the line).
    """
    origin = np.array(_point(zero, "--zero") or (0.0, 0.0, 0.0))
    begin = _point(start, "--start")
    tolerance_mm = _TOLERANCE_MM if tolerance_mm is None else tolerance_mm
    if not 1e-3 <= tolerance_mm <= 1e3:
        raise InputError(f"--tolerance-mm {tolerance_mm:g}: must lie between 0.001 and 1000")
    robot = job.robot_knowledge.robot
    if len(robot.target_names) > 1:
        raise DataError(f"{robot.path}: has several targets, but G-code moves only one; describe that target alone")
    program = read_gcode(job.program, begin, dialect, harmless)
    job.output.check(job.out)
    tolerance = quantity(f"{tolerance_mm!r} mm", "length", "--tolerance-mm") - ROUNDING
    unknown = (np.nan, np.nan, np.nan)
    moves = StraightMoves(
        np.array([move.start or unknown for move in program.moves]) + origin,
        np.array([move.end for move in program.moves]) + origin,
        tuple(program.label(move) for move in program.moves),
    )
    with job.output.working(f"compensating {count_noun(len(program.moves), 'move')}"):
        compensated = compensate_moves(job.robot_knowledge, moves, tolerance)
    figures = _figures(compensated)
    worst, n_pieces = figures["between_mm"]["max"], sum(len(way) for way in compensated.waypoints)
    done = f"compensated for {robot.name} with {job.result}; between points at most {worst:.4f} mm off"
    ways: list[FloatArray] | None = [way - origin for way in compensated.waypoints]
    more = f"Between points it is off by another {worst:.4f} mm at worst, measured at"
    lines = [f"{more} {count_noun(compensated.n_measured, 'point')}"]
    if compensated.nothing_to_correct:
        done, ways, lines = f"left as it is for {robot.name}: {no_correction_sentence(job.result)}", None, []
    comments = job.comments(f"{done}; errors are {compensated.frame}")
    text = program.rewritten(ways, [" ".join(line.split()) for line in comments])
    job.output.write(job.out, text, GCODE_COMMENT)
    content = {"n_moves": len(program.moves), "n_pieces": n_pieces, "n_measured": compensated.n_measured}
    what = count_noun(len(program.moves), "straight move")
    cut = f"compensated as {count_noun(n_pieces, 'line')}"
    job.report(compensated, figures, content, (what, cut, "left as they are"), lines)


def _point(text: str | None, option: str) -> tuple[float, ...] | None:
    """Read X,Y,Z in mm, and return them in m."""
    if text is None:
        return None
    parts = text.split(",")
    if len(parts) != 3:
        raise InputError(f"{option} '{text}': write three numbers in mm, such as 0,0,-400")
    return tuple(quantity(f"{part.strip()} mm", "length", option) for part in parts)


def _figures(compensated: CompensatedMoves) -> dict[str, dict[str, float]]:
    """Root mean square and largest error [mm]: without compensation, expected with it, and along the cut moves."""
    measured = compensated.deviations[np.isfinite(compensated.deviations)]
    between = measured + ROUNDING if len(measured) else np.zeros(1)
    shown = {"before_mm": compensated.before, "expected_mm": compensated.expected, "between_mm": between}
    return {name: summary(millimetres(values)) for name, values in shown.items()}
