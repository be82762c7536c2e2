"""The formats of three firmwares for `calib export`; `calib.printers.formats` writes them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from calib.core.robots.accuracy_of_files import Holds
from calib.core.robots.file_formats import Format, FormatFile
from calib.core.robots.robot import Robot
from calib.printers import COMMENTS


def _writer(firmware: str) -> Callable[[Robot, Sequence[str]], FormatFile]:
    def write(robot: Robot, lines: Sequence[str]) -> FormatFile:
        from calib.printers.formats import printer_lines  # here: a fit names formats, and writes none of them

        return printer_lines(robot, firmware, lines)

    return write


def _is_linear_delta(robot: Robot) -> bool:
    return robot.description.parametrisation == "linear_delta"


FORMATS = tuple(
    Format(firmware, Holds.ORIGINS, _is_linear_delta, _writer(firmware), comment)
    for firmware, comment in COMMENTS.items()
)
