"""The `calib` program; a command is imported at first use."""

from __future__ import annotations

from importlib import import_module

import click

from calib import pictures
from calib.core.base.version import VERSION
from calib.core.commands.program import run_program

_COMMANDS = {
    "init": ("calib.starting.command", "Write a robot description to start from."),
    "check": ("calib.planning.commands.check", "Say which parameters poses determine, and how well."),
    "sample": ("calib.planning.commands.sample", "Write poses that a robot can take."),
    "compare": ("calib.fleets.compare_command", "Show results side by side."),
    "fleet": ("calib.fleets.command", "Make a prior for the next robot of a model."),
    "select": ("calib.planning.commands.select", "Choose the poses to measure."),
    "route": ("calib.motion.command", "Plan a way through poses, as a program for the robot."),
    "simulate": ("calib.studies.simulate_command", "Simulate measurements."),
    "study": ("calib.studies.command", "Calibrate many times from simulated measurements."),
    "fit": ("calib.core.commands.fit", "Calibrate a robot from measurements."),
    "predict": ("calib.core.commands.predict", "Predict where the targets are."),
    "solve": ("calib.programs.commands.solve", "Find joint values that reach goals."),
    "compensate": ("calib.programs.commands.compensate", "Correct a program for the real robot."),
    "match": ("calib.matching.command", "Make a URDF agree with its controller."),
    "verify": ("calib.core.commands.verify", "Judge a calibrated robot by new measurements."),
    "export": ("calib.exporting.command", "Write the robot in formats of other programs."),
    "qualify": ("calib.quality.command", "Prove that this installation computes rightly."),
    "certificate": ("calib.quality.certificate_command", "Write a calibration certificate with its budget."),
    "watch": ("calib.planning.commands.watch", "Say while measuring which pose is next, and when to stop."),
    "detect": ("calib.photographs.commands.detect", "Find a printed board in photographs."),
    "board": ("calib.photographs.commands.boards", "Write a board to print."),
    "hand-eye": ("calib.photographs.commands.hand_eye", "Find where a camera is, from photographs of a board."),
}
"""Module and help of each command: the list of commands shows them, and imports no module."""


_GROUPS = {
    "Before measuring": ("init", "check", "sample", "select", "route", "simulate", "study"),
    "Measuring and calibrating": ("watch", "fit", "match", "verify", "compare", "fleet"),
    "Cameras": ("board", "detect", "hand-eye"),
    "Using the result": ("predict", "solve", "compensate", "export"),
    "Quality systems": ("qualify", "certificate"),
}
"""The commands in the order of work; those of the package that draws pictures follow them."""


class Commands(click.Group):
    """The commands of this package, and those of the package that draws pictures (`calib.pictures`)."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of the commands."""
        return sorted({*_COMMANDS, *pictures.commands()})

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Return the command of a name; None if there is none."""
        if cmd_name in _COMMANDS:
            command: click.Command = import_module(_COMMANDS[cmd_name][0]).command
            return command
        if cmd_name in pictures.commands():
            return pictures.named(cmd_name).command
        for name in self.list_commands(ctx):  # click names the nearest of them
            self.add_command(click.Command(name))
        return None

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the list of commands, group by group, their summaries one below the other."""
        names = self.list_commands(ctx)
        grouped = {name for group in _GROUPS.values() for name in group}
        groups = {**_GROUPS, "Looking at the result": tuple(name for name in names if name not in grouped)}
        width = max(len(name) for name in names)
        for title, group in groups.items():
            if not group:
                continue
            with formatter.section(title):
                formatter.write_dl(
                    [
                        (name.ljust(width), _COMMANDS[name][1] if name in _COMMANDS else pictures.named(name).summary)
                        for name in group
                    ]
                )


@click.group(name="calib", cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(VERSION, prog_name="calib")
def group() -> None:
    """Kinematic calibration of any robot with a URDF, closed loops included."""


def main() -> None:
    """Run the program."""
    run_program(group)
