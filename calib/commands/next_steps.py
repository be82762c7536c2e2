"""What commands say at the end: what the grade means, and the next command to type."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from typing import TYPE_CHECKING

import click

from calib.data.measurements import Measurements
from calib.fitting.fitted import Fit
from calib.judging.next_step import next_step
from calib.judging.verdict import judge

if TYPE_CHECKING:
    from calib.planning.assessment import Assessment

_MEANINGS = {
    "PASS": ("green", "this fit can be used at poses like those measured"),
    "CHECK": ("yellow", "read the reasons above before you use this fit; intervals may be too narrow"),
    "FAIL": ("red", "do not use these numbers; the reasons above say what to look for"),
}


def after_fit(fit: Fit, robot: str, data: Sequence[str], out: str, *, written: bool = True) -> str:
    """Return what the grade means, and what to do next.

    Args:
        fit: The fit.
        robot: ROBOT, as it was typed.
        data: DATA, likewise.
        out: Where the result is.
        written: Whether it is there, and is not only a proposal.
    """
    grade, step = judge(fit).grade, next_step(fit)
    colour, meaning = _MEANINGS[grade]
    words = step.typed(robot, data, out)
    if step.needs_folder and not written:
        words = f"fit again with --out {shlex.quote(out)}, then {words}"
    return f"{click.style(grade, fg=colour, bold=True)}: {meaning}\nNext: {words}"


def after_check(assessment: Assessment, robot: str, poses: object, data: Sequence[str]) -> str:
    """Return what to do about what poses determine.

    Args:
        assessment: What they determine.
        robot: ROBOT, as it was typed.
        poses: What was looked at.
        data: DATA, likewise; nothing where poses were sampled.
    """
    if not data:
        words: tuple[str, ...] = ("calib", "sample", robot, "--count", "1000", "--seed", "1", "--out", "poses.csv")
        return f"Next: write poses to choose from: {shlex.join(words)}"
    if assessment.determination.missing:
        hold = "hold parameters that are named above (`held` in the description), or add poses, and check again"
        return f"Next: {hold}: {shlex.join(('calib', 'check', robot, *data))}"
    if isinstance(poses, Measurements):
        words = ("calib", "fit", robot, *data, "--validate", "0.25", "--out", "out/robot")
        return f"Next: fit these measurements: {shlex.join(words)}"
    words = ("calib", "select", robot, *data, "--count", "40", "--out", "chosen.csv")
    return f"Next: choose the poses to measure: {shlex.join(words)}"


def after_select(robot: str, out: str) -> str:
    """Return what to do with chosen poses.

    Args:
        robot: ROBOT, as it was typed.
        out: The file with the chosen poses.
    """
    words = ("calib", "watch", robot, "measured.csv", "--goal", "0.1mm", "--candidates", out)
    return f"Next: measure them, and follow the measurement: {shlex.join(words)}"
