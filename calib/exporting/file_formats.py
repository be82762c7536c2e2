"""The formats of `calib export` and their contents; `calib.exporting.formats` writes them, when first asked to."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module

from calib.core.base.errors import InputError
from calib.core.robots.accuracy_of_files import Holds
from calib.core.robots.file_formats import Format, FormatFile
from calib.core.robots.robot import Robot

LANGUAGES = ("numpy", "c", "jax", "torch", "casadi")
"""C, and libraries of Python."""


def function_file(robot: Robot, language: str, lines: Sequence[str]) -> bytes:
    """Return the file of a robot's function; `lines` are comments on the origin of the numbers.

    Raises:
        InputError: `why_none` gives a reason, or nothing moves the robot's target.
        ComputationError: No configuration is known at which the loops close.
    """
    # imported here, since commands that only name formats do not need these writers
    from calib.exporting.functions.c_text import c_text
    from calib.exporting.functions.facts import facts_of
    from calib.exporting.functions.python_text import python_text

    if refused := why_none(robot):
        raise InputError(f"format '{language}': {refused}")
    facts, header = facts_of(robot), [f"Made from {robot.path}.", *lines]
    text = c_text(facts, header) if language == "c" else python_text(facts, language, header)
    return text.encode()


def why_none(robot: Robot) -> str:
    """Return the reason why a robot cannot be written as a function; empty if it can."""
    whole = next((loop for loop in robot.mechanism.loops if loop.full_pose), None)
    if whole is not None:
        return f"loop {whole.name} is of type 6d, which functions cannot close; describe it with closures of type 3d"
    silent = next((term for term in robot.terms if term.adds and term.formula(0) is None), None)
    if silent is None:
        return ""
    named = f"'{silent.parameters[0].name}' ({type(silent).__qualname__})"
    return f"the joint term of {named} gives no formula; choose another format"


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


_origins = partial(Format, holds=Holds.ORIGINS)
_function = partial(Format, holds=Holds.EVERYTHING, fits=lambda robot: not why_none(robot))
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
    *(_function(name, comment={"c": "//"}.get(name, "")) for name in LANGUAGES),
)
"""The formats that hold joint terms."""
