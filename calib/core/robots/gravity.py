"""The torque of gravity that joints hold, and the direction of gravity where that is found from the measurements.

Torques are linear in the acceleration a by gravity, seen from the root link, so their derivative by its direction is
the torque of another acceleration: with a = 9.81 m/s^2 R_a(t_a) R_b(t_b) d,

    d tau / d t = tau(d a / d t),      d a / d t_a = e_a x a,      d a / d t_b = R_a(t_a) (e_b x R_b(t_b) 9.81 d)

and a joint that gives way by c tau moves by c d tau / d t (`calib.core.robots.terms.gravity` has the turns t).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import DescriptionError, nearest, require_known
from calib.core.base.parameter import Parameter
from calib.core.base.units import Dimension
from calib.core.numerics import linalg
from calib.core.robots import kinematics, loops
from calib.core.robots.closure import residual
from calib.core.robots.description import Description
from calib.core.robots.mechanism import Mechanism, RelativeFrame
from calib.core.robots.robot_data import RobotData
from calib.core.robots.terms.gravity import STANDARD, GravitySection, InclinometerSection
from calib.core.robots.terms.term import Condition, Context, Joint, JointTerm
from calib.core.robots.urdf.text import UrdfText

_ROUNDS = 30  # steps of Newton's method
_SETTLED = 1e-12  # a smaller step ends the iteration [rad]
_MISSED = 1e-9  # allowed distance of a direction from what was read
_CONTRADICTS = np.radians(45.0)  # angle from which a reading contradicts the stated direction [rad]
_SAME_AXIS = 1e-3  # two axes turn a link alike if their parts across gravity differ by less


@dataclass(frozen=True)
class GravityTurn(JointTerm):
    """Two turns of gravity's direction. They move every joint that yields under gravity, by its compliance."""

    adds = False
    cause = "load (compliance)"
    depends_on = (Condition.LOAD,)
    follows_command = False
    joint: str
    parameters: tuple[Parameter, ...]
    driven: tuple[str, ...]

    @classmethod
    def from_section(cls, joint: Joint, section: Any, sigma: float | None) -> JointTerm:
        """Raise `ValueError`: this term belongs to a description's `gravity`, and has no entry of its own."""
        raise ValueError("gravity's direction is found where the description's `gravity` has a sigma")

    def driven_joint_names(self, dimensions: Mapping[str, Dimension]) -> tuple[str, ...]:
        """Return the names of the driven joints that give way."""
        return self.driven


def gravity_turn(description: Description, terms: list[JointTerm], mechanism: Mechanism) -> tuple[JointTerm, ...]:
    """Return the turns of gravity's direction, if it is found and any of the terms depends on it."""
    section, bending = description.gravity, [term for term in terms if term.needs_torque]
    if section is None or section.sigma is None or not bending:
        return ()
    driven = dict.fromkeys(name for term in bending for name in term.driven_joint_names(mechanism.dimensions))
    parameters = tuple(Parameter(f"gravity.r{'xyz'[k]}", "angle", 0.0, section.sigma, "deg") for k in section.axes)
    return (GravityTurn("gravity", parameters, tuple(driven)),)


def check_gravity(description: Description, mechanism: Mechanism, where: str) -> None:
    """Raise `DescriptionError` where `gravity` names a link or a setup that there is not."""
    section = description.gravity
    if section is None:
        return
    if section.frame is not None:
        require_known(section.frame, mechanism.frames, f"{where}: gravity.frame: no link or joint", DescriptionError)
    for name in section.setups:
        require_known(name, description.setups, f"{where}: gravity.setups: no setup", DescriptionError)


def check_inclinometers(description: Description, mechanism: Mechanism, where: str) -> None:
    """Raise `DescriptionError` where `inclinometers` cannot say how far their joints are turned."""
    taken: dict[str, str] = {}
    for sensor, section in description.inclinometers.items():
        place = f"{where}: inclinometers.{sensor}"
        require_known(section.frame, mechanism.frames, f"{place}.frame: no link or joint", DescriptionError)
        support = mechanism.support[mechanism.frames[section.frame]]
        for name in section.joints:
            if name not in mechanism.actuated:
                hint = nearest(name, mechanism.actuated)
                raise DescriptionError(f"{place}.joints: no joint '{name}' in name_mot{hint}")
            if name in taken:
                raise DescriptionError(f"{place}.joints: '{name}' is read by '{taken[name]}' already")
            if mechanism.dimensions[name] != "angle":
                raise DescriptionError(f"{place}.joints: '{name}' slides, and tilts nothing; name a joint that turns")
            if not support[mechanism.origin_names.index(name)]:
                raise DescriptionError(f"{place}.joints: '{name}' does not move {section.frame}; name one that does")
            taken[name] = sensor
        if _hangs_in_loop(mechanism, section.frame):
            raise DescriptionError(f"{place}.frame: {section.frame} hangs in a loop; name a link before the loop")
    sensors = list(description.inclinometers)
    for k, (sensor, section) in enumerate(description.inclinometers.items()):
        support = mechanism.support[mechanism.frames[section.frame]]
        for name, of in taken.items():
            if of in sensors[k + 1 :] and support[mechanism.origin_names.index(name)]:
                raise DescriptionError(f"{where}: inclinometers: list '{of}' before '{sensor}': it moves '{sensor}'")


def _hangs_in_loop(mechanism: Mechanism, frame: str) -> bool:
    return bool(np.any(mechanism.support[mechanism.frames[frame]] @ mechanism.select_passive))


def turned_joints(
    mechanism: Mechanism, section: InclinometerSection, q: FloatArray, read: FloatArray, down: FloatArray
) -> FloatArray:
    """Return the angles of two joints at which a sensor would read gravity as it did, (n, 2) [rad]; NaN if none.

    Newton's method from their values in q (n, n_actuated): with g as read (n, 3), d the direction of gravity (n, 3), R
    of the sensor's link and axes e of the joints in the root link, R g = d, and its derivative by a joint is e x R g.
    Of three equations, two count: all vectors have length 1.
    """
    model, index = mechanism.model, mechanism.joint(section.frame)
    data, columns = model.createData(), [mechanism.actuated.index(name) for name in section.joints]
    places = [mechanism.origin_names.index(name) for name in section.joints]
    result = np.full((len(q), 2), np.nan)
    for k, row in enumerate(_open_joints(mechanism, q)):
        value = q[k, columns]
        for _ in range(_ROUNDS):
            row = row + mechanism.select_actuated[:, columns] @ (value - row[places])
            pin.forwardKinematics(model, data, row)
            measured = data.oMi[index].rotation @ read[k]
            slope = np.stack(
                [np.cross(data.oMi[i + 1].rotation @ mechanism.axes[i, 3:], measured) for i in places], axis=1
            )
            step, rank = linalg.solution_and_rank(slope, down[k] - measured, rcond=_SAME_AXIS)
            if rank < 2:
                break
            value = value + step
            if np.max(np.abs(step)) < _SETTLED:
                result[k] = value if np.linalg.norm(down[k] - measured) < _MISSED else np.nan
                break
    return result


def accelerations(robot: RobotData, joints: FloatArray, context: Context) -> tuple[FloatArray, tuple[FloatArray, ...]]:
    """Return the acceleration by gravity at each visit in the root link's axes, and its derivative by each found turn.

    (n, 3) each [m/s^2], [m/s^2 per rad]; `joints` are all of the nominal robot, (n, n_joints) [m or rad].
    """
    section = robot.description.gravity or GravitySection()
    down = section.stated_directions(tuple(robot.description.setups))[context.setup_numbers]
    if context.down is not None:
        read = _measured_direction(section, robot.nominal, joints, context.down)
        down = np.where(np.isnan(read), down, read)
    if not robot.turns_gravity:
        return STANDARD * down, ()
    turns = robot.values[robot.coefficients][-2:]
    axes = np.eye(3)[list(section.axes)]
    first, second = (pin.exp3(angle * axis) for angle, axis in zip(turns, axes, strict=True))
    of_first, of_second = (pin.skew(axis) @ turn for axis, turn in zip(axes, (first, second), strict=True))
    turned = STANDARD * down @ second.T
    return turned @ first.T, (turned @ of_first.T, STANDARD * down @ of_second.T @ first.T)


def _measured_direction(
    section: GravitySection, mechanism: Mechanism, joints: FloatArray, down: FloatArray
) -> FloatArray:
    """Directions that sensors read (n, 3), in the axes of the root link, (n, 3)."""
    if section.frame is None:
        return down
    pair = RelativeFrame(section.frame, 0, mechanism.joint(section.frame), True, ())
    swept = kinematics.sweep(mechanism, joints, (pair,), poses_only=True)
    rotation, _ = kinematics.seen_frame(swept, pair.a, pair.b)
    return np.asarray(np.einsum("nab,nb->na", rotation, down))


def contradiction_angles(robot: RobotData, q: FloatArray, context: Context) -> FloatArray:
    """Return the angle between read and stated gravity, (n,) [rad], at joints q (n, n_actuated) of the nominal robot.

    NaN where it is not too large, and where the sensor's link is in a loop.
    """
    description, mechanism, nothing = robot.description, robot.nominal, np.full(len(q), np.nan)
    section = description.gravity
    if section is None or context.down is None:
        return nothing
    if section.frame is not None and _hangs_in_loop(mechanism, section.frame):
        return nothing
    names = tuple(description.setups) or ("",)
    stated = np.array(["down" in section.model_fields_set or name in section.setups for name in names])
    read = _measured_direction(section, mechanism, _open_joints(mechanism, q), context.down)
    cosine = np.sum(read * section.stated_directions(names)[context.setup_numbers], axis=1)
    angle = np.arccos(np.clip(cosine, -1.0, 1.0))
    return np.where(
        stated[context.setup_numbers] & (angle > max(_CONTRADICTS, 3.0 * (section.sigma or 0.0))), angle, nothing
    )


def _open_joints(mechanism: Mechanism, q: FloatArray) -> FloatArray:
    """All joints at commands q (n, n_actuated), passive ones at zero, (n, n_joints) [m or rad]."""
    return mechanism.all_joints(mechanism.without_tilts(q), np.zeros((len(q), len(mechanism.passive))))


def turn_columns(robot: RobotData, q: FloatArray, context: Context, slopes: tuple[FloatArray, ...]) -> FloatArray:
    """Return the derivative of the errors of the joints that give way by the turns, (n, n_giving_way, n_turns).

    The turns are the last of the terms; `slopes` are derivatives of the torque by each, (n, n_driven).
    """
    mechanism = robot.mechanism
    moved = robot.terms[-1].driven_joint_names(mechanism.dimensions)
    result = np.zeros((len(q), len(moved), len(slopes)))
    for term, coefficients in robot.term_values():
        for name in term.driven_joint_names(mechanism.dimensions) if term.needs_torque else ():
            for k, slope in enumerate(slopes):
                j = mechanism.driven.index(name)
                result[:, moved.index(name), k] += term.torque_derivative(q, j, context, slope) @ coefficients
    return result


def gravity_torques(robot: RobotData, q: FloatArray, context: Context) -> tuple[FloatArray, tuple[FloatArray, ...]]:
    """Return the torque of gravity that each driven joint holds, loops closed, and its derivative by each found turn.

    With the generalized gravity g of the nominal tree, of its masses and of the payload m at the point x, and dp/da of
    the passive joints, virtual work gives

        tau_a = E_a^T g + (dp/da)^T E_p^T g,      g = g(masses) - m J_x^T gravity,      dp/da = -C_p^-1 C_a

    Where loops do not close, passive joints stand at 0.

    Args:
        q: Commands, (n, n_actuated) [m or rad].
        context: Their conditions.

    Returns:
        (n, n_driven) [N m or N], and as many for each turn [per rad].

    Raises:
        DescriptionError: The URDF has no masses, and it is not stated that a payload alone loads the joints.
    """
    mechanism, payload = robot.nominal, robot.description.payload
    driven = mechanism.without_tilts(q)
    closed = loops.close(mechanism, robot.mode, driven)
    passive = np.where(np.isfinite(closed.passive), closed.passive, 0.0)
    joints, masses = mechanism.all_joints(driven, passive), with_masses(robot.urdf, mechanism)
    if masses is None and payload is None:
        raise DescriptionError(
            f"{robot.path}: bending by gravity needs masses, and the URDF has none; add <inertial> to its"
            " links, or say with `payload` which frame carries the masses of a column 'load', or leave the term out"
        )
    kilogram = mechanism.model.copy()  # without any other mass
    kilogram.inertias[payload_frame(mechanism, payload)] = pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3)))
    rate = None
    if mechanism.loops and len(q):
        assert closed.slope is not None  # as no seed was given, `close` has computed it
        slope = np.where(closed.ok[:, None, None], closed.slope, np.eye(passive.shape[1]))
        rate = -np.linalg.solve(slope, residual(mechanism, driven, passive)[2])

    def torque(acceleration: FloatArray) -> FloatArray:
        gravity = np.zeros_like(joints) if masses is None else _gravity(masses, joints, acceleration)
        if np.any(context.load):
            gravity += context.load[:, None] * _gravity(kilogram, joints, acceleration)
        held: FloatArray = gravity @ mechanism.select_actuated
        return held if rate is None else held + np.einsum("npa,np->na", rate, gravity @ mechanism.select_passive)

    acceleration, slopes = accelerations(robot, joints, context)
    return torque(acceleration), tuple(map(torque, slopes))


def _gravity(model: pin.Model, joints: FloatArray, acceleration: FloatArray) -> FloatArray:
    """The generalized gravity of every joint of the tree, (n, n_joints)."""
    data, result = model.createData(), np.empty(joints.shape)
    for k, row in enumerate(joints):
        model.gravity.linear = acceleration[k]
        result[k] = pin.computeGeneralizedGravity(model, data, row)
    return result


def with_masses(urdf: UrdfText, mechanism: Mechanism) -> pin.Model | None:
    """Return the model with the masses of the URDF, if it has any; fixed links are part of the link before."""
    full_model = pin.buildModelFromXML(urdf.source.decode())
    inertias = {
        name: inertia for name, inertia in zip(full_model.names, full_model.inertias, strict=True) if inertia.mass > 0
    }
    if not inertias.keys() & {*mechanism.origin_names}:
        return None
    model = mechanism.model.copy()
    for joint in urdf.joints:
        if joint.name in inertias:
            model.inertias[mechanism.frames[joint.child]] = inertias[joint.name]
    return model


def payload_frame(mechanism: Mechanism, payload: str | None) -> int:
    """Return the joint index of the frame that a payload hangs at; None: of the first target that motors move."""
    tool = (*mechanism.moved_targets, mechanism.targets[0])[0]
    return tool.b if payload is None else mechanism.joint(payload)
