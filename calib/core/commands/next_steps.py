"""The end of a command's output: meaning of the grade, and the next command to type."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence

import click
from click.core import ParameterSource

from calib.core.fitting.fitted import Fit
from calib.core.judging.next_step import next_step
from calib.core.judging.verdict import judge

_MEANINGS = {
    "PASS": "this fit can be used at poses like those measured",
    "CHECK": "read the reasons above before you use this fit; intervals may be too narrow",
    "FAIL": "do not use these numbers; the reasons above say what to look for",
}
_NOT_AGAIN = ("--out", "--json", "--force", "--quiet", "--verbose", "--debug")
NOISE = ("--sigma-mm",)
"""Options that mean the same in all commands that know a noise."""


def options_as_typed() -> dict[str, tuple[str, ...]]:
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


def words_of(typed: Mapping[str, Sequence[str]], names: Sequence[str]) -> list[str]:
    """Return the words of those of these options that were typed."""
    return [word for name in names if name in typed for word in (name, *typed[name])]


def advice_after_fit(
    fit: Fit, robot: str, data: Sequence[str], out: str, typed: Mapping[str, Sequence[str]], *, written: bool = True
) -> str:
    """Return what the grade means, and what to do next.

    Args:
        fit: The fit.
        robot: ROBOT, as it was typed.
        data: DATA, as it was typed.
        out: Folder of the result.
        typed: Options, as `options_as_typed` has them.
        written: Whether the result was written; if not, `out` is a proposal.
    """
    grade, step = judge(fit).grade, next_step(fit)
    noise = {name: typed[name] for name in NOISE if name in typed}
    kept = {"fit": typed, "check": noise}.get(step.command.split()[1], {})
    words = step.with_file_names(robot, data, out, kept)
    if step.needs_folder and not written:
        words = f"fit again with --out {shlex.quote(out)}, then {words}"
    return f"{grade}: {_MEANINGS[grade]}\nNext: {words}"
