"""What all commands share: one line for every error, exit codes, --quiet, --debug and --json."""

import errno
import json
import re
import sys

import click
import pytest

from calib import cli
from calib.core.base.errors import CalibrationError, ComputationError, InputError, NotConvergedError
from calib.core.commands.common import shared_options, with_values
from calib.core.commands.program import run_program
from tests.signed_files import read_plain


@pytest.fixture
def run(monkeypatch, capsys):
    """Run a program whose only command calls a function with its `output`; give exit code, output and errors."""

    def run_function(function, *arguments):
        @click.group(name="tool")
        def group():
            pass

        @group.command("do")
        @shared_options(json_output=True)
        def do(output):
            function(output)

        for stream in ("stdout", "stderr"):  # click replaces them when a pipe closes
            monkeypatch.setattr(sys, stream, getattr(sys, stream))
        monkeypatch.setattr(sys, "argv", ["/somewhere/else.py", *arguments])
        with pytest.raises(SystemExit) as ended:
            run_program(group)
        streams = capsys.readouterr()
        return ended.value.code, streams.out, streams.err

    return run_function


def raising(error):
    def function(output):
        raise error

    return function


@pytest.mark.parametrize(
    ("error", "code", "line"),
    [
        (InputError("data.csv: wrong"), 2, "tool: data.csv: wrong\n"),
        (ComputationError("no answer"), 3, "tool: no answer\n"),
        (NotConvergedError("two\n lines"), 3, "tool: two lines\n"),
        (
            ValueError("odd"),
            1,
            "tool: unexpected ValueError: odd; this is a defect of the program; --debug shows where\n",
        ),
        (KeyboardInterrupt(), 130, "tool: interrupted\n"),
        (BrokenPipeError(errno.EPIPE, "head has seen enough"), 1, ""),
    ],
)
def test_every_error_is_one_line_and_an_exit_code(run, error, code, line):
    ended, out, err = run(raising(error), "do")
    assert (ended, out, err.lstrip("\n")) == (code, "", line)
    if isinstance(error, CalibrationError):
        ended, _, err = run(raising(error), "do", "--debug")
        assert (ended, err[:9], err.endswith(f"{error}\n")) == (code, "Traceback", True)


def test_output_goes_where_it_belongs(run, tmp_path):
    def function(output):
        output.say("for people")
        output.note("remark")
        output.json({"µ": [1, float("nan")]})

    assert run(function, "do") == (0, "for people\n", "remark\n")
    assert run(function, "do", "--quiet") == (0, "", "")
    path = tmp_path / "out.json"
    assert run(function, "do", "--json", str(path)) == (0, "for people\n", "remark\n")
    assert json.loads(read_plain(path)) == {"µ": [1, None]}
    code, out, err = run(function, "do", "--json", "-")
    assert (code, err) == (0, "remark\n")
    assert json.loads(out) == {"µ": [1, None]}  # and nothing else is on standard output


def test_a_place_for_json_that_cannot_be_written_is_refused_before_the_work(run, tmp_path):
    worked = []
    code, _, err = run(worked.append, "do", "--json", str(tmp_path / "no" / "out.json"))
    assert (code, worked) == (2, [])
    assert "cannot be written (no such file or directory)" in err


def test_long_work_tells_a_file_how_far_it_is_unless_quiet_and_shows_it_no_spinner(run, monkeypatch):
    def function(output):
        with output.working("short"):
            pass
        with output.working("thinking") as progress:
            progress(1, 3)
            clock[0] += 59.0
            progress(2, 3)
            clock[0] += 2.0
            progress(3, 3)

    clock = [0.0]
    monkeypatch.setattr("calib.core.commands.common.time.monotonic", lambda: clock[0])
    assert run(function, "do") == (0, "", "thinking: 3 of 3\n")
    assert run(function, "do", "--quiet") == (0, "", "")


def test_usage_errors_name_the_command_and_its_help(run):
    assert run(print, "do", "--jso", "x")[2] == (
        "tool do: No such option '--jso'. Did you mean '--json'? (see tool do --help)\n"
    )
    assert run(print, "undo")[0] == 2


@pytest.mark.parametrize("name", ["fit", "init", "predict", "simulate"])
def test_every_command_has_help_quiet_and_debug(run_calib, name):
    done = run_calib(name, "--help")
    assert (done.code, done.err) == (0, "")
    assert done.out.startswith(f"Usage: calib {name} ")
    for option in ("--quiet", "--debug", "--help"):
        assert option in done.out


def test_without_a_file_or_a_result_the_robot_stays_nominal(medrue):
    assert with_values(medrue, None, None) is medrue


def test_the_list_of_commands_is_grouped_and_names_each_once(run_calib):
    told = run_calib("--help").out
    assert "Before measuring:" in told
    assert "Using the result:" in told
    context = click.Context(cli.group)
    for name in cli.group.list_commands(context):
        assert len(re.findall(rf"^  {name} ", told, re.MULTILINE)) == 1, name
