"""Running a command line: every error is one line on standard error, and an exit code."""

from __future__ import annotations

import atexit
import gc
import sys
import traceback

import click

from calib.core.base.errors import CalibrationError
from calib.core.base.letters import brief, visible
from calib.core.base.other_words import hint_for

_COLLECTED_AFTER = 50_000  # new objects; after each 700, Python's default, all imported objects would be searched


def _one_line(message: str) -> str:
    return brief(visible(" ".join(message.split())))


class OneLineError(click.ClickException):
    """An error that prints as one line."""

    def __init__(self, message: str, exit_code: int) -> None:
        super().__init__(_one_line(message))
        self.exit_code = exit_code  # type: ignore[misc]  # click declares it on the class, and documents setting it


def _usage(error: click.UsageError, path: str) -> str:
    """The error of a command line in one line, with a hint for an option or a command of another package.

    `path` is the command with the program's name, such as `calib fit`.
    """
    typed = error.option_name if isinstance(error, click.NoSuchOption) else getattr(error, "command_name", "")
    hint = (hint_for(typed, path) or hint_for(typed, "the command line")) if typed else ""
    if hint:  # in place of similar names
        return f"no {'option' if typed.startswith('-') else 'command'} '{typed}'{hint}"
    message = _one_line(error.format_message())
    if message.startswith("Got unexpected extra argument"):
        return message + hint_for("another", path)
    param = error.param if isinstance(error, click.MissingParameter) else None
    missing = "" if param is None else param.opts[0] if isinstance(param, click.Option) else param.human_readable_name
    hint = hint_for(missing, "missing arguments") if missing else ""
    return message.rstrip(".") + hint if hint else message


def run_program(group: click.Group) -> None:
    """Run a command line; every error is one line on standard error and an exit code."""
    gc.set_threshold(_COLLECTED_AFTER)
    atexit.register(gc.freeze)  # the system takes all memory back, so Python need not search it for garbage
    try:
        result = group.main(prog_name=group.name, standalone_mode=False)
        sys.exit(result if isinstance(result, int) else 0)
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message(), err=True)
        sys.exit(2)
    except click.UsageError as error:
        path = error.ctx.command_path if error.ctx else str(group.name)
        click.echo(f"{path}: {_usage(error, path)} (see {path} --help)", err=True)
        sys.exit(2)
    except click.ClickException as error:
        click.echo(f"{group.name}: {_one_line(error.format_message())}", err=True)
        sys.exit(error.exit_code)
    except CalibrationError as error:  # only with --debug
        traceback.print_exc()
        sys.exit(error.exit_code)
    except MemoryError:
        click.echo(f"{group.name}: there is not enough memory; give fewer poses or candidates at once", err=True)
        sys.exit(3)
    except (click.Abort, KeyboardInterrupt):
        click.echo(f"{group.name}: interrupted", err=True)
        sys.exit(130)
