"""Parameters: possible errors of a robot, and how they move the joint origins.

A parametrisation maps a vector of values to joint origins and gives the derivative as twists. The twist xi_i of origin
i is the right perturbation `placement_i * exp6(xi_i)`, [linear; angular] in the joint's own frame, so

    d(measured)/d(parameters) = d(measured)/d(xi) . d(xi)/d(parameters)

and the first factor is the same for every parametrisation.

`OriginComponents` is the general one. With nominal origin (t, R), its parameters give

    translation  t + [x, y, z]        (in the parent link, as URDF's xyz)
    rotation     R exp([rx, ry, rz])  (a rotation vector in the joint frame, 0 at nominal)

A rotation vector, and not URDF's rpy, because rpy has no derivative at pitch = +-90 degrees, where many robots have
joints. The value shown for a translation is the coordinate itself; for a rotation it is the deviation.

The measurement frame is the one origin that is edited the other way round: the parameters of `base` are those of the
robot's link seen in the measurement frame. A tracker stands metres away; turning the robot about its own base keeps
the model close to linear, turning it about the tracker would not.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
import pinocchio as pin

from calib.core.base.arrays import FloatArray, ReadOnlyArrays
from calib.core.base.parameter import Parameter


@dataclass(frozen=True)
class Origin(ReadOnlyArrays):
    """A nominal joint origin as the URDF has it: `xyz` (3,) [m] in the parent link, `rpy` (3,) fixed-axis angles [rad].

    That of `base` is the pose of its link in the measurement frame.
    """

    xyz: FloatArray
    rpy: FloatArray

    @property
    def placement(self) -> pin.SE3:
        """The origin as a rigid transform, parent link to joint."""
        return pin.SE3(pin.rpy.rpyToMatrix(*self.rpy), self.xyz)


class Parametrisation(Protocol):
    """Interface of a set of parameters."""

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameters, in the order of every vector and column."""

    def placements(self, values: FloatArray) -> dict[str, pin.SE3]:
        """Return the origins that the values (n_parameters,) [m or rad] give, by name; the others stay nominal."""

    def twists(self, values: FloatArray) -> dict[str, FloatArray]:
        """Return d(xi)/d(values) of the same origins, (6, n_parameters) each; see the module docstring for xi."""


@dataclass(frozen=True)
class ResultUse:
    """Use of calibrated robots of a parametrisation, in words: its attribute `result_use`, if it has one.

    Attributes:
        aim: The aim, in words that begin with a verb.
        command: Command to type; `DIR` stands for the result folder.
        held_by_controller: Message to users who compensate programs, where the controller has the result itself.
    """

    aim: str
    command: str
    held_by_controller: str = ""


def twist_of_edit(rpy: FloatArray, d_xyz: FloatArray, d_rpy: FloatArray) -> FloatArray:
    """Turn derivatives of URDF's xyz and rpy into a right-perturbation twist.

    xi = [R^T dxyz ; W(rpy) drpy], with W Pinocchio's local roll-pitch-yaw Jacobian.

    Args:
        rpy: Angles at which to differentiate, (3,) [rad].
        d_xyz: d(xyz)/d(parameters), (3, n_parameters).
        d_rpy: d(rpy)/d(parameters), (3, n_parameters).

    Returns:
        (6, n_parameters).
    """
    twist = np.empty((6, d_xyz.shape[1]))
    twist[:3] = pin.rpy.rpyToMatrix(rpy).T @ d_xyz
    twist[3:] = pin.rpy.computeRpyJacobian(rpy, pin.ReferenceFrame.LOCAL) @ d_rpy
    return twist


@dataclass(frozen=True, eq=False)
class OriginComponents:
    """Any components of any joint origins; see the module docstring.

    Attributes:
        parameters: One for each component.
        places: (origin name, index into x, y, z, rx, ry, rz) of each parameter.
        nominal: Nominal (t, R) of each origin that has parameters.
        inverted: Origins whose (t, R) is the inverse of their placement.
    """

    parameters: tuple[Parameter, ...]
    places: tuple[tuple[str, int], ...]
    nominal: dict[str, pin.SE3]
    inverted: frozenset[str] = frozenset()

    def placements(self, values: FloatArray) -> dict[str, pin.SE3]:
        """Return the edited origins; see `Parametrisation`."""
        edited = {name: self._edit(name, moved) for name, moved in self._deviations(values).items()}
        return {name: pose.inverse() if name in self.inverted else pose for name, pose in edited.items()}

    def twists(self, values: FloatArray) -> dict[str, FloatArray]:
        """Return the derivative of each origin; see `Parametrisation`."""
        row, component, _ = self._moves
        whole, own = np.zeros((len(self.nominal), 6, 6)), np.zeros((len(self.nominal), 6, len(self.parameters)))
        whole[:, :3, :3], whole[:, 3:, 3:] = self._axes, np.eye(3)
        for twist, (name, moved) in zip(whole, self._deviations(values).items(), strict=True):
            if moved[3:].any():
                twist[:3, :3] = pin.exp3(moved[3:]).T @ twist[:3, :3]
                twist[3:, 3:] = pin.Jexp3(moved[3:])
            if name in self.inverted:  # (T exp(xi))^-1 = T^-1 exp(-Ad(T) xi)
                twist[:] = -self._edit(name, moved).toActionMatrix() @ twist
        own[row, :, np.arange(len(row))] = whole[row, :, component]
        return dict(zip(self.nominal, own, strict=True))

    @cached_property
    def _axes(self) -> FloatArray:
        """Transposed nominal rotations of all origins, (n_origins, 3, 3)."""
        return np.array([pose.rotation.T for pose in self.nominal.values()]).reshape(-1, 3, 3)

    def _edit(self, name: str, moved: FloatArray) -> pin.SE3:
        nominal = self.nominal[name]
        return pin.SE3(nominal.rotation @ pin.exp3(moved[3:]), nominal.translation + moved[:3])

    def _deviations(self, values: FloatArray) -> dict[str, FloatArray]:
        moved = np.zeros((len(self.nominal), 6))
        row, component, nominal = self._moves
        moved[row, component] = values - nominal
        return dict(zip(self.nominal, moved, strict=True))

    @cached_property
    def _moves(self) -> tuple[list[int], list[int], FloatArray]:
        """Row of the origin, component and nominal value of each parameter."""
        rows = {name: row for row, name in enumerate(self.nominal)}
        nominal = np.array([parameter.nominal_si for parameter in self.parameters])
        return [rows[name] for name, _ in self.places], [component for _, component in self.places], nominal


@dataclass(frozen=True, eq=False)
class ParametrisationStack:
    """Several parametrisations of different origins, one after another.

    Attributes:
        parts: The parametrisations.
        own: The parameters of all parts with other priors; none: as the parts have them.
    """

    parts: tuple[Parametrisation, ...]
    own: tuple[Parameter, ...] = ()

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameters of all parts."""
        return self.own or tuple(parameter for part in self.parts for parameter in part.parameters)

    def placements(self, values: FloatArray) -> dict[str, pin.SE3]:
        """Return the edited origins; see `Parametrisation`."""
        return {
            name: pose
            for part, part_values, _ in self._split_values(values)
            for name, pose in part.placements(part_values).items()
        }

    def twists(self, values: FloatArray) -> dict[str, FloatArray]:
        """Return the derivative of each origin; see `Parametrisation`."""
        result: dict[str, FloatArray] = {}
        for part, part_values, columns in self._split_values(values):
            for name, twist in part.twists(part_values).items():
                result[name] = np.zeros((6, len(values)))
                result[name][:, columns] = twist
        return result

    def _split_values(self, values: FloatArray) -> Iterator[tuple[Parametrisation, FloatArray, slice]]:
        start = 0
        for part in self.parts:
            columns = slice(start, start + len(part.parameters))
            yield part, values[columns], columns
            start = columns.stop
