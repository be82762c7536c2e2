"""What commands say at the end: what the grade means, and the next command to type."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import click
from click.core import ParameterSource

from calib.core.data.measurements import Measurements
from calib.core.fitting.fitted import Fit
from calib.core.judging.next_step import next_step
from calib.core.judging.verdict import judge

if TYPE_CHECKING:
    from calib.planning.assessment import Assessment

_MEANINGS = {
    "PASS": ("green", "this fit can be used at poses like those measured"),
    "CHECK": ("yellow", "read the reasons above before you use this fit; intervals may be too narrow"),
    "FAIL": ("red", "do not use these numbers; the reasons above say what to look for"),
}
_NOT_AGAIN = ("--out", "--json", "--force", "--quiet", "--verbose", "--debug")
_NOISE = ("--sigma-mm",)
_POSES = ("--sigma-mm", "--parameters", "--result", "--task")
"""Options that mean the same in all commands: of those that know a noise, and of those that weigh poses."""


def typed_options() -> dict[str, tuple[str, ...]]:
    """Return the options of the running command that were typed, with their values, by their long name.

    Without those that say where to write and how much to print.
    """
    context = click.get_current_context()
    typed: dict[str, tuple[str, ...]] = {}
    for option in context.command.params:
        if option.name is None or context.get_parameter_source(option.name) is not ParameterSource.COMMANDLINE:
            continue
        name = max(option.opts, key=len)
        if isinstance(option, click.Option) and name not in _NOT_AGAIN:
            typed[name] = () if option.is_flag else (str(context.params[option.name]),)
    return typed


def _some(typed: Mapping[str, Sequence[str]], names: Sequence[str]) -> list[str]:
    """The words of those of these options that were typed."""
    return [word for name in names if name in typed for word in (name, *typed[name])]


def after_fit(
    fit: Fit, robot: str, data: Sequence[str], out: str, typed: Mapping[str, Sequence[str]], *, written: bool = True
) -> str:
    """Return what the grade means, and what to do next.

    Args:
        fit: The fit.
        robot: ROBOT, as it was typed.
        data: DATA, likewise.
        out: Where the result is.
        typed: Options, as `typed_options` has them.
        written: Whether it is there, and is not only a proposal.
    """
    grade, step = judge(fit).grade, next_step(fit)
    colour, meaning = _MEANINGS[grade]
    noise = {name: typed[name] for name in _NOISE if name in typed}
    kept = {"fit": typed, "check": noise}.get(step.command.split()[1], {})
    words = step.typed(robot, data, out, kept)
    if step.needs_folder and not written:
        words = f"fit again with --out {shlex.quote(out)}, then {words}"
    return f"{click.style(grade, fg=colour, bold=True)}: {meaning}\nNext: {words}"


def after_check(
    assessment: Assessment, robot: str, poses: object, data: Sequence[str], typed: Mapping[str, Sequence[str]]
) -> str:
    """Return what to do about what poses determine.

    Args:
        assessment: What they determine.
        robot: ROBOT, as it was typed.
        poses: What was looked at.
        data: DATA, likewise; nothing where poses were sampled.
        typed: Options, as `typed_options` has them.
    """
    if not data:
        words: tuple[str, ...] = ("calib", "sample", robot, "--count", "1000", "--seed", "1", "--out", "poses.csv")
        return f"Next: write poses to choose from: {shlex.join(words)}"
    if assessment.determination.missing:
        hold = "hold parameters that are named above (`held` in the description), or add poses, and check again"
        return f"Next: {hold}: {shlex.join(('calib', 'check', robot, *data, *_some(typed, tuple(typed))))}"
    if isinstance(poses, Measurements):
        options = (*_some(typed, _NOISE), "--validate", "0.25", "--out", "out/robot")
        words = ("calib", "fit", robot, *data, *options)
        return f"Next: fit these measurements: {shlex.join(words)}"
    words = ("calib", "select", robot, *data, "--count", "40", *_some(typed, _POSES), "--out", "chosen.csv")
    return f"Next: choose the poses to measure: {shlex.join(words)}"


def after_select(robot: str, out: str, typed: Mapping[str, Sequence[str]]) -> str:
    """Return what to do with chosen poses.

    Args:
        robot: ROBOT, as it was typed.
        out: The file with the chosen poses.
        typed: Options, as `typed_options` has them.
    """
    options = ("--goal", "0.1mm", "--candidates", out, *_some(typed, _NOISE))
    words = ("calib", "watch", robot, "measured.csv", *options)
    return f"Next: measure them, and follow the measurement: {shlex.join(words)}"
