"""The next command to type, at the end of the output of planning commands."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence

from calib.core.commands.next_steps import NOISE, words_of
from calib.core.data.measurements import Measurements
from calib.planning.assessment import Assessment

_POSES = ("--sigma-mm", "--parameters", "--result", "--task")
"""Options with the same meaning in all commands about poses."""


def advice_after_check(
    assessment: Assessment, robot: str, poses: object, data: Sequence[str], typed: Mapping[str, Sequence[str]]
) -> str:
    """Return the next step after an assessment.

    Args:
        data: DATA as typed; empty if poses were sampled.
        typed: Options as typed, from `typed_options`.
    """
    if not data:
        words: tuple[str, ...] = ("calib", "sample", robot, "--count", "1000", "--seed", "1", "--out", "poses.csv")
        return f"Next: write poses to choose from: {shlex.join(words)}"
    if assessment.determination.missing:
        hold = "hold parameters that are named above (`held` in the description), or add poses, and check again"
        return f"Next: {hold}: {shlex.join(('calib', 'check', robot, *data, *words_of(typed, tuple(typed))))}"
    if isinstance(poses, Measurements):
        options = (*words_of(typed, NOISE), "--validate", "0.25", "--out", "out/robot")
        words = ("calib", "fit", robot, *data, *options)
        return f"Next: fit these measurements: {shlex.join(words)}"
    words = ("calib", "select", robot, *data, "--count", "40", *words_of(typed, _POSES), "--out", "chosen.csv")
    return f"Next: choose the poses to measure: {shlex.join(words)}"


def advice_after_select(robot: str, out: str, typed: Mapping[str, Sequence[str]]) -> str:
    """Return the next step after a choice of poses, written to the file `out`."""
    options = ("--goal", "0.1mm", "--candidates", out, *words_of(typed, NOISE))
    words = ("calib", "watch", robot, "measured.csv", *options)
    return f"Next: measure them, and follow the measurement: {shlex.join(words)}"
