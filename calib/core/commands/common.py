"""Options, one-line errors with exit codes, JSON output, progress and files of poses, for all commands."""

from __future__ import annotations

import functools
import json
import logging
import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
from rich.console import Console

from calib.core.base.errors import CalibrationError, InputError
from calib.core.base.files import check_file, check_folder, write_file
from calib.core.base.letters import visible
from calib.core.base.own_files import inputs_noted
from calib.core.base.units import quantity
from calib.core.base.words import as_data
from calib.core.base.workers import Progress
from calib.core.commands.program import OneLineError
from calib.core.data.parameter_files import read_parameters
from calib.core.numerics.losses import LOSSES
from calib.core.results.result_reading import forced_lines, load, load_result
from calib.core.robots.loading import first_description
from calib.core.robots.robot import Robot

SIGMA_HELP = (
    "Noise of one position reading: one standard deviation along each axis [mm]. Default: as the description states"
    " it. The description also has the noise of other instruments"
)
"""Help on --sigma-mm in every command."""
FORCED = "Also replace files that this program did not write, or that this command reads."
"""Help on --force in every command."""
_REMARKS = 5
_LINE_EVERY = 60.0  # [s] between lines on the progress of long work without a terminal


@dataclass(frozen=True)
class Output:
    """Output of a command: its stream, and the files that it may write.

    Attributes:
        quiet: Print nothing but errors.
        json_target: File for JSON, `-` for standard output (then nothing else goes there), or None.
        force: Whether to replace files of other programs, and files that the command reads.
    """

    quiet: bool
    json_target: str | None
    force: bool

    def say(self, text: str) -> None:
        """Print text for people."""
        if not self.quiet and self.json_target != "-":
            click.echo(visible(text))

    def note(self, text: str) -> None:
        """Print a warning or remark to standard error."""
        if not self.quiet:
            click.echo(visible(text), err=True)

    def alarm(self, text: str) -> None:
        """Print a danger to standard error, in red on a terminal."""
        if not self.quiet:
            click.secho(visible(text), err=True, fg="red")

    def remarks(self, remarks: Sequence[str]) -> None:
        """Print the first few remarks on single poses to standard error."""
        for remark in remarks[:_REMARKS]:
            self.note(f"note: {remark}")
        if len(remarks) > _REMARKS:
            self.note(f"note: and {len(remarks) - _REMARKS} more")

    def json(self, content: object) -> None:
        """Write JSON if requested; null for unknown numbers."""
        if self.json_target is None:
            return
        text = json.dumps(as_data(content), indent=1, allow_nan=False, ensure_ascii=False) + "\n"
        if self.json_target == "-":
            click.echo(text, nl=False)
        else:
            self.write(self.json_target, text)

    def write(self, path: str, content: bytes | str, comment: str = "") -> None:
        """Write a file; see `calib.core.base.files.write_files`."""
        write_file(path, content, comment=comment, force=self.force)

    def check(self, *files: str | None, folders: Sequence[str | None] = (), names: Sequence[str] = ()) -> None:
        """Raise `InputError` before any work if an output could not be written; call it after all input was read.

        Outputs are files other than that of --json, and folders with the known names of their files.
        """
        targets = [file for file in (*files, self.json_target) if file not in (None, "-")]
        for file in targets:
            check_file(str(file), force=self.force)
        given = [folder for folder in folders if folder is not None]
        for folder in given:
            check_folder(folder, names, force=self.force)
        places = [Path(str(file)).resolve() for file in targets]
        clash = next((path for path in places if path in [Path(folder).resolve() for folder in given]), None)
        if clash is not None:
            raise InputError(f"{clash}: is to be a file and a folder; give each output a place of its own")
        places += [Path(folder, name).resolve() for folder in given for name in names]
        for path in places:
            if places.count(path) > 1 and (path.is_file() or not path.exists()):
                raise InputError(f"{path}: is to be written twice; give each output a place of its own")

    @contextmanager
    def working(self, what: str) -> Iterator[Progress]:
        """Show a spinner on a terminal during long work; yields a function for the progress.

        Where standard error is a file, it gets a line a minute.
        """
        console = Console(stderr=True)
        if self.quiet:
            yield lambda done, total: None
            return
        if not console.is_terminal:
            yield _line_now_and_then(what)
            return
        with console.status(what) as status:
            yield lambda done, total: status.update(f"{what}: {done} of {total}")


def _line_now_and_then(what: str) -> Progress:
    """Return a function that prints the progress to standard error, at most once in `_LINE_EVERY`."""
    last = time.monotonic()

    def tell(done: int, total: int) -> None:
        nonlocal last
        if time.monotonic() - last >= _LINE_EVERY:
            last = time.monotonic()
            click.echo(f"{what}: {done} of {total}", err=True)

    return tell


def shared_options(
    *, json_output: bool = False, forced: str = FORCED
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Give a command --quiet, --debug, --force (and --json) and an argument `output`; print errors in a single line.

    The command raises `OneLineError` for every error, but with --debug the error itself. `forced`: effect of --force.
    """

    def decorate(function: Callable[..., None]) -> Callable[..., None]:
        @functools.wraps(function)
        def run(
            *args: Any, quiet: bool, debug: bool, force: bool, json_target: str | None = None, **options: Any
        ) -> None:
            _check_values(click.get_current_context())
            output = Output(quiet, json_target, force)
            _tell_warnings(quiet)
            try:
                with inputs_noted():
                    output.check()
                    function(*args, output=output, **options)
            except (click.ClickException, click.exceptions.Exit, click.Abort):
                raise
            except BrokenPipeError:
                raise  # the reader, `head` for instance, has seen enough: click ends in silence
            except Exception as error:
                if debug:
                    raise
                raise _in_one_line(error) from None

        run = click.option("-f", "--force", is_flag=True, help=forced)(run)
        run = click.option("--debug", is_flag=True, help="Show the traceback of an error.")(run)
        run = click.option("-q", "--quiet", is_flag=True, help="Print nothing but errors.")(run)
        if json_output:
            run = click.option(
                "--json",
                "json_target",
                metavar="FILE",
                is_flag=False,
                flag_value="-",
                help="Write the result as JSON; without FILE, or with '-', to standard output, and nothing else there.",
            )(run)
        return run

    return decorate


def _check_values(context: click.Context) -> None:
    """Raise `click.BadParameter` for an empty word, such as that of an unset variable of the shell, and for nan or inf.

    Infinity is in every open range, and nan in all ranges, as click compares them.
    """
    for param in context.command.params:
        value = context.params.get(param.name or "")
        if isinstance(param.type, click.FloatRange) and value is not None and not math.isfinite(value):
            raise click.BadParameter(f"{value} is not a finite number", context, param)
        if value == "" or (isinstance(value, tuple) and "" in value):
            raise click.BadParameter("it is empty; give it a value, or leave it out", context, param)


def _in_one_line(error: Exception) -> OneLineError:
    if isinstance(error, CalibrationError):
        return OneLineError(str(error), error.exit_code)
    if isinstance(error, OSError):
        reason = (error.strerror or str(error)).lower()
        return OneLineError(f"{error.filename or 'output'}: {reason}", InputError.exit_code)
    words = f"unexpected {type(error).__name__}: {error}; this is a defect of the program; --debug shows where"
    return OneLineError(words, 1)


class _ToStandardError(logging.Handler):
    """Prints warnings of the library as notes, one line each."""

    def emit(self, record: logging.LogRecord) -> None:
        """Print the warning."""
        click.echo(f"note: {visible(record.getMessage())}", err=True)


def _tell_warnings(quiet: bool) -> None:
    log = logging.getLogger("calib")
    log.handlers = [logging.NullHandler() if quiet else _ToStandardError(logging.WARNING)]
    log.propagate = False


def jobs_option(shared: str, default: int = 1) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return the option --jobs, for processes that share some work."""
    return click.option(
        "-j",
        "--jobs",
        type=click.IntRange(min=1),
        default=default,
        show_default="all cores" if default > 1 else True,
        help=f"Number of processes for {shared}; results do not depend on it.",
    )


def values_options(function: Callable[..., None]) -> Callable[..., None]:
    """Give a command --parameters and --result, the sources of ROBOT's values (`with_values`)."""
    help_text = "Parameter values (CSV parameter,value,unit); nominal if not given."
    with_result = click.option("--result", metavar="DIR", help="Use the calibrated values of this result folder.")
    return click.option("--parameters", metavar="FILE", help=help_text)(with_result(function))


def loss_option(function: Callable[..., None]) -> Callable[..., None]:
    """Give a command --loss."""
    losses, help_text = click.Choice(LOSSES), "Robust loss: gives outliers less weight."
    return click.option("--loss", type=losses, default="none", show_default=True, help=help_text)(function)


def sigma_in_metres(sigma_mm: float, *, zero: bool = False) -> float:
    """Return the --sigma-mm option in m, or raise `InputError` if it is not possible; 0 needs `zero`."""
    if not (0 <= sigma_mm < 1e6 and (zero or sigma_mm > 0)):
        raise InputError(f"--sigma-mm {sigma_mm:g}: must be {'zero or ' if zero else ''}a positive number")
    return quantity(f"{sigma_mm!r} mm", "length", "--sigma-mm")


def failure_lines(output: Output, result: str | None, out: str) -> list[str]:
    """Print a note if the result failed and was forced, and return lines that say so in a file made from it."""
    lines = forced_lines(result) if result else []
    if lines:
        output.note(f"note: the fit in {result} failed; {out} says so inside")
    return lines


def load_robot(path: str, output: Output) -> Robot:
    """Load ROBOT; print a note on parts of a plain URDF that the robot leaves out."""
    robot = load(path)
    remark = first_description(robot.urdf, robot.path)[1] if robot.path == robot.urdf.path else ""
    if remark:
        output.note(f"note: {remark}")
    return robot


def folder_of_values(robot: str, parameters: str | None, result: str | None) -> str | None:
    """Return the result folder that gives the values: that of --result, or ROBOT where it is one."""
    return robot if result is None and parameters is None and Path(robot).is_dir() else result


def result_folder(robot: str, result: str | None) -> str:
    """Return the result folder of a command that needs one, --result or ROBOT, or raise `InputError`."""
    folder = folder_of_values(robot, None, result)
    if folder is None:
        raise InputError(f"{robot}: is not a result folder; give that as ROBOT, or with --result DIR")
    return folder


def with_values(robot: Robot, parameters: str | None, result: str | None) -> Robot:
    """Return the robot with the values of a parameter file or of a result folder, if one is given.

    `InputError` if both are given, or a file cannot be read; `ComputationError` if the verdict of the result is FAIL.
    """
    if parameters and result:
        raise InputError("give --parameters or --result, not both")
    if parameters:
        return robot.with_parameters(read_parameters(parameters, robot))
    return load_result(result, robot).robot if result else robot
