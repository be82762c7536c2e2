"""Rotary axes of a machining centre: the position of each axis of rotation in the names of ISO 230-1, and as a table.

Joints `a`, `b` and `c` turn about x, y and z at their zeros. Each may be displaced along both other axes, and tilted
about them: EX0C and EY0C, EA0C and EB0C for axis C, and so on. The measurements are centres of balls on the table,
found by a probe in the spindle at several angles (`touch`, a socket that moves with the table).

The table has a point of each axis and its direction, in machine coordinates, all other axes at zero. The controller's
manual has its names of these numbers (rotation centres, vectors of the kinematics).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from calib.core.base.errors import DescriptionError, InputError
from calib.core.base.sections import Component
from calib.core.base.units import millimetres
from calib.core.robots.accuracy_of_files import Holds
from calib.core.robots.file_formats import Format, FormatFile
from calib.core.robots.parameters import Origin
from calib.core.robots.robot import Robot
from calib.redundancy.named_origins import NamedComponent, NamedOrigins

NAME = "rotary_axes"
_LINEAR: tuple[Component, ...] = ("x", "y", "z")
_ROTARY: tuple[Component, ...] = ("rx", "ry", "rz")
_OFF, _TILT = 0.5e-3, 1e-3  # expected errors [m], [rad]


def rotary_axes(origins: Mapping[str, Origin]) -> NamedOrigins:
    """Return the parametrisation of a machine's rotary axes.

    Raises:
        DescriptionError: The machine has no rotary axis.
    """
    joints = [(k, name) for k, name in enumerate("abc") if name in origins]
    if not joints:
        raise DescriptionError("parametrisation 'rotary_axes': the URDF has no joint 'a', 'b' or 'c'")
    table: list[NamedComponent] = []
    for own, joint in joints:
        across = [k for k in range(3) if k != own]
        table += [NamedComponent(f"E{'XYZ'[k]}0{joint.upper()}", joint, _LINEAR[k], 1, _OFF, "mm") for k in across]
        table += [NamedComponent(f"E{'ABC'[k]}0{joint.upper()}", joint, _ROTARY[k], 1, _TILT, "mrad") for k in across]
    return NamedOrigins(tuple(table), origins)


def _table(robot: Robot, lines: Sequence[str]) -> FormatFile:
    """A point and the direction of each rotary axis as CSV."""
    if not _has_rotary_axes(robot):
        raise InputError(f"{robot.path}: format 'rotary-axes' is for a robot with 'parametrisation: {NAME}'")
    zero, text = np.zeros((1, len(robot.joint_names))), [f"# {line}" for line in lines]
    text.append("axis,x [mm],y [mm],z [mm],i,j,k")
    for joint in (joint for joint in robot.urdf.joints if joint.name in ("a", "b", "c")):
        pose = robot.forward(zero, joint.name)[0]
        point, direction = millimetres(pose[:3, 3]), pose[:3, "abc".index(joint.name)]
        text.append(
            ",".join([joint.name.upper(), *(f"{n + 0.0:.5f}" for n in point), *(f"{n:.8f}" for n in direction)])
        )
    statement = "a point of each axis of rotation and its direction in machine coordinates, all other axes at zero"
    return FormatFile(("\n".join(text) + "\n").encode(), statement)


def _has_rotary_axes(robot: Robot) -> bool:
    return robot.description.parametrisation == NAME


FORMATS = (Format("rotary-axes", Holds.ORIGINS, _has_rotary_axes, _table),)
