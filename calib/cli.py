"""The `calib` program."""

from __future__ import annotations

from importlib.metadata import entry_points

import click

from calib.commands import check, compensate, export, fit, init, predict, select, simulate, solve, verify
from calib.commands.common import run_program
from calib.version import VERSION

COMMANDS = "calib.commands"
"""Entry point group of commands that other packages add."""


@click.group(name="calib", context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(VERSION, prog_name="calib")
def group() -> None:
    """Kinematic calibration of any robot with a URDF, closed loops included."""


for _module in (init, check, select, simulate, fit, predict, solve, compensate, verify, export):
    group.add_command(_module.command)
for _entry in entry_points(group=COMMANDS):
    group.add_command(_entry.load())


def main() -> None:
    """Run the program."""
    run_program(group)
