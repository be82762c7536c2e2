"""The target workspace: 420 poses of the tool on a half cylinder around a patient's leg.

The paper gives the size (diameter 300 mm, length 700 mm along x) and the number of positions (420, spread
uniformly). Its text gives neither the place, nor the directions of the probe, nor the joint values. They are chosen
here, with the nominal parameters and in the world frame:

Place
    The leg's axis is parallel to x, at y = 340 mm, z = -40 mm, from x = -113 mm to 587 mm. The half of the surface
    that is used faces the robot and upwards: its middle is 140 degrees from +y towards +z. (A half that faces straight
    up would bring the links within 130 mm of the axis, into the leg.) With this choice the links' centre lines stay
    166 mm away from the leg's axis, every angle between two links of a five-bar keeps a sine above 0.64 (above 0.58
    with parameter errors of up to 2 mm and 1.5 degrees), and q1 stays between 36 and 666 mm of its 700 mm stroke.

Positions
    15 directions around the axis times 28 stations along it, each at the middle of an equal piece of the surface
    (31.4 mm by 25 mm). The stations run fastest. 28 and 5 have no common divisor, so that every fifth pose is spread
    over all stations and directions.

Directions of the probe
    z_6 always points at the leg's axis (gamma = direction of the position around the axis + 90 degrees). In addition
    the probe leans along the leg (beta) and twists about its own axis (alpha), as an ultrasound examination asks for.
    Without leaning and twisting, E_1 and E_2 would move as one and the positions would show 21 instead of 28
    combinations of the 36 parameters. For pose n = 0, 1, ... at the fraction s (from -1 to 1) of the leg,
        beta_n  = 20 deg s + 10 deg (2 frac(1/2 + n / g) - 1)
        alpha_n =            30 deg (2 frac(1/2 + n / g^2) - 1)
    with g = 1.3247..., the real root of g^3 = g + 1. This is the R2 sequence (Roberts, 2018): it covers the square
    evenly and needs no random numbers. The term with s leans the probe towards the nearer end of the leg, so that the
    guide's stroke of 700 mm suffices for 700 mm of leg.

The working mode has the elbows of each five-bar apart from each other, so that its links do not cross. All positions
share the assembly mode of `HOME`, also for parameters up to 2 mm and 1.5 degrees away from nominal.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from medrue.closed_form import (
    ACTUATED_JOINTS,
    PASSIVE_JOINTS,
    Array,
    forward,
    homogeneous,
    rotation_x,
    rotation_y,
    rotation_z,
)
from medrue.closed_form_inverse import inverse
from medrue.paper_tables import table1

AXIS_START = (-0.113, 0.340, -0.040)
"""Start of the leg's axis in the world [m]."""

RADIUS = 0.150
LENGTH = 0.700
MIDDLE_ANGLE = np.radians(140.0)
DIRECTIONS_AROUND = 15
STATIONS_ALONG = 28
LEAN_AT_END = np.radians(20.0)
LEAN_SPREAD = np.radians(10.0)
TWIST_SPREAD = np.radians(30.0)
R2_ROOT = 1.32471795724474602596


@dataclass(frozen=True)
class Workspace:
    """Poses on the half cylinder and its shape, for viewers. All in the world frame.

    Attributes:
        T_world_tool: Poses of the tool, `(420, 4, 4) [m]`; its z axis points at the leg.
        q: Joint values that reach them with nominal parameters, `(420, 6) [m, rad]`.
        p_axis: Start of the leg's axis, `(3,) [m]`.
        axis: Unit direction of the leg's axis, `(3,)`.
        middle: Unit direction from the axis to the middle of the used half, `(3,)`.
        radius: Radius of the cylinder [m].
        length: Length of the cylinder along the axis [m].
    """

    T_world_tool: Array
    q: Array
    p_axis: Array
    axis: Array
    middle: Array
    radius: float
    length: float


@cache
def target_workspace() -> Workspace:
    """The 420 poses of the target workspace, with the joint values that reach them; its arrays are read-only."""
    T_world_tool = _poses()
    q = inverse(T_world_tool, table1().nominal)
    arrays = (
        T_world_tool,
        q,
        np.array(AXIS_START),
        np.array([1.0, 0.0, 0.0]),
        np.array([0.0, np.cos(MIDDLE_ANGLE), np.sin(MIDDLE_ANGLE)]),
    )
    for values in arrays:
        values.setflags(write=False)
    return Workspace(*arrays, radius=RADIUS, length=LENGTH)


def _poses() -> Array:
    """Poses in the order described above, `(420, 4, 4) [m]`."""
    around = MIDDLE_ANGLE + np.pi * (_middles(DIRECTIONS_AROUND) - 0.5)
    along = _middles(STATIONS_ALONG)
    direction, fraction = (grid.ravel() for grid in np.meshgrid(around, along, indexing="ij"))
    n = np.arange(len(direction))
    lean = LEAN_AT_END * (2.0 * fraction - 1.0) + LEAN_SPREAD * _evenly_spread(n / R2_ROOT)
    twist = TWIST_SPREAD * _evenly_spread(n / R2_ROOT**2)
    R = rotation_x(direction + np.pi / 2.0) @ rotation_y(lean) @ rotation_z(twist)
    offset = np.stack([LENGTH * fraction, RADIUS * np.cos(direction), RADIUS * np.sin(direction)], axis=1)
    return homogeneous(R, np.array(AXIS_START) + offset)


def _middles(count: int) -> Array:
    """The middles of `count` equal pieces of the interval from 0 to 1, `(count,)`."""
    return (np.arange(count) + 0.5) / count


def _evenly_spread(steps: NDArray[np.float64]) -> Array:
    """One coordinate of the R2 sequence, from -1 to 1, `(n,)`."""
    return 2.0 * np.remainder(0.5 + steps, 1.0) - 1.0


def _home() -> Mapping[str, float]:
    """Joint values at the middle of the workspace, with closed loops at nominal parameters."""
    direction = np.array([MIDDLE_ANGLE])
    offset = np.array([LENGTH / 2.0, RADIUS * np.cos(MIDDLE_ANGLE), RADIUS * np.sin(MIDDLE_ANGLE)])
    p = np.array(AXIS_START) + offset
    middle = inverse(homogeneous(rotation_x(direction + np.pi / 2.0), p[None]), table1().nominal)
    q = np.round(middle, 3)
    passive = forward(q, table1().nominal).passive + 0.0  # turns -0.0 into 0.0
    names = ACTUATED_JOINTS + PASSIVE_JOINTS
    return MappingProxyType(dict(zip(names, np.concatenate([q[0], passive[0]]).tolist(), strict=True)))


HOME: Mapping[str, float] = _home()
"""A closed configuration at the middle of the workspace, by joint name [m, rad]. Actuated values are rounded."""
