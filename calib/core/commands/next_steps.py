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
"""Options that state the noise. They mean the same in every command."""


def options_as_typed() -> dict[str, tuple[str, ...]]:
    """Return the typed options of the running command, with their values, by their long name.

    Options on output are left out.
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
    """Return the words of the typed options among these."""
    return [word for name in names if name in typed for word in (name, *typed[name])]


def advice_after_fit(
    fit: Fit, robot: str, data: Sequence[str], out: str, typed: Mapping[str, Sequence[str]], *, written: bool = True
) -> str:
    """Return the meaning of the grade, and the next step, for ROBOT and DATA as typed.

    `typed` are options from `options_as_typed`. If the result was not `written`, its folder `out` is a proposal.
    """
    grade, step = judge(fit).grade, next_step(fit)
    noise = {name: typed[name] for name in NOISE if name in typed}
    kept = {"fit": typed, "check": noise}.get(step.command.split()[1], {})
    words = step.with_file_names(robot, data, out, kept)
    if step.needs_folder and not written:
        words = f"fit again with --out {shlex.quote(out)}, then {words}"
    return f"{grade}: {_MEANINGS[grade]}\nNext: {words}"
