"""The parts of `calib compensate` that are about G-code and about programs of controllers."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import DataError, InputError, UnreachablePoseError
from calib.core.base.files import write_files
from calib.core.base.own_files import is_mark, is_own
from calib.core.base.units import from_unit, millimetres, quantity, quantity_text
from calib.core.base.words import count_noun, listing
from calib.core.commands.common import Output
from calib.programs.commands.report import Figures, Job, figures_of, no_correction_sentence, summary
from calib.programs.languages.controller_program import CompensatedProgram, compensate_program
from calib.programs.languages.gcode import read_gcode
from calib.programs.languages.gcode_program import ROUNDING
from calib.programs.languages.languages import read_program
from calib.programs.languages.straight_moves import StraightMoves, compensate_moves

_SHOWN = 20


def compensate_controller(
    job: Job,
    *,
    frames: Sequence[str],
    harmless: Sequence[str],
    base_link: str | None,
    flange_link: str | None,
    third_joint: str | None,
    skip_unreachable: bool,
) -> None:
    """Write a controller's program, and the files beside it, for the calibrated robot.

    Raises:
        DataError: A program that cannot be read; with its line.
        InputError: The file to write has the suffix of another language.
        UnreachablePoseError: Targets that cannot be compensated.
    """
    suffix, out, output = Path(job.program).suffix, Path(job.out), job.output
    if out.suffix.lower() != suffix.lower():
        raise InputError(
            f"{out}: the program has the language of {job.program}; give the output the same ending, {suffix}"
        )
    program = read_program(job.program, frames, harmless)
    if is_own(Path(job.program)):
        output.note(
            f"note: {job.program}: this program wrote it; if it is compensated already, give the one it came from"
        )
    places = [out, *(out.with_suffix(Path(source.path).suffix) for source in program.sources[1:])]
    output.check(*map(str, places))
    count = count_noun(len(program.targets), "target")
    with output.working(f"compensating {count}"):
        compensated = compensate_program(
            job.robot_knowledge, program, base=base_link, flange=flange_link, third_joint=third_joint
        )
    compensation = compensated.compensation
    pairs = zip(program.targets, compensated.reasons, strict=True)
    missed = [f"{target.label} {why}" for target, why in pairs if why]
    if missed and not skip_unreachable:
        raise UnreachablePoseError(
            f"{len(missed)} of {count} cannot be compensated: {listing(missed, '; ')}; change them, or leave them as"
            " they are with --skip-unreachable"
        )
    for miss in missed:
        output.note(f"{miss}; left as it is")
    _note(output, "not compensated: ", [str(left) for left in program.left_out])
    _note(output, "note: ", [*compensated.configurations, *compensation.jumps()])
    job.comments()
    write_files(dict(zip(places, compensated.files(), strict=True)), comment=None, force=output.force)
    figures = {**figures_of(compensation), "rounding_mm": summary(millimetres(compensated.rounding[compensation.ok]))}
    what = (
        f"{int(np.sum(compensation.ok))} of {count}",
        f"compensated ({compensation.kept_components} kept)",
        "left as they are",
    )
    job = replace(job, out=" and ".join(map(str, places)))
    subjects = "At the targets the tool", "Its orientation"
    job.report(compensation, figures, _content(compensated), what, _remarks(compensated, figures), subjects)


def _note(output: Output, mark: str, lines: Sequence[str]) -> None:
    for line in lines[:_SHOWN]:
        output.note(f"{mark}{line}")
    if len(lines) > _SHOWN:
        output.note(f"and {len(lines) - _SHOWN} more (--json lists all)")


def _content(compensated: CompensatedProgram) -> dict[str, object]:
    program, compensation = compensated.program, compensated.compensation
    figures = {f"{name}_{unit}": values for (name, unit), values in compensation.figures().items()}
    row_of = {int(k): n for n, k in enumerate(compensated.rows)}
    return {
        "language": program.language,
        "base_link": compensated.base,
        "flange_link": compensated.flange,
        "kept": compensation.kept_components,
        "n_targets": len(program.targets),
        "n_compensated": sum(values is not None for values in compensated.values),
        "tool_from_target_mm": millimetres(compensated.lever),
        "targets": [
            {
                "file": target.path,
                "line": target.line,
                "name": target.name,
                "status": compensated.reasons[k] or "ok",
                **{name: float(figures[name][row_of[k]]) for name in ("before_mm", "expected_mm") if k in row_of},
            }
            for k, target in enumerate(program.targets)
        ],
        "not_compensated": [
            {"file": left.path, "line": left.line, "text": left.text, "why": left.why} for left in program.left_out
        ],
        "configurations": list(compensated.configurations),
    }


def _remarks(compensated: CompensatedProgram, figures: Figures) -> list[str]:
    program, compensation, lines = compensated.program, compensated.compensation, []
    if not compensation.nothing_to_correct:
        lines.append(
            f"Rounding to the file's decimals moves the tool by {figures['rounding_mm']['max']:.4f} mm at worst"
        )
        lines.append("Between distant targets it is off by more, since moves are not cut; add targets on long moves")
    if compensated.lever > 1e-6 and "expected_angle_mrad" in figures:
        turned = from_unit(figures["expected_angle_mrad"]["rms"], "mrad")
        most = figures["expected_mm"]["rms"] + millimetres(compensated.lever) * turned
        lines.append(
            f"These figures are for target '{compensation.target}'. The program's tool tips are up to"
            f" {quantity_text(compensated.lever, 'mm', '.1f')} from it; there the expected error is at most {most:.4f}"
            " mm (RMS)"
        )
    if program.left_out:
        lines.append(f"{count_noun(len(program.left_out), 'place')} not compensated, listed above")
    return [
        *lines,
        f"Poses are from link '{compensated.base}' to link '{compensated.flange}' and the program's tool",
    ]


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
    origin, begin = np.array(_point(zero, "--zero") or (0.0, 0.0, 0.0)), _point(start, "--start")
    tolerance_mm = 0.01 if tolerance_mm is None else tolerance_mm
    if not 1e-3 <= tolerance_mm <= 1e3:
        raise InputError(f"--tolerance-mm {tolerance_mm:g}: must lie between 0.001 and 1000")
    robot = job.robot_knowledge.robot
    if len(robot.target_names) > 1:
        raise DataError(f"{robot.path}: has several targets, but G-code moves only one; describe that target alone")
    program = read_gcode(job.program, begin, dialect, harmless)
    if any(map(is_mark, program.lines)):
        raise DataError(f"{job.program}: is compensated already; give the program from which it was made")
    job.output.check(job.out)
    if not program.unit_stated:
        job.output.note(f"note: {job.program}: has no G20 or G21; its numbers are taken for millimetres (G21)")
    tolerance = quantity(f"{tolerance_mm!r} mm", "length", "--tolerance-mm") - ROUNDING
    unknown = (np.nan, np.nan, np.nan)
    moves = StraightMoves(
        np.array([move.start or unknown for move in program.moves]) + origin,
        np.array([move.end for move in program.moves]) + origin,
        tuple(program.label(move) for move in program.moves),
    )
    with job.output.working(f"compensating {count_noun(len(program.moves), 'move')}"):
        compensated = compensate_moves(job.robot_knowledge, moves, tolerance)
    between = compensated.deviations[np.isfinite(compensated.deviations)] + ROUNDING
    figures = {
        "before_mm": summary(millimetres(compensated.before)),
        "expected_mm": summary(millimetres(compensated.expected)),
        "between_mm": summary(millimetres(between if len(between) else np.zeros(1))),
    }
    worst, n_pieces = figures["between_mm"]["max"], sum(len(way) for way in compensated.waypoints)
    done = f"compensated for {robot.name} with {job.result}; between points at most {worst:.4f} mm off"
    ways: list[FloatArray] | None = [way - origin for way in compensated.waypoints]
    points = count_noun(compensated.n_measured, "point")
    lines = [f"Between points it is off by another {worst:.4f} mm at worst, measured at {points}"]
    if compensated.nothing_to_correct:
        done, ways, lines = f"left as it is for {robot.name}: {no_correction_sentence(job.result)}", None, []
    comments = job.comments(f"{done}; errors are {compensated.frame}")
    text = program.rewritten(ways, [" ".join(line.split()) for line in comments])
    job.output.write(job.out, text, program.comment)
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
