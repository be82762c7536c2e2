"""The part of `calib compensate` that is about programs of controllers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calib.core.base.errors import InputError, UnreachablePoseError
from calib.core.base.files import write_files
from calib.core.base.units import ERROR_UNIT, error_scale, millimetres
from calib.core.base.words import counted
from calib.core.commands.common import Output, said_of_failure
from calib.core.rows.known_robot import KnownRobot
from calib.programs.languages.controller_program import CompensatedProgram, compensate_program
from calib.programs.languages.languages import read_program
from calib.programs.languages.robot_program import RobotProgram
from calib.programs.reaching.expected_errors import (
    COUNTED,
    before_and_now,
    expected_now,
    left_as_it_is,
    of_frame,
    summary,
)

_SHOWN = 20


def compensate_controller(
    known: KnownRobot,
    path: str,
    result: str,
    frames: Sequence[str],
    harmless: Sequence[str],
    links: tuple[str | None, str | None, str | None],
    skip_unreachable: bool,
    out: str,
    output: Output,
) -> None:
    """Write a controller's program with which the calibrated robot goes where it says.

    Args:
        known: The calibrated robot.
        path: The program.
        result: Folder of the calibration, for messages.
        frames: --frames.
        harmless: --harmless.
        links: --base-link, --flange-link and --third-joint.
        skip_unreachable: Whether targets that cannot be compensated stay as they are.
        out: File to write; a `.dat` file goes beside it.
        output: Where to print.

    Raises:
        DataError: A program that cannot be read; with its line.
        InputError: The file to write has the suffix of another language.
        UnreachablePoseError: Targets that cannot be compensated.
    """
    suffix = Path(path).suffix
    if Path(out).suffix.lower() != suffix.lower():
        raise InputError(f"{out}: the program has the language of {path}, whose names end in {suffix}; end it so, too")
    program = read_program(path, frames, harmless)
    places = [Path(out), *(Path(out).with_suffix(Path(source.path).suffix) for source in program.sources[1:])]
    output.check(*map(str, places))
    base, flange, third_joint = links
    with output.working(f"compensating {counted(len(program.targets), 'target')}"):
        compensated = compensate_program(known, program, base=base, flange=flange, third_joint=third_joint)
    missed = [k for k, why in enumerate(compensated.reasons) if why]
    if missed and not skip_unreachable:
        named = "; ".join(f"{program.targets[k].label} {compensated.reasons[k]}" for k in missed[:5])
        more = f" (and {len(missed) - 5} more)" if len(missed) > 5 else ""
        raise UnreachablePoseError(
            f"{counted(len(missed), 'target')} of {len(program.targets)} cannot be compensated: {named}{more}; change"
            " them, or leave them as they are with --skip-unreachable"
        )
    for k in missed:
        output.note(f"{program.targets[k].label} {compensated.reasons[k]}; left as it is")
    _note(output, "", [str(place_left) for place_left in program.left_out])
    _note(output, "note: ", [*compensated.configurations, *compensated.compensation.jumps()])
    said_of_failure(output, result, out)
    write_files(dict(zip(places, compensated.files(), strict=True)), comment=None, force=output.force)
    output.json(_content(program, compensated))
    output.say(_said(program, compensated, result, [str(place) for place in places]))


def _note(output: Output, mark: str, lines: Sequence[str]) -> None:
    for line in lines[:_SHOWN]:
        output.note(f"{mark}{line}" if mark else f"not compensated: {line}")
    if len(lines) > _SHOWN:
        output.note(f"and {len(lines) - _SHOWN} more (--json lists all)")


def _figures(compensated: CompensatedProgram) -> dict[str, dict[str, float]]:
    """Root mean square and largest errors, of positions [mm] and of orientations where they are kept [mrad]."""
    compensation, ok = compensated.compensation, compensated.compensation.ok
    figures = {f"{name}_mm": millimetres(getattr(compensation, name)[ok]) for name in ("before", "expected")}
    if compensation.keep != "position":
        angle = error_scale("angle")
        figures |= {
            f"{name}_angle_{ERROR_UNIT['angle']}": angle * getattr(compensation, f"{name}_angle")[ok]
            for name in ("before", "expected")
        }
    figures["rounding_mm"] = millimetres(compensated.rounding[ok])
    return {name: summary(np.asarray(values)) for name, values in figures.items()}


def _content(program: RobotProgram, compensated: CompensatedProgram) -> dict[str, object]:
    compensation = compensated.compensation
    place = {int(k): n for n, k in enumerate(compensated.rows)}
    return {
        "language": program.language,
        "base_link": compensated.base,
        "flange_link": compensated.flange,
        "kept": compensation.keep,
        "frame": compensation.frame,
        "counted": COUNTED,
        "nothing_to_correct": compensation.nothing_to_correct,
        "n_targets": len(program.targets),
        "n_compensated": sum(values is not None for values in compensated.values),
        **_figures(compensated),
        "tool_from_target_mm": millimetres(compensated.lever),
        "targets": [
            {
                "file": target.path,
                "line": target.line,
                "name": target.name,
                "status": compensated.reasons[k] or "ok",
                **(
                    {
                        f"{name}_mm": millimetres(float(getattr(compensation, name)[place[k]]))
                        for name in ("before", "expected")
                    }
                    if k in place
                    else {}
                ),
            }
            for k, target in enumerate(program.targets)
        ],
        "not_compensated": [
            {"file": place_left.path, "line": place_left.line, "text": place_left.text, "why": place_left.why}
            for place_left in program.left_out
        ],
        "configurations": list(compensated.configurations),
    }


def _said(program: RobotProgram, compensated: CompensatedProgram, result: str, places: Sequence[str]) -> str:
    compensation, figures = compensated.compensation, _figures(compensated)
    n, written = int(np.sum(compensation.ok)), " and ".join(places)
    count = f"{n} of {counted(len(program.targets), 'target')}"
    if compensation.nothing_to_correct:
        lines = [
            f"{count} left as they are: {left_as_it_is(result)}; written to {written}",
            expected_now("The tool", figures["expected_mm"], "mm"),
        ]
    else:
        lines = [
            f"{count} compensated ({compensation.keep} kept), written to {written}",
            before_and_now("The tool", figures["before_mm"], figures["expected_mm"], "mm"),
        ]
        if "before_angle_mrad" in figures:
            lines.append(
                before_and_now("Its orientation", figures["before_angle_mrad"], figures["expected_angle_mrad"], "mrad")
            )
        lines.append(f"Rounding to the file's decimals moves it by {figures['rounding_mm']['max']:.4f} mm at worst")
    if compensated.lever > 1e-6 and "expected_angle_mrad" in figures:
        far = millimetres(compensated.lever)
        most = figures["expected_mm"]["rms"] + far * figures["expected_angle_mrad"]["rms"] / 1e3
        lines.append(
            f"These figures are for target '{compensation.target}'; the program's tools end up to {far:.1f} mm from it,"
            f" where at most {most:.4f} mm (RMS) are expected"
        )
    if program.left_out:
        lines.append(f"{counted(len(program.left_out), 'place')} not compensated, listed above")
    lines.append(f"Poses are from link '{compensated.base}' to link '{compensated.flange}' and the program's tool")
    return "\n".join([*lines, of_frame(compensation.frame)])
