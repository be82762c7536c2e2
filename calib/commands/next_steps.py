"""What to say at the end to somebody who sits at a terminal: what the grade means, and the next command to type."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from typing import TYPE_CHECKING

import click

from calib.data.measurements import Measurements
from calib.fitting.fitted import Fit
from calib.judging.reasons import Answer, what_next
from calib.judging.rules_model import why_no_origins
from calib.judging.verdict import judge

if TYPE_CHECKING:
    from calib.planning.assessment import Assessment

_MEANINGS = {
    "PASS": ("green", "nothing was found against this fit"),
    "CHECK": ("yellow", "to be used by someone who has read the reasons above; intervals may be too narrow"),
    "FAIL": ("red", "do not use these numbers; the reasons above say what to look for"),
}


def after_fit(fit: Fit, robot: str, data: Sequence[str], out: str) -> list[str]:
    """Return what the verdict means, and the command that answers its first reason, or that goes on.

    Args:
        fit: The fit.
        robot: ROBOT, as it was typed.
        data: DATA, likewise.
        out: Where the result is.
    """
    verdict = judge(fit)
    grade = verdict.grade
    colour, meaning = _MEANINGS[grade]
    lines = [f"{click.style(grade, fg=colour, bold=True)}: {meaning}"]
    again = typed("calib", "fit", robot, *data)
    answers = [reason.answer for reason in verdict.reasons if reason.grade != "PASS"]
    following = what_next(grade, answers, validated=fit.validation is not None or fit.folds is not None)
    if following is Answer.OTHER_POSES:
        return [*lines, f"Next: {typed('calib', 'check', robot, *data)}    (what these poses do not tell)"]
    if following is Answer.VALIDATE:
        return [*lines, f"Next: {again} {following.value} --out {shlex.quote(out)}    (how good it is on other poses)"]
    if following not in (Answer.LOOK, Answer.USE):
        return [*lines, f"Next: {again} {following.value} --out {shlex.quote(f'{out}-2')}"]
    if following is Answer.LOOK:
        return [*lines, f"Next: {typed('calib', 'view', robot, '--result', out)}    (where the errors are)"]
    if why_no_origins(fit):
        program = typed("calib", "compensate", out, "program.csv", "--out", "compensated.csv")
        return [*lines, *([f"Next: {program}"] if fit.robot.terms else [])]
    return [*lines, f"Next: {typed('calib', 'export', out, '--format', 'urdf', '--out', 'calibrated.urdf')}"]


def after_check(assessment: Assessment, robot: str, poses: object, data: Sequence[str]) -> list[str]:
    """Return the command that follows on what poses determine.

    Args:
        assessment: What they determine.
        robot: ROBOT, as it was typed.
        poses: What was looked at.
        data: DATA, likewise; nothing where poses were sampled.
    """
    if not data:
        return [f"Next: {typed('calib', 'sample', robot, '--count', '1000', '--seed', '1', '--out', 'poses.csv')}"]
    if assessment.determination.missing:
        return [f"Next: hold what is named above (`held` in {robot}), or add poses; then the same command again"]
    if isinstance(poses, Measurements):
        return [f"Next: {typed('calib', 'fit', robot, *data, '--validate', '0.25', '--out', 'out/robot')}"]
    return [f"Next: {typed('calib', 'select', robot, *data, '--count', '40', '--out', 'chosen.csv')}"]


def after_select(robot: str, out: str) -> list[str]:
    """Return the command that follows on chosen poses.

    Args:
        robot: ROBOT, as it was typed.
        out: The file with the chosen poses.
    """
    watched = typed("calib", "watch", robot, "measured.csv", "--goal", "0.1mm", "--candidates", out)
    return [f"Next: measure them, and while you do: {watched}"]


def typed(*words: str) -> str:
    """Return words as a line to type."""
    return shlex.join(words)
