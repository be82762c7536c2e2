"""Formats of files: how much of a calibrated robot each holds, the robot to write into it, and the remarks in it.

Formats are brought by capabilities and other packages, under the group `calib.formats`: each entry is a tuple of
`Format`. `calib.core.robots.accuracy_of_files` says what holding means.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from calib.core.base.errors import ComputationError
from calib.core.base.registry import load_group
from calib.core.base.words import listing
from calib.core.robots.accuracy_of_files import Holds
from calib.core.robots.robot import Robot
from calib.core.robots.robot_files import lost_by, without_terms

WHOLE = "the terms are in parameters.csv of the result folder, and calib predict, solve and compensate use them"
"""Where joint terms are that a file does not hold."""


@dataclass(frozen=True)
class FormatFile:
    """A file for a controller.

    Attributes:
        content: Its bytes.
        statement: Its content, and the error that it leaves, in words.
    """

    content: bytes
    statement: str


@dataclass(frozen=True)
class Format:
    """A format of files.

    Attributes:
        name: Its name for `calib export --format`.
        holds: How much of a robot it holds.
        fits: Whether it can hold a robot with its loops and terms.
        write: Function of the robot, with its current values, and of lines for the comment; returns the file, or raises
            `InputError` where the robot does not fit. None: the format is one of `calib.exporting.formats`.
        comment: How comments of its files begin, if not as in tables or XML.
    """

    name: str
    holds: Holds
    fits: Callable[[Robot], bool] = lambda robot: True
    write: Callable[[Robot, Sequence[str]], FormatFile] | None = None
    comment: str = ""


def formats() -> dict[str, Format]:
    """Return every format by its name, in the order of help and messages."""
    return {each.name: each for _, given in load_group("calib.formats", "format of files") for each in given}


def formats_that_hold(holds: Holds, robot: Robot) -> list[str]:
    """Return the formats of this kind that can hold a robot with its loops and terms."""
    return [name for name, each in formats().items() if each.holds is holds and each.fits(robot)]


def held_of(robot: Robot, file_format: str) -> Holds:
    """Return how much of a robot a file of a format holds.

    `TO_LAST_AXIS` is returned only if the robot comes from a fit that has a robot for files of that kind.
    """
    holds = formats()[file_format].holds
    return Holds.ORIGINS if holds is Holds.TO_LAST_AXIS and holds not in robot.files else holds


def robot_for(robot: Robot, file_format: str, *, force: bool = False) -> Robot:
    """Return the robot to write into a file of a format; for joint zeros, the robot itself, which knows its zeros.

    `ComputationError` if the file is worse than the nominal robot, or of unknown accuracy, unless `force` is set.
    """
    holds = held_of(robot, file_format)
    known = robot.files.get(holds)
    hint = "; --force writes it all the same"
    if known is not None and known.withheld and not force:
        raise ComputationError(
            f"format '{file_format}' holds {holds.value}; such a file is not written: {known.withheld}{hint}"
        )
    if holds is Holds.ZEROS:
        return robot
    try:
        return robot.held_by(holds)
    except ComputationError as error:
        if not force:
            raise ComputationError(f"format '{file_format}': {error}{hint}") from None
    return without_terms(robot, holds)


def loses(robot: Robot, holds: Holds) -> bool:
    """Whether a file of this kind must say that it loses something, or that it was written by force."""
    known = robot.files.get(holds)
    return bool(lost_by(robot, holds)) or (known is not None and bool(known.withheld))


def remarks_on_file(robot: Robot, holds: Holds) -> list[str]:
    """Return the remarks in a file of this kind: what it loses, and its error, as far as known."""
    lost, known = lost_by(robot, holds), robot.files.get(holds)
    if known is None:
        without = f"joint terms of {listing(lost)}, which are not in this file"
        return [f"exported by force: these values need {without}"] if lost and holds is not Holds.ZEROS else []
    lines = [f"exported by force: {known.withheld}"] if known.withheld else []
    if holds is Holds.ZEROS:  # the format's own remarks have the rest
        return lines
    if lost:
        lines.append(
            f"holds {holds.value}, fitted without the joint terms of {listing(lost)}, which have no place in this file;"
            f" {WHOLE}"
        )
    return [*lines, f"error of the robot in this file: {error_comparison(robot, holds)}"]


def error_comparison(robot: Robot, holds: Holds) -> str:
    """Return the error of the robot in a file, of the nominal one and of the whole model, as one clause."""
    accuracy, whole = robot.files[holds].accuracy, robot.files.get(Holds.EVERYTHING)
    others = f"; the nominal robot has {accuracy.in_unit(accuracy.before)}"
    if whole is not None and whole.accuracy != accuracy:
        others += f", the whole model {whole.accuracy.in_unit(whole.accuracy.rms)}"
    return accuracy.words + others
