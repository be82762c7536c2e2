"""The command reference is what the programs print for --help."""

import re
import shlex

import click
from click.testing import CliRunner
from command_reference import EXAMPLES, WIDTH, commands, page, programs


def test_every_command_is_on_the_page_with_its_help():
    text = page()
    assert [program.name for program in programs()] == ["calib", "medrue"]
    names = [name for name, _, _ in commands()]
    assert {"calib", "calib fit", "calib check", "calib select", "medrue study"} <= set(names)
    for name in names:
        assert len(re.findall(rf"^#+ {name}$", text, re.MULTILINE)) == 1


def test_the_page_says_what_the_programs_print():
    runner = CliRunner()
    text = page()
    for program in programs():
        for arguments in ([], *([name] for name in program.commands)):
            done = runner.invoke(program, [*arguments, "--help"], prog_name=program.name, terminal_width=WIDTH)
            assert done.exit_code == 0
            assert done.output.strip() in text


def test_every_command_has_an_example_that_its_options_understand():
    for name, command, context in commands():
        if isinstance(command, click.Group):
            continue
        program, word, *arguments = shlex.split(EXAMPLES[name])
        assert f"{program} {word}" == name
        with command.make_context(word, arguments, parent=context.parent) as parsed:
            assert not parsed.args
