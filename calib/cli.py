"""The `calib` program; a command is imported when it is asked for."""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import entry_points

import click

from calib.commands.program import run_program
from calib.version import VERSION

COMMANDS = "calib.commands"
"""Entry point group of commands that other packages add."""
_MODULES = {
    "init": "calib.commands.init",
    "check": "calib.commands.check",
    "select": "calib.commands.select",
    "simulate": "calib.commands.simulate",
    "fit": "calib.commands.fit",
    "predict": "calib.commands.predict",
    "solve": "calib.commands.solve",
    "compensate": "calib.commands.compensate",
    "verify": "calib.commands.verify",
    "export": "calib.commands.export",
}


class Commands(click.Group):
    """Our commands and those that other packages add."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return their names."""
        return sorted({*_MODULES, *entry_points(group=COMMANDS).names})

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Return one of them; None if there is none of this name."""
        if cmd_name in _MODULES:
            found: click.Command = import_module(_MODULES[cmd_name]).command
            return found
        for entry in entry_points(group=COMMANDS, name=cmd_name):
            added: click.Command = entry.load()
            return added
        for name in self.list_commands(ctx):  # click names the nearest of them
            known = self.get_command(ctx, name)
            if known is not None:
                self.add_command(known, name)
        return None


@click.group(name="calib", cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(VERSION, prog_name="calib")
def group() -> None:
    """Kinematic calibration of any robot with a URDF, closed loops included."""


def main() -> None:
    """Run the program."""
    run_program(group)
