"""The `calib` program; a command is imported when it is asked for."""

from __future__ import annotations

from importlib import import_module

import click

from calib import pictures
from calib.base.version import VERSION
from calib.commands.program import run_program

_MODULES = {
    "init": "calib.commands.init",
    "check": "calib.commands.check",
    "sample": "calib.commands.sample",
    "compare": "calib.commands.compare",
    "select": "calib.commands.select",
    "simulate": "calib.commands.simulate",
    "study": "calib.commands.study",
    "fit": "calib.commands.fit",
    "predict": "calib.commands.predict",
    "solve": "calib.commands.solve",
    "compensate": "calib.commands.compensate",
    "verify": "calib.commands.verify",
    "export": "calib.commands.export",
    "watch": "calib.commands.watch",
}


class Commands(click.Group):
    """The commands of this package, and those that come with the pictures."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return their names."""
        return sorted({*_MODULES, *pictures.commands()})

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Return one of them; None if there is none of this name."""
        if cmd_name in _MODULES:
            found: click.Command = import_module(_MODULES[cmd_name]).command
            return found
        if cmd_name in pictures.commands():
            return pictures.command(cmd_name)
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
