"""The formats of `calib export` and their contents; `calib.exporting.formats` writes them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module

from calib.core.robots.accuracy_of_files import Holds
from calib.core.robots.file_formats import Format, FormatFile
from calib.core.robots.robot import Robot
from calib.exporting.functions.languages import COMMENTS, LANGUAGES, why_none

_WRITERS = "calib.exporting.controllers"  # loaded at first use, since a fit only names formats


def _controller(name: str, *convention: str) -> Callable[[Robot, Sequence[str]], FormatFile]:
    def write(robot: Robot, lines: Sequence[str]) -> FormatFile:
        written: FormatFile = getattr(import_module(_WRITERS), name)(robot, *convention, lines)
        return written

    return write


def _is_chain(robot: Robot) -> bool:
    return not robot.mechanism.loops


def _is_ur(robot: Robot) -> bool:
    return _is_chain(robot) and bool(import_module(_WRITERS).has_ur_kinematics(robot))


def _has_functions(robot: Robot) -> bool:
    return not why_none(robot)


_origins = partial(Format, holds=Holds.ORIGINS)
FORMATS = (
    *(_origins(name) for name in ("urdf", "mjcf", "drake", "toolbox")),
    _origins("dh", fits=_is_chain, write=_controller("dh_file", "standard")),
    _origins("mdh", fits=_is_chain, write=_controller("dh_file", "modified")),
    Format("ur-kinematics", Holds.TO_LAST_AXIS, _is_ur, _controller("ur_kinematics")),
    Format("joint-offsets", Holds.ZEROS, write=_controller("joint_offsets")),
    _origins("xacro", write=_controller("xacro_origins")),
)
MORE_FORMATS = (
    Format("joint-tables", Holds.TABLES),
    *(Format(name, Holds.EVERYTHING, _has_functions, comment=COMMENTS.get(name, "")) for name in LANGUAGES),
)
"""The formats that hold joint terms."""
