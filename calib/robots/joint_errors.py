"""From commanded to actual joints: the terms of a robot's joint errors, and the one door through which they enter."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from calib.base.arrays import FloatArray
from calib.base.errors import DescriptionError, InputError, nearest
from calib.base.units import Dimension, quantity
from calib.joint_terms.term import Context, Joint, JointTerm, TermSection, tilts_of
from calib.joint_terms.terms import TERMS
from calib.robots import kinematics
from calib.robots.description import Description
from calib.robots.mechanism import Mechanism
from calib.robots.urdf.text import UrdfJoint, UrdfText


def build_terms(description: Description, urdf: UrdfText, mechanism: Mechanism, where: str) -> tuple[JointTerm, ...]:
    """Build the joint terms of a description.

    Raises:
        DescriptionError: An unknown joint, a sigma of another dimension, an entry that does not fit its joint, or a
            payload at a frame that there is not, or that no joint moves.
    """
    if description.payload is not None and description.payload not in mechanism.frames:
        name = description.payload
        raise DescriptionError(f"{where}: payload: no link, joint or target '{name}'{nearest(name, mechanism.frames)}")
    if description.payload is not None and not np.any(
        mechanism.support[mechanism.frames[description.payload]] @ mechanism.select_moving
    ):
        raise DescriptionError(f"{where}: payload: no motor moves '{description.payload}'; name a frame that moves")
    joints = {joint.name: joint for joint in urdf.joints}
    terms: list[JointTerm] = []
    for section in description.terms:
        names = mechanism.actuated if section.joint == "all" else (section.joint,)
        for name in names:
            if name not in mechanism.actuated:
                raise DescriptionError(
                    f"{where}: joint term '{section.term}': no actuated joint '{name}'"
                    f"{nearest(name, (*mechanism.actuated, 'all'))}"
                )
            terms.append(_term(section, name, joints[name], mechanism, where))
    return tuple(terms)


def _term(section: TermSection, name: str, joint: UrdfJoint, mechanism: Mechanism, where: str) -> JointTerm:
    dimension = mechanism.dimensions[name]
    place = f"{where}: joint term '{section.term}' of '{name}'"
    try:
        unit: Dimension = "angle" if TERMS[section.term].tilts else dimension
        sigma = None if section.sigma is None else quantity(section.sigma, unit, f"{place}, sigma")
        if sigma is not None and sigma <= 0:
            raise InputError(f"{place}: sigma must be positive; leave the term out to have none")
        stroke = joint.upper - joint.lower
        if dimension == "length" and np.isfinite(stroke) and stroke > 0:
            section = section.within(float(stroke))
        return TERMS[section.term].of(Joint(name, dimension, mechanism.actuated), section, sigma)
    except (InputError, ValueError) as error:
        text = str(error)
        raise DescriptionError(text if text.startswith(where) else f"{place}: {text}") from None


def driven_by(term: JointTerm, mechanism: Mechanism) -> list[int]:
    """Return which of the driven joints a term moves."""
    names = tilts_of(term.joint, mechanism.dimensions[term.joint]) if term.tilts else (term.joint,)
    return [mechanism.driven.index(name) for name in names]


def term_columns(
    terms: tuple[JointTerm, ...], mechanism: Mechanism, q: FloatArray, context: Context
) -> tuple[FloatArray, ...]:
    """Return phi of each term for each joint that it moves, (n, n_moved, n_coefficients) each.

    Args:
        terms: The terms.
        mechanism: The robot.
        q: Commands, (n, n_actuated) [m or rad].
        context: Their conditions.
    """
    columns = []
    for term in terms:
        moved = driven_by(term, mechanism)
        if term.needs_torque and context.torque is None:
            columns.append(np.zeros((len(q), len(moved), len(term.parameters))))
        else:
            columns.append(np.stack([term.columns(q, j, context) for j in moved], axis=1))
    return tuple(columns)


def joint_errors(
    terms: tuple[JointTerm, ...], mechanism: Mechanism, columns: tuple[FloatArray, ...], values: FloatArray, n: int
) -> FloatArray:
    """Return dq of every driven joint, (n, n_driven), from the columns and the coefficients (n_coefficients,)."""
    errors, start = np.zeros((n, len(mechanism.driven))), 0
    for term, phi in zip(terms, columns, strict=True):
        stop = start + len(term.parameters)
        errors[:, driven_by(term, mechanism)] += phi @ values[start:stop]
        start = stop
    return errors


def gravity_torque(
    urdf: UrdfText,
    mechanism: Mechanism,
    q: FloatArray,
    passive: FloatArray,
    slope: FloatArray,
    load: FloatArray,
    payload: str | None,
    where: str,
) -> FloatArray:
    """Return the torque of gravity that each driven joint holds, loops closed, (n, n_driven) [N m or N].

    With the generalized gravity g of the tree, of its masses and of the payload m at the point x, and dp/da of the
    passive joints, virtual work gives

        tau_a = E_a^T g + (dp/da)^T E_p^T g,      g = g(masses) - m J_x^T gravity,      dp/da = -C_p^-1 C_a

    Args:
        urdf: The URDF with its masses.
        mechanism: The nominal mechanism.
        q: Driven joints, (n, n_driven).
        passive: Passive joints there, (n, n_passive).
        slope: C_p there, (n, n_passive, n_passive).
        load: Mass of the payload, (n,) [kg].
        payload: Frame at whose origin it hangs; None: that of the first target that motors move.
        where: What to call the robot in messages.

    Raises:
        DescriptionError: The URDF has no masses, and nobody says that a payload alone loads the joints.
    """
    joints = mechanism.all_joints(q, passive)
    gravity = np.zeros_like(joints)
    masses = with_masses(urdf, mechanism)
    if masses is not None:
        gravity += _gravity(masses, joints)
    elif payload is None:
        raise DescriptionError(
            f"{where}: what gravity bends needs masses, and the URDF has none; add <inertial> to its"
            " links, or say with `payload` which frame carries the masses of a column 'load', or leave the term out"
        )
    if np.any(load):
        gravity += load[:, None] * _gravity(_with_one_kilogram(mechanism, payload), joints)
    torque: FloatArray = gravity @ mechanism.select_actuated
    if mechanism.loops and len(q):
        by_actuated = _closure_by_actuated(mechanism, joints)
        rate = -np.linalg.solve(slope, by_actuated)
        torque = torque + np.einsum("npa,np->na", rate, gravity @ mechanism.select_passive)
    return torque


def _gravity(model: pin.Model, joints: FloatArray) -> FloatArray:
    """The generalized gravity of every joint of the tree, (n, n_joints)."""
    data = model.createData()
    return np.array([pin.computeGeneralizedGravity(model, data, row).copy() for row in joints]).reshape(joints.shape)


def _closure_by_actuated(mechanism: Mechanism, joints: FloatArray) -> FloatArray:
    """C_a, (n, n_passive, n_driven)."""
    swept = kinematics.sweep(mechanism, joints, mechanism.loops)
    parts = []
    for loop in mechanism.loops:
        columns = mechanism.between(loop)[:, None] * mechanism.select_actuated
        parts.append(kinematics.joint_derivative(swept, kinematics.twist_map(swept, loop), columns))
    return np.concatenate(parts, axis=1)


def with_masses(urdf: UrdfText, mechanism: Mechanism) -> pin.Model | None:
    """Return the model with the masses of the URDF, if it has any.

    What hangs on fixed joints is part of the link before.
    """
    whole = pin.buildModelFromXML(urdf.source.decode())
    inertias = {name: inertia for name, inertia in zip(whole.names, whole.inertias, strict=True) if inertia.mass > 0}
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


def _with_one_kilogram(mechanism: Mechanism, payload: str | None) -> pin.Model:
    """The mechanism's model with one kilogram at a frame's origin and no other mass."""
    model = mechanism.model.copy()
    model.inertias[payload_frame(mechanism, payload)] = pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3)))
    return model
