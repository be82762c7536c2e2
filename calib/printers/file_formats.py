"""The formats of three firmwares for `calib export`; `calib.printers.formats` writes them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from calib.core.robots.accuracy_of_files import Holds
from calib.core.robots.file_formats import Format, FormatFile
from calib.core.robots.robot import Robot

COMMENTS = {"klipper": "#", "marlin": ";", "duet": ";"}
"""The firmwares, and the mark of comments in their settings."""


def _writer(firmware: str) -> Callable[[Robot, Sequence[str]], FormatFile]:
    def write(robot: Robot, lines: Sequence[str]) -> FormatFile:
        from calib.printers.formats import printer_lines  # here: a fit names formats, and writes none of them

        return printer_lines(robot, firmware, lines)

    return write


def is_linear_delta(robot: Robot) -> bool:
    """Return whether a robot has the parametrisation of delta printers."""
    return robot.description.parametrisation == "linear_delta"


FORMATS = tuple(
    Format(firmware, Holds.ORIGINS, is_linear_delta, _writer(firmware), comment)
    for firmware, comment in COMMENTS.items()
)
