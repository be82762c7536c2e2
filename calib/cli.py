"""The `calib` program; a command is imported at first use."""

from __future__ import annotations

from importlib import import_module

import click

from calib import pictures
from calib.core.base.version import VERSION
from calib.core.commands.program import run_program

_GROUPS = {
    "Before measuring": {
        "init": ("calib.starting.command", "Write a robot description to start from."),
        "check": ("calib.planning.commands.check", "Say which parameters poses determine, and how well."),
        "sample": ("calib.planning.commands.sample", "Write poses that a robot can take."),
        "select": ("calib.planning.commands.select", "Choose the poses to measure."),
        "route": ("calib.motion.command", "Plan a way through poses, as a program for the robot."),
        "simulate": ("calib.studies.simulate_command", "Simulate measurements."),
        "study": ("calib.studies.command", "Calibrate many times from simulated measurements."),
    },
    "Measuring and calibrating": {
        "watch": ("calib.planning.commands.watch", "Say while measuring which pose is next, and when to stop."),
        "fit": ("calib.core.commands.fit", "Calibrate a robot from measurements."),
        "match": ("calib.matching.command", "Make a URDF agree with its controller."),
        "verify": ("calib.core.commands.verify", "Judge a calibrated robot by new measurements."),
        "compare": ("calib.fleets.compare_command", "Show results side by side."),
        "fleet": ("calib.fleets.command", "Make a prior for the next robot of a model."),
    },
    "Cameras": {
        "board": ("calib.photographs.commands.boards", "Write a board to print."),
        "detect": ("calib.photographs.commands.detect", "Find a printed board in photographs."),
        "hand-eye": ("calib.photographs.commands.hand_eye", "Find where a camera is, from photographs of a board."),
    },
    "Using the result": {
        "predict": ("calib.core.commands.predict", "Predict where the targets are."),
        "solve": ("calib.programs.commands.solve", "Find joint values that reach goals."),
        "compensate": ("calib.programs.commands.compensate", "Correct a program for the real robot."),
        "export": ("calib.exporting.command", "Write the robot in formats of other programs."),
    },
    "Quality systems": {
        "qualify": ("calib.quality.command", "Prove that this installation computes rightly."),
        "certificate": ("calib.quality.certificate_command", "Write a calibration certificate with its budget."),
    },
}
"""Module and help of each command in the order of work: the list of commands shows them, and imports no module.

The commands of the package that draws pictures follow.
"""
_COMMANDS = {name: command for group in _GROUPS.values() for name, command in group.items()}


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
        width = max(map(len, self.list_commands(ctx)))
        groups = {title: [(name, words) for name, (_, words) in group.items()] for title, group in _GROUPS.items()}
        others = [name for name in self.list_commands(ctx) if name not in _COMMANDS]
        groups["Looking at the result"] = [(name, pictures.named(name).summary) for name in others]
        for title, group in groups.items():
            if group:
                with formatter.section(title):
                    formatter.write_dl([(name.ljust(width), words) for name, words in group])


@click.group(name="calib", cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(VERSION, prog_name="calib")
def group() -> None:
    """Kinematic calibration of any robot with a URDF, closed loops included."""


def main() -> None:
    """Run the program."""
    run_program(group)
