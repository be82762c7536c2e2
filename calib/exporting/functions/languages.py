"""A robot as a function: one file that computes tool poses from commands, without this package."""

from __future__ import annotations

from collections.abc import Sequence

from calib.core.base.errors import InputError
from calib.core.robots.robot import Robot

LANGUAGES = ("numpy", "c", "jax", "torch", "casadi")
"""C, and libraries of Python."""
COMMENTS = {"c": "//"}
"""Beginning of a comment in languages other than Python."""


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
