"""Three ways to measure MedRUE in simulation: by a tracker, by touch, and by encoders on its passive joints.

Tracker
    Positions of the tool at poses of the target workspace, as in `medrue.study`.
Touch
    The ball at the tip of the probe rests in sockets of one artefact, the probe turned by up to 30 degrees about each
    axis; nothing is read but the joints. Sockets and no spheres: a touch of a socket gives three rows, as a position by
    the tracker does, so that both methods have equally many rows with the same noise and differ only in where they
    measure; a touch of a sphere gives one. The nine sockets lie on the half cylinder of the target workspace, as on a
    dummy leg, because a robot is known best where it was measured. Their places on the artefact count as known exactly.
Encoders
    Readings of all seven passive joints at poses of the target workspace. What an encoder reads at zero is unknown.

The noise of a touch on each axis, and of a sliding encoder, is that of the tracker; the noise of a turning encoder is
this length divided by that of a distal link. What is read comes from the closed form: joint values that bring the
tool of the actual robot into a socket that it misses by the noise, and passive joints of the actual robot.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin

from calib.core.base.arrays import FloatArray, IntArray
from calib.core.base.errors import ComputationError
from calib.core.data.in_memory import as_measurements
from calib.core.data.measurements import Measurements
from calib.core.robots.description import validate_description
from calib.core.robots.loading import build, load
from calib.core.robots.robot import Robot
from medrue import robot_file
from medrue.closed_form import PASSIVE_JOINTS, forward, homogeneous, rotation_x, rotation_y, rotation_z
from medrue.closed_form_inverse import inverse
from medrue.paper_tables import PARAMETERS, table1
from medrue.study import SIGMA, true_positions
from medrue.workspace import AXIS_START, LEAN_AT_END, LENGTH, MIDDLE_ANGLE, RADIUS

CANDIDATES = 540
"""Touches to choose from, shared evenly by the sockets of an artefact."""
TURN, LEAN, TWIST = np.radians(30.0), np.radians(20.0), np.radians(30.0)
"""How far the probe turns about the leg's axis, leans along it, and twists about its own [rad]."""
PUT_UP = (5e-3, float(np.radians(1.0)))
"""Placing error of an artefact that is put up by hand, one standard deviation [m, rad]."""
ENCODER_SIGMA = SIGMA / float(table1().nominal[PARAMETERS.index("L12")])
"""Noise of an encoder that turns [rad]."""
_PLASTIC = 1.2207440846057596  # the real root of g^4 = g + 1: the R3 sequence (Roberts, 2018)


@dataclass(frozen=True)
class Artefact:
    """An artefact with sockets on the half cylinder of the target workspace; its axes are the world's.

    Attributes:
        around: Directions of the sockets around the leg's axis, from the middle of the half [rad].
        along: Their places along it, as fractions of its length.
    """

    around: tuple[float, ...]
    along: tuple[float, ...]

    @cached_property
    def grid(self) -> FloatArray:
        """Direction from +y towards +z [rad] and fraction of the length of each socket, (n, 2)."""
        around, along = np.meshgrid(MIDDLE_ANGLE + np.array(self.around), self.along, indexing="ij")
        return np.stack([around.ravel(), along.ravel()], axis=1)

    @cached_property
    def sockets(self) -> FloatArray:
        """Centres of the sockets seen from the start of the leg's axis, (n, 3) [m]."""
        around, along = self.grid.T
        return np.stack([LENGTH * along, RADIUS * np.cos(around), RADIUS * np.sin(around)], axis=1)


ARTEFACT = Artefact((-np.radians(70.0), 0.0, np.radians(70.0)), (1 / 8, 1 / 2, 7 / 8))
"""The artefact that is touched."""


@dataclass(frozen=True, eq=False)
class Touches:
    """Touches that the robot can make, with nominal parameters.

    Attributes:
        T_world_tool: Poses of the tool, (n, 4, 4) [m].
        socket: Number of the socket of each touch, (n,).
        joints: Joint values that reach them, (n, 6) [m, rad].
    """

    T_world_tool: FloatArray
    socket: IntArray
    joints: FloatArray

    def some(self, index: IntArray) -> Touches:
        """Return the touches with these indices, (n,)."""
        return Touches(self.T_world_tool[index], self.socket[index], self.joints[index])


def possible_touches(artefact: Artefact) -> Touches:
    """Return touches of every socket in evenly spread directions of the probe.

    The probe points at the leg's axis and leans towards the nearer end of the leg, as in the target workspace; from
    there it turns about all three axes.
    """
    each = CANDIDATES // len(artefact.sockets)
    socket = np.repeat(np.arange(len(artefact.sockets)), each)
    steps = np.tile(np.arange(1, each + 1), len(artefact.sockets))
    turn, lean, twist = (2.0 * np.remainder(0.5 + steps / _PLASTIC**k, 1.0) - 1.0 for k in (1, 2, 3))
    around, along = artefact.grid[socket].T
    inwards = LEAN_AT_END * (2.0 * along - 1.0)
    R = rotation_x(around + np.pi / 2.0 + TURN * turn) @ rotation_y(inwards + LEAN * lean) @ rotation_z(TWIST * twist)
    T = homogeneous(R, np.array(AXIS_START) + artefact.sockets[socket])
    return Touches(T, socket, inverse(T, table1().nominal))


@dataclass(frozen=True, eq=False)
class Method(ABC):
    """A way to measure the robot.

    Attributes:
        name: Its name.
        robot: The nominal robot with its instruments.
    """

    name: str
    robot: Robot

    @abstractmethod
    def measured(self, actual: FloatArray, generator: np.random.Generator) -> Measurements:
        """Measure a robot with the actual parameters (36,) [m, rad]; the generator draws noise and unknown places."""


@dataclass(frozen=True, eq=False)
class TrackerMethod(Method):
    """Positions at poses, (n, 6) [m, rad]."""

    joints: FloatArray

    def measured(self, actual: FloatArray, generator: np.random.Generator) -> Measurements:
        """See `Method`."""
        exact = true_positions(self.joints, actual)
        return as_measurements(self.robot, self.joints, exact + generator.normal(0.0, SIGMA, exact.shape))


@dataclass(frozen=True, eq=False)
class TouchMethod(Method):
    """Touches of sockets.

    Attributes:
        touches: The touches.
        anywhere: Whether the artefact stands where it was put by hand, and not where the description says.
    """

    touches: Touches
    anywhere: bool

    def measured(self, actual: FloatArray, generator: np.random.Generator) -> Measurements:
        """See `Method`.

        Raises:
            ComputationError: The actual robot does not reach a socket.
        """
        touched, origin = self.touches.T_world_tool.copy(), np.array(AXIS_START)
        offset = touched[:, :3, 3] - origin
        if self.anywhere:
            origin = origin + generator.normal(0.0, PUT_UP[0], 3)
            offset = offset @ pin.exp3(generator.normal(0.0, PUT_UP[1], 3)).T
        touched[:, :3, 3] = origin + offset + generator.normal(0.0, SIGMA, offset.shape)
        joints = inverse(touched, actual)
        if not np.isfinite(joints).all():
            raise ComputationError("a robot with the actual parameters does not reach all sockets")
        words = [_socket_name(k) for k in self.touches.socket]
        return as_measurements(self.robot, joints, {"probe": words})


@dataclass(frozen=True, eq=False)
class EncoderMethod(Method):
    """Readings of the passive joints at poses, (n, 6) [m, rad]."""

    joints: FloatArray

    def measured(self, actual: FloatArray, generator: np.random.Generator) -> Measurements:
        """See `Method`."""
        exact = forward(self.joints, actual).passive
        slides = np.array([joint == "slide" for joint in PASSIVE_JOINTS])
        zeros = np.where(slides, PUT_UP[0], np.pi) * generator.uniform(-1.0, 1.0, len(slides))
        noise = np.where(slides, SIGMA, ENCODER_SIGMA) * generator.standard_normal(exact.shape)
        read = exact + zeros + noise
        return as_measurements(
            self.robot, self.joints, {f"at_{joint}": read[:, [k]] for k, joint in enumerate(PASSIVE_JOINTS)}
        )


def touching_robot(*, anywhere: bool) -> Robot:
    """Return MedRUE with the sockets that its probe touches.

    Args:
        anywhere: The artefact with the sockets may stand anywhere; no parameter is held then, all are expected within
            their sigmas. Otherwise it stands where the description says: it is the world.
    """
    points = {_socket_name(k): place.tolist() for k, place in enumerate(ARTEFACT.sockets)}
    artefact = {"frame": "world", "xyz": list(AXIS_START), "points": points, "pose": "unknown" if anywhere else "known"}
    probe = {"kind": "touch", "target": "tool", "sigma": SIGMA, "artefact": artefact}
    return _with_instruments({"probe": probe}, expected=anywhere)


def encoder_robot() -> Robot:
    """Return MedRUE with an encoder on every passive joint; no parameter is held, all are expected within sigma."""
    encoders = {}
    for joint in PASSIVE_JOINTS:
        dimension, sigma = ("length", SIGMA) if joint == "slide" else ("angle", ENCODER_SIGMA)
        encoder = {"kind": "joint_reading", "joint": joint, "dimension": dimension, "sigma": sigma, "zero": "unknown"}
        encoders[f"at_{joint}"] = encoder
    return _with_instruments(encoders, expected=True)


def _socket_name(k: int) -> str:
    return f"socket {k + 1}"


def _with_instruments(instruments: Mapping[str, Any], *, expected: bool) -> Robot:
    """The robot of `medrue.yaml` with other instruments.

    If its parameters are `expected` within the sigmas of their geometry, none is held; measured places may be anywhere.
    """
    robot = load(robot_file())
    content = robot.description.model_dump(mode="json", exclude_unset=True) | {"instruments": dict(instruments)}
    del content["sigma"]  # noise of the tracker
    if expected:
        parameters = robot.parameters
        content |= {"held": [], "prior": {p.name: f"{p.sigma:g} {p.unit}" for p in parameters}}
    return build(validate_description(content, robot.path), robot.urdf, robot.path)
