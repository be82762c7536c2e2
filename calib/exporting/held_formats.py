"""What each export format holds of a calibrated robot, the robot that it gets for that, and what its file says of it.

The one place that knows what formats hold; `calib.core.robots.held` says what that means.
"""

from __future__ import annotations

from calib.core.base.errors import ComputationError
from calib.core.base.words import listed
from calib.core.robots.held import Holds
from calib.core.robots.robot import Robot
from calib.core.robots.robot_files import lost_by, without_terms
from calib.exporting.functions.languages import LANGUAGES, why_none
from calib.printers.linear_delta import is_linear_delta

FIRMWARES = ("klipper", "marlin", "duet")
"""Formats for delta printers."""
HELD: dict[str, Holds] = {
    "urdf": Holds.ORIGINS,
    "mjcf": Holds.ORIGINS,
    "drake": Holds.ORIGINS,
    "toolbox": Holds.ORIGINS,
    "dh": Holds.ORIGINS,
    "mdh": Holds.ORIGINS,
    "ur-kinematics": Holds.TO_LAST_AXIS,
    "joint-offsets": Holds.ZEROS,
    "xacro": Holds.ORIGINS,
    **dict.fromkeys(FIRMWARES, Holds.ORIGINS),
    "joint-tables": Holds.TABLES,
    **dict.fromkeys(LANGUAGES, Holds.EVERYTHING),
}
"""Every format, in the order of help and messages."""
_CHAINS = ("dh", "mdh", "ur-kinematics")
WHOLE = "the terms are in parameters.csv of the result folder, and calib predict, solve and compensate use them"
"""Where to have what a file loses."""


def formats_that_hold(holds: Holds, robot: Robot) -> list[str]:
    """Return the formats that hold so much of a robot, and can hold one with its loops and terms at all."""
    no_place = (*(_CHAINS if robot.mechanism.loops else ()),)
    no_place += () if is_linear_delta(robot.description) else FIRMWARES
    no_place += LANGUAGES if why_none(robot) else ()
    return [name for name, held in HELD.items() if held is holds and name not in no_place]


def held_of(robot: Robot, file_format: str) -> Holds:
    """Return how much of a robot a file of a format holds.

    What lies behind the last axis is looked at only in a fit of a robot that has such files.
    """
    holds = HELD[file_format]
    return Holds.ORIGINS if holds is Holds.TO_LAST_AXIS and holds not in robot.files else holds


def robot_for(robot: Robot, file_format: str, *, force: bool = False) -> Robot:
    """Return the robot that a file of a format gets; of joint zeros, the robot itself, which knows them.

    Args:
        robot: The robot; one of a fit knows which robot is best in each kind of file.
        file_format: The format.
        force: Whether the file is written even if it is worse than the nominal robot, or of unknown accuracy.

    Raises:
        ComputationError: It is, and is not forced.
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
    """Whether a file that holds so much has something to say of what it is not: what it loses, or that it is forced."""
    known = robot.files.get(holds)
    return bool(lost_by(robot, holds)) or (known is not None and bool(known.withheld))


def said_of(robot: Robot, holds: Holds) -> list[str]:
    """Return what a file that holds so much of a robot says: what it loses, and how good it is, as far as known."""
    lost, known = lost_by(robot, holds), robot.files.get(holds)
    if known is None:
        without = f"joint terms of {listed(lost)}, which are not in this file"
        return [f"exported by force: these values belong to {without}"] if lost and holds is not Holds.ZEROS else []
    lines = [f"exported by force: {known.withheld}"] if known.withheld else []
    if holds is Holds.ZEROS:  # what that format says by itself has the rest
        return lines
    if lost:
        lines.append(
            f"holds {holds.value}, fitted without the joint terms of {listed(lost)}, which have no place in this file;"
            f" {WHOLE}"
        )
    return [*lines, f"error of the robot in this file: {compared(robot, holds)}"]


def compared(robot: Robot, holds: Holds) -> str:
    """Return the error of the robot that a file gets, beside the nominal one and the whole model; one clause."""
    accuracy, whole = robot.files[holds].accuracy, robot.files.get(Holds.EVERYTHING)
    others = f"; the nominal robot has {accuracy.shown(accuracy.before)}"
    if whole is not None and whole.accuracy != accuracy:
        others += f", the whole model {whole.accuracy.shown(whole.accuracy.rms)}"
    return accuracy.words + others
